//! The filters of section A.7 of the thesis, each with the rule it follows at the ends of the record.

use super::SignalError;

/// A low-pass filter of second order, `H(z) = (b0 + b1 z⁻¹ + b2 z⁻²) / (1 + a1 z⁻¹ + a2 z⁻²)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Butterworth {
    /// Numerator `b0, b1, b2`.
    pub b: [f64; 3],
    /// Denominator `a1, a2`; `a0` is 1.
    pub a: [f64; 2],
}

impl Butterworth {
    /// The Butterworth low-pass with its corner at `cutoff_hz`, by the bilinear transform with the corner prewarped, as
    /// MATLAB's and SciPy's `butter(2, cutoff / (rate / 2))`.
    ///
    /// # Errors
    /// [`SignalError::Cutoff`] unless `0 < cutoff_hz < sample_rate_hz / 2`.
    pub fn low_pass(cutoff_hz: f64, sample_rate_hz: f64) -> Result<Self, SignalError> {
        if !(cutoff_hz > 0.0 && cutoff_hz < sample_rate_hz / 2.0) {
            return Err(SignalError::Cutoff { cutoff_hz, sample_rate_hz });
        }
        let k = (std::f64::consts::PI * cutoff_hz / sample_rate_hz).tan();
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * k + k * k);
        let b0 = k * k * scale;
        Ok(Self {
            b: [b0, 2.0 * b0, b0],
            a: [2.0 * (k * k - 1.0) * scale, (1.0 - std::f64::consts::SQRT_2 * k + k * k) * scale],
        })
    }

    /// Filters forwards, then backwards, so that nothing is delayed and the attenuation is squared.
    ///
    /// At the ends the record is continued by its first (last) 6 samples turned about the end point,
    /// `2 x[0] - x[6..1]`, and each pass starts in the steady state of its first sample. This is MATLAB's `filtfilt`,
    /// which pads by `3 (max(length(a), length(b)) - 1)`; SciPy's pads by 9 unless told `padlen=6`.
    ///
    /// # Errors
    /// [`SignalError::TooShort`] below 7 samples, as MATLAB.
    pub fn forwards_and_backwards(&self, x: &[f64]) -> Result<Vec<f64>, SignalError> {
        const PAD: usize = 6;
        let n = x.len();
        if n <= PAD {
            return Err(SignalError::TooShort { samples: n, needed: PAD + 1, stage: "Butterworth filter" });
        }
        let before = (1..=PAD).rev().map(|i| 2.0 * x[0] - x[i]);
        let after = (1..=PAD).map(|i| 2.0 * x[n - 1] - x[n - 1 - i]);
        let mut y = Vec::with_capacity(n + 2 * PAD);
        y.extend(before);
        y.extend_from_slice(x);
        y.extend(after);
        self.run(y[0], y.iter_mut());
        self.run(y[n + 2 * PAD - 1], y.iter_mut().rev());
        y.truncate(PAD + n);
        y.drain(..PAD);
        Ok(y)
    }

    /// Filters in place, from the steady state of the first sample.
    fn run<'a>(&self, first: f64, x: impl Iterator<Item = &'a mut f64>) {
        let ([b0, b1, b2], [a1, a2]) = (self.b, self.a);
        let gain = (b0 + b1 + b2) / (1.0 + a1 + a2);
        let mut z2 = (b2 - a2 * gain) * first;
        let mut z1 = (b1 - a1 * gain) * first + z2;
        for v in x {
            let y = b0 * *v + z1;
            z1 = b1 * *v - a1 * y + z2;
            z2 = b2 * *v - a2 * y;
            *v = y;
        }
    }
}

/// The mean over `window` samples about each one; towards an end the window shrinks so that it stays symmetric, as
/// MATLAB's `smooth(x, window)`. An even window counts as the odd one below it.
pub fn moving_average(x: &[f64], window: usize) -> Vec<f64> {
    let n = x.len();
    let half_window = window.saturating_sub(1) / 2;
    let (mut sum, mut from, mut to) = (0.0, 0, 0);
    (0..n)
        .map(|i| {
            let half = half_window.min(i).min(n - 1 - i);
            while to < i + half + 1 {
                sum += x[to];
                to += 1;
            }
            while from < i - half {
                sum -= x[from];
                from += 1;
            }
            sum / (2 * half + 1) as f64
        })
        .collect()
}

