//! `start-delay`.

use super::{Coordinate, Effect, Need, one, reported};
use crate::rotor::P;

pub(super) fn effect() -> Effect {
    Effect {
        name: "start-delay",
        says: "the wave builds up late after each rise of the PWM",
        equation: "drive starts t_d after each PWM rise",
        coordinate: Coordinate::Pulse,
        needs: &[Need::PulsedDrive],
        forms: vec![one(P::StartDelay, 2e-3, 1e-4, (0.0, 0.015))],
        reported: vec![reported("delay_s", "s", P::StartDelay)],
        conflicts: &["dead-zone", "frequency-settling"],
        next_experiment: "repeat two duties at another pwm_hz (e.g. 100 Hz), and one run at duty 1: a delay loses nothing there",
    }
}
