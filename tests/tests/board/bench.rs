//! A simulated bench: board, driver board and motor in virtual time, with the host's own session on top.

use std::time::Duration;
use twum_host::link::{LinkError, Received, Session, SimulatedLink};
use twum_host::sim::{Board, Setup};
use twum_shared::message::{
    CaptureMode, Configuration, DeviceMessage, FaultReport, Identity, Mode, SpeedRun, TrackRun,
};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;
use twum_shared::{Direction, Duty, Fault};

/// The control period of every configuration used here, µs.
pub const TICK_US: u64 = 500;

pub struct Bench {
    pub session: Session<SimulatedLink>,
    pub seen: Vec<Received>,
}

impl Bench {
    pub fn new(setup: Setup) -> Self {
        let mut session = Session::new(SimulatedLink::new(setup));
        session.hello().expect("the board answers");
        Self { session, seen: Vec::new() }
    }

    /// Aligned and configured, idle.
    pub fn aligned(configuration: Configuration) -> Self {
        let mut bench = Self::new(Setup::default());
        bench.session.align().expect("alignment");
        bench.session.configure(configuration).expect("configuration");
        bench
    }

    /// Aligned, configured and armed.
    pub fn armed(configuration: Configuration) -> Self {
        let mut bench = Self::aligned(configuration);
        bench.session.arm().expect("arming");
        bench
    }

    /// In a speed run at this duty for a minute, after 200 ms of it.
    pub fn running(configuration: Configuration, duty: Duty) -> Self {
        let mut bench = Self::armed(configuration);
        bench.session.start_speed(speed(duty, Direction::Cw, 60_000)).expect("run");
        bench.wait(200);
        bench
    }

    /// In a closed-loop run along the thesis's sine for a minute, after 200 ms of it.
    pub fn tracking() -> Self {
        let mut bench = Self::armed(default_configuration());
        let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
        bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).expect("run");
        bench.wait(200);
        bench
    }

    pub fn board(&mut self) -> &mut Board {
        self.session.port().board()
    }

    /// Lets time pass with the host listening and keeping the link alive.
    pub fn wait(&mut self, duration_ms: u64) {
        let end_us = self.board().now_us() + duration_ms * 1_000;
        while self.board().now_us() < end_us {
            let left = Duration::from_micros(end_us - self.board().now_us());
            match self.session.next(left) {
                Ok(Some(received)) => self.seen.push(received),
                Ok(None) | Err(LinkError::Restarted) => {}
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// Who the board is, also of one that restarted in the middle of something.
    pub fn hello(&mut self) -> Identity {
        match self.session.hello() {
            Err(LinkError::Restarted) => self.session.hello(),
            other => other,
        }
        .expect("the board answers")
    }

    /// Ticks until the pins hold the motor off, with the host alive or silent. Panics after `limit`.
    pub fn ticks_until_off(&mut self, host_alive: bool, limit: u64) -> u64 {
        for tick in 0..=limit {
            if self.board().output_is_off() {
                return tick;
            }
            if host_alive && tick % 100 == 0 {
                self.session.keep_alive().expect("the link is up");
            }
            self.board().run_for(TICK_US);
        }
        panic!("the output was still on after {limit} ticks");
    }

    /// The fault the board says it latched.
    pub fn reported_fault(&mut self) -> Option<FaultReport> {
        self.wait(50);
        self.seen.iter().rev().find_map(|received| match &received.message {
            DeviceMessage::Fault(report) => Some(*report),
            _ => None,
        })
    }

    /// Proves that nothing but stop, then arm, leads out of the fault.
    pub fn assert_latched(&mut self, fault: Fault) {
        assert_eq!(self.board().mode(), Mode::Fault, "{fault:?} must latch");
        let duty = Duty::FULL;
        let refused = |result: Result<(), LinkError>| matches!(result, Err(LinkError::Refused { .. }));
        assert!(refused(self.session.arm()), "{fault:?}: arming must be refused");
        assert!(
            refused(self.session.start_speed(speed(duty, Direction::Cw, 100))),
            "{fault:?}: running must be refused"
        );
        assert!(refused(self.session.configure(default_configuration())), "{fault:?}: configuring must be refused");
        assert!(refused(self.session.align()), "{fault:?}: aligning must be refused");
        self.session.capture(CaptureMode::default()).expect("capture modes change in any state");
        self.wait(300);
        assert!(self.board().output_is_off(), "{fault:?}: the output must stay off");
        assert_eq!(
            self.session.hello().expect("the board answers").fault,
            Some(fault),
            "the fault is told after reconnecting"
        );
        self.session.stop().expect("stopping is never refused");
        assert!(self.board().output_is_off() && self.board().mode() == Mode::Idle);
        assert!(
            refused(self.session.start_speed(speed(duty, Direction::Cw, 100))),
            "stopping alone must not allow a run"
        );
    }
}

pub fn speed(duty: Duty, direction: Direction, duration_ms: u32) -> SpeedRun {
    SpeedRun { duty, direction, duration_ms }
}

pub fn default_configuration() -> Configuration {
    Configuration::with_control(ConfigSpec::DEFAULT)
}
