//! Every named fault, provoked: the output is off within a stated number of ticks, the fault is latched and told, and only
//! stop, then arm, leads on. `docs/safety.md` states the same numbers.

use crate::bench::{Bench, TICK_US, default_configuration, speed};
use twum_host::sim::{Disturbance, Setup};
use twum_shared::encoder::CountSign;
use twum_shared::message::{CaptureMode, Configuration, Mode, ResetCause, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::{Direction, Duty, Fault};

const HALF: Duty = Duty::from_ratio(1, 2);

/// Runs the bench until the output is off and checks time, latch and report.
fn expect(mut bench: Bench, host_alive: bool, fault: Fault, within_ticks: u64) {
    let ticks = bench.ticks_until_off(host_alive, within_ticks);
    println!("{fault:?}: off after {ticks} ticks, stated {within_ticks}");
    let report = bench.reported_fault().expect("the fault is reported");
    assert_eq!(report.fault, fault);
    bench.assert_latched(fault);
}

fn with(change: impl FnOnce(&mut Configuration)) -> Configuration {
    let mut configuration = default_configuration();
    change(&mut configuration);
    configuration
}

#[test]
fn loop_overrun() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::LateTicks(150));
    expect(bench, true, Fault::LoopOverrun, 5);
}

#[test]
fn loop_overrun_by_one_very_late_tick() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::LateTicks(5_000));
    expect(bench, true, Fault::LoopOverrun, 12);
}

#[test]
fn command_timeout() {
    // 500 ms after the last keepalive, which may be no older than 100 ms here.
    expect(Bench::running(default_configuration(), HALF), false, Fault::CommandTimeout, 1_001);
    expect(Bench::tracking(), false, Fault::CommandTimeout, 1_001);
}

#[test]
fn command_timeout_while_armed() {
    let mut bench = Bench::armed(default_configuration());
    bench.board().run_for(600_000);
    assert_eq!(bench.board().mode(), Mode::Fault);
    assert_eq!(bench.reported_fault().unwrap().fault, Fault::CommandTimeout);
}

#[test]
fn encoder_stall() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::EncoderDead(true));
    expect(bench, true, Fault::EncoderStall, 1_002);
}

#[test]
fn encoder_chatter() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::Chatter(6));
    expect(bench, true, Fault::EncoderChatter, 2);
}

#[test]
fn wrong_direction_in_an_open_loop() {
    let mut bench = Bench::armed(with(|c| c.count_sign = CountSign::Reversed));
    bench.session.start_speed(speed(HALF, Direction::Cw, 60_000)).unwrap();
    bench.board().run_for(30_000);
    expect(bench, true, Fault::WrongDirection, 400);
}

#[test]
fn wrong_direction_in_a_closed_loop_is_caught_within_a_quarter_turn_and_a_fifth_of_a_second() {
    for control in [twum_shared::step::ConfigSpec::THESIS, twum_shared::step::ConfigSpec::DEFAULT] {
        let mut configuration = Configuration::with_control(control);
        configuration.count_sign = CountSign::Reversed;
        let mut bench = Bench::armed(configuration);
        let before = bench.board().angle_rad();
        let reference = Reference::Step { position: 50, at_us: 0 };
        bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).unwrap();
        let ticks = bench.ticks_until_off(true, 400);
        bench.board().run_for(100_000);
        let turned_deg = (bench.board().angle_rad() - before).to_degrees().abs();
        println!("reversed count: off after {ticks} ticks and {turned_deg:.1}°");
        assert!(turned_deg < 90.0);
        bench.assert_latched(Fault::WrongDirection);
    }
}

#[test]
fn following_error() {
    let mut bench = Bench::armed(default_configuration());
    let reference = Reference::Step { position: 200, at_us: 100_000 };
    bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).unwrap();
    bench.wait(150);
    expect(bench, true, Fault::FollowingError, 1);
}

#[test]
fn overspeed() {
    let mut bench = Bench::armed(with(|c| c.limits.overspeed_counts_s = 150));
    bench.session.start_speed(speed(Duty::FULL, Direction::Cw, 60_000)).unwrap();
    bench.board().run_for(5_000);
    // Two windows of 50 ms: the first may hold the start-up.
    expect(bench, true, Fault::Overspeed, 201);
}

#[test]
fn position_bound() {
    let mut bench = Bench::armed(with(|c| c.limits.position_max = 30));
    bench.session.start_speed(speed(HALF, Direction::Cw, 60_000)).unwrap();
    bench.wait(50);
    // At most 30 counts at 100 counts/s.
    expect(bench, true, Fault::PositionBound, 800);
}

