//! Who may move the motor, who keeps it moving, and that anybody may stop it.

use crate::bench::{Bench, default_configuration, speed};
use std::time::Duration;
use twum_host::link::bench::{Action, Experiment, perform};
use twum_host::link::{LinkError, Port, Session, SimulatedLink};
use twum_host::sim::{Disturbance, Setup};
use twum_shared::frame::{self, Decoder, Header, MAX_ENCODED};
use twum_shared::message::{CaptureMode, DeviceMessage, HostMessage, Mode, Pass, RunEnd};
use twum_shared::safety::Limits;
use twum_shared::{Direction, Duty, Fault};

fn framed(sequence: u32, message: &HostMessage) -> Vec<u8> {
    frame::encode(Header { sequence, time_us: 0 }, message, &mut [0; MAX_ENCODED]).unwrap().to_vec()
}

#[test]
fn only_the_session_that_started_the_run_keeps_it_alive() {
    let mut bench = Bench::running(default_configuration(), Duty::FULL);
    // The host is dead from here on; a viewer says all that a viewer may, every 50 ms.
    let viewer = [
        HostMessage::Hello,
        HostMessage::Keepalive { token: 0 },
        HostMessage::Keepalive { token: 77 },
        HostMessage::AskPass { token: 77 },
        HostMessage::Capture(CaptureMode { bits: true, edges: true, control: true }),
        HostMessage::Arm { token: 77 },
        HostMessage::Configure(default_configuration()),
    ];
    let mut sequence = 5_000;
    for _ in 0..12 {
        for message in &viewer {
            sequence += 1;
            bench.board().send(&framed(sequence, message));
        }
        bench.board().run_for(50_000);
    }
    assert!(bench.board().output_is_off());
    // The answers to the viewer's hellos go first.
    bench.wait(50);
    assert_eq!(bench.session.hello().unwrap().fault, Some(Fault::CommandTimeout));
}

/// A link that keeps what the host says.
struct Tapped(SimulatedLink, Vec<u8>);

impl Port for Tapped {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.1.extend(bytes);
        self.0.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        self.0.receive(into, wait)
    }

    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

#[test]
fn what_a_host_said_starts_nothing_when_it_is_said_again() {
    let mut session = Session::new(Tapped(SimulatedLink::new(Setup::default()), Vec::new()));
    session.hello().unwrap();
    session.configure(default_configuration()).unwrap();
    session.align().unwrap();
    session.arm().unwrap();
    session.start_speed(speed(Duty::FULL, Direction::Cw, 300)).unwrap();
    session.rest(Duration::from_millis(500)).unwrap();
    session.halt().unwrap();
    session.driver(heapless::String::try_from("u100").unwrap()).unwrap_err();
    let said = session.port().1.clone();
    let moves = |session: &mut Session<Tapped>, what: &str| {
        // As fast as the line is, then frame by frame with all the time that the first time took.
        let pieces: Vec<&[u8]> = said.split_inclusive(|byte| *byte == 0).collect();
        for (pieces, pause_us) in [(vec![&said[..]], 200_000), (pieces, 3_000)] {
            for piece in pieces {
                session.port().0.send(piece).unwrap();
                let board = session.port().0.board();
                for _ in 0..pause_us / 500 {
                    board.run_for(500);
                    assert!(board.output_is_off(), "{what}: a replayed frame drove the motor");
                    assert_ne!(board.mode(), Mode::Running, "{what}");
                    assert_ne!(board.mode(), Mode::Aligning, "{what}");
                }
            }
        }
    };
    moves(&mut session, "aligned and idle");
    session.stop().unwrap();
    session.port().0.board().disturb(Disturbance::Reset(twum_shared::message::ResetCause::External));
    session.port().0.board().disturb(Disturbance::DriverPowerCycled);
    moves(&mut session, "just booted");
}

