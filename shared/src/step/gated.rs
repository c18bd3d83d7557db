//! The drive gated tick by tick: a model of the rotor says when each pulse has to begin and to end.
//!
//! Duty is an average, and over a slow PWM period the rotor runs ahead of its target and waits for it. Here the drive is
//! either on or off for a tick, and the question of every tick is where the rotor would come to rest, relative to the moving
//! target, if it were switched off now. The encoder answers with whole counts only; between two edges [`Rotor`](super::Rotor) goes
//! on with what it knows of the motor, and each edge, with its time, puts it right. Where pulses have a period, [`planned`]
//! says when they end.

use super::model::{COUNT, FARTHEST, FASTEST, FINE};
use super::planned::{self, Foretold};
use super::{Config, Inputs, Outputs, State};
use crate::Direction;

/// An overshoot by so many ticks of full drive is left to the target to catch up with: a shortest pulse the other way, and what
/// the rotor runs on after it, would turn by as much.
const REVERSES_TICKS: i32 = 4;

/// One tick of a controller that gates the drive.
#[inline(always)]
pub(super) fn gated(config: &Config, state: &mut State, inputs: &Inputs) -> Outputs {
    let spec = &config.spec;
    let rotor = &mut state.rotor;
    rotor.sees(config, inputs);
    let gives_way = if config.admittance.is_on() {
        config.admittance.moves(&config.model, &mut state.deviation, rotor.load.worth(rotor.braking))
    } else {
        state.deviation = 0;
        0
    };

    // What is under way when this tick's decision comes to bear, there and at the target.
    let (mut place, mut speed) = (rotor.place, rotor.speed);
    for ago in (0..spec.delay_ticks).rev() {
        (place, speed) = rotor.advanced(place, speed, ago);
    }
    let rate = ((i64::from(inputs.target_rate) * i64::from(config.rate_of_one)) >> (32 - FINE)) as i32;
    let rate = rate.saturating_add(gives_way).clamp(-2 * FASTEST, 2 * FASTEST);
    let counts = inputs.target.saturating_sub(inputs.position).clamp(-FARTHEST, FARTHEST);
    let wanted = counts * COUNT + i32::from(inputs.target_fraction) * (COUNT / 128) + state.deviation;
    let target = wanted + rate * i32::from(spec.delay_ticks);
    let short = target.saturating_sub(place).saturating_sub(rotor.runs_on(speed, rate));

    let along = if state.direction == Direction::Cw { short } else { short.saturating_neg() };
    let was_on = rotor.on & 1 == 1;
    let mut on = if rotor.held < spec.shortest_pulse_ticks {
        was_on
    } else if spec.has_pulse_period() {
        planned::wants(config, rotor, &Foretold::along(state.direction, rotor, place - target, speed, rate))
    } else if was_on {
        along >= -config.model.full / 2
    } else {
        along > config.model.full / 2
    };
    if !on {
        let may = state.reversal.waits(spec, inputs.position)
            && !was_on
            && rotor.held >= spec.shortest_pulse_ticks
            && (!spec.has_pulse_period() || rotor.since >= spec.pulse_period_ticks);
        if along < -REVERSES_TICKS * config.model.full && may {
            state.direction = state.direction.opposite();
            on = true;
        }
    }
    if on {
        state.reversal.drives(spec, inputs.position);
    }
    if spec.has_pulse_period() {
        // A pulse that goes on over the end of its period begins another.
        let begins = on && (!was_on || rotor.since >= spec.pulse_period_ticks);
        rotor.since = if begins { 1 } else { rotor.since.saturating_add(1) };
    }
    rotor.held = if on == was_on { rotor.held.saturating_add(1) } else { 1 };
    rotor.on = (rotor.on << 1) | u16::from(on);
    rotor.cw = (rotor.cw << 1) | u16::from(state.direction == Direction::Cw);
    let on_steps = if on { spec.duty_steps } else { 0 };
    let signed = (i64::from(on_steps) * i64::from(state.direction.sign())) << 16;
    Outputs { u: signed.min(i64::from(i32::MAX)) as i32, on_steps, direction: state.direction }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::super::motor::Motor;
    use super::super::{Config, ConfigSpec, GuideSpec, Load, Rotor, step};
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Follows a sine; gives the mean error in degrees, and the state at the end.
    fn follows(spec: ConfigSpec, mut motor: Motor, delay: usize, seconds: u32) -> (f64, State) {
        let config = Config::try_from(spec).unwrap();
        let reference = crate::reference::Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
        let mut state = State::REST;
        let mut late = std::collections::VecDeque::from(std::vec![(0, Direction::Ccw); delay]);
        let mut off = 0.0;
        for tick in 0..seconds * 2_000 {
            let inputs = motor.sees(&reference, tick);
            off += (89.0 * (1.257 * f64::from(tick) * 500e-6).sin() - motor.place).abs() * 0.9;
            let out = step(&config, &mut state, inputs);
            late.push_back((i32::from(out.on_steps > 0) * out.direction.sign(), out.direction));
            let (drive, direction) = late.pop_front().unwrap();
            motor.turn(drive, direction, f64::from(tick + 1));
        }
        (off / f64::from(seconds * 2_000), state)
    }

    /// Fails when the model, its correction by edges or the plan of the pulses is off: the default controller is off by 1.1° on
    /// the motor that brakes so, and a count is 0.9°.
    #[test]
    fn a_rotor_that_is_known_follows_within_a_third_of_a_count() {
        let (error, state) = follows(ConfigSpec::GATED, Motor::new(234.0, 16_400.0), 1, 10);
        assert!(error < 0.25, "{error}");
        assert!((state.rotor.place..state.rotor.place + 1).contains(&state.rotor.place));
    }

    /// Fails when the plan of a period is off: where its last place is to be, what the rotor runs on, or when a period is over.
    #[test]
    fn one_pulse_a_period_follows_within_a_third_of_a_count() {
        let (error, _) = follows(ConfigSpec::PLANNED, Motor::new(234.0, 16_400.0), 1, 10);
        assert!(error < 0.25, "{error}");
        let (clamped, _) = follows(ConfigSpec::PLANNED, Motor::new(234.0, 1e6), 1, 10);
        assert!(clamped < 0.30, "{clamped}");
    }

    /// Fails when nothing is learnt of the motor, or what is learnt has the wrong sign.
    #[test]
    fn a_rotor_that_is_not_the_one_told_is_learnt() {
        let learnt =
            [(190.0, 16_400.0), (300.0, 16_400.0), (234.0, 100_000.0), (260.0, 12_000.0)].map(|(full, braking)| {
                let (error, state) = follows(ConfigSpec::GATED, Motor::new(full, braking), 2, 20);
                assert!(error < 0.45, "{full} counts/s, {braking} counts/s²: {error}°");
                state.rotor
            });
        let [slow, fast, braked, coasting] = learnt;
        assert!(slow.full_cw < fast.full_cw && slow.full_ccw < fast.full_ccw, "{slow:?}, {fast:?}");
        assert!(braked.braking > 2 * coasting.braking, "{braked:?}, {coasting:?}");
    }

    /// Fails when a target that rests leaves the drive hunting.
    #[test]
    fn at_a_target_that_rests_the_drive_is_off() {
        let config = Config::try_from(ConfigSpec::GATED).unwrap();
        let (mut state, mut motor) = (State::REST, Motor::new(234.0, 16_400.0));
        let mut on: Vec<bool> = Vec::new();
        for tick in 0..4_000u32 {
            let age = (f64::from(tick) - motor.edge_at) * 500.0;
            let inputs = Inputs { target: 40, position: motor.count, edge_age_us: age as u16, ..Inputs::default() };
            let out = step(&config, &mut state, inputs);
            on.push(out.on_steps > 0);
            motor.turn(i32::from(out.on_steps > 0) * out.direction.sign(), out.direction, f64::from(tick + 1));
        }
        assert!((motor.place - 40.0).abs() < 0.6, "{}", motor.place);
        assert!(!on[1_000..].contains(&true), "hunts at rest");
    }

    #[test]
    fn models_that_fixed_point_cannot_hold_are_refused() {
        let with = |change: fn(&mut ConfigSpec)| {
            let mut spec = ConfigSpec::GATED;
            change(&mut spec);
            Config::try_from(spec).map(|_| ())
        };
        let changes: [fn(&mut ConfigSpec); 10] = [
            |s| s.full_speed_counts_s = 0,
            |s| s.full_speed_counts_s = 16_001,
            |s| s.braking_counts_s2 = 0,
            |s| s.braking_counts_s2 = u32::MAX,
            |s| s.delay_ticks = 9,
            |s| s.shortest_pulse_ticks = 0,
            |s| s.shortest_pulse_ticks = 41,
            |s| s.pulse_period_ticks = 0,
            |s| s.pulse_period_ticks = 41,
            |s| s.reversal_rest_ticks = 0,
        ];
        for change in changes {
            assert_eq!(with(change), Err(super::super::ConfigError::Rotor));
        }
        assert_eq!(with(|s| s.full_speed_counts_s = 16_000), Ok(()));
    }

    proptest! {
        /// Fails if any operation can overflow (debug assertions are on), whatever a recording says the state was; if a pulse is
        /// shorter than the driver board follows, or begins before its period; or if the direction changes with the drive on.
        #[test]
        fn no_state_and_no_input_overflows(
            full in 1u16..=16_000, braking in 1u32..2_000_000, delay in 0u8..=8, pulse in 1u8..=40, period in 1u8..=40,
            any in any::<[i32; 8]>(), bits in any::<[u16; 2]>(), held in any::<[u8; 2]>(),
            felt in any::<([i32; 2], [u16; 4])>(), guide in any::<(u16, [u32; 4])>(),
            ticks in proptest::collection::vec((any::<i32>(), any::<i32>(), -3i32..=3, any::<i8>(), any::<u16>(), 0u8..20), 1..200),
        ) {
            let spec = ConfigSpec {
                full_speed_counts_s: full, braking_counts_s2: braking, delay_ticks: delay, shortest_pulse_ticks: pulse,
                pulse_period_ticks: period, ..ConfigSpec::GATED
            };
            // Most targets that give way are refused; the others go through the same ticks as those that do not.
            let (limit_counts, [stiffness_nnm, damping_nnm_s, dead_band_nnm, braking_nnm]) = guide;
            let guide = GuideSpec {
                limit_counts: limit_counts % 300, stiffness_nnm: stiffness_nnm >> 8, damping_nnm_s: damping_nnm_s >> 8,
                dead_band_nnm: dead_band_nnm >> 8, braking_nnm: braking_nnm >> 4
            };
            let guided = Config::try_from(ConfigSpec { guide, ..spec });
            let Ok(config) = guided.or_else(|_| Config::try_from(spec)) else { return Ok(()) };
            let ([pushes, deviation], [doubt, speed_ticks, place_ticks, edges]) = felt;
            let [count, place, speed, full_cw, full_ccw, braking, driven, coasted] = any;
            let ([on, cw], [held, since]) = (bits, held);
            let load = Load { pushes, doubt, speed_ticks, place_ticks, edges };
            let rotor = Rotor { count, place, speed, full_cw, full_ccw, braking, on, cw, held, since, driven, coasted, load };
            let mut state = State { rotor, deviation, ..State::REST };
            let (mut position, mut last, mut run) = (count, state.rotor.on & 1 == 1, u32::from(held));
            let mut pin = state.direction;
            let mut began = u32::from(since);
            for (target, target_rate, move_by, target_fraction, edge_age_us, jump) in ticks {
                position = if jump == 0 { target } else { position.wrapping_add(move_by) };
                let out = step(&config, &mut state, Inputs { target, target_rate, position, target_fraction, edge_age_us });
                prop_assert!(out.on_steps == 0 || out.on_steps == spec.duty_steps);
                prop_assert!((0..=COUNT).contains(&state.rotor.place));
                prop_assert!(config.model.about(state.rotor.full_cw) == state.rotor.full_cw);
                let limit = i64::from(config.spec().guide.limit_counts) * i64::from(COUNT);
                prop_assert!(i64::from(state.deviation).abs() <= limit, "{} off its path", state.deviation);
                prop_assert!(state.rotor.load.pushes.abs() < state.rotor.braking, "no more than the rotor bears");
                prop_assert!(config.model.braked(state.rotor.braking) == state.rotor.braking);
                let on = out.on_steps > 0;
                prop_assert!(out.direction == pin || (on && !last), "the pin changes with the pulse, from rest");
                if on && !last {
                    prop_assert!(period == 1 || began >= u32::from(period), "{began} ticks");
                    began = 0;
                }
                began += 1;
                if on != last {
                    prop_assert!(run >= u32::from(pulse), "{run} ticks");
                    run = 0;
                }
                run += 1;
                (last, pin) = (on, out.direction);
            }
        }
    }
}
