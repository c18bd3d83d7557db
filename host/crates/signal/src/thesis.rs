//! The thesis's way from encoder samples to speed (section A.7), step for step.
//!
//! Its properties, kept here so that its figures can be reproduced: the encoder step is 2π/400 rounded to five decimals
//! (0.01571 rad, 0.013 % too large); a record begins with a made-up event at time 0 and position 0; nothing after the
//! last edge is estimated and the last 10 samples are lost; the first 10 come from one fit of their own (a seam), with
//! negative values set to zero; the direction is not seen. Prefer [`super::smoother`].

use super::filters::{Butterworth, LANES, median, moving_average};
use super::spline::Spline;
use super::{RAD_S_TO_RPM, SignalError};
use nalgebra::{DMatrix, DVector};
use twum_record::convert::changes;

/// Samples in the window of the local cubic.
pub const WINDOW: usize = 21;
/// Corner of the Butterworth filter, in Hz.
pub const CUTOFF_HZ: f64 = 6.0;
/// Samples in the window of the moving average.
pub const AVERAGE_WINDOW: usize = 101;
/// Samples in the window of the median.
pub const MEDIAN_WINDOW: usize = 13;

const HALF: usize = (WINDOW - 1) / 2;
/// Samples of the spline worked on at once: 32 KiB, what the innermost cache of any computer of today holds.
const BLOCK: usize = 4096;

/// A step of the thesis's method that gives a speed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The derivative of the cubic over 21 samples.
    LocalCubic,
    /// After the Butterworth filter.
    Butterworth,
    /// After the moving average.
    MovingAverage,
    /// After the median.
    Median,
}

/// The thesis's method up to the local cubic: position and speed of each sample before any filter.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LocalFit {
    /// The local cubic's position, in rad.
    pub position_rad: Vec<f64>,
    /// The local cubic's derivative, in rpm.
    pub raw_rpm: Vec<f64>,
}

/// What each step of the thesis's method makes of one record.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ThesisEstimate {
    /// Time of each sample, in µs.
    pub time_us: Vec<f64>,
    /// The spline through the event midpoints, in rad; [`WINDOW`] / 2 samples longer than the rest.
    pub spline_rad: Vec<f64>,
    /// Before the filters.
    pub fit: LocalFit,
    /// The speed after the Butterworth filter, in rpm.
    pub butterworth_rpm: Vec<f64>,
    /// The speed after the moving average, in rpm.
    pub moving_average_rpm: Vec<f64>,
    /// The speed after the median, in rpm.
    pub median_rpm: Vec<f64>,
    /// The thesis's speed of the run: the mean of the moving average, in rpm.
    pub mean_rpm: f64,
}

/// Applies the thesis's method, filters and all, to an encoder line sampled every `period_us` from `start_us`.
///
/// # Errors
/// As [`local_fit`].
pub fn estimate(
    start_us: f64,
    period_us: f64,
    levels: &[bool],
    edges_per_rev: u32,
) -> Result<ThesisEstimate, SignalError> {
    let (mut spline_rad, mut fit) = (Vec::with_capacity(levels.len()), LocalFit::of(levels));
    local_cubics(period_us, levels, edges_per_rev, |block| {
        spline_rad.extend_from_slice(block.spline_rad);
        fit.add(&block);
    })?;
    if fit.raw_rpm.is_empty() {
        return Ok(ThesisEstimate::default());
    }
    let filtered = |step| filtered(&fit.raw_rpm, period_us, step);
    let moving_average_rpm = filtered(Step::MovingAverage)?;
    Ok(ThesisEstimate {
        time_us: times_us(start_us, period_us, &fit),
        spline_rad,
        butterworth_rpm: filtered(Step::Butterworth)?,
        mean_rpm: moving_average_rpm.iter().sum::<f64>() / moving_average_rpm.len() as f64,
        moving_average_rpm,
        median_rpm: filtered(Step::Median)?,
        fit,
    })
}

