//! What reaches the PWM wire, seen at the pad of each chip's modules: the chip's own output stage runs here, on the PWM
//! unit and the pads the manuals describe.

use crate::bench::{Bench, TICK_US, default_configuration, speed};
use crate::document;
use std::fmt::Write;
use twum_host::sim::{Chip, Disturbance, Half, PadEdge, Setup};
use twum_shared::message::{Configuration, DeviceMessage, Mode, ResetCause, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::{Direction, Duty};

/// Starts of drive pulses (the wire is active low), ns, from `from_us` on.
fn pulses(edges: &[PadEdge], from_us: u64) -> Vec<u64> {
    edges.iter().filter(|edge| !edge.high && edge.time_ns >= from_us * 1_000).map(|edge| edge.time_ns).collect()
}

fn armed(chip: Chip, configuration: Configuration) -> Bench {
    let mut bench = Bench::new(Setup { chip, ..Setup::default() });
    bench.session.align().expect("alignment");
    bench.session.configure(configuration).expect("configuration");
    bench.session.arm().expect("arming");
    bench.board().watch_pwm();
    bench
}

/// In a closed-loop run for 1.5 s, with the host's last word spoken: its silence stops the motor 500 ms from here.
fn tracking(chip: Chip) -> Bench {
    let mut bench = armed(chip, default_configuration());
    let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
    bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).expect("run");
    bench.wait(1_500);
    bench.session.keep_alive().expect("the link is up");
    bench.board().run_for(2_000);
    bench
}

#[test]
fn a_panic_anywhere_leaves_no_drive_pulse() {
    for chip in Chip::ALL {
        for half in [Half::Tasks, Half::Control] {
            let mut bench = tracking(chip);
            let panicked_us = bench.board().now_us();
            bench.board().disturb(Disturbance::Panic(half));
            bench.board().run_for(2_000_000);
            let edges = bench.board().pwm_edges();
            assert!(pulses(&edges, panicked_us - 100_000).len() > 2, "{chip:?}, {half:?}: the motor was driven before");
            let later = pulses(&edges, panicked_us + TICK_US);
            assert!(later.is_empty(), "{chip:?}, {half:?}: {} pulses after the panic, at {later:?} ns", later.len());
        }
    }
}

#[test]
fn after_a_panic_on_either_core_the_board_restarts_by_itself_and_says_why() {
    for chip in Chip::ALL {
        for half in [Half::Tasks, Half::Control] {
            let mut bench = tracking(chip);
            bench.board().disturb(Disturbance::Panic(half));
            // The handler takes 0.6 s; the watchdog would bite after 1 s.
            bench.board().run_for(700_000);
            // The first that is heard is that it restarted.
            let _ = bench.session.hello();
            let identity = bench.session.hello().expect("the board answers");
            assert_eq!((identity.reset, identity.mode), (ResetCause::Panic, Mode::Fault), "{chip:?}, {half:?}");
        }
    }
}

/// Device time at which the recording says the last run began, µs.
fn recorded_start_us(bench: &Bench) -> u64 {
    let start = |message: &DeviceMessage| match message {
        DeviceMessage::RunStarted { start_us } => Some(*start_us),
        _ => None,
    };
    bench.seen.iter().rev().find_map(|received| start(&received.message)).expect("the run started")
}

/// A run of some periods: its recorded start and the wire's edges, ns after that.
fn timed_run(chip: Chip, pwm_hz: u16, duty: Duty) -> Vec<(i64, bool)> {
    let mut bench = armed(chip, Configuration { pwm_hz, ..default_configuration() });
    bench.session.start_speed(speed(duty, Direction::Cw, 300)).expect("run");
    bench.wait(500);
    let start_ns = recorded_start_us(&bench) as i64 * 1_000;
    bench.board().pwm_edges().iter().map(|edge| (edge.time_ns as i64 - start_ns, edge.high)).collect()
}

