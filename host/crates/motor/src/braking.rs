//! How much the rotor brakes while the drive is off, from the two figures the thesis measured on the real motor's closed loop.
//!
//! Everything else of the listed model stays as identified; the torque without a wave is the one unknown, so the two figures
//! check each other. What the thesis does not state, the encoder's phase at the start, is spread over a pitch.

use super::closed_loop::{LoopProgram, following, run};
use super::effects::EffectSet;
use super::motor::Motor;
use super::motor_plant::{History, MotorPlant, Solver};
use super::parameters::{Flavour, ParameterError, Parameters};
use super::study::{Setup, SetupError};
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;
use thiserror::Error;
use twum_shared::step::ConfigError;

/// What the thesis measured on the real motor (section 5.3): mean square of the position error (deg²), and mean of its amount (deg).
pub const MEASURED: [f64; 2] = [14.199, 3.125];
/// The same of its simulation.
pub const SIMULATED: [f64; 2] = [2.566, 1.452];
/// R² of its simulated speeds over duty against the real motor's.
pub const MEASURED_R2: f64 = 0.974;
/// HIGH fractions of the active-low pin at which it measured speeds (section A.7, line 13).
const HIGH: [f64; 11] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.93];
/// Torques looked at (N·m): from a rotor that all but coasts to one that stands 3 ms after the wave.
const TORQUES: [f64; 2] = [0.0, 4e-4];
const STEPS: u32 = 20;
/// Phases of the encoder at the start, over two pitches: one whole period of its line.
const PHASES: u32 = 8;

/// The closed loop and the speeds at one torque.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// Torque without a wave (N·m).
    pub torque_nm: f64,
    /// Mean square (deg²) and mean amount (deg) of the counted error: mean over the encoder's phases.
    pub mse_deg2: f64,
    /// See `mse_deg2`.
    pub mean_abs_deg: f64,
    /// R² of the listed model's speeds over duty, if this were the real motor; none where its speeds do not differ.
    pub r2_listed: Option<f64>,
}

/// The torque one figure asks for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Asked {
    /// The figure.
    pub figure: &'static str,
    /// Its measured value.
    pub measured: f64,
    /// Torque (N·m): mean over the encoder's phases; none where no torque gives it.
    pub torque_nm: Option<f64>,
    /// Least and greatest over the phases (N·m).
    pub range_nm: Option<[f64; 2]>,
}

/// What the figures say of the braking.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Braking {
    /// Over torques.
    pub points: Vec<Point>,
    /// By either figure of the loop, and by the speeds.
    pub asked: Vec<Asked>,
    /// The torque that both figures of the loop allow (N·m): the middle of what they ask for over all phases.
    pub torque_nm: Option<f64>,
    /// The interval that holds both (N·m).
    pub interval_nm: Option<[f64; 2]>,
    /// `uoff` of that torque.
    pub off_friction: Option<f64>,
}

/// Why the braking cannot be found.
#[derive(Debug, Error)]
pub enum BrakingError {
    /// The controller cannot run.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The motor's parameters will not do.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// The speeds cannot be simulated.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

/// Finds the torque without a wave under which the measured flavour of a motor gives what the thesis measured.
///
/// # Errors
/// When the motor cannot be simulated with some of the torques.
pub fn braking(motor: &Motor) -> Result<Braking, BrakingError> {
    let torques: Vec<f64> =
        (0..=STEPS).map(|i| TORQUES[0] + (TORQUES[1] - TORQUES[0]) * f64::from(i) / f64::from(STEPS)).collect();
    let listed = speeds(motor.parameters(Flavour::Thesis), Flavour::Thesis)?;
    // Per torque: the loop's two figures at each phase, and R².
    let found = torques
        .par_iter()
        .map(|&torque_nm| {
            let parameters = with_torque(motor, torque_nm)?;
            let loops = (0..PHASES)
                .map(|i| loop_figures(parameters, motor.edges_per_rev, f64::from(i) / f64::from(PHASES)))
                .collect::<Result<Vec<_>, ConfigError>>()?;
            let r2 = r2(&listed, &speeds(parameters, Flavour::Measured)?);
            Ok((loops, r2))
        })
        .collect::<Result<Vec<_>, BrakingError>>()?;
    let points = torques.iter().zip(&found).map(|(&torque_nm, (loops, r2))| {
        let mean = |k: usize| loops.iter().map(|f| f[k]).sum::<f64>() / loops.len() as f64;
        Point { torque_nm, mse_deg2: mean(0), mean_abs_deg: mean(1), r2_listed: *r2 }
    });
    let mut asked: Vec<Asked> = ["mean square error of the loop (deg²)", "mean error of the loop (deg)"]
        .into_iter()
        .enumerate()
        .map(|(k, figure)| {
            let crossings: Vec<f64> = (0..PHASES as usize)
                .filter_map(|phase| {
                    let values: Vec<f64> = found.iter().map(|(loops, _)| loops[phase][k]).collect();
                    crossing(&torques, &values, MEASURED[k])
                })
                .collect();
            Asked::of(figure, MEASURED[k], &crossings)
        })
        .collect();
    let both: Option<Vec<[f64; 2]>> = asked.iter().map(|a| a.range_nm).collect();
    let interval_nm = both.map(|r| [r[0][0].min(r[1][0]), r[0][1].max(r[1][1])]);
    let r2: Vec<f64> = found.iter().map(|(_, r2)| r2.unwrap_or(1.0)).collect();
    asked.push(Asked::of(
        "R² of the listed speeds over duty",
        MEASURED_R2,
        &crossing(&torques, &r2, MEASURED_R2).into_iter().collect::<Vec<_>>(),
    ));
    let torque_nm = interval_nm.map(|[low, high]| 0.5 * (low + high));
    let p = motor.parameters(Flavour::Measured);
    let off_friction = torque_nm.map(|t| t / (p.preload_n * p.contact_radius_m));
    Ok(Braking { points: points.collect(), asked, torque_nm, interval_nm, off_friction })
}

impl Asked {
    fn of(figure: &'static str, measured: f64, torques: &[f64]) -> Self {
        let range = torques.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| [a.min(*t), b.max(*t)]);
        let some = !torques.is_empty();
        Self {
            figure,
            measured,
            torque_nm: some.then(|| torques.iter().sum::<f64>() / torques.len() as f64),
            range_nm: some.then_some(range),
        }
    }
}

