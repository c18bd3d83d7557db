//! Time and memory are bounded by the size of what is handed in, never by the numbers in it. Each command has 2 GB and a
//! minute, far more than it takes and far less than it took.
#![cfg(target_os = "linux")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn limited(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -v 2097152; exec timeout 60 \"$@\"", "sh", env!("CARGO_BIN_EXE_twum")]);
    command.args(arguments).current_dir(folder).env("XDG_CACHE_HOME", folder.join("cache"));
    command.stdin(Stdio::null()).output().unwrap()
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn measurement(folder: &Path, name: &str, format: &str, rows: &str) {
    let folder = folder.join(name);
    fs::create_dir(&folder).unwrap();
    let manifest = format!(
        "name = \"a\"\nmotor = \"pcbmotor-30mm\"\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\n\
         format = \"{format}\"\nduty = 0.5\ndirection = \"cw\"\ndrive_on_s = 1.0\n"
    );
    fs::write(folder.join("measurement.toml"), manifest).unwrap();
    fs::write(folder.join("a.csv"), rows).unwrap();
}

#[test]
fn an_edge_that_comes_hours_late_costs_no_hours() {
    let dir = tempfile::tempdir().unwrap();
    let rows = "time_us,level\n0,0\n1000,1\n5000,0\n9000,1\n80000000000,0\n80000001000,0\n";
    measurement(dir.path(), "late", "edges", rows);
    for arguments in [
        &["velocity", "late"][..],
        &["velocity", "late", "--method", "window"],
        &["velocity", "late", "--method", "thesis-raw"],
        &["plot", "late", "late.svg"],
        &["import", "late", "--as", "levels", "--to", "levels"],
    ] {
        let output = limited(dir.path(), arguments);
        assert!(
            matches!(output.status.code(), Some(0 | 2)),
            "{arguments:?}: {:?}, {}",
            output.status,
            message(&output)
        );
    }
    let output = limited(dir.path(), &["compare", "late"]);
    assert_eq!(output.status.code(), Some(2), "{}", message(&output));
    assert!(message(&output).contains("run `a`: it ends 4000000 PWM periods after t = 0"), "{}", message(&output));
}

#[test]
fn a_window_longer_than_a_record_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    measurement(dir.path(), "short", "edges", "time_us,level\n0,0\n1000,1\n5000,0\n9000,1\n20000,1\n");
    let output = limited(dir.path(), &["velocity", "short", "--method", "window", "--window", "18446744073709551615"]);
    assert_eq!(output.status.code(), Some(2), "{}", message(&output));
}

#[test]
fn a_load_beyond_what_the_contact_transmits_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    for arguments in [&["model", "loop", "--set", "Tload=-1"][..], &["model", "speed", "--set", "Tload=1e3"]] {
        let output = limited(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", message(&output));
        assert!(message(&output).contains("the contact transmits"), "{}", message(&output));
    }
}

#[test]
fn a_number_that_is_none_or_out_of_all_measure_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    measurement(dir.path(), "m", "velocity", "time_us,rpm\n0,17\n500000,17.1\n1000000,17\n");
    let force_factor = |loaded| ["identify", "force-factor", "m", "--loaded", loaded];
    for (arguments, says) in [
        (&["experiment", "plan", "--seconds", "nan"][..], "--seconds: NaN s is outside 0.001 to 3600 s"),
        (&force_factor("1.0:0.004:1.8e19"), "rpm must be within 10 N m and 1000 rpm"),
        (&force_factor("1.0:0.015:65535"), "rpm must be within 10 N m and 1000 rpm"),
        (&force_factor("1.0:1e-300:0"), "a stall must be at duty 1 and a torque of 0.000001 N m or more"),
        (&["model", "speed", "--set", "Ctheta=0.1", "--pwm-hz", "0"], "pwm-hz = 0 is outside 0.1 ..= 20000"),
        (&["speed", "--port", "sim", "--duty", "0.5", "--pwm-hz", "0"], "`pwm_hz` = 0: 10 to 2000"),
    ] {
        let output = limited(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {:?}, {}", output.status, message(&output));
        assert!(message(&output).contains(says), "{arguments:?}: {}", message(&output));
    }
}

#[test]
fn damping_as_large_as_it_may_be_gives_a_number() {
    let dir = tempfile::tempdir().unwrap();
    for damping in ["Ctheta=0.1", "Ctheta=0.3", "Ctheta=1"] {
        for solver in ["averaged", "carrier"] {
            let arguments = [
                "model",
                "speed",
                "--duty",
                "0.5",
                "--seconds",
                "0.04",
                "--set",
                damping,
                "--solver",
                solver,
                "--json",
            ];
            let output = limited(dir.path(), &arguments);
            let said = String::from_utf8_lossy(&output.stdout).into_owned();
            assert_eq!(output.status.code(), Some(0), "{arguments:?}: {:?}, {}", output.status, message(&output));
            assert!(!said.contains("NaN") && !said.contains("null") && !said.contains("inf"), "{arguments:?}: {said}");
        }
    }
}

#[test]
fn a_pipe_in_the_place_of_a_file_is_not_waited_for() {
    let dir = tempfile::tempdir().unwrap();
    if !Command::new("mkfifo").arg(dir.path().join("pipe")).status().is_ok_and(|status| status.success()) {
        println!("skipped: no mkfifo here");
        return;
    }
    for arguments in [
        &["replay", "pipe"][..],
        &["plot", "pipe", "a.svg"],
        &["export", "pipe", "--to", "csv", "out"],
        &["live", "pipe", "--once"],
        &["compare", "pipe"],
        &["velocity", "pipe"],
        &["diagnose", "pipe"],
        &["identify", "stator", "pipe"],
        &["model", "speed", "--motor", "./pipe"],
        &["neck", "--exercise", "./pipe"],
        &["track", "--port", "sim", "--control", "./pipe"],
    ] {
        let output = limited(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", message(&output));
    }
}

/// The container's own reader makes room for any length that stands in a record, 4 GB here.
#[test]
fn a_length_in_a_recording_that_cannot_be_makes_no_room() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let made = limited(dir.path(), &["track", "--port", "sim", "--seconds", "0.2", "--out", "a.mcap"]);
    assert!(made.status.success(), "{}", message(&made));
    let mut bytes = fs::read(&path).unwrap();
    let key = bytes.windows(4).position(|word| word == b"chip").expect("the metadata names the chip");
    bytes[key - 4..key].copy_from_slice(&[0xf0, 0xff, 0xff, 0xff]);
    fs::write(&path, bytes).unwrap();
    let output = limited(dir.path(), &["replay", "a.mcap"]);
    assert_eq!(output.status.code(), Some(2), "{:?}: {}", output.status, message(&output));
}
