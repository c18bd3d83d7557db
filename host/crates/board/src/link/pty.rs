use crate::sim::{Board, Setup};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{FdFlags, fcntl_setfd};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The board catches up with real time in slices of this length.
const SLICE: Duration = Duration::from_millis(2);
/// Bytes kept for a reader that does not read, about 3 s of a full line; more are dropped, as a UART would.
const BACKLOG_BYTES: usize = 1 << 18;

/// A pseudo-terminal in the place of a board's serial line.
pub struct PseudoTerminal {
    /// The board's end. It waits for nobody: a board goes on while its host reads nothing, or is gone.
    pub board: File,
    /// What the host opens.
    pub name: String,
    /// The host's end stays open, so that one host may close it and another open it and its name is nobody else's.
    pub kept_open: File,
}

impl PseudoTerminal {
    /// A new one.
    ///
    /// # Errors
    /// When the system gives none.
    pub fn open() -> io::Result<Self> {
        let board = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&board)?;
        unlockpt(&board)?;
        let name = ptsname(&board, Vec::new())?.into_string().map_err(io::Error::other)?;
        let mut settings = tcgetattr(&board)?;
        settings.make_raw();
        tcsetattr(&board, OptionalActions::Now, &settings)?;
        fcntl_setfl(&board, OFlags::NONBLOCK)?;
        // What the program starts may outlive it, and then nobody would be told that the line is gone.
        fcntl_setfd(&board, FdFlags::CLOEXEC)?;
        // A plain file, without the lock of a serial port, which would keep every host out; nobody's terminal.
        let kept_open = open(&name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        Ok(Self { board: board.into(), name, kept_open: kept_open.into() })
    }
}

/// Serves a simulated board in real time on a new pseudo-terminal until `stop` is set; `announce` is told its name.
///
/// # Errors
/// When the system gives no pseudo-terminal.
pub fn serve(setup: Setup, stop: &AtomicBool, announce: impl FnOnce(&str)) -> io::Result<()> {
    let mut line = PseudoTerminal::open()?;
    announce(&line.name);

    let mut board = Board::new(setup);
    let start_us = board.now_us();
    let started = Instant::now();
    let mut backlog: Vec<u8> = Vec::new();
    let mut buffer = [0; 4096];
    while !stop.load(Ordering::Relaxed) {
        // Before the line is heard: a board goes no further than it has heard, and the kernel may be long about handing over what has arrived.
        let now_us = start_us + started.elapsed().as_micros() as u64;
        match line.board.read(&mut buffer) {
            Ok(length) => board.send(&buffer[..length]),
            Err(error) if is_idle(&error) => {}
            Err(error) => return Err(error),
        }
        board.run_until(now_us);
        board.received(&mut backlog);
        if !backlog.is_empty() {
            match line.board.write(&backlog) {
                Ok(written) => {
                    backlog.drain(..written);
                }
                Err(error) if is_idle(&error) => {}
                Err(error) => return Err(error),
            }
        }
        let excess = backlog.len().saturating_sub(BACKLOG_BYTES);
        backlog.drain(..excess);
        let slice = SLICE.saturating_sub(Duration::from_micros(100));
        std::thread::sleep(slice);
    }
    Ok(())
}

fn is_idle(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;
    use twum_shared::frame::{self, Header, MAX_ENCODED};
    use twum_shared::message::HostMessage;

    /// Fails when the board waits for a host that is frozen: its clock, and with it the command timeout, stood still until somebody read on,
    /// and it could not be ended.
    #[test]
    fn a_host_that_reads_nothing_does_not_hold_the_board_up() {
        let stop: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
        let (named, name) = channel();
        let (ended, end) = channel();
        std::thread::spawn(move || {
            serve(Setup::default(), stop, |name| named.send(name.to_owned()).unwrap()).unwrap();
            ended.send(()).unwrap();
        });
        let mut host = File::options().read(true).write(true).open(name.recv().unwrap()).unwrap();
        let hello = Header { sequence: 0, time_us: 0 };
        let mut buffer = [0; MAX_ENCODED];
        let hello = frame::encode(hello, &HostMessage::Hello, &mut buffer).unwrap();
        let hello = hello.repeat(10);
        // Each is answered by more than forty bytes; a pseudo-terminal holds 64 KiB at most.
        std::thread::spawn(move || {
            for _ in 0..200 {
                if host.write_all(&hello).is_err() {
                    // The board has been ended, and with it its line.
                    return;
                }
                std::thread::sleep(Duration::from_millis(4));
            }
        });
        std::thread::sleep(Duration::from_secs(1));
        stop.store(true, Ordering::Relaxed);
        assert!(end.recv_timeout(Duration::from_secs(10)).is_ok(), "it waits for its host");
    }
}
