//! The control interrupt: supervisor, limits, loop and capture, in one bounded call every control period.

mod monitor;

use crate::output::{Output, OutputStage};
use crate::queues::{ControlEnds, TickRecord, WordRecord};
use crate::shared::{Command, DriverRequest, Event, Request, Shared};
use monitor::{Monitor, Seen};
use twum_shared::alignment::Failure;
use twum_shared::bits::BitPacker;
use twum_shared::message::{
    CaptureMode, Configuration, ControlSample, FaultReport, Mode, Refusal, ResetCause, RunEnd, SpeedRun, Status,
    TrackRun,
};
use twum_shared::step::{self, Config, Inputs, Outputs, State};
use twum_shared::{Fault, driver};

/// Longest run, ms.
const MAX_DURATION_MS: u32 = 3_600_000;
/// Status is published every so many µs.
const STATUS_US: u64 = 100_000;
/// 1 kHz: the bit capture takes a sample when this much time has passed since the one before.
const BIT_PERIOD_US: u64 = 1_000;

/// What drives the motor in [`Mode::Running`].
#[derive(Debug)]
enum Run {
    Speed(SpeedRun),
    Track { run: TrackRun, state: State, origin: i32 },
}

/// A run in progress.
#[derive(Debug)]
struct Running {
    run: Run,
    /// When its first PWM period began; `None` while it waits for that.
    start_us: Option<u64>,
    duration_us: u64,
    tick: u64,
}

/// The configuration in force and what was derived from it.
#[derive(Debug)]
struct Configured {
    message: Configuration,
    config: Config,
}

/// A timed bit capture.
#[derive(Debug, Default)]
struct Bits {
    packer: BitPacker,
    samples: u64,
    word_us: u64,
    next_us: u64,
}

/// The control interrupt's state. One per board; its [`Control::tick`] is the only caller of the output.
pub struct Control<'a, S: OutputStage> {
    shared: &'a Shared,
    queues: ControlEnds<'a>,
    output: Output<S>,
    mode: Mode,
    fault: Option<Fault>,
    configured: Option<Configured>,
    aligned: bool,
    hardware_mode: bool,
    running: Option<Running>,
    capture: CaptureMode,
    bits: Bits,
    monitor: Monitor,
    ticks: u64,
    previous_duration_us: u16,
    worst_late_us: u32,
    worst_duration_us: u32,
    late_ticks: u32,
    next_status_us: u64,
    lost_in_a_row: u16,
    lost_edges_seen: u32,
}

impl<'a, S: OutputStage> Control<'a, S> {
    /// Takes an output that [`Output::boot`] has switched off. A reset by watchdog or panic latches its fault at once.
    pub fn new(shared: &'a Shared, queues: ControlEnds<'a>, output: Output<S>, reset: ResetCause) -> Self {
        let fault = match reset {
            ResetCause::Watchdog => Some(Fault::BootFromWatchdog),
            ResetCause::Panic => Some(Fault::BootFromPanic),
            _ => None,
        };
        Self {
            shared,
            queues,
            output,
            mode: if fault.is_some() { Mode::Fault } else { Mode::Idle },
            fault,
            configured: None,
            aligned: false,
            hardware_mode: false,
            running: None,
            capture: CaptureMode::default(),
            bits: Bits::default(),
            monitor: Monitor::default(),
            ticks: 0,
            previous_duration_us: 0,
            worst_late_us: 0,
            worst_duration_us: 0,
            late_ticks: 0,
            next_status_us: 0,
            lost_in_a_row: 0,
            lost_edges_seen: 0,
        }
    }

    /// The control period the board's timer should have, µs.
    pub fn period_us(&self) -> u32 {
        self.configured.as_ref().map_or(500, |configured| configured.message.control.period_us)
    }

    /// The supervisor's state.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Whether the motor cannot move before another command: the output is off, and not armed.
    pub const fn is_at_rest(&self) -> bool {
        !Shared::is_live(self.mode)
    }

    /// The stop input is low. A board says so before each tick for as long as it is: that tick latches it, again after every
    /// `stop`.
    #[inline]
    pub fn stop_input_is_low(&self) {
        self.shared.request_fault(Fault::ExternalStop);
    }

