extern crate std;
use super::*;
use proptest::prelude::*;

fn thesis() -> Config {
    Config::try_from(ConfigSpec::THESIS).unwrap()
}

/// The arithmetic of the thesis's `compute()` (C.2) in doubles, written from its formulas: the independent reference.
#[derive(Default)]
struct Doubles {
    previous: f64,
    integral: f64,
}

impl Doubles {
    fn compute(&mut self, target: i32, position: i32) -> (i64, Direction) {
        let dt = 500.0 / 1_000_000.0;
        let e = f64::from(target) - f64::from(position);
        let rate = (e - self.previous) / dt;
        self.integral = (self.integral + e * dt).clamp(0.0, 31.0);
        let u = 1.3 * e + 0.0015 * self.integral + 0.00004 * rate;
        self.previous = e;
        ((31.0 - u.abs()).max(0.0) as i64, if u > 0.0 { Direction::Cw } else { Direction::Ccw })
    }
}

/// A small generator of its own (PCG), so that the runs are the same on every machine.
struct Pcg(u64);

impl Pcg {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let shifted = (((self.0 >> 18) ^ self.0) >> 27) as u32;
        shifted.rotate_right((self.0 >> 59) as u32)
    }

    fn within(&mut self, low: i32, high: i32) -> i32 {
        low + (self.next() % (high - low + 1) as u32) as i32
    }
}

/// Runs and their ticks; an interpreter (Miri) has a share of them.
const SEEDS: u64 = if cfg!(miri) { 1 } else { 8 };
const TICKS: u32 = if cfg!(miri) { 2_000 } else { 100_000 };

/// Differing ticks of a run, and the largest difference in PWM steps.
fn differences(errors: impl Iterator<Item = i32>) -> (u32, u32, i64) {
    let (config, mut state, mut doubles) = (thesis(), State::REST, Doubles::default());
    let (mut ticks, mut different, mut largest) = (0, 0, 0);
    for error in errors {
        let ours =
            step(&config, &mut state, Inputs { target: error, target_rate: 0, position: 0, ..Inputs::default() });
        let (theirs, _) = doubles.compute(error, 0);
        let distance = (i64::from(32 - ours.on_steps) - theirs).abs();
        ticks += 1;
        different += u32::from(distance != 0);
        largest = largest.max(distance);
    }
    (ticks, different, largest)
}

#[test]
fn thesis_gives_the_doubles_pwm_in_random_runs() {
    for seed in 0..SEEDS {
        let mut pcg = Pcg(seed);
        let mut error = 0;
        // A walk with rare jumps: what a tracking error looks like, with every saturation and sign in it.
        let (ticks, different, largest) = differences((0..TICKS).map(|_| {
            error = if pcg.next().is_multiple_of(500) {
                pcg.within(-90, 90)
            } else {
                (error + pcg.within(-1, 1)).clamp(-60, 60)
            };
            error
        }));
        std::println!("walk seed {seed}: {different} of {ticks} ticks differ, by at most {largest} step");
        assert!(different * 1000 <= ticks && largest <= 1, "seed {seed}: {different} of {ticks}, by {largest}");
    }
}

#[test]
fn thesis_gives_the_doubles_pwm_where_truncation_ties() {
    for seed in 0..SEEDS {
        let mut pcg = Pcg(seed);
        // Multiples of ten, mostly negative so that the integral stays clamped at zero, held for a few ticks.
        let mut error = 0;
        let (ticks, different, largest) = differences((0..TICKS).map(|tick| {
            if tick % 4 == 0 {
                error = 10 * pcg.within(-3, 1);
            }
            error
        }));
        std::println!("tie seed {seed}: {different} of {ticks} ticks differ, by at most {largest} step");
        assert!(different * 1000 <= ticks && largest <= 1, "seed {seed}: {different} of {ticks}, by {largest}");
    }
}

#[test]
fn thesis_leaves_a_thirty_second_on_at_rest() {
    let out = step(&thesis(), &mut State::REST.clone(), Inputs::default());
    assert_eq!((out.on_steps, out.direction), (1, Direction::Ccw));
}

#[test]
fn default_is_truly_off_at_rest_and_keeps_its_direction() {
    let config = Config::try_from(ConfigSpec::DEFAULT).unwrap();
    let mut state = State { direction: Direction::Cw, ..State::REST };
    let out = step(&config, &mut state, Inputs::default());
    assert_eq!((out.on_steps, out.direction, out.u), (0, Direction::Cw, 0));
}

