//! `duty-quantisation`.

use super::{Coordinate, Effect, Need, one, reported};
use crate::rotor::P;

pub(super) fn effect() -> Effect {
    // All of the rounding, or none: what is fitted is only how well that share is known.
    let rounded = |n: f64, down: f64| {
        one(P::QuantShare, 1.0, 0.5, (0.85, 1.15)).pinned(P::QuantSteps, n).pinned(P::QuantDown, down)
    };
    let steps = || (3..=26).chain([28, 30, 31, 32, 40, 50, 64]).map(f64::from);
    Effect {
        name: "duty-quantisation".into(),
        says: "the duty is rounded to a coarse grid".into(),
        equation: "u → round(N·u)/N, or floor(N·u)/N".into(),
        coordinate: Coordinate::Duty,
        needs: &[Need::ThreeDuties],
        forms: [0.0, 1.0].into_iter().flat_map(|down| steps().map(move |n| rounded(n, down))).collect(),
        reported: vec![
            reported("rounding_share", "1", P::QuantShare),
            reported("duty_steps", "1", P::QuantSteps),
            reported("rounds_down", "1", P::QuantDown),
        ],
        conflicts: &["dead-zone"],
        next_experiment: "sweep the duty in steps of 0.01 over 0.1: a staircase shows its treads",
    }
}