    /// One control period: due at `due_us`, started at `now_us` (device clock), with the encoder pin's level; `clock` reads
    /// the device clock again at the end, for the tick's own duration.
    pub fn tick(&mut self, due_us: u64, now_us: u64, level: bool, clock: impl FnOnce() -> u64) {
        let late_us = now_us.saturating_sub(due_us);
        let position = self.shared.encoder.count();
        self.ticks += 1;
        self.shared.ticked();

        self.observe(now_us, late_us, position);
        for _ in 0..2 {
            if let Some(command) = self.shared.commands.pull() {
                self.obey(command, now_us, position);
            }
        }
        self.drive(due_us, now_us, late_us, position);
        self.capture_bit(due_us, level);
        self.publish(now_us, position);

        let duration_us = clock().saturating_sub(now_us);
        self.previous_duration_us = duration_us.min(u64::from(u16::MAX)) as u16;
        self.worst_duration_us = self.worst_duration_us.max(duration_us.min(u64::from(u32::MAX)) as u32);
    }

    /// Everything that can stop the motor, before anything that can move it.
    fn observe(&mut self, now_us: u64, late_us: u64, position: i32) {
        self.worst_late_us = self.worst_late_us.max(late_us.min(u64::from(u32::MAX)) as u32);
        let requested = self.shared.take_requested_fault();
        // Bytes lost while nothing can move cost a command, which the host repeats; they are counted, not latched.
        let requested = requested.filter(|fault| *fault != Fault::RxOverrun || Shared::is_live(self.mode));
        if let Some(fault) = requested {
            self.latch(fault, now_us, position);
        }
        let lost_edges = self.shared.lost_edges();
        if lost_edges != self.lost_edges_seen {
            self.lost_in_a_row = self.lost_in_a_row.saturating_add(1);
            self.lost_edges_seen = lost_edges;
        }
        let Some(configured) = &self.configured else { return };
        let limits = &configured.message.limits;
        self.late_ticks = self.late_ticks.saturating_add(u32::from(late_us > u64::from(limits.late_tick_us)));
        let seen = Seen {
            live: Shared::is_live(self.mode),
            running: self.mode == Mode::Running,
            late_us,
            position,
            edges: self.shared.encoder.edges(),
            host_frames: self.shared.host_frames(),
            duty: self.output.duty(),
            direction: self.output.direction(),
            lost_in_a_row: self.lost_in_a_row,
        };
        if let Some(fault) = self.monitor.check(limits, configured.message.control.period_us, seen) {
            self.latch(fault, now_us, position);
        }
    }

    fn latch(&mut self, fault: Fault, now_us: u64, position: i32) {
        self.output.off();
        if self.fault.is_some() {
            return;
        }
        self.end_run(RunEnd::Fault(fault), now_us);
        self.fault = Some(fault);
        self.mode = Mode::Fault;
        self.shared.end_errand();
        self.shared.tell(Event::Fault(FaultReport { fault, off_us: now_us, position }));
    }

    fn obey(&mut self, command: Command, now_us: u64, position: i32) {
        match command {
            Command::Host(_, Request::Identify) => self.shared.tell(Event::Hello(self.mode, self.fault)),
            Command::Host(of, request) => {
                let answer = match self.decide(request, now_us, position) {
                    Ok(()) => Event::Ack(of),
                    Err(reason) => Event::Nack(of, reason),
                };
                self.shared.tell(answer);
            }
            Command::AlignEnded(errand, result) => {
                if errand == self.shared.errand() {
                    self.align_ended(result, now_us, position);
                }
            }
            Command::PassthroughEnded(errand) => {
                if errand == self.shared.errand() && self.mode == Mode::Passthrough {
                    self.mode = Mode::Idle;
                    self.shared.tell(Event::DriverDone);
                }
            }
        }
    }

