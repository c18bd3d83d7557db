//! Nuisances that are always there, and the strength of an effect against them.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// What disturbs a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Nuisance {
    /// Standard deviation of a sample's time in s.
    pub jitter_s: f64,
    /// Delay of the record behind the drive in s.
    pub latency_s: f64,
    /// Standard deviation of a run's speed, relative.
    pub gain_spread: f64,
    /// Largest share of a record that may be cut off its end.
    pub truncation: f64,
}

impl Default for Nuisance {
    fn default() -> Self {
        Self { jitter_s: 50e-6, latency_s: 0.5e-3, gain_spread: 0.01, truncation: 0.15 }
    }
}

/// A normal number.
pub fn normal(rng: &mut ChaCha8Rng, deviation: f64) -> f64 {
    if deviation <= 0.0 { 0.0 } else { Normal::new(0.0, deviation).expect("positive deviation").sample(rng) }
}
