//! Controllers for a motor that was identified: the named ones, with what in them is the motor's put right.
//!
//! `thesis` and `default` are gains in duty steps a count, made for one speed at full drive. A motor that turns twice as fast makes the
//! same loop with half the gains, so their gains go with the inverse of the speed. No gain came from tuning them further
//! (docs/control.md). `gated` has no gains but a model of the motor, which is told what was found.

use super::fit::{FitError, Identified};
use fixed::types::{I16F48, I32F32};
use serde::Serialize;
use twum_motor::parameters::Parameters;
use twum_shared::step::{ConfigSpec, DriveLaw};

/// What a controller has to know of a motor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Facts {
    /// Speed at full drive, mean of both directions (counts/s).
    pub full_speed_counts_s: f64,
    /// Speed lost with the drive off (counts/s²).
    pub braking_counts_s2: f64,
}

impl Facts {
    /// Of what was identified.
    ///
    /// # Errors
    /// When the model cannot be had there.
    pub fn of(identified: &Identified) -> Result<Self, FitError> {
        let motor = identified.best()?;
        let edges = f64::from(identified.edges_per_rev);
        let rpm = 0.5 * (identified.full_cw_rpm.median + identified.full_ccw_rpm.median);
        let Parameters { rotor_inertia_kg_m2, .. } = motor.parameters;
        let braking_rad_s2 = motor.parameters.off_friction_nm(motor.flavour) / rotor_inertia_kg_m2;
        Ok(Self {
            full_speed_counts_s: rpm / 60.0 * edges,
            braking_counts_s2: braking_rad_s2 / std::f64::consts::TAU * edges,
        })
    }
}

/// Crossover of the default controller on the motor it was made for: 70 steps a count of 1024, 234 counts/s at full drive (rad/s).
pub const BANDWIDTH_RAD_S: f64 = 16.0;
/// Longest rest before a reversal: what the board would take for a stall (ticks).
const LONGEST_REST_TICKS: f64 = 400.0;

/// A named controller for a motor; `bandwidth_rad_s` is the crossover of its position loop where it has gains.
pub fn design(name: &ConfigSpec, facts: &Facts, bandwidth_rad_s: f64) -> ConfigSpec {
    let of = f64::from(ConfigSpec::GATED.full_speed_counts_s);
    let ticks_s = 1e6 / f64::from(name.period_us);
    match name.law {
        DriveLaw::Gated => {
            let full = facts.full_speed_counts_s.round().clamp(1.0, f64::from(u16::MAX));
            // A rotor that loses its speed within a tick stands at once: braking by more says nothing, and less than a tick the
            // chip's numbers do not hold.
            let most = (0.999 * full * ticks_s).min(f64::from(u32::MAX));
            ConfigSpec {
                full_speed_counts_s: full as u16,
                braking_counts_s2: facts.braking_counts_s2.clamp(1.0, most) as u32,
                ..with_rest(name, rest_ticks(facts, ticks_s, 0.0).max(f64::from(name.reversal_rest_ticks)))
            }
        }
        DriveLaw::ActiveLowTruncated | DriveLaw::OnTimeRounded => {
            let speed = of / facts.full_speed_counts_s;
            let faster = bandwidth_rad_s / BANDWIDTH_RAD_S;
            let gain = |value: I32F32, factor: f64| I32F32::saturating_from_num(value.to_num::<f64>() * factor);
            // What the integral may add, in duty, stays.
            let limit = |value: i32| (f64::from(value) / (speed * faster * faster)).round() as i32;
            let scaled = ConfigSpec {
                kp: gain(name.kp, speed * faster),
                // Its corner goes with the crossover.
                ki_tick: I16F48::saturating_from_num(name.ki_tick.to_num::<f64>() * speed * faster * faster),
                kd_tick: gain(name.kd_tick, speed),
                feed_forward: gain(name.feed_forward, speed),
                integral_min: limit(name.integral_min),
                integral_max: limit(name.integral_max),
                ..*name
            };
            if name.law == DriveLaw::OnTimeRounded {
                // A duty that was taken back may still be in its period.
                with_rest(&scaled, rest_ticks(facts, ticks_s, ticks_s / f64::from(name.pwm_hz())))
            } else {
                // The thesis's drive is never off.
                scaled
            }
        }
    }
}

/// Ticks without an edge after which the rotor stands: what braking takes for the last count, once the drive is off.
fn rest_ticks(facts: &Facts, ticks_s: f64, off_after_ticks: f64) -> f64 {
    let last_count_s = (2.0 / facts.braking_counts_s2.max(1e-3)).sqrt();
    (off_after_ticks + last_count_s * ticks_s).ceil().clamp(1.0, LONGEST_REST_TICKS)
}

fn with_rest(spec: &ConfigSpec, ticks: f64) -> ConfigSpec {
    let limit = (2.0 * ticks).max(f64::from(spec.reversal_limit_ticks));
    ConfigSpec { reversal_rest_ticks: ticks as u16, reversal_limit_ticks: limit as u16, ..*spec }
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::step::Config;

    const SHIPPED: Facts = Facts { full_speed_counts_s: 234.0, braking_counts_s2: 16_400.0 };

    /// On the motor they were made for nothing but the rests changes; on one that turns twice as fast the gains halve.
    #[test]
    fn the_gains_go_with_the_inverse_of_the_speed() {
        for (name, spec) in ConfigSpec::NAMED {
            let same = design(&spec, &SHIPPED, BANDWIDTH_RAD_S);
            let rests = |s: ConfigSpec| ConfigSpec {
                reversal_rest_ticks: spec.reversal_rest_ticks,
                reversal_limit_ticks: spec.reversal_limit_ticks,
                ..s
            };
            assert_eq!(rests(same), spec, "{name}");
            let fast = design(&spec, &Facts { full_speed_counts_s: 468.0, ..SHIPPED }, BANDWIDTH_RAD_S);
            assert!((fast.kp.to_num::<f64>() - 0.5 * spec.kp.to_num::<f64>()).abs() < 1e-6, "{name}");
            Config::try_from(fast).unwrap();
        }
        let gated = design(&ConfigSpec::GATED, &Facts { full_speed_counts_s: 190.0, ..SHIPPED }, BANDWIDTH_RAD_S);
        assert_eq!(gated.full_speed_counts_s, 190);
    }

    /// Whatever was identified of a motor that turns by 3 rpm and more (of 400 edges), the chip takes it.
    #[test]
    fn every_design_is_a_controller() {
        for speed in [20.0, 60.0, 234.0, 2_000.0, 12_000.0] {
            for braking in [200.0, 16_400.0, 1e7, 1e12] {
                let facts = Facts { full_speed_counts_s: speed, braking_counts_s2: braking };
                for (name, spec) in ConfigSpec::NAMED {
                    let made = Config::try_from(design(&spec, &facts, BANDWIDTH_RAD_S));
                    assert!(made.is_ok(), "{name} at {facts:?}: {made:?}");
                }
            }
        }
    }
}
