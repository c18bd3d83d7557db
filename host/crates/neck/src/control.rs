//! The position controller at another sensor's resolution.
//!
//! A controller is tuned in duty steps per count of the 400-edge encoder. With `N` edges a revolution a count is `400/N`
//! of that angle, so the gains per count shrink by `400/N` and the limits in counts grow by `N/400`: the controller does
//! the same per degree, only its quantisation is finer. Duty steps are the actuator's and stay as they are.

use fixed::types::{I16F48, I32F32};
use twum_motor::parameters::Flavour;
use twum_record::configuration::{ControllerError, controller};
use twum_shared::step::{Config, ConfigError, ConfigSpec};

/// A controller, and what it is called.
#[derive(Debug, Clone, PartialEq)]
pub struct Controller {
    /// The name it was asked for by: one that ships, or a file's.
    pub name: String,
    /// The controller, tuned for [`TUNED_EDGES_PER_REV`].
    pub spec: ConfigSpec,
}

impl Controller {
    /// The controller of a name, or of a file.
    ///
    /// # Errors
    /// Names the file, the key and what is wrong with it.
    pub fn load(name: &str) -> Result<Self, ControllerError> {
        Ok(Self { name: name.to_owned(), spec: controller(name)? })
    }

    /// The controller that a flavour of the motor is tried with unless asked otherwise: the thesis had its own model under its own
    /// controller.
    pub fn of(flavour: Flavour) -> Self {
        let (name, spec) = match flavour {
            Flavour::Thesis => ("thesis", ConfigSpec::THESIS),
            Flavour::Physical | Flavour::Measured => ("default", ConfigSpec::DEFAULT),
        };
        Self { name: name.to_owned(), spec }
    }
}

/// Edges a revolution of the encoder the named configurations are tuned for.
pub const TUNED_EDGES_PER_REV: u32 = 400;

/// The controller of `spec`, tuned for 400 edges a revolution, on a sensor with `edges_per_rev`.
///
/// # Errors
/// When the scaled gains or limits leave what the control step can compute.
pub fn at_resolution(spec: &ConfigSpec, edges_per_rev: u32) -> Result<Config, ConfigError> {
    let scale = f64::from(TUNED_EDGES_PER_REV) / f64::from(edges_per_rev);
    let gain = |value: I32F32| I32F32::saturating_from_num(value.to_num::<f64>() * scale);
    let limit = |value: i32| (f64::from(value) / scale).round() as i32;
    Config::try_from(ConfigSpec {
        kp: gain(spec.kp),
        ki_tick: I16F48::saturating_from_num(spec.ki_tick.to_num::<f64>() * scale),
        kd_tick: gain(spec.kd_tick),
        feed_forward: gain(spec.feed_forward),
        integral_min: limit(spec.integral_min),
        integral_max: limit(spec.integral_max),
        full_speed_counts_s: (f64::from(spec.full_speed_counts_s) / scale).round() as u16,
        braking_counts_s2: (f64::from(spec.braking_counts_s2) / scale).round() as u32,
        dead_band_counts: (f64::from(spec.dead_band_counts) / scale).round() as u16,
        ..*spec
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::step::{Inputs, State, step};

    #[test]
    fn the_tuned_resolution_changes_nothing() {
        for (_, spec) in ConfigSpec::NAMED {
            assert_eq!(*at_resolution(&spec, 400).unwrap().spec(), spec);
        }
    }

    /// Errors that are whole counts of both sensors give the same drive, integral and all.
    #[test]
    fn the_same_angle_gives_the_same_drive_at_every_resolution() {
        for spec in [ConfigSpec::THESIS, ConfigSpec::DEFAULT] {
            for finer in [4, 10, 160] {
                let coarse = Config::try_from(spec).unwrap();
                let fine = at_resolution(&spec, 400 * finer as u32).unwrap();
                let (mut a, mut b) = (State::REST, State::REST);
                for tick in 0..10_000 {
                    let error = (12.0 * (f64::from(tick) * 1e-3).sin()).round() as i32;
                    let rate = (12.0 * (f64::from(tick) * 1e-3).cos()).round() as i32;
                    let x = step(&coarse, &mut a, Inputs { target: error, target_rate: rate, ..Inputs::default() });
                    let inputs = Inputs { target: error * finer, target_rate: rate * finer, ..Inputs::default() };
                    let y = step(&fine, &mut b, inputs);
                    assert!((x.u - y.u).abs() <= 2, "{finer} times finer, tick {tick}: {} against {}", x.u, y.u);
                }
            }
        }
    }
}
