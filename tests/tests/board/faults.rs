//! Every named fault, provoked: the output is off within a stated number of ticks, the fault is latched and told, and only
//! stop, then arm, leads on. The tables of `docs/reliability.md` are these tests' own; `docs/safety.md` states the same
//! numbers.

use crate::bench::{Bench, TICK_US, default_configuration, speed};
use crate::document;
use std::fmt::Write;
use twum_host::sim::{Disturbance, DriverHealth, Half, Setup};
use twum_shared::encoder::CountSign;
use twum_shared::message::{CaptureMode, Configuration, Mode, ResetCause, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;
use twum_shared::{Direction, Duty, Fault};

const HALF: Duty = Duty::from_ratio(1, 2);
const SINE: Reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };

fn with(change: impl FnOnce(&mut Configuration)) -> Configuration {
    let mut configuration = default_configuration();
    change(&mut configuration);
    configuration
}

fn running() -> Bench {
    Bench::running(default_configuration(), HALF)
}

fn disturbed(mut bench: Bench, disturbance: Disturbance) -> Bench {
    bench.board().disturb(disturbance);
    bench
}

fn in_speed_run(configuration: Configuration, duty: Duty) -> Bench {
    let mut bench = Bench::armed(configuration);
    bench.session.start_speed(speed(duty, Direction::Cw, 60_000)).expect("run");
    bench
}

fn in_track_run(configuration: Configuration, reference: Reference) -> Bench {
    let mut bench = Bench::armed(configuration);
    bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).expect("run");
    bench
}

/// One way to bring a fault about.
struct Scenario {
    fault: Fault,
    provoked_by: &'static str,
    /// The bench at the moment from which the ticks count.
    make: fn() -> Bench,
    host_alive: bool,
    /// The stated bound, ticks.
    within: u64,
}

const SCENARIOS: &[Scenario] = &[
    Scenario {
        fault: Fault::LoopOverrun,
        provoked_by: "every tick 150 µs late",
        make: || disturbed(running(), Disturbance::LateTicks(150)),
        host_alive: true,
        within: 5,
    },
    Scenario {
        fault: Fault::LoopOverrun,
        provoked_by: "one tick 5 ms late",
        make: || disturbed(running(), Disturbance::LateTicks(5_000)),
        host_alive: true,
        within: 12,
    },
    Scenario {
        fault: Fault::CommandTimeout,
        provoked_by: "the host falls silent in a speed run",
        // 500 ms after the last keepalive, which may be no older than 100 ms here.
        make: running,
        host_alive: false,
        within: 1_001,
    },
    Scenario {
        fault: Fault::CommandTimeout,
        provoked_by: "the host falls silent while tracking",
        make: Bench::tracking,
        host_alive: false,
        within: 1_001,
    },
    Scenario {
        fault: Fault::EncoderStall,
        provoked_by: "the encoder line goes dead at half duty",
        make: || disturbed(running(), Disturbance::EncoderDead(true)),
        host_alive: true,
        within: 1_002,
    },
    Scenario {
        fault: Fault::EncoderChatter,
        provoked_by: "6 extra edges a tick",
        make: || disturbed(running(), Disturbance::Chatter(6)),
        host_alive: true,
        within: 2,
    },
    Scenario {
        fault: Fault::WrongDirection,
        provoked_by: "count sign reversed, open loop at half duty, from 30 ms after standstill",
        make: || {
            let mut bench = in_speed_run(with(|c| c.count_sign = CountSign::Reversed), HALF);
            bench.board().run_for(30_000);
            bench
        },
        host_alive: true,
        within: 400,
    },
    Scenario {
        fault: Fault::WrongDirection,
        provoked_by: "count sign reversed, thesis controller, step of 50 counts",
        make: || reversed_loop(ConfigSpec::THESIS),
        host_alive: true,
        within: 400,
    },
    Scenario {
        fault: Fault::WrongDirection,
        provoked_by: "count sign reversed, default controller, step of 50 counts",
        make: || reversed_loop(ConfigSpec::DEFAULT),
        host_alive: true,
        within: 400,
    },
    Scenario {
        fault: Fault::FollowingError,
        provoked_by: "a step of 200 counts, 120 allowed",
        make: || {
            let mut bench = in_track_run(default_configuration(), Reference::Step { position: 200, at_us: 100_000 });
            bench.wait(150);
            bench
        },
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::Overspeed,
        provoked_by: "full duty, 150 counts/s allowed",
        make: || {
            let mut bench = in_speed_run(with(|c| c.limits.overspeed_counts_s = 150), Duty::FULL);
            bench.board().run_for(5_000);
            bench
        },
        host_alive: true,
        // Two windows of 50 ms: the first may hold the start-up.
        within: 201,
    },
    Scenario {
        fault: Fault::PositionBound,
        provoked_by: "half duty, 30 counts allowed",
        make: || {
            let mut bench = in_speed_run(with(|c| c.limits.position_max = 30), HALF);
            bench.wait(50);
            bench
        },
        host_alive: true,
        // At most 30 counts at 100 counts/s.
        within: 800,
    },
    Scenario {
        fault: Fault::QueueOverflow,
        provoked_by: "told by a task in a run",
        make: || disturbed(running(), Disturbance::Fault(Fault::QueueOverflow)),
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::AlignFailed,
        provoked_by: "told by the driver task in a run",
        make: || disturbed(running(), Disturbance::Fault(Fault::AlignFailed)),
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::DriverSilent,
        provoked_by: "told by the driver task in a run",
        make: || disturbed(running(), Disturbance::Fault(Fault::DriverSilent)),
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::ConfigInvalid,
        provoked_by: "told by a task in a run",
        make: || disturbed(running(), Disturbance::Fault(Fault::ConfigInvalid)),
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::RxOverrun,
        provoked_by: "told by the receive task in a run",
        make: || disturbed(running(), Disturbance::Fault(Fault::RxOverrun)),
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::ExternalStop,
        provoked_by: "the stop input pulled low",
        make: || disturbed(running(), Disturbance::StopInput(true)),
        host_alive: true,
        within: 1,
    },
    Scenario {
        fault: Fault::BootFromWatchdog,
        provoked_by: "the control interrupt hangs: hardware watchdog",
        // 1 s of watchdog and up to 100 ms since it was last fed.
        make: || disturbed(running(), Disturbance::ControlHung),
        host_alive: true,
        within: 2_201,
    },
    Scenario {
        fault: Fault::BootFromPanic,
        provoked_by: "a panic",
        make: || disturbed(running(), Disturbance::Panic(Half::Tasks)),
        host_alive: true,
        within: 0,
    },
];

