use crate::sim::{Board, Setup};
use serialport::{SerialPort, TTYPort};
use std::io::{self, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The board catches up with real time in slices of this length.
const SLICE: Duration = Duration::from_millis(2);
/// Bytes kept for a reader that does not read, about 3 s of a full line; more are dropped, as a UART would.
const BACKLOG_BYTES: usize = 1 << 18;

/// Serves a simulated board in real time on a new pseudo-terminal until `stop` is set; `announce` is told its name.
///
/// # Errors
/// When the system gives no pseudo-terminal.
pub fn serve(setup: Setup, stop: &AtomicBool, announce: impl FnOnce(&str)) -> io::Result<()> {
    let (mut master, mut slave) = TTYPort::pair().map_err(io::Error::other)?;
    let name = slave.name().ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
    slave.set_exclusive(false).map_err(io::Error::other)?;
    // The other end stays open, so that one host may close it and another open it, but as a plain file: a serial port takes
    // a lock that would keep every host out.
    let _kept_open = std::fs::File::options().read(true).write(true).open(&name)?;
    drop(slave);
    master.set_timeout(Duration::from_millis(1)).map_err(io::Error::other)?;
    announce(&name);

    let mut board = Board::new(setup);
    let start_us = board.now_us();
    let started = Instant::now();
    let mut backlog: Vec<u8> = Vec::new();
    let mut buffer = [0; 4096];
    while !stop.load(Ordering::Relaxed) {
        match master.read(&mut buffer) {
            Ok(length) => board.send(&buffer[..length]),
            Err(error) if is_idle(&error) => {}
            Err(error) => return Err(error),
        }
        board.run_until(start_us + started.elapsed().as_micros() as u64);
        board.received(&mut backlog);
        if !backlog.is_empty() {
            match master.write(&backlog) {
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
