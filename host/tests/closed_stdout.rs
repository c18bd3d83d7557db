//! A reader that has seen enough ends a command quietly, whatever the command.

use std::process::{Command, Stdio};

#[test]
fn a_closed_reader_is_no_failure() {
    for arguments in [&["model", "sweep", "--points", "3"][..], &["model", "speed", "--json"], &["model", "torque"]] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_twum"))
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let ended = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(ended.status.success(), "{arguments:?}: {:?}, {said}", ended.status);
        assert!(!said.contains("panicked"), "{arguments:?}: {said}");
    }
}

#[test]
fn a_fault_beside_a_closed_reader_is_still_a_fault() {
    let arguments = ["track", "--port", "sim", "--step", "200", "--max-following-error", "20", "--seconds", "1"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_twum"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(3));
}

#[test]
fn other_failures_keep_their_code() {
    let code = |arguments: &[&str]| {
        let ended = Command::new(env!("CARGO_BIN_EXE_twum")).args(arguments).output().unwrap();
        (ended.status.code(), String::from_utf8_lossy(&ended.stderr).into_owned())
    };
    let (status, said) = code(&["model", "speed", "--set", "Ms=-1"]);
    assert!(status == Some(2) && said.contains("Ms"), "{status:?} {said}");
    let (status, said) = code(&["model", "speed", "--motor", "nowhere.toml"]);
    assert!(status == Some(2) && said.contains("nowhere.toml"), "{status:?} {said}");
}
