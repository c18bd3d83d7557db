//! `frequency-settling`.

use super::{Coordinate, Effect, LogNormal, one, reported};
use crate::rotor::P;

/// A driver that tracks its resonance finds it within some PWM periods or tenths of a second.
const TIME: LogNormal = LogNormal { median: 0.04, log_sd: 0.8 };

pub(super) fn effect() -> Effect {
    let excess = || one(P::SettleExcess, 0.3, 0.02, (-1.5, 3.0));
    let forms = [0.006, 0.012, 0.025, 0.05, 0.1, 0.2].into_iter().flat_map(|tau| {
        // Counted from the start of the run, or while the drive is on.
        [0.0, 1.0]
            .map(|on_time| excess().shaped(P::SettleTau, tau, TIME, (0.003, 0.4)).pinned(P::SettleOnTime, on_time))
    });
    Effect {
        name: "frequency-settling".into(),
        says: "the drive frequency needs time to find the resonance at each start, so the speed over- or undershoots"
            .into(),
        equation: "speed·(1 + δ·exp(−t/τ)), t from the start of the run, or the time driven since".into(),
        coordinate: Coordinate::Start,
        needs: &[],
        forms: forms.collect(),
        reported: vec![
            reported("relative_excess_at_start", "1", P::SettleExcess),
            reported("settling_time_s", "s", P::SettleTau),
        ],
        conflicts: &["resonance-heating", "start-delay"],
        next_experiment: "runs of 0.2 s at full duty, repeated after pauses of 1 s and 30 s: settling repeats at each start, heating depends on the pause",
    }
}