fn reversed_loop(control: ConfigSpec) -> Bench {
    let mut configuration = Configuration::with_control(control);
    configuration.count_sign = CountSign::Reversed;
    in_track_run(configuration, Reference::Step { position: 50, at_us: 0 })
}

#[test]
fn every_fault_switches_off_within_its_stated_ticks_and_latches() {
    let mut table = String::from(
        "| fault | provoked by | off within (stated, ticks of 500 µs) | off after (measured) |\n|---|---|---|---|\n",
    );
    let mut ran_again = 0;
    for Scenario { fault, provoked_by, make, host_alive, within } in SCENARIOS {
        let mut bench = make();
        let ticks = bench.ticks_until_off(*host_alive, *within);
        writeln!(table, "| {fault:?} | {provoked_by} | {within} | {ticks} |").unwrap();
        // Until the board has told it, or has restarted: a panic's handler takes 0.6 s. A restarted board tells it when asked.
        bench.wait(if *fault == Fault::BootFromPanic { 700 } else { 50 });
        if !matches!(fault, Fault::BootFromWatchdog | Fault::BootFromPanic) {
            assert_eq!(bench.reported_fault().expect("the fault is reported").fault, *fault, "{provoked_by}");
        }
        if *fault == Fault::ExternalStop {
            bench.session.stop().expect("stopping is never refused");
            bench.wait(10);
            assert_eq!(bench.board().mode(), Mode::Fault, "the input is still low");
            bench.board().disturb(Disturbance::StopInput(false));
        }
        bench.assert_latched(*fault);
        // With its cause gone, stop and arm open the way again.
        for gone in [Disturbance::LateTicks(0), Disturbance::Chatter(0), Disturbance::EncoderDead(false)] {
            bench.board().disturb(gone);
        }
        if bench.session.arm().is_ok() {
            bench.session.start_speed(speed(HALF, Direction::Ccw, 50)).expect("after stop and arm, a run is allowed");
            ran_again += 1;
        }
    }
    // After a restart there is no alignment any more.
    assert_eq!(ran_again, SCENARIOS.len() - 2);
    document::check("faults", &table);
    for fault in Fault::ALL {
        assert!(SCENARIOS.iter().any(|scenario| scenario.fault == fault), "{fault:?} is not provoked");
    }
}