/// Samples worked on side by side, so that the compiler can use vector instructions.
pub(super) const LANES: usize = 8;

/// The median over `window` samples (odd) about each one, with zeros beyond the ends: MATLAB's `medfilt1`, SciPy's
/// `medfilt`. The samples are finite.
///
/// The median of 2h + 1 values is never the least nor the greatest of any h + 2 of them: both are thrown away, the next
/// value comes in, until one is left. The same comparisons serve `LANES` samples side by side.
pub fn median(x: &[f64], window: usize) -> Vec<f64> {
    let half = window / 2;
    let mut padded = vec![0.0; half];
    padded.extend_from_slice(x);
    padded.resize(x.len().next_multiple_of(LANES) + 2 * half, 0.0);
    let mut out = Vec::with_capacity(padded.len());
    let mut kept: Vec<[f64; LANES]> = Vec::with_capacity(half + 1);
    for start in (0..x.len()).step_by(LANES) {
        let value = |k: usize| -> [f64; LANES] { std::array::from_fn(|lane| padded[start + k + lane]) };
        kept.clear();
        kept.extend((0..half + 1).map(value));
        for k in half + 1..2 * half + 1 {
            let Some(last) = kept.pop() else { break };
            let (mut least, mut greatest) = sorted(last, value(k));
            for v in &mut kept {
                let greater;
                (least, greater) = sorted(least, *v);
                (*v, greatest) = sorted(greater, greatest);
            }
        }
        out.extend_from_slice(&kept[0]);
    }
    out.truncate(x.len());
    out
}

/// The smaller of each pair, and the greater.
fn sorted(a: [f64; LANES], b: [f64; LANES]) -> ([f64; LANES], [f64; LANES]) {
    let pick = |f: fn(f64, f64) -> f64| std::array::from_fn(|lane| f(a[lane], b[lane]));
    (pick(|a, b| if a < b { a } else { b }), pick(|a, b| if a > b { a } else { b }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn butterworth_passes_a_constant_and_halves_power_at_its_corner_per_pass() {
        let filter = Butterworth::low_pass(6.0, 1000.0).unwrap();
        assert!(filter.forwards_and_backwards(&[3.0; 50]).unwrap().iter().all(|v| (v - 3.0).abs() < 1e-9));
        let tone: Vec<f64> = (0..4000).map(|i| (std::f64::consts::TAU * 6.0 * i as f64 / 1000.0).sin()).collect();
        let out = filter.forwards_and_backwards(&tone).unwrap();
        let peak = out[1000..3000].iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        assert!((peak - 0.5).abs() < 1e-3, "two passes of -3 dB leave one half, not {peak}");
    }

    #[test]
    fn bad_filters_are_refused() {
        assert!(matches!(Butterworth::low_pass(500.0, 1000.0), Err(SignalError::Cutoff { .. })));
        assert!(matches!(Butterworth::low_pass(f64::NAN, 1000.0), Err(SignalError::Cutoff { .. })));
        let filter = Butterworth::low_pass(6.0, 1000.0).unwrap();
        assert!(matches!(filter.forwards_and_backwards(&[0.0; 6]), Err(SignalError::TooShort { .. })));
    }

    #[test]
    fn short_records_are_filtered() {
        assert_eq!(moving_average(&[1.0, 2.0, 6.0, 4.0], 101), [1.0, 3.0, 4.0, 4.0]);
        assert_eq!(moving_average(&[], 5), [0.0; 0]);
        assert_eq!(median(&[5.0, 1.0, 4.0], 3), [1.0, 4.0, 1.0]);
        assert_eq!(median(&[], 13), [0.0; 0]);
    }

    /// Against sorting each window.
    #[test]
    fn the_median_is_the_middle_of_the_sorted_window() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for (length, window) in [(1, 1), (40, 1), (9, 3), (100, 5), (333, 13), (8, 13), (64, 101)] {
            let x: Vec<f64> = (0..length).map(|_| f64::from(rng.random_range(-20..20))).collect();
            let sorted_middle = |i: usize| {
                let at = |k: usize| (i + k).checked_sub(window / 2).and_then(|i| x.get(i)).copied().unwrap_or(0.0);
                let mut inside: Vec<f64> = (0..window).map(at).collect();
                inside.sort_by(f64::total_cmp);
                inside[window / 2]
            };
            assert_eq!(median(&x, window), (0..length).map(sorted_middle).collect::<Vec<_>>(), "{length} {window}");
        }
    }
}
