//! Reaching a board while another program holds its port: that program listens on a socket in the user's runtime directory and
//! passes on what any terminal of the same user asks, which is who the board is, to stop, and to watch. What is answered is the
//! board's own answer; who watches gets the board's own bytes. A program that does nothing with the board itself lends it whole.
//!
//! The socket is in a directory that only its owner may enter. A program that is killed leaves its socket behind; nobody
//! listens on it then, and the next program takes its place. Everybody is served at once: a stop waits for nobody.

use super::stopping::STOP_AGAIN;
use super::{Borrowed, LinkError, Port, Received};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::time::{Duration, Instant};
use thiserror::Error;
use twum_shared::frame::{self, Decoder, Header, MAX_ENCODED};
use twum_shared::message::{DeviceMessage, HostMessage, Identity};

/// A request is looked for this often while the program waits for the board.
const SLICE: Duration = Duration::from_millis(2);
/// Longest wait for the board's answer.
const PATIENCE: Duration = Duration::from_millis(2_500);
/// The line of one who watches.
const WATCH: &str = "watch";
/// How the line of one who borrows begins; what for follows.
const BORROW: &str = "borrow ";
/// What the lender says first: after it come the board's bytes.
const LENT: &str = "\"lent\"";
/// Longest line of a question, and of an answer, bytes.
const LINE: u64 = 64;
const ANSWER: u64 = 4096;
/// What may wait for who watches, pieces of some 10 ms each; what does not fit is not seen there, and never waited for.
const WATCHED: usize = 256;
/// Sequences of frames that are passed on, far from those of a session, which count from zero.
const FIRST_SEQUENCE: u32 = 1 << 31;

/// What can be asked of a board that another program holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// Stop, as [`super::Session::stop`].
    Stop,
    /// Say who it is.
    Hello,
}

impl Asked {
    const fn word(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Hello => "hello",
        }
    }

    fn message(self) -> HostMessage {
        match self {
            Self::Stop => HostMessage::Stop { clear_fault: true },
            Self::Hello => HostMessage::Hello,
        }
    }
}

/// Why a board could not be reached through another program.
#[derive(Debug, Error)]
pub enum RelayError {
    /// Nobody listens.
    #[error("no other twum of yours holds it")]
    Nobody,
    /// The socket is not this user's.
    #[error("{} belongs to another user: it is not trusted", .0.display())]
    Foreign(PathBuf),
    /// The other program did not pass it on, or the board did not answer.
    #[error("the program that holds it: {0}")]
    Failed(String),
}

/// Lends the board to who asks over the stream for what the text says, once it has said so over it ([`lent`]); or says why not.
pub type Lender = Arc<dyn Fn(UnixStream, &str) -> Result<(), String> + Send + Sync>;

/// Says over the stream that the board is lent.
///
/// # Errors
/// Whoever asked is gone.
pub fn lent(mut stream: &UnixStream) -> std::io::Result<()> {
    writeln!(stream, "{LENT}")
}

