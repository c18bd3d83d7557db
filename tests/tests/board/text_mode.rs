//! The driver board's own motion: nothing ends it within a line, so everything has to end it between lines.

use crate::bench::{Bench, default_configuration};
use twum_host::sim::{Disturbance, DriverHealth, Setup};
use twum_shared::Fault;
use twum_shared::driver::LINE_MICROSTEPS;
use twum_shared::message::{DeviceMessage, Mode, ResetCause};

/// The farthest the rotor may go on: a line's worth of microsteps of 0.05°.
const LINE_DEG: f64 = 0.05 * LINE_MICROSTEPS as f64 + 1e-9;

/// In the middle of a line that would turn the rotor for hours.
fn passing() -> Bench {
    let mut bench = Bench::new(Setup::default());
    bench.session.driver(heapless::String::try_from("u65535,x65535").unwrap()).unwrap();
    bench.wait(1_000);
    assert_eq!(bench.board().mode(), Mode::Passthrough);
    assert!(bench.board().angle_rad().to_degrees() > 5.0, "it turns");
    bench
}

fn angle_deg(bench: &mut Bench) -> f64 {
    bench.board().angle_rad().to_degrees()
}

#[test]
fn a_stop_ends_a_driver_line_and_says_so_only_when_the_edges_have_ceased() {
    let mut bench = passing();
    let before_deg = angle_deg(&mut bench);
    bench.session.stop().unwrap();
    let stopped_deg = angle_deg(&mut bench);
    assert!(stopped_deg - before_deg <= LINE_DEG, "{before_deg}° to {stopped_deg}°");
    bench.wait(3_600_000 / 60);
    assert_eq!(angle_deg(&mut bench), stopped_deg, "nothing moves after \"stopped\"");
    assert_eq!(bench.board().mode(), Mode::Idle);
}

#[test]
fn while_the_driver_board_still_moves_the_board_says_stopping() {
    let mut bench = passing();
    let modes: Vec<Mode> = (0..300)
        .map(|_| {
            bench.board().run_for(1_000);
            bench.board().mode()
        })
        .collect();
    assert!(modes.iter().all(|mode| *mode == Mode::Passthrough));
    let stop = twum_shared::message::HostMessage::Stop { clear_fault: false };
    bench.session.send(&stop).unwrap();
    bench.board().run_for(10_000);
    assert_eq!(bench.board().mode(), Mode::Stopping);
    // A second stop changes nothing, and anything else is refused.
    bench.session.send(&stop).unwrap();
    bench.board().run_for(10_000);
    assert_eq!(bench.board().mode(), Mode::Stopping);
    assert!(bench.session.configure(default_configuration()).is_err());
    bench.wait(600);
    assert_eq!(bench.board().mode(), Mode::Idle);
    let done = bench.seen.iter().any(|received| received.message == DeviceMessage::DriverDone);
    assert!(!done, "a line that was stopped is not done");
}

/// How long the rotor goes on after the host was heard for the last time, ms.
fn goes_on_ms(bench: &mut Bench) -> u64 {
    bench.session.keep_alive().unwrap();
    let (mut last_deg, mut last_ms) = (angle_deg(bench), 0);
    for ms in 1..2_000 {
        bench.board().run_for(1_000);
        let now_deg = angle_deg(bench);
        if now_deg != last_deg {
            (last_deg, last_ms) = (now_deg, ms);
        }
    }
    last_ms
}

#[test]
fn a_silent_host_ends_a_driver_line_and_an_alignment_by_the_command_timeout() {
    // At every moment of a piece, which lasts for some 50 ms: the one that is going on has ended by then too.
    let timeout_ms = u64::from(default_configuration().limits.command_timeout_ms);
    for after_ms in (0..60).step_by(6) {
        let mut bench = passing();
        bench.wait(after_ms);
        let went_on_ms = goes_on_ms(&mut bench);
        assert!((timeout_ms - 200..=timeout_ms).contains(&went_on_ms), "{after_ms} ms: {went_on_ms} ms");
        let after_deg = angle_deg(&mut bench);
        bench.board().run_for(60_000_000);
        assert_eq!(angle_deg(&mut bench), after_deg);
        assert_eq!(bench.session.hello().unwrap().fault, Some(Fault::CommandTimeout));
    }

    for after_ms in (0..400).step_by(40) {
        let mut bench = Bench::new(Setup { start_pitch: 0.05, ..Setup::default() });
        bench.session.begin_alignment().unwrap();
        bench.wait(after_ms);
        let went_on_ms = goes_on_ms(&mut bench);
        assert!(went_on_ms <= timeout_ms, "{after_ms} ms: {went_on_ms} ms");
        assert_eq!(bench.session.hello().unwrap().fault, Some(Fault::CommandTimeout), "{after_ms} ms");
        assert_eq!(bench.board().mode(), Mode::Fault);
    }
}

#[test]
fn a_slow_driver_board_is_no_silent_host() {
    // 10 ms a microstep: a line lasts for 0.2 s, two fifths of the timeout.
    let mut bench = Bench::new(Setup { driver: DriverHealth::Slow, ..Setup::default() });
    bench.session.driver(heapless::String::try_from("u200").unwrap()).unwrap();
    bench.wait(3_000);
    assert!(
        bench.seen.iter().any(|received| received.message == DeviceMessage::DriverDone),
        "{:?}",
        bench.board().mode()
    );
    assert!((angle_deg(&mut bench) - 10.0).abs() < 1e-9);
}

#[test]
fn a_restart_and_a_fault_end_a_driver_line() {
    for harm in [
        Disturbance::Reset(ResetCause::External),
        Disturbance::Reset(ResetCause::Panic),
        Disturbance::Fault(Fault::Overspeed),
    ] {
        let mut bench = passing();
        let before_deg = angle_deg(&mut bench);
        bench.board().disturb(harm);
        bench.board().run_for(60_000_000);
        let turned_deg = angle_deg(&mut bench) - before_deg;
        assert!(turned_deg <= LINE_DEG, "{harm:?}: {turned_deg}°");
    }
}

#[test]
fn a_stop_ends_an_alignment_within_a_line() {
    for after_ms in (20..900).step_by(40) {
        let mut bench = Bench::new(Setup { start_pitch: 0.05, ..Setup::default() });
        bench.session.begin_alignment().unwrap();
        bench.wait(after_ms);
        let before_deg = angle_deg(&mut bench);
        bench.session.stop().unwrap();
        let stopped_deg = angle_deg(&mut bench);
        assert!((stopped_deg - before_deg).abs() <= LINE_DEG, "{after_ms} ms: {before_deg}° to {stopped_deg}°");
        bench.board().run_for(5_000_000);
        assert_eq!(angle_deg(&mut bench), stopped_deg, "{after_ms} ms");
    }
}

#[test]
fn a_condition_ends_a_line_s_repetition_as_the_board_would() {
    // From 0.3 of a pitch of 0.9°, the sensor goes high after 13 microsteps.
    let mut bench = Bench::new(Setup::default());
    bench.session.driver(heapless::String::try_from("u1,ap,ADC>2100?S,x100").unwrap()).unwrap();
    bench.wait(5_000);
    assert!(bench.seen.iter().any(|received| received.message == DeviceMessage::DriverDone));
    assert!((angle_deg(&mut bench) - 0.65).abs() < 1e-9, "{}°", angle_deg(&mut bench));
    let replies = bench.seen.iter().filter(|r| matches!(r.message, DeviceMessage::DriverReply(_))).count();
    assert_eq!(replies, 13, "the readings that were asked for, and no others");
}
