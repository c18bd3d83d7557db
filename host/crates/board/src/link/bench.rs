//! One experiment on a board, from hello to stop: what every command that moves or records does.

use super::{LinkError, Port, Received, RunReport, Session, Tally};
use std::path::PathBuf;
use std::time::Duration;
use twum_record::store::{Metadata, Writer};
use twum_shared::message::{
    CaptureMode, Configuration, DeviceMessage, HostMessage, Identity, Mode, Refusal, RunEnd, SpeedRun, TrackRun,
};

/// The last blocks of a run arrive within this time of its end.
const TAIL: Duration = Duration::from_millis(500);
/// A run's end may come this much later than its duration.
const GRACE: Duration = Duration::from_secs(2);
/// A lost port is tried again this often: an interruption is seen as soon.
const RETRY: Duration = Duration::from_millis(100);
/// A port that stays away is given up this long after the experiment's own end.
const RECONNECT: Duration = Duration::from_secs(60);

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
    /// Whether it sets the motor in motion.
    fn moves(&self) -> bool {
        !matches!(self, Self::Watch(_))
    }

    /// Whether it is a run of the controller, which has to be armed.
    fn runs(&self) -> bool {
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

impl Outcome {
    /// What cut the run short, if anything did; the recording says so too.
    pub fn cut(&self) -> Option<LinkError> {
        cut(self.interrupted, self.run)
    }
}

fn cut(interrupted: bool, run: Option<RunReport>) -> Option<LinkError> {
    match run.map(|run| run.end) {
        Some(RunEnd::Fault(fault)) => Some(LinkError::Fault(fault)),
        _ if interrupted => Some(LinkError::Interrupted),
        Some(RunEnd::Stopped) => Some(LinkError::StoppedByOther),
        Some(RunEnd::Completed) | None => None,
    }
}

/// Performs an experiment. `reopen` gives the port again after it was lost; without it a lost port ends the experiment.
/// A latched fault is not cleared: nothing starts. However it ends, the motor is stopped first, where the board can still be
/// told; then the rest is received and the recording finished.
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
    if let Some(fault) = identity.fault.filter(|_| experiment.action.moves()) {
        return Err(LinkError::Latched(fault));
    }
    if let Some(path) = &experiment.recording {
        let mut metadata = if session.port().is_virtual() { Metadata::simulated() } else { Metadata::now() };
        metadata.firmware_version = identity.firmware.to_string();
        metadata.chip = identity.chip.to_string();
        metadata.motor = experiment.motor.clone();
        session.record(Writer::create(path, &metadata)?);
    }
    let mut follower = Follower::default();
    let result = conduct(session, experiment, &mut reopen, &mut follower, &mut observe);
    let stopped = session.let_go();
    let rest = receive_rest(session, &mut follower, &mut observe);
    let interrupted = matches!(result, Err(LinkError::Interrupted));
    let error = result.as_ref().err().filter(|_| !interrupted).map(ToString::to_string);
    if let Some(why) = error.or_else(|| cut(interrupted, follower.ended).map(|why| why.to_string())) {
        session.remark(&format!("cut short: {why}"));
    }
    let tally = session.tally();
    let recorded = session.finish_recording();
    // A motor that may still turn matters more than what came before it.
    stopped?;
    match result {
        Ok(()) => rest?,
        Err(LinkError::Interrupted) => {}
        Err(error) => return Err(error),
    }
    Ok(Outcome { identity, run: follower.ended, tally, recorded: recorded?, interrupted })
}

/// Aligns the motor. However it ends, nothing is left moving.
///
/// # Errors
/// Whatever ended it before its end; a latched fault is not cleared.
pub fn align<P: Port>(session: &mut Session<P>) -> Result<(), LinkError> {
    if let Some(fault) = session.hello()?.fault {
        return Err(LinkError::Latched(fault));
    }
    let result = session.align();
    session.let_go()?;
    result
}

type Reopen<'a, P> = Option<&'a mut dyn FnMut() -> Result<P, LinkError>>;