/// The speed after a step, of that of the local cubic.
///
/// # Errors
/// Below 7 samples, but for none, there is no Butterworth filter.
pub fn filtered(raw_rpm: &[f64], period_us: f64, step: Step) -> Result<Vec<f64>, SignalError> {
    if raw_rpm.is_empty() {
        return Ok(Vec::new());
    }
    match step {
        Step::LocalCubic => Ok(raw_rpm.to_vec()),
        Step::Butterworth => Butterworth::low_pass(CUTOFF_HZ, 1e6 / period_us)?.forwards_and_backwards(raw_rpm),
        Step::MovingAverage => Ok(moving_average(raw_rpm, AVERAGE_WINDOW)),
        Step::Median => Ok(median(raw_rpm, MEDIAN_WINDOW)),
    }
}

/// Times of the samples of a fit, in µs.
pub fn times_us(start_us: f64, period_us: f64, fit: &LocalFit) -> Vec<f64> {
    (0..fit.raw_rpm.len()).map(|i| start_us + i as f64 * period_us).collect()
}

/// Applies the thesis's method up to its filters.
///
/// # Errors
/// As [`local_cubics`].
pub fn local_fit(period_us: f64, levels: &[bool], edges_per_rev: u32) -> Result<LocalFit, SignalError> {
    let mut fit = LocalFit::of(levels);
    local_cubics(period_us, levels, edges_per_rev, |block| fit.add(&block))?;
    Ok(fit)
}

impl LocalFit {
    /// Nothing yet, with room for what these levels give at most.
    fn of(levels: &[bool]) -> Self {
        Self { position_rad: Vec::with_capacity(levels.len()), raw_rpm: Vec::with_capacity(levels.len()) }
    }

    fn add(&mut self, block: &Block<'_>) {
        self.position_rad.extend_from_slice(block.position_rad);
        self.raw_rpm.extend_from_slice(block.raw_rpm);
    }
}

/// What follows in a record, a few thousand samples at most.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    /// The next values of the spline through the event midpoints, in rad; it runs [`WINDOW`] / 2 samples ahead of the rest.
    pub spline_rad: &'a [f64],
    /// The next values of the local cubic's position, in rad.
    pub position_rad: &'a [f64],
    /// The next values of its derivative, in rpm.
    pub raw_rpm: &'a [f64],
}

