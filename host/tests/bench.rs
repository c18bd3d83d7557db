//! What a person does to a board around the runs, with the `twum` command on a real pseudo-terminal: its configuration, a
//! restart, a stop from another terminal, a flash.

mod simulator;

use simulator::{Simulator, text};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use twum_host::record::store::{Entry, Reader};

#[test]
fn the_configuration_is_dumped_loaded_compared_and_outlives_a_restart() {
    let simulator = Simulator::start();
    let none = simulator.run(&["config", "show"]);
    assert!(!none.status.success() && text(&none).contains("no configuration yet"), "{}", text(&none));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bench.toml");
    let path = file.to_str().unwrap();
    std::fs::write(&file, "control = \"thesis\"\ncount_sign = \"reversed\"\n[limits]\nposition_max = 400\n").unwrap();
    simulator.say(&["config", "load", path]);
    let dumped = simulator.say(&["config", "dump"]);
    assert!(dumped.contains("count_sign = \"reversed\"") && dumped.contains("position_max = 400"), "{dumped}");

    // `dump | load`: the same again, bit for bit.
    let mut load = simulator.twum(&["config", "load"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    load.stdin.take().unwrap().write_all(dumped.as_bytes()).unwrap();
    let load = load.wait_with_output().unwrap();
    assert!(load.status.success() && text(&load).contains("0 changed"), "{}", text(&load));
    assert_eq!(simulator.say(&["config", "dump"]), dumped);

    assert!(simulator.say(&["reboot"]).contains("Software"));
    assert_eq!(simulator.say(&["config", "dump"]), dumped, "a restart keeps it");

    std::fs::write(&file, "pwm_hz = 100\n").unwrap();
    let diff = simulator.run(&["config", "diff", path]);
    assert_eq!(diff.status.code(), Some(1), "{}", text(&diff));
    assert_eq!(text(&diff), "pwm_hz: 50 on the board, 100 in the file\n");
    for (wrong, named) in [
        ("pwm = 3", "`pwm` is unknown"),
        ("\u{0}garbage", "TOML parse error"),
        ("", "is empty"),
        ("[limits]\nstall_ms = 0", "stall_ms"),
    ] {
        std::fs::write(&file, wrong).unwrap();
        let load = simulator.run(&["config", "load", path]);
        assert_eq!(load.status.code(), Some(2), "{wrong:?}: {}", text(&load));
        assert!(text(&load).contains(named) && text(&load).contains("bench.toml"), "{wrong:?}: {}", text(&load));
    }
    assert_eq!(simulator.say(&["config", "dump"]), dumped, "a wrong file changes nothing");

    // A run's own limits are that run's.
    let limited = folder.path().join("limited.mcap");
    let out = limited.to_str().unwrap();
    simulator.say(&[
        "speed",
        "--duty",
        "0.3",
        "--seconds",
        "0.3",
        "--count-sign",
        "positive",
        "--stall",
        "900",
        "--out",
        out,
    ]);
    assert_eq!(simulator.say(&["config", "dump"]), dumped, "the board has its own again");
    let recording = twum_host::record::recording::Recording::load(&limited).unwrap();
    assert_eq!(recording.runs[0].configuration.unwrap().limits.stall_ms, 900, "the recording holds what was in force");
}

#[test]
fn a_run_is_stopped_from_another_terminal_and_its_recording_closed() {
    let simulator = Simulator::start();
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("stopped.mcap");
    let child = simulator.tracking(&recording);
    // Who connects and says nothing is heard out for 200 ms: one after the other, these would hold up a stop for 4 s.
    let silent: Vec<UnixStream> = (0..20).map(|_| UnixStream::connect(simulator.socket()).unwrap()).collect();
    let asked = Instant::now();
    assert!(simulator.say(&["stop"]).contains("the board acknowledged it"));
    let took = asked.elapsed();
    assert!(took < Duration::from_secs(2), "{took:?}");
    drop(silent);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{}", text(&output));
    let mut reader = Reader::open(&recording).unwrap();
    let mut remarks = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        if let Entry::Remark { json, .. } = entry {
            remarks.push(json.to_owned());
        }
    }
    assert!(remarks.iter().any(|remark| remark.contains("cut short")), "{remarks:?}");
    assert!(!simulator.socket().exists(), "nothing is left behind");
    assert!(simulator.say(&["info"]).contains("Idle"));
}

#[test]
fn a_socket_left_behind_is_taken_over_and_a_strangers_is_not_trusted() {
    let simulator = Simulator::start();
    let folder = tempfile::tempdir().unwrap();
    let mut child = simulator.tracking(&folder.path().join("killed.mcap"));
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(simulator.socket().exists(), "a killed program leaves its socket");
    assert!(simulator.say(&["stop"]).contains("stopped"), "the port is free, so it is used");
    let again = folder.path().join("again.mcap");
    let child = simulator.tracking(&again);
    assert!(simulator.say(&["stop"]).contains("the board acknowledged it"));
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(4));

    // Somebody else's socket, while something that is no twum holds the port.
    let _held = serialport::new(&simulator.port, 921_600).open().unwrap();
    let listener = std::os::unix::net::UnixListener::bind(simulator.socket()).unwrap();
    if std::os::unix::fs::chown(simulator.socket(), Some(4_242), None).is_ok() {
        let stop = simulator.run(&["stop"]);
        assert!(!stop.status.success() && text(&stop).contains("another user"), "{}", text(&stop));
    } else {
        println!("skipped: only root can give a file away");
    }
    drop(listener);
    std::fs::remove_file(simulator.socket()).unwrap();
    std::fs::set_permissions(simulator.runtime.path().join("twum"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let stop = simulator.run(&["stop"]);
    assert!(!stop.status.success() && text(&stop).contains("open to others"), "{}", text(&stop));
}

/// A stand-in for `espflash` that finds an ESP32-C6 and writes nothing.
fn pretended_espflash(folder: &Path) -> PathBuf {
    let bin = folder.join("bin");
    std::fs::DirBuilder::new().mode(0o755).create(&bin).unwrap();
    let script =
        "#!/bin/sh\n[ \"$1\" = board-info ] && echo 'Chip type:         esp32c6 (revision v0.1)' && exit 0\nexit 1\n";
    std::fs::write(bin.join("espflash"), script).unwrap();
    std::fs::set_permissions(bin.join("espflash"), std::fs::Permissions::from_mode(0o755)).unwrap();
    bin
}

#[test]
fn flashing_refuses_what_it_cannot_do_before_it_writes() {
    let flash = |arguments: &[&str], path: Option<&Path>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_twum"));
        command.arg("flash").args(arguments).env_remove("TWUM_PORT").env_remove("TWUM_IMAGES");
        if let Some(path) = path {
            command.env("PATH", path);
        }
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output));
        text(&output)
    };
    assert!(flash(&[], None).contains("--port"));
    assert!(flash(&["--port", "sim"], None).contains("simulated"));
    assert!(flash(&["--port", "/dev/no-such-port"], None).contains("twum ports"));
    let simulator = Simulator::start();
    assert!(flash(&["--port", &simulator.port], None).contains("simulated"));

    let folder = tempfile::tempdir().unwrap();
    // As good as a port until something is written to it.
    let port = folder.path().join("port");
    std::fs::write(&port, "").unwrap();
    let (port, images) = (port.to_str().unwrap(), folder.path().to_str().unwrap());
    let said = flash(&["--port", port, "--images", images, "--chip", "esp32c3"], None);
    assert!(said.contains("no image") && said.contains("firmware/check esp32c3"), "{said}");
    assert!(flash(&["--port", port, "--images", images], Some(folder.path())).contains("cargo install espflash"));

    let bin = pretended_espflash(folder.path());
    let path = PathBuf::from(format!("{}:/bin:/usr/bin", bin.display()));
    assert!(flash(&["--port", port, "--images", images], Some(&path)).contains("-esp32c6.bin"));
    std::fs::write(folder.path().join(format!("twum-{}-esp32c3.bin", env!("CARGO_PKG_VERSION"))), "image").unwrap();
    let wrong = flash(&["--port", port, "--images", images, "--chip", "esp32c3"], Some(&path));
    assert!(wrong.contains("is an esp32c6, not an esp32c3; nothing was written"), "{wrong}");
    std::fs::write(folder.path().join(format!("twum-{}-esp32c6.bin", env!("CARGO_PKG_VERSION"))), "image").unwrap();
    assert!(flash(&["--port", port, "--images", images], Some(&path)).contains("espflash failed"));
}
