//! Runs: what drives the motor from its first PWM period to its end.

use super::Control;
use crate::output::OutputStage;
use crate::shared::Event;
use twum_shared::Fault;
use twum_shared::message::{Mode, Pass, Refusal, RunEnd, SpeedRun, TrackRun};
use twum_shared::step::{self, Inputs, State};

/// Longest run, ms.
const MAX_DURATION_MS: u32 = 3_600_000;

/// What drives the motor in [`Mode::Running`].
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "there is one, and nothing to allocate the other from")]
pub(super) enum Run {
    Speed(SpeedRun),
    Track { run: TrackRun, state: State, origin: i32 },
}

/// A control period: when it was due and began, and what the encoder showed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tick {
    pub due_us: u64,
    pub now_us: u64,
    pub late_us: u64,
    pub position: i32,
    pub edge_age_us: u16,
}

/// A run in progress.
#[derive(Debug)]
pub(super) struct Running {
    run: Run,
    /// When its first PWM period began; `None` while it waits for that.
    start_us: Option<u64>,
    duration_us: u64,
    tick: u64,
}

impl<S: OutputStage> Control<'_, S> {
    pub(super) fn begin_run(&mut self, pass: Pass, duration_ms: u32, run: Run) -> Result<(), Refusal> {
        self.require(Mode::Armed)?;
        if !(1..=MAX_DURATION_MS).contains(&duration_ms) {
            return Err(Refusal::Duration);
        }
        self.passes.take(pass)?;
        self.monitor.reset();
        self.mode = Mode::Running;
        self.running = Some(Running { run, start_us: None, duration_us: u64::from(duration_ms) * 1_000, tick: 0 });
        Ok(())
    }

    /// A PWM period began; called from its interrupt, which has the tick's priority, with the device clock. The first period
    /// that carries a run's first duty is the run's start.
    pub fn period_began(&mut self, now_us: u64) {
        let Some(age_us) = self.output.period_began() else { return };
        let Some(running) = self.running.as_mut().filter(|running| running.start_us.is_none()) else { return };
        let start_us = now_us.saturating_sub(u64::from(age_us));
        running.start_us = Some(start_us);
        if let Run::Track { origin, .. } = &mut running.run {
            *origin = self.shared.encoder.count();
        }
        self.monitor.reset();
        self.output.begin_run();
        self.shared.tell(Event::RunStarted(start_us));
    }

    /// What the first period of a run that waits for it is to carry.
    fn prepare(&mut self) {
        let (Some(running), Some(configured)) = (&self.running, &self.configured) else { return };
        let (duty, direction) = match &running.run {
            Run::Speed(run) => (run.duty, run.direction),
            Run::Track { run, .. } => {
                let target = run.reference.at(0);
                let inputs = Inputs { target: target.position, target_rate: target.rate, ..Inputs::default() };
                let outputs = step::step(&configured.config, &mut State::REST.clone(), inputs);
                (outputs.duty(&configured.config), outputs.direction)
            }
        };
        self.output.drive(duty, direction);
    }

    pub(super) fn end_run(&mut self, end: RunEnd, now_us: u64) {
        if let Some(running) = self.running.take() {
            self.output.end_run();
            if running.start_us.is_none() {
                // Over before its first period: a run of no length, so that every end has its start.
                self.shared.tell(Event::RunStarted(now_us));
            }
            self.shared.tell(Event::RunEnded(end, now_us));
        }
    }

    /// The run's next control period.
    pub(super) fn drive(&mut self, seen: Tick) {
        let Tick { due_us, now_us, late_us, position, edge_age_us } = seen;
        let (Some(running), Some(configured)) = (&mut self.running, &self.configured) else { return };
        let Some(start_us) = running.start_us else {
            self.prepare();
            return;
        };
        let elapsed_us = now_us.saturating_sub(start_us);
        if elapsed_us >= running.duration_us {
            self.end_run(RunEnd::Completed, now_us);
            self.mode = Mode::Armed;
            return;
        }
        let (inputs, state_before, outputs) = match &mut running.run {
            Run::Speed(run) => {
                self.output.drive(run.duty, run.direction);
                return;
            }
            Run::Track { run, state, origin } => {
                let target = run.reference.at(elapsed_us);
                let inputs = Inputs {
                    target: target.position,
                    target_rate: target.rate,
                    target_fraction: target.fraction,
                    position: position.wrapping_sub(*origin),
                    edge_age_us,
                };
                let before = *state;
                let outputs = step::step(&configured.config, state, inputs);
                (inputs, before, outputs)
            }
        };
        let error = inputs.target.saturating_sub(inputs.position).unsigned_abs();
        if error > configured.message.limits.following_error_counts {
            self.latch(Fault::FollowingError, now_us, position);
            return;
        }
        let duty = outputs.duty(&configured.config);
        let tick = running.tick;
        running.tick += 1;
        self.output.drive(duty, outputs.direction);
        self.capture_tick(tick, due_us, late_us, (inputs, state_before, outputs));
    }
}
