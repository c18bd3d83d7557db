//! Experiments: which runs are made, what is recorded, and the folder they are written to.

use crate::hidden::Hidden;
use crate::motor::{ContactTable, Drive, Motor, State, rpm, step};
use crate::noise::{Nuisance, normal};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

/// Encoder edges a revolution.
pub const EDGES: f64 = 400.0;
/// Encoder pitch in rad.
pub const PITCH: f64 = TAU / EDGES;
/// PWM frequency in Hz.
pub const PWM_HZ: f64 = 50.0;
/// Sampling period in s.
pub const SAMPLE_S: f64 = 1e-3;

/// The runs that are made.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// On fractions.
    pub duties: Vec<f64>,
    /// Repetitions of each duty and direction.
    pub trials: usize,
    /// Length of each drive in s.
    pub seconds: f64,
    /// Both directions, or clockwise only.
    pub both_directions: bool,
    /// PWM frequencies in Hz.
    pub pwm_hz: Vec<f64>,
}

impl Design {
    /// A small experiment for bulk statistics: 6 duties, both directions, 3 trials of 2.5 s.
    pub fn small() -> Self {
        Self {
            duties: vec![0.18, 0.33, 0.5, 0.66, 0.83, 1.0],
            trials: 3,
            seconds: 2.5,
            both_directions: true,
            pwm_hz: vec![PWM_HZ],
        }
    }

    /// The small experiment at two PWM frequencies: a dead zone loses the same duty at both, a delay the same time.
    pub fn two_frequencies() -> Self {
        Self { trials: 2, pwm_hz: vec![PWM_HZ, 2.0 * PWM_HZ], ..Self::small() }
    }

    /// The thesis's experiment in both directions: 11 duties, 5 trials of 5 s.
    pub fn thesis() -> Self {
        Self {
            duties: (0..11).map(|k| 0.1 + 0.09 * k as f64).collect(),
            trials: 5,
            seconds: 5.0,
            both_directions: true,
            pwm_hz: vec![PWM_HZ],
        }
    }
}

/// One run as it is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    /// Identifier.
    pub id: String,
    /// On fraction.
    pub duty: f64,
    /// Direction.
    pub sign: f64,
    /// PWM frequency.
    pub pwm_hz: f64,
    /// Length of the drive in s.
    pub seconds: f64,
    /// Order.
    pub order: usize,
    /// Encoder levels, one a millisecond.
    pub levels: Vec<bool>,
}

/// A whole data set with what is hidden in it.
#[derive(Debug, Clone, PartialEq)]
pub struct DataSet {
    /// The runs.
    pub runs: Vec<Made>,
    /// What is hidden.
    pub hidden: Vec<Hidden>,
    /// The motor.
    pub motor: Motor,
}

/// What a run starts from: all that happened before.
#[derive(Debug, Clone, Copy, Default)]
struct History {
    warm: [f64; 2],
    revolutions: f64,
}

/// A data set drawn from a seed: motor, order, nuisances and the hidden effects' numbers.
#[derive(Debug, Clone)]
pub struct Sealed {
    /// Runs to make.
    pub design: Design,
    /// Disturbances.
    pub nuisance: Nuisance,
    /// Perturbed motor.
    pub motor: Motor,
    seed: u64,
    order: Vec<(f64, f64, f64)>,
}

