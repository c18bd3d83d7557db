//! One experiment on a board, from hello to stop: what every command that moves or records does.

use super::{LinkError, Port, Received, RunReport, Session, Tally};
use crate::record::store::{Metadata, Writer};
use std::path::PathBuf;
use std::time::{Duration, Instant};
use twum_shared::message::{
    CaptureMode, Configuration, DeviceMessage, Identity, Mode, Refusal, RunEnd, SpeedRun, TrackRun,
};

/// The last blocks of a run arrive within this time of its end.
const TAIL: Duration = Duration::from_millis(500);
/// A run's end may come this much later than its duration.
const GRACE: Duration = Duration::from_secs(2);
/// A lost port is tried again this often.
const RETRY: Duration = Duration::from_millis(500);
/// A lost port is waited for so long: time to plug a cable in again.
pub const PORT_PATIENCE: Duration = Duration::from_secs(30);

/// What the board is to do.
#[derive(Clone, Debug)]
pub enum Action {
    /// Nothing: record what it streams for so long.
    Watch(Duration),
    /// Run at constant duty.
    Speed(SpeedRun),
    /// Track a reference.
    Track(TrackRun),
    /// Pass a line to the driver board and record until the motor stands.
    Driver(heapless::String<64>),
}

impl Action {
    fn moves(&self) -> bool {
        matches!(self, Self::Speed(_) | Self::Track(_))
    }

    fn duration(&self) -> Duration {
        match self {
            Self::Watch(duration) => *duration,
            Self::Speed(run) => Duration::from_millis(run.duration_ms.into()),
            Self::Track(run) => Duration::from_millis(run.duration_ms.into()),
            Self::Driver(_) => Duration::from_secs(60),
        }
    }
}

/// An experiment.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// The configuration to run with; a board that already has one may keep it when there is nothing to move.
    pub configuration: Option<Configuration>,
    /// The streams to capture.
    pub capture: CaptureMode,
    /// What to do.
    pub action: Action,
    /// Where to record, if anywhere. Never overwritten.
    pub recording: Option<PathBuf>,
    /// Motor parameter set, for the recording's metadata.
    pub motor: String,
}

/// How an experiment went.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The board.
    pub identity: Identity,
    /// The run, when there was one and its end was seen.
    pub run: Option<RunReport>,
    /// What was received and lost.
    pub tally: Tally,
    /// Frames in the recording.
    pub recorded: u64,
    /// Whether the user ended it.
    pub interrupted: bool,
}

/// Performs an experiment. `reopen` gives the port again after it was lost; without it a lost port ends the experiment.
/// However it ends, the motor is stopped where the board can still be told, and the recording is finished.
///
/// # Errors
/// Whatever ended it before its end; a fault of the board is in the [`Outcome`].
pub fn perform<P: Port>(
    session: &mut Session<P>,
    experiment: &Experiment,
    mut reopen: Option<&mut dyn FnMut() -> Result<P, LinkError>>,
    mut observe: impl FnMut(&Received),
) -> Result<Outcome, LinkError> {
    let identity = session.hello()?;
    if let Some(path) = &experiment.recording {
        let mut metadata = if session.port().is_virtual() { Metadata::simulated() } else { Metadata::now() };
        metadata.firmware_version = identity.firmware.to_string();
        metadata.chip = identity.chip.to_string();
        metadata.motor = experiment.motor.clone();
        session.record(Writer::create(path, &metadata)?);
    }
    let result = conduct(session, experiment, &mut reopen, &mut observe);
    session.ignore_interrupts();
    // A board that cannot be told stops by its own command timeout.
    let stopped = if experiment.action.moves() { session.stop() } else { Ok(()) };
    let tally = session.tally();
    let recorded = session.finish_recording()?;
    let (run, interrupted) = match result {
        Ok(run) => (run, false),
        Err(LinkError::Interrupted) => (None, true),
        Err(error) => return Err(error),
    };
    stopped?;
    Ok(Outcome { identity, run, tally, recorded, interrupted })
}

type Reopen<'a, P> = Option<&'a mut dyn FnMut() -> Result<P, LinkError>>;

