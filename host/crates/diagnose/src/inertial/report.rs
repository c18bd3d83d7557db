//! The numbers of an ordinary motor alone, for `twum identify motor`.

use super::compensation::Compensation;
use super::conclude::InertialOutcome;
use crate::answer::{Diagnosis, Verdict};
use crate::finding::{Estimate, Status};

/// A number with its interval.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Number {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Unit; `1` is a share of the largest input, or of another number.
    pub unit: String,
    /// What it belongs to: `motor`, or an effect, with `ambiguous` where another effect could stand in its place.
    pub effect: String,
}

/// An identified motor.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct MotorReport {
    /// Of this shape.
    pub schema: u32,
    /// What `twum diagnose` answers.
    pub verdict: Verdict,
    /// The largest input in the record's unit, to which sizes relate.
    pub largest_input: f64,
    /// Error in rpm (root mean square) on what was not fitted, with gain and lag alone.
    pub line_rmse_rpm: f64,
    /// The same with all that was found.
    pub rmse_rpm: f64,
    /// Noise in rpm.
    pub noise_floor_rpm: f64,
    /// Its numbers, the motor's own first.
    pub parameters: Vec<Number>,
    /// The feed-forward that cancels what was found; none of a motor that reaches one direction only.
    pub compensation: Option<Compensation>,
    /// What else must be said.
    pub notes: Vec<String>,
}

impl MotorReport {
    /// Of runs that are of one motor.
    pub fn of(outcome: &InertialOutcome, diagnosis: &Diagnosis) -> Option<Self> {
        let fitted = outcome.fitted.as_ref()?;
        let number = |e: &Estimate, effect: String| Number {
            name: e.name.clone(),
            value: e.value,
            ci95: e.interval,
            unit: e.unit.clone(),
            effect,
        };
        let mut parameters: Vec<Number> = outcome.own.iter().map(|e| number(e, "motor".to_owned())).collect();
        for finding in outcome.findings.iter().filter(|f| f.status != Status::Rejected) {
            let doubt = if finding.status == Status::Ambiguous { ", ambiguous" } else { "" };
            parameters.extend(finding.parameters.iter().map(|e| number(e, format!("{}{doubt}", finding.name))));
        }
        Some(Self {
            schema: 1,
            verdict: diagnosis.verdict,
            largest_input: outcome.data.largest_input,
            line_rmse_rpm: outcome.held_out.rmse(0),
            rmse_rpm: outcome.held_out.rmse(1),
            noise_floor_rpm: outcome.noise_floor,
            parameters,
            compensation: Compensation::of(fitted, &outcome.data.ripples, outcome.data.largest_input),
            notes: diagnosis.notes.iter().filter(|n| !n.starts_with("the motor itself")).cloned().collect(),
        })
    }
}
