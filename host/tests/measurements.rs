//! `twum velocity` and `twum compare` from the command line, on measurements whose answer is known without them.

use serde_json::Value;
use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Output};

const EDGES_PER_REV: f64 = 400.0;

fn twum(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_twum")).current_dir(folder).args(args).output().unwrap()
}

fn json(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text} {}", String::from_utf8_lossy(&output.stderr)))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn write(folder: &Path, runs: &str, files: &[(&str, String)]) {
    let manifest = format!("name = \"known\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n{runs}");
    std::fs::write(folder.join("measurement.toml"), manifest).unwrap();
    for (name, text) in files {
        std::fs::write(folder.join(name), text).unwrap();
    }
}

/// The cells of the table rows in the page that a command writes to `page.html`.
fn rendered(folder: &Path, args: &[&str]) -> Vec<Vec<String>> {
    let output = twum(folder, args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let html = std::fs::read_to_string(folder.join("page.html")).unwrap();
    let cells = |row: &str| -> Vec<String> {
        row.split("<td")
            .skip(1)
            .map(|cell| cell[cell.find('>').unwrap() + 1..cell.find("</td>").unwrap()].to_owned())
            .collect()
    };
    html.split("<tr>").skip(1).map(cells).filter(|cells| !cells.is_empty()).collect()
}

/// Rows of a `levels` file: the line sampled at 1 kHz while the rotor, at rest until 20 ms, turns by `rpm(time, angle)`.
fn levels(length_s: f64, rpm: impl Fn(f64, f64) -> f64) -> String {
    const STEP_S: f64 = 1e-5;
    let (mut text, mut turns) = ("time_us,level\n".to_owned(), 0.25 / EDGES_PER_REV);
    for step in 0..(length_s / STEP_S).round() as usize {
        if step % 100 == 0 {
            let level = (turns * EDGES_PER_REV) as u64 % 2;
            writeln!(text, "{},{level}", step * 10).unwrap();
        }
        let time_s = step as f64 * STEP_S;
        turns += rpm(time_s, turns * std::f64::consts::TAU) / 60.0 * STEP_S;
    }
    text
}

fn speed_run(id: &str, duty: f64) -> String {
    format!(
        "[[run]]\nid = \"{id}\"\nkind = \"speed\"\nfile = \"{id}.csv\"\nformat = \"levels\"\nduty = {duty}\n\
         direction = \"ccw\"\ndrive_on_s = 4.0\n"
    )
}

#[test]
fn velocity_finds_mean_drift_and_ripple() {
    let dir = tempfile::tempdir().unwrap();
    let ripple = |t: f64, angle: f64| 36.0 - 0.8 * t + 4.0 * (2.0 * angle).cos();
    write(
        dir.path(),
        &[speed_run("ripple", 1.0), speed_run("steady", 0.75)].concat(),
        &[("ripple.csv", levels(4.0, ripple)), ("steady.csv", levels(4.0, |_, _| 30.9))],
    );
    let output = twum(dir.path(), &["velocity", ".", "--json"]);
    assert!(output.status.success());
    let found = json(&output);
    let (ripple, steady) = (&found[0], &found[1]);
    // ccw is negative; a turn takes 60 / sqrt(36^2 - 4^2) s, and 36 rpm fall to 32.8 rpm.
    assert!((number(&ripple["drift_rpm_per_s"]) - 0.8).abs() < 0.03, "{ripple}");
    assert!((number(&ripple["ripple_rpm"][1]) - 4.0).abs() < 0.1, "{ripple}");
    assert!(number(&ripple["ripple_rpm"][0]) < 0.1 && number(&ripple["ripple_r2"]) > 0.99, "{ripple}");
    // Settled from 0.2 s on, 34.32 rpm in the middle; the 2.15 turns leave a part of the ripple in the mean.
    let mean_rpm = ((34.32_f64).powi(2) - 16.0).sqrt();
    assert!((number(&ripple["mean_rpm"]) + mean_rpm).abs() < 0.25, "{ripple}");
    assert!((number(&steady["mean_rpm"]) + 30.9).abs() < 0.03, "{steady}");
    assert!((number(&steady["duration_s"]) - 3.999).abs() < 1e-9, "{steady}");
    // 30.9 rpm over 4 s at 400 edges a turn.
    assert!((number(&steady["edges"]) - 824.0).abs() <= 1.0, "{steady}");

    let table = twum(dir.path(), &["velocity", "measurement.toml", "--run", "steady"]);
    let text = String::from_utf8(table.stdout).unwrap();
    assert!(text.lines().nth(1).unwrap().contains("-30.9") && !text.contains("ripple "), "{text}");

    let csv = twum(dir.path(), &["velocity", ".", "--run", "steady", "--csv", "-"]);
    let text = String::from_utf8(csv.stdout).unwrap();
    let row: Vec<f64> = text.lines().nth(2001).unwrap().split(',').skip(1).map(|v| v.parse().unwrap()).collect();
    assert!((row[0] - 2e6).abs() < 1e-6 && (row[2] + 30.9).abs() < 0.05 && row[3] < 0.1, "{row:?}");

    let missing = twum(dir.path(), &["velocity", ".", "--run", "other"]);
    assert_eq!(missing.status.code(), Some(2));
    assert!(String::from_utf8(missing.stderr).unwrap().contains("no run other; it has: ripple, steady"));
}

/// What one command says of a run, every other says of it: no figure has two values.
#[test]
fn commands_agree_on_the_figures_of_a_run() {
    let dir = tempfile::tempdir().unwrap();
    // Rises within 20 ms, 35.05 rpm until the drive ends at 2 s, brakes for 50 ms, stands for another second.
    let rpm = |t: f64, _: f64| match t {
        t if t < 0.02 => 0.0,
        t if t < 2.0 => 35.05 * (1.0 - (-(t - 0.02) / 0.015).exp()),
        t if t < 2.05 => 35.05 * (1.0 - (t - 2.0) / 0.05),
        _ => 0.0,
    };
    let run = speed_run("run", 1.0).replace("drive_on_s = 4.0", "drive_on_s = 2.0");
    write(dir.path(), &run, &[("run.csv", levels(3.0, rpm))]);
    let velocity = json(&twum(dir.path(), &["velocity", ".", "--json", "--run", "run", "--plot", "v.svg"]))[0].clone();
    assert!((number(&velocity["mean_rpm"]) + 35.05).abs() < 0.01, "{velocity}");
    assert!(
        number(&velocity["drift_rpm_per_s"]).abs() < 0.05 && number(&velocity["ripple_rpm"][0]) < 0.1,
        "{velocity}"
    );
    assert!((number(&velocity["stop_s"]) - 0.0475).abs() < 0.02, "{velocity}");
    assert!((number(&velocity["coast_deg"]) - 0.5 * 35.05 * 6.0 * 0.05).abs() < 1.0, "{velocity}");

    let compare = json(&twum(dir.path(), &["compare", ".", "--json", "--plot", "c.svg", "--report", "c.html"]));
    let measured = &compare["simulation"]["runs"][0]["measured"];
    // The direction is ccw, which velocity signs and compare takes as forwards.
    for key in ["mean_rpm", "start_peak_rpm"] {
        assert_eq!(number(&velocity[key]), -number(&measured[key]), "{key}");
    }
    for key in ["rise_s", "stop_s", "overshoot", "coast_deg"] {
        assert_eq!(velocity[key], measured[key], "{key}");
    }
    assert_eq!(measured["settled_rpm"], measured["mean_rpm"]);

    let shown = |decimals: usize| format!("{:.decimals$}", -number(&velocity["mean_rpm"]));
    let text = |args: &[&str]| String::from_utf8(twum(dir.path(), args).stdout).unwrap();
    assert!(text(&["velocity", "."]).contains(&format!("-{}", shown(3))));
    assert!(text(&["compare", "."]).contains(&shown(3)));
    let file = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap();
    assert!(file("v.svg").contains(&format!("mean \u{2212}{} rpm settled", shown(2))));
    assert!(file("c.svg").contains(&format!("mean \u{2212}{} rpm settled", shown(2))));
    assert!(file("c.html").contains(&shown(3)));
}

/// Frames, ticks, edges and lengths: whoever counts them, counts as many.
#[test]
fn commands_agree_on_what_a_recording_holds() {
    let dir = tempfile::tempdir().unwrap();
    let said = |args: &[&str]| {
        let output = twum(dir.path(), &[args, &["--json"]].concat());
        // Replay ends with 1 where there is no tick to check, as in a run of constant duty.
        let best = i32::from(args == ["replay", "speed.mcap"]);
        assert_eq!(output.status.code(), Some(best), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        json(&output)
    };
    let speed = said(&["speed", "--port", "sim", "--duty", "0.7", "--seconds", "2", "--out", "speed.mcap"]);
    let track = said(&["track", "--port", "sim", "--seconds", "2", "--out", "track.mcap"]);
    for (name, made) in [("speed", &speed), ("track", &track)] {
        let recording = format!("{name}.mcap");
        let (replay, live) = (said(&["replay", &recording]), said(&["live", &recording, "--once"]));
        assert_eq!(made["link"]["received"], replay["link"]["device_frames"], "{name}");
        assert_eq!(made["link"]["lost"], replay["link"]["missing_sequences"], "{name}");
        assert_eq!(made["recorded_frames"], replay["file"]["frames"], "{name}");
        assert_eq!(live["link"], replay["link"], "{name}");
        let exported = said(&["export", &recording, "--to", "folder", name]);
        assert_eq!(exported["losses"], Value::Array(Vec::new()), "{name}");
    }
    let imported = |name: &str| said(&["import", name])["runs"][0].clone();
    let loop_ticks =
        [&track["motor"]["ticks"], &said(&["replay", "track.mcap"])["checked"], &imported("track")["samples"]]
            .map(Value::clone);
    assert!(loop_ticks.iter().all(|ticks| *ticks == loop_ticks[0] && ticks.is_u64()), "{loop_ticks:?}");
    let (velocity, folder) = (said(&["velocity", "speed.mcap"])[0].clone(), imported("speed"));
    for key in ["edges", "duration_s", "id", "duty"] {
        assert_eq!(speed["motor"][key], velocity[key], "{key}");
        // A folder's numbers are text.
        match (velocity[key].as_f64(), folder[key].as_f64()) {
            (Some(a), Some(b)) => assert!((a - b).abs() < 1e-9, "{key}: {a} in the recording, {b} in the folder"),
            _ => assert_eq!(velocity[key], folder[key], "{key}"),
        }
    }
}

#[test]
fn compare_tells_by_how_much_the_simulation_is_off() {
    let dir = tempfile::tempdir().unwrap();
    let duties = [0.5, 0.75, 1.0];
    let ids = ["half", "most", "full"];
    let runs: String = ids.iter().zip(duties).map(|(id, duty)| speed_run(id, duty)).collect();
    let files: Vec<(String, String)> =
        ids.iter().zip(duties).map(|(id, duty)| (format!("{id}.csv"), levels(3.0, |_, _| 50.0 * duty))).collect();
    let files: Vec<(&str, String)> = files.iter().map(|(name, text)| (name.as_str(), text.clone())).collect();
    write(dir.path(), &runs, &files);
    let output = twum(dir.path(), &["compare", ".", "--json", "--plot", "compare.svg"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found = &json(&output)["simulation"];
    let runs = found["runs"].as_array().unwrap();
    let mut squares = 0.0;
    for (run, duty) in runs.iter().zip(duties) {
        assert!((number(&run["measured"]["settled_rpm"]) - 50.0 * duty).abs() < 0.05, "{run}");
        let off = 50.0 * duty - number(&run["simulated"]["settled_rpm"]);
        // The motion is steady, so the error of the speed is that of its mean, pulses and start of the simulation aside.
        assert!(number(&run["rmse_speed_rpm"]) > off.abs() - 0.1, "{run}: {off}");
        squares += number(&run["rmse_speed_rpm"]).powi(2) / 3.0;
    }
    assert!((number(&found["rmse_speed_rpm"]) - squares.sqrt()).abs() < 1e-9, "{found}");
    // R² from the means themselves: 1 - sum (m - s)^2 / sum (m - mean)^2.
    let of = |side: &str| -> Vec<f64> { runs.iter().map(|run| number(&run[side]["mean_rpm"])).collect() };
    let (measured, simulated) = (of("measured"), of("simulated"));
    let mean = measured.iter().sum::<f64>() / 3.0;
    let sum = |other: &dyn Fn(usize) -> f64| (0..3).map(|i| (measured[i] - other(i)).powi(2)).sum::<f64>();
    let r2 = 1.0 - sum(&|i| simulated[i]) / sum(&|_| mean);
    assert!((number(&found["r2_speed"]) - r2).abs() < 1e-9, "{found} {r2}");
    let svg = std::fs::read_to_string(dir.path().join("compare.svg")).unwrap();
    assert!(svg.contains(&format!("Speed against duty (R\u{b2} {r2:.3})")));

    let page = rendered(dir.path(), &["compare", ".", "--report", "page.html"]);
    let shown = |v: &Value, decimals: usize| format!("{:.decimals$}", number(v)).replace('-', "\u{2212}");
    for (run, cells) in runs.iter().zip(&page) {
        assert_eq!(cells[0], run["id"].as_str().unwrap());
        let (m, s) = (&run["measured"], &run["simulated"]);
        let expected = [
            shown(&run["duty"], 3),
            shown(&run["rmse_speed_rpm"], 3),
            shown(&run["rmse_position_deg"], 2),
            shown(&m["mean_rpm"], 3),
            shown(&s["mean_rpm"], 3),
            shown(&m["start_peak_rpm"], 2),
            shown(&s["start_peak_rpm"], 2),
            format!("{:.0}", 1e3 * number(&m["rise_s"])),
            format!("{:.0}", 1e3 * number(&s["rise_s"])),
        ];
        assert_eq!(cells[1..10], expected, "{run}");
    }
    let html = std::fs::read_to_string(dir.path().join("page.html")).unwrap();
    assert!(html.contains(&format!("R\u{b2} of speed against duty: {}.", shown(&found["r2_speed"], 4))));
    assert!(html.contains(&format!("RMSE of the speed {} rpm", shown(&found["rmse_speed_rpm"], 3))));
    // Everything is in the page: it works without a network.
    assert!(html.contains("uPlot") && !html.contains("src=") && !html.contains("<link"));

    let strict = twum(dir.path(), &["compare", ".", "--max-rmse-rpm", "0.01"]);
    assert_eq!(strict.status.code(), Some(1));
}

/// The thesis's controller in doubles over a rotor of 350 counts/s: what a lab's own board may have written down.
fn track(kp: f64) -> String {
    const PERIOD_S: f64 = 500e-6;
    let (mut position, mut previous, mut integral) = (0.0_f64, 0.0, 0.0_f64);
    let mut text = "time_us,target,position,u,duty,direction\n".to_owned();
    for tick in 0..8000 {
        let target = (89.0 * (1.257 * f64::from(tick) * PERIOD_S).sin()).trunc();
        let error = target - position.trunc();
        integral = (integral + error * PERIOD_S).clamp(0.0, 31.0);
        let u = kp * error + 0.0015 * integral + 0.00004 * (error - previous) / PERIOD_S;
        previous = error;
        let on = 32.0 - (31.0 - u.abs()).max(0.0).trunc();
        let direction = if u > 0.0 { 1.0 } else { -1.0 };
        writeln!(text, "{},{target},{},{u},{},{direction}", tick * 500, position.trunc(), on / 32.0).unwrap();
        position += direction * (on - 1.0) / 31.0 * 350.0 * PERIOD_S;
    }
    text
}

#[test]
fn compare_takes_a_closed_loop_apart() {
    let dir = tempfile::tempdir().unwrap();
    let run =
        "[[run]]\nid = \"sine\"\nkind = \"track\"\nfile = \"sine.csv\"\nformat = \"control\"\ncontrol = \"thesis\"\n";
    write(dir.path(), run, &[("sine.csv", track(1.3))]);
    let output = twum(dir.path(), &["compare", ".", "--json", "--plot", "sine.png"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found = json(&output)["closed_loops"][0].clone();
    assert_eq!(
        (found["controller"]["ticks"].as_u64(), found["controller"]["mismatched"].as_u64()),
        (Some(8000), Some(0))
    );
    assert_eq!(number(&found["actuator"]["duty_rms"]), 0.0);
    assert_eq!(number(&found["actuator"]["wrong_direction"]), 0.0);
    assert_eq!(number(&found["sensor"]["largest_jump"]), 1.0);
    // This rotor turns at once and in proportion to the duty, which no piezo motor does.
    assert!(number(&found["plant"]["rms_rpm"]) > 1.0 && found["plant"]["gain"].is_number(), "{found}");
    assert!(dir.path().join("sine.png").exists());

    let page = rendered(dir.path(), &["compare", ".", "--report", "page.html"]);
    let plant = &found["plant"];
    let shown = |v: &Value, decimals: usize| format!("{:.decimals$}", number(v)).replace('-', "\u{2212}");
    assert_eq!(page[0][..6], ["sine", "8000", "0", "0.0000", "0.00000", "0.00"].map(str::to_owned));
    assert_eq!(page[0][6..9], [shown(&plant["gain"], 3), shown(&plant["explained"], 3), shown(&plant["rms_rpm"], 2)]);

    write(dir.path(), run, &[("sine.csv", track(1.5))]);
    let output = twum(dir.path(), &["compare", "."]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("likely: other gains: kp = 1.500"), "{text}");
}

#[test]
fn both_read_recordings() {
    let dir = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        let output = twum(dir.path(), args);
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        output
    };
    run(&["speed", "--port", "sim", "--duty", "1", "--seconds", "2", "--out", "speed.mcap"]);
    run(&["export", "speed.mcap", "--to", "folder", "exported"]);
    let direct = json(&run(&["velocity", "speed.mcap", "--json"]));
    let exported = json(&run(&["velocity", "exported", "--json"]));
    let mean = number(&direct[0]["mean_rpm"]);
    assert!(mean.abs() > 10.0 && (mean - number(&exported[0]["mean_rpm"])).abs() < 1e-6, "{direct} {exported}");
    assert_eq!(direct[0]["edges"], exported[0]["edges"]);

    run(&["track", "--port", "sim", "--control", "thesis", "--seconds", "4", "--out", "track.mcap"]);
    let found = json(&run(&["compare", "track.mcap", "--json"]))["closed_loops"][0].clone();
    assert_eq!(found["controller"]["mismatched"].as_u64(), Some(0), "{found}");
    assert_eq!(number(&found["actuator"]["duty_rms"]), 0.0, "{found}");
    // The simulated board's motor is the one that is replayed.
    assert!((0.95..1.05).contains(&number(&found["plant"]["gain"])), "{found}");
    assert_eq!(number(&found["sensor"]["largest_jump"]), 1.0, "{found}");
}

/// Fails if a recording cannot be diagnosed, if its answer is not kept or outlives what was recorded, if a model that cannot be saved costs the
/// answer, or if the folder above a measurement is not seen through.
#[test]
fn diagnose_reads_recordings_and_keeps_the_answer() {
    let dir = tempfile::tempdir().unwrap();
    let diagnose = |args: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_twum"))
            .current_dir(dir.path())
            .env("XDG_CACHE_HOME", dir.path().join("cache"))
            .arg("diagnose")
            .args(args)
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let record = |duty: &str| {
        let _ = std::fs::remove_file(dir.path().join("run.mcap"));
        let args = ["speed", "--port", "sim", "--duty", duty, "--seconds", "2", "--out", "run.mcap"];
        assert!(twum(dir.path(), &args).status.success());
    };
    record("1");
    let (code, first, message) = diagnose(&["run.mcap"]);
    assert!(code == Some(0) && first.contains("one run only") && !message.contains("answered before"), "{message}");
    let (_, second, message) = diagnose(&["run.mcap"]);
    assert!(first == second && message.contains("answered before"), "{message}");
    let (code, answer, message) = diagnose(&["run.mcap", "--save-model", "mine.toml"]);
    assert!(code == Some(0) && answer == first && message.contains("wrote mine.toml"), "{message}");
    let saved = std::fs::read_to_string(dir.path().join("mine.toml")).unwrap();
    assert!(saved.contains("[parameters"), "{saved}");
    // Fails if the file does not say how well it repeats the run, or says it of something else than `compare` simulates.
    let compared = twum(dir.path(), &["compare", "run.mcap", "--motor", "mine.toml", "--json"]).stdout;
    let compared: Value = serde_json::from_slice(&compared).unwrap();
    let mean = |of: &str| compared["simulation"]["runs"][0][of]["mean_rpm"].as_f64().unwrap();
    let off = format!("{:.2} rpm off", (mean("simulated") - mean("measured")).abs());
    assert!(saved.lines().next().is_some_and(|line| line.contains(&off)) && message.contains(&off), "{off}: {message}");
    record("0.6");
    let (_, other, message) = diagnose(&["run.mcap"]);
    assert!(other != first && !message.contains("answered before"), "{message}");

    std::fs::create_dir_all(dir.path().join("bench/measurement")).unwrap();
    let (code, _, message) = diagnose(&["bench"]);
    assert!(code == Some(2) && message.contains("did you mean bench/measurement?"), "{message}");
}

/// What went wrong stands once in the message, with the file it is about.
#[test]
fn errors_name_their_cause_once() {
    let dir = tempfile::tempdir().unwrap();
    let runs = [speed_run("a", 1.0), speed_run("b", 1.0)].concat();
    write(dir.path(), &runs, &[("a.csv", levels(0.5, |_, _| 30.0)), ("b.csv", "time_us,level\n0,0\n1000,x\n".into())]);
    std::fs::write(dir.path().join("not.mcap"), b"nothing").unwrap();
    let fails = |args: &[&str], cause: &str| {
        let output = twum(dir.path(), args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(message.matches(cause).count(), 1, "{args:?}: {message}");
    };
    fails(&["velocity", "."], "b.csv:3:6: level `x` is not a number");
    fails(&["import", "."], "b.csv:3:6: level `x` is not a number");
    fails(&["velocity", "nowhere"], "no such file or folder");
    fails(&["velocity", "not.mcap"], "not a recording");
    fails(&["live", "nowhere.mcap", "--once"], "No such file or directory");
    fails(&["export", "nowhere.mcap", "--to", "csv", "x"], "No such file or directory");
    fails(&["neck", "--exercise", "nowhere.toml"], "No such file or directory");
    write(dir.path(), &speed_run("a", 1.0), &[]);
    fails(&["compare", ".", "--motor", "nowhere.toml"], "No such file or directory");
    fails(&["velocity", ".", "--plot", "nowhere/a.svg"], "No such file or directory");
    fails(&["velocity", ".", "--plot", "a.pdf"], "a figure is written as .svg, .png or .html");
    fails(&["velocity", ".", "--period-us", "1e-9"], "are the most: take a longer period");
    fails(&["velocity", ".", "--method", "thesis-butterworth", "--csv", "nowhere/a.csv"], "No such file or directory");
}

/// The README's commands run on a clean clone: the measurement it names is there, whole, and a dead zone shows in its speeds.
#[test]
fn the_example_is_a_measurement_with_something_hidden_in_it() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/first");
    let found = json(&twum(Path::new("."), &["velocity", example.to_str().unwrap(), "--json"]));
    let runs = found.as_array().unwrap();
    assert_eq!(runs.len(), 20);
    // Of a duty u the motor gets u - 0.08, and its speed goes with what it gets.
    for run in runs {
        let (duty, rpm) = (run["duty"].as_f64().unwrap(), run["mean_rpm"].as_f64().unwrap().abs());
        assert!((rpm - 35.3 * (duty - 0.08)).abs() < 0.6, "{run}");
    }
}

/// A recording plots as it is: a public MCAP reader finds the motion in it, with its schema, equal to what the frames say.
#[test]
fn recordings_hold_the_motion_for_other_programs() {
    let dir = tempfile::tempdir().unwrap();
    let args = ["track", "--port", "sim", "--seconds", "4", "--out", "track.mcap", "--json"];
    let said = json(&twum(dir.path(), &args));
    let bytes = std::fs::read(dir.path().join("track.mcap")).unwrap();
    let mut motion: Vec<Value> = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == "/twum/motion" {
            let schema = message.channel.schema.as_ref().expect("the channel has a schema");
            let properties: Value = serde_json::from_slice(&schema.data).unwrap();
            assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("twum.Motion", "jsonschema"));
            let one: Value = serde_json::from_slice(&message.data).unwrap();
            let known = one.as_object().unwrap().keys().all(|key| properties["properties"].get(key).is_some());
            assert!(known, "{one}");
            motion.push(one);
        }
    }
    let tracked: Vec<&Value> = motion.iter().filter(|m| m.get("error_deg").is_some()).collect();
    // 2000 ticks a second in blocks of 16.
    assert!((480..=510).contains(&tracked.len()), "{}", tracked.len());
    for m in &tracked {
        let off = number(&m["target_deg"]) - number(&m["position_deg"]) - number(&m["error_deg"]);
        assert!(off.abs() < 2e-3, "{m}");
        assert!((number(&m["position"]) * 0.9 - number(&m["position_deg"])).abs() < 1e-3, "{m}");
    }
    let mean = tracked.iter().map(|m| number(&m["error_deg"]).abs()).sum::<f64>() / tracked.len() as f64;
    let of_all = number(&said["motor"]["mean_abs_deg"]);
    assert!((mean / of_all - 1.0).abs() < 0.1, "{mean} of every block's last tick, {of_all} of all ticks");
    assert!(tracked.iter().any(|m| number(&m["speed_rpm"]).abs() > 5.0));
}