#[test]
fn a_dead_band_leaves_small_errors_alone_while_the_target_rests() {
    let spec = ConfigSpec { dead_band_counts: 2, ..ConfigSpec::DEFAULT };
    let config = Config::try_from(spec).unwrap();
    let on = |target, target_rate| {
        let mut state = State { direction: Direction::Cw, ..State::REST };
        let out = step(&config, &mut state, Inputs { target, target_rate, position: 0, ..Inputs::default() });
        assert_eq!(state.integral == 0, out.u == 0, "what is left alone does not wind up either");
        out.on_steps
    };
    assert_eq!((on(2, 0), on(-2, 0), on(0, 0)), (0, 0, 0));
    // 3 counts at 70 and 0.1 steps; 1 count beside a rate of 5 at 4 steps.
    assert_eq!((on(3, 0), on(-3, 0), on(1, 5)), (210, 210, 90));
}

#[test]
fn the_targets_rate_is_fed_forward_up_to_its_limit() {
    let spec = ConfigSpec { duty_steps: 32_768, feed_forward: I32F32::lit("0.0625"), ..ConfigSpec::DEFAULT };
    let config = Config::try_from(spec).unwrap();
    let on = |target_rate| {
        let out = step(
            &config,
            &mut State::REST.clone(),
            Inputs { target: 0, target_rate, position: 0, ..Inputs::default() },
        );
        (out.on_steps, out.direction)
    };
    assert_eq!((on(1_600), on(-1_600)), ((100, Direction::Cw), (100, Direction::Ccw)));
    // 2^18 counts/s at 1/16 step.
    assert_eq!((on(1 << 18), on(i32::MAX), on(i32::MIN).0), ((16_384, Direction::Cw), (16_384, Direction::Cw), 16_384));
}

#[test]
fn a_gain_is_called_in_a_message_as_in_a_file() {
    use std::string::ToString;
    let names = [GainName::Kp, GainName::Ki, GainName::Kd, GainName::FeedForward].map(|name| name.to_string());
    assert_eq!(names, ["kp", "ki", "kd", "feed_forward"]);
}

#[test]
fn default_does_not_wind_up_while_saturated() {
    let config = Config::try_from(ConfigSpec::DEFAULT).unwrap();
    let mut state = State::REST;
    for _ in 0..if cfg!(miri) { 100 } else { 10_000 } {
        step(&config, &mut state, Inputs { target: 1000, target_rate: 0, position: 0, ..Inputs::default() });
    }
    assert_eq!(state.integral, 0);
}

/// Fails when a drive of exactly full counts as saturated (`>=` or `<=` for `>` or `<` in the anti-windup), and when
/// the drive of a tick that does not integrate holds that tick's error all the same.
#[test]
fn the_integral_waits_only_while_the_drive_is_beyond_full() {
    let after = |ki_tick, target| {
        let spec = ConfigSpec { kp: I32F32::lit("16"), ki_tick, ..ConfigSpec::DEFAULT };
        let (config, mut state) = (Config::try_from(spec).unwrap(), State::REST);
        let out = step(&config, &mut state, Inputs { target, target_rate: 0, position: 0, ..Inputs::default() });
        (state.integral, out.u, out.on_steps)
    };
    // 64 counts at 16 steps are the 1024 of full drive; 65 are 1040.
    assert_eq!(after(I16F48::ZERO, 64), (64, 1_024 << 16, 1_024));
    assert_eq!(after(I16F48::ZERO, -64), (-64, -1_024 << 16, 1_024));
    assert_eq!(after(I16F48::ZERO, 65), (0, 1_040 << 16, 1_024));
    assert_eq!(after(I16F48::ZERO, -65), (0, -1_040 << 16, 1_024));
    // 61 counts are 976 steps, and with themselves in the integral 1037; 60 are 960 and 1020.
    assert_eq!((after(I16F48::ONE, 61), after(I16F48::ONE, -61)), ((0, 976 << 16, 976), (0, -976 << 16, 976)));
    assert_eq!(
        (after(I16F48::ONE, 60), after(I16F48::ONE, -60)),
        ((60, 1_020 << 16, 1_020), (-60, -1_020 << 16, 1_020))
    );
}

