//! A board on a serial port. What it says is read on a thread of its own: whoever looks at a terminal on Linux, be it with a timeout of a
//! millisecond or to write, waits for the kernel's worker that hands over what has arrived, and on a busy machine that comes late by tenths of
//! a second. A stop waits for nothing that is to be read.

use super::{LinkError, Port, elapsed};
use rustix::fs::{Mode, OFlags, open};
use serialport::SerialPort;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Baud rate of the link.
pub const BAUD: u32 = 921_600;
/// The reader looks this often whether it is still wanted: a port that is closed is free for another program as soon.
const WANTED: Duration = Duration::from_millis(5);
/// Pieces that may wait to be taken, a quarter of a second of a piece each millisecond; what is left longer waits in the kernel, which drops
/// what is too much.
const WAITING: usize = 256;
/// A line that takes nothing for so long is lost.
const TAKEN: Duration = Duration::from_secs(2);
/// A line that takes nothing is tried again this often.
const AGAIN: Duration = Duration::from_millis(1);

/// A board on a serial port or pseudo-terminal.
pub struct SerialLink {
    name: String,
    line: Box<dyn Write + Send>,
    pieces: Option<Receiver<io::Result<Vec<u8>>>>,
    is_closed: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl SerialLink {
    /// Opens a port, with both control lines released: either one can hold an ESP32 in reset or its boot loader. With
    /// `reset` the board is reset through RTS first.
    ///
    /// # Errors
    /// [`LinkError::Open`], with what to do.
    pub fn open(name: &str, reset: bool) -> Result<Self, LinkError> {
        let cannot = |reason: String| LinkError::Open { port: name.to_owned(), reason };
        let line = straight_to(name);
        let mut port = serialport::new(name, BAUD)
            .timeout(WANTED)
            .dtr_on_open(false)
            .open_native()
            .map_err(|error| cannot(explain(name, &error)))?;
        // A pseudo-terminal has no control lines; what it answers does not matter.
        let _ = port.write_data_terminal_ready(false);
        if reset {
            let _ = port.write_request_to_send(true);
            std::thread::sleep(Duration::from_millis(100));
        }
        let _ = port.write_request_to_send(false);
        elapsed();
        line.and_then(|line| Self::over(name, port, line)).map_err(|error| cannot(error.to_string()))
    }

    /// A link over both halves of a line, of which `from` gives up a read from time to time.
    fn over(name: &str, from: impl Read + Send + 'static, to: impl Write + Send + 'static) -> io::Result<Self> {
        let (sender, pieces) = sync_channel(WAITING);
        let is_closed = Arc::new(AtomicBool::new(false));
        let inner = is_closed.clone();
        let reader = std::thread::Builder::new().name("line".to_owned()).spawn(move || read(from, &sender, &inner))?;
        Ok(Self { name: name.to_owned(), line: Box::new(to), pieces: Some(pieces), is_closed, reader: Some(reader) })
    }

    fn lost(&self, reason: &io::Error) -> LinkError {
        LinkError::Lost { port: self.name.clone(), reason: reason.to_string() }
    }
}

impl Drop for SerialLink {
    fn drop(&mut self) {
        self.is_closed.store(true, Ordering::Relaxed);
        self.pieces = None;
        // Until it is gone the port is in use.
        let _ = self.reader.take().map(JoinHandle::join);
    }
}

/// A way straight to the port, on which nothing is looked at before: where it takes nothing, that is said at once. It has to be there before
/// the port is locked; a port that is in use, or none, is told of by whoever locks it.
fn straight_to(name: &str) -> io::Result<File> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    Ok(open(name, flags, Mode::empty())?.into())
}

fn is_for_later(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Reads until the line is lost, which is said last, or the link is closed.
fn read(mut from: impl Read, pieces: &SyncSender<io::Result<Vec<u8>>>, is_closed: &AtomicBool) {
    let mut buffer = [0; 4096];
    while !is_closed.load(Ordering::Relaxed) {
        let piece = match from.read(&mut buffer) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(length) => Ok(buffer[..length].to_vec()),
            Err(error) if is_for_later(&error) => continue,
            Err(error) => Err(error),
        };
        let is_lost = piece.is_err();
        if pieces.send(piece).is_err() || is_lost {
            return;
        }
    }
}

fn explain(name: &str, error: &serialport::Error) -> String {
    use serialport::ErrorKind as Kind;
    let advice = match error.kind() {
        Kind::NoDevice if std::path::Path::new(name).exists() => "it is in use by another program; close that one",
        Kind::NoDevice | Kind::Io(ErrorKind::NotFound) => "no such port; `twum ports` lists those there are",
        Kind::Io(ErrorKind::PermissionDenied) => "permission denied; join the group that owns it (often `dialout`)",
        _ => "",
    };
    if advice.is_empty() { error.to_string() } else { format!("{advice} ({error})") }
}

