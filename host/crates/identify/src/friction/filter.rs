//! Low-pass and power spectrum of torque data (thesis sections A.2.1 and A.2.2).

use rustfft::{FftPlanner, num_complex::Complex};
use std::f64::consts::PI;
use twum_signal::{SignalError, filters::Butterworth};

/// Second-order Butterworth run forward and backward, the ends extended by reflection over three periods of the cut-off:
/// with the few samples `filtfilt` extends by, a cut-off of 0.5 Hz at 1 kHz leaves a start-up transient (the thesis drops
/// its first second).
///
/// # Errors
/// As [`Butterworth::low_pass`] and [`Butterworth::forwards_and_backwards`].
pub fn zero_phase_low_pass(signal: &[f64], sample_hz: f64, cutoff_hz: f64) -> Result<Vec<f64>, SignalError> {
    let filter = Butterworth::low_pass(cutoff_hz, sample_hz)?;
    let pad = ((3.0 * sample_hz / cutoff_hz) as usize).min(signal.len().saturating_sub(1));
    let (Some(first), Some(last)) = (signal.first(), signal.last()) else { return Ok(Vec::new()) };
    let before = signal[1..=pad].iter().rev().map(|x| 2.0 * first - x);
    let after = signal[signal.len() - 1 - pad..signal.len() - 1].iter().rev().map(|x| 2.0 * last - x);
    let extended: Vec<f64> = before.chain(signal.iter().copied()).chain(after).collect();
    let filtered = filter.forwards_and_backwards(&extended)?;
    Ok(filtered[pad..pad + signal.len()].to_vec())
}

/// One-sided power spectral density by Welch's method: (frequency in Hz, density in unit²/Hz), Hann windows of
/// `segment` samples, half overlapped, the mean removed.
pub fn power_spectrum(signal: &[f64], sample_hz: f64, segment: usize) -> Vec<(f64, f64)> {
    let segment = segment.min(signal.len()).max(2);
    let window: Vec<f64> = (0..segment).map(|i| (PI * i as f64 / segment as f64).sin().powi(2)).collect();
    let power: f64 = window.iter().map(|w| w * w).sum();
    let fft = FftPlanner::new().plan_fft_forward(segment);
    let mut sum = vec![0.0; segment / 2 + 1];
    let mut count = 0.0;
    let mean = signal.iter().sum::<f64>() / signal.len() as f64;
    let mut start = 0;
    while start + segment <= signal.len() {
        let mut buffer: Vec<Complex<f64>> = signal[start..start + segment]
            .iter()
            .zip(&window)
            .map(|(x, w)| Complex::new((x - mean) * w, 0.0))
            .collect();
        fft.process(&mut buffer);
        for (s, z) in sum.iter_mut().zip(&buffer) {
            *s += z.norm_sqr();
        }
        count += 1.0;
        start += segment / 2;
    }
    sum.iter()
        .enumerate()
        .map(|(i, s)| {
            let sides = if i == 0 || 2 * i == segment { 1.0 } else { 2.0 };
            (i as f64 * sample_hz / segment as f64, sides * s / (count * power * sample_hz))
        })
        .collect()
}

/// Cut-off for a low-pass: where the spectrum has come down to four times its floor (the median above an eighth of the
/// sampling rate), within 0.5 Hz (the thesis's) and a fiftieth of the sampling rate.
pub fn cutoff_from_spectrum(spectrum: &[(f64, f64)], sample_hz: f64) -> f64 {
    let mut high: Vec<f64> = spectrum.iter().filter(|(f, _)| *f > sample_hz / 8.0).map(|p| p.1).collect();
    high.sort_by(f64::total_cmp);
    let floor = high.get(high.len() / 2).copied().unwrap_or(0.0);
    let meets = spectrum.iter().skip(1).find(|(_, p)| *p < 4.0 * floor).map_or(0.5, |p| p.0);
    meets.clamp(0.5, sample_hz / 50.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cutoff_is_the_half_power_point_of_two_passes() {
        let fs = 1000.0;
        let tone: Vec<f64> = (0..8000).map(|i| (2.0 * PI * 5.0 * i as f64 / fs).sin()).collect();
        let out = zero_phase_low_pass(&tone, fs, 5.0).unwrap();
        // Each pass takes 1/√2 at the cut-off, both together half, without delay.
        for (x, y) in tone.iter().zip(&out).skip(2000).take(4000) {
            assert!((y - 0.5 * x).abs() < 2e-3);
        }
    }

    #[test]
    fn a_constant_passes() {
        assert!(zero_phase_low_pass(&[0.3; 5000], 1000.0, 0.5).unwrap().iter().all(|y| (y - 0.3).abs() < 1e-9));
    }

    #[test]
    fn the_spectrum_holds_the_variance() {
        let fs = 1000.0;
        let tone: Vec<f64> = (0..16_384).map(|i| 0.7 * (2.0 * PI * 62.5 * i as f64 / fs).sin()).collect();
        let spectrum = power_spectrum(&tone, fs, 4096);
        let area: f64 = spectrum.iter().map(|p| p.1).sum::<f64>() * fs / 4096.0;
        assert!((area / (0.7 * 0.7 / 2.0) - 1.0).abs() < 1e-2, "{area}");
        let peak = spectrum.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0;
        assert!((peak - 62.5).abs() < 0.3);
    }
}
