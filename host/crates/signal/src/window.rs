//! Speed from one fixed window: the yardstick an adaptive estimator has to beat everywhere.

use super::edges::EdgeTrain;
use super::spline::Spline;
use super::thesis::LocalCubic;
use super::{RAD_S_TO_RPM, SignalError};

/// Longest window: two seconds at 1 kHz, more than one turn. Its work goes with the length of the record times its own.
const MOST_SAMPLES: usize = 2_001;

/// The polynomial fitted in the window. At the middle of a symmetric window a line has the slope of a parabola and a
/// cubic that of a quartic, so these two are all there is below order five.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// A straight line.
    Line,
    /// A cubic.
    Cubic,
}

/// Speed, in rpm, at `samples` times every `period_us` from the start of the record: the spline through the edges' midpoints,
/// then the slope of a polynomial over `window` samples (odd) about each one. Towards an end of what the edges cover the
/// window shrinks; beyond it, and where fewer than 5 samples are left, the speed is NaN.
///
/// # Errors
/// A period that is not above zero, or fewer than two edges.
pub fn speed_rpm(
    train: &EdgeTrain,
    period_us: f64,
    samples: usize,
    window: usize,
    order: Order,
) -> Result<Vec<f64>, SignalError> {
    super::check_positive("the sampling period (µs)", period_us)?;
    if window > MOST_SAMPLES {
        return Err(SignalError::TooMany { samples: window, most: MOST_SAMPLES });
    }
    let time_s = |us: f64| (us - train.start_us) * 1e-6;
    let events_s: Vec<f64> = train.edges.iter().map(|e| time_s(e.middle_us())).collect();
    let events_rad: Vec<f64> = train.edges.iter().map(|e| e.boundary as f64 * train.pitch_rad).collect();
    let too_short = SignalError::TooShort { samples: events_s.len(), needed: 2, stage: "window over edges" };
    let ends_s = events_s.first().copied().zip(events_s.last().copied());
    let (spline, (from_s, to_s)) = Spline::not_a_knot(events_s, events_rad).zip(ends_s).ok_or(too_short)?;
    let period_s = period_us * 1e-6;
    let first = ((from_s / period_s).ceil().max(0.0) as usize).min(samples);
    let end = (((to_s / period_s).floor() as usize) + 1).clamp(first, samples);
    let position = spline.values((first..end).map(|i| i as f64 * period_s));
    let full = LocalCubic::new(window | 1, period_s);
    let mut rpm = vec![f64::NAN; samples];
    for i in 0..position.len() {
        let half = (window / 2).min(i).min(position.len() - 1 - i);
        if half >= 2 {
            let inside = &position[i - half..=i + half];
            let slope = match order {
                Order::Line => line_slope(inside) / period_s,
                Order::Cubic if half == window / 2 => full.at_middle(inside).1,
                Order::Cubic => LocalCubic::new(inside.len(), period_s).at_middle(inside).1,
            };
            rpm[first + i] = slope * RAD_S_TO_RPM;
        }
    }
    Ok(rpm)
}

/// Slope per sample of the least-squares line.
fn line_slope(y: &[f64]) -> f64 {
    let half = (y.len() / 2) as f64;
    let weights = (0..y.len()).map(|i| i as f64 - half);
    let (top, bottom) = weights.zip(y).fold((0.0, 0.0), |(a, b), (k, y)| (a + k * y, b + k * k));
    top / bottom
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial::{Motion, Trial};

    #[test]
    fn a_long_window_finds_a_steady_speed() {
        let trial = Trial::new(Motion::Steady { rpm: 30.0 }, 1);
        let train = trial.sampled();
        for order in [Order::Line, Order::Cubic] {
            let rpm = speed_rpm(&train, 1000.0, trial.samples(), 201, order).unwrap();
            let worst = rpm[150..rpm.len() - 150].iter().map(|v| (v - 30.0).abs()).fold(0.0, f64::max);
            assert!(worst < 0.1, "{order:?}: {worst}");
        }
    }
}
