//! The control interrupt: supervisor, limits, loop and capture, in one bounded call every control period.

mod capture;
mod monitor;
mod stall;

use crate::output::{Output, OutputStage};
use crate::queues::ControlEnds;
use crate::shared::{Asked, Command, DriverRequest, Event, Request, Shared, Stop};
use capture::Bits;
use monitor::{Monitor, Seen};
use twum_shared::alignment::Failure;
use twum_shared::message::{
    CaptureMode, Configuration, FaultReport, Mode, Pass, Refusal, ResetCause, RunEnd, SpeedRun, Status, TrackRun,
};
use twum_shared::safety::Limits;
use twum_shared::step::{self, Config, Inputs, State};
use twum_shared::{Fault, driver};

/// Longest run, ms.
const MAX_DURATION_MS: u32 = 3_600_000;
/// The control period before there is a configuration, µs.
const UNCONFIGURED_PERIOD_US: u32 = 500;
/// Status is published every so many µs.
const STATUS_US: u64 = 100_000;

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
    /// Of so many blocks of ticks, one is captured.
    every_block: u32,
    /// The pass that was given last and not used.
    pass: Option<Pass>,
    nonce: u32,
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
            every_block: 1,
            pass: None,
            nonce: 0,
        }
    }

    /// The control period the board's timer should have, µs.
    pub fn period_us(&self) -> u32 {
        self.configured.as_ref().map_or(UNCONFIGURED_PERIOD_US, |configured| configured.message.control.period_us)
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

        if let Some(stop) = self.shared.take_stop() {
            self.stop(stop, now_us);
        }
        self.settle(now_us);
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
        // Alignment needs no configuration, but a host that is there.
        let (limits, period_us) = match &self.configured {
            Some(configured) => (&configured.message.limits, configured.message.control.period_us),
            None => (&Limits::DEFAULT, UNCONFIGURED_PERIOD_US),
        };
        self.late_ticks = self.late_ticks.saturating_add(u32::from(late_us > u64::from(limits.late_tick_us)));
        let seen = Seen {
            held: Shared::is_held(self.mode),
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
        if let Some(fault) = self.monitor.check(limits, period_us, seen) {
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
        self.release();
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
                    self.release();
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
                self.release();
                self.shared.tell(Event::Aligned);
            }
            Err(Failure::DriverSilent) => self.latch(Fault::DriverSilent, now_us, position),
            Err(Failure::NoEdge) => self.latch(Fault::AlignFailed, now_us, position),
        }
    }

    fn decide(&mut self, request: Request, now_us: u64, position: i32) -> Result<(), Refusal> {
        match request {
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
            Request::GivePass(asked) => self.give_pass(asked, now_us),
            Request::Configure(message) => self.configure(message),
            Request::Align(pass) => self.begin_text(pass, DriverRequest::Align, Mode::Aligning),
            Request::Driver(pass, line) => {
                driver::parse(&line).map_err(|_| Refusal::DriverLine)?;
                self.begin_text(pass, DriverRequest::Passthrough(line), Mode::Passthrough)
            }
            Request::Arm(asked) => self.arm(asked, now_us),
            Request::Speed(pass, run) => self.begin_run(pass, run.duration_ms, Run::Speed(run)),
            Request::Track(pass, run) => {
                self.require(Mode::Armed)?;
                run.reference.validate().map_err(Refusal::Reference)?;
                self.begin_run(pass, run.duration_ms, Run::Track { run, state: State::REST, origin: position })
            }
            Request::Reboot | Request::Identify => Err(Refusal::Mode(self.mode)),
        }
    }

    /// Gives a session the pass for its next motion, and voids the one before.
    fn give_pass(&mut self, asked: Asked, now_us: u64) -> Result<(), Refusal> {
        if asked.token == 0 {
            return Err(Refusal::Pass);
        }
        if ![0, asked.token].contains(&self.shared.holder()) {
            return Err(Refusal::Held);
        }
        self.nonce = another_nonce(self.nonce, asked.heard_us, now_us);
        let pass = Pass { token: asked.token, nonce: self.nonce };
        self.pass = Some(pass);
        self.shared.tell(Event::Pass(pass));
        Ok(())
    }

    /// Takes a pass: it works once.
    fn use_pass(&mut self, pass: Pass) -> Result<(), Refusal> {
        if self.pass != Some(pass) {
            return Err(Refusal::Pass);
        }
        self.pass = None;
        Ok(())
    }

    /// From here on the motor moves, or may, as long as this session is heard.
    fn hold(&mut self, token: u32) {
        self.shared.set_holder(token);
        self.monitor.reset();
        self.lost_in_a_row = 0;
    }

    /// Nobody holds the motor, and nothing that was asked for before moves it.
    fn release(&mut self) {
        self.shared.set_holder(0);
        self.shared.end_errand();
        self.pass = None;
    }

    fn arm(&mut self, asked: Asked, now_us: u64) -> Result<(), Refusal> {
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
        self.give_pass(asked, now_us)?;
        self.hold(asked.token);
        self.mode = Mode::Armed;
        Ok(())
    }

    /// Starts what moves the motor through the driver board's text mode.
    fn begin_text(&mut self, pass: Pass, request: DriverRequest, mode: Mode) -> Result<(), Refusal> {
        self.require(Mode::Idle)?;
        if self.hardware_mode {
            return Err(Refusal::HardwareMode);
        }
        self.use_pass(pass)?;
        self.hold(pass.token);
        self.shared.begin_errand(request);
        self.mode = mode;
        Ok(())
    }

    fn require(&self, mode: Mode) -> Result<(), Refusal> {
        if self.mode == mode { Ok(()) } else { Err(Refusal::Mode(self.mode)) }
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
        self.monitor = Monitor::new(&message);
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

    /// Off at once. What the driver board does by itself ends within its line: only then is the motor said to be idle.
    fn stop(&mut self, stop: Stop, now_us: u64) {
        self.output.off();
        self.end_run(RunEnd::Stopped, now_us);
        self.release();
        if stop.clear_fault {
            self.fault = None;
        }
        self.mode = match self.fault {
            Some(_) => Mode::Fault,
            None => Mode::Stopping,
        };
        self.shared.have_stopped(stop.of);
        self.next_status_us = now_us;
    }

    /// Leaves [`Mode::Stopping`] once nothing moves.
    fn settle(&mut self, now_us: u64) {
        if self.mode == Mode::Stopping && !self.shared.is_driver_busy() {
            self.mode = Mode::Idle;
            self.next_status_us = now_us;
        }
    }

    fn begin_run(&mut self, pass: Pass, duration_ms: u32, run: Run) -> Result<(), Refusal> {
        self.require(Mode::Armed)?;
        if !(1..=MAX_DURATION_MS).contains(&duration_ms) {
            return Err(Refusal::Duration);
        }
        self.use_pass(pass)?;
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
        self.capture_tick(tick, due_us, late_us, (inputs, state_before, outputs));
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

/// Another number each time: the µs at which frames arrive and ticks start do not repeat from one session, or one boot, to the
/// next. The mixing is the finaliser of MurmurHash3.
fn another_nonce(before: u32, heard_us: u64, now_us: u64) -> u32 {
    let mut mixed = before.wrapping_add(0x9e37_79b9) ^ heard_us as u32 ^ (now_us as u32).rotate_left(16);
    mixed = (mixed ^ (mixed >> 16)).wrapping_mul(0x85eb_ca6b);
    mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xc2b2_ae35);
    mixed ^ (mixed >> 16)
}
