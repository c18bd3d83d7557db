//! `dead-zone`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// A gate is some hundredths of the duty wide.
const WIDTH: LogNormal = LogNormal { median: 0.02, log_sd: 0.6 };

pub(super) fn effect() -> Effect {
    let gates = [0.06, 0.1, 0.17, 0.24, 0.33, 0.45]
        .map(|at| one(P::GateDuty, at, at, (0.0, 0.6)).shaped(P::GateWidth, 0.02, WIDTH, (0.003, 0.08)));
    Effect {
        name: "dead-zone".into(),
        says: "part of every commanded duty is lost: below a threshold nothing moves".into(),
        equation: "u → max(u − u₀, 0), or u above a threshold and nothing below".into(),
        coordinate: Coordinate::Duty,
        needs: &[Need::ThreeDuties],
        forms: std::iter::once(one(P::DeadDuty, 0.1, 0.005, (0.0, 0.6))).chain(gates).collect(),
        reported: vec![
            reported("threshold_duty", "1", P::DeadDuty),
            reported("gate_duty", "1", P::GateDuty),
            reported("gate_width", "1", P::GateWidth),
        ],
        conflicts: &["start-delay", "stribeck-friction"],
        next_experiment: "repeat two duties at another pwm_hz (e.g. 100 Hz): a delay loses pwm_hz·t_d of duty, a dead zone the same duty",
    }
}
