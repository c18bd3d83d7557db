//! What goes wrong at a bench: pages that are gone or frozen, a server that is killed, a cable that is pulled, a disk that is full.

use super::page::Page;
use super::served::Served;
use super::simulator::{Simulator, text};
use super::terminal::signal_to;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use twum_host::record::store::Reader;

/// A server of a board in a program of its own, aligned, with a page that holds the motor.
pub fn board() -> (Simulator, Served) {
    let simulator = Simulator::start();
    let served = Served::start(&simulator.port, "127.0.0.1:0", "");
    served.until("the board answers", |state| state["connected"] == true);
    (simulator, served)
}

pub fn frames(path: &std::path::Path) -> u64 {
    let mut reader = Reader::open(path).unwrap();
    while reader.next_entry().unwrap().is_some() {}
    assert!(reader.integrity().is_whole(), "{:?}", reader.integrity());
    reader.integrity().frames
}

#[test]
fn a_page_that_is_frozen_or_gone_stops_the_motor_and_comes_back_only_by_an_act() {
    let (_simulator, served) = board();
    for is_gone in [false, true] {
        let watcher = Page::open(&served);
        let holder = Page::open(&served);
        holder.take();
        assert_eq!(
            served.post("/api/take", &json!({ "page": "0123456789abcdef0123456789abcdef" })).0,
            409,
            "no page of that name"
        );
        let name = holder.tracking();
        let (status, refused) = watcher.command("/api/take", None);
        assert_eq!(status, 409, "one page holds it while it is used: {refused}");
        let mut kept = Some(holder);
        if is_gone {
            drop(kept.take());
        } else {
            kept.as_ref().unwrap().freeze();
        }
        let since = Instant::now();
        let state = served.until("the motor is off", |state| state["doing"].is_null() && state["is_off"] == true);
        println!("motor off and recording finished {:?} after the page fell silent", since.elapsed());
        assert!(state["fault"].is_null(), "this server stopped it, not the board's own timeout: {state}");
        watcher.until("it is said", |page| page.has_line("does not keep up"));
        assert!(frames(&served.runs().join(&name)) > 10);
        if let Some(holder) = &kept {
            let (status, refused) = holder.command("/api/arm", None);
            assert_eq!(status, 409, "nothing comes back by itself: {refused}");
            holder.take();
        }
    }
}

#[test]
fn a_server_that_is_killed_leaves_a_motor_that_stops_itself_and_a_whole_recording() {
    let (simulator, mut served) = board();
    let page = Page::open(&served);
    page.take();
    let name = page.tracking();
    std::thread::sleep(Duration::from_millis(500));
    drop(page);
    served.process.kill().unwrap();
    served.process.wait().unwrap();
    // The command timeout is 500 ms.
    std::thread::sleep(Duration::from_secs(1));
    let info = simulator.say(&["info", "--json"]);
    let info: Value = serde_json::from_str(&info).unwrap();
    assert_eq!((&info["mode"], &info["fault"]), (&json!("Fault"), &json!("CommandTimeout")));
    assert!(frames(&served.runs().join(name)) > 10);
}

/// Fails when a server ends without having stopped the motor: the board's own timeout would have to, and would latch its fault.
#[test]
fn a_server_that_is_asked_to_end_stops_the_motor_first() {
    for signal in ["INT", "TERM", "HUP", "QUIT"] {
        let (simulator, mut served) = board();
        let page = Page::open(&served);
        page.take();
        let name = page.tracking();
        std::thread::sleep(Duration::from_millis(300));
        drop(page);
        signal_to(&served.process, signal);
        let since = Instant::now();
        let ended = served.process.wait().unwrap();
        println!("ended {:?} after {signal}, {ended}", since.elapsed());
        assert!(ended.success(), "{signal}: {ended}");
        // A latched fault would stay until somebody clears it.
        let info: Value = serde_json::from_str(&simulator.say(&["info", "--json"])).unwrap();
        assert_eq!((&info["mode"], &info["fault"]), (&json!("Idle"), &Value::Null), "{signal}");
        assert!(frames(&served.runs().join(name)) > 10, "{signal}");
    }
}