/// The directory of sockets, made if need be: private to its owner.
fn directory() -> std::io::Result<PathBuf> {
    let base = match std::env::var_os("XDG_RUNTIME_DIR") {
        Some(runtime) => PathBuf::from(runtime).join("twum"),
        None => std::env::temp_dir().join(format!("twum-{}", std::env::var("USER").unwrap_or_default())),
    };
    match std::fs::DirBuilder::new().mode(0o700).create(&base) {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let about = std::fs::symlink_metadata(&base)?;
    if !about.is_dir() || about.permissions().mode() & 0o077 != 0 {
        return Err(std::io::Error::other(format!("{} is open to others", base.display())));
    }
    Ok(base)
}

/// The socket for a port.
fn socket(directory: &Path, port: &str) -> PathBuf {
    let port = std::fs::canonicalize(port).unwrap_or_else(|_| PathBuf::from(port));
    let name: String =
        port.to_string_lossy().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    directory.join(format!("{name}.sock"))
}

/// What came in on the socket.
enum Request {
    /// A question, and where the answer goes.
    Ask(Asked, Sender<String>),
    /// Somebody watches from here on.
    Watch(SyncSender<Vec<u8>>),
}

/// A request the board has not answered yet.
struct Waiting {
    asked: Asked,
    answer: Sender<String>,
    sequences: std::ops::Range<u32>,
    since: Instant,
    sent: Instant,
}

/// A port that other programs reach too.
pub struct Relay<P> {
    port: P,
    socket: Option<PathBuf>,
    requests: Option<Receiver<Request>>,
    waiting: Vec<Waiting>,
    watching: Vec<SyncSender<Vec<u8>>>,
    decoder: Decoder,
    sequence: u32,
}

impl<P: Port> Relay<P> {
    /// Listens for what others ask of the board on `port`, which goes by `name`; a `lender` lends it too. Where no socket can be
    /// made the port works all the same.
    pub fn new(port: P, name: &str, lender: Option<Lender>) -> Self {
        let listening = directory().and_then(|directory| listen(&socket(&directory, name), lender));
        let (socket, requests) = listening.map_or((None, None), |(path, requests)| (Some(path), Some(requests)));
        Self {
            port,
            socket,
            requests,
            waiting: Vec::new(),
            watching: Vec::new(),
            decoder: Decoder::new(),
            sequence: FIRST_SEQUENCE,
        }
    }

    /// Sends what others asked for, again where it is not answered.
    fn pass_on(&mut self) -> Result<(), LinkError> {
        let now = Instant::now();
        while let Some(request) = self.requests.as_ref().and_then(|requests| requests.try_recv().ok()) {
            match request {
                Request::Watch(watcher) => self.watching.push(watcher),
                Request::Ask(asked, answer) => {
                    let sequences = self.sequence..self.sequence;
                    self.waiting.push(Waiting { asked, answer, sequences, since: now, sent: now - STOP_AGAIN });
                }
            }
        }
        self.waiting.retain(|waiting| waiting.since.elapsed() < PATIENCE);
        for waiting in self.waiting.iter_mut().filter(|waiting| waiting.sent.elapsed() >= STOP_AGAIN) {
            let mut buffer = [0; MAX_ENCODED];
            let header = Header { sequence: self.sequence, time_us: 0 };
            let frame =
                frame::encode(header, &waiting.asked.message(), &mut buffer).expect("a stop and a hello fit a frame");
            self.port.send(frame)?;
            self.sequence = self.sequence.wrapping_add(1).max(FIRST_SEQUENCE);
            (waiting.sequences.end, waiting.sent) = (self.sequence, now);
        }
        Ok(())
    }

    /// Looks for the board's answers in what it sends, and passes it to who watches.
    fn look(&mut self, bytes: &[u8]) {
        self.watching.retain(|watcher| !matches!(watcher.try_send(bytes.to_vec()), Err(TrySendError::Disconnected(_))));
        if self.waiting.is_empty() {
            return;
        }
        for &byte in bytes {
            let Some(Ok((_, message))) = self.decoder.push::<DeviceMessage>(byte) else { continue };
            self.waiting.retain(|waiting| {
                let answer = match (&message, waiting.asked) {
                    (DeviceMessage::Ack { of }, Asked::Stop) if waiting.sequences.contains(of) => {
                        "\"stopped\"".to_owned()
                    }
                    (DeviceMessage::Hello(identity), Asked::Hello) => {
                        serde_json::to_string(identity).expect("an identity is plain data")
                    }
                    _ => return true,
                };
                // Whoever asked may be gone.
                let _ = waiting.answer.send(answer);
                false
            });
        }
    }
}

impl<P: Port> Port for Relay<P> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.port.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let deadline = Instant::now() + wait;
        let before = into.len();
        loop {
            self.pass_on()?;
            let left = deadline.saturating_duration_since(Instant::now());
            self.port.receive(into, left.min(SLICE))?;
            if into.len() > before || left.is_zero() {
                self.look(&into[before..]);
                return Ok(());
            }
        }
    }

    fn elapsed(&self) -> Duration {
        self.port.elapsed()
    }

    fn is_virtual(&self) -> bool {
        self.port.is_virtual()
    }
}

impl<P> Drop for Relay<P> {
    fn drop(&mut self) {
        if let Some(socket) = &self.socket {
            let _ = std::fs::remove_file(socket);
        }
    }
}

/// Listens on a socket in a thread of its own, until the program ends.
fn listen(path: &Path, lender: Option<Lender>) -> std::io::Result<(PathBuf, Receiver<Request>)> {
    let listener = match UnixListener::bind(path) {
        Ok(listener) => listener,
        // Left behind by a program that was killed: whoever listened would hold the port, and we would not.
        Err(error) if error.kind() == ErrorKind::AddrInUse => {
            std::fs::remove_file(path)?;
            UnixListener::bind(path)?
        }
        Err(error) => return Err(error),
    };
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (sender, lender) = (sender.clone(), lender.clone());
            // Whoever asks may be gone before the answer.
            std::thread::spawn(move || _ = serve(&stream, &sender, lender.as_ref()));
        }
    });
    Ok((path.to_owned(), receiver))
}

fn serve(mut stream: &UnixStream, requests: &Sender<Request>, lender: Option<&Lender>) -> std::io::Result<()> {
    stream.set_read_timeout(Some(Duration::from_millis(200)))?;
    stream.set_write_timeout(Some(Duration::from_millis(200)))?;
    let mut line = String::new();
    BufReader::new(stream.take(LINE)).read_line(&mut line)?;
    if line.trim() == WATCH {
        return show(stream, requests);
    }
    if let Some(what) = line.trim().strip_prefix(BORROW) {
        let asked = match lender {
            Some(lender) => lender(stream.try_clone()?, what),
            None => Err("it makes a run of its own, and lends the port to nobody".to_owned()),
        };
        return asked.or_else(|why| writeln!(stream, "{}", serde_json::json!({ "error": why })));
    }
    let known = [Asked::Stop, Asked::Hello].into_iter().find(|asked| asked.word() == line.trim());
    let answer = match known {
        None => "{\"error\":\"not understood\"}".to_owned(),
        Some(asked) => {
            let (answer, answered) = channel();
            let failed = |reason: &str| format!("{{\"error\":\"{reason}\"}}");
            match requests.send(Request::Ask(asked, answer)) {
                Err(_) => failed("it no longer holds the port"),
                Ok(()) => answered.recv_timeout(PATIENCE).unwrap_or_else(|_| failed("the board did not answer")),
            }
        }
    };
    writeln!(stream, "{answer}")
}

