//! The `twum` command against a simulated board on a real pseudo-terminal, in real time.

mod simulator;

use simulator::{Simulator, text};
use std::path::Path;
use std::process::{Command, Output};

/// The `twum` of this build.
fn twum() -> Command {
    Command::new(env!("CARGO_BIN_EXE_twum"))
}

fn track(simulator: &Simulator, recording: &Path) -> Output {
    simulator.run(&["track", "--control", "thesis", "--seconds", "4", "--out", recording.to_str().unwrap()])
}

#[test]
fn a_tracked_run_through_the_serial_port_loses_nothing_and_replays_bit_for_bit() {
    let simulator = Simulator::start();
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("sine.mcap");
    let output = track(&simulator, &recording);
    assert!(output.status.success(), "{}", text(&output));
    assert!(text(&output).contains(" 0 lost, 0 bad"), "{}", text(&output));
    let replay = twum().args(["replay", recording.to_str().unwrap()]).output().unwrap();
    assert!(replay.status.success(), "{}", text(&replay));

    let before = std::fs::read(&recording).unwrap();
    let again = track(&simulator, &recording);
    assert_eq!(again.status.code(), Some(2), "{}", text(&again));
    assert!(text(&again).contains("never overwritten"), "{}", text(&again));
    assert_eq!(std::fs::read(&recording).unwrap(), before, "nothing is overwritten");

    // The board stays aligned between commands, and its port can be opened again.
    let speed = simulator.run(&["speed", "--duty", "0.5", "--direction", "ccw", "--seconds", "0.5"]);
    assert!(speed.status.success(), "{}", text(&speed));
    let info = simulator.run(&["info", "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!((info["mode"].as_str(), &info["fault"]), (Some("Idle"), &serde_json::Value::Null));
}

#[test]
fn a_port_that_is_busy_wrong_or_silent_is_named_with_what_to_do() {
    let missing = twum().args(["info", "--port", "/dev/no-such-port"]).output().unwrap();
    assert_eq!(missing.status.code(), Some(2));
    assert!(text(&missing).contains("twum ports"), "{}", text(&missing));

    let simulator = Simulator::start();
    let held = serialport::new(&simulator.port, 921_600).open().unwrap();
    let busy = simulator.run(&["info"]);
    assert_eq!(busy.status.code(), Some(2));
    assert!(text(&busy).contains("in use"), "{}", text(&busy));
    drop(held);

    // A pseudo-terminal on which nobody answers.
    use serialport::SerialPort as _;
    let (_master, mut slave) = serialport::TTYPort::pair().unwrap();
    slave.set_exclusive(false).unwrap();
    let name = slave.name().unwrap();
    let _kept = std::fs::File::options().read(true).write(true).open(&name).unwrap();
    drop(slave);
    let silent = twum().args(["info", "--port", &name]).output().unwrap();
    assert_eq!(silent.status.code(), Some(2));
    assert!(text(&silent).contains("no answer"), "{}", text(&silent));
}

#[test]
fn arguments_out_of_range_are_refused_before_anything_moves() {
    for (arguments, expected) in [
        (vec!["speed", "--port", "sim", "--duty", "1.5"], "outside 0 to 1"),
        (vec!["speed", "--port", "sim", "--duty", "nan"], "outside 0 to 1"),
        (vec!["speed", "--port", "sim", "--duty", "0.5", "--seconds", "0"], "outside 0.001"),
        (vec!["speed", "--port", "sim", "--duty", "0.5", "--control", "/no/such/gains.toml"], "gains.toml"),
        (vec!["track", "--port", "sim", "--sine", "89"], "AMPLITUDE,OMEGA"),
        (vec!["track", "--port", "sim", "--path", "5:0"], "no time"),
        (vec!["driver", "--port", "sim", "fly"], "not a line of driver commands"),
        (vec!["replay", "/no/such/recording.mcap"], "recording.mcap"),
    ] {
        let output = twum().args(&arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output));
        assert!(text(&output).contains(expected), "{arguments:?}: {}", text(&output));
    }
}

#[test]
fn gains_that_cannot_be_represented_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let gains = folder.path().join("gains.toml");
    std::fs::write(
        &gains,
        "kp = 1e12\nki = 0.0\nkd = 0.0\nperiod_us = 500\nduty_steps = 32\nintegral_min = 0\nintegral_max = 31\n",
    )
    .unwrap();
    let output = twum().args(["track", "--port", "sim", "--control", gains.to_str().unwrap()]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output).contains("kp = 1000000000000 cannot be represented"), "{}", text(&output));
}
