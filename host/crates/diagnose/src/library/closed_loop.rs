//! What only closed loops show: `gravity-load`, `backlash`, `reversal-miscount`, `off-phase-braking`.

use super::{Coordinate, Effect, Need, Phased, one, phased, reported};
use crate::rotor::P;

pub(super) fn gravity_load() -> Effect {
    Effect {
        name: "gravity-load".into(),
        says: "a weight off the axis pulls with the sine of the angle".into(),
        equation: "load torque m·g·l·sin(θ + φ)".into(),
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
        name: "backlash".into(),
        says: "motion is lost at each reversal before the encoder follows".into(),
        equation: "a gap g between motor and encoder".into(),
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
        name: "reversal-miscount".into(),
        says: "the counter gains or loses counts at each reversal".into(),
        equation: "count + n at each reversal, in the new sense or always in the same".into(),
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

/// Open-loop runs of a motor that brakes otherwise than the file's are of another motor; the loop's own motor is taken for the file's.
pub(super) fn off_phase_braking() -> Effect {
    // Secants: half of the friction missing hardly shows, a hundredth left does all the more.
    let missing = |share: f64| one(P::OffLoss, share, share, (0.0, 0.9999));
    Effect {
        name: "off-phase-braking".into(),
        says: "the rotor brakes with the wave gone as the motor file does not say".into(),
        equation: "Coulomb torque −Fc_off·sign(ω) while the drive is off".into(),
        coordinate: Coordinate::Pulse,
        needs: &[Need::ClosedLoop],
        forms: [0.7, 0.9, 0.97, 0.99, 0.997].map(missing).into(),
        reported: vec![reported("friction_missing", "1", P::OffLoss)],
        conflicts: &[],
        next_experiment: "open-loop runs at duties of 0.1 to 0.5 with edge timestamps: the coasting after each pulse shows the braking",
    }
}