/// Fails when the integral also waits for a saturation against the error, or for one without any error (`>=` for `>`,
/// `<=` for `<`, `||` for `&&`): a state from elsewhere, outside the limits, would then stay outside.
#[test]
fn the_integral_does_not_wait_for_a_saturation_that_is_not_the_errors() {
    let config = Config::try_from(ConfigSpec::DEFAULT).unwrap();
    let after = |integral, target, target_rate| {
        let mut state = State { integral, ..State::REST };
        let out = step(&config, &mut state, Inputs { target, target_rate, position: 0, ..Inputs::default() });
        (state.integral, out.on_steps)
    };
    // 1000 counts/s feed 4000 steps forward, nearly four times full drive; the 5 counts take back 350.
    assert_eq!((after(0, -5, 1_000), after(0, 5, -1_000)), ((-5, 1_024), (5, 1_024)));
    // The limits are 4000 count·ticks.
    assert_eq!((after(9_000, 0, 1_000), after(-9_000, 0, -1_000)), ((4_000, 1_024), (-4_000, 1_024)));
}

/// Fails when the rounding law cuts its fractions off (without its half step) or the truncating law does not cut the
/// high time, which leaves a step on (without its two steps less the last bit).
#[test]
fn one_law_rounds_the_on_time_and_the_other_cuts_the_high_time() {
    let on = |law, target| {
        let (kp, ki_tick, kd_tick) = (I32F32::lit("0.25"), I16F48::ZERO, I32F32::ZERO);
        let config = Config::try_from(ConfigSpec { kp, ki_tick, kd_tick, law, ..ConfigSpec::THESIS }).unwrap();
        step(&config, &mut State::REST.clone(), Inputs { target, target_rate: 0, position: 0, ..Inputs::default() })
            .on_steps
    };
    // Quarters of a step: 0, 0.25, 0.5, 0.75, 1, 1.25, 1.5.
    assert_eq!([0, 1, 2, 3, 4, 5, 6].map(|target| on(DriveLaw::OnTimeRounded, target)), [0, 0, 1, 1, 1, 1, 2]);
    // High times of 31, 30.75, 30.5, 30.25, 30, 29.75 and 29.5 steps, cut to 31, 30, 30, 30, 30, 29 and 29 of 32.
    assert_eq!([0, 1, 2, 3, 4, 5, 6].map(|target| on(DriveLaw::ActiveLowTruncated, target)), [1, 2, 2, 2, 2, 3, 3]);
    for target in 0..200 {
        for law in [DriveLaw::OnTimeRounded, DriveLaw::ActiveLowTruncated] {
            assert_eq!(on(law, -target), on(law, target), "both directions alike");
        }
    }
}

/// Fails when halves are not rounded away from zero in both directions (`+` for `-`, another comparison with zero).
#[test]
fn halves_are_rounded_away_from_zero() {
    // 2^-24 is 256 of 2^-32.
    let cases = [(0, 0), (127, 0), (128, 1), (383, 1), (384, 2), (-127, 0), (-128, -1), (-383, -1), (-384, -2)];
    for (q32, q24) in cases {
        assert_eq!(rounded_q24(q32), q24, "{q32}");
    }
}

/// Fails when the control signal saturates elsewhere than at what 16 bits of whole steps hold, or to the wrong side.
#[test]
fn the_control_signal_saturates_at_32768_steps() {
    let steps = |steps: i64| steps << 24;
    assert_eq!((q16(steps(1)), q16(steps(-1)), q16(255), q16(256), q16(-256)), (1 << 16, -1 << 16, 0, 1, -1));
    assert_eq!((q16(steps(32_767)), q16(steps(32_768))), (32_767 << 16, i32::MAX));
    assert_eq!((q16(steps(-32_768)), q16(steps(-32_769))), (i32::MIN, i32::MIN));
    assert_eq!((q16(steps(32_768) - 1), q16(steps(1 << 30)), q16(steps(-1 << 30))), (i32::MAX, i32::MAX, i32::MIN));
}

