//! Smooth random functions: draws of a Gaussian process, rising and fading ones made of it, and bumps round a circle.

use crate::profile::random::Dice;
use std::f64::consts::TAU;

/// Waves a process is made of: enough that its values are close to normal.
const FEATURES: usize = 24;
/// Points of a table.
const POINTS: usize = 256;

/// A normal number of unit deviation (Box and Muller).
pub fn normal(dice: &mut Dice) -> f64 {
    (-2.0 * dice.even(1e-12, 1.0).ln()).sqrt() * dice.even(0.0, TAU).cos()
}

/// A function over 0..1 in a table, flat outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    values: Vec<f64>,
}

impl Table {
    /// Of a function.
    pub fn of(f: impl Fn(f64) -> f64) -> Self {
        Self { values: (0..=POINTS).map(|n| f(n as f64 / POINTS as f64)).collect() }
    }

    /// A Gaussian process of mean 0 and unit RMS over 0..1 whose values hang together over `length`.
    pub fn wave(dice: &mut Dice, length: f64) -> Self {
        let terms: Vec<(f64, f64)> = (0..FEATURES).map(|_| (normal(dice) / length, dice.even(0.0, TAU))).collect();
        let mut table = Self::of(|x| terms.iter().map(|(w, p)| (w * x + p).cos()).sum());
        let n = table.values.len() as f64;
        let mean = table.values.iter().sum::<f64>() / n;
        table.values.iter_mut().for_each(|v| *v -= mean);
        let rms = (table.values.iter().map(|v| v * v).sum::<f64>() / n).sqrt().max(1e-9);
        table.values.iter_mut().for_each(|v| *v /= rms);
        table
    }

    /// Rising from 0 at 0 to 1 at 1, at a rate whose logarithm is a process of deviation `uneven`.
    pub fn climb(dice: &mut Dice, uneven: f64) -> Self {
        let length = dice.even(0.2, 0.6);
        let rate = Self::wave(dice, length);
        let mut sum = 0.0;
        let mut values = vec![0.0];
        for n in 0..POINTS {
            sum += (uneven * rate.at((n as f64 + 0.5) / POINTS as f64)).exp();
            values.push(sum);
        }
        values.iter_mut().for_each(|v| *v /= sum);
        Self { values }
    }

    /// Fading from 1 to 0, over four time constants from 0 to 1, at a rate that varies as in [`Self::climb`].
    pub fn fade(dice: &mut Dice) -> Self {
        let climb = Self::climb(dice, 0.6);
        let rest = (-4.0_f64).exp();
        Self::of(|x| ((-4.0 * climb.at(x)).exp() - rest) / (1.0 - rest))
    }

    /// Its value at `x`.
    pub fn at(&self, x: f64) -> f64 {
        let x = x.clamp(0.0, 1.0) * POINTS as f64;
        let n = (x as usize).min(POINTS - 1);
        self.values[n] + (x - n as f64) * (self.values[n + 1] - self.values[n])
    }
}

/// A smooth function of an angle: von Mises bumps, mean 0 and unit RMS over the circle.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring {
    table: Table,
}

impl Ring {
    /// `bumps` at random places, each of random sign and weight and as sharp as drawn from `sharp`.
    pub fn bumps(dice: &mut Dice, bumps: usize, sharp: [f64; 2]) -> Self {
        let terms: Vec<(f64, f64, f64)> =
            (0..bumps).map(|_| (normal(dice), dice.decade(sharp[0], sharp[1]), dice.even(0.0, TAU))).collect();
        let at = |x: f64| terms.iter().map(|(w, k, p)| w * (k * ((TAU * x - p).cos() - 1.0)).exp()).sum::<f64>();
        let values: Vec<f64> = (0..POINTS).map(|n| at(n as f64 / POINTS as f64)).collect();
        let mean = values.iter().sum::<f64>() / POINTS as f64;
        let rms = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / POINTS as f64).sqrt().max(1e-9);
        Self { table: Table::of(|x| (at(x) - mean) / rms) }
    }

    /// Its value at an angle in rad.
    pub fn at(&self, angle: f64) -> f64 {
        self.table.at((angle / TAU).rem_euclid(1.0))
    }
}
