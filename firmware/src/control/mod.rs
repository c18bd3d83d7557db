//! The control interrupt: supervisor, limits, loop and capture, in one bounded call every control period.

mod alignment;
mod capture;
mod monitor;
mod run;
mod safety;
mod session;
mod status;

use crate::output::{Output, OutputStage};
use crate::queues::ControlEnds;
use crate::shared::{Command, DriverRequest, Event, Shared};
use alignment::Alignment;
use capture::Capture;
use monitor::Monitor;
use run::{Run, Running, Tick};
use safety::Lost;
use session::Passes;
use status::Timing;
use twum_shared::message::{Configuration, HostMessage, Mode, Refusal, ResetCause};
use twum_shared::step::{Config, State};
use twum_shared::{Fault, driver};

/// The control period before there is a configuration, µs.
const UNCONFIGURED_PERIOD_US: u32 = 500;

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
    alignment: Alignment,
    passes: Passes,
    running: Option<Running>,
    capture: Capture,
    lost: Lost,
    monitor: Monitor,
    timing: Timing,
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
            alignment: Alignment::default(),
            passes: Passes::default(),
            running: None,
            capture: Capture::default(),
            lost: Lost::default(),
            monitor: Monitor::default(),
            timing: Timing::default(),
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
        let edge_age_us = self.shared.encoder.edge_age_us(now_us);
        self.timing.ticks += 1;
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
        self.drive(Tick { due_us, now_us, late_us, position, edge_age_us });
        self.capture_bit(due_us, level);
        self.publish(now_us, position);

        self.timing.ended(clock().saturating_sub(now_us));
    }

    fn obey(&mut self, command: Command, now_us: u64, position: i32) {
        match command {
            Command::Host { message: HostMessage::Hello, .. } => self.shared.tell(Event::Hello(self.mode, self.fault)),
            Command::Host { of, heard_us, message } => {
                let answer = match self.decide(message, heard_us, now_us, position) {
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
                if errand == self.shared.errand() {
                    self.passthrough_ended();
                }
            }
        }
    }

    fn decide(&mut self, message: HostMessage, heard_us: u64, now_us: u64, position: i32) -> Result<(), Refusal> {
        match message {
            HostMessage::Capture(mode) => {
                self.set_capture(mode, now_us);
                Ok(())
            }
            HostMessage::Reboot if matches!(self.mode, Mode::Idle | Mode::Fault) => {
                self.output.off();
                self.shared.reboot.signal(());
                Ok(())
            }
            _ if self.fault.is_some() => Err(self.fault.map_or(Refusal::Busy, Refusal::Fault)),
            HostMessage::AskPass { token } => self.give_pass(token, heard_us, now_us),
            HostMessage::Configure(configuration) => self.configure(configuration),
            HostMessage::Align(pass) => self.begin_text(pass, DriverRequest::Align, Mode::Aligning),
            HostMessage::Driver { pass, line } => {
                driver::parse(&line).map_err(|_| Refusal::DriverLine)?;
                self.begin_text(pass, DriverRequest::Passthrough(line), Mode::Passthrough)
            }
            HostMessage::Arm { token } => self.arm(token, heard_us, now_us),
            HostMessage::Speed { pass, run } => self.begin_run(pass, run.duration_ms, Run::Speed(run)),
            HostMessage::Track { pass, run } => {
                self.require(Mode::Armed)?;
                run.reference.validate().map_err(Refusal::Reference)?;
                if self.configured.as_ref().is_some_and(|configured| !configured.message.pwm_fits()) {
                    return Err(Refusal::Pwm);
                }
                self.begin_run(pass, run.duration_ms, Run::Track { run, state: State::REST, origin: position })
            }
            // The last three do not come here: the receive task answers a keepalive and a stop, `obey` a hello.
            HostMessage::Reboot | HostMessage::Keepalive { .. } | HostMessage::Stop { .. } | HostMessage::Hello => {
                Err(Refusal::Mode(self.mode))
            }
        }
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
}
