//! Torques over the angle: an order of a turn, its phase in every run, and its course over a run.

use nalgebra::Complex;
use std::f64::consts::TAU;

/// Orders that are looked at: slots times poles of the motors there are, seen at their own shaft.
pub const MOST_ORDERS: usize = 64;
/// Orders that one motor is said to have: the strongest, and one beside it (its harmonic, or that of another part).
pub const KEPT: usize = 2;
/// What a phase of a run's own costs in nats: told to a tenth of a radian out of a whole turn.
const PHASE_COST: f64 = 4.1;

/// An order that stands out.
#[derive(Debug, Clone, PartialEq)]
pub struct Ripple {
    /// Periods a turn.
    pub order: usize,
    /// Phase of every run in rad: the torque is largest where 2π·order·turns is the phase.
    pub phases: Vec<f64>,
}

impl Ripple {
    /// What its choice costs in nats: one of many orders, and phases that differ from run to run.
    pub fn cost(&self) -> f64 {
        let own = self.phases.windows(2).filter(|w| w[0] != w[1]).count();
        (MOST_ORDERS as f64).ln() + PHASE_COST * own as f64
    }
}

/// The mean of e^(i·2π·order·turns) over every interval between two samples; the last interval stands for the one after the end.
pub fn waves(turns: &[f64], order: usize) -> Vec<Complex<f64>> {
    let mut out: Vec<Complex<f64>> = turns
        .windows(2)
        .map(|w| {
            let (middle, half) = (TAU * order as f64 * 0.5 * (w[0] + w[1]), TAU * order as f64 * 0.5 * (w[1] - w[0]));
            let mean = if half.abs() < 1e-6 { 1.0 } else { half.sin() / half };
            Complex::from_polar(1.0, middle) * mean
        })
        .collect();
    out.push(*out.last().unwrap_or(&Complex::ZERO));
    out
}

/// The course of every ripple over the intervals of the run `at`, cosine and sine about its phase.
pub fn courses(turns: &[f64], at: usize, ripples: &[Ripple]) -> Vec<[f64; 2 * KEPT]> {
    let mut out = vec![[0.0; 2 * KEPT]; turns.len()];
    for (j, ripple) in ripples.iter().enumerate() {
        let turned = Complex::from_polar(1.0, -ripple.phases[at]);
        for (to, w) in out.iter_mut().zip(waves(turns, ripple.order)) {
            let w = w * turned;
            (to[2 * j], to[2 * j + 1]) = (w.re, w.im);
        }
    }
    out
}
