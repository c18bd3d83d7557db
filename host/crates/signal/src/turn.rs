//! How a speed varies with the angle of the rotor, and how it drifts.

use super::SignalError;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Orders (periods a turn) fitted.
pub const ORDERS: usize = 4;
/// Turns below which drift and the first order cannot be told apart.
pub const LEAST_TURNS: f64 = 1.0;

/// A speed as `mean + drift · time + Σ amplitude_k · cos(k · angle − phase_k)`.
#[derive(Debug, Clone, PartialEq)]
pub struct TurnFit {
    /// Speed in the middle of the fitted stretch without the variation over angle, in rpm.
    pub mean_rpm: f64,
    /// Change of the speed with time, in rpm/s.
    pub drift_rpm_per_s: f64,
    /// Amplitude of orders 1 to [`ORDERS`], in rpm.
    pub amplitude_rpm: [f64; ORDERS],
    /// Angle at which each order is greatest, times the order, in rad.
    pub phase_rad: [f64; ORDERS],
    /// Share of the variance explained.
    pub r2: f64,
    /// Turns fitted over.
    pub turns: f64,
    /// Middle of the fitted stretch, in s.
    pub middle_s: f64,
}

impl TurnFit {
    /// Fits by least squares.
    ///
    /// # Errors
    /// [`SignalError::TooFewTurns`] below [`LEAST_TURNS`].
    pub fn new(time_s: &[f64], position_rad: &[f64], speed_rpm: &[f64]) -> Result<Self, SignalError> {
        let turned = |p: &[f64]| {
            let (low, high) = p.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
            ((high - low) / TAU).max(0.0)
        };
        let turns = turned(position_rad);
        if turns < LEAST_TURNS {
            return Err(SignalError::TooFewTurns { turns });
        }
        let middle_s = 0.5 * (time_s[0] + time_s[time_s.len() - 1]);
        let columns = 2 + 2 * ORDERS;
        let mut normal = DMatrix::zeros(columns, columns);
        let mut right = DVector::zeros(columns);
        let mut row = DVector::zeros(columns);
        for ((t, angle), speed) in time_s.iter().zip(position_rad).zip(speed_rpm) {
            (row[0], row[1]) = (1.0, t - middle_s);
            for k in 1..=ORDERS {
                (row[2 * k + 1], row[2 * k]) = (k as f64 * angle).sin_cos();
            }
            normal.ger(1.0, &row, &row, 1.0);
            right.axpy(*speed, &row, 1.0);
        }
        // A rotor that moves over a turn leaves the columns independent; rounding is the only danger left.
        let c = normal.cholesky().ok_or(SignalError::TooFewTurns { turns })?.solve(&right);
        let mut fit = Self {
            mean_rpm: c[0],
            drift_rpm_per_s: c[1],
            amplitude_rpm: std::array::from_fn(|i| c[2 * i + 2].hypot(c[2 * i + 3])),
            phase_rad: std::array::from_fn(|i| c[2 * i + 3].atan2(c[2 * i + 2])),
            r2: 0.0,
            turns,
            middle_s,
        };
        let n = speed_rpm.len() as f64;
        let mean = speed_rpm.iter().sum::<f64>() / n;
        let all: f64 = speed_rpm.iter().map(|v| (v - mean).powi(2)).sum();
        let left: f64 = time_s
            .iter()
            .zip(position_rad)
            .zip(speed_rpm)
            .map(|((t, angle), v)| (v - fit.at(*t, *angle)).powi(2))
            .sum();
        fit.r2 = if all > 0.0 { 1.0 - left / all } else { 0.0 };
        Ok(fit)
    }

    /// The fitted speed at a time and an angle, in rpm.
    pub fn at(&self, time_s: f64, position_rad: f64) -> f64 {
        let ripple = |i: usize| self.amplitude_rpm[i] * ((i + 1) as f64 * position_rad - self.phase_rad[i]).cos();
        self.mean_rpm + self.drift_rpm_per_s * (time_s - self.middle_s) + (0..ORDERS).map(ripple).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_put_in_comes_out() {
        let time_s: Vec<f64> = (0..3000).map(|i| f64::from(i) * 1e-3).collect();
        let position: Vec<f64> = time_s.iter().map(|t| 4.0 * t + 0.1 * (3.0 * t).sin()).collect();
        let speed: Vec<f64> = time_s
            .iter()
            .zip(&position)
            .map(|(t, a)| 35.0 - 0.8 * (t - 1.4995) + 5.0 * (2.0 * a - 0.7).cos() + 0.5 * (a + 0.2).cos())
            .collect();
        let fit = TurnFit::new(&time_s, &position, &speed).unwrap();
        assert!((fit.mean_rpm - 35.0).abs() < 1e-9);
        assert!((fit.drift_rpm_per_s + 0.8).abs() < 1e-9);
        assert!((fit.amplitude_rpm[1] - 5.0).abs() < 1e-9 && (fit.phase_rad[1] - 0.7).abs() < 1e-9);
        assert!((fit.amplitude_rpm[0] - 0.5).abs() < 1e-9 && fit.amplitude_rpm[3] < 1e-9);
        assert!((fit.r2 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn less_than_a_turn_is_refused() {
        assert!(matches!(TurnFit::new(&[0.0, 1.0], &[0.0, 1.0], &[1.0, 1.0]), Err(SignalError::TooFewTurns { .. })));
        assert!(matches!(TurnFit::new(&[], &[], &[]), Err(SignalError::TooFewTurns { .. })));
    }
}
