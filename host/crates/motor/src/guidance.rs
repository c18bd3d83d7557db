//! How honest the load is that a controller believes, against the hand that pushed.

use super::closed_loop::{Hand, Tick};
use serde::Serialize;

/// What a controller with a target that gives way believed, from when on the hand was there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Guidance {
    /// Share of the ticks in which the load was believed (1).
    pub believed: f64,
    /// Mean amount by which it was off the hand then (N·m).
    pub mean_abs_error_nm: f64,
    /// Mean by which it was off then, clockwise (N·m).
    pub mean_error_nm: f64,
    /// Mean amount of the hand's torque (N·m): what an estimate of none would be off by.
    pub mean_abs_hand_nm: f64,
    /// Farthest that the target was off its path (counts).
    pub farthest_counts: f64,
}

impl Guidance {
    /// Of a run; none without a tick with the hand there.
    pub fn of(hand: &Hand, trace: &[Tick]) -> Option<Self> {
        let held: Vec<&Tick> = trace.iter().filter(|tick| tick.time_s > hand.from_s).collect();
        let all = held.len() as f64;
        let errors: Vec<f64> = held.iter().filter_map(|tick| Some(tick.load_nm? - hand.at(tick.time_s))).collect();
        let mean = |values: &mut dyn Iterator<Item = f64>, count: f64| values.sum::<f64>() / count.max(1.0);
        (!held.is_empty()).then(|| Self {
            believed: errors.len() as f64 / all,
            mean_abs_error_nm: mean(&mut errors.iter().map(|e| e.abs()), errors.len() as f64),
            mean_error_nm: mean(&mut errors.iter().copied(), errors.len() as f64),
            mean_abs_hand_nm: mean(&mut held.iter().map(|tick| hand.at(tick.time_s).abs()), all),
            farthest_counts: held.iter().map(|tick| tick.deviation.abs()).fold(0.0, f64::max),
        })
    }
}
