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
