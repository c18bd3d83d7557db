//! The motor on the bench is kept in the recording whole: the file it was read from may change or go.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn twum(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_twum")).args(arguments).current_dir(folder).output().unwrap()
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// The shipped motor with another force factor: it turns at another speed.
fn slower_motor() -> String {
    let shipped = include_str!("../crates/motor/motors/pcbmotor-30mm.toml");
    let at = shipped.find("\n[physical.eta]").expect("the file has eta");
    let value = at + shipped[at..].find("value = ").expect("it has a value") + "value = ".len();
    let end = value + shipped[value..].find([',', '\n', ' ', '}']).unwrap();
    format!("{}{}{}", &shipped[..value], 0.05, &shipped[end..])
}

#[test]
fn compare_and_export_use_the_motor_that_was_on_the_bench() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("mine.toml"), slower_motor()).unwrap();
    let run =
        ["speed", "--port", "sim", "--duty", "1", "--seconds", "1", "--motor", "./mine.toml", "--out", "run.mcap"];
    let made = twum(folder, &run);
    assert!(made.status.success(), "{}", text(&made));
    let simulated = |arguments: &[&str]| -> f64 {
        let found = twum(folder, arguments);
        assert!(found.status.success(), "{arguments:?}: {}", text(&found));
        let found: serde_json::Value = serde_json::from_slice(&found.stdout).unwrap();
        found["simulation"]["runs"][0]["simulated"]["settled_rpm"].as_f64().unwrap()
    };
    let mine = simulated(&["compare", "run.mcap", "--json", "--motor", "./mine.toml"]);
    let shipped = simulated(&["compare", "run.mcap", "--json", "--motor", "pcbmotor-30mm"]);
    assert!((mine - shipped).abs() > 1.0, "{mine} and {shipped} rpm: the motors do not differ");
    fs::remove_file(folder.join("mine.toml")).unwrap();
    assert_eq!(simulated(&["compare", "run.mcap", "--json"]), mine);
    let exported = twum(folder, &["export", "run.mcap", "--to", "folder", "bench"]);
    assert!(exported.status.success(), "{}", text(&exported));
    assert_eq!(fs::read_to_string(folder.join("bench/motor.toml")).unwrap().trim_end(), slower_motor().trim_end());
    assert_eq!(simulated(&["compare", "bench", "--json"]), mine);
    // As it was asked for, from what is not there any more.
    let again = twum(folder, &[&run[..9], &["--out", "again.mcap"]].concat());
    assert_eq!(again.status.code(), Some(2));
    assert!(text(&again).contains("mine.toml") && !folder.join("again.mcap").exists(), "{}", text(&again));
}
