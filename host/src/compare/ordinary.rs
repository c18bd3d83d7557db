//! A measurement of an ordinary motor against a saved one.

use crate::diagnose::inertial::{Model, RunAgainst};
use crate::record::measurement::Measurement;
use serde::Serialize;

/// No run of the measurement can be simulated.
#[derive(Debug, thiserror::Error)]
#[error("no run can be compared: {0}")]
pub struct NoRuns(String);

/// Runs of an ordinary motor beside what a saved one makes of their inputs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ordinary {
    /// What the saved motor is called.
    pub motor: String,
    /// Root mean square of the difference over all runs, each alike, in rpm.
    pub rmse_speed_rpm: f64,
    /// The runs.
    pub runs: Vec<RunAgainst>,
    /// What was left out.
    pub left_out: Vec<String>,
}

/// Holds the runs against a saved motor.
///
/// # Errors
/// When no run can be used.
pub fn compare(model: &Model, measurement: &Measurement) -> Result<Ordinary, NoRuns> {
    let (runs, left_out) = model.against(&measurement.runs.iter().collect::<Vec<_>>());
    if runs.is_empty() {
        return Err(NoRuns(left_out.join("; ")));
    }
    let squares: f64 = runs.iter().map(|r| r.rmse_rpm.powi(2)).sum();
    let rmse_speed_rpm = (squares / runs.len() as f64).sqrt();
    Ok(Ordinary { motor: model.name.clone(), rmse_speed_rpm, runs, left_out })
}
