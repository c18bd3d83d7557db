//! `unequal-edges`.

use super::{Coordinate, Effect, Need, one, reported};
use crate::rotor::P;

pub(super) fn effect() -> Effect {
    Effect {
        name: "unequal-edges".into(),
        says: "the encoder's high and low slots are not equally wide".into(),
        equation: "high slots (1 + δ) pitch, low slots (1 − δ) pitch".into(),
        coordinate: Coordinate::Slots,
        needs: &[Need::Levels],
        forms: vec![one(P::EdgeOffset, 0.2, 0.01, (-0.9, 0.9))],
        reported: vec![reported("high_slot_excess", "1", P::EdgeOffset)],
        conflicts: &[],
        next_experiment: "one run at full duty with edge timestamps (format edges)",
    }
}
