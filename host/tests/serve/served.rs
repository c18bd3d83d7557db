//! A server of this build, and requests to it.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A server, ended with the test.
pub struct Served {
    pub process: Child,
    /// `127.0.0.1:PORT`.
    pub address: String,
    /// The token, where one is asked for.
    pub token: Option<String>,
    /// The port of the board.
    pub port: String,
    pub folder: tempfile::TempDir,
    runtime: tempfile::TempDir,
}

impl Served {
    /// One of the simulated board, on a free port.
    pub fn sim() -> Self {
        Self::start("sim", "127.0.0.1:0", "")
    }

    /// One of the board on `port`; `first` are words of a shell before it.
    pub fn start(port: &str, listen: &str, first: &str) -> Self {
        let (folder, runtime) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut process = Command::new("bash")
            .args(["-c", &format!("{first} exec \"$@\""), "bash", env!("CARGO_BIN_EXE_twum")])
            .args(["serve", "--port", port, "--listen", listen, "--json", "--folder"])
            .arg(folder.path().join("runs"))
            .env("XDG_RUNTIME_DIR", runtime.path())
            .env("XDG_CONFIG_HOME", runtime.path())
            .env("XDG_CACHE_HOME", runtime.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        let url = said["url"].as_str().unwrap();
        let (address, fragment) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
        let token = fragment.strip_prefix("#token=").map(str::to_owned);
        let address = address.replace("0.0.0.0", "127.0.0.1");
        Self { process, address, token, port: said["port"].as_str().unwrap().to_owned(), folder, runtime }
    }

    /// Puts the shipped measurement, in which a dead zone is hidden, into the folder of runs.
    pub fn has_example(&self, name: &str) {
        let copied = self.runs().join(name);
        std::fs::create_dir_all(&copied).unwrap();
        let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/first");
        for entry in std::fs::read_dir(example).unwrap().flatten().filter(|entry| entry.path().is_file()) {
            std::fs::copy(entry.path(), copied.join(entry.file_name())).unwrap();
        }
    }

    pub fn runs(&self) -> PathBuf {
        self.folder.path().join("runs")
    }

    /// Another command of this build, beside the server.
    pub fn twum(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_twum"));
        command.args(arguments).env("XDG_RUNTIME_DIR", self.runtime.path()).env("XDG_CONFIG_HOME", self.runtime.path());
        command
    }

    /// Sends bytes, and gives all that comes back until it is silent for so long.
    pub fn raw(&self, bytes: &[u8], patience: Duration) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(patience)).unwrap();
        // A server that has heard enough may close before all is sent.
        let _ = stream.write_all(bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// A request with these lines in its head: status and body.
    pub fn request(&self, method: &str, path: &str, head: &[&str], body: &str) -> (u16, String) {
        let host = format!("Host: {}", self.address);
        let has_host = head.iter().any(|line| line.to_ascii_lowercase().starts_with("host:"));
        let mut text = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n", body.len());
        for line in head.iter().copied().chain((!has_host).then_some(&*host)) {
            text += &format!("{line}\r\n");
        }
        let answer = self.raw(format!("{text}\r\n{body}").as_bytes(), Duration::from_secs(30));
        let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        (status, body.to_owned())
    }

    fn own<'a>(&self, head: &mut Vec<&'a str>, token: &'a Option<String>) {
        head.push("Content-Type: application/json");
        head.extend(token.as_deref());
    }

    /// JSON of a request of this server's own page.
    pub fn get(&self, path: &str) -> (u16, Value) {
        let (token, mut head) = (self.bearer(), Vec::new());
        self.own(&mut head, &token);
        let (status, body) = self.request("GET", path, &head, "");
        (status, serde_json::from_str(&body).unwrap_or_else(|error| panic!("{path}: {error}: {body}")))
    }

    pub fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        let (token, mut head) = (self.bearer(), Vec::new());
        self.own(&mut head, &token);
        let (status, body) = self.request("POST", path, &head, &body.to_string());
        (status, serde_json::from_str(&body).unwrap_or_else(|error| panic!("{path}: {error}: {body}")))
    }

    fn bearer(&self) -> Option<String> {
        self.token.as_ref().map(|token| format!("Authorization: Bearer {token}"))
    }

    pub fn state(&self) -> Value {
        let (status, state) = self.get("/api/state");
        assert_eq!(status, 200, "{state}");
        state
    }

    /// Waits until the state is so.
    pub fn until(&self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            let state = self.state();
            if is(&state) {
                return state;
            }
            assert!(Instant::now() < until, "{what}: {state}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    pub fn stop(&self) {
        let (status, answer) = self.post("/api/stop", &json!({}));
        assert_eq!((status, &answer["stopped"]), (200, &json!(true)), "{answer}");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
