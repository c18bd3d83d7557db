//! `direction-asymmetry`.

use super::{Coordinate, Effect, Need, one, reported};
use crate::rotor::P;

pub(super) fn effect() -> Effect {
    let speed = one(P::AsymSpeed, 0.1, 0.005, (-0.6, 0.6));
    let friction = one(P::AsymFriction, 0.3, 0.03, (-0.6, 0.6));
    let brake = one(P::AsymBrake, 0.3, 0.03, (-0.9, 0.9));
    let forms = vec![speed.clone(), speed.clone().and(&friction), speed.and(&brake), friction, brake];
    Effect {
        name: "direction-asymmetry".into(),
        says: "the motor is faster in one direction than in the other".into(),
        equation: "speed·(1 ± g), friction·(1 ± f), braking·(1 ± b)".into(),
        coordinate: Coordinate::Direction,
        needs: &[Need::BothDirections],
        forms,
        reported: vec![
            reported("speed_asymmetry", "1", P::AsymSpeed),
            reported("friction_asymmetry", "1", P::AsymFriction),
            reported("braking_asymmetry", "1", P::AsymBrake),
        ],
        conflicts: &["gravity-load"],
        next_experiment: "turn the motor's axis vertical and repeat one duty in both directions: a load's bias goes, an asymmetry stays",
    }
}
