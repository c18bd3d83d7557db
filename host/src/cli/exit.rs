//! Exit codes: what other programs read of a command that moves the motor.

use anyhow::{Error, Result};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU8, Ordering};
use twum_host::instruments::sweep::SweepError;
use twum_host::link::LinkError;
use twum_shared::message::Refusal;

/// The codes, for `twum --help`; docs/safety.md says the same.
pub const HELP: &str = "\
Exit codes: 0 done. 1 done, and the answer is no (frames lost, a tick differs, beyond a bound). 2 not done: bad input, no
port, refused. 3 a fault stopped the motor, or is latched; `twum stop` clears it. 4 somebody else's stop or the board's
restart ended the run. 5 the port was lost, or the motor was not seen to stand. 130 interrupted (Ctrl-C, TERM, HUP, QUIT).";

const BAD_INPUT: u8 = 2;
const FAULT: u8 = 3;
const ENDED_BY_OTHER: u8 = 4;
const NOT_SEEN_TO_STAND: u8 = 5;
/// As shells give it for SIGINT.
pub const INTERRUPTED: u8 = 130;

/// The code of an error.
pub fn code_of(error: &Error) -> u8 {
    let sweep = error.chain().find_map(|cause| cause.downcast_ref::<SweepError>());
    if matches!(sweep, Some(SweepError::Stopped { .. })) {
        return INTERRUPTED;
    }
    let link = error.chain().find_map(|cause| cause.downcast_ref::<LinkError>());
    match link {
        Some(LinkError::Fault(_) | LinkError::Latched(_) | LinkError::Refused { reason: Refusal::Fault(_), .. }) => {
            FAULT
        }
        Some(LinkError::StoppedByOther | LinkError::Restarted) => ENDED_BY_OTHER,
        Some(LinkError::Lost { .. } | LinkError::NotStopped(_)) => NOT_SEEN_TO_STAND,
        Some(LinkError::Interrupted) => INTERRUPTED,
        _ => BAD_INPUT,
    }
}

/// The code to end with should the reader of the output be gone.
static DECIDED: AtomicU8 = AtomicU8::new(0);

/// Decides the exit code before anything is printed: a closed pipe then changes nothing about it.
pub fn decide(verdict: &Result<u8>) {
    DECIDED.store(verdict.as_ref().map_or_else(code_of, |code| *code), Ordering::Relaxed);
}

/// What was decided; not done where nothing was, or where only the printing was left of it.
pub fn decided_or_failed() -> ExitCode {
    match DECIDED.load(Ordering::Relaxed) {
        0 => ExitCode::from(BAD_INPUT),
        code => ExitCode::from(code),
    }
}

/// What was decided; success where nothing was.
pub fn decided() -> ExitCode {
    ExitCode::from(DECIDED.load(Ordering::Relaxed))
}
