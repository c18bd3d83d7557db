//! What only closed loops show: `gravity-load`, `backlash`, `reversal-miscount`.

use super::{Coordinate, Effect, Need, Phased, one, phased, reported};
use crate::diagnose::rotor::P;

pub(super) fn gravity_load() -> Effect {
    Effect {
        name: "gravity-load",
        says: "a weight off the axis pulls with the sine of the angle",
        equation: "load torque m·g·l·sin(θ + φ)",
        coordinate: Coordinate::Angle,
        needs: &[Need::ClosedLoop],
        forms: vec![phased(vec![Phased::Gravity])],
        reported: Vec::new(),
        conflicts: &["preload-runout"],
        next_experiment: "turn the motor's axis vertical and repeat the run: gravity's torque goes",
    }
}

pub(super) fn backlash() -> Effect {
    Effect {
        name: "backlash",
        says: "motion is lost at each reversal before the encoder follows",
        equation: "a gap g between motor and encoder",
        coordinate: Coordinate::Reversal,
        needs: &[Need::ClosedLoop],
        forms: vec![one(P::Backlash, 0.02, 1e-3, (0.0, 0.3))],
        reported: vec![reported("gap_rad", "rad", P::Backlash)],
        conflicts: &["reversal-miscount", "presliding"],
        next_experiment: "reverse by hand-sized steps of 10°: a gap returns, a miscount accumulates",
    }
}

pub(super) fn reversal_miscount() -> Effect {
    Effect {
        name: "reversal-miscount",
        says: "the counter gains or loses counts at each reversal",
        equation: "count + n at each reversal, in the new sense or always in the same",
        coordinate: Coordinate::Reversal,
        needs: &[Need::ClosedLoop],
        forms: vec![one(P::Miscount, 1.0, 0.1, (-5.0, 5.0)), one(P::MiscountDrift, 1.0, 0.1, (-5.0, 5.0))],
        reported: vec![
            reported("counts_per_reversal", "1", P::Miscount),
            reported("counts_gained_per_reversal", "1", P::MiscountDrift),
        ],
        conflicts: &["backlash"],
        next_experiment: "track the same sine for ten periods and return to the mark: a miscount's error grows with each reversal",
    }
}
