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

/// The least-squares sine of a known frequency. `None` when the samples cannot determine it (fewer than four, or they
/// span too little of a period).
pub fn fit_at(frequency_hz: f64, time_s: &[f64], volt: &[f64]) -> Option<Sine> {
    if time_s.len() != volt.len() || time_s.len() < 4 {
        return None;
    }
    let row = |t: f64| {
        let (s, c) = (TAU * frequency_hz * t).sin_cos();
        Vector3::new(s, c, 1.0)
    };
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for (&t, &y) in time_s.iter().zip(volt) {
        let x = row(t);
        normal += x * x.transpose();
        right += x * y;
    }
    let n = time_s.len() as f64;
    // A record much shorter than a period cannot tell the sine from its offset.
    if normal.symmetric_eigenvalues().min() < 1e-4 * n {
        return None;
    }
    let inverse = normal.try_inverse()?;
    let beta = inverse * right;
    let rss: f64 = time_s.iter().zip(volt).map(|(&t, &y)| (y - row(t).dot(&beta)).powi(2)).sum();
    let s2 = rss / (n - 3.0);
    Some(Sine {
        offset: beta[2],
        phasor: Complex::new(beta[0], beta[1]),
        frequency_hz,
        variance: s2 * (inverse[(0, 0)] + inverse[(1, 1)]) / 2.0,
        residual: (rss / n).sqrt(),
    })
}

/// The least-squares sine with a free frequency, started at `frequency_hz`: the thesis's fit of each channel by itself.
pub fn fit_free(frequency_hz: f64, time_s: &[f64], volt: &[f64]) -> Option<Sine> {
    let mut best = fit_at(frequency_hz, time_s, volt)?;
    let mut f = frequency_hz;
    for _ in 0..20 {
        let (a, b) = (best.phasor.re, best.phasor.im);
        let mut normal = Matrix4::zeros();
        let mut right = Vector4::zeros();
        for (&t, &y) in time_s.iter().zip(volt) {
            let (s, c) = (TAU * f * t).sin_cos();
            let x = Vector4::new(s, c, 1.0, TAU * t * (a * c - b * s));
            normal += x * x.transpose();
            right += x * y;
        }
        let step = (normal.try_inverse()? * right)[3];
        // A step beyond a tenth of the frequency has left the neighbourhood where the linearisation holds.
        if !step.is_finite() || step.abs() > 0.1 * f {
            return Some(best);
        }
        f += step;
        best = fit_at(f, time_s, volt)?;
        if step.abs() < 1e-9 * f {
            break;
        }
    }
    Some(best)
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
    fn a_sliver_of_a_period_is_refused() {
        let (t, y) = record(100.0);
        assert!(fit_at(100.0, &t, &y).is_none());
    }
}
