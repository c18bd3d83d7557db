//! Commands of a terminal beside the server: through it, as at the port itself.

use super::faults::{board, frames};
use super::page::Page;
use super::served::Served;
use super::simulator::text;
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};
use twum_host::compare::replay::replay_recording;
use twum_host::record::recording::Recording;

fn run(served: &Served, arguments: &[&str]) -> Output {
    served.twum(arguments).args(["--port", &served.port]).output().unwrap()
}

/// A run of a minute from a terminal, once the motor is driven.
fn tracking(served: &Served, recording: &Path) -> Child {
    let child = served
        .twum(&["track", "--seconds", "60", "--out", recording.to_str().unwrap(), "--port", &served.port])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    served.until("the terminal's run begins", |state| state["mode"] == "Running");
    child
}

/// Fails when a terminal cannot work through the server, records elsewhere than it was told to, loses a frame, says anything
/// else than without a server, or leaves its own gains behind.
#[test]
fn a_terminal_tracks_through_the_server_as_at_the_port_itself() {
    let (simulator, served) = board();
    let watcher = Page::open(&served);
    let folder = tempfile::tempdir().unwrap();
    let idle = folder.path().join("idle.mcap");
    let (through, alone) = (folder.path().join("through.mcap"), folder.path().join("alone.mcap"));
    let track = |out: &Path| {
        ["track", "--control", "thesis", "--seconds", "2", "--out", out.to_str().unwrap()].map(str::to_owned)
    };
    let (points, own_gains) = (watcher.points(), served.get("/api/configuration").1["toml"].clone());
    let aligned = run(&served, &["align"]);
    assert!(aligned.status.success(), "{}", text(&aligned));
    let words = track(&through);
    let output = run(&served, &words.each_ref().map(String::as_str));
    assert!(output.status.success(), "{}", text(&output));
    watcher.until("the page watches it", |page| page.points() > points + 20 && page.has_line("twum track"));
    let replay = replay_recording(&through).unwrap();
    assert!(replay.replay.is_exact() && replay.replay.checked > 1000, "{replay:?}");
    assert!(Recording::load(&through).unwrap().runs[0].configuration.is_some());
    served.until("it is given back", |state| state["doing"].is_null());
    assert_eq!(served.get("/api/configuration").1["toml"], own_gains, "the run's gains are the run's alone");

    for arguments in [
        vec!["speed", "--duty", "0.5", "--seconds", "0.5"],
        vec!["capture", "--seconds", "0.5", "--out", idle.to_str().unwrap()],
        vec!["config", "show"],
        vec!["info", "--json"],
    ] {
        let output = run(&served, &arguments);
        assert!(output.status.success(), "{arguments:?}: {}", text(&output));
    }
    let state = served.until("it is given back", |state| state["doing"].is_null() && state["is_off"] == true);
    assert!(state["fault"].is_null(), "{state}");
    // The pages work on as before.
    watcher.take();
    watcher.tracking();
    served.stop();
    served.until("the run is told of", |state| state["doing"].is_null() && state["is_off"] == true);
    drop(watcher);
    let mut served = served;
    served.process.kill().unwrap();
    served.process.wait().unwrap();

    let own = simulator.run(&track(&alone).each_ref().map(String::as_str));
    assert!(own.status.success(), "{}", text(&own));
    // The same lines, but for their numbers and the file's name.
    let shape = |output: &Output| -> Vec<String> {
        let text = text(output).replace("through.mcap", "alone.mcap");
        text.lines()
            .map(|line| {
                line.split_whitespace()
                    .filter(|word| !word.contains(|c: char| c.is_ascii_digit()))
                    .collect::<Vec<_>>()
                    .join(" ")
            })
            .collect()
    };
    assert_eq!(shape(&output), shape(&own), "{}\n{}", text(&output), text(&own));
}

/// Fails when two move the motor at once, or the refusal does not say what to do.
#[test]
fn a_terminal_is_refused_while_a_page_holds_the_motor_and_a_page_while_a_terminal_does() {
    let (_simulator, served) = board();
    let folder = tempfile::tempdir().unwrap();
    let page = Page::open(&served);
    page.take();
    let refused = run(&served, &["speed", "--duty", "0.5", "--seconds", "0.5"]);
    assert!(!refused.status.success() && text(&refused).contains("a page holds the motor"), "{}", text(&refused));
    page.does("/api/release", None);
    let recording = folder.path().join("run.mcap");
    let child = tracking(&served, &recording);
    let (status, refused) = page.command("/api/take", None);
    assert!(status == 409 && refused["error"].as_str().unwrap().contains("a terminal has the board"), "{refused}");
    let second = run(&served, &["speed", "--duty", "0.5", "--seconds", "0.5"]);
    assert!(!second.status.success() && text(&second).contains("a terminal has the board"), "{}", text(&second));
    // Anybody stops it, and the terminal says so and has all that was recorded.
    served.stop();
    let output = child.wait_with_output().unwrap();
    assert!(!output.status.success() && text(&output).contains("stopped by somebody else"), "{}", text(&output));
    assert!(text(&output).contains(" 0 lost, 0 bad"), "{}", text(&output));
    assert!(frames(&recording) > 10);
    let state = served.until("it is given back", |state| state["doing"].is_null() && state["is_off"] == true);
    assert!(state["fault"].is_null(), "{state}");
    page.take();
}

