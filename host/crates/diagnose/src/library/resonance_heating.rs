//! `resonance-heating`.

use super::{Coordinate, Effect, LogNormal, Need, one, reported};
use crate::rotor::P;

/// Small motors of some tens of grams warm within seconds of continuous drive: a median of 5 s, from 1 to 25 s at two deviations.
const TIME: LogNormal = LogNormal { median: 5.0, log_sd: 0.9 };
/// Of the warmth kept until the next run nothing is known but that some is lost.
const KEPT: LogNormal = LogNormal { median: 0.6, log_sd: 0.7 };

pub(super) fn effect() -> Effect {
    let loss = || one(P::HeatLoss, 0.25, 0.02, (0.0, 0.9));
    let cold = [0.5, 1.0, 2.0, 5.0, 15.0]
        .map(|tau| loss().shaped(P::HeatTau, tau, TIME, (0.3, 60.0)).pinned(P::HeatCarry, 0.0));
    // A contact that warms grips less, or more; one of a tenth is a contact of another kind.
    let friction = [(1.0, 0.4), (5.0, 0.8)].map(|(tau, carry)| {
        one(P::HeatFriction, 0.3, 0.03, (-0.9, 1.0)).shaped(P::HeatTau, tau, TIME, (0.3, 60.0)).shaped(
            P::HeatCarry,
            carry,
            KEPT,
            (0.05, 0.97),
        )
    });
    let carried = [0.5, 2.0, 5.0, 15.0].into_iter().flat_map(|tau| {
        [0.4, 0.8].map(|carry| {
            loss().shaped(P::HeatTau, tau, TIME, (0.3, 60.0)).shaped(P::HeatCarry, carry, KEPT, (0.05, 0.97))
        })
    });
    Effect {
        name: "resonance-heating".into(),
        says: "the motor changes as it warms up: its resonance drifts away from the drive frequency, or its contact grips otherwise".into(),
        equation: "dT/dt = (u − T)/τ, speed·(1 − h·T), or friction·(1 + f·T)".into(),
        coordinate: Coordinate::Start,
        needs: &[Need::LongRun],
        forms: cold.into_iter().chain(carried).chain(friction).collect(),
        reported: vec![
            reported("speed_loss_warm", "1", P::HeatLoss),
            reported("friction_change_warm", "1", P::HeatFriction),
            reported("thermal_time_s", "s", P::HeatTau),
            reported("warmth_kept_between_runs", "1", P::HeatCarry),
        ],
        conflicts: &["run-in-wear", "supply-sag"],
        next_experiment: "repeat the first run after a pause of ten thermal time constants: warmth recovers, wear does not",
    }
}
