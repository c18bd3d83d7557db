//! What acts beside the input: a place of the angle, a load that was measured, the warmth.

use super::angle::KEPT;
use super::data::DriveRun;
use super::values::{P, Values};

/// A torque and a share of the input's own.
#[derive(Debug, Clone, Copy, Default)]
pub struct Aside {
    /// A torque beside the input, as a share of the largest one.
    pub torque: f64,
    /// By how much the input's torque is larger, relative.
    pub share: f64,
}

impl Aside {
    /// In the interval after sample `k` of a run.
    pub fn at(v: &Values, run: &DriveRun, k: usize) -> Self {
        let angle = run.ripple.get(k).map_or(Self::default(), |wave| Self::of_angle(v, wave));
        let Some([load, warmth]) = run.beside.get(k) else { return angle };
        Self {
            torque: angle.torque - v.get(P::Load) * load,
            share: (1.0 + angle.share) * (1.0 - v.get(P::Heating) * warmth) - 1.0,
        }
    }

    /// Of a place where the courses of the orders are these.
    pub fn of_angle(v: &Values, wave: &[f64; 2 * KEPT]) -> Self {
        let pair = |cos: P, sin: P, j: usize| v.get(cos) * wave[2 * j] + v.get(sin) * wave[2 * j + 1];
        Self {
            torque: pair(P::CoggingCos, P::CoggingSin, 0) + pair(P::Cogging2Cos, P::Cogging2Sin, 1),
            share: pair(P::RippleCos, P::RippleSin, 0),
        }
    }
}
