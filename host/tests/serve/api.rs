//! What a person does at the bench, over the page's own protocol.

use super::page::Page;
use super::served::Served;
use serde_json::{Value, json};
use twum_host::compare::replay::replay_recording;
use twum_host::record::recording::Recording;

#[test]
fn a_run_is_made_recorded_and_stopped_and_the_recording_holds_the_new_gains() {
    let served = Served::sim();
    let state = served.until("the board answers", |state| state["connected"] == true);
    assert_eq!((&state["mode"], &state["is_off"]), (&json!("Idle"), &json!(true)));
    let page = Page::open(&served);
    let (status, refused) = page.command("/api/align", None);
    assert_eq!(status, 409, "nobody moves what they do not hold: {refused}");
    page.take();
    page.does("/api/align", None);
    served.until("it is aligned", |state| state["last"]["ok"] == true);

    // The limits that the board refuses are refused with the key's name, and change nothing.
    let (status, refused) = page.command("/api/configuration", Some(json!({ "toml": "[control]\nkp = 2000" })));
    assert!(status == 400 && refused["error"].as_str().unwrap().contains("kp"), "{refused}");
    // So is a controller that swings in the model, unless it is wanted all the same.
    let swings = json!({ "toml": "[control]\nkp = -5.0" });
    let (status, refused) = page.command("/api/configuration", Some(swings));
    assert!(status == 400 && refused["error"].as_str().unwrap().contains("unstable in the model"), "{refused}");
    page.does("/api/configuration", Some(json!({ "toml": "[control]\nkp = -5.0", "allow_unstable": true })));
    page.does("/api/configuration", Some(json!({ "toml": "[control]\nkp = 70.0" })));
    let changed = page.does("/api/configuration", Some(json!({ "toml": "[control]\nkp = 50.5" })));
    assert_eq!(changed["changed"], json!(["control.kp = 50.5"]));
    page.until("the page is told", |page| page.has_line("control.kp = 50.5"));
    let (_, found) = served.get("/api/configuration");
    let kp = found["rows"].as_array().unwrap().iter().find(|row| row["key"] == "control.kp").unwrap();
    assert_eq!((&kp["value"], &kp["bounds"]), (&json!(50.5), &json!("below 1024")));

    let name = page.tracking();
    let (status, refused) = page.command("/api/configuration", Some(json!({ "toml": "pwm_hz = 60" })));
    assert_eq!(status, 409, "gains are changed between runs: {refused}");
    let points = page.points();
    page.until("the plot moves", |page| page.points() > points + 20);
    // Another terminal sees the same board, and anybody stops it.
    let info = served.twum(&["info", "--json", "--port", &served.port]).output().unwrap();
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["mode"], "Running");
    served.stop();
    let state = served.until("the run is told of", |state| state["doing"].is_null());
    assert_eq!((&state["is_off"], &state["fault"]), (&json!(true), &Value::Null));
    assert!(state["last"]["words"].as_str().unwrap().contains("none lost"), "{state}");

    let path = served.runs().join(&name);
    let replay = replay_recording(&path).unwrap();
    assert!(replay.replay.is_exact() && replay.replay.checked > 1000, "{replay:?}");
    let recording = Recording::load(&path).unwrap();
    let used = recording.runs[0].configuration.unwrap();
    assert_eq!(used.control.kp, 50.5);
    read_the_run(&served, &name);
    let (status, _) = page.command("/api/release", None);
    assert_eq!(status, 200);
}

/// What the Runs page reads.
fn read_the_run(served: &Served, name: &str) {
    let before = std::fs::read(served.runs().join(name)).unwrap();
    let (_, list) = served.get("/api/runs");
    assert_eq!(list["runs"][0]["name"], name);
    let (_, figures) = served.get(&format!("/api/run/figures?run={name}"));
    assert_eq!(figures["figures"]["kind"], "track", "{figures}");
    let (_, plots) = served.get(&format!("/api/run/plots?run={name}"));
    let panels: Vec<&str> =
        plots["figure"]["panels"].as_array().unwrap().iter().map(|panel| panel["y_label"].as_str().unwrap()).collect();
    assert_eq!(panels, ["position (°)", "error (°)", "speed (rpm)", "drive on, signed (1)", "tick (µs)"]);
    std::fs::copy(served.runs().join(name), served.runs().join("other.mcap")).unwrap();
    let (_, both) = served.get(&format!("/api/run/plots?run={name}&with=other.mcap"));
    assert_eq!(both["figure"]["panels"][0]["series"].as_array().unwrap().len(), 4);
    let (_, replay) = served.get(&format!("/api/run/replay?run={name}"));
    assert_eq!(replay["exact"], true);
    let (status, _) = served.post("/api/run/notes", &json!({ "run": name, "text": "first light" }));
    assert_eq!(status, 200);
    assert_eq!(served.get(&format!("/api/run/notes?run={name}")).1["text"], "first light");
    let (_, list) = served.get("/api/runs");
    let listed = list["runs"].as_array().unwrap().iter().find(|run| run["name"] == name).unwrap();
    assert_eq!(listed["note"], "first light");
    assert_eq!(std::fs::read(served.runs().join(name)).unwrap(), before, "a recording is never touched");
}