impl Sealed {
    /// Draws motor, nuisances and order.
    pub fn new(design: Design, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5ea1ed);
        let mut spread = |width: f64| 1.0 + rng.random_range(-width..width);
        let base = Motor::default();
        let motor = Motor {
            crest_speed: base.crest_speed * spread(0.1),
            contact: base.contact * spread(0.15),
            off_friction: base.off_friction * spread(0.25),
            viscous: base.viscous * spread(0.5),
            wave_time: base.wave_time * spread(0.1),
            half_contact: base.half_contact * spread(0.15),
            creep: base.creep * spread(0.3),
            exponent: 1.0,
        };
        let nuisance = Nuisance { latency_s: rng.random_range(0.1e-3..1.5e-3), ..Nuisance::default() };
        let mut order = Vec::new();
        for _ in 0..design.trials {
            for duty in &design.duties {
                for pwm in &design.pwm_hz {
                    order.push((*duty, 1.0, *pwm));
                    if design.both_directions {
                        order.push((*duty, -1.0, *pwm));
                    }
                }
            }
        }
        for i in (1..order.len()).rev() {
            order.swap(i, rng.random_range(0..=i));
        }
        Self { design, nuisance, motor, seed, order }
    }

    /// Makes the runs with `hidden` in them.
    pub fn make(&self, hidden: &[Hidden]) -> DataSet {
        let table = ContactTable::new(&stiffened(&self.motor, hidden));
        let mut history = History::default();
        let mut start = Vec::new();
        for (k, (duty, _, _)) in self.order.iter().enumerate() {
            start.push(history);
            history = after(history, *duty, self.design.seconds, self.motor.crest_speed, hidden, self.rest_s(k));
        }
        let runs = self
            .order
            .par_iter()
            .enumerate()
            .map(|(k, (duty, sign, pwm))| self.run(k, *duty, *sign, *pwm, start[k], hidden, &table))
            .collect();
        DataSet { runs, hidden: hidden.to_vec(), motor: self.motor.clone() }
    }

    fn rest_s(&self, k: usize) -> f64 {
        3.0 + 7.0 * ((self.seed.wrapping_mul(31).wrapping_add(k as u64 * 17)) % 100) as f64 / 100.0
    }

    #[allow(clippy::too_many_arguments)]
    fn run(
        &self,
        k: usize,
        duty: f64,
        sign: f64,
        pwm_hz: f64,
        history: History,
        hidden: &[Hidden],
        table: &ContactTable,
    ) -> Made {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed.wrapping_mul(1_000_003).wrapping_add(k as u64));
        let run_gain = 1.0 + normal(&mut rng, self.nuisance.gain_spread);
        let zero_angle = rng.random_range(0.0..TAU);
        let cut = if rng.random::<f64>() < 0.5 { rng.random_range(0.0..self.nuisance.truncation) } else { 0.0 };
        let record_s = (self.design.seconds + 0.15) * (1.0 - cut);
        let motor = stiffened(&self.motor, hidden);
        let mut trace = Trace::new(
            &motor,
            table,
            duty,
            sign,
            pwm_hz,
            self.design.seconds,
            zero_angle,
            run_gain,
            history,
            hidden,
            rng.random(),
        );
        let wheel = Wheel::new(hidden);
        let samples = (record_s / SAMPLE_S) as usize;
        let mut levels = Vec::with_capacity(samples);
        let mut clock = 0.0;
        let mut drift = 0.0;
        let mut drop = None;
        for h in hidden {
            if h.name == "clock-error" {
                clock = 0.01 * h.size * h.sign();
                drift = 0.1 * clock;
            }
            if h.name == "dropped-samples" {
                let gaps = usize::from(rng.random::<f64>() < h.size) + usize::from(rng.random::<f64>() < h.size - 1.0);
                let mut at: Vec<usize> = (0..gaps).map(|_| rng.random_range(100..samples.max(200))).collect();
                at.sort_unstable();
                drop = Some(at);
            }
        }
        for n in 0..samples {
            let recorded = n as f64 * SAMPLE_S;
            let scale = 1.0 + clock + drift * (recorded / self.design.seconds - 0.5);
            let t = recorded / scale - self.nuisance.latency_s + normal(&mut rng, self.nuisance.jitter_s);
            let angle = trace.angle_at(t);
            levels.push(wheel.level(angle + zero_angle));
        }
        if let Some(at) = drop {
            for position in at.iter().rev() {
                if position + 32 < levels.len() {
                    levels.drain(*position..position + 32);
                }
            }
        }
        Made { id: format!("r{k:03}"), duty, sign, pwm_hz, seconds: self.design.seconds, order: k, levels }
    }

    /// Scales the first of `hidden` until its strength is `rho`. Returns the achieved strength.
    ///
    /// The strength is read from every other run: sizes below 0.02 or above the effect's largest are not used.
    pub fn scale_to(&self, hidden: &mut Hidden, rho: f64) -> f64 {
        let part = self.part();
        let mut refitted = (part.motor.clone(), part.nuisance.latency_s);
        let noise = part.floor_from(&[], &mut refitted);
        let (mut low, mut high) = (0.01, hidden.largest());
        hidden.size = hidden.size.min(high);
        let mut achieved = 0.0;
        for _ in 0..7 {
            let total = part.floor_from(std::slice::from_ref(hidden), &mut refitted);
            achieved = (total * total - noise * noise).max(1e-6).sqrt() / noise;
            if (achieved / rho - 1.0).abs() < 0.05
                || (achieved < rho && hidden.size >= 0.999 * high && high == hidden.largest())
            {
                break;
            }
            if achieved < rho {
                low = hidden.size;
            } else {
                high = hidden.size;
            }
            let guess = hidden.size * (rho / achieved).clamp(0.3, 3.0);
            hidden.size = if guess > low && guess < high { guess } else { (low * high).sqrt() };
            if high < 1.02 * low {
                break;
            }
        }
        achieved
    }

    /// A third of the experiment, for reading strengths.
    fn part(&self) -> Self {
        let mut part = self.clone();
        let kept = (self.order.len() / 3).max(6).min(self.order.len());
        // Every kind of run once: the order is random, the first of each kind will do.
        let mut seen = Vec::new();
        part.order.retain(|run| {
            let new = !seen.contains(run);
            seen.push(*run);
            new
        });
        part.order.truncate(kept.max(part.design.duties.len() * 2));
        part
    }

    /// RMS of the speed residual in rpm after a refit of the motor's own parameters.
    pub fn floor(&self, hidden: &[Hidden]) -> f64 {
        self.floor_from(hidden, &mut (self.motor.clone(), self.nuisance.latency_s))
    }

    /// [`Self::floor`], starting the refit from a motor and a latency and leaving them refitted.
    fn floor_from(&self, hidden: &[Hidden], start: &mut (Motor, f64)) -> f64 {
        let data = self.make(hidden);
        // The refit does not touch the contact's shape, so one table serves all of it.
        let table = ContactTable::new(&self.motor);
        let (mut motor, mut latency) = start.clone();
        let seconds: f64 = data.runs.iter().map(|r| r.levels.len() as f64 * SAMPLE_S).sum();
        let mut base = self.residual(&data, &motor, &table, latency);
        let square = |r: &[f64]| r.iter().map(|v| v * v).sum::<f64>();
        let mut best = square(&base);
        for _ in 0..5 {
            let mut columns = Vec::new();
            for k in 0..5 {
                let (m, l, h) = nudged(&motor, latency, k);
                let moved = self.residual(&data, &m, &table, l);
                columns.push(moved.iter().zip(&base).map(|(a, b)| (a - b) / h).collect::<Vec<f64>>());
            }
            let before = best;
            // Levenberg's damping, from nearly none to a short step downhill.
            for damping in [1e-4, 1e-2, 0.3, 5.0] {
                let step = least_squares(&columns, &base, damping);
                let mut m = motor.clone();
                m.crest_speed *= 1.0 - step[0].clamp(-0.3, 0.3);
                m.contact *= 1.0 - step[1].clamp(-0.5, 0.5);
                m.off_friction *= 1.0 - step[2].clamp(-0.5, 0.5);
                m.viscous = (m.viscous * (1.0 - step[3].clamp(-3.0, 0.95))).max(1e-3);
                let l = latency - step[4].clamp(-1e-3, 1e-3);
                let trial = self.residual(&data, &m, &table, l);
                if square(&trial) < best {
                    best = square(&trial);
                    (motor, latency, base) = (m, l, trial);
                    break;
                }
            }
            if before - best < 1e-3 * before {
                break;
            }
        }
        *start = (motor, latency);
        (best / seconds).sqrt()
    }

    /// Speed residuals of every edge interval against the motor alone, weighted by the root of their duration.
    fn residual(&self, data: &DataSet, motor: &Motor, table: &ContactTable, latency: f64) -> Vec<f64> {
        let parts: Vec<Vec<f64>> = data
            .runs
            .par_iter()
            .map(|run| {
                let mut trace = Trace::new(
                    motor,
                    table,
                    run.duty,
                    run.sign,
                    run.pwm_hz,
                    run.seconds,
                    0.0,
                    1.0,
                    History::default(),
                    &[],
                    0,
                );
                let mut out = Vec::new();
                let mut last: Option<(f64, f64)> = None;
                for n in 1..run.levels.len() {
                    if run.levels[n] != run.levels[n - 1] {
                        let t = (n as f64 - 0.5) * SAMPLE_S;
                        let angle = trace.angle_at(t - latency);
                        if let Some((t0, a0)) = last {
                            let dt = t - t0;
                            out.push(rpm(run.sign * PITCH - (angle - a0)) / dt * dt.sqrt());
                        }
                        last = Some((t, angle));
                    }
                }
                out
            })
            .collect();
        parts.concat()
    }
}

