//! Torques over the angle: an order of a turn, its phase in every run, and its course over a run.

use nalgebra::Complex;
use std::f64::consts::TAU;

/// Orders that are looked at: slots times poles of the motors there are, seen at their own shaft.
pub const MOST_ORDERS: usize = 64;
/// Orders that one motor is said to have: the strongest, and one beside it (its harmonic, or that of another part).
pub const KEPT: usize = 2;
/// Of every order: cosine and sine of what a speed feels of it over an interval, then what the way has more of both.
pub const WAVES: usize = 4 * KEPT;
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

/// Parts of an interval in which an angle whose speeds are known is a straight line: a sixteenth of the bend is left.
const PARTS: usize = 4;

/// Where a rotor went.
#[derive(Clone, Copy)]
pub struct Course<'a> {
    /// Times of the samples in s.
    pub time_s: &'a [f64],
    /// Angle at each in turns.
    pub turns: &'a [f64],
    /// Speed at each in rpm, where it is known better than the angles tell it: an interval is a straight line without.
    pub rpm: Option<&'a [f64]>,
    /// The lag through which the rotor feels a torque, in s.
    pub lag_s: f64,
}

impl Course<'_> {
    /// What e^(i·2π·order·turns) does over every interval between two samples to a speed that follows it with the lag, as the constant that
    /// does the same; the last interval stands for the one after the end.
    pub fn waves(&self, order: usize) -> Vec<Complex<f64>> {
        let parts = self.parts();
        let (mut step, mut decay) = (f64::NAN, 0.0);
        let mut out: Vec<Complex<f64>> = (1..self.time_s.len())
            .map(|k| {
                let h = self.time_s[k] - self.time_s[k - 1];
                if h != step {
                    (step, decay) = (h, (-h / (parts as f64 * self.lag_s)).exp());
                }
                let (mut sum, mut before) = (Complex::ZERO, self.angle(order, k, 0));
                for part in 1..=parts {
                    let after = self.angle(order, k, part);
                    // ∫ e^(−(h − s)/τ)·e^(iφ(s)) ds over τ, φ from `before` to `after`.
                    let whole = Complex::from_polar(1.0, after) - Complex::from_polar(decay, before);
                    sum = sum * decay + whole / Complex::new(1.0, (after - before) * self.lag_s * parts as f64 / h);
                    before = after;
                }
                sum / (1.0 - decay.powi(parts as i32))
            })
            .collect();
        out.push(*out.last().unwrap_or(&Complex::ZERO));
        out
    }

    /// The plain means over the intervals: a torque's integral is what the motion has, and the speed is the way's.
    fn means(&self, order: usize) -> Vec<Complex<f64>> {
        let parts = self.parts();
        let mean = |before: f64, after: f64| {
            let half = 0.5 * (after - before);
            let within = if half.abs() < 1e-4 { 1.0 } else { half.sin() / half };
            Complex::from_polar(within, 0.5 * (before + after))
        };
        let over = |k: usize| {
            let angle = |part: usize| self.angle(order, k, part);
            (0..parts).map(|part| mean(angle(part), angle(part + 1))).sum::<Complex<f64>>() / parts as f64
        };
        let mut out: Vec<Complex<f64>> = (1..self.time_s.len()).map(over).collect();
        out.push(*out.last().unwrap_or(&Complex::ZERO));
        out
    }

    fn parts(&self) -> usize {
        if self.rpm.is_some() { PARTS } else { 1 }
    }

    /// The order's angle in rad after a part of the interval before sample `k`.
    fn angle(&self, order: usize, k: usize, part: usize) -> f64 {
        let h = self.time_s[k] - self.time_s[k - 1];
        let gained = self.rpm.map_or(0.0, |rpm| (rpm[k] - rpm[k - 1]) / 60.0);
        let x = part as f64 / self.parts() as f64;
        let turns = self.turns[k - 1] + x * (self.turns[k] - self.turns[k - 1]) - 0.5 * h * gained * x * (1.0 - x);
        TAU * order as f64 * turns
    }

    /// The course of every ripple over the intervals of the run `at`, cosine and sine about its phase: [`WAVES`].
    pub fn ripple(&self, at: usize, ripples: &[Ripple]) -> Vec<[f64; WAVES]> {
        let mut out = vec![[0.0; WAVES]; self.turns.len()];
        for (j, ripple) in ripples.iter().enumerate() {
            let turned = Complex::from_polar(1.0, -ripple.phases[at]);
            let both = self.waves(ripple.order).into_iter().zip(self.means(ripple.order));
            for (to, (felt, mean)) in out.iter_mut().zip(both) {
                let (felt, more) = (felt * turned, (mean - felt) * turned);
                (to[2 * j], to[2 * j + 1]) = (felt.re, felt.im);
                (to[2 * (KEPT + j)], to[2 * (KEPT + j) + 1]) = (more.re, more.im);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if what a torque over the angle leaves of a speed, or its mean, is not what small steps leave of it: turning slowly, fast, back, at
    /// rest, and faster and faster.
    #[test]
    fn a_wave_does_what_small_steps_of_it_do() {
        let (lag_s, order) = (0.05, 3);
        let (time_s, turns) = ([0.0, 0.02, 0.03, 0.09, 0.1], [0.1, 0.15, 0.35, 0.05, 0.05]);
        let speeds = [60.0, 240.0, 60.0, -600.0, 300.0];
        for rpm in [None, Some(&speeds[..])] {
            let course = Course { time_s: &time_s, turns: &turns, rpm, lag_s };
            for (k, (wave, whole)) in course.waves(order).iter().zip(course.means(order)).take(4).enumerate() {
                let (steps, h) = (20_000, time_s[k + 1] - time_s[k]);
                let (mut speed, mut mean) = (Complex::ZERO, Complex::ZERO);
                for i in 0..steps {
                    let x = (i as f64 + 0.5) / steps as f64;
                    let bend = rpm.map_or(0.0, |v| 0.5 * h * (v[k + 1] - v[k]) / 60.0 * x * (1.0 - x));
                    let at = turns[k] + x * (turns[k + 1] - turns[k]) - bend;
                    let torque = Complex::from_polar(1.0, TAU * order as f64 * at);
                    speed += (torque - speed) * (h / steps as f64 / lag_s);
                    mean += torque / steps as f64;
                }
                let exact = wave * (1.0 - (-h / lag_s).exp());
                // Where an interval bends, its parts are straight.
                let most = if rpm.is_some() { 0.02 } else { 1e-4 };
                assert!((exact - speed).norm() < most, "interval {k}: {exact} and {speed}");
                assert!((whole - mean).norm() < most, "interval {k}: {whole} and {mean}");
            }
        }
    }
}
