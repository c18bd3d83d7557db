//! `contact-stiffening`.

use super::{Coordinate, Effect, Need, one, reported};
use crate::rotor::P;

pub(super) fn effect() -> Effect {
    // Secants too: a wide band is far from what a narrow one suggests.
    let band = |step: f64| one(P::SlipExtra, 0.5, step, (0.0, 5.0));
    // n is 1.5 of round asperities; from a tenth, with 0.93 of the torque at half the band, to four, with 0.06.
    let power = one(P::SlipPower, 1.0, 0.5, (-0.9, 3.0));
    let both = |step: f64| band(step).and(&power);
    Effect {
        name: "contact-stiffening".into(),
        says: "the contact takes up the speed difference softly: the rotor approaches the wave's speed slowly".into(),
        equation: "drive torque saturates within a slip band (s₀ + s)·ω_free instead of s₀·ω_free, half of which gives ½ⁿ of it (contact force ∝ δⁿ)"
            .into(),
        coordinate: Coordinate::Pulse,
        // In the short pulses of a closed loop a soft contact moves the rotor as a wave does that grows slowly.
        needs: &[Need::PulsedDrive, Need::OpenLoop],
        forms: vec![band(0.05), band(0.3), band(1.0), both(0.05), both(0.3), both(1.0)],
        reported: vec![
            reported("slip_band_excess", "1", P::SlipExtra),
            reported("slip_exponent_excess", "1", P::SlipPower),
        ],
        conflicts: &["high-duty-saturation", "stribeck-friction"],
        next_experiment: "edge timestamps (format edges) of starts at full duty: the approach to the final speed shows the band",
    }
}
