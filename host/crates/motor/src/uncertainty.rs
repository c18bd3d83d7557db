//! What is not known of a motor, carried on: motors drawn from the uncertainties of a motor file, and the bands that what is foretold
//! of them lies in.

use super::motor::Motor;
use super::parameters::{Flavour, ParameterError, Parameters, SPECS};
use super::robust::stream;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use thiserror::Error;
use twum_fit::quantile::{INTERVAL_95, quantiles};

/// Beyond a factor of e either way a logarithm's standard deviation says nothing any more, as for `identify force-factor`.
const WIDEST: f64 = 1.0;
/// A draw outside of what the model describes is drawn again so many times.
const AGAIN: u64 = 100;

/// Why nothing can be drawn.
#[derive(Debug, Error)]
pub enum UncertaintyError {
    /// The file knows everything exactly.
    #[error(
        "the motor file `{motor}` states no uncertainty that the flavour `{flavour}` uses: add `uncertainty` to its parameters, or have \
         `twum tune` or `twum identify ... --save` write it"
    )]
    Exact {
        /// The motor.
        motor: String,
        /// The flavour.
        flavour: Flavour,
    },
    /// Hardly any draw is a motor.
    #[error(
        "of motors as uncertain as the motor file `{motor}` says, hardly any is one that the model describes: {reason}"
    )]
    Outside {
        /// The motor.
        motor: String,
        /// What was wrong with the last one.
        reason: ParameterError,
    },
}

/// The range that 95 % of the draws lie in, and their median.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Band {
    /// Median.
    pub median: f64,
    /// Where 95 % lie.
    pub ci95: [f64; 2],
}

impl Band {
    /// Of what was foretold for each draw.
    pub fn of(values: Vec<f64>) -> Self {
        let [low, median, high] = quantiles(values, [INTERVAL_95[0], 0.5, INTERVAL_95[1]]);
        Self { median, ci95: [low, high] }
    }
}

/// Motors as a file's uncertainties have them, around `nominal`; parameters of the names in `exact` stay as they are there.
///
/// Positive parameters are drawn by their logarithm. `Ms`, `Cs` and `Ks` have one factor in common, that of `Ms`: the admittance fixes their ratios
/// and only their size is uncertain. Everything else is drawn by itself, which makes a band too wide where two parameters were
/// found together.
///
/// # Errors
/// When the file states no uncertainty, or hardly any draw lies within the model's bounds.
pub fn draws(
    motor: &Motor,
    flavour: Flavour,
    nominal: &Parameters,
    exact: &[String],
    count: u64,
    seed: u64,
) -> Result<Vec<Parameters>, UncertaintyError> {
    let spread: Vec<f64> = SPECS
        .iter()
        .map(|spec| {
            let known = exact.iter().any(|name| name == spec.name);
            // Only the measured and the physical rotor have friction without a wave.
            let unused = spec.name == "uoff" && flavour == Flavour::Thesis || spec.name == "b";
            let entry = motor.entry(flavour, spec.name).filter(|_| !known && !unused);
            entry.and_then(|entry| entry.uncertainty).unwrap_or(0.0)
        })
        .collect();
    if spread.iter().all(|spread| *spread == 0.0) {
        return Err(UncertaintyError::Exact { motor: motor.name.clone(), flavour });
    }
    (0..count)
        .map(|index| {
            let mut rng = stream(seed, index);
            let mut last = None;
            for _ in 0..AGAIN {
                match drawn(nominal, &spread, &mut rng).check() {
                    Ok(parameters) => return Ok(parameters),
                    Err(reason) => last = Some(reason),
                }
            }
            let reason = last.unwrap_or(ParameterError::Unknown { name: String::new() });
            Err(UncertaintyError::Outside { motor: motor.name.clone(), reason })
        })
        .collect()
}

fn drawn(nominal: &Parameters, spread: &[f64], rng: &mut ChaCha8Rng) -> Parameters {
    let mut values = nominal.to_array();
    let mut size = 1.0;
    for ((value, spec), sd) in values.iter_mut().zip(&SPECS).zip(spread) {
        let normal: f64 = StandardNormal.sample(rng);
        let factor = (normal * (sd / *value).min(WIDEST)).exp();
        match spec.name {
            "Ms" if *sd > 0.0 => {
                size = factor;
                *value *= size;
            }
            "Cs" | "Ks" => *value *= size,
            // A load, or a damping of nothing, may have either sign, and the bounds say which.
            _ if *value <= 0.0 => *value += normal * sd,
            _ => *value *= factor,
        }
    }
    Parameters::from_array(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uncertain() -> Motor {
        let mut motor = Motor::pcbmotor_30mm();
        let tables = [&mut motor.parameters, &mut motor.physical, &mut motor.measured];
        tables.into_iter().flat_map(|table| table.values_mut()).for_each(|entry| entry.uncertainty = None);
        let h = motor.parameters.get_mut("h").unwrap();
        h.uncertainty = Some(0.02 * h.value);
        motor
    }

    /// Fails when the spread of the draws is not the file's, or something exact is drawn.
    #[test]
    fn draws_spread_as_the_file_says() {
        let motor = uncertain();
        let nominal = motor.parameters(Flavour::Measured);
        let found = draws(&motor, Flavour::Measured, &nominal, &[], 2_000, 1).unwrap();
        let h: Vec<f64> = found.iter().map(|p| p.half_thickness_m / nominal.half_thickness_m).collect();
        let band = Band::of(h);
        assert!((band.median - 1.0).abs() < 0.002, "{band:?}");
        assert!((band.ci95[1] - 1.96f64.mul_add(0.02, 1.0)).abs() < 0.005, "{band:?}");
        let same = |p: &Parameters| Parameters { half_thickness_m: nominal.half_thickness_m, ..*p } == nominal;
        assert!(found.iter().all(same), "nothing else is uncertain");
        let exact = draws(&motor, Flavour::Measured, &nominal, &["h".to_owned()], 5, 1).unwrap_err().to_string();
        assert!(exact.contains("states no uncertainty") && exact.contains("measured"), "{exact}");
    }

    /// The stator's size alone is uncertain: its resonance and its quality are not, or no draw would be near the drive's frequency.
    #[test]
    fn the_stators_ratios_stay() {
        let motor = Motor::pcbmotor_30mm();
        let nominal = motor.parameters(Flavour::Physical);
        for p in draws(&motor, Flavour::Physical, &nominal, &["f".to_owned()], 50, 3).unwrap() {
            assert!((p.resonance_hz() / nominal.resonance_hz() - 1.0).abs() < 1e-9);
            assert!(p.modal_mass_kg != nominal.modal_mass_kg);
        }
    }
}
