//! `supply-sag`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// A supply gives way within some milliseconds: its capacitance times its resistance. Two deviations is the most: what takes longer is warmth.
const TIME: LogNormal = LogNormal { median: 0.008, log_sd: 1.0 };
/// A supply that is slower than the pulses gives way with the mean current: with the duty, and what friction takes of it besides.
const POWER: LogNormal = LogNormal { median: 1.0, log_sd: 0.5 };

pub(super) fn effect() -> Effect {
    Effect {
        name: "supply-sag".into(),
        says: "the supply gives way under load: more drive power, less speed, at once".into(),
        equation:
            "speed·(1 − r·s), τ·ds/dt = drive − s  (V = V₀ − R·I, with the supply's capacitance), or speed·(1 − r·u^p)"
                .into(),
        coordinate: Coordinate::Pulse,
        needs: &[Need::ThreeDuties],
        forms: [0.0015, 0.003, 0.01, 0.03]
            .map(|tau| one(P::Sag, 0.2, 0.01, (0.0, 0.9)).shaped(P::SagTime, tau, TIME, (1e-3, 0.06)))
            .into_iter()
            .chain([one(P::BendLoss, 0.2, 0.01, (0.0, 0.9)).shaped(P::BendPower, 1.0, POWER, (0.5, 4.0))])
            .collect(),
        reported: vec![
            reported("speed_lost_at_full_duty", "1", P::Sag),
            reported("supply_time_s", "s", P::SagTime),
            reported("speed_lost_at_full_duty", "1", P::BendLoss),
            reported("loss_power", "1", P::BendPower),
        ],
        conflicts: &["resonance-heating", "high-duty-saturation"],
        next_experiment: "repeat duties 0.5 and 1 with the supply's voltage logged, or from a stiffer supply",
    }
}