/// Passes on what the board sends until one of both is gone.
fn show(mut stream: &UnixStream, requests: &Sender<Request>) -> std::io::Result<()> {
    let (watcher, seen) = sync_channel(WATCHED);
    if requests.send(Request::Watch(watcher)).is_ok() {
        for bytes in seen {
            stream.write_all(&bytes)?;
        }
    }
    Ok(())
}

/// Connects to the program that holds the port, and says one line.
fn connect(port: &str, line: &str) -> Result<UnixStream, RelayError> {
    let failed = |error: std::io::Error| RelayError::Failed(error.to_string());
    let directory = directory().map_err(failed)?;
    let path = socket(&directory, port);
    let owner = |path: &Path| std::fs::symlink_metadata(path).map(|about| about.uid());
    let (Ok(of_socket), Ok(of_directory)) = (owner(&path), owner(&directory)) else { return Err(RelayError::Nobody) };
    if of_socket != of_directory {
        return Err(RelayError::Foreign(path));
    }
    let stream = UnixStream::connect(&path).map_err(|_| RelayError::Nobody)?;
    writeln!(&stream, "{line}").map_err(failed)?;
    Ok(stream)
}

/// Asks through the program that holds the port.
fn ask(port: &str, asked: Asked) -> Result<serde_json::Value, RelayError> {
    let failed = |error: std::io::Error| RelayError::Failed(error.to_string());
    let stream = connect(port, asked.word())?;
    stream.set_read_timeout(Some(PATIENCE + Duration::from_millis(500))).map_err(failed)?;
    let mut answer = String::new();
    BufReader::new(stream.take(ANSWER)).read_line(&mut answer).map_err(failed)?;
    understood(&answer)
}

/// A line that the other program answered with.
fn understood(answer: &str) -> Result<serde_json::Value, RelayError> {
    let answer: serde_json::Value =
        serde_json::from_str(answer).map_err(|_| RelayError::Failed("it gave no answer".to_owned()))?;
    match answer.get("error") {
        Some(error) => Err(RelayError::Failed(error.as_str().unwrap_or_default().to_owned())),
        None => Ok(answer),
    }
}

/// Borrows the board of the program that holds the port, for what the text says.
///
/// # Errors
/// Nobody of this user holds the port, or who does so needs it.
pub fn borrow(port: &str, what: &str) -> Result<Borrowed, RelayError> {
    let failed = |error: std::io::Error| RelayError::Failed(error.to_string());
    let what: String = what.chars().take(32).collect();
    let stream = connect(port, &format!("{BORROW}{what}"))?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
    let (mut answer, mut byte) = (Vec::new(), [0]);
    // Byte by byte: what follows the line is the board's.
    while byte != *b"\n" && answer.len() < ANSWER as usize {
        (&stream).read_exact(&mut byte).map_err(failed)?;
        answer.extend(byte);
    }
    understood(&String::from_utf8_lossy(&answer))?;
    Borrowed::new(port, stream).map_err(failed)
}

/// What a board says to the program that holds its port.
pub struct Watching {
    stream: UnixStream,
    decoder: Decoder,
}

impl Watching {
    /// What came within `wait`; none once the other program no longer holds the port.
    pub fn next(&mut self, wait: Duration) -> Option<Vec<Received>> {
        let mut bytes = [0; 4096];
        let read = self.stream.set_read_timeout(Some(wait)).and_then(|()| self.stream.read(&mut bytes));
        let length = match read {
            Ok(0) => return None,
            Ok(length) => length,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => 0,
            Err(_) => return None,
        };
        let frames = bytes[..length].iter().filter_map(|&byte| self.decoder.push::<DeviceMessage>(byte)?.ok());
        Some(frames.map(|(header, message)| Received { header, message }).collect())
    }
}

/// Watches a board through the program that holds its port.
///
/// # Errors
/// Nobody of this user holds the port.
pub fn watch_through(port: &str) -> Result<Watching, RelayError> {
    Ok(Watching { stream: connect(port, WATCH)?, decoder: Decoder::new() })
}

/// Stops the motor through the program that holds the port; the board has acknowledged it.
///
/// # Errors
/// Nobody of this user holds the port, or the board does not answer.
pub fn stop_through(port: &str) -> Result<(), RelayError> {
    ask(port, Asked::Stop).map(|_| ())
}

/// Who the board is, through the program that holds the port.
///
/// # Errors
/// As [`stop_through`].
pub fn hello_through(port: &str) -> Result<Identity, RelayError> {
    let answer = ask(port, Asked::Hello)?;
    serde_json::from_value(answer).map_err(|error| RelayError::Failed(error.to_string()))
}