/// Fails when a limit of the gains, or of the integral's product with its gain, is not where its message says.
#[test]
fn the_first_value_out_of_bounds_is_refused_and_the_last_inside_is_not() {
    let with = |change: fn(&mut ConfigSpec)| {
        let mut spec = ConfigSpec { ki_tick: I16F48::ZERO, ..ConfigSpec::THESIS };
        change(&mut spec);
        Config::try_from(spec).map(|_| ())
    };
    assert_eq!(with(|s| s.kp = I32F32::lit("-1024")), Err(ConfigError::Gain(GainName::Kp)));
    assert_eq!(with(|s| s.kp = I32F32::lit("-1023.99")), Ok(()));
    assert_eq!(with(|s| s.kp = I32F32::lit("1023.99")), Ok(()));
    let limits = |s: &mut ConfigSpec| (s.integral_min, s.integral_max) = (0, 0);
    assert_eq!(with(limits), Ok(()));
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (0, I16F48::lit("1023"))), Ok(()));
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (0, I16F48::lit("-1023"))), Ok(()));
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (0, I16F48::lit("1024"))), Err(ConfigError::Gain(GainName::Ki)));
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (0, I16F48::lit("-1024"))), Err(ConfigError::Gain(GainName::Ki)));
    // One step a count·tick: 2^14 of them are 16384 duty steps.
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (16_383, I16F48::ONE)), Ok(()));
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (16_384, I16F48::ONE)), Err(ConfigError::IntegralLimits));
    assert_eq!(with(|s| (s.integral_max, s.ki_tick) = (16_384, -I16F48::ONE)), Err(ConfigError::IntegralLimits));
    assert_eq!(with(|s| (s.integral_min, s.integral_max, s.ki_tick) = (-16_383, 0, I16F48::ONE)), Ok(()));
    let low = |s: &mut ConfigSpec| (s.integral_min, s.integral_max, s.ki_tick) = (-16_384, 0, I16F48::ONE);
    assert_eq!(with(low), Err(ConfigError::IntegralLimits));
}

/// Ticks that a reversal of the drive waits, with an edge after each `every`th of them.
fn waits(rest: u16, limit: u16, every: usize) -> usize {
    let spec = ConfigSpec { reversal_rest_ticks: rest, reversal_limit_ticks: limit, ..ConfigSpec::DEFAULT };
    let (config, mut state) = (Config::try_from(spec).unwrap(), State { direction: Direction::Cw, ..State::REST });
    let mut position = 0;
    step(&config, &mut state, Inputs { target: 5, target_rate: 0, position, ..Inputs::default() });
    (1..1_000)
        .find(|tick| {
            position += i32::from(tick % every == 0);
            step(&config, &mut state, Inputs { target: -50, target_rate: 0, position, ..Inputs::default() }).on_steps
                > 0
        })
        .unwrap()
        - 1
}

/// Fails when the wait counts other than ticks with the drive off, is not begun anew by an edge, or has no end.
#[test]
fn a_reversal_waits_for_rest_and_no_longer_than_its_limit() {
    assert_eq!((waits(0, 0, 3), waits(10, 100, 1_000), waits(10, 10, 1_000)), (0, 10, 10));
    // Edges 4 ticks apart never let it rest; 11 apart they do.
    assert_eq!((waits(10, 100, 4), waits(10, 37, 4)), (100, 37));
    assert!(waits(10, 100, 11) < 22);
}

#[test]
fn a_rotor_that_was_never_driven_is_driven_at_once_either_way() {
    let spec = ConfigSpec { reversal_rest_ticks: 50, reversal_limit_ticks: 100, ..ConfigSpec::DEFAULT };
    let config = Config::try_from(spec).unwrap();
    for target in [-9, 9] {
        let out = step(
            &config,
            &mut State::REST.clone(),
            Inputs { target, target_rate: 0, position: 0, ..Inputs::default() },
        );
        assert!(out.on_steps > 0 && out.direction.sign() == target.signum());
    }
}