#[test]
fn the_safety_document_states_the_bounds_that_are_tested() {
    let text = document::read("safety.md");
    for Scenario { fault, provoked_by, within, .. } in SCENARIOS {
        let row = text.lines().find(|line| line.starts_with("| ") && line.contains(&format!("{fault:?}")));
        let row = row.unwrap_or_else(|| panic!("docs/safety.md has no row for {fault:?}"));
        let bound = row.rsplit('|').nth(1).unwrap_or_default();
        // Those which a task tells of stop a run at the next tick, whatever else stands there.
        let stated = bound.split(|c: char| !c.is_ascii_digit()).any(|number| number == within.to_string());
        assert!(
            stated || provoked_by.starts_with("told by") || *within == 1,
            "{fault:?}: {within} is not in `{bound}`"
        );
    }
}

#[test]
fn a_reversed_count_in_a_closed_loop_is_caught_within_a_quarter_turn_and_a_fifth_of_a_second() {
    for (_, control) in ConfigSpec::NAMED {
        let mut bench = Bench::armed(default_configuration());
        let before = bench.board().angle_rad();
        drop(bench);
        let mut bench = reversed_loop(control);
        let ticks = bench.ticks_until_off(true, 400);
        bench.board().run_for(100_000);
        let turned_deg = (bench.board().angle_rad() - before).to_degrees().abs();
        println!("reversed count: off after {ticks} ticks and {turned_deg:.1}°");
        assert!(turned_deg < 90.0);
        bench.assert_latched(Fault::WrongDirection);
    }
}

#[test]
fn command_timeout_while_armed() {
    let mut bench = Bench::armed(default_configuration());
    bench.board().run_for(600_000);
    assert_eq!(bench.board().mode(), Mode::Fault);
    assert_eq!(bench.reported_fault().unwrap().fault, Fault::CommandTimeout);
}

#[test]
fn queue_overflow_when_the_tasks_hang() {
    let mut bench = Bench::armed(with(|c| c.limits.lost_items = 50));
    bench.session.capture(CaptureMode { bits: true, edges: true, control: true }).unwrap();
    bench.session.start_track(TrackRun { reference: SINE, duration_ms: 60_000 }).unwrap();
    bench.wait(100);
    bench.board().disturb(Disturbance::TasksHung);
    // 256 ticks fill the queue, 50 more are lost; a word of bits that still finds room, every 64 ticks, begins that count anew.
    let ticks = bench.ticks_until_off(false, 360);
    println!("QueueOverflow: off after {ticks} ticks");
    assert_eq!(bench.board().mode(), Mode::Fault);
}

#[test]
fn hung_tasks_are_ended_by_the_hardware_watchdog() {
    let mut bench = disturbed(running(), Disturbance::TasksHung);
    // The command timeout comes first: nobody hears the host any more.
    let ticks = bench.ticks_until_off(true, 1_001);
    println!("TasksHung: off after {ticks} ticks");
    bench.wait(1_200);
    bench.assert_latched(Fault::BootFromWatchdog);
}

type Make = fn() -> Bench;

const MODES: [(&str, Make); 6] = [
    ("idle", || Bench::new(Setup::default())),
    ("aligning", aligning),
    ("aligned", || Bench::aligned(default_configuration())),
    ("armed", || Bench::armed(default_configuration())),
    ("speed run", running),
    ("tracking", Bench::tracking),
];

/// In the middle of the search for an edge.
fn aligning() -> Bench {
    let mut bench = Bench::new(Setup::default());
    bench.session.configure(default_configuration()).expect("configuration");
    bench.session.begin_alignment().expect("the link is up");
    bench.wait(150);
    assert_eq!(bench.board().mode(), Mode::Aligning);
    bench
}

#[test]
fn every_fault_in_every_mode_leaves_the_output_off_and_latched() {
    let mut table = format!("| fault | {} |\n|---|{}\n", MODES.map(|(mode, _)| mode).join(" | "), "---|".repeat(6));
    for fault in Fault::ALL {
        write!(table, "| {fault:?} |").unwrap();
        for (mode, make) in MODES {
            let mut bench = disturbed(make(), Disturbance::Fault(fault));
            let ticks = bench.ticks_until_off(true, 2);
            bench.board().run_for(2 * TICK_US);
            assert!(bench.board().output_is_off(), "{fault:?} while {mode}");
            if fault == Fault::RxOverrun && matches!(mode, "idle" | "aligning" | "aligned") {
                assert_ne!(bench.board().mode(), Mode::Fault, "a lost byte at rest is counted, not latched");
                table += " counted |";
            } else {
                bench.assert_latched(fault);
                write!(table, " {ticks} |").unwrap();
            }
        }
        table += "\n";
    }
    document::check("fault-matrix", &table);
}

