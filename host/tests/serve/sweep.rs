//! A stator's sweep is started from a page and seen while it is made; however it ends, the generator is off.

use super::page::Page;
use super::served::Served;
use super::terminal::{signal, signal_to};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A process, ended with the test.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A simulated generator and oscilloscope in a program of their own, and their addresses.
struct Bench {
    _process: Ended,
    generator: String,
    scope: String,
}

impl Bench {
    fn of(served: &Served) -> Self {
        let mut simulated = served
            .twum(&["instruments", "simulate", "--generator-port", "0", "--scope-port", "0", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(simulated.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap();
        let text = |key: &str| said[key].as_str().unwrap().to_owned();
        Self { _process: Ended(simulated), generator: text("generator"), scope: text("scope") }
    }

    /// What the generator says of its outputs.
    fn outputs(&self) -> [bool; 2] {
        let mut stream = TcpStream::connect(&self.generator).unwrap();
        let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
        ["OUTP?", "OUTP:CH2?"].map(|query| {
            writeln!(stream, "{query}").unwrap();
            answers.next().unwrap().unwrap() == "ON"
        })
    }

    fn until_off(&self) {
        let until = Instant::now() + Duration::from_secs(30);
        while self.outputs() != [false; 2] {
            assert!(Instant::now() < until, "{:?}", self.outputs());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// A sweep of a minute and more.
    fn plan(&self, page: &Page<'_>) -> Value {
        json!({
            "page": page.name(), "name": "stator-1.csv", "generator": self.generator, "scope": self.scope,
            "from_hz": 40e3, "to_hz": 48e3, "step_hz": 2, "vpp": 6, "settle_ms": 5, "single_phase": false,
        })
    }

    /// Begins it, and waits until it drives.
    fn begin(&self, served: &Served, page: &Page<'_>) {
        let (status, answer) = served.post("/api/sweep/run", &self.plan(page));
        assert_eq!(status, 200, "{answer}");
        served.until("it sweeps", |state| doing(state).contains(" of 4001 frequencies"));
        assert_eq!(self.outputs(), [true; 2]);
    }
}

fn doing(state: &Value) -> &str {
    state["doing"]["what"].as_str().unwrap_or_default()
}

/// A program that the server started for a sweep.
fn sweeper(served: &Served) -> Option<u32> {
    let parent = format!("PPid:\t{}\n", served.process.id());
    let of = |process: &u32| {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        let words = std::fs::read_to_string(format!("/proc/{process}/cmdline")).unwrap_or_default();
        status.contains(&parent) && words.contains("instruments")
    };
    let all = std::fs::read_dir("/proc").unwrap().flatten();
    all.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).find(of)
}

/// A line to the instrument at `to` that is cut when it is told.
fn line(to: &str, is_cut: &Arc<AtomicBool>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (to, is_cut) = (to.to_owned(), Arc::clone(is_cut));
    std::thread::spawn(move || {
        let (near, _) = listener.accept().unwrap();
        let far = TcpStream::connect(to).unwrap();
        let pass = |mut from: TcpStream, mut to: TcpStream, is_cut: Arc<AtomicBool>| {
            let mut buffer = [0; 4096];
            while let Ok(count @ 1..) = from.read(&mut buffer) {
                if is_cut.load(Ordering::Relaxed) || to.write_all(&buffer[..count]).is_err() {
                    break;
                }
            }
            let _ = (from.shutdown(std::net::Shutdown::Both), to.shutdown(std::net::Shutdown::Both));
        };
        let (one, other, cut) = (near.try_clone().unwrap(), far.try_clone().unwrap(), Arc::clone(&is_cut));
        std::thread::spawn(move || pass(one, other, cut));
        pass(far, near, is_cut);
    });
    address
}

/// Fails when an end leaves an output on, when the state does not say how it ended, or when the file cannot be gone on with.
#[test]
fn however_a_sweep_of_a_page_ends_the_generator_is_off() {
    for end in ["anybody's stop", "given back", "the page frozen", "the page gone", "the sweep killed"] {
        let served = Served::sim();
        let bench = Bench::of(&served);
        let (watcher, mut page) = (Page::open(&served), Some(Page::open(&served)));
        let holder = page.as_ref().unwrap();
        holder.take();
        bench.begin(&served, holder);
        let refused = holder.command("/api/arm", None);
        assert!(refused.0 == 409 && refused.1.to_string().contains("something is going on"), "{refused:?}");
        assert_eq!(watcher.command("/api/take", None).0, 409);
        let since = Instant::now();
        let answer = match end {
            "anybody's stop" => Some(served.post("/api/stop", &json!({})).1),
            "given back" => Some(holder.does("/api/release", None)),
            "the page frozen" => {
                holder.freeze();
                None
            }
            "the page gone" => {
                drop(page.take());
                None
            }
            _ => {
                signal(sweeper(&served).unwrap(), "KILL");
                None
            }
        };
        bench.until_off();
        println!("{end}: outputs off {:?} after it", since.elapsed());
        let state = served.until("it has ended", |state| state["doing"].is_null());
        let words = state["last"]["words"].as_str().unwrap();
        assert!(words.ends_with("; the generator is off") && state["last"]["ok"] == false, "{end}: {state}");
        assert!(words.contains(if end == "the sweep killed" { "killed" } else { "stopped after" }), "{end}: {words}");
        if let Some(answer) = answer {
            assert!(answer["sweep"] == words && answer["stopped"] == true, "{end}: {answer}");
        }
        let (status, found) = served.get("/api/sweep?run=stator-1.csv&shunt_ohm=2000");
        let taken = found["taken"].as_u64().unwrap();
        assert!(status == 200 && taken > 0, "{end}: {found}");
        // The same plan goes on from there.
        watcher.take();
        bench.begin(&served, &watcher);
        let again = served.until("it goes on", |state| doing(state).contains(" of "));
        let at = doing(&again).split(" of ").next().unwrap().rsplit(' ').next().unwrap().parse::<u64>().unwrap();
        assert!(at >= taken, "{end}: {taken}, then {again}");
        served.stop();
        assert_eq!(bench.outputs(), [false; 2], "{end}");
    }
}

/// Fails when a sweep outlives its server, or goes on beside one that is frozen.
#[test]
fn a_server_that_ends_is_killed_or_frozen_leaves_the_generator_off() {
    for name in ["INT", "TERM", "HUP", "QUIT", "KILL", "STOP"] {
        let mut served = Served::sim();
        let bench = Bench::of(&served);
        let page = Page::open(&served);
        page.take();
        bench.begin(&served, &page);
        drop(page);
        signal_to(&served.process, name);
        let since = Instant::now();
        if !["KILL", "STOP"].contains(&name) {
            assert!(served.process.wait().unwrap().success(), "{name}");
            assert_eq!(bench.outputs(), [false; 2], "{name}: it ended before the generator was off");
        }
        bench.until_off();
        println!("{name}: outputs off {:?} after it", since.elapsed());
    }
}

/// Fails when a broken line leaves the outputs on, or when a generator that cannot be told is said to be off.
#[test]
fn a_line_that_breaks_ends_the_sweep_and_what_is_not_known_is_said() {
    for broken in ["scope", "generator"] {
        let served = Served::sim();
        let bench = Bench::of(&served);
        let page = Page::open(&served);
        page.take();
        let is_cut = Arc::<AtomicBool>::default();
        let (mut plan, own) = (bench.plan(&page), if broken == "scope" { &bench.scope } else { &bench.generator });
        plan[broken] = line(own, &is_cut).into();
        assert_eq!(served.post("/api/sweep/run", &plan).0, 200);
        served.until("it sweeps", |state| doing(state).contains(" of 4001 frequencies"));
        is_cut.store(true, Ordering::Relaxed);
        let state = served.until("it has ended", |state| state["doing"].is_null());
        let words = state["last"]["words"].as_str().unwrap();
        assert_eq!(words.contains("LOOK WHETHER THE GENERATOR IS OFF"), broken == "generator", "{words}");
        assert_eq!(bench.outputs(), [broken == "generator"; 2], "{words}");
    }
}

#[test]
fn who_does_not_hold_the_motor_sweeps_nothing_and_a_page_names_no_files() {
    let served = Served::start("/dev/null/none", "127.0.0.1:0", "");
    let bench = Bench::of(&served);
    let page = Page::open(&served);
    let plan = bench.plan(&page);
    assert_eq!(served.post("/api/sweep/run", &plan).0, 409, "it does not hold the motor");
    page.take();
    let file = served.folder.path().join("secret.csv");
    std::fs::write(&file, "secret").unwrap();
    let changed = |key: &str, value: Value| {
        let mut plan = plan.clone();
        plan[key] = value;
        plan
    };
    for (key, value) in [
        ("name", json!("../secret.csv")),
        ("name", json!("a/b.csv")),
        ("name", json!("stator.mcap")),
        ("generator", json!(file.to_str().unwrap())),
        ("scope", json!("/dev/tty")),
        ("generator", json!("--attended")),
        ("generator", json!("sim")),
        ("vpp", json!(60)),
        ("step_hz", json!(0)),
        ("to_hz", json!(1)),
        ("settle_ms", json!(1_000_000)),
    ] {
        let (status, answer) = served.post("/api/sweep/run", &changed(key, value.clone()));
        assert_eq!(status, 400, "{key} = {value}: {answer}");
    }
    assert_eq!(bench.outputs(), [false; 2]);
    // Another file of the folder is not written into.
    std::fs::write(served.runs().join("mine.csv"), "time_us,level\n").unwrap();
    assert_eq!(served.post("/api/sweep/run", &changed("name", json!("mine.csv"))).0, 200);
    let state = served.until("it is refused", |state| state["last"].is_object() && state["doing"].is_null());
    assert!(state["last"]["words"].as_str().unwrap().contains("holds another sweep"), "{state}");
    assert_eq!(std::fs::read_to_string(served.runs().join("mine.csv")).unwrap(), "time_us,level\n");
    // A stator is swept without a board, and stopped.
    bench.begin(&served, &page);
    let (status, answer) = served.post("/api/stop", &json!({}));
    let said = answer["error"].as_str().unwrap();
    assert!(status == 409 && said.contains("the generator is off. the board cannot be told"), "{answer}");
    assert_eq!(bench.outputs(), [false; 2]);
}

/// Fails when the plots come at the end only, or do not show the resonance that the simulated stator has.
#[test]
fn nyquist_and_bode_are_shown_while_a_stator_is_swept() {
    let served = Served::sim();
    let bench = Bench::of(&served);
    let file = served.runs().join("stator.csv");
    let sweep = served
        .twum(&["instruments", "sweep", file.to_str().unwrap(), "--from", "42000", "--to", "46000", "--step", "40"])
        .args(["--generator", &bench.generator, "--scope", &bench.scope])
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