fn conduct<P: Port>(
    session: &mut Session<P>,
    experiment: &Experiment,
    reopen: &mut Reopen<'_, P>,
    follower: &mut Follower,
    observe: &mut impl FnMut(&Received),
) -> Result<(), LinkError> {
    start(session, experiment)?;
    let started = session.port().elapsed();
    let moves = experiment.action.moves();
    let mut until = started + experiment.action.duration() + if moves { GRACE } else { Duration::ZERO };
    loop {
        let left = until.saturating_sub(session.port().elapsed());
        let restarts = session.tally().restarts;
        match session.next(left) {
            Ok(Some(received)) => {
                let ended = follower.take(&received.message);
                observe(&received);
                if ended {
                    return Ok(());
                }
            }
            Ok(None) if moves => {
                return Err(LinkError::NoAnswer {
                    waited_ms: (experiment.action.duration() + GRACE).as_millis() as u64,
                });
            }
            Ok(None) => return Ok(()),
            Err(LinkError::Lost { port, reason }) => {
                let Some(reopen) = reopen.as_mut() else { return Err(LinkError::Lost { port, reason }) };
                session.remark(&format!("lost {port}: {reason}"));
                let left = until.saturating_sub(session.port().elapsed());
                let lost = LinkError::Lost { port, reason };
                reconnect(session, *reopen, experiment.capture, until + RECONNECT)
                    .map_err(|error| error.unwrap_or(lost))?;
                until = session.port().elapsed() + left;
            }
            Err(error) => return Err(error),
        }
        if session.tally().restarts > restarts {
            go_on_after_restart(session, experiment.capture)?;
        }
    }
}

/// Brings the board to where the experiment's action begins, and begins it.
fn start<P: Port>(session: &mut Session<P>, experiment: &Experiment) -> Result<(), LinkError> {
    if session.is_interrupted() {
        return Err(LinkError::Interrupted);
    }
    if let Some(configuration) = experiment.configuration {
        session.configure(configuration)?;
    }
    if experiment.action.runs() {
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
        Action::Watch(_) => Ok(()),
        Action::Speed(run) => session.start_speed(*run),
        Action::Track(run) => session.start_track(run.clone()),
        Action::Driver(line) => session.driver(line.clone()),
    }
}

/// What only watches switches its streams on again; what moved has ended before.
fn go_on_after_restart<P: Port>(session: &mut Session<P>, capture: CaptureMode) -> Result<(), LinkError> {
    let reset = session.hello()?.reset;
    session.remark(&format!("the board restarted: {reset:?}"));
    session.capture(capture)
}

/// Switches the streams off, which flushes what waits for a block to fill, and takes what still comes. The motor stands.
fn receive_rest<P: Port>(
    session: &mut Session<P>,
    follower: &mut Follower,
    observe: &mut impl FnMut(&Received),
) -> Result<(), LinkError> {
    session.send(&HostMessage::Capture(CaptureMode::default()))?;
    let until = session.port().elapsed() + TAIL;
    loop {
        let left = until.saturating_sub(session.port().elapsed());
        let Some(received) = session.next_at_rest(left)? else { return Ok(()) };
        follower.take(&received.message);
        observe(&received);
    }
}

/// Watches for the end of what was started.
#[derive(Default)]
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
            DeviceMessage::Status(status) if status.mode == Mode::Stopping && self.ended.is_none() => {
                self.ended = Some(RunReport { end: RunEnd::Stopped, start_us: self.start_us, end_us: 0 });
                true
            }
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

/// Waits for the port to come back.
///
/// # Errors
/// What else ended the wait; `None` when its time was up.
fn reconnect<P: Port>(
    session: &mut Session<P>,
    reopen: &mut dyn FnMut() -> Result<P, LinkError>,
    capture: CaptureMode,
    give_up: Duration,
) -> Result<(), Option<LinkError>> {
    loop {
        if session.is_interrupted() {
            return Err(Some(LinkError::Interrupted));
        }
        if session.port().elapsed() > give_up {
            return Err(None);
        }
        if let Ok(port) = reopen() {
            session.reattach(port);
            match session.hello() {
                Ok(_) => return session.capture(capture).map_err(Some),
                Err(LinkError::Interrupted) => return Err(Some(LinkError::Interrupted)),
                Err(_) => {}
            }
        }
        std::thread::sleep(RETRY);
    }
}
