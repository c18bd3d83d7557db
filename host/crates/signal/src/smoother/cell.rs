//! The Gaussian that stands for "the angle lies between these two boundaries".

use super::kalman::Angle;
use statrs::function::erf::erfc;
use std::f64::consts::{SQRT_2, TAU};

/// Expectation propagation's update of one statement: the Gaussian that, beside what all others say, gives the mean and
/// variance of the angle cut to the cell. `mean` and `variance` are those of the angle with the present statement `now` in;
/// the boundaries are uncertain with variance `softness`. `None` where nothing can be improved.
pub(super) fn moments(mean: f64, variance: f64, now: Angle, bounds: (f64, f64), softness: f64) -> Option<Angle> {
    let others = 1.0 / variance - now.precision;
    if others.is_nan() || others <= 1e-9 {
        return None;
    }
    let (v, m) = (1.0 / others, (mean / variance - now.weighted) / others);
    let (first, second) = derivatives(m, v + softness, bounds);
    let left = 1.0 + v * second;
    if left.is_nan() || left <= 1e-9 || !first.is_finite() {
        return None;
    }
    Some(Angle { precision: (-second / left).max(0.0), weighted: (first - m * second) / left })
}

/// First and second derivative, in the mean, of the logarithm of the probability that a Gaussian lies within bounds.
fn derivatives(mean: f64, variance: f64, (low, high): (f64, f64)) -> (f64, f64) {
    let sd = variance.sqrt();
    let (a, b) = ((low - mean) / sd, (high - mean) / sd);
    // Far outside, only the nearer bound matters, and the difference of two small numbers would lose its digits.
    if a > 4.0 {
        let r = tail_ratio(a);
        return (r / sd, -r * (r - a) / variance);
    }
    if b < -4.0 {
        let r = tail_ratio(-b);
        return (-r / sd, -r * (r + b) / variance);
    }
    let inside = upper_tail(a) - upper_tail(b);
    let first = (density(a) - density(b)) / (inside * sd);
    (first, (a * density(a) - b * density(b)) / (inside * variance) - first * first)
}

fn density(z: f64) -> f64 {
    (-0.5 * z * z).exp() / TAU.sqrt()
}

fn upper_tail(z: f64) -> f64 {
    0.5 * erfc(z / SQRT_2)
}

/// Density over upper tail; where both become too small for `f64`, by its asymptotic series.
fn tail_ratio(z: f64) -> f64 {
    if z > 20.0 { z + 1.0 / z - 2.0 / z.powi(3) + 10.0 / z.powi(5) } else { density(z) / upper_tail(z) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and variance of a Gaussian cut to bounds, by summation.
    fn cut(mean: f64, variance: f64, (low, high): (f64, f64)) -> (f64, f64) {
        let n = 200_000;
        let (mut w, mut wx, mut wxx) = (0.0, 0.0, 0.0);
        for i in 0..n {
            let x = low + (high - low) * (f64::from(i) + 0.5) / f64::from(n);
            let p = (-0.5 * (x - mean).powi(2) / variance).exp();
            (w, wx, wxx) = (w + p, wx + p * x, wxx + p * x * x);
        }
        (wx / w, wxx / w - (wx / w).powi(2))
    }

    #[test]
    fn the_statement_gives_the_moments_of_the_cut_gaussian() {
        for (mean, variance) in [(0.5, 0.04), (0.1, 0.04), (-0.3, 0.01), (0.5, 10.0), (1.2, 0.003), (-2.0, 0.1)] {
            let site = moments(mean, variance, Angle::UNKNOWN, (0.0, 1.0), 0.0).unwrap();
            let precision = 1.0 / variance + site.precision;
            let got = ((mean / variance + site.weighted) / precision, 1.0 / precision);
            let want = cut(mean, variance, (0.0, 1.0));
            assert!((got.0 - want.0).abs() < 1e-4, "{mean} {variance}: {got:?} {want:?}");
            assert!((got.1 / want.1 - 1.0).abs() < 0.01, "{mean} {variance}: {got:?} {want:?}");
        }
    }

    #[test]
    fn an_angle_well_inside_is_left_alone() {
        let site = moments(0.5, 1e-4, Angle::UNKNOWN, (0.0, 1.0), 0.0).unwrap();
        assert!(site.precision < 1e-6);
    }
}