/// Applies the thesis's method up to its filters and hands it on block by block: over ten minutes at 1 kHz, memory for results that
/// nobody keeps costs more than they do.
///
/// # Errors
/// [`SignalError::TooShort`] when the last edge comes before the 10th sample: the listing fails there (no edge at all is
/// an estimate of no samples and mean speed 0, as in the listing).
pub fn local_cubics(
    period_us: f64,
    levels: &[bool],
    edges_per_rev: u32,
    mut found: impl FnMut(Block<'_>),
) -> Result<(), SignalError> {
    super::check_positive("the sampling period (µs)", period_us)?;
    super::check_positive("edges a revolution", f64::from(edges_per_rev))?;
    let period_s = period_us * 1e-6;
    let step_rad = (std::f64::consts::TAU / f64::from(edges_per_rev) * 1e5).round() / 1e5;
    let (mut event_s, mut event_rad) = (vec![0.0], vec![0.0]);
    let mut level_off = 0;
    for i in changes(levels) {
        event_rad.push((event_s.len() as f64 - 0.5) * step_rad);
        event_s.push((i as f64 - 0.5) * period_s);
        level_off = i + 1;
    }
    if level_off == 0 {
        return Ok(());
    }
    if level_off < HALF {
        return Err(SignalError::TooShort {
            samples: level_off,
            needed: HALF,
            stage: "thesis's method (up to the last edge)",
        });
    }
    let spline = Spline::not_a_knot(event_s, event_rad).expect("event times increase by at least half a sample");
    let cubic = LocalCubic::new(WINDOW, period_s);
    let mut samples = Vec::with_capacity(BLOCK + WINDOW - 1);
    let (mut positions, mut speeds) = (Vec::new(), Vec::new());
    for start in (0..level_off).step_by(BLOCK) {
        // The windows that end in this block begin in the one before.
        samples.drain(..samples.len().saturating_sub(WINDOW - 1));
        let before = samples.len();
        let end = level_off.min(start + BLOCK);
        spline.extend(&mut samples, (start..end).map(|i| i as f64 * period_s));
        positions.clear();
        speeds.clear();
        if start == 0 {
            (positions, speeds) = first_fit(&samples[..HALF], period_s);
        }
        cubic.along(&samples, |values, slopes| {
            positions.extend_from_slice(values);
            speeds.extend(slopes.iter().map(|slope| slope * RAD_S_TO_RPM));
        });
        found(Block { spline_rad: &samples[before..], position_rad: &positions, raw_rpm: &speeds });
    }
    Ok(())
}

/// The least-squares cubic over an odd number of equally spaced samples, as weights of value and derivative at the middle
/// (Savitzky and Golay).
pub(super) struct LocalCubic {
    value: Vec<f64>,
    derivative: Vec<f64>,
}

impl LocalCubic {
    /// For `window` samples (odd, 5 or more) every `period_s`, from the even and the odd half of the normal equations.
    pub(super) fn new(window: usize, period_s: f64) -> Self {
        let half = (window / 2) as f64;
        let k = || (0..window).map(|i| i as f64 - half);
        let sum = |power: i32| k().map(|k| k.powi(power)).sum::<f64>();
        let (s0, s2, s4, s6) = (sum(0), sum(2), sum(4), sum(6));
        let even = s4 * s0 - s2 * s2;
        let odd = (s2 * s6 - s4 * s4) * period_s;
        Self {
            value: k().map(|k| (s4 - s2 * k * k) / even).collect(),
            derivative: k().map(|k| (s6 * k - s4 * k * k * k) / odd).collect(),
        }
    }

    /// Values and derivatives at the middle of every full window, in order, some at a time. The weights of the value are
    /// symmetric, those of the derivative antisymmetric.
    fn along(&self, samples: &[f64], mut found: impl FnMut(&[f64], &[f64])) {
        let (window, half) = (self.value.len(), self.value.len() / 2);
        let windows = (samples.len() + 1).saturating_sub(window);
        let whole = windows - windows % LANES;
        for start in (0..whole).step_by(LANES) {
            let lanes = |k: usize| &samples[start + k..start + k + LANES];
            let (mut value, mut derivative) = ([0.0; LANES], [0.0; LANES]);
            for (v, y) in value.iter_mut().zip(lanes(half)) {
                *v = self.value[half] * y;
            }
            for k in 0..half {
                let (left, right) = (lanes(k), lanes(window - 1 - k));
                for lane in 0..LANES {
                    value[lane] += self.value[k] * (left[lane] + right[lane]);
                    derivative[lane] += self.derivative[k] * (left[lane] - right[lane]);
                }
            }
            found(&value, &derivative);
        }
        for start in whole..windows {
            let (value, derivative) = self.at_middle(&samples[start..start + window]);
            found(&[value], &[derivative]);
        }
    }

    /// Value and derivative at the middle of the samples.
    pub(super) fn at_middle(&self, samples: &[f64]) -> (f64, f64) {
        let weigh = |weights: &[f64]| weights.iter().zip(samples).map(|(w, y)| w * y).sum::<f64>();
        (weigh(&self.value), weigh(&self.derivative))
    }
}

/// Position (rad) and speed (rpm) at the samples before the first full window: one cubic through them, negatives set to
/// zero.
fn first_fit(samples: &[f64], period_s: f64) -> (Vec<f64>, Vec<f64>) {
    let middle = (samples.len() - 1) as f64 / 2.0;
    let k = |i: usize| i as f64 - middle;
    let powers = DMatrix::from_fn(samples.len(), 4, |i, j| k(i).powi(j as i32));
    let c = powers
        .svd(true, true)
        .solve(&DVector::from_column_slice(samples), 1e-12)
        .expect("both sets of singular vectors were asked for");
    (0..samples.len())
        .map(k)
        .map(|k| {
            let position = c[0] + k * (c[1] + k * (c[2] + k * c[3]));
            let speed = (c[1] + k * (2.0 * c[2] + k * 3.0 * c[3])) / period_s;
            (position.max(0.0), (speed * RAD_S_TO_RPM).max(0.0))
        })
        .unzip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Fixture {
        levels: String,
        spline_rad: Vec<f64>,
        position_rad: Vec<f64>,
        raw_rpm: Vec<f64>,
        butterworth_rpm: Vec<f64>,
        moving_average_rpm: Vec<f64>,
        median_rpm: Vec<f64>,
    }

    /// `host/crates/signal/fixtures/thesis_velocity.py` made the reference with NumPy and SciPy.
    #[test]
    fn every_step_matches_scipy() {
        let fixture: Fixture = serde_json::from_str(include_str!("../fixtures/thesis_velocity.json")).unwrap();
        let levels: Vec<bool> = fixture.levels.chars().map(|c| c == '1').collect();
        let got = estimate(0.0, 1000.0, &levels, 400).unwrap();
        for (name, got, want) in [
            ("spline", &got.spline_rad, &fixture.spline_rad),
            ("position", &got.fit.position_rad, &fixture.position_rad),
            ("raw", &got.fit.raw_rpm, &fixture.raw_rpm),
            ("butterworth", &got.butterworth_rpm, &fixture.butterworth_rpm),
            ("moving average", &got.moving_average_rpm, &fixture.moving_average_rpm),
            ("median", &got.median_rpm, &fixture.median_rpm),
        ] {
            assert_eq!(got.len(), want.len(), "{name}");
            let worst = got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-6, "{name}: {worst}");
        }
    }

    /// Fails if a window that reaches from one block into the next is lost, comes twice, or is fitted to other samples than its own.
    #[test]
    fn blocks_join_without_a_seam() {
        let edge_every = |i: usize| 3 + i / 700;
        let mut levels = vec![false];
        while levels.len() < 2 * BLOCK + 100 {
            let next = !levels[levels.len() - 1];
            levels.extend(std::iter::repeat_n(next, edge_every(levels.len())));
        }
        let got = estimate(0.0, 1000.0, &levels, 400).unwrap();
        assert!(got.spline_rad.len() > 2 * BLOCK);
        assert_eq!(got.fit.raw_rpm.len(), got.spline_rad.len() - HALF);
        assert_eq!(got.fit.position_rad.len(), got.fit.raw_rpm.len());
        let cubic = LocalCubic::new(WINDOW, 1e-3);
        for (i, window) in got.spline_rad.windows(WINDOW).enumerate() {
            let (position_rad, rad_s) = cubic.at_middle(window);
            assert!((got.fit.position_rad[HALF + i] - position_rad).abs() < 1e-9, "{i}");
            assert!((got.fit.raw_rpm[HALF + i] - rad_s * RAD_S_TO_RPM).abs() < 1e-6, "{i}");
        }
    }

    #[test]
    fn a_motor_that_stands_still_has_speed_zero() {
        assert_eq!(estimate(0.0, 1000.0, &[true; 100], 400).unwrap(), ThesisEstimate::default());
        assert_eq!(estimate(0.0, 1000.0, &[], 400).unwrap(), ThesisEstimate::default());
    }

    #[test]
    fn what_the_listing_cannot_do_is_refused() {
        let early = [false, true, true, true, true, true, true];
        assert!(matches!(estimate(0.0, 1000.0, &early, 400), Err(SignalError::TooShort { .. })));
        assert!(matches!(estimate(0.0, 0.0, &early, 400), Err(SignalError::NotPositive { .. })));
        assert!(matches!(estimate(0.0, 1.0, &early, 0), Err(SignalError::NotPositive { .. })));
    }
}