fn nudged(motor: &Motor, latency: f64, k: usize) -> (Motor, f64, f64) {
    let mut m = motor.clone();
    let h = 0.01;
    match k {
        0 => m.crest_speed *= 1.0 + h,
        1 => m.contact *= 1.0 + 5.0 * h,
        2 => m.off_friction *= 1.0 + 5.0 * h,
        3 => m.viscous *= 1.0 + 20.0 * h,
        _ => return (m, latency + 1e-4, 1e-4),
    }
    (
        m,
        latency,
        match k {
            0 => h,
            3 => 20.0 * h,
            _ => 5.0 * h,
        },
    )
}

/// Coefficients of `columns` that best explain `y` (normal equations, Gaussian elimination).
fn least_squares(columns: &[Vec<f64>], y: &[f64], damping: f64) -> Vec<f64> {
    let n = columns.len();
    let mut a = vec![vec![0.0; n + 1]; n];
    for i in 0..n {
        for j in 0..n {
            a[i][j] = columns[i].iter().zip(&columns[j]).map(|(p, q)| p * q).sum();
        }
        a[i][n] = columns[i].iter().zip(y).map(|(p, q)| p * q).sum();
        a[i][i] *= 1.0 + damping;
        a[i][i] += 1e-12;
    }
    for i in 0..n {
        let (above, below) = a.split_at_mut(i + 1);
        let pivot = &above[i];
        for row in below {
            let f = row[i] / pivot[i];
            for (value, p) in row.iter_mut().zip(pivot).skip(i) {
                *value -= f * p;
            }
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let s: f64 = (i + 1..n).map(|j| a[i][j] * x[j]).sum();
        x[i] = (a[i][n] - s) / a[i][i];
    }
    x
}

/// The motor with a softer contact, if that is hidden.
fn stiffened(motor: &Motor, hidden: &[Hidden]) -> Motor {
    let mut m = motor.clone();
    for h in hidden {
        if h.name == "contact-stiffening" {
            m.creep += 1.2 * h.size;
            m.crest_speed *= 1.0 + 0.05 * h.size;
        }
    }
    m
}

/// Warmth and distance after a run and the rest that follows.
fn after(before: History, duty: f64, seconds: f64, speed: f64, hidden: &[Hidden], rest: f64) -> History {
    let mut h = before;
    for e in hidden {
        if e.name == "resonance-heating" {
            let tau = e.between(0, 0.7, 4.0);
            for (k, tau) in [tau, 3.0 * tau].into_iter().enumerate() {
                h.warm[k] = duty + (h.warm[k] - duty) * (-seconds / tau).exp();
                h.warm[k] *= (-rest / (4.0 * tau)).exp();
            }
        }
    }
    h.revolutions += duty * speed * seconds / TAU;
    h
}

/// The encoder wheel with its errors.
struct Wheel {
    eccentricity: f64,
    phase: f64,
    harmonic: f64,
    slot: f64,
}

impl Wheel {
    fn new(hidden: &[Hidden]) -> Self {
        let mut w = Self { eccentricity: 0.0, phase: 0.0, harmonic: 0.0, slot: 0.0 };
        for h in hidden {
            match h.name {
                "encoder-eccentricity" => {
                    w.eccentricity = 0.4 * h.size;
                    w.phase = TAU * h.shape[0];
                    w.harmonic = 0.1;
                }
                "unequal-edges" => w.slot = 0.6 * h.size * h.sign(),
                _ => {}
            }
        }
        w
    }

    fn level(&self, angle: f64) -> bool {
        let x = angle - self.phase;
        let read = angle + self.eccentricity * (x.sin() + self.harmonic * (2.0 * x + 1.0).sin());
        let place = (read / (2.0 * PITCH)).rem_euclid(1.0);
        place < 0.5 * (1.0 + self.slot)
    }
}

/// A rotor in motion that can be asked for its angle at ascending times.
struct Trace<'a> {
    motor: &'a Motor,
    table: &'a ContactTable,
    duty: f64,
    sign: f64,
    period: f64,
    seconds: f64,
    zero_angle: f64,
    run_gain: f64,
    history: History,
    hidden: &'a [Hidden],
    state: State,
    before: State,
    t: f64,
    warm: [f64; 2],
    sagged: f64,
    pulse_noise: ChaCha8Rng,
    pulse: i64,
    pulse_delay: f64,
    effective: f64,
}

