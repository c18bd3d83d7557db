//! Whether a driver board follows short pulses: asked of simulated boards through the command itself.

use std::path::Path;
use std::process::{Command, Output};

fn twum(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_twum")).args(arguments).current_dir(folder).output().unwrap()
}

/// What the command says of a board with these effects: the shortest pulse in ticks, at half duty and every 20 ms, and whether every run
/// was made.
fn shortest_pulse(effects: &str) -> (u64, u64, bool) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("effects.toml"), effects).unwrap();
    let run = "experiment run --pulses --port sim --effects effects.toml --out pulses";
    let made = twum(folder.path(), &run.split(' ').collect::<Vec<_>>());
    let said = twum(folder.path(), &["experiment", "pulses", "pulses/measurement", "--json"]);
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    let said: serde_json::Value = serde_json::from_slice(&said.stdout).unwrap();
    let ticks = |key: &str| said[key].as_u64().unwrap();
    (ticks("shortest_pulse_ticks"), ticks("shortest_planned_ticks"), made.status.success())
}

/// Fails when the runs are not made at their own PWM frequency, or are not told apart by it.
#[test]
fn a_board_that_follows_half_a_millisecond_may_be_gated_every_tick() {
    assert_eq!(shortest_pulse(""), (1, 2, true));
}

/// A driver that needs 1.5 ms to start follows a quarter of 2 ms: the board's own judge ends the first run of shorter pulses.
#[test]
fn a_board_that_starts_late_may_not() {
    assert_eq!(shortest_pulse("[effects.start-delay]\ndelay_s = 0.0015\nrest_s = 0.0\n"), (20, 8, false));
}
