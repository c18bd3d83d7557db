//! What acts beside the input: a place of the angle, a load that was measured, the warmth.

use super::angle::{KEPT, WAVES};
use super::data::DriveRun;
use super::values::{P, Values};

/// A torque and a share of the input's own.
#[derive(Debug, Clone, Copy, Default)]
pub struct Aside {
    /// A torque beside the input, as a share of the largest one.
    pub torque: f64,
    /// By how much the input's torque is larger, relative.
    pub share: f64,
    /// What the mean over an interval has more of the torque than a constant that leads to the same speed, and of the share.
    pub way: [f64; 2],
}

impl Aside {
    /// In the interval after sample `k` of a run.
    pub fn at(v: &Values, run: &DriveRun, k: usize) -> Self {
        let angle = run.ripple.get(k).map_or(Self::default(), |wave| Self::of_angle(v, wave));
        let Some([load, warmth]) = run.beside.get(k) else { return angle };
        let kept = 1.0 - v.get(P::Heating) * warmth;
        Self {
            torque: angle.torque - v.get(P::Load) * load,
            share: (1.0 + angle.share) * kept - 1.0,
            way: [angle.way[0], angle.way[1] * kept],
        }
    }

    /// Of a place where the courses of the orders are these.
    pub fn of_angle(v: &Values, wave: &[f64; WAVES]) -> Self {
        let pair = |cos: P, sin: P, j: usize| v.get(cos) * wave[2 * j] + v.get(sin) * wave[2 * j + 1];
        let torque =
            |from: usize| pair(P::CoggingCos, P::CoggingSin, from) + pair(P::Cogging2Cos, P::Cogging2Sin, from + 1);
        let share = |from: usize| pair(P::RippleCos, P::RippleSin, from);
        Self { torque: torque(0), share: share(0), way: [torque(KEPT), share(KEPT)] }
    }
}
