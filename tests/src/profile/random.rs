//! Random numbers and smooth random functions: piecewise cubics through random knots.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use std::f64::consts::TAU;

/// A source of random numbers for one purpose, told from others by `purpose`.
#[derive(Debug, Clone)]
pub struct Dice(ChaCha12Rng);

impl Dice {
    /// Equal seeds and purposes throw equally.
    pub fn new(seed: u64, purpose: &str) -> Self {
        // FNV-1a over the purpose, so that purposes are independent streams of a seed.
        let hash =
            purpose.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
        Self(ChaCha12Rng::seed_from_u64(seed.rotate_left(17) ^ hash))
    }

    /// In `low..high`.
    pub fn even(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    /// In `low..high`, even in the logarithm.
    pub fn decade(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.even(0.0, 1.0))
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.even(0.0, 1.0) < p
    }

    /// In `low..=high`.
    pub fn whole(&mut self, low: usize, high: usize) -> usize {
        self.0.random_range(low..=high)
    }

    /// One of several.
    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.whole(0, of.len() - 1)]
    }

    /// Unit deviation, two-sided exponential: tails heavier than normal ones.
    pub fn laplace(&mut self) -> f64 {
        let u = self.even(-0.5, 0.5);
        -u.signum() * (1.0 - 2.0 * u.abs()).max(1e-12).ln() / 2f64.sqrt()
    }

    /// Unit deviation, even.
    pub fn box_shaped(&mut self) -> f64 {
        self.even(-1.0, 1.0) * 3f64.sqrt()
    }
}

/// A smooth function over 0..1 through random knots (Catmull–Rom), constant outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Smooth {
    knots: Vec<f64>,
}

impl Smooth {
    /// Free: mean 0, unit RMS over its knots.
    pub fn free(dice: &mut Dice, knots: usize) -> Self {
        let mut k: Vec<f64> = (0..knots).map(|_| dice.laplace()).collect();
        let mean = k.iter().sum::<f64>() / knots as f64;
        k.iter_mut().for_each(|v| *v -= mean);
        let rms = (k.iter().map(|v| v * v).sum::<f64>() / knots as f64).sqrt().max(1e-9);
        k.iter_mut().for_each(|v| *v /= rms);
        Self { knots: k }
    }

    /// Rising from 0 to 1 in uneven steps.
    pub fn rising(dice: &mut Dice, knots: usize) -> Self {
        let mut sum = 0.0;
        let mut k = vec![0.0];
        for _ in 1..knots {
            sum += dice.even(0.15, 1.0);
            k.push(sum);
        }
        k.iter_mut().for_each(|v| *v /= sum);
        Self { knots: k }
    }

    /// From 0, slowly at first, to 1: a rising function of a power.
    pub fn late(dice: &mut Dice, knots: usize) -> Self {
        let power = dice.even(2.0, 5.0);
        let mut s = Self::rising(dice, knots);
        let last = knots as f64 - 1.0;
        for (n, k) in s.knots.iter_mut().enumerate() {
            *k = 0.3 * *k * (n as f64 / last).powf(power) + 0.7 * (n as f64 / last).powf(power);
        }
        s
    }

    /// Value at `x`.
    pub fn at(&self, x: f64) -> f64 {
        let last = self.knots.len() - 1;
        let x = x.clamp(0.0, 1.0) * last as f64;
        let n = (x as usize).min(last - 1);
        let f = x - n as f64;
        let k = |i: isize| self.knots[(n as isize + i).clamp(0, last as isize) as usize];
        let (a, b, c, d) = (k(-1), k(0), k(1), k(2));
        b + 0.5 * f * (c - a + f * (2.0 * a - 5.0 * b + 4.0 * c - d + f * (3.0 * (b - c) + d - a)))
    }
}

/// A smooth periodic function of an angle: some harmonics, unit RMS.
#[derive(Debug, Clone, PartialEq)]
pub struct Periodic {
    terms: Vec<(f64, f64, f64)>,
}

impl Periodic {
    /// Harmonics `from..=to`, the higher the weaker by a random law; `stretch` makes them a non-integer multiple.
    pub fn draw(dice: &mut Dice, from: usize, to: usize, stretch: f64) -> Self {
        let fall = dice.even(0.3, 2.5);
        let mut terms: Vec<(f64, f64, f64)> = (from..=to)
            .map(|n| {
                let weight = dice.even(0.2, 1.0) * (from as f64 / n as f64).powf(fall);
                (n as f64 * stretch, weight, dice.even(0.0, TAU))
            })
            .collect();
        let rms = (terms.iter().map(|t| 0.5 * t.1 * t.1).sum::<f64>()).sqrt();
        terms.iter_mut().for_each(|t| t.1 /= rms);
        Self { terms }
    }

    /// Value at an angle.
    pub fn at(&self, angle: f64) -> f64 {
        self.terms.iter().map(|(n, w, p)| w * (n * angle + p).cos()).sum()
    }

    /// Amplitude of the lowest harmonic.
    pub fn lowest(&self) -> f64 {
        self.terms.first().map_or(0.0, |t| t.1)
    }
}