#[test]
fn a_pass_works_once_and_for_its_session_only() {
    let mut bench = Bench::armed(default_configuration());
    let run = speed(Duty::FULL, Direction::Cw, 100);
    let mut refused = |pass: Pass| {
        bench.board().send(&framed(9_000, &HostMessage::Speed { pass, run }));
        bench.board().run_for(5_000);
        assert_eq!(bench.board().mode(), Mode::Armed);
    };
    refused(Pass::default());
    refused(Pass { token: 1, nonce: 0 });
    let error = {
        let mut other = Bench::armed(default_configuration());
        other.session.start_speed(run).unwrap();
        other.wait(300);
        assert_eq!(other.board().mode(), Mode::Armed, "the run is over");
        // Another run needs another pass, which the session asks for.
        other.session.start_speed(run).unwrap();
        other.wait(300);
        other.session.start_speed(speed(Duty::FULL, Direction::Cw, 0)).unwrap_err()
    };
    assert!(matches!(error, LinkError::Refused { .. }), "{error}");
}

#[test]
fn a_stop_among_a_flood_is_taken_at_the_next_tick_and_what_came_before_it_starts_nothing() {
    // The slowest control there is: two commands every 10 ms.
    let mut configuration = default_configuration();
    configuration.control.period_us = 10_000;
    let mut bench = Bench::running(configuration, Duty::FULL);
    let flood: Vec<u8> = (0..40).flat_map(|n| framed(20_000 + n, &HostMessage::AskPass { token: 1 })).collect();
    bench.board().send(&flood);
    bench.board().send(&framed(30_000, &HostMessage::Stop { clear_fault: false }));
    // 40 frames of 20 bytes are 9 ms of line, and a tick is 10 ms.
    bench.board().run_for(25_000);
    assert!(bench.board().output_is_off());
    assert_eq!(bench.board().mode(), Mode::Idle);
    bench.wait(300);
    assert!(
        bench.seen.iter().any(|received| received.message == DeviceMessage::Ack { of: 30_000 }),
        "the stop is acknowledged"
    );

    // An arming that waits in the queue when the stop comes is taken back.
    bench.board().send(&flood[..flood.len() / 4]);
    bench.board().send(&framed(31_000, &HostMessage::Arm { token: 1 }));
    bench.board().send(&framed(31_001, &HostMessage::Stop { clear_fault: false }));
    bench.board().run_for(100_000);
    assert_eq!(bench.board().mode(), Mode::Idle, "nothing that came before the stop leads on");
}

/// A link that loses the first stop frames.
struct Lossy {
    link: SimulatedLink,
    decoder: Decoder,
    to_lose: u32,
    keepalives_since_first: u32,
    lost: u32,
}

