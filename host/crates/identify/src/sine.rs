//! Sine fits to sampled voltages: at a known frequency (linear), and with the frequency free (IEEE 1057).

use nalgebra::{Complex, Matrix3, Matrix4, Vector3, Vector4};
use std::f64::consts::TAU;

/// y(t) = offset + |phasor|·sin(2πft + arg phasor).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sine {
    /// Mean (V).
    pub offset: f64,
    /// Amplitude and phase: the phase is the sine's at t = 0.
    pub phasor: Complex<f64>,
    /// Frequency (Hz).
    pub frequency_hz: f64,
    /// Variance of each component of the phasor (V²), from the fit's residual.
    pub variance: f64,
    /// Root mean square of the residual (V).
    pub residual: f64,
}

/// Sine, cosine and constant of a known frequency at given times, ready to be fitted to any channel sampled at them.
pub struct Basis {
    frequency_hz: f64,
    rows: Vec<Vector3<f64>>,
    inverse: Matrix3<f64>,
}

impl Basis {
    /// `None` when the times cannot determine a sine of this frequency: fewer than four, or too little of a period.
    pub fn new(frequency_hz: f64, time_s: &[f64]) -> Option<Self> {
        if time_s.len() < 4 {
            return None;
        }
        let rows: Vec<Vector3<f64>> = time_s
            .iter()
            .map(|t| {
                let (s, c) = (TAU * frequency_hz * t).sin_cos();
                Vector3::new(s, c, 1.0)
            })
            .collect();
        let normal: Matrix3<f64> = rows.iter().map(|x| x * x.transpose()).sum();
        // A record much shorter than a period cannot tell the sine from its offset.
        if normal.symmetric_eigenvalues().min() < 1e-4 * rows.len() as f64 {
            return None;
        }
        Some(Self { frequency_hz, inverse: normal.try_inverse()?, rows })
    }

    fn solve(&self, volt: impl Iterator<Item = f64>) -> Vector3<f64> {
        self.inverse * self.rows.iter().zip(volt).map(|(x, y)| x * y).sum::<Vector3<f64>>()
    }

    fn sine(&self, beta: Vector3<f64>, rss: f64) -> Sine {
        let n = self.rows.len() as f64;
        Sine {
            offset: beta[2],
            phasor: Complex::new(beta[0], beta[1]),
            frequency_hz: self.frequency_hz,
            variance: rss / (n - 3.0) * (self.inverse[(0, 0)] + self.inverse[(1, 1)]) / 2.0,
            residual: (rss / n).sqrt(),
        }
    }

    /// The least-squares sine. `None` when there is not one value a time.
    pub fn fit(&self, volt: &[f64]) -> Option<Sine> {
        if volt.len() != self.rows.len() {
            return None;
        }
        let beta = self.solve(volt.iter().copied());
        let rss = self.rows.iter().zip(volt).map(|(x, y)| (y - x.dot(&beta)).powi(2)).sum();
        Some(self.sine(beta, rss))
    }

    /// The least-squares sine of values rounded to `grid`, without the rounding's bias.
    ///
    /// Rounding a sine with little noise on it changes its amplitude by up to a hundredth of a step, the same at every
    /// frequency, which no number of samples averages out. The mean error of rounding v + Gaussian noise is
    /// (δ/π)·Σ(−1)ⁿ/n·sin(2πnv/δ)·exp(−2π²n²σ²/δ²) (Widrow and Kollár, Quantization Noise, 2008); it is subtracted at
    /// the fitted sine, and the fit repeated. σ² is the residual's variance less δ²/12.
    pub fn fit_rounded(&self, volt: &[f64], grid: Grid) -> Option<Sine> {
        let plain = self.fit(volt)?;
        let mut beta = Vector3::new(plain.phasor.re, plain.phasor.im, plain.offset);
        let mut corrected = volt.to_vec();
        for _ in 0..4 {
            let error: f64 = self.rows.iter().zip(volt).map(|(x, y)| (y - x.dot(&beta)).powi(2)).sum();
            let spread = (error / volt.len() as f64 / (grid.step * grid.step) - 1.0 / 12.0).max(0.01).sqrt();
            // Terms below a thousandth of the step do not matter.
            let weights: Vec<f64> = (1..=6)
                .map(|n| {
                    let n = f64::from(n);
                    (-2.0 * (std::f64::consts::PI * n * spread).powi(2)).exp() / (n * std::f64::consts::PI)
                })
                .take_while(|w| *w > 1e-3)
                .collect();
            for ((x, y), c) in self.rows.iter().zip(volt).zip(&mut corrected) {
                // (−1)ⁿ·sin(nφ) = sin(n(φ + π)), by the recurrence of Chebyshev.
                let (mut now, cos) = (TAU * ((x.dot(&beta) - grid.origin) / grid.step + 0.5)).sin_cos();
                let mut before = 0.0;
                let mut mean = 0.0;
                for w in &weights {
                    mean += w * now;
                    (before, now) = (now, 2.0 * cos * now - before);
                }
                *c = y - grid.step * mean;
            }
            let before = beta;
            beta = self.solve(corrected.iter().copied());
            // The bias to remove is a hundredth of a step.
            if (beta - before).amax() < 1e-5 * grid.step {
                break;
            }
        }
        let rss = self.rows.iter().zip(&corrected).map(|(x, y)| (y - x.dot(&beta)).powi(2)).sum();
        Some(self.sine(beta, rss))
    }
}

