//! The rotor equation the diagnosis searches with: drive phases, a saturating drive torque, Coulomb braking.
//!
//! It is the averaged motor model reduced once more. The wave follows the drive with a time constant; from some height on it pulls the rotor
//! towards its crest's speed with a torque that is constant (friction is saturated) until the speed comes within a slip band of
//! it, and proportional inside the band; below that height Coulomb friction brakes, and from it on that goes over into the wave's with its height.
//! All have closed forms but the crest's, which moves in straight pieces of half a time constant or more: a run is stepped from event to event.
//!
//! Everything an effect of the library can change is a parameter here, with the value 0 for "absent".

mod clock;
mod motion;
mod parameters;
mod schedule;
mod simulate;
mod warming;
mod wave;
mod wheel;

pub use parameters::{HARMONICS, P, Parameters, RunTerms, placed};
pub use schedule::{Period, Schedule};
pub use simulate::{RunInput, Trajectory, simulate};
pub use wheel::Wheel;

/// Warmth at the end of a drive of `seconds` at `duty` that began at `warmth`.
pub fn warm_up(warmth: f64, duty: f64, seconds: f64, tau: f64) -> f64 {
    duty + (warmth - duty) * (-seconds / tau.max(1e-3)).exp()
}

/// Delay of the wave in s after a rise of the drive that was off for `rest_s`.
fn start_delay(p: &Parameters, rest_s: f64) -> f64 {
    let rest = p.get(P::DelayRest);
    p.get(P::StartDelay) * if rest > 0.0 { 1.0 - (-rest_s / rest).exp() } else { 1.0 }
}

