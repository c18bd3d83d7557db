//! `clock-error`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// Time in which a drift dies away, as that of a crystal that warms: in a tenth of a second no run shows it, and over ten it is none.
const TAU: LogNormal = LogNormal { median: 2.0, log_sd: 1.2 };

/// `lines` are the relative errors at which the PWM's line stands out.
pub(super) fn effect(lines: &[f64]) -> Effect {
    // A drift by a PWM period is far from linear: from where the line says, both signs of what it may drift besides.
    let error = |e: f64| one(P::ClockError, e.abs().max(1e-3), e, (-0.1, 0.1));
    let drifting = |e: f64| {
        let mut form = error(e);
        form.sizes.extend(one(P::ClockDrift, 5e-3, 2e-5, (-0.05, 0.05)).sizes);
        form
    };
    let warming = |e: f64| drifting(e).shaped(P::ClockTau, TAU.median, TAU, (0.1, 10.0));
    Effect {
        name: "clock-error".into(),
        says: "the recorder's clock runs fast or slow: speeds and PWM periods are scaled alike".into(),
        equation: "t_recorded = (1 + ε + d·t/2)·t, or with d·exp(−t/τ)".into(),
        coordinate: Coordinate::Clock,
        needs: &[Need::PulsedDrive, Need::Edges],
        // How a drift goes on shows where it has moved the line.
        forms: [error(2e-5), drifting(2e-5)]
            .into_iter()
            .chain(lines.iter().flat_map(|e| [error(*e), drifting(*e), warming(*e)]))
            .collect(),
        reported: vec![
            reported("relative_clock_error", "1", P::ClockError),
            reported("clock_drift_per_s", "1/s", P::ClockDrift),
            reported("clock_drift_tau_s", "s", P::ClockTau),
        ],
        conflicts: &["dropped-samples"],
        next_experiment: "record a reference signal of known frequency on the encoder input",
    }
}
