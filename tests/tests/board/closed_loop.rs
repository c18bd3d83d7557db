//! Random controllers, references and disturbances in closed loop: the position stays within its bound, or a fault stops
//! the motor.

use crate::bench::Bench;
use fixed::types::{I16F48, I32F32};
use proptest::prelude::*;
use proptest::test_runner::{Config as RunnerConfig, RngAlgorithm, TestRng, TestRunner};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use twum_host::sim::{Disturbance, FirstOrderMotor, Setup, SimulatedMotor};
use twum_shared::Direction;
use twum_shared::encoder::CountSign;
use twum_shared::message::{Configuration, Mode, TrackRun};
use twum_shared::reference::{Reference, WayPoint};
use twum_shared::step::{Config, ConfigSpec, DriveLaw};

/// What happens to the rotor from outside.
#[derive(Clone, Copy, Debug, Default)]
struct Load {
    held: bool,
    /// Somebody turns it, rad/s.
    turned_rad_s: f64,
}

/// A motor whose load changes while it runs.
struct LoadedMotor {
    motor: FirstOrderMotor,
    load: Rc<Cell<Load>>,
    turned_rad: f64,
}

impl Case {
    /// Whether every edge is the motor's own, under the right sign. Otherwise a one-line encoder cannot know the position:
    /// a hand that turns the rotor is counted in the direction of the drive, extra edges count, missing ones do not.
    fn encoder_is_honest(&self) -> bool {
        let honest = |(_, harm): &(u64, Harm)| matches!(harm, Harm::Hold(_) | Harm::Late(_));
        self.configuration.count_sign == CountSign::Positive && self.harms.iter().all(honest)
    }
}

impl SimulatedMotor for LoadedMotor {
    fn advance(&mut self, dt_s: f64, drive_on: bool, direction: Direction) -> f64 {
        let load = self.load.get();
        self.motor.stuck = load.held;
        self.turned_rad += load.turned_rad_s * dt_s;
        self.motor.advance(dt_s, drive_on, direction) + self.turned_rad
    }

    fn nudge(&mut self, angle_rad: f64) {
        self.motor.nudge(angle_rad);
    }
}

#[derive(Clone, Copy, Debug)]
enum Harm {
    Hold(bool),
    Turn(f64),
    Late(u64),
    Chatter(u32),
    Dead(bool),
}

#[derive(Clone, Debug)]
struct Case {
    configuration: Configuration,
    reference: Reference,
    harms: Vec<(u64, Harm)>,
    full_speed_rad_s: f64,
}

/// Gains of every size and both signs, as far as they are accepted.
fn any_control() -> impl Strategy<Value = ConfigSpec> {
    let gain = (any::<i64>(), 22u32..60).prop_map(|(bits, shift)| bits >> shift);
    let small = (any::<i64>(), 6u32..60).prop_map(|(bits, shift)| bits >> shift);
    let limit = (0u32..24).prop_map(|shift| i32::MAX >> shift);
    let period_us = prop_oneof![Just(500u32), 100u32..=10_000];
    let duty_steps = prop_oneof![Just(32u16), Just(1_024), 2u16..=32_768];
    let reversal = prop_oneof![Just(0u16), 0u16..200];
    let rest = (any::<bool>(), 0u16..10, any::<bool>(), reversal);
    let spec = (gain.clone(), small, gain.clone(), gain, limit.clone(), limit, period_us, duty_steps, rest);
    let spec = spec.prop_map(|(kp, ki, kd, ff, min, max, period_us, duty_steps, rest)| {
        let (truncated, dead_band_counts, conditional, reversal) = rest;
        ConfigSpec {
            kp: I32F32::from_bits(kp),
            ki_tick: I16F48::from_bits(ki),
            kd_tick: I32F32::from_bits(kd),
            feed_forward: I32F32::from_bits(ff),
            integral_min: -min,
            integral_max: max,
            period_us,
            duty_steps,
            law: if truncated { DriveLaw::ActiveLowTruncated } else { DriveLaw::OnTimeRounded },
            dead_band_counts,
            conditional_integration: conditional,
            reversal_rest_ticks: reversal,
            reversal_limit_ticks: 2 * reversal,
            ..ConfigSpec::DEFAULT
        }
    });
    prop_oneof![3 => spec, 1 => any_gated()].prop_filter("accepted", |spec| Config::try_from(*spec).is_ok())
}

