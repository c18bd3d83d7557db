//! `run-in-wear`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// Contacts run in over some to some hundred revolutions.
const REVOLUTIONS: LogNormal = LogNormal { median: 5.0, log_sd: 1.5 };

pub(super) fn effect() -> Effect {
    Effect {
        name: "run-in-wear".into(),
        says: "the motor changes for good from run to run, with the distance it has turned".into(),
        equation: "speed·(1 + w·log(1 + revs/r₀))".into(),
        coordinate: Coordinate::Order,
        needs: &[Need::Order],
        forms: [0.3, 3.0, 30.0, 300.0]
            .map(|r0| {
                one(P::Wear, 0.05, 0.002, (-0.5, 0.5)).shaped(P::WearRevolutions, r0, REVOLUTIONS, (0.03, 1000.0))
            })
            .into(),
        reported: vec![
            reported("change_per_log_revolution", "1", P::Wear),
            reported("run_in_revolutions", "1", P::WearRevolutions),
        ],
        conflicts: &["resonance-heating"],
        next_experiment: "repeat the first run now, after a long pause: wear stays, warmth is gone",
    }
}
