//! The firmware on its simulated board: alignment, runs and tracking, in virtual time.

use crate::bench::{Bench, default_configuration, speed};
use twum_host::compare::replay::Replay;
use twum_host::link::LinkError;
use twum_host::sim::{Disturbance, DriverHealth, Setup};
use twum_shared::message::{Configuration, DeviceMessage, Mode, Refusal, RunEnd, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::{ConfigSpec, GuideSpec};
use twum_shared::{Direction, Duty, Fault};

/// Seconds of virtual time an alignment may take at most: four attempts of its longest waits.
const ALIGNMENT_BOUND_S: u64 = 100;

#[test]
fn alignment_finds_the_edge_from_both_sensor_levels() {
    for start_pitch in [0.3, 0.99, 1.3, 1.01, 0.0] {
        let mut bench = Bench::new(Setup { start_pitch, ..Setup::default() });
        bench.session.align().unwrap_or_else(|error| panic!("start at {start_pitch} pitches: {error}"));
        // The rotor stands within a microstep (0.05° of a pitch of 0.9°) behind the edge.
        let pitches = bench.board().angle_rad() / std::f64::consts::TAU * 400.0 + start_pitch;
        let into_pulse = pitches - pitches.floor();
        assert!(into_pulse < 0.06, "start at {start_pitch}: {into_pulse} of a pitch behind the edge");
        assert!(bench.board().output_is_off());
    }
}

#[test]
fn a_driver_board_that_is_not_well_ends_alignment_in_its_fault_in_bounded_time() {
    for (driver, fault) in [
        (DriverHealth::Silent, Fault::DriverSilent),
        (DriverHealth::Garbage, Fault::AlignFailed),
        (DriverHealth::Lame, Fault::AlignFailed),
    ] {
        let mut bench = Bench::new(Setup { driver, ..Setup::default() });
        match bench.session.align() {
            Err(LinkError::Fault(got)) => assert_eq!(got, fault),
            other => panic!("{driver:?}: {other:?}"),
        }
        assert!(bench.board().now_us() < ALIGNMENT_BOUND_S * 1_000_000);
        assert!(bench.board().output_is_off());
        bench.assert_latched(fault);
    }
}

#[test]
fn stopping_ends_an_alignment_and_the_next_one_succeeds() {
    let mut bench = Bench::new(Setup::default());
    bench.session.begin_alignment().unwrap();
    bench.wait(120);
    assert_eq!(bench.board().mode(), Mode::Aligning);
    bench.session.stop().unwrap();
    assert_eq!(bench.board().mode(), Mode::Idle);
    bench.wait(400);
    bench.session.align().unwrap();
}

#[test]
fn aligning_again_asks_for_a_power_cycle() {
    let mut bench = Bench::aligned(default_configuration());
    let again = bench.session.align();
    assert!(matches!(again, Err(LinkError::Refused { reason: Refusal::HardwareMode, .. })), "{again:?}");
}

#[test]
fn speed_runs_repeat_in_both_directions_without_a_reboot() {
    let mut bench = Bench::armed(default_configuration());
    // Full drive is 35 rpm = 233 counts/s; at 50 Hz each on-phase loses a rise of 6 ms and gains a little braking.
    for (duty, least, most) in
        [(Duty::OFF, 0, 0), (Duty::from_ratio(1, 32), 0, 6), (Duty::from_ratio(1, 2), 60, 125), (Duty::FULL, 220, 245)]
    {
        for direction in [Direction::Cw, Direction::Ccw] {
            let before = bench.board().angle_rad();
            bench.session.start_speed(speed(duty, direction, 1_000)).unwrap();
            bench.wait(1_200);
            let moved =
                (bench.board().angle_rad() - before) / std::f64::consts::TAU * 400.0 * f64::from(direction.sign());
            assert!(
                (f64::from(least) - 0.5..=f64::from(most)).contains(&moved),
                "duty {duty:?} {direction:?}: {moved} counts in a second"
            );
            assert!(bench.board().output_is_off());
            assert_eq!(bench.board().mode(), Mode::Armed);
        }
    }
    let ends =
        bench.seen.iter().filter(|r| matches!(r.message, DeviceMessage::RunEnded { end: RunEnd::Completed, .. }));
    assert_eq!(ends.count(), 8);
}

#[test]
fn the_count_is_the_rotor_within_an_edge() {
    let mut bench = Bench::running(default_configuration(), Duty::from_ratio(3, 4));
    bench.wait(2_000);
    bench.session.stop().unwrap();
    bench.wait(200);
    let position = bench
        .seen
        .iter()
        .rev()
        .find_map(|r| if let DeviceMessage::Status(status) = &r.message { Some(status.position) } else { None })
        .unwrap();
    let truth = bench.board().angle_rad() / std::f64::consts::TAU * 400.0;
    // Alignment zeroed the count up to one pitch after the rotor's own zero.
    assert!((f64::from(position) - truth).abs() <= 2.0, "{position} against {truth}");
}

#[test]
fn every_controller_tracks_the_thesis_sine() {
    // Of whole counts, of which a rotor that followed exactly would be off by half of one.
    for (spec, mean_bound_deg) in
        [(ConfigSpec::THESIS, 12.0), (ConfigSpec::DEFAULT, 2.0), (ConfigSpec::GATED, 0.6), (ConfigSpec::PLANNED, 0.7)]
    {
        let mut bench = Bench::armed(twum_shared::message::Configuration::with_control(spec));
        let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
        bench.session.capture(twum_shared::message::CaptureMode { bits: false, edges: false, control: true }).unwrap();
        bench.session.start_track(TrackRun { reference, duration_ms: 10_000 }).unwrap();
        bench.wait(10_500);
        let errors: Vec<f64> = bench
            .seen
            .iter()
            .filter_map(|r| if let DeviceMessage::Control(block) = &r.message { Some(&block.samples) } else { None })
            .flatten()
            .map(|sample| f64::from(sample.target - sample.position) * 0.9)
            .collect();
        assert!(errors.len() >= 20_000, "every tick arrives: {}", errors.len());
        let mean = errors.iter().map(|error| error.abs()).sum::<f64>() / errors.len() as f64;
        assert!(mean < mean_bound_deg, "mean error {mean}°");
    }
}

/// A rotor that stands as soon as the drive is off tells of no load. Fails when one is believed all the same, when a tick of a guided run does
/// not replay, or when the board takes a target that fixed point cannot let give way.
#[test]
fn a_guided_run_replays_and_falls_back_to_its_path_on_a_rotor_that_does_not_run_on() {
    let guide = GuideSpec::EXAMPLE;
    let guided = |guide| Configuration::with_control(ConfigSpec { guide, ..ConfigSpec::PLANNED });
    let mut bench = Bench::armed(guided(guide));
    let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
    bench.session.capture(twum_shared::message::CaptureMode { bits: false, edges: false, control: true }).unwrap();
    bench.session.start_track(TrackRun { reference, duration_ms: 15_000 }).unwrap();
    bench.wait(15_500);
    let mut replay = Replay::new();
    replay.observe(&DeviceMessage::Configured(guided(guide)));
    bench.seen.iter().for_each(|received| replay.observe(&received.message));
    let report = replay.finish();
    assert!(report.is_exact() && report.checked >= 30_000, "{report:?}");
    let felt = report.guided.unwrap();
    assert!(felt.ticks == report.checked && felt.believed * 10 < felt.ticks, "{felt:?}");
    bench.session.stop().unwrap();
    let refused = bench.session.configure(guided(GuideSpec { damping_nnm_s: 0, ..guide })).unwrap_err();
    assert!(refused.to_string().contains("guide_damping_nnm_s"), "{refused}");
}

/// Fails when a drive that is decided every tick is run with pulses that begin every 20 ms.
#[test]
fn a_gated_drive_is_refused_a_pwm_that_is_not_its_own() {
    let slow = Configuration { pwm_hz: 50, ..Configuration::with_control(ConfigSpec::GATED) };
    let mut bench = Bench::armed(slow);
    let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
    let refused = bench.session.start_track(TrackRun { reference, duration_ms: 1_000 }).unwrap_err();
    assert!(refused.to_string().contains("pwm_hz"), "{refused}");
    // A run at constant duty asks no controller.
    bench.session.start_speed(speed(Duty::from_ratio(1, 2), Direction::Cw, 100)).unwrap();
    bench.wait(300);
    assert_eq!(bench.board().mode(), Mode::Armed);
}

#[test]
fn a_passed_on_line_is_answered_and_its_motion_captured() {
    let mut bench = Bench::new(Setup::default());
    bench.session.driver(heapless::String::try_from("u100,ap").unwrap()).unwrap();
    bench.wait(1_500);
    let reply: Vec<u8> = bench
        .seen
        .iter()
        .filter_map(|r| if let DeviceMessage::DriverReply(bytes) = &r.message { Some(bytes.to_vec()) } else { None })
        .flatten()
        .collect();
    assert!(twum_shared::driver::sensor_level(&reply).is_ok(), "{}", String::from_utf8_lossy(&reply));
    assert!(bench.seen.iter().any(|r| r.message == DeviceMessage::DriverDone));
    // 100 microsteps of 0.05° pass five edges.
    assert!((bench.board().angle_rad().to_degrees() - 5.0).abs() < 1e-9);
    assert_eq!(bench.board().mode(), Mode::Idle);
}

#[test]
fn after_a_reboot_the_driver_in_hardware_mode_is_silent_until_its_power_is_cycled() {
    let mut bench = Bench::aligned(default_configuration());
    bench.session.reboot().unwrap();
    bench.wait(100);
    assert!(matches!(bench.session.align(), Err(LinkError::Fault(Fault::DriverSilent))));
    bench.session.stop().unwrap();
    bench.board().disturb(Disturbance::DriverPowerCycled);
    bench.session.align().unwrap();
}

#[test]
fn commands_out_of_place_are_refused_with_their_reason() {
    let mut bench = Bench::new(Setup::default());
    let refusal = |result: Result<(), LinkError>| match result {
        Err(LinkError::Refused { reason, .. }) => reason,
        other => panic!("{other:?}"),
    };
    assert_eq!(refusal(bench.session.arm()), Refusal::NotConfigured);
    bench.session.configure(default_configuration()).unwrap();
    assert_eq!(refusal(bench.session.arm()), Refusal::NotAligned);
    assert_eq!(refusal(bench.session.start_speed(speed(Duty::FULL, Direction::Cw, 10))), Refusal::Mode(Mode::Idle));
    let line = heapless::String::try_from("fly").unwrap();
    assert_eq!(refusal(bench.session.driver(line)), Refusal::DriverLine);
    let mut broken = default_configuration();
    broken.limits.stall_ms = 0;
    assert_eq!(refusal(bench.session.configure(broken)), Refusal::Limits);
    bench.session.align().unwrap();
    bench.session.arm().unwrap();
    assert_eq!(refusal(bench.session.start_speed(speed(Duty::FULL, Direction::Cw, 0))), Refusal::Duration);
    let wild = Reference::Sine { amplitude: 1 << 25, omega_urad_s: 1 };
    let wild = bench.session.start_track(TrackRun { reference: wild, duration_ms: 10 });
    assert!(matches!(refusal(wild), Refusal::Reference(_)));
    assert!(bench.board().output_is_off());
}

#[test]
fn the_motor_model_runs_on_the_board() {
    use twum_host::model::effects::EffectSet;
    use twum_host::model::motor::Motor;
    use twum_host::model::parameters::Flavour;
    let setup = Setup::hybrid(&Motor::pcbmotor_30mm(), Flavour::Measured, &EffectSet::default()).unwrap();
    let mut bench = Bench::new(setup);
    assert_eq!(bench.session.hello().unwrap().chip, "simulated pcbmotor-30mm measured");
    bench.session.configure(default_configuration()).unwrap();
    bench.session.align().unwrap();
    bench.session.arm().unwrap();
    let before = bench.board().angle_rad();
    bench.session.start_speed(speed(Duty::FULL, Direction::Cw, 1_000)).unwrap();
    bench.wait(1_200);
    // The real motor turns at about 35 rpm under full drive.
    let rpm = (bench.board().angle_rad() - before) / std::f64::consts::TAU * 60.0;
    assert!((30.0..40.0).contains(&rpm), "{rpm} rpm");
}
