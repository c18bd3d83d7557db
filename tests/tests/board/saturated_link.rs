//! More capture data than the link carries: the board stays in charge, and what is lost is counted by stream.

use crate::bench::{Bench, default_configuration};
use twum_host::sim::{Disturbance, Setup};
use twum_shared::message::{CaptureMode, DeviceMessage, HostMessage, Mode, ResetCause, TrackRun};
use twum_shared::reference::Reference;

const ALL: CaptureMode = CaptureMode { bits: true, edges: true, control: true };
const SINE: Reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };

fn tracking(period_us: u32) -> Bench {
    let mut configuration = default_configuration();
    configuration.control.period_us = period_us;
    let mut bench = Bench::armed(configuration);
    bench.session.capture(ALL).unwrap();
    bench.session.start_track(TrackRun { reference: SINE, duration_ms: 60_000 }).unwrap();
    bench
}

#[test]
fn twenty_thousand_edges_a_second_neither_restart_the_board_nor_delay_a_stop() {
    for period_us in [100, 170, 500] {
        let mut bench = tracking(period_us);
        let edges_a_tick = if period_us == 500 { 4 } else { 2 };
        bench.board().disturb(Disturbance::Chatter(edges_a_tick));
        bench.seen.clear();
        bench.wait(5_000);
        // Extra edges are counted: the run may end in a fault, but not the board in a restart.
        let statuses = bench.seen.iter().filter(|r| matches!(r.message, DeviceMessage::Status(_))).count();
        assert!(statuses >= 45, "period {period_us} us: {statuses} statuses in 5 s");
        let lost = bench.seen.iter().rev().find_map(|r| match r.message {
            DeviceMessage::Losses(lost) => Some(lost),
            _ => None,
        });
        println!("period {period_us} us: {lost:?}");
        let before_us = bench.board().now_us();
        bench.session.stop().unwrap();
        let took_ms = (bench.board().now_us() - before_us) / 1_000;
        assert!(took_ms <= 60, "period {period_us} us: {took_ms} ms to the stop's confirmation");
        let identity = bench.session.hello().unwrap();
        assert_eq!((identity.reset, identity.mode), (ResetCause::PowerOn, Mode::Idle));
    }
}

#[test]
fn a_period_whose_ticks_do_not_fit_the_link_is_captured_in_part_and_that_is_said() {
    let mut bench = tracking(100);
    bench.wait(3_000);
    let said =
        bench.seen.iter().any(|r| matches!(&r.message, DeviceMessage::Log(line) if line.contains("link cannot carry")));
    assert!(said, "the user is told");
    let (mut ticks, mut last) = (0u64, 0);
    for received in &bench.seen {
        match &received.message {
            DeviceMessage::Control(block) => {
                assert_eq!(block.samples.len(), 16, "whole blocks");
                assert_eq!(block.first_tick % 64, 0, "every fourth");
                ticks += 16;
                last = block.first_tick;
            }
            DeviceMessage::Losses(lost) => panic!("what fits is not lost: {lost:?}"),
            _ => {}
        }
    }
    assert!(last > 25_000 && ticks * 4 >= last, "{ticks} ticks up to {last}");
    assert_eq!(bench.board().mode(), Mode::Running, "control does not suffer");
    bench.session.stop().unwrap();

    // At the ordinary period every tick is there.
    let mut bench = tracking(500);
    bench.wait(3_000);
    let ticks: usize = bench
        .seen
        .iter()
        .map(|r| if let DeviceMessage::Control(block) = &r.message { block.samples.len() } else { 0 })
        .sum();
    assert!(ticks > 5_900, "{ticks}");
}

#[test]
fn a_flood_of_commands_is_answered_and_a_stop_still_taken() {
    let mut bench = Bench::new(Setup::default());
    for _ in 0..200 {
        bench.session.send(&HostMessage::Hello).unwrap();
    }
    bench.session.stop().unwrap();
    bench.wait(500);
    assert_eq!(bench.session.hello().unwrap().reset, ResetCause::PowerOn);
}