#[test]
fn two_servers_on_one_port_do_not_share_it_and_the_second_says_so() {
    let (simulator, served) = board();
    let second = Served::start(&simulator.port, "127.0.0.1:0", "");
    let state = second
        .until("it says what is wrong", |state| state["trouble"].as_str().is_some_and(|it| it.contains("in use")));
    assert_eq!(state["connected"], false);
    let page = Page::open(&second);
    page.take();
    let (status, refused) = page.command("/api/arm", None);
    assert!(status == 409 && refused["error"].as_str().unwrap().contains("in use"), "{refused}");
    let (status, refused) = second.post("/api/stop", &json!({}));
    assert!(status == 409 && refused["error"].as_str().unwrap().contains("cannot be told"), "{refused}");
    assert_eq!(served.state()["connected"], true);
    // Two servers at one address: the second ends with a sentence.
    let output = served
        .twum(&["serve", "--port", "sim", "--listen", &served.address, "--folder"])
        .arg(second.runs())
        .output()
        .unwrap();
    assert!(!output.status.success() && text(&output).contains("name another with --listen"), "{}", text(&output));
}

/// Fails when a run goes on with the board that is plugged in again, or the motor is given back with it.
#[test]
fn a_board_that_goes_away_is_told_of_and_nothing_resumes_when_it_is_back() {
    let cable = tempfile::tempdir().unwrap();
    let port = cable.path().join("port");
    let simulator = Simulator::start();
    std::os::unix::fs::symlink(&simulator.port, &port).unwrap();
    let served = Served::start(port.to_str().unwrap(), "127.0.0.1:0", "");
    served.until("the board answers", |state| state["connected"] == true);
    let page = Page::open(&served);
    page.take();
    let name = page.tracking();
    drop(simulator);
    // The run waits for the port to come back, until somebody stops it.
    std::thread::sleep(Duration::from_secs(1));
    let (status, answer) = served.post("/api/stop", &json!({}));
    assert!(status == 409 || status == 200, "{answer}");
    let state = served.until("it is told of", |state| state["connected"] == false && state["doing"].is_null());
    assert!(state["trouble"].as_str().unwrap().len() > 10, "{state}");
    let known = [&state["is_known"], &state["is_off"], &state["mode"], &state["heard_ms_ago"]];
    assert_eq!(
        known,
        [&json!(false), &json!(false), &Value::Null, &Value::Null],
        "nothing old is told as if it were so"
    );
    assert!(frames(&served.runs().join(name)) > 10);

    let again = Simulator::start();
    std::fs::remove_file(&port).unwrap();
    std::os::unix::fs::symlink(&again.port, &port).unwrap();
    served.until("the board answers again", |state| state["connected"] == true);
    std::thread::sleep(Duration::from_millis(500));
    let state = served.state();
    assert!(state["is_off"] == true && state["doing"].is_null() && state["fault"].is_null(), "{state}");
    page.take();
    page.tracking();
    served.stop();
}

#[test]
fn a_full_disk_stops_the_motor_and_loses_nothing_of_what_was_recorded() {
    let simulator = Simulator::start();
    // A file may not grow beyond 96 KiB: what the system says then is what it says of a full disk, to whoever is not killed by it.
    let served = Served::start(&simulator.port, "127.0.0.1:0", "trap '' XFSZ; ulimit -f 96;");
    served.until("the board answers", |state| state["connected"] == true);
    let page = Page::open(&served);
    page.take();
    let name = page.tracking();
    let state = served.until("the disk is full", |state| state["doing"].is_null());
    assert!(state["last"]["words"].as_str().unwrap().contains("captured so far are intact"), "{state}");
    served.until("the motor is off", |state| state["is_off"] == true);
    assert!(Reader::open(served.runs().join(name)).is_ok());
}
