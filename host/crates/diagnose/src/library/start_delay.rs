//! `start-delay`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// Rest after which a wave builds up late: of the order of the pauses between pulses, or there would be no telling.
const REST: LogNormal = LogNormal { median: 0.01, log_sd: 0.7 };

pub(super) fn effect() -> Effect {
    Effect {
        name: "start-delay".into(),
        says: "the wave builds up late after each rise of the PWM".into(),
        equation: "drive starts t_d after each PWM rise, or t_d·(1 − exp(−rest/τ))".into(),
        coordinate: Coordinate::Pulse,
        needs: &[Need::PulsedDrive],
        forms: vec![
            one(P::StartDelay, 2e-3, 1e-4, (0.0, 0.015)),
            one(P::StartDelay, 2e-3, 1e-4, (0.0, 0.015)).shaped(P::DelayRest, 0.01, REST, (1e-3, 0.1)),
        ],
        reported: vec![reported("delay_s", "s", P::StartDelay), reported("rest_s", "s", P::DelayRest)],
        conflicts: &["dead-zone", "frequency-settling"],
        next_experiment: "repeat two duties at another pwm_hz (e.g. 100 Hz), and one run at duty 1: a delay loses nothing there",
    }
}
