//! What repeats in time, and what repeats in angle.

use super::{SignalError, check_positive};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Samples a turn when speed is resampled against angle: two for each of the 400 edges of the 30 mm PCBMotor.
const SAMPLES_PER_TURN: f64 = 800.0;
/// Zeros appended, as a multiple of the record: they make peaks readable, and resolve nothing.
const PADDING: usize = 4;
/// Fewer samples have no spectrum worth the name.
const LEAST_SAMPLES: usize = 16;

/// Amplitudes over frequencies.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Frequencies in Hz, or orders (periods a turn) when taken against angle; the first is 0.
    pub at: Vec<f64>,
    /// Amplitude (half of peak to peak) of the sine at each, in the unit of the signal.
    pub amplitude: Vec<f64>,
    /// Least distance at which two sines are told apart: the width of the window's main lobe at half height, two bins.
    pub resolution: f64,
}

/// Amplitudes of a signal sampled every `period_s`, its straight-line trend taken off, under a Hann window.
///
/// # Errors
/// Fewer than 16 samples, or a period that is not above zero.
pub fn against_time(signal: &[f64], period_s: f64) -> Result<Spectrum, SignalError> {
    check_positive("the sampling period (s)", period_s)?;
    let n = signal.len();
    if n < LEAST_SAMPLES {
        return Err(SignalError::TooShort { samples: n, needed: LEAST_SAMPLES, stage: "spectrum" });
    }
    let (mean, slope) = trend(signal);
    let middle = (n - 1) as f64 / 2.0;
    let padded = (n * PADDING).next_power_of_two();
    let mut buffer = vec![Complex::new(0.0, 0.0); padded];
    let mut weights = 0.0;
    for (i, (v, out)) in signal.iter().zip(&mut buffer).enumerate() {
        let weight = 0.5 - 0.5 * (TAU * (i as f64 + 0.5) / n as f64).cos();
        weights += weight;
        out.re = weight * (v - mean - slope * (i as f64 - middle));
    }
    FftPlanner::new().plan_fft_forward(padded).process(&mut buffer);
    let bins = padded / 2 + 1;
    Ok(Spectrum {
        at: (0..bins).map(|i| i as f64 / (padded as f64 * period_s)).collect(),
        amplitude: buffer[..bins].iter().map(|c| 2.0 * c.norm() / weights).collect(),
        resolution: 2.0 / (n as f64 * period_s),
    })
}

/// Amplitudes of a speed against the angle turned, in orders of a revolution. Only what turns on in the direction of the
/// whole record counts: where the rotor turns back, the record is left out until it has come past again.
///
/// # Errors
/// As [`against_time`], and [`SignalError::TooFewTurns`] below one turn, [`SignalError::TooManyTurns`] above one in two samples.
pub fn against_angle(position_rad: &[f64], speed_rpm: &[f64]) -> Result<Spectrum, SignalError> {
    let sign = match (position_rad.first(), position_rad.last()) {
        (Some(first), Some(last)) if last < first => -1.0,
        _ => 1.0,
    };
    let mut onwards: Vec<(f64, f64)> = Vec::with_capacity(position_rad.len());
    for (position, speed) in position_rad.iter().zip(speed_rpm) {
        let turned = sign * position / TAU;
        if turned.is_finite() && speed.is_finite() && onwards.last().is_none_or(|(before, _)| turned > *before) {
            onwards.push((turned, *speed));
        }
    }
    let turns = match (onwards.first(), onwards.last()) {
        (Some(first), Some(last)) => last.0 - first.0,
        _ => 0.0,
    };
    if turns < 1.0 {
        return Err(SignalError::TooFewTurns { turns });
    }
    if turns > onwards.len() as f64 / 2.0 {
        return Err(SignalError::TooManyTurns { turns, samples: onwards.len() });
    }
    let start = onwards[0].0;
    let mut i = 0;
    let resampled: Vec<f64> = (0..(turns * SAMPLES_PER_TURN) as usize)
        .map(|k| {
            let at = start + k as f64 / SAMPLES_PER_TURN;
            while i + 2 < onwards.len() && onwards[i + 1].0 < at {
                i += 1;
            }
            let ((a, va), (b, vb)) = (onwards[i], onwards[i + 1]);
            va + (vb - va) * ((at - a) / (b - a))
        })
        .collect();
    against_time(&resampled, 1.0 / SAMPLES_PER_TURN)
}

/// Mean, and slope per sample, of the least-squares line.
fn trend(y: &[f64]) -> (f64, f64) {
    let n = y.len() as f64;
    let mean = y.iter().sum::<f64>() / n;
    let middle = (n - 1.0) / 2.0;
    let (top, bottom) = y.iter().enumerate().fold((0.0, 0.0), |(top, bottom), (i, y)| {
        let x = i as f64 - middle;
        (top + x * (y - mean), bottom + x * x)
    });
    (mean, top / bottom)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peak(s: &Spectrum) -> (f64, f64) {
        let i = (0..s.at.len()).max_by(|a, b| s.amplitude[*a].total_cmp(&s.amplitude[*b])).unwrap();
        (s.at[i], s.amplitude[i])
    }

    #[test]
    fn a_sine_on_a_trend_shows_with_its_amplitude() {
        let signal: Vec<f64> =
            (0..2000).map(|i| i as f64 * 1e-3).map(|t| 30.0 - 2.0 * t + 4.0 * (TAU * 50.0 * t).sin()).collect();
        let (at, amplitude) = peak(&against_time(&signal, 1e-3).unwrap());
        assert!((at - 50.0).abs() < 0.2, "{at}");
        // Between two of the padded bins a Hann window loses up to 1 %.
        assert!((amplitude - 4.0).abs() < 0.04, "{amplitude}");
    }

    #[test]
    fn a_ripple_tied_to_the_angle_stays_one_line_when_the_speed_changes() {
        // Speeds up from 20 to 60 rpm, with ±3 rpm twice a turn, turning backwards.
        let (mut position, mut speed, mut angle) = (Vec::new(), Vec::new(), 0.0_f64);
        for i in 0..6000 {
            let rpm = 20.0 + 40.0 * f64::from(i) / 6000.0 + 3.0 * (2.0 * angle).cos();
            position.push(-angle);
            speed.push(-rpm);
            angle += rpm / 60.0 * TAU * 1e-3;
        }
        let (order, amplitude) = peak(&against_angle(&position, &speed).unwrap());
        assert!((order - 2.0).abs() < 0.05, "{order}");
        assert!((amplitude - 3.0).abs() < 0.15, "{amplitude}");
    }

    #[test]
    fn too_little_is_refused() {
        assert!(matches!(against_time(&[1.0; 5], 1.0), Err(SignalError::TooShort { .. })));
        assert!(matches!(against_angle(&[0.0, 1.0], &[1.0, 1.0]), Err(SignalError::TooFewTurns { .. })));
        assert!(matches!(against_angle(&[], &[]), Err(SignalError::TooFewTurns { .. })));
        let far = against_angle(&[0.0, 1e15, 2e15], &[1.0, 1.0, 1.0]);
        assert!(matches!(far, Err(SignalError::TooManyTurns { samples: 3, .. })));
    }
}