/// The values a converter can give: origin + k·step (V).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Distance of neighbouring values.
    pub step: f64,
    /// One of them.
    pub origin: f64,
}

impl Grid {
    /// The grid that values lie on; `None` when they lie on none that is coarse enough to matter.
    pub fn of(volt: &[f64]) -> Option<Self> {
        let mut distinct = volt.to_vec();
        distinct.sort_unstable_by(f64::total_cmp);
        let origin = *distinct.first()?;
        let span = distinct.last()? - origin;
        let step = distinct.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > span * 1e-6).fold(f64::INFINITY, f64::min);
        let levels = span / step;
        // Over the whole span, the finest step must divide every value: refine it by the widest multiple.
        if !(levels.is_finite() && (2.0..4096.0).contains(&levels.round())) {
            return None;
        }
        let step = span / levels.round();
        distinct
            .iter()
            .all(|v| ((v - origin) / step - ((v - origin) / step).round()).abs() < 0.02)
            .then_some(Self { step, origin })
    }
}

/// The least-squares sine of a known frequency. `None` when the samples cannot determine it.
pub fn fit_at(frequency_hz: f64, time_s: &[f64], volt: &[f64]) -> Option<Sine> {
    Basis::new(frequency_hz, time_s)?.fit(volt)
}

/// The least-squares sine with a free frequency, started at `frequency_hz`: the thesis's fit of each channel by itself.
pub fn fit_free(frequency_hz: f64, time_s: &[f64], volt: &[f64]) -> Option<Sine> {
    let first = fit_at(frequency_hz, time_s, volt)?;
    let (mut f, mut phasor) = (frequency_hz, first.phasor);
    for _ in 0..20 {
        let mut normal = Matrix4::zeros();
        let mut right = Vector4::zeros();
        for (&t, &y) in time_s.iter().zip(volt) {
            let (s, c) = (TAU * f * t).sin_cos();
            let x = Vector4::new(s, c, 1.0, TAU * t * (phasor.re * c - phasor.im * s));
            normal += x * x.transpose();
            right += x * y;
        }
        let next = normal.try_inverse()? * right;
        let step = next[3];
        // A step beyond a tenth of the frequency has left the neighbourhood where the linearisation holds.
        if !step.is_finite() || step.abs() > 0.1 * f {
            return Some(first);
        }
        f += step;
        phasor = Complex::new(next[0], next[1]);
        if step.abs() < 1e-9 * f {
            break;
        }
    }
    fit_at(f, time_s, volt)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(f: f64) -> (Vec<f64>, Vec<f64>) {
        let t: Vec<f64> = (0..600).map(|i| -30e-6 + i as f64 * 1e-7).collect();
        let y = t.iter().map(|t| 0.2 + 2.5 * (TAU * f * t + 0.7).sin()).collect();
        (t, y)
    }

    #[test]
    fn a_sine_comes_back() {
        let (t, y) = record(44_100.0);
        let fit = fit_at(44_100.0, &t, &y).unwrap();
        assert!((fit.phasor.norm() - 2.5).abs() < 1e-9 && (fit.phasor.arg() - 0.7).abs() < 1e-9);
        assert!((fit.offset - 0.2).abs() < 1e-9);
    }

    #[test]
    fn a_wrong_frequency_is_corrected_when_free() {
        let (t, y) = record(44_100.0);
        let fit = fit_free(43_900.0, &t, &y).unwrap();
        assert!((fit.frequency_hz - 44_100.0).abs() < 1e-3, "{}", fit.frequency_hz);
    }

    #[test]
    fn rounding_does_not_change_the_amplitude() {
        // An amplitude where the bias of plain least squares is near its greatest, and noise of a quarter step.
        let step = 0.04;
        let mut state = 1u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let t: Vec<f64> = (0..600_000).map(|i| i as f64 * 1.03713e-7).collect();
        let y: Vec<f64> = t
            .iter()
            .map(|t| {
                let noise = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                ((3.015 * (TAU * 44_100.0 * t + 0.7).sin() + 0.25 * step * noise) / step).round() * step
            })
            .collect();
        let grid = Grid::of(&y).unwrap();
        assert!((grid.step / step - 1.0).abs() < 1e-9);
        let basis = Basis::new(44_100.0, &t).unwrap();
        let (plain, better) = (basis.fit(&y).unwrap(), basis.fit_rounded(&y, grid).unwrap());
        let off = |s: Sine| (s.phasor.norm() - 3.015).abs();
        assert!(off(plain) > 2e-4 && off(better) < 8e-5, "{} {}", off(plain), off(better));
    }

    #[test]
    fn smooth_values_lie_on_no_grid() {
        let (_, y) = record(44_100.0);
        assert!(Grid::of(&y).is_none());
    }

    #[test]
    fn a_sliver_of_a_period_is_refused() {
        let (t, y) = record(100.0);
        assert!(fit_at(100.0, &t, &y).is_none());
    }
}
