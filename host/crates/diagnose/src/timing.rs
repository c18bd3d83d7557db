//! When a pulse takes hold of the rotor and lets it go: no equation of the rotor says it to better than a fraction of a millisecond.

use super::design::Column;
use super::problem::Problem;
use super::rotor::P;

/// How far off the equations are believed to be, in units of the columns: 0.15 ms. Contacts spring back, slip and catch within a pulse in ways
/// that they leave out, and move it by 0.1 to 0.2 ms (generator E's motors without an effect).
pub const TIMING: f64 = 0.15;

/// A millisecond, the unit of the columns, and the step of their derivative (s).
const UNIT_S: f64 = 1e-3;
const STEP_S: f64 = 1e-4;

/// Pulses of duties that differ by more count as of another length.
const DUTY_STEP: f64 = 1.0 / 16.0;

/// Columns of pulses that take hold later, and of pulses that are later as a whole.
pub fn timing() -> [Column; 2] {
    [P::StartDelay, P::Latency].map(|parameter| Column::Scalar {
        parameter,
        scale: UNIT_S,
        step: STEP_S,
        shape: Vec::new(),
    })
}

/// Which runs have pulses alike: what a contact does within one it does in all of that length. Runs without a duty of their own are alike.
pub fn alike(problem: &Problem) -> Vec<usize> {
    let lengths: Vec<Option<i64>> =
        problem.runs.iter().map(|r| r.duty.map(|duty| (duty / DUTY_STEP).round() as i64)).collect();
    let mut kinds = lengths.clone();
    kinds.sort();
    kinds.dedup();
    lengths.iter().map(|length| kinds.binary_search(length).unwrap_or(0)).collect()
}
