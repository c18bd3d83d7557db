//! Smooth random functions: cosine series of falling weight, tabulated.

use crate::profile::random::Dice;
use std::f64::consts::{PI, TAU};

/// Points of a table: the steepest series has a wavelength of 0.4, which 128 cells follow within a thousandth.
const CELLS: usize = 128;

/// A smooth random function over 0..1, constant outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve(Vec<f64>);

/// The series itself, at the table's points.
fn series(dice: &mut Dice) -> Vec<f64> {
    let fall = dice.even(0.8, 2.0);
    let terms: Vec<[f64; 3]> =
        (1..=5).map(f64::from).map(|k| [k, dice.even(-1.0, 1.0) / k.powf(fall), dice.even(0.0, TAU)]).collect();
    let value = |x: f64| terms.iter().map(|[k, weight, phase]| weight * (PI * k * x + phase).cos()).sum();
    (0..=CELLS).map(|n| value(n as f64 / CELLS as f64)).collect()
}

/// To mean 0 and RMS 1.
fn standard(values: &mut [f64]) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter_mut().for_each(|v| *v -= mean);
    let rms = (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt().max(1e-9);
    values.iter_mut().for_each(|v| *v /= rms);
}

impl Curve {
    /// Of mean 0 and RMS 1, going where it will.
    pub fn wandering(dice: &mut Dice) -> Self {
        let mut values = series(dice);
        standard(&mut values);
        Self(values)
    }

    /// From 0 to 1, rising everywhere: its slope is the exponential of a series, so that it varies by some e either way.
    pub fn rising(dice: &mut Dice) -> Self {
        let mut slope = series(dice);
        standard(&mut slope);
        let mut values = vec![0.0];
        let mut sum = 0.0;
        for pair in slope.windows(2) {
            sum += (0.8 * 0.5 * (pair[0] + pair[1])).exp();
            values.push(sum);
        }
        values.iter_mut().for_each(|v| *v /= sum);
        Self(values)
    }

    /// Value at `x`.
    pub fn at(&self, x: f64) -> f64 {
        let x = x.clamp(0.0, 1.0) * CELLS as f64;
        let n = (x as usize).min(CELLS - 1);
        self.0[n] + (x - n as f64) * (self.0[n + 1] - self.0[n])
    }
}

/// A smooth random function of an angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring(Vec<[f64; 3]>);

impl Ring {
    /// Harmonics `orders`, the first of amplitude 1, each other drawn weaker than the one before.
    pub fn draw(dice: &mut Dice, orders: &[f64]) -> Self {
        let mut weight = 1.0;
        let term = |order: &f64| {
            let now = [*order, weight, dice.even(0.0, TAU)];
            weight *= dice.even(0.15, 0.8);
            now
        };
        Self(orders.iter().map(term).collect())
    }

    /// What its first harmonic alone is at an angle in rad.
    pub fn first(&self, angle: f64) -> f64 {
        self.0.first().map_or(0.0, |[order, weight, phase]| weight * (order * angle + phase).sin())
    }

    /// Value at an angle in rad.
    pub fn at(&self, angle: f64) -> f64 {
        self.0.iter().map(|[order, weight, phase]| weight * (order * angle + phase).sin()).sum()
    }
}
