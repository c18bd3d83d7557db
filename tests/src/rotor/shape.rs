//! Drawing numbers and smooth random curves.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;

/// Evenly between two values.
pub fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// Between two positive values, even in the logarithm.
pub fn log_between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    between(rng, low.ln(), high.ln()).exp()
}

/// One of several.
pub fn one_of<T: Clone>(rng: &mut ChaCha8Rng, of: &[T]) -> T {
    of[rng.random_range(0..of.len())].clone()
}

/// A normal number of unit deviation.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A smooth random curve over 0..1: a few cosines, the faster the weaker.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    terms: [(f64, f64); 4],
}

impl Curve {
    /// Draws one.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        Self { terms: [1.0, 2.0, 3.0, 4.0].map(|n: f64| (normal(rng) / n.powf(1.5), between(rng, 0.0, 2.0 * PI))) }
    }

    fn slope(&self, x: f64) -> f64 {
        self.terms.iter().enumerate().map(|(n, (a, p))| a * (PI * (n + 1) as f64 * x + p).cos()).sum()
    }

    /// From 0 at 0 to 1 at 1, rising all the way but unevenly: the integral of exp(curve), normalised.
    pub fn rising(&self, x: f64) -> f64 {
        let part = |to: f64| -> f64 {
            let steps = 16;
            let dx = to / f64::from(steps);
            (0..steps).map(|k| (0.8 * self.slope((f64::from(k) + 0.5) * dx)).exp() * dx).sum()
        };
        part(x.clamp(0.0, 1.0)) / part(1.0)
    }

    /// [`Self::rising`] in a table, for use in each step.
    pub fn table(&self) -> Rising {
        Rising { values: (0..=64).map(|k| self.rising(f64::from(k) / 64.0)).collect() }
    }
}

/// A rising curve from 0 to 1, tabulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Rising {
    values: Vec<f64>,
}

impl Rising {
    /// Its value, flat outside 0..1.
    pub fn at(&self, x: f64) -> f64 {
        let x = 64.0 * x.clamp(0.0, 1.0);
        let n = (x as usize).min(63);
        self.values[n] + (x - n as f64) * (self.values[n + 1] - self.values[n])
    }
}