#[test]
fn specs_that_could_overflow_are_refused() {
    let with = |change: fn(&mut ConfigSpec)| {
        let mut spec = ConfigSpec::THESIS;
        change(&mut spec);
        Config::try_from(spec).map(|_| ())
    };
    assert_eq!(with(|s| s.kp = I32F32::lit("1024")), Err(ConfigError::Gain(GainName::Kp)));
    assert_eq!(with(|s| s.kd_tick = I32F32::MIN), Err(ConfigError::Gain(GainName::Kd)));
    assert_eq!(with(|s| s.feed_forward = I32F32::MAX), Err(ConfigError::Gain(GainName::FeedForward)));
    assert_eq!(with(|s| s.ki_tick = I16F48::MIN), Err(ConfigError::Gain(GainName::Ki)));
    assert_eq!(with(|s| s.integral_min = 1), Err(ConfigError::IntegralLimits));
    assert_eq!(with(|s| s.integral_max = -1), Err(ConfigError::IntegralLimits));
    assert_eq!(with(|s| s.ki_tick = I16F48::lit("1000")), Err(ConfigError::IntegralLimits));
    let low = |s: &mut ConfigSpec| (s.ki_tick, s.integral_min, s.integral_max) = (I16F48::lit("1023"), -1_000_000, 0);
    assert_eq!(with(low), Err(ConfigError::IntegralLimits));
    assert_eq!(with(|s| s.period_us = 99), Err(ConfigError::Period(99)));
    assert_eq!(with(|s| s.period_us = 10_001), Err(ConfigError::Period(10_001)));
    assert_eq!(with(|s| s.duty_steps = 1), Err(ConfigError::DutySteps(1)));
    assert_eq!(with(|s| s.duty_steps = 32_769), Err(ConfigError::DutySteps(32_769)));
    assert_eq!(with(|s| (s.reversal_rest_ticks, s.reversal_limit_ticks) = (2, 1)), Err(ConfigError::Reversal));
    assert_eq!(with(|s| (s.reversal_rest_ticks, s.reversal_limit_ticks) = (2, 2)), Ok(()));
    assert_eq!(with(|s| (s.period_us, s.duty_steps) = (100, 2)), Ok(()));
    assert_eq!(with(|s| (s.period_us, s.duty_steps) = (10_000, 32_768)), Ok(()));
}

prop_compose! {
    fn any_spec()(
        kp in any::<i64>(), ki in any::<i64>(), kd in any::<i64>(), ff in any::<i64>(),
        shift in 0u32..40, integral_min in i32::MIN..=0, integral_max in 0..=i32::MAX,
        duty_steps in 2u16..=32_768, truncated in any::<bool>(), dead_band_counts in any::<u16>(),
        conditional_integration in any::<bool>(), reversal_rest_ticks in 0u16..100, wait in 0u16..100,
    ) -> ConfigSpec {
        ConfigSpec {
            kp: I32F32::from_bits(kp >> shift.max(22)), ki_tick: I16F48::from_bits(ki >> shift.max(6)),
            kd_tick: I32F32::from_bits(kd >> shift.max(22)), feed_forward: I32F32::from_bits(ff >> shift.max(22)),
            integral_min, integral_max, period_us: 500, duty_steps,
            law: if truncated { DriveLaw::ActiveLowTruncated } else { DriveLaw::OnTimeRounded },
            dead_band_counts, conditional_integration,
            reversal_rest_ticks, reversal_limit_ticks: reversal_rest_ticks + wait,
            ..ConfigSpec::DEFAULT
        }
    }
}