/// Drives gated by a model of the rotor that need not be this one's, at the periods that a PWM has.
fn any_gated() -> impl Strategy<Value = ConfigSpec> {
    let period_us = prop_oneof![Just(500u32), Just(1_000), Just(2_000)];
    let model = (1u16..2_000, 1u32..4_000_000, 0u8..=8, 1u8..=40, prop_oneof![Just(1u8), 1u8..=40]);
    (model, period_us, 1u16..200).prop_map(|((full, braking, delay, pulse, between), period_us, reversal)| ConfigSpec {
        period_us,
        full_speed_counts_s: full,
        braking_counts_s2: braking,
        delay_ticks: delay,
        shortest_pulse_ticks: pulse,
        pulse_period_ticks: between,
        reversal_rest_ticks: reversal,
        reversal_limit_ticks: 2 * reversal,
        ..ConfigSpec::GATED
    })
}

fn any_reference() -> impl Strategy<Value = Reference> {
    let position = -1_500i32..1_500;
    let way_point =
        (position.clone(), 1_000u32..2_000_000).prop_map(|(position, duration_us)| WayPoint { position, duration_us });
    prop_oneof![
        (position.clone(), 0u32..20_000_000)
            .prop_map(|(amplitude, omega_urad_s)| Reference::Sine { amplitude, omega_urad_s }),
        (position.clone(), 0u32..500_000).prop_map(|(position, at_us)| Reference::Step { position, at_us }),
        (-600i32..600, 0u32..1_500).prop_map(|(rate, limit)| Reference::Ramp { rate, limit }),
        prop::collection::vec(way_point, 1..8)
            .prop_map(|points| Reference::Path { start: 0, way_points: points.into_iter().collect() }),
    ]
}

fn any_harm() -> impl Strategy<Value = Harm> {
    prop_oneof![
        any::<bool>().prop_map(Harm::Hold),
        (-4.0f64..4.0).prop_map(Harm::Turn),
        (0u64..400).prop_map(Harm::Late),
        (0u32..8).prop_map(Harm::Chatter),
        any::<bool>().prop_map(Harm::Dead),
    ]
}

fn any_case() -> impl Strategy<Value = Case> {
    let harms = prop::collection::vec((0u64..RUN_MS, any_harm()), 0..4);
    let bounds =
        (-800i32..=-5, 5i32..=800, prop_oneof![1 => Just(120u32), 3 => Just(100_000)], prop::bool::weighted(0.15));
    (any_control(), any_reference(), harms, bounds, 1.0f64..6.0).prop_map(
        |(control, reference, harms, (min, max, following, reversed), full_speed_rad_s)| {
            let mut configuration = Configuration::with_control(control);
            (configuration.limits.position_min, configuration.limits.position_max) = (min, max);
            configuration.limits.following_error_counts = following;
            configuration.count_sign = if reversed { CountSign::Reversed } else { CountSign::Positive };
            Case { configuration, reference, harms, full_speed_rad_s }
        },
    )
}

/// Length of a run, ms.
const RUN_MS: u64 = 2_000;
/// A run waits for a PWM period to begin, µs: 50 Hz.
const PWM_PERIOD_US: u64 = 20_000;
/// Fastest the rotor may turn here: full speed with its ripple, and somebody's hand, counts/s.
const FASTEST_COUNTS_S: f64 = (6.0 * 1.12 + 4.0) / std::f64::consts::TAU * 400.0;