#[test]
fn a_run_starts_when_its_recording_says_and_no_pulse_is_short() {
    let mut table = String::from(
        "| chip | PWM, Hz | duty | first drive edge after the recorded start, µs (expected) | shortest and longest pulse, µs (asked) |\n\
         |---|---:|---:|---:|---:|\n",
    );
    for chip in Chip::ALL {
        for pwm_hz in [50u16, 100, 2_000] {
            for (name, duty) in [
                ("1/1024", Duty::from_ratio(1, 1_024)),
                ("0.1", Duty::from_ratio(1, 10)),
                ("0.5", Duty::from_ratio(1, 2)),
                ("1", Duty::FULL),
            ] {
                let edges = timed_run(chip, pwm_hz, duty);
                let period_ns = 1e9 / f64::from(pwm_hz);
                let asked_ns = period_ns * f64::from(duty.raw()) / f64::from(Duty::FULL.raw());
                // The wire's first edge is its first fall: it was high before.
                assert!(edges[0].1 && !edges[1].1, "{chip:?}, {pwm_hz} Hz, {name}");
                let first_us = edges[1].0 as f64 / 1e3;
                let expected_us = (period_ns - asked_ns) / 1e3;
                assert!(
                    (first_us - expected_us).abs() <= TICK_US as f64,
                    "{chip:?}, {pwm_hz} Hz, {name}: the first drive edge is {first_us} µs after the recorded start"
                );
                // The run's end cuts its last pulse.
                let widths: Vec<i64> =
                    edges[1..].windows(2).filter(|pair| !pair[0].1).map(|pair| pair[1].0 - pair[0].0).collect();
                let whole = if widths.len() > 1 { &widths[..widths.len() - 1] } else { &widths };
                let (shortest, longest) = (whole.iter().min().unwrap(), whole.iter().max().unwrap());
                // The counter's step, and the clock's.
                let step_ns = period_ns / 16_384.0 + 12.5;
                assert!(
                    *shortest as f64 >= asked_ns - step_ns,
                    "{chip:?}, {pwm_hz} Hz, {name}: a pulse of {shortest} ns, {asked_ns} asked"
                );
                if duty != Duty::FULL {
                    assert!(
                        *longest as f64 <= asked_ns + step_ns,
                        "{chip:?}, {pwm_hz} Hz, {name}: a pulse of {longest} ns"
                    );
                }
                writeln!(
                    table,
                    "| {chip:?} | {pwm_hz} | {name} | {first_us:.1} ({expected_us:.1}) | {:.1}, {:.1} ({:.1}) |",
                    *shortest as f64 / 1e3,
                    *longest as f64 / 1e3,
                    asked_ns / 1e3,
                )
                .unwrap();
            }
        }
    }
    document::check_in("firmware.md", "run-start", &table);
}

#[test]
fn a_run_that_is_stopped_before_its_first_period_never_drives() {
    let mut configuration = default_configuration();
    configuration.pwm_hz = 10;
    let mut bench = armed(Chip::Esp32c3, configuration);
    // Past the period in which the new frequency is taken.
    bench.wait(150);
    bench.session.start_speed(speed(Duty::FULL, Direction::Cw, 1_000)).expect("run");
    bench.session.stop().expect("stopping is never refused");
    bench.wait(300);
    assert!(pulses(&bench.board().pwm_edges(), 0).is_empty());
    let ends: Vec<_> = bench.seen.iter().filter(|r| matches!(r.message, DeviceMessage::RunEnded { .. })).collect();
    assert_eq!(ends.len(), 1, "its end is told, and its start with it: {}", recorded_start_us(&bench));
}

#[test]
fn the_boot_brings_the_wire_from_pulled_up_to_driven_high_and_nothing_in_between() {
    for chip in Chip::ALL {
        let mut bench = Bench::new(Setup { chip, ..Setup::default() });
        bench.board().watch_pwm();
        for cause in [ResetCause::External, ResetCause::Watchdog, ResetCause::Software] {
            bench.board().disturb(Disturbance::Reset(cause));
            bench.board().run_for(100_000);
        }
        let edges = bench.board().pwm_edges();
        assert!(edges.iter().all(|edge| edge.high) && edges.len() == 1, "{chip:?}: {edges:?}");
        assert!(bench.board().pwm_is_driven(), "{chip:?}: the pad drives the wire high");
    }
}
