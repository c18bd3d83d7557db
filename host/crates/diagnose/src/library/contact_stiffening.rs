//! `contact-stiffening`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// A contact's force goes with its depth, and with the power 1.5 of it where round asperities touch. Half of that or less is no soft contact:
/// the torque is nearly whole at once, as of the motors whose own contact is not that of the model.
const EXPONENT: LogNormal = LogNormal { median: 1.0, log_sd: 0.5 };

pub(super) fn effect() -> Effect {
    // Secants too: a wide band is far from what a narrow one suggests.
    let band = |step: f64| one(P::SlipExtra, 0.5, step, (0.0, 5.0));
    // From a tenth, with 0.93 of the torque at half the band, to four, with 0.06.
    let shaped = |step: f64| band(step).shaped(P::SlipExponent, 1.0, EXPONENT, (0.1, 4.0));
    Effect {
        name: "contact-stiffening".into(),
        says: "the contact takes up the speed difference softly: the rotor approaches the wave's speed slowly".into(),
        equation: "drive torque saturates within a slip band (s₀ + s)·ω_free instead of s₀·ω_free, half of which gives ½ⁿ of it (contact force ∝ δⁿ)"
            .into(),
        coordinate: Coordinate::Pulse,
        // In the short pulses of a closed loop a soft contact moves the rotor as a wave does that grows slowly.
        needs: &[Need::PulsedDrive, Need::OpenLoop],
        forms: vec![band(0.05), band(0.3), band(1.0), shaped(0.05), shaped(0.3), shaped(1.0)],
        reported: vec![
            reported("slip_band_excess", "1", P::SlipExtra),
            reported("slip_exponent", "1", P::SlipExponent),
        ],
        conflicts: &["high-duty-saturation", "stribeck-friction"],
        next_experiment: "edge timestamps (format edges) of starts at full duty: the approach to the final speed shows the band",
    }
}