proptest! {
    /// Fails if any operation of the step can overflow (debug assertions are on) or leave its range.
    #[test]
    fn no_input_overflows(
        spec in any_spec(),
        state in (any::<i32>(), any::<i32>(), any::<bool>(), any::<u16>(), any::<u16>()),
        inputs in proptest::collection::vec((any::<i32>(), any::<i32>(), any::<i32>()), 1..20),
    ) {
        if let Ok(config) = Config::try_from(spec) {
            let mut state =
                State { integral: state.0, previous_error: state.1, direction: Direction::from_pin(state.2),
                    reversal: Reversal { rest_left: state.3, limit_left: state.4, position: 0 }, ..State::REST };
            for (target, target_rate, position) in inputs {
                let out = step(&config, &mut state, Inputs { target, target_rate, position, ..Inputs::default() });
                prop_assert!(out.on_steps <= spec.duty_steps);
                prop_assert!((spec.integral_min..=spec.integral_max).contains(&state.integral) || out.on_steps == 0
                    || spec.conditional_integration);
            }
        }
    }

    /// Fails when the pin changes while the drive is on, with an edge less than the rest ago, or before either wait is over; and
    /// when a wait has no end.
    #[test]
    fn the_direction_changes_only_at_rest_or_after_the_limit(
        rest in 1u16..60, wait in 0u16..60,
        ticks in proptest::collection::vec((-300i32..300, 0u8..8), 1..400),
    ) {
        let spec = ConfigSpec { reversal_rest_ticks: rest, reversal_limit_ticks: rest + wait, ..ConfigSpec::DEFAULT };
        let config = Config::try_from(spec).unwrap();
        // A state from elsewhere: driven, the rotor still turning.
        let driven = Reversal { rest_left: rest, limit_left: rest + wait, position: 0 };
        let mut state = State { reversal: driven, ..State::REST };
        let (mut pin, mut position) = (state.direction, 0i32);
        let (mut off, mut still, mut refused) = (0u16, 0u16, 0u16);
        for (target, moves) in ticks {
            // An edge in an eighth of the ticks, either way.
            if moves == 0 {
                position += if target < 0 { -1 } else { 1 };
                still = 0;
            }
            let out = step(&config, &mut state, Inputs { target: target / 10, target_rate: 0, position, ..Inputs::default() });
            if out.direction != pin {
                prop_assert!(off >= rest, "off for {off} ticks of {rest}");
                prop_assert!(still >= rest || off >= rest + wait, "{still} still, {off} off");
            }
            (pin, off, still) = if out.on_steps > 0 { (out.direction, 0, 0) } else { (pin, off + 1, still + 1) };
            refused = if out.on_steps == 0 && out.u.unsigned_abs() > 1 << 16 { refused + 1 } else { 0 };
            prop_assert!(refused <= rest + wait, "a wait without end");
        }
    }

    /// The guard changes nothing but when a reversal comes: until the first, both controllers are one.
    #[test]
    fn the_guard_changes_nothing_until_a_reversal(targets in proptest::collection::vec(1i32..400, 1..200)) {
        let config = |rest| {
            let spec = ConfigSpec { reversal_rest_ticks: rest, reversal_limit_ticks: 2 * rest, ..ConfigSpec::DEFAULT };
            Config::try_from(spec).unwrap()
        };
        let (mut a, mut b) = (State { direction: Direction::Cw, ..State::REST }, State { direction: Direction::Cw, ..State::REST });
        for target in targets {
            let inputs = Inputs { target, ..Inputs::default() };
            prop_assert_eq!(step(&config(0), &mut a, inputs), step(&config(40), &mut b, inputs));
        }
    }

    /// The thesis's step against doubles over the full range: the same PWM value, never more than one step away.
    #[test]
    fn thesis_never_differs_by_more_than_a_step(errors in proptest::collection::vec(any::<i32>(), 1..50)) {
        let (_, _, largest) = differences(errors.into_iter());
        prop_assert!(largest <= 1);
    }

    /// The default law is odd: mirrored inputs give the mirrored drive.
    #[test]
    fn default_is_symmetric(targets in proptest::collection::vec((-200..200i32, -300..300i32), 1..200)) {
        let config = Config::try_from(ConfigSpec::DEFAULT).unwrap();
        let (mut a, mut b) = (State::REST, State { direction: Direction::Cw, ..State::REST });
        for (target, target_rate) in targets {
            let x = step(&config, &mut a, Inputs { target, target_rate, position: 0, ..Inputs::default() });
            let y = step(&config, &mut b, Inputs { target: -target, target_rate: -target_rate, position: 0, ..Inputs::default() });
            prop_assert_eq!(x.on_steps, y.on_steps);
            prop_assert!(x.on_steps == 0 || x.direction != y.direction);
            prop_assert_eq!(a.integral, -b.integral);
        }
    }
}

/// Fails when either sign is cut off elsewhere than where it rounds to: a controller at full drive would wind up in one direction.
#[test]
fn full_drive_ends_where_the_sum_rounds_beyond_it() {
    for duty_steps in [1, 100, 256, u16::MAX] {
        let (beyond, full) = (beyond_full_drive(duty_steps), i64::from(duty_steps) << 24);
        for sum in beyond - 300..beyond + 300 {
            assert_eq!(sum >= beyond, rounded_q24(sum) > full, "{duty_steps}: {sum}");
            assert_eq!(-sum <= -beyond, rounded_q24(-sum) < -full, "{duty_steps}: {}", -sum);
        }
    }
}