#[test]
fn queue_overflow_when_the_tasks_hang() {
    let mut bench = Bench::armed(with(|c| c.limits.lost_items = 50));
    bench.session.capture(CaptureMode { bits: true, edges: true, control: true }).unwrap();
    let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
    bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).unwrap();
    bench.wait(100);
    bench.board().disturb(Disturbance::TasksHung);
    // 256 ticks fill the queue, 50 more are lost.
    let ticks = bench.ticks_until_off(false, 310);
    println!("QueueOverflow: off after {ticks} ticks");
    assert_eq!(bench.board().mode(), Mode::Fault);
}

#[test]
fn a_hung_control_interrupt_is_ended_by_the_hardware_watchdog() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::ControlHung);
    // 1 s of watchdog and up to 100 ms since it was last fed.
    let ticks = bench.ticks_until_off(true, 2_201);
    println!("BootFromWatchdog: off after {ticks} ticks");
    bench.wait(100);
    bench.assert_latched(Fault::BootFromWatchdog);
}

#[test]
fn hung_tasks_are_ended_by_the_hardware_watchdog() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::TasksHung);
    // The command timeout comes first: nobody hears the host any more.
    let ticks = bench.ticks_until_off(true, 1_001);
    println!("TasksHung: off after {ticks} ticks");
    bench.wait(1_200);
    bench.assert_latched(Fault::BootFromWatchdog);
}

#[test]
fn a_panic_switches_off_at_once_and_is_told_at_the_next_boot() {
    let mut bench = Bench::running(default_configuration(), HALF);
    bench.board().disturb(Disturbance::Panic);
    assert!(bench.board().output_is_off());
    bench.wait(100);
    bench.assert_latched(Fault::BootFromPanic);
}

#[test]
fn faults_that_tasks_report_stop_a_run_at_the_next_tick() {
    for fault in [Fault::RxOverrun, Fault::QueueOverflow, Fault::ConfigInvalid, Fault::DriverSilent, Fault::AlignFailed]
    {
        let mut bench = Bench::running(default_configuration(), HALF);
        bench.board().disturb(Disturbance::Fault(fault));
        expect(bench, true, fault, 1);
    }
}

#[test]
fn every_fault_in_every_mode_leaves_the_output_off_and_latched() {
    type Make = fn() -> Bench;
    let benches: [(&str, Make); 5] = [
        ("idle", || Bench::new(Setup::default())),
        ("configured", || Bench::aligned(default_configuration())),
        ("armed", || Bench::armed(default_configuration())),
        ("speed run", || Bench::running(default_configuration(), HALF)),
        ("tracking", Bench::tracking),
    ];
    for fault in Fault::ALL {
        for (mode, make) in benches {
            let mut bench = make();
            bench.board().disturb(Disturbance::Fault(fault));
            bench.board().run_for(2 * TICK_US);
            assert!(bench.board().output_is_off(), "{fault:?} while {mode}");
            let counts_only = fault == Fault::RxOverrun && matches!(mode, "idle" | "configured");
            if counts_only {
                assert_eq!(bench.board().mode(), Mode::Idle, "a lost byte at rest is counted, not latched");
            } else {
                bench.assert_latched(fault);
            }
        }
    }
}

#[test]
fn of_two_faults_at_once_the_first_is_kept_and_the_output_is_off() {
    for first in Fault::ALL {
        for second in Fault::ALL {
            let mut bench = Bench::running(default_configuration(), HALF);
            bench.board().disturb(Disturbance::Fault(first));
            bench.board().disturb(Disturbance::Fault(second));
            bench.board().run_for(3 * TICK_US);
            assert!(bench.board().output_is_off() && bench.board().mode() == Mode::Fault);
            assert_eq!(bench.session.hello().unwrap().fault, Some(first));
        }
    }
}

#[test]
fn a_board_that_starts_after_a_fault_does_not_run_before_stop() {
    for (reset, fault) in [(ResetCause::Watchdog, Fault::BootFromWatchdog), (ResetCause::Panic, Fault::BootFromPanic)] {
        let mut bench = Bench::new(Setup { reset, ..Setup::default() });
        assert!(bench.board().output_is_off());
        bench.assert_latched(fault);
    }
}

#[test]
fn a_host_that_is_gone_and_back_finds_the_fault_and_a_motor_that_is_off() {
    let mut bench = Bench::tracking();
    bench.board().run_for(3_000_000);
    assert!(bench.board().output_is_off());
    assert_eq!(bench.session.hello().unwrap().fault, Some(Fault::CommandTimeout));
    bench.session.stop().unwrap();
    bench.session.arm().unwrap();
    bench.session.start_speed(speed(HALF, Direction::Ccw, 100)).unwrap();
    bench.wait(200);
    assert_eq!(bench.board().mode(), Mode::Armed);
}