/// What the actuator path makes of a commanded duty.
pub fn effective_duty(duty: f64, p: &Parameters) -> f64 {
    if duty <= 0.0 {
        return 0.0;
    }
    let mut u = duty;
    let share = p.get(P::QuantShare);
    if share != 0.0 {
        let n = p.get(P::QuantSteps).max(1.0);
        let steps = if p.get(P::QuantDown) > 0.5 { (n * u + 1e-9).floor() } else { (n * u).round() };
        u += share * (steps / n - u);
    }
    u -= p.get(P::DeadDuty);
    u = u.max(0.0);
    let gate = p.get(P::GateDuty);
    if gate > 0.0 {
        u /= 1.0 + (-(duty - gate) / p.get(P::GateWidth).max(1e-4)).exp();
    }
    let bend = p.get(P::Bend);
    if bend != 0.0 {
        u /= (1.0 + bend * u.powf(p.get(P::BendPower))).max(0.1);
    }
    u = u.min(1.0 - p.get(P::FlatTop));
    u /= 1.0 + (u * p.get(P::Saturation)).max(-0.9);
    u.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::simulate::period_by_period;
    use super::*;
    use std::sync::Arc;
    use twum_motor::hypothesis::{ActsOn, Hypothesis, Number, Role};

    fn angles(p: &Parameters, on_s: f64, half_sample_s: f64, times: &[f64]) -> Vec<f64> {
        angles_towards(1.0, p, on_s, half_sample_s, times)
    }

    fn angles_towards(direction: f64, p: &Parameters, on_s: f64, half_sample_s: f64, times: &[f64]) -> Vec<f64> {
        // One PWM period of 20 ms with the drive on at its end, then none.
        let schedule = Schedule {
            periods: vec![Period { start: 0.0, end: 0.02, duty: on_s / 0.02 }],
            directions: vec![(0.0, direction)],
        };
        let angles = vec![0.0; times.len()];
        let input = RunInput {
            schedule: &schedule,
            drive_end: 0.02,
            times,
            half_sample_s,
            angles: &angles,
            warmth: 0.0,
            revolutions: 0.0,
            formulas: &[],
        };
        simulate(&input, p, &RunTerms::default()).angle
    }

    /// The same rotor in steps of a microsecond: the crest follows the drive with a time constant, the contact pulls the rotor towards it as far as
    /// the wave carries it, friction brakes for the rest.
    fn stepped(p: &Parameters, on_s: f64) -> f64 {
        let (mut height, mut speed, mut angle) = (0.0, 0.0_f64, 0.0);
        let dt = 1e-6;
        let lift = p.get(P::Lift).max(0.01);
        let [drive, brake] = [P::OnAcceleration, P::OffDeceleration].map(|rate| p.get(rate));
        for k in 0..2_000_000 {
            let goal = f64::from(u8::from(f64::from(k) * dt < on_s));
            height += (goal - height) * dt / p.get(P::WaveTime);
            let carried = height * height / (height * height + lift * lift);
            let rest = (1.0 - carried) * brake;
            speed = if carried * drive < rest {
                (speed - brake * dt).max(0.0)
            } else {
                let [behind, ahead] = [1.0, p.get(P::Ahead)].map(|share| (carried * drive * share + rest) * dt);
                speed + (height * p.get(P::FreeSpeed) - speed).clamp(-ahead, behind)
            };
            angle += speed * dt;
        }
        angle
    }

    /// Fails if the dying wave no longer drives a rotor that is slower than its crest: pulses of 1 ms then turn a sixth less.
    #[test]
    fn short_pulses_turn_as_far_as_small_steps_say() {
        let p = Parameters::new(3.57, 2009.0, 1900.0, 0.0, 0.005).with(P::WaveTime, 2.48e-4);
        for on_s in [1e-3, 2e-3, 4e-3, 10e-3] {
            let ours = angles(&p, on_s, 0.0, &[0.05])[0];
            let reference = stepped(&p, on_s);
            assert!((ours / reference - 1.0).abs() < 0.05, "{on_s} s: {ours} rad, in small steps {reference} rad");
        }
        let without = angles(&p.with(P::WaveTime, 0.0), 1e-3, 0.0, &[0.05])[0];
        assert!(without < 0.9 * stepped(&p, 1e-3), "the effect is there to be seen: {without}");
    }

    /// Fails if the contact is carried all at once from its lift on: pulses of a millisecond then turn this rotor twice as far.
    #[test]
    fn a_contact_is_carried_by_and_by() {
        let p = Parameters::new(2.1, 460.0, 43.0, 0.0, 0.01).with(P::WaveTime, 1.7e-3).with(P::Lift, 0.25);
        let p = p.with(P::Ahead, 0.9);
        for on_s in [1e-3, 2e-3, 4e-3, 10e-3] {
            let ours = angles(&p, on_s, 0.0, &[1.9])[0];
            let reference = stepped(&p, on_s);
            assert!((ours / reference - 1.0).abs() < 0.02, "{on_s} s: {ours} rad, in small steps {reference} rad");
        }
    }

    /// Fails if a friction that differs between the directions does not act under the wave and without it, or acts in one direction alone.
    #[test]
    fn a_friction_that_differs_between_the_directions_is_another_friction_in_each() {
        let of = |friction: f64| Parameters::new(3.57, 1000.0 * friction, 300.0 * friction, 0.3, 0.02);
        let asymmetric = of(1.0).with(P::AsymFriction, 0.3);
        let times = [0.013, 0.016, 0.02, 0.022, 0.04];
        for (direction, friction) in [(1.0, 1.3), (-1.0, 0.7)] {
            let ours = angles_towards(direction, &asymmetric, 10e-3, 0.0, &times);
            let reference = angles_towards(direction, &of(friction), 10e-3, 0.0, &times);
            let plain = angles_towards(direction, &of(1.0), 10e-3, 0.0, &times);
            for ((a, b), c) in ours.iter().zip(reference).zip(plain) {
                assert!((a - b).abs() < 1e-9 && (a - c).abs() > 1e-4, "{direction}: {a}, {b}, without {c}");
            }
        }
    }

    /// Fails if one of the numbers that map the duty acts elsewhere too: runs whose duty it leaves as it is are not simulated again.
    #[test]
    fn a_mapped_duty_is_that_drive_and_nothing_else() {
        let plain = Parameters::new(3.57, 1000.0, 300.0, 0.3, 0.02).with(P::WaveTime, 4e-4);
        let mapped = P::OF_THE_DUTY.map(|which| {
            let rounded = plain.with(P::QuantShare, 1.0).with(P::QuantSteps, 7.0);
            match which {
                P::QuantShare | P::QuantSteps => rounded,
                P::QuantDown => rounded.with(P::QuantDown, 1.0),
                P::GateDuty | P::GateWidth => plain.with(P::GateDuty, 0.58).with(P::GateWidth, 0.05),
                P::FlatTop => plain.with(P::FlatTop, 0.45),
                _ => plain.with(which, 0.2),
            }
        });
        let times = [0.009, 0.011, 0.013, 0.017, 0.02, 0.022, 0.04];
        for p in mapped {
            let duty = effective_duty(0.6, &p);
            assert!((duty - 0.6).abs() > 1e-3, "{p:?}");
            for (a, b) in angles(&p, 0.6 * 0.02, 0.0, &times).iter().zip(angles(&plain, duty * 0.02, 0.0, &times)) {
                assert!((a - b).abs() < 1e-9, "{p:?}: {a} {b}");
            }
        }
    }

    /// Fails if an edge is held against the angle in the middle of its sampling period.
    #[test]
    fn a_sampled_edge_stands_for_the_mean_of_both_samples() {
        let p = Parameters::new(3.57, 2009.0, 1900.0, 0.0, 0.02);
        let h = 0.5e-3;
        let times = [0.0104, 0.012, 0.0185, 0.021];
        let mean = angles(&p, 10e-3, h, &times);
        for (t, m) in times.iter().zip(mean) {
            let sides = angles(&p, 10e-3, 0.0, &[t - h, t + h]);
            assert!((m - 0.5 * (sides[0] + sides[1])).abs() < 1e-12, "at {t} s");
        }
    }

    /// Fails if a period that repeats the one before it is answered otherwise than one that is stepped: an effect too small to see, but
    /// there, keeps periods from repeating.
    #[test]
    fn repeated_periods_are_those_that_are_stepped() {
        let schedule = Schedule::constant(0.4, 1.0, 50.0, 0.0, 1.5);
        let times: Vec<f64> = (0..800).map(|k| 0.001 + 2.03e-3 * f64::from(k)).collect();
        let angles = vec![0.0; times.len()];
        for p in [
            Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02).with(P::WaveTime, 2.5e-4),
            Parameters::new(3.6, 900.0, 15.0, 0.1, 0.02).with(P::WaveTime, 2e-4).with(P::Lift, 0.1),
            Parameters::new(3.6, 1900.0, 400.0, 0.3, 0.02).with(P::Sag, 0.2).with(P::SagTime, 5e-3),
        ] {
            for half_sample_s in [0.0, 0.5e-3] {
                let input = RunInput {
                    schedule: &schedule,
                    drive_end: 1.5,
                    times: &times,
                    half_sample_s,
                    angles: &angles,
                    warmth: 0.0,
                    revolutions: 0.0,
                    formulas: &[],
                };
                let repeated = simulate(&input, &p, &RunTerms::default()).angle;
                let each = period_by_period(&input, &p.with(P::HeatLoss, 1e-12), &RunTerms::default()).angle;
                for (a, b) in repeated.iter().zip(&each) {
                    assert!((a - b).abs() < 1e-4, "{a} {b}");
                }
            }
        }
    }

    /// Fails if warmth leaves the friction as it was, or changes only what drives or only what brakes.
    #[test]
    fn a_warm_friction_is_that_of_another_rotor() {
        let schedule = Schedule::constant(0.4, 1.0, 50.0, 0.0, 1.5);
        let times: Vec<f64> = (1..150).map(|k| 0.01 * f64::from(k)).collect();
        let measured = vec![0.0; times.len()];
        let input = RunInput {
            schedule: &schedule,
            drive_end: 1.5,
            times: &times,
            half_sample_s: 0.0,
            angles: &measured,
            warmth: 0.4,
            revolutions: 0.0,
            formulas: &[],
        };
        let rotor = |friction: f64| Parameters::new(3.6, friction, friction, 0.3, 0.02).with(P::WaveTime, 2.5e-4);
        let angles = |p: &Parameters| simulate(&input, p, &RunTerms::default()).angle;
        // At the duty's own warmth nothing warms or cools.
        let warm = angles(&rotor(1900.0).with(P::HeatFriction, -0.5).with(P::HeatTau, 5.0));
        for (a, b) in warm.iter().zip(&angles(&rotor(0.8 * 1900.0))) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }

    /// Fails if wear is looked at once a run, or if it is held for longer than makes half a hundredth: as a formula over the revolutions it is not
    /// held at all.
    #[test]
    fn what_is_worn_follows_the_revolutions() {
        let size = Number { name: "a".into(), unit: "1".into(), role: Role::Typical(0.1), min: -0.5, max: 0.5 };
        let times: Vec<f64> = (1..800).map(|k| 5e-3 * f64::from(k)).collect();
        let measured = vec![0.0; times.len()];
        let rotor = Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02).with(P::WaveTime, 2.5e-4);
        for (wear, change) in [(P::Wear, "a*ln(1 + revolutions/0.5)"), (P::WearRunIn, "a*(1 - exp(-revolutions/0.5))")]
        {
            let formula = Hypothesis::new("mine", "", ActsOn::Speed, change, vec![size.clone()]).expect("a formula");
            let formulas = [Arc::new(formula)];
            for (duty, revolutions) in [(1.0, 0.0), (0.4, 0.0), (0.4, 40.0)] {
                let schedule = Schedule::constant(duty, 1.0, 50.0, 0.0, 4.0);
                let turned = |p: &Parameters| {
                    let input = RunInput {
                        schedule: &schedule,
                        drive_end: 4.0,
                        times: &times,
                        half_sample_s: 0.0,
                        angles: &measured,
                        warmth: 0.0,
                        revolutions,
                        formulas: &formulas,
                    };
                    simulate(&input, p, &RunTerms::default()).angle
                };
                let [worn, by_formula] =
                    [rotor.with(wear, 0.1).with(P::WearRevolutions, 0.5), rotor.with(P::FORMULA[0], 0.1)];
                for (a, b) in turned(&worn).iter().zip(turned(&by_formula)) {
                    assert!((a - b).abs() < 0.1 * 0.005 * b + 1e-3, "{change} at {duty} from {revolutions}: {a} {b}");
                }
            }
        }
    }
}
