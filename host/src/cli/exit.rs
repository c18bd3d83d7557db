//! What an exit code says, for every command.

use std::process::ExitCode;
use twum_host::link::LinkError;

/// The table, as `twum --help` prints it.
pub const TABLE: &str = "\
Exit codes:
  0    done, and the answer is yes where there was a question
  1    done, and the answer is no: a controller differs, frames were lost, no resonance
  2    not done: bad arguments or files, a port or a disk that failed
  3    a fault stopped the motor
  4    ended early by something else: another program stopped the run, or the board restarted
  130  interrupted; what was recorded or computed until then is kept
  101  a mistake of this program: please report it";

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done; yes.
    Done = 0,
    /// Done; no.
    No = 1,
    /// Not done.
    Failed = 2,
    /// A fault stopped the motor.
    Fault = 3,
    /// The run was ended by somebody else, or by a restart of the board.
    CutShort = 4,
    /// The user ended it.
    Interrupted = 130,
}

impl Exit {
    /// What an error says.
    pub fn of(error: &anyhow::Error) -> Self {
        let link = error.chain().find_map(|cause| cause.downcast_ref::<LinkError>());
        match link {
            Some(LinkError::Fault(_)) => Self::Fault,
            Some(LinkError::Restarted) => Self::CutShort,
            Some(LinkError::Interrupted) => Self::Interrupted,
            _ => Self::Failed,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}
