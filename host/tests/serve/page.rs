//! A page as the server sees it: a stream that is read and answered.

use super::served::Served;
use serde_json::{Value, json};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tungstenite::{ClientRequestBuilder, Message};

#[derive(Default)]
struct Seen {
    page: Mutex<String>,
    holder: Mutex<String>,
    last: Mutex<Value>,
    lines: Mutex<Vec<String>>,
    points: AtomicU64,
    answers: AtomicBool,
    is_over: AtomicBool,
}

/// A page; closed with the test.
pub struct Page<'a> {
    served: &'a Served,
    seen: Arc<Seen>,
    thread: Option<JoinHandle<()>>,
}

impl<'a> Page<'a> {
    pub fn open(served: &'a Served) -> Self {
        let stream = TcpStream::connect(&served.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
        let uri = format!("ws://{}/api/stream", served.address).parse().unwrap();
        let mut request = ClientRequestBuilder::new(uri);
        if let Some(token) = &served.token {
            request = request.with_header("Cookie", format!("twum={token}"));
        }
        let (mut socket, _) = tungstenite::client(request, stream).unwrap();
        let seen = Arc::new(Seen { answers: AtomicBool::new(true), ..Seen::default() });
        let thread = Arc::clone(&seen);
        let thread = std::thread::spawn(move || {
            while !thread.is_over.load(Ordering::Relaxed) {
                let text = match socket.read() {
                    Ok(Message::Text(text)) => text,
                    Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => continue,
                    Ok(_) => continue,
                    Err(_) => return,
                };
                let message: Value = serde_json::from_str(&text).unwrap();
                if let Some(page) = message["page"].as_str() {
                    *thread.page.lock().unwrap() = page.to_owned();
                }
                *thread.holder.lock().unwrap() = message["holder"].as_str().unwrap().to_owned();
                let lines = message["lines"].as_array().unwrap().iter().map(|line| line.as_str().unwrap().to_owned());
                thread.lines.lock().unwrap().extend(lines);
                thread.points.fetch_add(message["points"].as_array().unwrap().len() as u64, Ordering::Relaxed);
                *thread.last.lock().unwrap() = message["state"].clone();
                if thread.answers.load(Ordering::Relaxed)
                    && socket.send(Message::text(json!({ "beat": message["beat"] }).to_string())).is_err()
                {
                    return;
                }
            }
        });
        let page = Self { served, seen, thread: Some(thread) };
        page.until("the first message", |page| !page.name().is_empty());
        page
    }

    pub fn name(&self) -> String {
        self.seen.page.lock().unwrap().clone()
    }

    pub fn holder(&self) -> String {
        self.seen.holder.lock().unwrap().clone()
    }

    pub fn points(&self) -> u64 {
        self.seen.points.load(Ordering::Relaxed)
    }

    pub fn has_line(&self, part: &str) -> bool {
        self.seen.lines.lock().unwrap().iter().any(|line| line.contains(part))
    }

    /// Reads on, and answers nothing: a tab that is frozen, as far as the server can tell.
    pub fn freeze(&self) {
        self.seen.answers.store(false, Ordering::Relaxed);
    }

    pub fn until(&self, what: &str, is: impl Fn(&Self) -> bool) {
        let until = Instant::now() + Duration::from_secs(60);
        while !is(self) {
            assert!(Instant::now() < until, "{what}: {}, {:?}", self.seen.last.lock().unwrap(), self.seen.lines);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// What only the page that holds the motor may ask for.
    pub fn command(&self, path: &str, what: Option<Value>) -> (u16, Value) {
        let body = match what {
            Some(what) => json!({ "page": self.name(), "what": what }),
            None => json!({ "page": self.name() }),
        };
        self.served.post(path, &body)
    }

    /// As [`Self::command`], of what has to succeed.
    pub fn does(&self, path: &str, what: Option<Value>) -> Value {
        let (status, answer) = self.command(path, what);
        assert_eq!(status, 200, "{path}: {answer}");
        answer
    }

    pub fn take(&self) {
        self.does("/api/take", None);
        self.until("it holds the motor", |page| page.holder() == "you");
    }

    /// A run of a minute, once the motor is driven; the name of its recording.
    pub fn tracking(&self) -> String {
        let sine = json!({ "kind": "sine", "amplitude_deg": 80.1, "omega_rad_s": 1.257, "seconds": 60 });
        let taken = self.does("/api/run", Some(sine));
        self.served.until("the run begins", |state| state["mode"] == "Running");
        taken["recording"].as_str().unwrap().to_owned()
    }
}

impl Drop for Page<'_> {
    fn drop(&mut self) {
        self.seen.is_over.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