#[test]
fn every_kind_of_run_is_made_and_a_stop_of_another_terminal_is_told() {
    let served = Served::sim();
    served.until("the board answers", |state| state["connected"] == true);
    let page = Page::open(&served);
    page.take();
    for what in [
        json!({ "kind": "speed", "duty": 0.6, "direction": "ccw", "seconds": 0.5 }),
        json!({ "kind": "step", "angle_deg": 45, "seconds": 0.5 }),
        json!({ "kind": "ramp", "speed_deg_s": -60, "limit_deg": 20, "seconds": 0.5 }),
        json!({ "kind": "path", "points": [[20, 0.3], [0, 0.3]], "seconds": 0.7 }),
    ] {
        let taken = page.does("/api/run", Some(what.clone()));
        let state = served.until("it is made", |state| {
            state["doing"].is_null()
                && state["last"]["recording"].as_str() == taken["recording"].as_str().unwrap().strip_suffix(".mcap")
        });
        assert_eq!(state["last"]["ok"], true, "{what}: {state}");
    }
    // Arming allows runs; a run made then begins all the same.
    page.does("/api/arm", None);
    served.until("it is armed", |state| state["mode"] == "Armed" && state["is_off"] == false);
    page.tracking();
    let stop = served.twum(&["stop", "--port", &served.port]).output().unwrap();
    assert!(stop.status.success(), "{stop:?}");
    let state = served.until("the run is told of", |state| state["doing"].is_null());
    assert!(state["last"]["words"].as_str().unwrap().contains("stopped by somebody else"), "{state}");
    assert_eq!(state["is_off"], true);
}

#[test]
fn an_experiment_is_planned_stopped_and_gone_on_with() {
    let served = Served::sim();
    served.until("the board answers", |state| state["connected"] == true);
    let page = Page::open(&served);
    page.take();
    let table = json!({ "duties": [0.5, 1], "directions": ["cw"], "trials": 1, "seconds": 1 });
    let (_, planned) = served.post("/api/experiment/plan", &table);
    let runs = planned["runs"].clone();
    assert_eq!(runs.as_array().unwrap().len(), 2, "{planned}");
    let ask = |runs: Value| {
        let (status, answer) =
            served.post("/api/experiment/run", &json!({ "page": page.name(), "name": "first", "runs": runs }));
        assert_eq!(status, 200, "{answer}");
    };
    ask(runs.clone());
    served.until("the first run is made", |state| {
        state["doing"]["what"].as_str().is_some_and(|what| what.contains("run 2 of 2")) && state["mode"] == "Running"
    });
    served.stop();
    let state = served.until("its end is told", |state| state["doing"].is_null());
    assert!(state["last"]["words"].as_str().unwrap().contains("1 of 2 runs made"), "{state}");
    let (status, refused) =
        served.post("/api/experiment/run", &json!({ "page": page.name(), "name": "first", "runs": runs }));
    assert!(status == 400 && refused["error"].as_str().unwrap().contains("exists already"), "{refused}");
    ask(Value::Null);
    let state = served.until("the rest is made", |state| state["last"]["ok"] == true && state["doing"].is_null());
    assert!(state["last"]["words"].as_str().unwrap().contains("2 of 2 runs made"), "{state}");
    assert!(served.runs().join("first/measurement/measurement.toml").is_file());
    let (_, list) = served.get("/api/runs");
    let names: Vec<&str> = list["runs"].as_array().unwrap().iter().map(|run| run["name"].as_str().unwrap()).collect();
    assert!(names.contains(&"first") && names.contains(&"first/measurement"), "{names:?}");
}

#[test]
fn a_shipped_folder_is_diagnosed_with_its_page_and_progress() {
    let served = Served::sim();
    served.has_example("bench3");
    let (status, begun) = served.post("/api/study", &json!({ "kind": "diagnose", "runs": ["bench3"], "quick": true }));
    assert_eq!(status, 200, "{begun}");
    let (status, _) = served.post("/api/study", &json!({ "kind": "diagnose", "runs": ["bench3"], "quick": true }));
    assert_eq!(status, 409, "one at a time");
    let until = std::time::Instant::now() + std::time::Duration::from_secs(600);
    let mut shares = Vec::new();
    let done = loop {
        let (_, studies) = served.get("/api/studies");
        let study = studies["studies"][0].clone();
        shares.extend(study["share"].as_f64());
        if study["stage"] != "running" {
            break study;
        }
        assert!(std::time::Instant::now() < until, "{study}");
        std::thread::sleep(std::time::Duration::from_millis(100));
    };
    assert_eq!((&done["stage"], &done["has_page"]), (&json!("done"), &json!(true)), "{done}");
    assert!(shares.len() > 1, "it says how far it is");
    let (status, page) = served.request("GET", "/api/study/page?study=1", &[], "");
    assert_eq!(status, 200);
    assert!(page.contains("<h1>") && page.contains("plots.all()"), "the report's page");
    let (_, text) = served.get("/api/study/text?study=1");
    assert!(text["text"].as_str().unwrap().starts_with("NAMED: dead-zone"), "{text}");
}
