//! `twum live` on a terminal: what it shows of a board that another program holds, and how it ends.
#![cfg(target_os = "linux")]

mod simulator;
mod terminal;

use serialport::{SerialPort, TTYPort};
use simulator::{Simulator, text};
use std::io::Read;
use std::process::{Child, Command};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// One test at a time: what the other one starts would hold this one's terminal open.
static ALONE: Mutex<()> = Mutex::new(());
/// Generous: the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until all of these were on the screen. It is drawn by its changes: words come in pieces.
fn shown(terminal: &mut TTYPort, wanted: &[&str]) {
    terminal.set_timeout(Duration::from_millis(100)).unwrap();
    let until = Instant::now() + PATIENCE;
    let (mut seen, mut buffer) = (Vec::new(), [0; 4096]);
    loop {
        if let Ok(length) = terminal.read(&mut buffer) {
            seen.extend_from_slice(&buffer[..length]);
        }
        let text = String::from_utf8_lossy(&seen).into_owned();
        if wanted.iter().all(|wanted| text.contains(wanted)) {
            return;
        }
        assert!(Instant::now() < until, "{wanted:?} in {} bytes", text.len());
    }
}

/// Goes on reading the screen until its program ends.
fn drain(mut terminal: TTYPort) {
    std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        loop {
            match terminal.read(&mut buffer) {
                Err(error) if error.kind() != std::io::ErrorKind::TimedOut => return,
                _ => {}
            }
        }
    });
}

/// Waits for the end; the exit code, none if it died of a signal.
fn ended(mut child: Child) -> Option<i32> {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    panic!("it outlives its terminal");
}

#[test]
fn a_view_ends_when_its_terminal_goes_away() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("a.mcap");
    let made = Command::new(env!("CARGO_BIN_EXE_twum"))
        .args(["track", "--port", "sim", "--seconds", "1", "--out"])
        .arg(&recording)
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", text(&made));
    // A closed window says so with a signal; a program that was told to ignore it sees that its terminal is none any more.
    for first in ["", "trap '' HUP;"].repeat(4) {
        let (mut command, mut terminal) = terminal::on_terminal(first);
        let child = command.arg("live").arg(&recording).spawn().unwrap();
        shown(&mut terminal, &["a.mcap"]);
        drop(command);
        drop(terminal);
        ended(child);
    }
}

#[test]
fn a_board_that_another_program_holds_is_watched_through_it() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let simulator = Simulator::start();
    let folder = tempfile::tempdir().unwrap();
    let run = simulator.tracking(&folder.path().join("run.mcap"));
    let (mut command, mut terminal) = terminal::on_terminal("");
    command.args(["live", "--port", &simulator.port]).env("XDG_RUNTIME_DIR", simulator.runtime.path());
    let view = command.spawn().unwrap();
    drop(command);
    // A dot of a curve: the board's values come.
    shown(&mut terminal, &["through the program that holds its port", "⢸"]);
    drain(terminal);
    // The view holds up neither an answer nor a stop, and ends with the run's program.
    assert!(simulator.say(&["info"]).contains("Running"));
    assert!(simulator.say(&["stop"]).contains("the board acknowledged it"));
    assert_eq!(run.wait_with_output().unwrap().status.code(), Some(4));
    assert_eq!(ended(view), Some(0));
}
