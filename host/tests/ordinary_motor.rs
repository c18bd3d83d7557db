//! An ordinary motor from its folder to what is done with the answer.

use std::path::Path;
use std::process::{Command, Output};

fn twum(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_twum")).args(arguments).current_dir(folder).output().expect("it runs")
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/gear-motor");

/// Fails if a number loses its interval, or the table does not lead from the lowest speed to the highest.
#[test]
fn a_motor_is_identified_and_its_inverse_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = ["identify", "motor", EXAMPLE, "--json", "--compensation", "ff.csv"];
    let output = twum(folder.path(), &json);
    assert!(output.status.success(), "{}", said(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("it is JSON");
    let names: Vec<&str> =
        report["parameters"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert!(["gain_rpm", "lag_s", "coulomb"].iter().all(|n| names.contains(n)), "{names:?}");
    // 0.12 of the largest torque, scaled by the size that the folder's generator drew.
    let csv = std::fs::read_to_string(folder.path().join("ff.csv")).expect("it was written");
    let rows: Vec<Vec<f64>> =
        csv.lines().skip(2).map(|l| l.split(',').map(|v| v.parse().expect("a number")).collect()).collect();
    assert!(rows.len() > 30 && rows.windows(2).all(|w| w[0][0] < w[1][0] && w[0][1] <= w[1][1]), "{csv}");
    // What is there is data: not overwritten without being asked.
    assert!(!twum(folder.path(), &json).status.success());
}

/// A run of one level each way leaves friction and a dead zone open: fails if the plan is the board's, or the board is driven.
#[test]
fn the_next_inputs_are_in_the_drives_own_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    let toml = "name = \"steps\"\nmotor = \"inertial\"\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\nformat = \"drive\"\n";
    std::fs::write(folder.path().join("measurement.toml"), toml).unwrap();
    let mut csv = String::from("time_us,input,speed_rpm\n");
    let mut speed = 0.0_f64;
    for k in 0..400_u32 {
        let input = [24.0, 0.0, -24.0, 0.0][(k / 100) as usize];
        csv += &format!("{},{input},{:.3}\n", k * 5000, speed + 0.5 * f64::from(k * 7919 % 101) / 50.0);
        let drive = if input == 0.0 { 0.0 } else { 900.0 * (input / 24.0 - 0.2 * f64::signum(input)) };
        speed += (drive - speed) * 0.1;
    }
    std::fs::write(folder.path().join("a.csv"), csv).unwrap();
    let output = twum(folder.path(), &["experiment", "plan", ".", "--json"]);
    assert!(output.status.success(), "{}", said(&output));
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).expect("it is JSON");
    let runs = plan.as_array().expect("a list");
    assert!(runs.iter().any(|r| r["id"] == "levels" && r["pieces"][1]["to"] == 24.0), "{plan}");
    let output = twum(folder.path(), &["experiment", "run", ".", "--port", "sim", "--out", "new"]);
    assert!(!output.status.success() && said(&output).contains("not driven by the board"), "{}", said(&output));
    assert!(!folder.path().join("new").exists());
}

/// Fails if a saved motor does not do what the answer said that it does: its error on the runs it was fitted to is the answer's, its speeds
/// are the table's, and what does not take it says so.
#[test]
fn a_saved_motor_repeats_the_runs_it_was_fitted_to() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = |arguments: &[&str]| -> serde_json::Value {
        let output = twum(folder.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", said(&output));
        serde_json::from_slice(&output.stdout).expect("it is JSON")
    };
    let answer = json(&["diagnose", EXAMPLE, "--json", "--save-model", "mine.toml"]);
    let compared =
        json(&["compare", EXAMPLE, "--motor", "mine.toml", "--json", "--plot", "mine.svg", "--report", "mine.html"]);
    let [held_out, again] =
        [&answer["extended"]["rmse_speed_rpm"], &compared["ordinary"]["rmse_speed_rpm"]].map(|v| v.as_f64().unwrap());
    // Runs scatter a little in their gain, and one that was fitted is met a little better than one that was not.
    assert!((again / held_out - 1.0).abs() < 0.1, "{again} rpm, {held_out} rpm held out");
    assert_eq!(compared["ordinary"]["runs"].as_array().map(Vec::len), Some(3));
    let too_far = twum(folder.path(), &["compare", EXAMPLE, "--motor", "mine.toml", "--max-rmse-rpm", "0.1"]);
    assert_eq!(too_far.status.code(), Some(1), "{}", said(&too_far));

    // The inverse's steady speeds, and the saved motor's own at the inputs that it gives.
    let report = json(&["identify", "motor", EXAMPLE, "--json"]);
    let table = report["compensation"]["table"].as_array().unwrap();
    let last = table.last().unwrap();
    let largest = report["largest_input"].as_f64().unwrap();
    let duty = (last[1].as_f64().unwrap() / largest).to_string();
    let steady = json(&["model", "speed", "--motor", "mine.toml", "--duty", &duty, "--json"]);
    let (speed, wanted) = (steady["speed_rpm"].as_f64().unwrap(), last[0].as_f64().unwrap());
    assert!((speed / wanted - 1.0).abs() < 1e-3, "{speed} rpm, {wanted} in the table");
    assert_eq!(
        json(&["model", "sweep", "--motor", "mine.toml", "--points", "5", "--json"]).as_array().map(Vec::len),
        Some(5)
    );

    let refused = |arguments: &[&str], word: &str| {
        let output = twum(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(said(&output).contains(word), "{arguments:?}: {}", said(&output));
    };
    refused(&["model", "torque", "--motor", "mine.toml"], "an ordinary motor");
    refused(&["compare", EXAMPLE], "--save-model");
    refused(&["compare", EXAMPLE, "--motor", "pcbmotor-30mm"], "pcbmotor-30mm");
    refused(&["model", "speed", "--motor", "mine.toml", "--set", "u=0.1"], "--set");
    let text = std::fs::read_to_string(folder.path().join("mine.toml")).unwrap();
    for (from, to, word) in [
        ("lag_s =", "log_lag =", "numbers.log_lag"),
        ("gain_rpm =", "# gain_rpm =", "gain_rpm is missing"),
        ("largest_input =", "largest_input = -1 #", "largest_input"),
        ("coulomb =", "coulomb = nan #", "numbers.coulomb"),
        ("lag_s =", "swing_s = 0.001\nlag_s =", "numbers.swing_s goes with one of"),
    ] {
        std::fs::write(folder.path().join("wrong.toml"), text.replace(from, to)).unwrap();
        refused(&["compare", EXAMPLE, "--motor", "wrong.toml"], word);
    }
}
