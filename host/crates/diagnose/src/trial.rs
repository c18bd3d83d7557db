//! Runs to try things on, simple enough that what is in them is known by heart.

use super::observe::{Observed, observe};
use rand::{RngExt, SeedableRng};
use std::f64::consts::TAU;
use twum_record::measurement::{Direction, LevelEdge, Run, RunData, RunKind};

/// Eight runs of 2.5 s under full drive, either way in turn, of a motor of 5 rad/s whose speed is off by what `off` says of a run,
/// its direction, the time and the angle; edges come late by up to a tenth of a millisecond.
pub fn runs(off: &dyn Fn(usize, f64, f64, f64) -> f64) -> Vec<Observed> {
    let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let run = |k: usize| {
        let (direction, sign) = if k.is_multiple_of(2) { (Direction::Cw, 1.0) } else { (Direction::Ccw, -1.0) };
        let (pitch, dt) = (TAU / 400.0, 2e-5);
        let (mut angle, mut edges) = (0.0_f64, Vec::new());
        for step in 0..125_000 {
            let t = f64::from(step) * dt;
            let before = angle;
            angle += 5.0 * (1.0 + off(k, sign, t, sign * angle)) * dt;
            if (angle / pitch).floor() > (before / pitch).floor() {
                let time_us = (1e6 * (t + dice.random_range(0.0..1e-4))).round();
                edges.push(LevelEdge { time_us, level: edges.len() % 2 == 0 });
            }
        }
        let data = RunData::Edges { initial: false, start_us: 0.0, edges, end_us: 2.5e6 };
        let mut run = Run::new(format!("r{k}"), RunKind::Speed, data);
        // Duties that differ, though not in what they do: over one alone a direction is not told from the direction at a duty.
        let duty = 1.0 - 1e-4 * (k / 2) as f64;
        (run.duty, run.direction, run.drive_on_s) = (Some(duty), Some(direction), Some(2.5));
        run.order = Some(k as u32);
        observe(&run, 400).expect("it shows motion")
    };
    (0..8).map(run).collect()
}
