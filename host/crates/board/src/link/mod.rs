//! How the host reaches a board: serial port, pseudo-terminal, in memory.
//!
//! A [`Port`] moves bytes and has a clock; a [`Session`] speaks the protocol over it, keeps count of what was lost, and
//! writes every frame it sees into a recording.

pub mod bench;
mod commands;
mod loan;
mod pty;
mod readback;
mod recorder;
pub mod relay;
mod serial;
pub mod series;
mod session;
mod simulated;
mod stopping;

pub use loan::{Borrowed, Returned};
pub use pty::{PseudoTerminal, serve};
pub use serial::{BAUD, SerialLink};
pub use session::{Received, RunReport, Session, Tally, is_motor_held};
pub use simulated::SimulatedLink;

use std::sync::OnceLock;
use std::time::{Duration, Instant};
use thiserror::Error;
use twum_shared::Fault;
use twum_shared::frame::PROTOCOL_VERSION;
use twum_shared::message::Refusal;

/// A byte stream to a board, with the clock that goes with it.
pub trait Port {
    /// Sends bytes.
    ///
    /// # Errors
    /// [`LinkError::Lost`] when the port is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Appends what has arrived to `into`, waiting up to `wait` for the first byte.
    ///
    /// # Errors
    /// [`LinkError::Lost`] when the port is gone.
    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError>;

    /// Time of the link: this computer's, or virtual. It goes on when a lost port is opened again.
    fn elapsed(&self) -> Duration;

    /// Whether [`Port::elapsed`] is virtual.
    fn is_virtual(&self) -> bool;
}

impl Port for Box<dyn Port> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        (**self).send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        (**self).receive(into, wait)
    }

    fn elapsed(&self) -> Duration {
        (**self).elapsed()
    }

    fn is_virtual(&self) -> bool {
        (**self).is_virtual()
    }
}

/// Time since the first port was opened: it goes on across a cable that is pulled and plugged in again, and a port that is lent.
fn elapsed() -> Duration {
    static FIRST_OPENED: OnceLock<Instant> = OnceLock::new();
    FIRST_OPENED.get_or_init(Instant::now).elapsed()
}

/// What can go wrong between host and board.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The port could not be opened.
    #[error("cannot open {port}: {reason}")]
    Open {
        /// Its name.
        port: String,
        /// Why, and what to do.
        reason: String,
    },
    /// The port went away while it was in use.
    #[error("lost {port}: {reason}")]
    Lost {
        /// Its name.
        port: String,
        /// The system's reason.
        reason: String,
    },
    /// Nothing answered.
    #[error("no answer within {waited_ms} ms: is this the right port, and is the board powered and flashed?")]
    NoAnswer {
        /// How long was waited.
        waited_ms: u64,
    },
    /// The device speaks another protocol.
    #[error(
        "the device speaks protocol version {0}, this program version {PROTOCOL_VERSION}: flash the firmware that belongs to it"
    )]
    Version(u8),
    /// A command was refused.
    #[error("{command} was refused: {reason}")]
    Refused {
        /// The command.
        command: &'static str,
        /// Why.
        reason: Refusal,
    },
    /// A fault stopped the motor.
    #[error("fault {0:?}: {0}; `twum stop` clears it")]
    Fault(Fault),
    /// A fault was latched before anything was asked for.
    #[error("nothing was started: {0:?} is latched: {0}; `twum stop` clears it")]
    Latched(Fault),
    /// Somebody else stopped the motor.
    #[error("the motor was stopped by somebody else")]
    StoppedByOther,
    /// The board started anew in the middle of it.
    #[error("the board restarted; its motor is off, and nothing goes on by itself (`twum info` says why it restarted)")]
    Restarted,
    /// The motor was not seen to stand.
    #[error(
        "the motor was not seen to stand: {0}. A board that hears nothing switches off by itself within its command timeout; \
         look at the motor, and cut its power if it turns"
    )]
    NotStopped(&'static str),
    /// The recording cannot be written.
    #[error(transparent)]
    Store(#[from] twum_record::store::StoreError),
    /// The user asked to stop.
    #[error("interrupted")]
    Interrupted,
}