fn with_torque(motor: &Motor, torque_nm: f64) -> Result<Parameters, ParameterError> {
    let mut p = motor.parameters(Flavour::Measured);
    p.set("uoff", torque_nm / (p.preload_n * p.contact_radius_m))?;
    Ok(p)
}

/// The thesis's closed-loop test on the measured flavour; `phase` is the encoder's, as a share of two pitches.
fn loop_figures(parameters: Parameters, edges_per_rev: u32, phase: f64) -> Result<[f64; 2], ConfigError> {
    let program = LoopProgram {
        encoder_phase_rad: 2.0 * phase * TAU / f64::from(edges_per_rev),
        ..LoopProgram::thesis(edges_per_rev)?
    };
    let none = EffectSet::default();
    let mut plant = MotorPlant::new(parameters, Flavour::Measured, Solver::Averaged, &none, History::default());
    let trace = run(&program, &mut plant, &none)?;
    let found = following(&program, &trace);
    Ok([found.mse_deg2, found.mean_abs_deg])
}

/// Steady speeds at the thesis's duties (rpm).
fn speeds(parameters: Parameters, flavour: Flavour) -> Result<Vec<f64>, SetupError> {
    let setup = Setup {
        parameters,
        effects: EffectSet::default(),
        flavour,
        solver: Solver::Averaged,
        duty: 1.0,
        pwm_hz: 50.0,
        seconds: 1.0,
    };
    // The board writes whole 32nds to an active-low pin.
    let duties = HIGH.map(|high| 1.0 - (32.0_f64 * high).round() / 32.0);
    Ok(setup.sweep(&duties)?.into_iter().map(|(_, speed)| speed.speed_rpm).collect())
}

fn r2(simulated: &[f64], real: &[f64]) -> Option<f64> {
    let mean = real.iter().sum::<f64>() / real.len() as f64;
    let all: f64 = real.iter().map(|v| (v - mean).powi(2)).sum();
    let left: f64 = real.iter().zip(simulated).map(|(r, s)| (r - s).powi(2)).sum();
    (all > 0.0).then(|| 1.0 - left / all)
}

/// Where values over a grid first pass a level, by straight lines.
fn crossing(at: &[f64], values: &[f64], level: f64) -> Option<f64> {
    at.windows(2).zip(values.windows(2)).find_map(|(t, v)| {
        let (a, b) = (v[0] - level, v[1] - level);
        (a * b <= 0.0 && a != b).then(|| t[0] + (t[1] - t[0]) * a / (a - b))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The shipped torque, the figures it was solved for, and an independent plant's figures (14.01 deg², 3.07° at 1.97e-4 N·m).
    #[test]
    fn one_torque_gives_both_measured_figures() {
        let motor = Motor::pcbmotor_30mm();
        let shipped = motor.parameters(Flavour::Measured);
        let torque_nm = shipped.off_friction_nm(Flavour::Measured);
        assert!((torque_nm / 1.97e-4 - 1.0).abs() < 0.02, "{torque_nm}");
        let found = loop_figures(shipped, motor.edges_per_rev, 0.0).unwrap();
        for (found, measured) in found.into_iter().zip(MEASURED) {
            assert!((found / measured - 1.0).abs() < 0.03, "{found} against {measured}");
        }
        // Both others are far off, so the torque is what does it.
        for flavour in [Flavour::Thesis, Flavour::Physical] {
            let program = LoopProgram::thesis(motor.edges_per_rev).unwrap();
            let none = EffectSet::default();
            let p = motor.parameters(flavour);
            let mut plant = MotorPlant::new(p, flavour, Solver::Averaged, &none, History::default());
            let found = following(&program, &run(&program, &mut plant, &none).unwrap());
            assert!((found.mean_abs_deg / MEASURED[1] - 1.0).abs() > 0.5, "{flavour}: {found:?}");
        }
    }

    #[test]
    fn crossings_are_found_between_points() {
        assert_eq!(crossing(&[0.0, 1.0, 2.0], &[1.0, 3.0, 2.0], 2.0), Some(0.5));
        assert_eq!(crossing(&[0.0, 1.0], &[1.0, 3.0], 4.0), None);
    }
}
