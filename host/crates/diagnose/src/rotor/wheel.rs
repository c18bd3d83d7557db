//! An encoder's wheel that is off its centre.

use super::parameters::{HARMONICS, harmonics};
use std::f64::consts::TAU;

/// By how much a wheel reads too far, over the angle that is read: tabulated, for thousands of edges ask it of one wheel.
pub struct Wheel([f64; POINTS]);

/// Points of a turn between which the error is a cubic: with four harmonics of a twentieth of a radian it is off by 2·10⁻⁶ rad, a thousandth of a pitch of
/// 4096 edges.
const POINTS: usize = 128;
/// 0.3⁸ of an error that is itself a third of a radian at most: 2·10⁻⁵ rad.
const FIXED_POINT_ROUNDS: usize = 8;

impl Wheel {
    /// A wheel whose error has these cosines and sines of its own angle and of its multiples, in rad.
    pub fn new(eccentricity: &[f64; 2 * HARMONICS]) -> Self {
        // It errs by its own angle, which is the measured one less the error: each round leaves an error smaller by the relative error of the speed, a
        // third at most.
        let error =
            |measured: f64| (0..FIXED_POINT_ROUNDS).fold(0.0, |error, _| harmonics(eccentricity, measured - error));
        Self(std::array::from_fn(|k| error(k as f64 * TAU / POINTS as f64)))
    }

    /// Angle in rad that the encoder reads too far where it reads `measured`.
    pub fn error(&self, measured: f64) -> f64 {
        let x = measured * (POINTS as f64 / TAU);
        let x = x - POINTS as f64 * (x / POINTS as f64).floor();
        let k = x as usize;
        let [before, from, to, after] = [POINTS - 1, 0, 1, 2].map(|j| self.0[(k + j) % POINTS]);
        let t = x - k as f64;
        let [minus, left, right, plus] = [t + 1.0, t, t - 1.0, t - 2.0];
        // Lagrange's cubic through the four points around.
        (left * right * (minus * after - plus * before) / 3.0 + minus * plus * (right * from - left * to)) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if the wheel's error is taken at the measured angle, where a centred circle off its axis has harmonics that it has not, if the turn does not
    /// close, or if the cubic between the points is another one.
    #[test]
    fn a_wheel_errs_by_its_own_angle() {
        let own = |theta: f64| 0.2 * theta.sin() + 0.02 * (4.0 * theta).cos();
        let mut eccentricity = [0.0; 2 * HARMONICS];
        (eccentricity[1], eccentricity[6]) = (0.2, 0.02);
        let wheel = Wheel::new(&eccentricity);
        for theta in (-400..400).map(|k| 0.05 * f64::from(k)) {
            let off = wheel.error(theta + own(theta)) - own(theta);
            assert!(off.abs() < 1e-5, "{theta}: {off}");
        }
    }
}
