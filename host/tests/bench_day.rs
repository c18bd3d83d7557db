//! A day at the bench: every command once, in the order in which a person comes to need them, on a board behind a real
//! pseudo-terminal in real time. The exit codes are checked, and every figure that two commands print is the same.

use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Exit code and command line; `PORT` stands for the pseudo-terminal. A line with `--json` is kept by its number.
const DAY: [(i32, &str); 46] = [
    (0, ""),
    (0, "config path --json"),
    (0, "config defaults --json"),
    (0, "ports --json"),
    (0, "info --port PORT"),
    (0, "info --port PORT --json"),
    (0, "align --port PORT --json"),
    (0, "speed --port PORT --duty 50% --seconds 2 --out d50.mcap --json"),
    (2, "speed --port PORT --duty 0.5 --seconds 2 --out d50.mcap"),
    (2, "speed --port PORT --duty 150%"),
    (0, "speed --port PORT --duty 1 --direction ccw --seconds 2 --out full.mcap"),
    (0, "track --port PORT --step 90deg --seconds 2 --out step.mcap --json"),
    (0, "track --port PORT --sine 80deg,1.257 --seconds 3 --out sine.mcap --json"),
    (0, "track --port PORT --ramp 10rpm,0.25turn --seconds 2"),
    (2, "track --port PORT --motor simple --seconds 1"),
    (2, "track --port PORT --motor pcbmotor-31mm --seconds 1"),
    (2, "track --port PORT --flavour thesis --seconds 1"),
    (0, "stop --port PORT --json"),
    (0, "capture --port PORT --seconds 1 --streams bits edges --out idle.mcap"),
    (0, "live sine.mcap --once"),
    (0, "replay sine.mcap"),
    (0, "velocity d50.mcap --json"),
    (0, "velocity d50.mcap --plot d50.png"),
    (0, "velocity d50.mcap --plot d50.html"),
    (0, "compare d50.mcap --flavour physical --json"),
    (0, "compare sine.mcap --flavour physical --json"),
    (0, "plot sine.mcap sine.svg"),
    (0, "export d50.mcap --to folder exported"),
    (0, "velocity exported --json"),
    (0, "import exported --json"),
    (0, "experiment plan --duties 0.4,0.7,1 --trials 2 --seconds 1 --json"),
    (0, "experiment run --port PORT --duties 0.4,0.7,1 --trials 2 --seconds 1 --out first"),
    (2, "experiment run --port PORT --duties 0.5 --trials 1 --seconds 1 --out first"),
    (0, "velocity first --json"),
    (0, "compare first --flavour physical --json --report first.html"),
    (0, "plot first first.svg"),
    (0, "diagnose first --quick --json"),
    (0, "diagnose first --quick --flavour measured --json"),
    (0, "diagnose first --quick --report why.html"),
    (0, "experiment plan first --json"),
    (0, "model speed --duty 0.5 --json"),
    (0, "model loop --seconds 2 --json"),
    (0, "neck --exercise rotation --report neck.html --json"),
    (0, "identify force-factor first --json"),
    (0, "completions bash"),
    (0, "man"),
];

struct Simulator(Child);

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn twum(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_twum"));
    command.current_dir(folder).env("XDG_CONFIG_HOME", folder.join("own")).env("XDG_CACHE_HOME", folder.join("cache"));
    command
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("`{key}` of {value}"))
}

#[test]
#[ignore = "a minute in real time, on a machine with a core to spare: cargo test -p twum-host --test bench_day -- --ignored"]
fn every_command_does_the_right_thing_and_no_figure_has_two_values() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("hidden.toml"), "[effects.dead-zone]\nthreshold_duty = 0.12\n").unwrap();
    let mut process = twum(dir.path())
        .args(["sim", "--pty", "--flavour", "physical", "--effects", "hidden.toml"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut port = String::new();
    BufReader::new(process.stdout.take().unwrap()).read_line(&mut port).unwrap();
    let _simulator = Simulator(process);

    let mut answers: BTreeMap<&str, Value> = BTreeMap::new();
    for (code, line) in DAY {
        let words: Vec<&str> = line.split_whitespace().map(|w| if w == "PORT" { port.trim() } else { w }).collect();
        // The environment's port is set all day: a default never conflicts with an argument.
        let output = twum(dir.path()).args(&words).env("TWUM_PORT", port.trim()).output().unwrap();
        let (said, told) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(code), "twum {line}\n{said}\n{told}");
        assert!(!told.contains("panicked"), "twum {line}\n{told}");
        if line.contains("--json") {
            answers.insert(line, serde_json::from_str(&said).unwrap_or_else(|e| panic!("twum {line}: {e}\n{said}")));
        }
    }
    let answer = |start: &str| {
        let found = answers.iter().find(|(line, _)| line.starts_with(start));
        found.unwrap_or_else(|| panic!("no line starts with `{start}`")).1
    };

    assert_eq!(answer("info")["chip"], "simulated pcbmotor-30mm physical +effects");
    let said = &answer("speed")["motor"];
    let (read, exported) = (&answer("velocity d50.mcap")[0], &answer("velocity exported")[0]);
    let compared = &answer("compare d50.mcap")["simulation"]["runs"][0]["measured"];
    for key in ["mean_rpm", "start_peak_rpm", "rise_s", "stop_s", "coast_deg"] {
        assert_eq!(said[key], read[key], "{key}: twum speed against velocity");
        assert_eq!(read[key], compared[key], "{key}: velocity against compare");
        assert!((number(read, key) - number(exported, key)).abs() < 1e-6, "{key}: the folder against the recording");
    }
    for key in ["drift_rpm_per_s", "edges", "duration_s"] {
        assert_eq!(said[key], read[key], "{key}");
    }
    assert!((number(said, "mean_rpm") - 14.0).abs() < 2.0, "a dead zone of 0.12 leaves 0.38 of 35 rpm: {said}");
    let step = &answer("track --port PORT --step")["motor"];
    assert!((number(&step["step"], "height_deg") - 90.0).abs() < 1.0, "{step}");
    assert!(number(&answer("track --port PORT --sine")["motor"], "mean_abs_deg") < 5.0);

    let planned = answer("experiment plan --duties").as_array().unwrap().len();
    let (speeds, beside) = (answer("velocity first"), answer("compare first"));
    assert_eq!(speeds.as_array().unwrap().len(), planned);
    for (run, other) in speeds.as_array().unwrap().iter().zip(beside["simulation"]["runs"].as_array().unwrap()) {
        assert_eq!(run["id"], other["id"]);
        assert_eq!(number(run, "mean_rpm").abs(), number(&other["measured"], "mean_rpm").abs());
    }
    for page in ["d50.html", "first.html", "why.html", "neck.html"] {
        let size = std::fs::metadata(dir.path().join(page)).unwrap().len();
        assert!((60_000..4_000_000).contains(&size), "{page}: {size} bytes");
    }
    assert_eq!(answer("stop")["cleared"], Value::Null);
    let cause = answer("diagnose first --quick --json");
    assert_eq!(cause["verdict"], "named", "{cause}");
    let named: Vec<&Value> =
        cause["effects"].as_array().unwrap().iter().filter(|e| e["status"] == "named").map(|e| &e["name"]).collect();
    assert_eq!(named, ["dead-zone"], "{cause}");
}
