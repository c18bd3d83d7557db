//! Lending a board to another program: the one that holds its port passes the bytes of both directions on, so that a command in
//! a terminal does there what it does at the port itself, recording where it was told to.
//!
//! The lender stays the guard of the motor. However the loan ends, and first of all when the other program is gone, it stops the
//! motor. It keeps nothing alive for the other program: one that is frozen lets the board's command timeout run out.

use super::stopping::STOP_AGAIN;
use super::{LinkError, Port, Session, elapsed};
use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};
use twum_shared::frame::{self, Decoder, MAX_ENCODED};
use twum_shared::message::{DeviceMessage, HostMessage};

/// What the other program says is looked for this often.
const SLICE: Duration = Duration::from_millis(2);
/// What may wait for the other program, bytes: some ten seconds of every stream. What it leaves longer it would miss.
const BEHIND: usize = 1 << 20;
/// A program whose run was stopped finishes its recording and puts the configuration right within this time.
const FINISHING: Duration = Duration::from_millis(2_500);
/// A program that takes no bytes for so long is gone.
const TAKEN: Duration = Duration::from_secs(2);

/// How a loan ended. The motor is off then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Returned {
    /// The other program is done, or gone.
    ByTheOther,
    /// The lender took it back.
    TakenBack,
    /// The other program did not take what the board said.
    Behind,
}

/// A loan that is being taken back.
struct Stopping {
    since: Instant,
    sent: Instant,
    sequences: Vec<u32>,
    acknowledged: bool,
}

/// What is under way between both.
#[derive(Default)]
struct Loan {
    to_other: Vec<u8>,
    block: Vec<u8>,
    decoder: Decoder,
    stopping: Option<Stopping>,
}

impl<P: Port> Session<P> {
    /// Lends the board to the program at the other end of `stream` until one of both ends it. Once `is_taken_back` says so the
    /// motor is stopped at once, what sets anything in motion is not passed on any more, and the other program has some time
    /// to finish.
    ///
    /// # Errors
    /// When the port is gone, or the motor was not seen to stand.
    pub fn lend(&mut self, stream: &UnixStream, is_taken_back: impl Fn() -> bool) -> Result<Returned, LinkError> {
        self.hold(true);
        let returned = self.pass_between(stream, is_taken_back);
        // Whoever is gone needs not be told.
        let _ = stream.shutdown(Shutdown::Both);
        self.halt()?;
        returned
    }

    fn pass_between(
        &mut self,
        mut stream: &UnixStream,
        is_taken_back: impl Fn() -> bool,
    ) -> Result<Returned, LinkError> {
        if stream.set_nonblocking(true).is_err() {
            return Ok(Returned::ByTheOther);
        }
        let (mut loan, mut buffer) = (Loan::default(), [0; 4096]);
        loop {
            match stream.read(&mut buffer) {
                Ok(0) => return Ok(Returned::ByTheOther),
                Ok(length) => self.pass_to_the_board(&mut loan, &buffer[..length])?,
                Err(error) if is_for_later(&error) => {}
                Err(_) => return Ok(Returned::ByTheOther),
            }
            if (loan.stopping.is_some() || is_taken_back()) && self.take_back(&mut loan)? {
                return Ok(Returned::TakenBack);
            }
            let before = loan.to_other.len();
            self.port.receive(&mut loan.to_other, SLICE)?;
            loan.look(before);
            match stream.write(&loan.to_other) {
                Ok(length) => _ = loan.to_other.drain(..length),
                Err(error) if is_for_later(&error) => {}
                Err(_) => return Ok(Returned::ByTheOther),
            }
            if loan.to_other.len() > BEHIND {
                return Ok(Returned::Behind);
            }
        }
    }

    /// Whole frames only: between two of the other program's a stop goes out undamaged.
    fn pass_to_the_board(&mut self, loan: &mut Loan, bytes: &[u8]) -> Result<(), LinkError> {
        for &byte in bytes {
            loan.block.push(byte);
            if byte == 0 {
                if loan.stopping.is_none() || moves_nothing(&loan.block) {
                    self.port.send(&loan.block)?;
                }
                loan.block.clear();
            } else if loan.block.len() > MAX_ENCODED {
                // No frame is that long.
                loan.block.clear();
            }
        }
        Ok(())
    }

    /// Stops the motor; whether the other program's time is up.
    fn take_back(&mut self, loan: &mut Loan) -> Result<bool, LinkError> {
        let now = Instant::now();
        let stopping = loan.stopping.get_or_insert_with(|| Stopping {
            since: now,
            sent: now - STOP_AGAIN,
            sequences: Vec::new(),
            acknowledged: false,
        });
        if !stopping.acknowledged && stopping.sent.elapsed() >= STOP_AGAIN {
            stopping.sequences.push(self.send(&HostMessage::Stop { clear_fault: false })?);
            stopping.sent = now;
        }
        Ok(stopping.since.elapsed() > FINISHING)
    }
}

impl Loan {
    /// Looks for the board's acknowledgement of a stop in what came from `before` on.
    fn look(&mut self, before: usize) {
        for &byte in &self.to_other[before..] {
            let Some(Ok((_, DeviceMessage::Ack { of }))) = self.decoder.push::<DeviceMessage>(byte) else { continue };
            if let Some(stopping) = self.stopping.as_mut().filter(|stopping| stopping.sequences.contains(&of)) {
                stopping.acknowledged = true;
            }
        }
    }
}

fn is_for_later(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Whether a block is a frame that sets nothing in motion: what ends a run and puts the configuration right.
fn moves_nothing(block: &[u8]) -> bool {
    let mut frame = block[..block.len() - 1].to_vec();
    let Ok((_, message)) = frame::decode::<HostMessage>(&mut frame) else { return false };
    matches!(
        message,
        HostMessage::Stop { .. } | HostMessage::Capture(_) | HostMessage::Hello | HostMessage::Configure(_)
    )
}

/// A board that another program lends: see [`super::relay::borrow`].
pub struct Borrowed {
    name: String,
    stream: UnixStream,
}

impl Borrowed {
    /// The board on the port of this name, lent over a stream.
    pub(super) fn new(name: &str, stream: UnixStream) -> std::io::Result<Self> {
        stream.set_write_timeout(Some(TAKEN))?;
        Ok(Self { name: name.to_owned(), stream })
    }

    fn lost(&self, reason: &str) -> LinkError {
        LinkError::Lost { port: self.name.clone(), reason: reason.to_owned() }
    }
}

impl Port for Borrowed {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.stream.write_all(bytes).map_err(|error| self.lost(&format!("the program that lent it: {error}")))
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let mut buffer = [0; 4096];
        // No time at all would be for ever.
        let wait = wait.max(Duration::from_millis(1));
        let read = self.stream.set_read_timeout(Some(wait)).and_then(|()| self.stream.read(&mut buffer));
        match read {
            Ok(0) => Err(self.lost("the program that lent it has taken it back")),
            Ok(length) => {
                into.extend_from_slice(&buffer[..length]);
                Ok(())
            }
            Err(error) if is_for_later(&error) || error.kind() == ErrorKind::TimedOut => Ok(()),
            Err(error) => Err(self.lost(&format!("the program that lent it: {error}"))),
        }
    }

    fn elapsed(&self) -> Duration {
        elapsed()
    }

    fn is_virtual(&self) -> bool {
        false
    }
}