/// How a run ended, and by how many counts the true position left its bound.
fn outcome(case: &Case) -> Result<(String, f64), TestCaseError> {
    let load = Rc::new(Cell::new(Load::default()));
    let mut motor = FirstOrderMotor::default();
    motor.full_speed_rad_s = case.full_speed_rad_s;
    let motor = Box::new(LoadedMotor { motor, load: load.clone(), turned_rad: 0.0 });
    let mut bench = Bench::new(Setup { motor, ..Setup::default() });
    bench.session.align().expect("alignment");
    bench.session.configure(case.configuration).expect("an accepted controller is accepted");
    bench.session.arm().expect("arming");
    let run = TrackRun { reference: case.reference.clone(), duration_ms: RUN_MS as u32 };
    bench.session.start_track(run).expect("a valid reference is taken");

    let limits = case.configuration.limits;
    let period_us = u64::from(case.configuration.control.period_us);
    let start_us = bench.board().now_us();
    let start_rad = bench.board().angle_rad();
    let (mut chatter, mut late_us, mut truly_outside) = (0, 0, 0.0f64);
    let mut next_keepalive_us = 0;
    // A tick may come as late as four periods before it is a fault.
    let margin = |late_us: u64, chatter: u32| {
        let seconds = (2 * period_us + late_us) as f64 * 1e-6;
        (FASTEST_COUNTS_S * seconds).ceil() as i32 + 2 + 2 * chatter as i32
    };
    loop {
        let elapsed_us = bench.board().now_us() - start_us;
        if elapsed_us > RUN_MS * 1_000 + PWM_PERIOD_US + 4 * period_us {
            break;
        }
        for (_, harm) in
            case.harms.iter().filter(|(at_ms, _)| (elapsed_us..elapsed_us + period_us).contains(&(at_ms * 1_000)))
        {
            match *harm {
                Harm::Hold(held) => load.set(Load { held, ..load.get() }),
                Harm::Turn(turned_rad_s) => load.set(Load { turned_rad_s, ..load.get() }),
                Harm::Late(us) => {
                    late_us = us;
                    bench.board().disturb(Disturbance::LateTicks(us));
                }
                Harm::Chatter(edges) => {
                    chatter = edges;
                    bench.board().disturb(Disturbance::Chatter(edges));
                }
                Harm::Dead(dead) => bench.board().disturb(Disturbance::EncoderDead(dead)),
            }
        }
        if elapsed_us >= next_keepalive_us {
            next_keepalive_us = elapsed_us + 100_000;
            bench.session.keep_alive().expect("the link is up");
        }
        bench.board().run_for(period_us);
        let (mode, count, off) = (bench.board().mode(), bench.board().count(), bench.board().output_is_off());
        if mode == Mode::Running {
            let margin = margin(late_us, chatter);
            prop_assert!(
                (limits.position_min - margin..=limits.position_max + margin).contains(&count),
                "still running at {count} counts, allowed {}..={} and {margin} to see it",
                limits.position_min,
                limits.position_max
            );
            let truth = (bench.board().angle_rad() - start_rad) / std::f64::consts::TAU * 400.0;
            let outside = (truth - f64::from(limits.position_max)).max(f64::from(limits.position_min) - truth);
            truly_outside = truly_outside.max(outside);
        } else {
            prop_assert!(off, "the output is on in {mode:?}");
        }
    }
    let mode = bench.board().mode();
    prop_assert!(matches!(mode, Mode::Armed | Mode::Fault), "the run is over: {mode:?}");
    prop_assert!(bench.board().output_is_off());
    let identity = bench.session.hello().expect("the board answers");
    prop_assert_eq!(identity.fault.is_some(), mode == Mode::Fault);
    Ok((identity.fault.map_or("completed".to_owned(), |fault| format!("{fault:?}")), truly_outside))
}

/// `TWUM_LOOP_CASES=5000 cargo test --release -p twum-tests --test board -- --nocapture stays_within`
#[test]
fn the_position_stays_within_its_bound_or_a_fault_stops_the_motor() {
    let cases = std::env::var("TWUM_LOOP_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(100);
    let config = RunnerConfig { cases, failure_persistence: None, ..RunnerConfig::default() };
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]);
    let ends: RefCell<BTreeMap<String, u32>> = RefCell::default();
    let (honest, farthest, farthest_unseen) = (Cell::new(0), Cell::new(0.0f64), Cell::new(0.0f64));
    TestRunner::new_with_rng(config, rng)
        .run(&any_case(), |case| {
            let (end, outside) = outcome(&case)?;
            *ends.borrow_mut().entry(end).or_default() += 1;
            if case.encoder_is_honest() {
                honest.set(honest.get() + 1);
                farthest.set(farthest.get().max(outside));
            } else {
                farthest_unseen.set(farthest_unseen.get().max(outside));
            }
            Ok(())
        })
        .unwrap_or_else(|error| panic!("{error}"));
    let ends = ends.into_inner();
    println!("{cases} cases: {ends:?}");
    println!(
        "while driven, the true position was at most {:.1} counts outside its bound in the {} cases whose edges are all the \
         motor's own, {:.1} in the others",
        farthest.get(),
        honest.get(),
        farthest_unseen.get()
    );
    // Two periods to see it, the way to standstill, and what reversals miscount.
    assert!(farthest.get() < 10.0, "the motor itself left its bound by {} counts unseen", farthest.get());
    for end in ["completed", "PositionBound", "FollowingError", "EncoderStall"] {
        assert!(ends.contains_key(end), "no case ended with {end}: the test does not test");
    }
}