const DT: f64 = 1e-4;

impl<'a> Trace<'a> {
    #[allow(clippy::too_many_arguments)]
    fn new(
        motor: &'a Motor,
        table: &'a ContactTable,
        duty: f64,
        sign: f64,
        pwm_hz: f64,
        seconds: f64,
        zero_angle: f64,
        run_gain: f64,
        history: History,
        hidden: &'a [Hidden],
        seed: u64,
    ) -> Self {
        let mut effective = duty;
        for h in hidden {
            effective = actuator(h, effective);
        }
        Self {
            motor,
            table,
            duty,
            sign,
            period: 1.0 / pwm_hz,
            seconds,
            zero_angle,
            run_gain,
            history,
            hidden,
            state: State::default(),
            before: State::default(),
            t: 0.0,
            warm: history.warm,
            sagged: 0.0,
            pulse_noise: ChaCha8Rng::seed_from_u64(seed),
            pulse: -1,
            pulse_delay: 0.0,
            effective,
        }
    }

    fn angle_at(&mut self, t: f64) -> f64 {
        while self.t < t {
            self.before = self.state;
            self.advance();
        }
        if self.t <= 0.0 || t <= 0.0 {
            return 0.0;
        }
        let f = ((t - (self.t - DT)) / DT).clamp(0.0, 1.0);
        self.before.angle + f * (self.state.angle - self.before.angle)
    }