/// Fails when the motor runs on without its terminal, or a fault or a torn recording is left behind.
#[test]
fn a_terminal_that_is_killed_or_interrupted_stops_the_motor() {
    let (_simulator, served) = board();
    let folder = tempfile::tempdir().unwrap();
    for signal in ["KILL", "INT", "TERM", "HUP"] {
        let recording = folder.path().join(format!("{signal}.mcap"));
        let mut child = tracking(&served, &recording);
        std::thread::sleep(Duration::from_millis(300));
        let since = Instant::now();
        signal_to(&child, signal);
        let state = served.until("the motor is off", |state| state["is_off"] == true);
        println!("motor off {:?} after the terminal was sent {signal}", since.elapsed());
        assert!(state["fault"].is_null(), "{signal}: the server stopped it, not the command timeout: {state}");
        child.wait().unwrap();
        served.until("it is given back", |state| state["doing"].is_null());
        assert!(frames(&recording) > 10);
    }
    // The next one gets the board.
    assert!(run(&served, &["speed", "--duty", "0.5", "--seconds", "0.5"]).status.success());
}

/// Fails when the server keeps a motor alive whose terminal does not, or a frozen terminal keeps the bench for ever.
#[test]
fn a_terminal_that_is_frozen_lets_the_command_timeout_run_out_and_a_stop_takes_the_board_back() {
    let (_simulator, served) = board();
    let folder = tempfile::tempdir().unwrap();
    let mut child = tracking(&served, &folder.path().join("run.mcap"));
    signal_to(&child, "STOP");
    let state = served.until("the motor is off", |state| state["mode"] == "Fault");
    assert_eq!(state["fault"]["name"], "CommandTimeout", "{state}");
    served.stop();
    let state = served.until("it is taken back", |state| state["doing"].is_null());
    assert!(state["last"]["words"].as_str().unwrap().contains("has lost the board"), "{state}");
    let page = Page::open(&served);
    page.take();
    page.does("/api/clear", None);
    page.tracking();
    // Awake again, it moves nothing and stops nothing; as with a cable that is pulled it waits for the board until it is ended.
    signal_to(&child, "CONT");
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(served.state()["mode"], "Running");
    signal_to(&child, "INT");
    assert!(!child.wait().unwrap().success());
    assert_eq!(served.state()["mode"], "Running");
    served.stop();
}

pub fn signal_to(child: &Child, name: &str) {
    signal(child.id(), name);
}

/// As [`signal_to`], to a program that is known by its number.
pub fn signal(process: u32, name: &str) {
    let sent = std::process::Command::new("kill").args([&format!("-{name}"), &process.to_string()]).status();
    assert!(sent.unwrap().success());
}

/// Fails when a server that ends leaves the motor of a terminal running, or to the command timeout.
#[test]
fn a_server_that_ends_stops_the_motor_of_a_terminal_too() {
    let (simulator, mut served) = board();
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("run.mcap");
    let child = tracking(&served, &recording);
    signal_to(&served.process, "TERM");
    let output = child.wait_with_output().unwrap();
    assert!(text(&output).contains("stopped by somebody else"), "{}", text(&output));
    assert!(served.process.wait().unwrap().success());
    assert!(frames(&recording) > 10);
    let info: serde_json::Value = serde_json::from_str(&simulator.say(&["info", "--json"])).unwrap();
    assert_eq!((&info["mode"], &info["fault"]), (&"Idle".into(), &serde_json::Value::Null));
}

/// Fails when the motor is left to nobody: the terminal that runs it takes the port itself, within the command timeout, and goes on as
/// after a cable that was out for a moment.
#[test]
fn a_server_that_is_killed_leaves_the_motor_to_the_terminal_that_runs_it() {
    let (simulator, mut served) = board();
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("run.mcap");
    let child = tracking(&served, &recording);
    served.process.kill().unwrap();
    served.process.wait().unwrap();
    // Twice the command timeout: a motor that nobody holds would have stopped with its fault.
    std::thread::sleep(Duration::from_secs(1));
    signal_to(&child, "INT");
    let output = child.wait_with_output().unwrap();
    assert!(text(&output).contains("1 reconnects"), "{}", text(&output));
    let state: serde_json::Value = serde_json::from_str(&simulator.say(&["info", "--json"])).unwrap();
    assert!(state["mode"] == "Idle" && state["fault"].is_null(), "{state}");
    let replay = replay_recording(&recording).unwrap();
    assert!(replay.replay.checked > 1_500 && replay.replay.mismatched == 0, "{replay:?}");
}
