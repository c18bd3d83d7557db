//! Every command that moves the motor against everything that may end it, on a real port in real time: when the drive is off,
//! how far the rotor turned meanwhile, what the exit code and the recording say. The board and the host are the real ones;
//! only the motor is simulated, and watched from outside the link.
#![cfg(target_os = "linux")]

#[path = "safety/cases.rs"]
mod cases;
#[path = "../../tests/tests/board/document.rs"]
mod document;
#[path = "safety/rig.rs"]
mod rig;
mod terminal;

use cases::{EVENTS, Event, GATED_AND_TUNED, MOVERS, Mover, TUNE};
use rayon::prelude::*;
use rig::{Do, Rig, Seen};
use rustix::process::{Pid, Signal, kill_process};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use twum_host::record::store::Reader;
use twum_host::sim::Disturbance;
use twum_shared::Fault;
use twum_shared::message::ResetCause;

/// What came of one case.
#[derive(Clone, Debug)]
struct Came {
    off_ms: f64,
    /// For how much of that, and of the time just before, the machine kept threads from running that wanted to.
    kept_ms: f64,
    /// For how long at the most the board stood still then, whose clock this is.
    stood_ms: f64,
    turned_deg: f64,
    code: Option<i32>,
    recording: &'static str,
    begun_again: u32,
}

/// A program on a terminal, with the terminal's other end.
struct Program {
    child: Child,
    terminal: Option<serialport::TTYPort>,
}

fn start(mover: Mover, event: Event, port: &str, out: Option<&Path>) -> Program {
    let mut arguments: Vec<String> = mover.arguments.iter().map(|&argument| argument.to_owned()).collect();
    arguments.extend(["--port".to_owned(), port.to_owned()]);
    if let Some(out) = out {
        arguments.extend(["--out".to_owned(), out.to_str().unwrap().to_owned()]);
    }
    let mut terminal = None;
    let mut command = match event {
        Event::WindowClosed => {
            let (command, master) = terminal::on_terminal("");
            terminal = Some(master);
            command
        }
        // A limit on the size of files stands in for a full disk: the same call fails, only with another reason.
        Event::DiskFull => terminal::alone(&format!("trap '' XFSZ; ulimit -f {DISK_KIB}; exec \"$@\"")),
        _ => terminal::alone("exec \"$@\""),
    };
    command.args(arguments);
    if event != Event::WindowClosed {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    }
    Program { child: command.spawn().expect("the command starts"), terminal }
}

/// Sent from here: a `kill` that has to be started first comes late by what the machine takes for that.
fn signal(child: &Child, name: &str) {
    let signal = match name {
        "INT" => Signal::INT,
        "TERM" => Signal::TERM,
        "HUP" => Signal::HUP,
        "QUIT" => Signal::QUIT,
        "STOP" => Signal::STOP,
        "CONT" => Signal::CONT,
        "KILL" => Signal::KILL,
        other => panic!("SIG{other}"),
    };
    kill_process(Pid::from_child(child), signal).expect("a child that is there");
}

/// Lets it happen; when it did, µs.
fn happen(event: Event, rig: &Rig, program: &mut Program) -> u64 {
    if let Event::StopsLost(count) = event {
        rig.act(Do::LoseStops(count));
        // Until the rig has taken it.
        std::thread::sleep(Duration::from_millis(20));
    }
    let at_us = rig.now_us();
    match event {
        Event::Signal(name) => signal(&program.child, name),
        Event::WindowClosed => program.terminal = None,
        Event::CablePulled => rig.act(Do::Pull),
        Event::DiskFull => {}
        Event::PipeClosed => {
            program.child.stdout = None;
            program.child.stderr = None;
        }
        Event::BoardRestarts => rig.act(Do::Disturb(Disturbance::Reset(ResetCause::External))),
        Event::StopsLost(_) => signal(&program.child, "INT"),
        Event::SecondViewer => {
            rig.act(Do::View);
            signal(&program.child, "KILL");
        }
        Event::Fault => rig.act(Do::Disturb(Disturbance::Fault(Fault::Overspeed))),
        Event::Replayed => {
            signal(&program.child, "KILL");
            std::thread::sleep(Duration::from_millis(20));
            rig.act(Do::Replay);
        }
    }
    at_us
}

