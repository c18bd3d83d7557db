//! The force factor from speeds, with what it trades off against.
//!
//! The thesis tuned η by hand until the simulated speeds looked right, and doubted the outcome: η may have made up for errors
//! elsewhere. Here the averaged model is fitted to the steady speed and the start-up lag of every run, with η free and each
//! parameter that could stand in for it free within what is known of it (a Gaussian prior on its logarithm from the motor
//! file's uncertainty, or 10 % where the file gives none). The interval of η then holds all of those trades, and the report
//! says which parameter takes part in it, by how much, and whether the data or only the prior separates the two.

mod model;
pub mod observe;
mod report;
mod torque;

pub use torque::{Loaded, TorqueError, TorqueRuns};

use model::{RIVALS, TORQUE_RELATIVE, predictions, prior, start, steps, targets, with};
use nalgebra::{DMatrix, DVector};
use observe::{Observed, observe, scatter};
use report::Fitted;
use serde::Serialize;
use twum_fit::least_squares::Search;
use twum_motor::motor::Motor;
use twum_motor::parameters::Flavour;
use twum_record::measurement::Measurement;

/// Why no force factor could be had.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ForceFactorError {
    /// A load that the motor cannot have turned against.
    #[error(
        "a speed under {load_nm} N m: the contact of this motor transmits {most_nm:.6} N m at most; is the unit N m, and \
         the motor file's friction right?"
    )]
    Load {
        /// The load, N·m.
        load_nm: f64,
        /// What the contact transmits, N·m.
        most_nm: f64,
    },
    /// Nothing to go by.
    #[error(
        "{0}: no speed run with a duty, a direction and at least 0.8 s of drive after the start: record some with `twum speed`"
    )]
    NoRuns(String),
    /// The model does not turn where the motor did.
    #[error(
        "the model does not turn at any duty with eta up to {largest} N/V: check Fext, u and Vrms of the motor file"
    )]
    Stuck {
        /// The largest force factor tried (N/V).
        largest: f64,
    },
}

/// One run against the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunResult {
    /// Run.
    pub id: String,
    /// Duty.
    pub duty: f64,
    /// Load against the motion (N·m).
    pub load_nm: f64,
    /// Steady speed measured (rpm).
    pub rpm: f64,
    /// Steady speed of the fitted model (rpm).
    pub model_rpm: f64,
    /// Start-up lag measured: how far the motor is behind one that ran steadily from t = 0 (s).
    pub lag_s: Option<f64>,
    /// Start-up lag of the fitted model (s).
    pub model_lag_s: Option<f64>,
}

/// How a parameter trades with the force factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trade {
    /// Parameter.
    pub with: String,
    /// Correlation of the two after the fit.
    pub correlation: f64,
    /// Per cent of η that one per cent of the parameter is answered by, everything else held.
    pub exchange: f64,
    /// Relative standard uncertainty before the fit.
    pub prior_relative: f64,
    /// And after.
    pub posterior_relative: f64,
    /// Value the fit settled on over the motor file's.
    pub ratio: f64,
}

/// The answer of `twum identify force-factor`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of this shape.
    pub schema: u32,
    /// Folder read.
    pub source: String,
    /// Motor file it starts from.
    pub motor: String,
    /// Reading of the model.
    pub flavour: Flavour,
    /// Force factor (N/V).
    pub eta_n_v: f64,
    /// Its 95 % interval with every trade in it (N/V).
    pub ci95: [f64; 2],
    /// Its 95 % interval were every other parameter exact (N/V).
    pub ci95_others_exact: [f64; 2],
    /// Parameters it trades with, the strongest first.
    pub trades: Vec<Trade>,
    /// Each run.
    pub runs: Vec<RunResult>,
    /// Stall torque of the fitted model (N·m).
    pub stall_nm: f64,
    /// Stall torques measured (N·m).
    pub stall_measured_nm: Vec<f64>,
    /// Coefficient of determination over the steady speeds; null below three.
    pub r2_speed: Option<f64>,
    /// Factor by which the residual exceeds the measurement's scatter; 1 is none.
    pub misfit: f64,
    /// What a reader should know.
    pub notes: Vec<String>,
}

/// Fits the force factor of `motor` to the speed runs of a measurement and to loaded speeds.
///
/// # Errors
/// [`ForceFactorError`].
pub fn identify(
    measurement: &Measurement,
    torque: &TorqueRuns,
    motor: &Motor,
    flavour: Flavour,
) -> Result<Report, ForceFactorError> {
    let mut observed: Vec<Observed> =
        measurement.runs.iter().filter_map(|run| observe(run, measurement.edges_per_rev)).collect();
    if observed.is_empty() && torque.loaded.is_empty() {
        return Err(ForceFactorError::NoRuns(measurement.folder.display().to_string()));
    }
    scatter(&mut observed);
    let contact = motor.parameters(flavour);
    let most_nm = contact.friction * contact.preload_n * contact.contact_radius_m;
    if let Some(beyond) = torque.loaded.iter().find(|l| l.load_nm.abs() >= most_nm) {
        return Err(ForceFactorError::Load { load_nm: beyond.load_nm, most_nm });
    }
    observed.extend(torque.loaded.iter().map(|l| Observed {
        id: format!("load {} N m", l.load_nm),
        duty: l.duty,
        sign: 1.0,
        load_nm: l.load_nm,
        pwm_hz: 50.0,
        pwm_phase_s: 0.0,
        rpm: l.rpm,
        sigma_rpm: TORQUE_RELATIVE * l.rpm.max(1.0),
        lag: None,
    }));
    let base = motor.parameters(flavour);
    let priors: Vec<f64> = RIVALS.iter().map(|name| prior(motor, flavour, name)).collect();
    let (data, sigma) = targets(&observed, &torque.stall_nm);
    let predict = |x: &DVector<f64>| predictions(&observed, torque.stall_nm.len(), &with(&base, x), flavour);
    let steps = steps();
    let search = Search { data: &data, sigma: &sigma, priors: &priors, steps: &steps, predict: &predict };
    let mut best = search.settle(start(&observed, &base, flavour, &data, &sigma)?, false, None);
    let (mut low, mut high);
    let mut restarts = 0;
    loop {
        (low, high) = (search.end(&best, -1.0), search.end(&best, 1.0));
        let better = [&low, &high].into_iter().filter_map(|e| e.better.clone()).next();
        match better {
            // The way to an end of the interval led to a better fit: go on from there.
            Some(x) if restarts < 3 => {
                restarts += 1;
                best = search.settle(x, false, None);
            }
            _ => break,
        }
    }
    let (normal, _) = search.normal_equations(&best);
    let covariance = normal.clone().try_inverse().unwrap_or_else(|| DMatrix::identity(best.x.len(), best.x.len()));
    let alone = 1.0 / normal[(0, 0)].sqrt();
    let fitted = Fitted {
        base,
        observed: &observed,
        stall_nm: &torque.stall_nm,
        sigma: &sigma,
        priors: &priors,
        best: &best,
        covariance: &covariance,
    };
    Ok(fitted.report(measurement, motor, flavour, [low.x0, high.x0], alone))
}
