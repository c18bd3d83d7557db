//! `stribeck-friction`.

use super::{Coordinate, Effect, LogNormal, Need, Reported, one, reported};
use crate::rotor::P;

/// Stribeck speeds of dry contacts lie below the working speeds.
const SPEED: LogNormal = LogNormal { median: 0.5, log_sd: 0.7 };
/// Dry contacts hold at rest up to one and three quarters of what they hold when sliding.
const MOST: f64 = 0.75;

pub(super) fn effect() -> Effect {
    let extra = |vs: f64| one(P::Stribeck, 0.4, 0.05, (0.0, MOST)).shaped(P::StribeckSpeed, vs, SPEED, (0.02, 4.0));
    let torque = reported("extra_friction_over_inertia", "rad/s^2", P::Stribeck);
    Effect {
        name: "stribeck-friction".into(),
        says: "the rotor sticks at low speed: friction is larger at rest".into(),
        equation: "friction + Fs·exp(−(ω/vs)²)".into(),
        coordinate: Coordinate::Pulse,
        needs: &[Need::PulsedDrive],
        forms: [0.15, 0.4, 1.0, 2.0].map(extra).into(),
        reported: vec![
            Reported { of: Some(P::OnAcceleration), ..torque },
            reported("stribeck_speed", "rad/s", P::StribeckSpeed),
        ],
        conflicts: &["dead-zone", "start-delay", "contact-stiffening"],
        next_experiment: "runs at the lowest duty that moves, at 25 Hz and 100 Hz PWM, with edge timestamps",
    }
}