/// Waits for the program's end; one that waits for its port, or is stopped, is ended.
fn wait(event: Event, program: &mut Program) -> Option<ExitStatus> {
    // The rest of the longest command, where nothing ends it: the other runs of a tuning, and its own arithmetic.
    let until = Instant::now() + Duration::from_secs(90);
    let help_at = Instant::now() + Duration::from_millis(1_500);
    let mut helped = false;
    loop {
        if let Some(status) = program.child.try_wait().unwrap() {
            return Some(status);
        }
        if !helped && Instant::now() > help_at {
            helped = true;
            match event {
                // It waits for the cable to come back.
                Event::CablePulled => signal(&program.child, "INT"),
                // And goes on where it was: nothing may start again.
                Event::Signal("STOP") => signal(&program.child, "CONT"),
                _ => {}
            }
        }
        if Instant::now() > until {
            let _ = program.child.kill();
            let _ = program.child.wait();
            return None;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn recording_of(folder: &Path, out: Option<&Path>) -> &'static str {
    let Some(out) = out else { return "none" };
    let mut found: Vec<PathBuf> = match out.is_dir() {
        true => std::fs::read_dir(out.join("recordings")).unwrap().flatten().map(|entry| entry.path()).collect(),
        false => vec![out.to_owned()],
    };
    assert!(out.starts_with(folder));
    found.sort();
    let Some(last) = found.last() else { return "none" };
    let Ok(mut reader) = Reader::open(last) else { return "unreadable" };
    let mut marked = false;
    while let Ok(Some(entry)) = reader.next_entry() {
        if let twum_host::record::store::Entry::Remark { json, .. } = entry {
            marked |= json.contains("cut short");
        }
    }
    match (reader.integrity().is_whole(), marked) {
        (false, _) => "damaged",
        (true, true) => "whole, marked",
        (true, false) => "whole",
    }
}

/// What fits the "disk": the alignment and a part of the run.
const DISK_KIB: u64 = 7;

/// Waits for the end of a program whose recording fills the disk; what was seen, and when, µs, as the disk took the last that fits. Of what it has
/// no room for the program learns with the next frame.
fn fill(out: &Path, rig: &Rig, child: &mut Child) -> (Seen, u64) {
    let until = Instant::now() + Duration::from_secs(15);
    let length = |path: PathBuf| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let mut taken = 0;
    let mut at = (rig.seen(), rig.now_us());
    while Instant::now() < until && child.try_wait().unwrap().is_none() {
        let recording = match std::fs::read_dir(out.join("recordings")) {
            Ok(mut entries) => entries.next().and_then(Result::ok).map(|entry| entry.path()),
            Err(_) => Some(out.to_owned()),
        };
        let now = recording.map_or(0, length);
        if now > taken {
            taken = now;
            at = (rig.seen(), rig.now_us());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    at
}

/// One case, at `share` of the motion's length after its begin. A machine that is too busy to begin, to keep up a motion that nothing
/// ends, or to keep the board going while something does, is asked again. A drive that is off too late is late even so.
fn case(mover: Mover, event: Event, share: f64) -> Came {
    let kept_up = |came: &Came| {
        let kept_up = match event.ends(mover) {
            true => came.stood_ms <= STOOD * bound_ms(event) || is_late(event, came),
            false => came.code != Some(3),
        };
        if !kept_up {
            eprintln!("{} × {}: asked again, {came:?}", mover.name, event.name());
        }
        kept_up
    };
    (0..10).find_map(|_| attempt(mover, event, share).filter(kept_up)).expect("a machine that keeps up")
}

fn attempt(mover: Mover, event: Event, share: f64) -> Option<Came> {
    let folder = tempfile::tempdir().unwrap();
    let out = mover.out.map(|name| folder.path().join(name));
    let rig = Rig::start();
    let mut program = start(mover, event, &rig.port, out.as_deref());
    // On a full disk an experiment does not come to its second run.
    let motion = if event == Event::DiskFull { mover.motion.min(2) } else { mover.motion };
    if !rig.wait_until(Duration::from_secs(15), |seen| seen.begun >= motion) {
        let about =
            |what: &str| std::fs::read_to_string(format!("/proc/{}/{what}", program.child.id())).unwrap_or_default();
        let state = (
            about("wchan"),
            about("status").lines().find(|line| line.starts_with("State")).unwrap_or_default().to_owned(),
        );
        let _ = program.child.kill();
        let output = program.child.wait_with_output().unwrap();
        let said = [&output.stdout, &output.stderr].map(|said| String::from_utf8_lossy(said).into_owned()).join(" ");
        eprintln!(
            "{} × {}: the motion never began: {:?}, {state:?}, {}, {said}",
            mover.name,
            event.name(),
            rig.seen(),
            output.status
        );
        return None;
    }
    let (before, at_us) = match (event, &out) {
        (Event::DiskFull, Some(out)) => fill(out, &rig, &mut program.child),
        _ => {
            std::thread::sleep(Duration::from_secs_f64(share * mover.lasts_ms as f64 * 1e-3));
            (rig.seen(), happen(event, &rig, &mut program))
        }
    };
    let status = wait(event, &mut program);
    // What stands has to stay so.
    std::thread::sleep(Duration::from_millis(700));
    let after: Seen = rig.seen();
    let code = status.and_then(|status| status.code());
    let (sign_us, off_us) = (at_us.saturating_sub(LAST_SIGN_US), after.driven_us.max(at_us));
    Some(Came {
        off_ms: (off_us - at_us) as f64 * 1e-3,
        kept_ms: rig.kept_us(sign_us, off_us) as f64 * 1e-3,
        stood_ms: rig.stood_us(sign_us, off_us) as f64 * 1e-3,
        turned_deg: (after.angle_rad - before.angle_rad).to_degrees().abs(),
        code,
        recording: recording_of(folder.path(), out.as_deref()),
        begun_again: after.begun - before.begun,
    })
}

/// The last sign of life before an event was due within this time, µs.
const LAST_SIGN_US: u64 = 30_000;
/// The rig hears and drives the board in turns of 2 ms, and a tick is half of one.
const TURN_MS: f64 = 2.5;
/// The way from an event to the board is over three threads, the program's, its line's and the board's: each may have been kept
/// from running for as long as the one that watches.
const THREADS: f64 = 3.0;
/// A board that stood for a longer part of the bound says little of when its drive was off: what came meanwhile was heard as if it had
/// come before. A fifth: that the drive is off in time is then told from four fifths of it.
const STOOD: f64 = 0.2;

/// Within what time of the event the drive has to be off, on a machine that does nothing else.
fn bound_ms(event: Event) -> f64 {
    if event.host_lives() { 100.0 } else { 500.0 }
}

fn is_late(event: Event, came: &Came) -> bool {
    came.off_ms > bound_ms(event) + TURN_MS + THREADS * came.kept_ms
}

fn check(mover: Mover, event: Event, came: &Came) {
    let what = format!("{} × {}: {came:?}", mover.name, event.name());
    if event.ends(mover) {
        assert!(!is_late(event, came), "{what}");
        assert_eq!(came.begun_again, 0, "nothing starts again: {what}");
    }
    assert!(event.codes(mover).contains(&came.code), "{what}");
    assert!(!["unreadable", "damaged"].contains(&came.recording), "{what}");
}

/// So many moments from the begin of a motion to not quite its middle, as shares of its length. `TWUM_MOMENTS` says another number.
fn moments(count: usize) -> Vec<f64> {
    let count = std::env::var("TWUM_MOMENTS").map_or(count, |count| count.parse().expect("TWUM_MOMENTS is a number"));
    (0..count).map(|moment| 0.02 + 0.43 * moment as f64 / count.max(2).saturating_sub(1) as f64).collect()
}

fn every(movers: &[Mover], events: &[Event]) -> Vec<(Mover, Event)> {
    movers.iter().flat_map(|&mover| events.iter().map(move |&event| (mover, event))).collect()
}

fn matrix(cases: &[(Mover, Event)], shares: &[f64]) -> String {
    // A case waits for most of its time, for a command to start and for the rotor to turn.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(9).build().unwrap();
    let came: Vec<Vec<Came>> = pool.install(|| {
        cases
            .par_iter()
            .map(|&(mover, event)| {
                let came: Vec<Came> = shares.iter().map(|&share| case(mover, event, share)).collect();
                eprintln!(
                    "{} × {}: off after {:?} ms",
                    mover.name,
                    event.name(),
                    came.iter().map(|c| c.off_ms).collect::<Vec<_>>()
                );
                came
            })
            .collect()
    });
    let mut table = String::from(
        "| command | event | drive off after (worst, ms) | machine's own delay then (ms) | turned after it (worst, °) | exit code | recording |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for ((mover, event), came) in cases.iter().zip(&came) {
        let worst = |of: fn(&Came) -> f64| came.iter().map(of).fold(0.0, f64::max);
        let last = came.last().expect("a case has a moment");
        let code = last.code.map_or("none".to_owned(), |code| code.to_string());
        let latest = came.iter().max_by(|a, b| a.off_ms.total_cmp(&b.off_ms)).expect("a case has a moment");
        let (off_ms, kept_ms, turned_deg) = match event.ends(*mover) {
            true => (
                format!("{:.0}", latest.off_ms),
                format!("{:.0}", latest.kept_ms),
                format!("{:.1}", worst(|c| c.turned_deg)),
            ),
            false => ("goes on to its end".to_owned(), String::new(), "its own".to_owned()),
        };
        let (mover, event, recording) = (mover.name, event.name(), last.recording);
        writeln!(table, "| {mover} | {event} | {off_ms} | {kept_ms} | {turned_deg} | {code} | {recording} |").unwrap();
    }
    println!("{table}");
    for ((mover, event), came) in cases.iter().zip(&came) {
        came.iter().for_each(|came| check(*mover, *event, came));
    }
    table
}

/// A tuning that nothing ends makes its six other runs: half a minute that shows nothing.
fn goes_on_shortly((mover, event): &(Mover, Event)) -> bool {
    mover.name != TUNE || event.ends(*mover)
}

#[test]
fn whatever_ends_a_command_the_motor_is_off_and_nothing_starts_again() {
    let mut cases = every(&[&MOVERS[..], &GATED_AND_TUNED].concat(), &EVENTS);
    cases.retain(goes_on_shortly);
    matrix(&cases, &[0.3]);
}

/// `cargo test --release -p twum-host --test safety_matrix -- --ignored --nocapture ten_moments`; the simulated boards have to keep
/// up with real time.
#[test]
#[ignore = "seven minutes; docs/reliability.md gives the command"]
fn whatever_ends_a_command_the_motor_is_off_at_ten_moments() {
    document::record("safety-matrix", &matrix(&every(&MOVERS, &EVENTS), &moments(10)));
}

/// `... -- --ignored --nocapture gated`
#[test]
#[ignore = "minutes; docs/reliability.md gives the command"]
fn whatever_ends_a_gated_run_or_a_tuning_the_motor_is_off() {
    let mut cases = every(&GATED_AND_TUNED, &EVENTS);
    cases.retain(goes_on_shortly);
    document::record("safety-gated", &matrix(&cases, &moments(10)));
}

/// `... -- --ignored --nocapture thirty_moments`
#[test]
#[ignore = "half an hour; docs/reliability.md gives the command"]
fn whatever_signal_ends_a_command_the_motor_is_off_at_thirty_moments() {
    let signals = ["INT", "TERM", "HUP", "KILL"].map(Event::Signal);
    document::record("safety-signals", &matrix(&every(&MOVERS, &signals), &moments(30)));
}

/// A stop from another terminal has its motor off within this time of the command, ms.
const ELSEWHERE_MS: f64 = 50.0;

#[test]
fn a_stop_from_another_terminal_has_the_motor_off_within_50_ms() {
    let folder = tempfile::tempdir().unwrap();
    let mut took: Vec<(f64, f64)> = Vec::new();
    for round in 0..10 {
        let rig = Rig::start();
        let out = folder.path().join(format!("{round}.mcap"));
        let twum = |arguments: &[&str]| {
            let mut command = terminal::alone("exec \"$@\"");
            command.args(arguments).args(["--port", &rig.port]).env("XDG_RUNTIME_DIR", folder.path());
            command.stdout(Stdio::null()).stderr(Stdio::null());
            command
        };
        let mut run = twum(&["track", "--seconds", "60", "--out", out.to_str().unwrap()]).spawn().unwrap();
        assert!(rig.wait_until(Duration::from_secs(60), |seen| seen.begun >= 2), "the run begins");
        std::thread::sleep(Duration::from_millis(300 + 37 * round));
        let at_us = rig.now_us();
        let stop = twum(&["stop"]).status().unwrap();
        assert!(stop.success(), "{stop}");
        assert_eq!(run.wait().unwrap().code(), Some(4));
        let off_us = rig.seen().driven_us;
        took.push((off_us.saturating_sub(at_us) as f64 * 1e-3, rig.kept_us(at_us, off_us.max(at_us)) as f64 * 1e-3));
        assert_eq!(recording_of(folder.path(), Some(&out)), "whole, marked");
    }
    println!("drive off after `twum stop`, and the machine's own delay then (ms): {took:.1?}");
    // One thread more than on the program's own way: the other program's.
    assert!(took.iter().all(|(off_ms, kept_ms)| *off_ms <= ELSEWHERE_MS + (THREADS + 1.0) * kept_ms), "{took:?}");
}