    fn align_ended(&mut self, result: Result<(), Failure>, now_us: u64, position: i32) {
        if self.mode != Mode::Aligning {
            return;
        }
        match result {
            Ok(()) => {
                self.shared.encoder.zero();
                self.shared.encoder.set_unsigned(false);
                self.monitor.reset();
                (self.aligned, self.hardware_mode, self.mode) = (true, true, Mode::Idle);
                self.shared.tell(Event::Aligned);
            }
            Err(Failure::DriverSilent) => self.latch(Fault::DriverSilent, now_us, position),
            Err(Failure::NoEdge) => self.latch(Fault::AlignFailed, now_us, position),
        }
    }

    fn decide(&mut self, request: Request, now_us: u64, position: i32) -> Result<(), Refusal> {
        match request {
            Request::Stop => {
                self.stop(now_us);
                Ok(())
            }
            Request::Capture(mode) => {
                self.set_capture(mode, now_us);
                Ok(())
            }
            Request::Reboot if matches!(self.mode, Mode::Idle | Mode::Fault) => {
                self.output.off();
                self.shared.reboot.signal(());
                Ok(())
            }
            _ if self.fault.is_some() => Err(self.fault.map_or(Refusal::Busy, Refusal::Fault)),
            Request::Configure(message) => self.configure(message),
            Request::Align => {
                self.require(Mode::Idle)?;
                self.text_mode()?;
                self.shared.begin_errand(DriverRequest::Align);
                self.mode = Mode::Aligning;
                Ok(())
            }
            Request::Driver(line) => {
                self.require(Mode::Idle)?;
                self.text_mode()?;
                driver::parse(&line).map_err(|_| Refusal::DriverLine)?;
                self.shared.begin_errand(DriverRequest::Passthrough(line));
                self.mode = Mode::Passthrough;
                Ok(())
            }
            Request::Arm => {
                self.require(Mode::Idle)?;
                if self.configured.is_none() {
                    return Err(Refusal::NotConfigured);
                }
                if self.shared.is_keeping() {
                    return Err(Refusal::Busy);
                }
                if !self.aligned {
                    return Err(Refusal::NotAligned);
                }
                self.monitor.reset();
                self.lost_in_a_row = 0;
                self.mode = Mode::Armed;
                Ok(())
            }
            Request::Speed(run) => {
                self.require(Mode::Armed)?;
                self.begin_run(run.duration_ms, Run::Speed(run))
            }
            Request::Track(run) => {
                self.require(Mode::Armed)?;
                run.reference.validate().map_err(Refusal::Reference)?;
                self.begin_run(run.duration_ms, Run::Track { run, state: State::REST, origin: position })
            }
            Request::Reboot | Request::Identify => Err(Refusal::Mode(self.mode)),
        }
    }

    fn require(&self, mode: Mode) -> Result<(), Refusal> {
        if self.mode == mode { Ok(()) } else { Err(Refusal::Mode(self.mode)) }
    }

    fn text_mode(&self) -> Result<(), Refusal> {
        if self.hardware_mode { Err(Refusal::HardwareMode) } else { Ok(()) }
    }

    /// Takes what the board kept, before the first tick. What does not validate leaves the board unconfigured.
    ///
    /// # Errors
    /// Says why it was not taken.
    pub fn restore(&mut self, message: Configuration) -> Result<(), Refusal> {
        let config = Config::try_from(message.control).map_err(Refusal::Config)?;
        let in_range = (2..=10_000).contains(&message.edges_per_rev) && (10..=2_000).contains(&message.pwm_hz);
        if message.limits.validate().is_err() || !in_range {
            return Err(Refusal::Limits);
        }
        self.shared.encoder.set_sign(message.count_sign);
        self.output.set_frequency(message.pwm_hz);
        self.monitor.reset();
        self.configured = Some(Configured { message, config });
        self.shared.tell(Event::Configured(message));
        Ok(())
    }

    fn configure(&mut self, message: Configuration) -> Result<(), Refusal> {
        self.require(Mode::Idle)?;
        self.restore(message)?;
        self.shared.have_kept(message);
        Ok(())
    }

    fn stop(&mut self, now_us: u64) {
        self.output.off();
        self.end_run(RunEnd::Stopped, now_us);
        self.shared.end_errand();
        self.fault = None;
        self.mode = Mode::Idle;
    }

