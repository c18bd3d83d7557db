//! How strong a hidden effect is: ρ = RMS(effect) / RMS(noise floor), both as speed, after a refit of the motor.
//!
//! Two scales count: windows of one mean edge interval (what happens within a PWM period) and of one PWM period (what
//! changes from pulse to pulse and from run to run). The refit is linear: what the effect does to the windows' speeds is
//! projected off what small changes of the motor's own parameters and of the record's latency do. ρ is the larger of the
//! two scales'. Generators share this definition and nothing of their physics.

use std::f64::consts::TAU;

/// Spacing of the angle traces in s.
pub const GRID_S: f64 = 0.5e-3;
/// Scales: one mean edge interval, one PWM period.
pub const SCALES: usize = 2;

/// Noise-free angles of one run as the encoder reads them, every [`GRID_S`] of recorded time.
#[derive(Debug, Clone)]
pub struct Traces {
    /// The motor as it is, nothing hidden.
    pub plain: Vec<f64>,
    /// The same with each parameter of the motor a little changed.
    pub nudged: Vec<Vec<f64>>,
    /// PWM period in s.
    pub period_s: f64,
    /// Encoder pitch in rad.
    pub pitch: f64,
}

/// Speeds in windows of all runs at one scale, and what the motor's parameters do to them.
#[derive(Debug)]
struct Scale {
    strides: Vec<usize>,
    plain: Vec<f64>,
    weight: Vec<f64>,
    directions: Vec<Vec<f64>>,
}

/// The refit of the motor, ready to be held against effects.
#[derive(Debug)]
pub struct Refit {
    scales: [Scale; SCALES],
}

fn speeds(trace: &[f64], stride: usize) -> impl Iterator<Item = f64> + '_ {
    let dt = stride as f64 * GRID_S;
    (stride..trace.len()).step_by(stride).map(move |n| (trace[n] - trace[n - stride]) / dt * 60.0 / TAU)
}

impl Refit {
    /// Prepares the windows and orthonormal directions of the refit, the record's latency among them.
    pub fn new(runs: &[Traces]) -> Self {
        Self { scales: [0, 1].map(|k| Scale::new(runs, k)) }
    }

    /// RMS speed in rpm that `with` (one trace a run, in the order given) adds beyond what a refit takes up, per scale.
    pub fn beyond(&self, with: &[Vec<f64>]) -> [f64; SCALES] {
        [0, 1].map(|k| self.scales[k].beyond(with))
    }
}

impl Scale {
    fn new(runs: &[Traces], scale: usize) -> Self {
        let strides: Vec<usize> = runs
            .iter()
            .map(|r| {
                let seconds = r.plain.len() as f64 * GRID_S;
                let turned = (r.plain.last().unwrap_or(&0.0) - r.plain.first().unwrap_or(&0.0)).abs();
                let interval = r.pitch * seconds / turned.max(r.pitch);
                let window = if scale == 0 { interval.min(r.period_s) } else { r.period_s };
                ((window / GRID_S).round() as usize).max(1)
            })
            .collect();
        let stacked = |pick: &dyn Fn(&Traces) -> &[f64]| -> Vec<f64> {
            runs.iter().zip(&strides).flat_map(|(r, s)| speeds(pick(r), *s)).collect()
        };
        let plain = stacked(&|r| &r.plain);
        let weight: Vec<f64> = runs
            .iter()
            .zip(&strides)
            .flat_map(|(r, s)| speeds(&r.plain, *s).map(|_| (*s as f64 * GRID_S).sqrt()))
            .collect();
        let difference = |other: Vec<f64>| -> Vec<f64> {
            other.iter().zip(&plain).zip(&weight).map(|((a, b), w)| (a - b) * w).collect()
        };
        let late: Vec<Vec<f64>> = runs.iter().map(|r| later(&r.plain)).collect();
        let delayed = late.iter().zip(&strides).flat_map(|(r, s)| speeds(r, *s).collect::<Vec<f64>>()).collect();
        let mut directions = vec![difference(delayed)];
        for k in 0..runs.first().map_or(0, |r| r.nudged.len()) {
            directions.push(difference(stacked(&|r| &r.nudged[k])));
        }
        orthonormal(&mut directions);
        Self { strides, plain, weight, directions }
    }

    fn beyond(&self, with: &[Vec<f64>]) -> f64 {
        let changed = with.iter().zip(&self.strides).flat_map(|(r, s)| speeds(r, *s));
        let mut left: Vec<f64> = changed.zip(&self.plain).zip(&self.weight).map(|((a, b), w)| (a - b) * w).collect();
        for d in &self.directions {
            let along = dot(d, &left);
            left.iter_mut().zip(d).for_each(|(l, d)| *l -= along * d);
        }
        let seconds: f64 = self.weight.iter().map(|w| w * w).sum();
        (dot(&left, &left) / seconds).sqrt()
    }
}

/// The trace one grid point late.
fn later(trace: &[f64]) -> Vec<f64> {
    let first = trace.first().copied();
    first.into_iter().chain(trace.iter().copied()).take(trace.len()).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Gram–Schmidt, twice for precision; directions that the others span already are dropped.
fn orthonormal(directions: &mut Vec<Vec<f64>>) {
    let mut kept: Vec<Vec<f64>> = Vec::new();
    for mut d in std::mem::take(directions) {
        let before = dot(&d, &d).sqrt();
        for _ in 0..2 {
            for k in &kept {
                let along = dot(k, &d);
                d.iter_mut().zip(k).for_each(|(d, k)| *d -= along * k);
            }
        }
        let after = dot(&d, &d).sqrt();
        if after > 1e-6 * before.max(1e-12) && after > 0.0 {
            d.iter_mut().for_each(|v| *v /= after);
            kept.push(d);
        }
    }
    *directions = kept;
}

/// Sums of squared noise and of time, per scale.
#[derive(Debug, Clone, Copy, Default)]
pub struct Floor {
    square: [f64; SCALES],
    seconds: [f64; SCALES],
}

impl Floor {
    /// Adds a run with nothing hidden: recorded edge times in s, the noise-free trace, its pitch and PWM period.
    pub fn add(&mut self, edges: &[f64], plain: &[f64], pitch: f64, period_s: f64) {
        let turned = |t: f64| at(plain, t).abs();
        for (scale, least) in [0.0, period_s].into_iter().enumerate() {
            let mut from = 0;
            for to in 1..edges.len() {
                let dt = edges[to] - edges[from];
                if dt < least || dt <= 0.0 {
                    continue;
                }
                let read = (to - from) as f64 * pitch;
                let error = (read - (turned(edges[to]) - turned(edges[from]))) / dt * 60.0 / TAU;
                self.square[scale] += error * error * dt;
                self.seconds[scale] += dt;
                from = to;
            }
        }
    }

    /// Both together.
    pub fn with(mut self, other: Self) -> Self {
        for k in 0..SCALES {
            self.square[k] += other.square[k];
            self.seconds[k] += other.seconds[k];
        }
        self
    }

    /// RMS in rpm, per scale.
    pub fn rpm(&self) -> [f64; SCALES] {
        [0, 1].map(|k| (self.square[k] / self.seconds[k].max(1e-9)).sqrt().max(1e-6))
    }
}

/// A trace at a time in s, between its points.
pub fn at(trace: &[f64], t: f64) -> f64 {
    let x = (t / GRID_S).max(0.0);
    let n = x as usize;
    match (trace.get(n), trace.get(n + 1)) {
        (Some(a), Some(b)) => a + (x - n as f64) * (b - a),
        _ => trace.last().copied().unwrap_or(0.0),
    }
}
