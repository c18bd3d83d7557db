//! A stator's sweep is seen while it is made.

use super::served::Served;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};

/// A process, ended with the test.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Fails when the plots come at the end only, or do not show the resonance that the simulated stator has.
#[test]
fn nyquist_and_bode_are_shown_while_a_stator_is_swept() {
    let served = Served::sim();
    let mut simulated = served
        .twum(&["instruments", "simulate", "--generator-port", "0", "--scope-port", "0", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(simulated.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let _simulated = Ended(simulated);
    let bench: Value = serde_json::from_str(&line).unwrap();
    let file = served.runs().join("stator.csv");
    let sweep = served
        .twum(&["instruments", "sweep", file.to_str().unwrap(), "--from", "42000", "--to", "46000", "--step", "40"])
        .args(["--generator", bench["generator"].as_str().unwrap(), "--scope", bench["scope"].as_str().unwrap()])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut sweep = Ended(sweep);
    let asked = "/api/sweep?run=stator.csv&shunt_ohm=2000";
    let mut seen = Vec::new();
    let last = loop {
        let is_over = sweep.0.try_wait().unwrap();
        // The file may not be there yet.
        let (status, found) = served.get(asked);
        if status == 200 && !is_over.is_some_and(|status| status.success()) {
            seen.push(found["taken"].as_u64().unwrap());
        }
        if let Some(status) = is_over {
            assert!(status.success(), "{status}");
            break found;
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    };
    seen.dedup();
    println!("points while it swept: {seen:?}");
    assert!(seen.iter().filter(|taken| (1..101).contains(*taken)).count() > 3, "{seen:?}");
    assert_eq!((&last["taken"], &last["planned"], &last["unreadable"]), (&101.into(), &101.into(), &0.into()));
    let panels = last["figure"]["panels"].as_array().unwrap();
    let labels: Vec<&str> = panels.iter().map(|panel| panel["y_label"].as_str().unwrap()).collect();
    assert_eq!(labels, ["susceptance B (mS)", "|Y| (mS)", "phase (deg)"]);
    // The conductance is greatest at 1/(2π√(LC)) of what is simulated, 44 133 Hz; its Q is 32.
    let x = |panel: usize| panels[panel]["series"][0]["x"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap());
    let (_, most_khz) = x(0).zip(x(1)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    assert!((most_khz - 44.13).abs() < 0.25, "{most_khz} kHz");
    assert_eq!(served.get("/api/sweep?run=stator.csv&shunt_ohm=0").0, 400);
    assert_eq!(served.get("/api/sweep?run=..%2fstator.csv&shunt_ohm=2000").0, 400);
}