    fn advance(&mut self) {
        let t = self.t + 0.5 * DT;
        let mut d = Drive { sign: self.sign, gain: self.run_gain, ..Drive::default() };
        let pulse = (t / self.period).floor() as i64;
        if pulse != self.pulse {
            self.pulse = pulse;
            self.pulse_delay = 0.0;
            for h in self.hidden {
                if h.name == "start-delay" && (self.effective < 1.0 - 1e-9 || pulse == 0) {
                    self.pulse_delay += 5e-3 * h.size * (1.0 + normal(&mut self.pulse_noise, 0.08));
                }
            }
        }
        let phase = t - pulse as f64 * self.period;
        let on_from = (1.0 - self.effective) * self.period + self.pulse_delay;
        d.on = phase >= on_from && t < self.seconds;
        let theta = self.state.angle + self.zero_angle;
        for h in self.hidden {
            let s = h.size;
            match h.name {
                "resonance-heating" => {
                    let tau = h.between(0, 0.7, 4.0);
                    let heat = if d.on { 1.0 } else { 0.0 };
                    self.warm[0] += (heat - self.warm[0]) * DT / tau;
                    self.warm[1] += (heat - self.warm[1]) * DT / (3.0 * tau);
                    let warm = 0.75 * self.warm[0] + 0.25 * self.warm[1];
                    d.gain *= (1.0 + 0.3 * s) / (1.0 + 0.8 * s * warm);
                }
                "frequency-settling" => {
                    let tau = h.between(0, 0.03, 0.08);
                    let x = t / tau;
                    d.gain *= (1.0 + 1.5 * s * h.sign() * (1.0 + 0.6 * x) * (-1.2 * x).exp()).max(0.05);
                }
                "contact-stiffening" | "dead-zone" | "start-delay" | "duty-quantisation" | "high-duty-saturation" => {}
                "direction-asymmetry" => {
                    d.gain *= 1.0 + 0.3 * s * h.sign() * self.sign;
                    d.brake *= 1.0 - 0.2 * s * h.sign() * self.sign;
                }
                "preload-runout" => {
                    let mix = h.between(1, 0.0, 1.0);
                    let x = theta - TAU * h.shape[0];
                    let y = 2.0 * theta - TAU * h.shape[2];
                    let m = 0.4 * s * (mix.sqrt() * x.cos() + (1.0 - mix).sqrt() * y.cos() + 0.1 * (3.0 * x).cos());
                    d.gain *= (1.0 + m).max(0.05);
                    d.grip *= (1.0 + m).max(0.05);
                    d.brake *= (1.0 + 0.3 * m).max(0.05);
                }
                "stribeck-friction" => {
                    let vs = h.between(0, 0.3, 1.2);
                    let x = self.state.speed / vs;
                    d.drag += 1.6 * s * self.motor.contact / (1.0 + x * x) / (1.0 + 0.3 * x * x);
                }
                "supply-sag" => {
                    self.sagged += (if d.on { 1.0 } else { 0.0 } - self.sagged) * DT / 0.01;
                    d.gain *= 1.0 - 0.5 * s * (self.sagged - 0.6);
                }
                "run-in-wear" => {
                    let r0 = h.between(0, 1.0, 15.0);
                    let revs = self.history.revolutions + self.state.angle.abs() / TAU;
                    d.gain *= 1.0 + 0.6 * s * h.sign() * (revs / (revs + r0) - 0.5);
                }
                "outside-cogging" => d.gain *= (1.0 + 0.5 * s * (7.0 * theta).cos()).max(0.05),
                "outside-rhythm" => d.gain *= 1.0 + 0.5 * s * (TAU * 2.7 * t + 1.0).sin(),
                "outside-notch" => {
                    let x = (self.duty - 0.5) / 0.1;
                    d.gain *= 1.0 - 0.6 * s * (-x * x).exp();
                }
                _ => {}
            }
        }
        // A switching instant inside the step divides it.
        let split = on_from - (phase - 0.5 * DT);
        if split > 0.0 && split < DT && t < self.seconds {
            step(self.motor, self.table, &mut self.state, &Drive { on: false, ..d }, split);
            step(self.motor, self.table, &mut self.state, &Drive { on: true, ..d }, DT - split);
        } else {
            step(self.motor, self.table, &mut self.state, &d, DT);
        }
        self.t += DT;
    }
}

