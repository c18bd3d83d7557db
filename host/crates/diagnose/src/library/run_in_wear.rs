//! `run-in-wear`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// Contacts run in over some to some hundred revolutions.
const REVOLUTIONS: LogNormal = LogNormal { median: 5.0, log_sd: 1.5 };

pub(super) fn effect() -> Effect {
    // The revolutions that forms begin with lie a decade or so apart: a refit does not get much further.
    let for_ever = [0.5, 10.0, 200.0].map(|r0| (one(P::Wear, 0.05, 0.002, (-0.5, 0.5)), r0));
    // A friction at which nothing turns was not measured; one of a tenth is a contact of another kind.
    let mut run_in = one(P::WearRunIn, 0.1, 0.005, (-0.5, 1.0));
    run_in.sizes.extend(one(P::WearFriction, 0.3, 0.03, (-0.9, 3.0)).sizes);
    Effect {
        name: "run-in-wear".into(),
        says: "the motor changes for good from run to run, with the distance it has turned".into(),
        equation: "speed·(1 + w·log(1 + revs/r₀)), or speed and friction·(1 + w·(1 − exp(−revs/r₀)))".into(),
        coordinate: Coordinate::Order,
        needs: &[Need::Order],
        forms: for_ever
            .into_iter()
            .chain([2.0, 15.0].map(|r0| (run_in.clone(), r0)))
            .map(|(form, r0)| form.shaped(P::WearRevolutions, r0, REVOLUTIONS, (0.03, 1000.0)))
            .collect(),
        reported: vec![
            reported("change_per_log_revolution", "1", P::Wear),
            reported("change_once_run_in", "1", P::WearRunIn),
            reported("friction_change_once_run_in", "1", P::WearFriction),
            reported("run_in_revolutions", "1", P::WearRevolutions),
        ],
        conflicts: &["resonance-heating"],
        next_experiment: "repeat the first run now, after a long pause: wear stays, warmth is gone",
    }
}