#[test]
fn of_two_faults_at_once_the_first_is_kept_and_the_output_is_off() {
    for first in Fault::ALL {
        for second in Fault::ALL {
            let mut bench = disturbed(running(), Disturbance::Fault(first));
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

/// Causes of a restart which latch nothing.
const RESETS: [ResetCause; 4] = [ResetCause::BrownOut, ResetCause::External, ResetCause::Software, ResetCause::Unknown];

#[test]
fn a_reset_while_running_leaves_the_motor_off_and_nothing_resumes() {
    for cause in RESETS {
        for make in [running, Bench::tracking, || Bench::armed(default_configuration())] {
            let mut bench = disturbed(make(), Disturbance::Reset(cause));
            assert!(bench.board().output_is_off(), "{cause:?}: off comes first at boot");
            let before_rad = bench.board().angle_rad();
            for _ in 0..2_000 {
                bench.board().run_for(TICK_US);
                assert!(bench.board().output_is_off(), "{cause:?}: nothing resumes by itself");
            }
            let coasted_deg = (bench.board().angle_rad() - before_rad).to_degrees();
            assert!(coasted_deg.abs() < 2.0, "{cause:?}: the rotor went on for {coasted_deg}°");
            let identity = bench.hello();
            assert_eq!((identity.reset, identity.mode, identity.fault), (cause, Mode::Idle, None));
            assert!(bench.session.start_speed(speed(HALF, Direction::Cw, 100)).is_err(), "{cause:?}: run without arm");
            assert!(bench.session.arm().is_err(), "{cause:?}: arm without configuration and alignment");
            // The driver board kept its power: only cycling it leads back to its text mode.
            bench.board().disturb(Disturbance::DriverPowerCycled);
            bench.session.configure(default_configuration()).expect("configuration");
            bench.session.align().expect("alignment");
            bench.session.arm().expect("arming");
            bench.session.start_speed(speed(HALF, Direction::Cw, 100)).expect("run");
        }
    }
}

/// How long alignment takes here, ms, and more.
const ALIGNMENT_MS: u64 = 1_500;

#[test]
fn a_brown_out_at_any_moment_of_alignment_leaves_the_motor_off_and_can_be_aligned_again() {
    let (mut while_aligning, mut in_hardware_mode) = (0, 0);
    for driver_too in [false, true] {
        // The command itself takes less than a millisecond to arrive.
        for after_ms in (1..ALIGNMENT_MS).step_by(25) {
            let mut bench = Bench::new(Setup { driver: DriverHealth::Well, ..Setup::default() });
            bench.session.configure(default_configuration()).expect("configuration");
            bench.session.begin_alignment().expect("the link is up");
            for ms in 0..after_ms {
                if ms % 100 == 0 {
                    bench.session.keep_alive().expect("the link is up");
                }
                bench.board().run_for(1_000);
                assert!(bench.board().output_is_off(), "alignment goes without PWM");
            }
            while_aligning += u32::from(bench.board().mode() == Mode::Aligning);
            bench.board().disturb(Disturbance::Reset(ResetCause::BrownOut));
            if driver_too {
                bench.board().disturb(Disturbance::DriverPowerCycled);
            }
            for _ in 0..200 {
                bench.board().run_for(1_000);
                assert!(bench.board().output_is_off(), "{after_ms} ms: the output stays off");
            }
            let identity = bench.hello();
            assert_eq!((identity.reset, identity.mode, identity.fault), (ResetCause::BrownOut, Mode::Idle, None));
            bench.session.configure(default_configuration()).expect("configuration");
            assert!(bench.session.arm().is_err(), "{after_ms} ms: half an alignment is none");
            if bench.session.align().is_err() {
                // The driver board had reached hardware mode: it is silent until its power is cycled, and that is said.
                assert!(!driver_too, "{after_ms} ms: a driver board that lost its power too listens");
                in_hardware_mode += 1;
                bench.assert_latched(Fault::DriverSilent);
                bench.board().disturb(Disturbance::DriverPowerCycled);
                bench.session.align().expect("alignment");
            }
            bench.session.arm().expect("arming");
        }
    }
    println!("{while_aligning} brown-outs fell into alignment; {in_hardware_mode} left the driver in hardware mode");
    assert!(while_aligning >= 40, "only {while_aligning} fell into alignment: the test does not test");
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
