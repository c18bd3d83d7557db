//! `clock-error`.

use super::{Coordinate, Effect, Need, one, reported};
use crate::diagnose::rotor::P;

/// Largest error that is looked for: beyond a twentieth a recorder is not wrong but another.
const LARGEST: f64 = 0.05;

pub(super) fn effect() -> Effect {
    // Secants: a drift by a PWM period is far from linear. Steps of a thousandth of the run's periods near zero, wider beyond.
    let mut at: Vec<f64> = (1..=15).map(|k| 8e-4 * f64::from(k)).collect();
    while at.last().is_some_and(|e| *e < LARGEST) {
        at.push(at[at.len() - 1] + 1.2e-3);
    }
    let error = |e: f64| one(P::ClockError, e.abs(), e, (-0.1, 0.1));
    let drift = |d: f64| {
        let mut form = one(P::ClockError, 5e-3, 2e-5, (-0.1, 0.1));
        form.sizes.extend(one(P::ClockDrift, 5e-3, d, (-0.05, 0.05)).sizes);
        form
    };
    Effect {
        name: "clock-error",
        says: "the recorder's clock runs fast or slow: speeds and PWM periods are scaled alike",
        equation: "t_recorded = (1 + ε + d·t/2)·t",
        coordinate: Coordinate::Clock,
        needs: &[Need::PulsedDrive, Need::Edges],
        forms: std::iter::once(one(P::ClockError, 1e-3, 2e-5, (-0.1, 0.1)))
            .chain(at.into_iter().flat_map(|e| [error(e), error(-e)]))
            .chain([drift(2e-5)])
            .collect(),
        reported: vec![
            reported("relative_clock_error", "1", P::ClockError),
            reported("clock_drift_per_s", "1/s", P::ClockDrift),
        ],
        conflicts: &["dropped-samples"],
        next_experiment: "record a reference signal of known frequency on the encoder input",
    }
}