    fn begin_run(&mut self, duration_ms: u32, run: Run) -> Result<(), Refusal> {
        if !(1..=MAX_DURATION_MS).contains(&duration_ms) {
            return Err(Refusal::Duration);
        }
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
                let inputs = Inputs { target: target.position, target_rate: target.rate, position: 0 };
                let outputs = step::step(&configured.config, &mut State::REST.clone(), inputs);
                (outputs.duty(&configured.config), outputs.direction)
            }
        };
        self.output.drive(duty, direction);
    }

    fn end_run(&mut self, end: RunEnd, now_us: u64) {
        if let Some(running) = self.running.take() {
            self.output.end_run();
            if running.start_us.is_none() {
                // Over before its first period: a run of no length, so that every end has its start.
                self.shared.tell(Event::RunStarted(now_us));
            }
            self.shared.tell(Event::RunEnded(end, now_us));
        }
    }

    fn drive(&mut self, due_us: u64, now_us: u64, late_us: u64, position: i32) {
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
                    position: position.wrapping_sub(*origin),
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
        if self.capture.control {
            let sample = self.sample(inputs, outputs, late_us);
            let record = TickRecord { tick, due_us, state: state_before, sample };
            let lost = self.queues.ticks.push(record).is_err();
            self.count_loss(lost);
        }
    }

    fn sample(&self, inputs: Inputs, outputs: Outputs, late_us: u64) -> ControlSample {
        ControlSample {
            target: inputs.target,
            target_rate: inputs.target_rate,
            position: inputs.position,
            u: outputs.u,
            on_steps: outputs.on_steps,
            direction: outputs.direction,
            late_us: late_us.min(u64::from(u16::MAX)) as u16,
            duration_us: self.previous_duration_us,
        }
    }

    fn count_loss(&mut self, lost: bool) {
        if lost {
            self.shared.lose_sample();
            self.lost_in_a_row = self.lost_in_a_row.saturating_add(1);
        } else {
            self.lost_in_a_row = 0;
        }
    }

    fn set_capture(&mut self, mode: CaptureMode, now_us: u64) {
        if mode.bits && !self.capture.bits {
            self.bits = Bits { next_us: now_us, ..Bits::default() };
        }
        if self.capture.bits && !mode.bits {
            self.flush_bits();
        }
        self.shared.encoder.set_streaming(mode.edges);
        self.capture = mode;
        if let Some(configured) = &self.configured {
            self.shared.tell(Event::Configured(configured.message));
        }
    }

    fn capture_bit(&mut self, due_us: u64, level: bool) {
        if !self.capture.bits || due_us < self.bits.next_us {
            return;
        }
        if self.bits.samples.is_multiple_of(32) {
            self.bits.word_us = due_us;
        }
        self.bits.next_us += BIT_PERIOD_US;
        self.bits.samples += 1;
        if let Some(word) = self.bits.packer.push(level) {
            self.send_word(word, 32);
        }
    }

    fn flush_bits(&mut self) {
        if let Some((word, samples)) = self.bits.packer.flush() {
            self.send_word(word, samples);
        }
    }

    fn send_word(&mut self, word: u32, samples: u8) {
        let first_sample = self.bits.samples - u64::from(samples);
        let record = WordRecord { first_sample, first_us: self.bits.word_us, samples, word };
        let lost = self.queues.words.push(record).is_err();
        self.count_loss(lost);
    }

    fn publish(&mut self, now_us: u64, position: i32) {
        if now_us < self.next_status_us {
            return;
        }
        self.next_status_us = now_us + STATUS_US;
        self.shared.status.signal(Status {
            mode: self.mode,
            fault: self.fault,
            position,
            duty: self.output.duty(),
            direction: self.output.direction(),
            ticks: self.ticks,
            late_ticks: self.late_ticks,
            worst_late_us: self.worst_late_us,
            worst_duration_us: self.worst_duration_us,
            edges: self.shared.encoder.edges(),
            lost_items: self.shared.lost_items(),
            bad_frames: self.shared.bad_frames(),
        });
    }
}
