//! `high-duty-saturation`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// A bend is the third harmonic of an amplifier's curve, or the knee of one that holds out for long.
const POWER: LogNormal = LogNormal { median: 3.0, log_sd: 0.6 };

pub(super) fn effect() -> Effect {
    Effect {
        name: "high-duty-saturation".into(),
        says: "more duty gives less and less drive: the speed–duty line bends at the top".into(),
        equation: "u → u/(1 + u/us), u/(1 + b·u^p), speed·(1 − s·u^p), or min(u, 1 − f)".into(),
        coordinate: Coordinate::Duty,
        needs: &[Need::ThreeDuties],
        forms: vec![
            one(P::Saturation, 0.5, 0.01, (0.0, 5.0)),
            one(P::Bend, 0.5, 0.01, (0.0, 5.0)).shaped(P::BendPower, 2.0, POWER, (1.0, 12.0)),
            one(P::Bend, 0.5, 0.01, (0.0, 5.0)).shaped(P::BendPower, 6.0, POWER, (1.0, 12.0)),
            one(P::BendLoss, 0.2, 0.01, (0.0, 0.9)).shaped(P::BendPower, 2.0, POWER, (1.0, 12.0)),
            one(P::BendLoss, 0.2, 0.01, (0.0, 0.9)).shaped(P::BendPower, 6.0, POWER, (1.0, 12.0)),
            one(P::FlatTop, 0.1, 0.1, (0.0, 0.6)),
            one(P::FlatTop, 0.2, 0.2, (0.0, 0.6)),
            one(P::FlatTop, 0.35, 0.35, (0.0, 0.6)),
        ],
        reported: vec![
            reported("inverse_saturation_duty", "1", P::Saturation),
            // The key is of the time when the power was two.
            reported("quadratic_bend", "1", P::Bend),
            reported("speed_lost_at_full_duty", "1", P::BendLoss),
            reported("bend_power", "1", P::BendPower),
            reported("flat_top_duty", "1", P::FlatTop),
        ],
        conflicts: &["contact-stiffening", "supply-sag"],
        next_experiment: "edge timestamps (format edges) at duties 0.8 to 1: saturation shortens the drive, a sag slows the rotor within it",
    }
}