impl Port for SerialLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let mut rest = bytes;
        let deadline = Instant::now() + TAKEN;
        while !rest.is_empty() {
            match self.line.write(rest) {
                Ok(0) => std::thread::sleep(AGAIN),
                Ok(written) => rest = &rest[written..],
                Err(error) if is_for_later(&error) && Instant::now() <= deadline => std::thread::sleep(AGAIN),
                Err(error) => return Err(self.lost(&error)),
            }
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        // What has arrived a moment ago is still on its way between the threads.
        let wait = wait.max(Duration::from_millis(1));
        match self.pieces.as_ref().map(|pieces| pieces.recv_timeout(wait)) {
            Some(Ok(Ok(piece))) => {
                into.extend_from_slice(&piece);
                Ok(())
            }
            Some(Err(RecvTimeoutError::Timeout)) => Ok(()),
            Some(Ok(Err(reason))) => Err(self.lost(&reason)),
            Some(Err(RecvTimeoutError::Disconnected)) | None => Err(self.lost(&ErrorKind::NotConnected.into())),
        }
    }

    fn elapsed(&self) -> Duration {
        elapsed()
    }

    fn is_virtual(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::super::Session;
    use super::*;
    use std::sync::Mutex;
    use twum_shared::frame::{self, Decoder, Header, MAX_ENCODED};
    use twum_shared::message::{self, DeviceMessage, HostMessage, Status};
    use twum_shared::{Direction, Duty};

    /// How long nothing that has arrived is handed over: what the kernel's worker was late by on a busy machine.
    const HELD: Duration = Duration::from_secs(1);

    /// What a board heard, and when.
    #[derive(Clone, Default)]
    struct Heard(Arc<Mutex<Vec<(Instant, Header, HostMessage)>>>);

    impl Heard {
        fn times(&self, wanted: fn(&HostMessage) -> bool) -> Vec<Instant> {
            self.0.lock().unwrap().iter().filter(|(_, _, message)| wanted(message)).map(|(at, ..)| *at).collect()
        }
    }

    /// The way to a board that takes everything.
    struct To(Heard, Decoder);

    impl Write for To {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            for &byte in bytes {
                if let Some(Ok((header, message))) = self.1.push::<HostMessage>(byte) {
                    self.0.0.lock().unwrap().push((Instant::now(), header, message));
                }
            }
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// The way back, on which nothing is handed over before a time; then that the motor stands, and that a stop was taken.
    struct Back(Heard, Instant, u32);

    impl Back {
        fn say(&mut self, message: &DeviceMessage) -> Vec<u8> {
            self.2 += 1;
            let header = Header { sequence: self.2, time_us: u64::from(self.2) };
            frame::encode(header, message, &mut [0; MAX_ENCODED]).unwrap().to_vec()
        }
    }

    impl Read for Back {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            std::thread::sleep(self.1.saturating_duration_since(Instant::now()).max(Duration::from_millis(1)));
            let heard = self.0.0.lock().unwrap().clone();
            let stop = heard.iter().rev().find(|(_, _, message)| matches!(message, HostMessage::Stop { .. }));
            let acknowledged = stop.map(|(_, header, _)| DeviceMessage::Ack { of: header.sequence });
            let idle = Status {
                mode: message::Mode::Idle,
                fault: None,
                position: 0,
                duty: Duty::OFF,
                direction: Direction::Cw,
                ticks: 0,
                late_ticks: 0,
                worst_late_us: 0,
                worst_duration_us: 0,
                edges: 0,
                lost_items: 0,
                bad_frames: 0,
            };
            let mut said = acknowledged.map(|message| self.say(&message)).unwrap_or_default();
            said.extend(self.say(&DeviceMessage::Status(idle)));
            into[..said.len()].copy_from_slice(&said);
            Ok(said.len())
        }
    }

    /// Fails where the thread that stops is the one that reads: it said one sign of life and one stop, and the next when the worker let it.
    #[test]
    fn neither_a_stop_nor_an_interruption_waits_for_what_is_to_be_read() {
        static INTERRUPTED: AtomicBool = AtomicBool::new(false);
        let (heard, handed_over) = (Heard::default(), Instant::now() + HELD);
        let link = SerialLink::over("line", Back(heard.clone(), handed_over, 0), To(heard.clone(), Decoder::new()));
        let mut session = Session::new(link.unwrap());
        session.interrupt_by(&INTERRUPTED);
        session.hold(true);
        std::thread::spawn(|| {
            std::thread::sleep(HELD / 4);
            INTERRUPTED.store(true, Ordering::Relaxed);
        });
        assert!(matches!(session.next(Duration::from_secs(60)), Err(LinkError::Interrupted)));
        assert!(Instant::now() < handed_over, "the interruption waited");
        session.halt().unwrap();
        assert!(Instant::now() >= handed_over, "the acknowledgement came before");
        let before = |times: Vec<Instant>| times.into_iter().filter(|at| *at < handed_over).count();
        let alive = before(heard.times(|message| matches!(message, HostMessage::Keepalive { .. })));
        let stops = before(heard.times(|message| matches!(message, HostMessage::Stop { .. })));
        // 8 and 75 on a machine that does nothing else.
        assert!(alive >= 3 && stops >= 10, "{alive} signs of life, {stops} stops");
    }

    #[test]
    fn a_line_that_is_lost_says_why_once_it_was_read_to_its_end() {
        let mut link = SerialLink::over("line", &b"last words"[..], io::sink()).unwrap();
        let mut read = Vec::new();
        let lost = (0..1_000).find_map(|_| link.receive(&mut read, Duration::from_millis(5)).err()).expect("an end");
        assert_eq!(read, b"last words");
        assert!(matches!(lost, LinkError::Lost { port, .. } if port == "line"));
        assert!(link.receive(&mut read, Duration::ZERO).is_err(), "it stays lost");
    }
}