impl Port for Lossy {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for byte in bytes {
            match self.decoder.push::<HostMessage>(*byte) {
                Some(Ok((_, HostMessage::Stop { .. }))) if self.lost < self.to_lose => {
                    self.lost += 1;
                    return Ok(());
                }
                Some(Ok((_, HostMessage::Keepalive { .. }))) if self.lost > 0 => self.keepalives_since_first += 1,
                _ => {}
            }
        }
        self.link.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        self.link.receive(into, wait)
    }

    fn elapsed(&self) -> Duration {
        self.link.elapsed()
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

#[test]
fn each_lost_stop_frame_costs_ten_milliseconds_and_no_keepalive_goes_out_meanwhile() {
    for to_lose in 0..=3 {
        let link = SimulatedLink::new(Setup::default());
        let mut session =
            Session::new(Lossy { link, decoder: Decoder::new(), to_lose, keepalives_since_first: 0, lost: 0 });
        session.hello().unwrap();
        session.configure(default_configuration()).unwrap();
        session.align().unwrap();
        session.arm().unwrap();
        session.start_speed(speed(Duty::FULL, Direction::Cw, 60_000)).unwrap();
        session.rest(Duration::from_millis(300)).unwrap();
        let before = session.port().elapsed();
        let before_rad = session.port().link.board().angle_rad();
        session.halt().unwrap();
        let took = session.port().elapsed() - before;
        let turned_deg = (session.port().link.board().angle_rad() - before_rad).to_degrees();
        println!("{to_lose} stop frames lost: the motor was seen to stand after {took:?} and {turned_deg:.1}°");
        assert!(took < Duration::from_millis(40 + 10 * u64::from(to_lose)), "{took:?}");
        assert_eq!((session.port().lost, session.port().keepalives_since_first), (to_lose, 0));
        assert!(session.port().link.board().output_is_off());
    }
}

#[test]
fn a_run_command_clears_no_fault_and_starts_nothing_under_one() {
    let mut session = Session::new(SimulatedLink::new(Setup::default()));
    let experiment = Experiment {
        configuration: Some(default_configuration()),
        capture: CaptureMode::default(),
        action: Action::Speed(speed(Duty::FULL, Direction::Cw, 500)),
        recording: None,
        motor: String::new(),
    };
    perform(&mut session, &experiment, None, |_| {}).unwrap();
    let mut faulted = false;
    let outcome = perform(&mut session, &experiment, None, |received| {
        faulted |= matches!(received.message, DeviceMessage::RunStarted { .. });
    });
    assert_eq!(outcome.unwrap().run.unwrap().end, RunEnd::Completed);

    // A run that ends in a fault leaves it latched, though the command stops the motor at its end.
    let mut small = experiment.clone();
    small.configuration.as_mut().unwrap().limits.position_max = 10;
    let outcome = perform(&mut session, &small, None, |_| {}).unwrap();
    assert!(matches!(outcome.cut(), Some(LinkError::Fault(Fault::PositionBound))), "{outcome:?}");
    assert_eq!(session.hello().unwrap().fault, Some(Fault::PositionBound));
    for _ in 0..3 {
        let error = perform(&mut session, &experiment, None, |_| {}).unwrap_err();
        assert!(matches!(error, LinkError::Latched(Fault::PositionBound)), "{error}");
        assert!(error.to_string().contains("`twum stop` clears it"), "{error}");
        assert!(session.port().board().output_is_off());
    }
    session.stop().unwrap();
    perform(&mut session, &experiment, None, |_| {}).unwrap();
}

#[test]
fn a_session_that_is_dropped_stops_what_it_set_in_motion() {
    use std::cell::RefCell;
    use std::rc::Rc;
    #[derive(Clone)]
    struct Shared(Rc<RefCell<SimulatedLink>>);
    impl Port for Shared {
        fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
            self.0.borrow_mut().send(bytes)
        }
        fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
            self.0.borrow_mut().receive(into, wait)
        }
        fn elapsed(&self) -> Duration {
            self.0.borrow().elapsed()
        }
        fn is_virtual(&self) -> bool {
            true
        }
    }
    let link = Shared(Rc::new(RefCell::new(SimulatedLink::new(Setup::default()))));
    let mut session = Session::new(link.clone());
    session.hello().unwrap();
    session.configure(default_configuration()).unwrap();
    session.align().unwrap();
    session.arm().unwrap();
    session.start_speed(speed(Duty::FULL, Direction::Cw, 60_000)).unwrap();
    session.rest(Duration::from_millis(200)).unwrap();
    assert!(!link.0.borrow_mut().board().output_is_off());
    let unwound = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
        let _session = session;
        panic!("a defect");
    }));
    assert!(unwound.is_err());
    assert!(link.0.borrow_mut().board().output_is_off());
    assert_eq!(link.0.borrow_mut().board().mode(), Mode::Idle);
}

#[test]
fn limits_that_stop_too_late_are_refused_on_the_wire() {
    let mut bench = Bench::new(Setup::default());
    for widen in [
        |limits: &mut Limits| limits.command_timeout_ms = 65_000,
        |limits: &mut Limits| limits.stall_ms = 60_000,
        |limits: &mut Limits| limits.overspeed_counts_s = u32::MAX,
        |limits: &mut Limits| limits.position_max = i32::MAX,
    ] {
        let mut configuration = default_configuration();
        widen(&mut configuration.limits);
        assert!(matches!(bench.session.configure(configuration), Err(LinkError::Refused { .. })));
    }
}
