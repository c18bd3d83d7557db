//! What reaches the PWM wire, seen at the pad of each chip's modules: the chip's own output stage runs here, on the PWM
//! unit and the pads the manuals describe.

use crate::bench::{Bench, TICK_US, default_configuration, speed};
use twum_host::sim::{Chip, Disturbance, PadEdge, Setup};
use twum_shared::message::{Configuration, DeviceMessage, HostMessage, TrackRun};
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

#[test]
fn a_panic_in_a_task_leaves_no_drive_pulse() {
    for chip in Chip::ALL {
        let mut bench = armed(chip, default_configuration());
        let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
        bench.session.start_track(TrackRun { reference, duration_ms: 60_000 }).expect("run");
        bench.wait(1_500);
        // The host's last word: its silence stops the motor 500 ms from here.
        bench.session.send(&HostMessage::Keepalive).expect("the link is up");
        bench.board().run_for(2_000);
        bench.board().disturb(Disturbance::TaskPanic);
        let panicked_us = bench.board().now_us();
        bench.board().run_for(2_000_000);
        let later = pulses(&bench.board().pwm_edges(), panicked_us + TICK_US);
        println!("{chip:?}: {} pulses after the panic", later.len());
        // What this firmware does: the control interrupt goes on where it shares the tasks' core.
        assert_eq!(later.len(), if chip == Chip::Esp32 { 0 } else { 24 }, "{chip:?}");
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

#[test]
fn a_run_starts_when_its_recording_says() {
    for chip in Chip::ALL {
        let mut bench = armed(chip, default_configuration());
        bench.session.start_speed(speed(Duty::from_ratio(1, 2), Direction::Cw, 200)).expect("run");
        bench.wait(400);
        let start_us = recorded_start_us(&bench);
        let first: Vec<u64> =
            pulses(&bench.board().pwm_edges(), 0).into_iter().map(|ns| (ns / 1_000) - start_us).take(2).collect();
        // What this firmware does: a stray pulse of 0.1 ms, and the first real period 20.2 ms late.
        println!("{chip:?}: first drive edges {first:?} µs after the recorded start");
        assert_eq!(first, if chip == Chip::Esp32 { [10_205, 30_205] } else { [20_102, 30_204] }, "{chip:?}");
    }
}