/// What the hidden effect makes of a commanded duty.
fn actuator(h: &Hidden, duty: f64) -> f64 {
    let s = h.size;
    match h.name {
        "dead-zone" => {
            let soft = 0.012;
            let x = (duty - 0.3 * s) / soft;
            (soft * if x > 30.0 { x } else { x.exp().ln_1p() }).min(1.0)
        }
        "duty-quantisation" => {
            let steps = (2.5 / s.max(0.05)).round().clamp(4.0, 40.0);
            ((duty * steps).round() / steps).clamp(0.0, 1.0)
        }
        "high-duty-saturation" => {
            let us = 1.2 / s.max(0.02).sqrt();
            us * (duty / us).tanh()
        }
        _ => duty,
    }
}

impl DataSet {
    /// Writes the measurement folder.
    pub fn write(&self, folder: &Path, name: &str) -> std::io::Result<()> {
        std::fs::create_dir_all(folder)?;
        let mut toml = format!("name = \"{name}\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = {}\n", EDGES as u32);
        for run in &self.runs {
            let direction = if run.sign > 0.0 { "cw" } else { "ccw" };
            write!(
                toml,
                "\n[[run]]\nid = \"{0}\"\nkind = \"speed\"\nfile = \"{0}.csv\"\nformat = \"levels\"\nduty = {1:.6}\ndirection = \"{direction}\"\n\
                 pwm_hz = {2:.1}\ndrive_on_s = {3:.3}\norder = {4}\n",
                run.id, run.duty, run.pwm_hz, run.seconds, run.order
            )
            .expect("writing to a string cannot fail");
            let mut csv = String::with_capacity(run.levels.len() * 11);
            csv.push_str("time_us,level\n");
            for (n, level) in run.levels.iter().enumerate() {
                writeln!(csv, "{},{}", n * 1000, u8::from(*level)).expect("writing to a string cannot fail");
            }
            std::fs::write(folder.join(format!("{}.csv", run.id)), csv)?;
        }
        std::fs::write(folder.join("measurement.toml"), toml)
    }
}