fn conduct<P: Port>(
    session: &mut Session<P>,
    experiment: &Experiment,
    reopen: &mut Reopen<'_, P>,
    observe: &mut impl FnMut(&Received),
) -> Result<Option<RunReport>, LinkError> {
    if let Some(configuration) = experiment.configuration {
        session.configure(configuration)?;
    }
    if experiment.action.moves() {
        match session.arm() {
            Err(LinkError::Refused { reason: Refusal::NotAligned, .. }) => {
                session.align()?;
                session.arm()?;
            }
            other => other?,
        }
    }
    session.capture(experiment.capture)?;
    match &experiment.action {
        Action::Watch(_) => {}
        Action::Speed(run) => session.start_speed(*run)?,
        Action::Track(run) => session.start_track(run.clone())?,
        Action::Driver(line) => session.driver(line.clone())?,
    }
    let started = session.port().elapsed();
    let mut follower = Follower { start_us: 0, ended: None };
    let mut restarts = session.tally().restarts;
    let mut until =
        started + experiment.action.duration() + if experiment.action.moves() { GRACE } else { Duration::ZERO };
    loop {
        let left = until.saturating_sub(session.port().elapsed());
        match session.next(left) {
            Ok(Some(received)) => {
                if follower.take(&received.message) {
                    until = session.port().elapsed() + TAIL;
                }
                observe(&received);
                if session.tally().restarts != restarts {
                    restarts = session.tally().restarts;
                    go_on_after_restart(session, experiment)?;
                }
            }
            Ok(None) => break,
            Err(LinkError::Lost { port, reason }) => {
                let Some(reopen) = reopen.as_mut() else { return Err(LinkError::Lost { port, reason }) };
                session.remark(&format!("lost {port}: {reason}"))?;
                let left = until.saturating_sub(session.port().elapsed());
                reconnect(session, *reopen, experiment.capture, LinkError::Lost { port, reason })?;
                until = session.port().elapsed() + left;
            }
            Err(error) => return Err(error),
        }
    }
    // Switching the streams off flushes what waits for a block to fill.
    session.capture(CaptureMode::default())?;
    let flushed = session.port().elapsed() + TAIL;
    loop {
        let left = flushed.saturating_sub(session.port().elapsed());
        let Some(received) = session.next(left)? else { break };
        follower.take(&received.message);
        observe(&received);
    }
    match follower.ended {
        None if experiment.action.moves() => {
            Err(LinkError::NoAnswer { waited_ms: (experiment.action.duration() + GRACE).as_millis() as u64 })
        }
        ended => Ok(ended),
    }
}

/// A board that restarts has its streams off and its motor too. What only listens listens on, remarked in the recording;
/// nothing that moves is begun again.
fn go_on_after_restart<P: Port>(session: &mut Session<P>, experiment: &Experiment) -> Result<(), LinkError> {
    match experiment.action {
        Action::Watch(_) => {
            session.remark("the board has restarted; its streams are switched on again")?;
            session.capture(experiment.capture)
        }
        Action::Speed(_) | Action::Track(_) | Action::Driver(_) => {
            session.remark("the board has restarted: the run is over")?;
            Err(LinkError::Restarted)
        }
    }
}

/// Watches for the end of what was started.
struct Follower {
    start_us: u64,
    ended: Option<RunReport>,
}

impl Follower {
    /// Whether this message is the end.
    fn take(&mut self, message: &DeviceMessage) -> bool {
        match message {
            DeviceMessage::RunStarted { start_us } => {
                self.start_us = *start_us;
                false
            }
            DeviceMessage::RunEnded { end, end_us } => {
                self.ended = Some(RunReport { end: *end, start_us: self.start_us, end_us: *end_us });
                true
            }
            DeviceMessage::DriverDone => true,
            // The end itself may have been lost with the port; the latched fault is told ten times a second.
            DeviceMessage::Status(status) if status.mode == Mode::Fault && self.ended.is_none() => {
                self.ended = status.fault.map(|fault| RunReport {
                    end: RunEnd::Fault(fault),
                    start_us: self.start_us,
                    end_us: 0,
                });
                self.ended.is_some()
            }
            _ => false,
        }
    }
}

fn reconnect<P: Port>(
    session: &mut Session<P>,
    reopen: &mut dyn FnMut() -> Result<P, LinkError>,
    capture: CaptureMode,
    lost: LinkError,
) -> Result<(), LinkError> {
    let begun = Instant::now();
    loop {
        if session.is_interrupted() {
            return Err(LinkError::Interrupted);
        }
        if begun.elapsed() > PORT_PATIENCE {
            return Err(lost);
        }
        if let Ok(port) = reopen() {
            session.reattach(port)?;
            if session.hello().is_ok() {
                return session.capture(capture);
            }
        }
        std::thread::sleep(RETRY);
    }
}
