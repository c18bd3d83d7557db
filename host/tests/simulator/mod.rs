//! A simulated board on a pseudo-terminal, in a program of its own, and the `twum` of this build beside it.
#![allow(dead_code, reason = "each test uses a part")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

pub struct Simulator {
    process: Child,
    pub port: String,
    /// The sockets of this test alone.
    pub runtime: tempfile::TempDir,
}

impl Simulator {
    pub fn start() -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_twum"))
            .args(["sim", "--pty"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("twum sim starts");
        let mut port = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut port).unwrap();
        Self { process, port: port.trim().to_owned(), runtime: tempfile::tempdir().unwrap() }
    }

    pub fn twum(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_twum"));
        command.args(arguments).args(["--port", &self.port]).env("XDG_RUNTIME_DIR", self.runtime.path());
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        self.twum(arguments).output().unwrap()
    }

    /// Standard output of what has to succeed.
    pub fn say(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", text(&output));
        String::from_utf8(output.stdout).unwrap()
    }

    /// A run of a minute, once the motor is driven.
    pub fn tracking(&self, recording: &Path) -> Child {
        let mut child = self
            .twum(&["track", "--seconds", "60", "--out", recording.to_str().unwrap()])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // Generous: the machine may be busy.
        let until = Instant::now() + Duration::from_secs(60);
        // Asked before the run has the port, `info` would have it.
        while !self.socket().exists() || !text(&self.run(&["info"])).contains("Running") {
            assert!(Instant::now() < until && child.try_wait().unwrap().is_none(), "the run begins");
            std::thread::sleep(Duration::from_millis(100));
        }
        child
    }

    pub fn socket(&self) -> PathBuf {
        self.runtime.path().join("twum").join(format!("{}.sock", self.port.replace('/', "_")))
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

pub fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}
