//! Long runs in virtual time, and runs started just below the wrap of a counter.

use crate::bench::{Bench, default_configuration, speed};
use std::time::Instant;
use twum_host::sim::Setup;
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage, Mode, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::{Direction, Duty, Fault};

const SINE: Reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };

/// Tracks the sine for so long and gives the ticks that arrived, with the device time between the first and the last.
fn track(bench: &mut Bench, seconds: u32) -> (u64, u64) {
    bench.session.start_track(TrackRun { reference: SINE, duration_ms: seconds * 1_000 }).unwrap();
    let (mut ticks, mut first_us, mut last_us) = (0u64, None, 0);
    for _ in 0..=seconds {
        bench.wait(1_000);
        for received in bench.seen.drain(..) {
            if let DeviceMessage::Control(block) = received.message {
                assert_eq!(block.first_tick, ticks, "ticks are consecutive");
                ticks += block.samples.len() as u64;
                first_us.get_or_insert(block.first_us);
                last_us = block.first_us + 500 * (block.samples.len() as u64 - 1);
            }
        }
    }
    (ticks, last_us - first_us.unwrap_or(last_us))
}

fn armed(setup: Setup) -> Bench {
    let mut bench = Bench::new(setup);
    bench.session.configure(default_configuration()).unwrap();
    bench.session.align().unwrap();
    bench.session.capture(CaptureMode { bits: true, edges: true, control: true }).unwrap();
    bench.session.arm().unwrap();
    bench
}

#[test]
fn clocks_that_wrap_during_a_run_change_nothing() {
    // The 32-bit µs clock of the edges wraps at 2^32; 2^31 and 2^33 for good measure.
    for wrap in [1u64 << 31, 1 << 32, 1 << 33] {
        let mut bench = armed(Setup { start_us: wrap - 3_000_000, ..Setup::default() });
        let (ticks, span_us) = track(&mut bench, 5);
        // A tick starts up to 3 µs late here: the last one of the run is the same, or the one after.
        assert!((10_000..=10_001).contains(&ticks) && span_us == (ticks - 1) * 500, "{ticks} ticks in {span_us} us");
        assert!(bench.board().now_us() > wrap);
        assert_eq!(bench.board().mode(), Mode::Armed);
    }
}

#[test]
fn the_position_bound_stops_a_count_long_before_it_can_wrap() {
    let mut configuration: Configuration = default_configuration();
    (configuration.limits.position_min, configuration.limits.position_max) = (-50, 50);
    for direction in [Direction::Cw, Direction::Ccw] {
        let mut bench = Bench::armed(configuration);
        bench.session.start_speed(speed(Duty::FULL, direction, 60_000)).unwrap();
        bench.wait(500);
        assert_eq!(bench.reported_fault().unwrap().fault, Fault::PositionBound);
    }
}

/// `TWUM_SOAK_HOURS=24 cargo test --release -p twum-tests --test board -- --ignored --nocapture soak`
#[test]
#[ignore = "minutes to hours; docs/reliability.md gives the command"]
fn soak() {
    let hours: u32 = std::env::var("TWUM_SOAK_HOURS").ok().and_then(|hours| hours.parse().ok()).unwrap_or(1);
    let started = Instant::now();
    let mut bench = armed(Setup::default());
    let memory_before = resident_kib();
    for hour in 0..hours {
        let (ticks, span_us) = track(&mut bench, 3_599);
        assert_eq!(span_us, (ticks - 1) * 500, "no drift between tick and time");
        // A tick starts up to 3 µs late here, and a run ends with the first that starts a whole duration after its first: the
        // same, or the one after.
        assert!((3_599 * 2_000..=3_599 * 2_000 + 1).contains(&ticks), "{ticks} ticks in 3599 s");
        assert!(bench.session.tally().is_lossless(), "{:?}", bench.session.tally());
        println!("{} h of motion in {:.0} s", hour + 1, started.elapsed().as_secs_f64());
    }
    let grown = resident_kib().saturating_sub(memory_before);
    println!(
        "{hours} h in {:.0} s; resident memory grew by {grown} KiB; {:?}",
        started.elapsed().as_secs_f64(),
        bench.session.tally()
    );
    assert!(grown < 4 * 1024, "memory grew by {grown} KiB");
}

/// Resident memory of this process, where the system says.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()).and_then(|kib| kib.parse().ok()).unwrap_or(0)
}
