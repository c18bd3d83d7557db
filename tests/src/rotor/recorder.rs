//! The encoder wheel, the recorder's clock and what is written down: all that is known of the rotor.

use super::effects::Effect;
use super::motion::Step;
use super::shape::{between, log_between, normal};
use crate::folder::Record;
use crate::strength::GRID_S;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// The wheel: where its edges are, in the angle it should have read.
#[derive(Debug, Clone)]
pub struct Wheel {
    /// Angle between edges in rad.
    pub pitch: f64,
    irregular: Vec<f64>,
    eccentricity: [(f64, f64); 4],
    high_excess: f64,
}

impl Wheel {
    /// A wheel of `edges`, each misplaced at random by about `irregular` of a pitch, with what is hidden in it.
    pub fn new(edges: u32, irregular: f64, seed: u64, hidden: &[Effect]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut wheel = Self {
            pitch: TAU / f64::from(edges),
            irregular: (0..edges).map(|_| irregular * normal(&mut rng).clamp(-3.0, 3.0)).collect(),
            eccentricity: [(0.0, 0.0); 4],
            high_excess: 0.0,
        };
        for e in hidden {
            match e.name {
                "encoder-eccentricity" => {
                    for (k, h) in wheel.eccentricity.iter_mut().enumerate() {
                        let share = if k == 0 { 1.0 } else { 0.5 / (k + 1) as f64 * e.harmonics[k].0 };
                        *h = (e.size * share, e.harmonics[k].1);
                    }
                }
                "unequal-edges" => wheel.high_excess = e.sign * e.size,
                _ => {}
            }
        }
        wheel
    }

    fn turned(&self, angle: f64) -> f64 {
        let error = |(k, (size, phase)): (usize, &(f64, f64))| size * ((k + 1) as f64 * angle - phase).sin();
        angle + self.eccentricity.iter().enumerate().map(error).sum::<f64>()
    }

    fn boundary(&self, n: i64) -> f64 {
        let own = self.irregular[n.rem_euclid(self.irregular.len() as i64) as usize];
        let excess = if n.rem_euclid(2) == 1 { self.high_excess } else { 0.0 };
        (n as f64 + own + excess) * self.pitch
    }

    /// The angle as read by someone who takes every slot for one pitch; irregularity left out.
    pub fn read(&self, angle: f64) -> f64 {
        let x = self.turned(angle) / self.pitch;
        let pair = (x / 2.0).floor();
        let within = x - 2.0 * pair;
        let high = 1.0 + self.high_excess;
        let read = if within < high { within / high } else { 1.0 + (within - high) / (2.0 - high) };
        (2.0 * pair + read) * self.pitch
    }

    /// An angle at which a pulse has just begun.
    pub fn pulse_start(&self) -> f64 {
        let mut angle = self.boundary(0) + 1e-3 * self.pitch;
        for _ in 0..30 {
            angle -= self.turned(angle) - self.boundary(0) - 1e-3 * self.pitch;
        }
        angle
    }
}

/// True times of the edges of one run.
#[derive(Debug, Clone)]
pub struct Crossings<'a> {
    wheel: &'a Wheel,
    zero_angle: f64,
    sign: f64,
    next: i64,
    /// Level before the first edge.
    pub first: bool,
    /// Ascending, in s.
    pub times: Vec<f64>,
}

impl<'a> Crossings<'a> {
    /// Of a rotor that starts at `zero_angle` and turns in the sense of `sign`.
    pub fn new(wheel: &'a Wheel, zero_angle: f64, sign: f64) -> Self {
        let start = wheel.turned(zero_angle);
        let mut below = (start / wheel.pitch).floor() as i64 + 2;
        while wheel.boundary(below) > start {
            below -= 1;
        }
        let next = if sign > 0.0 { below + 1 } else { below };
        Self { wheel, zero_angle, sign, next, first: below.rem_euclid(2) == 0, times: Vec::new() }
    }

    /// Takes in one step of the rotor.
    pub fn step(&mut self, s: &Step) {
        let angle = |k: usize| self.wheel.turned(self.zero_angle + self.sign * s.angle[k]);
        let (from, to) = (angle(0), angle(1));
        while self.sign * (to - self.wheel.boundary(self.next)) >= 0.0 && to != from {
            let share = ((self.wheel.boundary(self.next) - from) / (to - from)).clamp(0.0, 1.0);
            let dt = s.t[1] - s.t[0];
            let way = share * (s.angle[1] - s.angle[0]);
            let slope = (s.speed[1] - s.speed[0]) / dt;
            // Root of way = v·τ + slope·τ²/2 in the form that does not cancel.
            let root = (s.speed[0] * s.speed[0] + 2.0 * slope * way).max(0.0).sqrt();
            let tau = if s.speed[0] + root > 0.0 { 2.0 * way / (s.speed[0] + root) } else { share * dt };
            self.times.push(s.t[0] + tau.clamp(0.0, dt));
            self.next += if self.sign > 0.0 { 1 } else { -1 };
        }
    }
}

/// How the recorder's time differs from the true one, in one run.
#[derive(Debug, Clone)]
pub struct Clock {
    scale: f64,
    drift: f64,
    seconds: f64,
    latency_s: f64,
    /// Recorded times in s behind which a word is missing.
    lost_at: Vec<f64>,
}

/// A lost word's length in samples.
const WORD: usize = 32;

impl Clock {
    /// A clock with what is hidden in it; `seed` is the run's.
    pub fn new(seconds: f64, nuisance: &Nuisance, hidden: &[Effect], seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut clock = Self {
            scale: nuisance.clock_ppm * 1e-6,
            drift: 0.0,
            seconds,
            latency_s: nuisance.latency_s,
            lost_at: Vec::new(),
        };
        for e in hidden {
            match e.name {
                "clock-error" => {
                    clock.scale += e.sign * e.size;
                    clock.drift = if e.form == "drifting" { e.sign * e.size * (e.a[0] - 0.5) } else { 0.0 };
                }
                "dropped-samples" => {
                    let words = e.size.floor() as usize + usize::from(rng.random::<f64>() < e.size.fract());
                    clock.lost_at = (0..words).map(|_| between(&mut rng, 0.1, 0.95 * seconds)).collect();
                    clock.lost_at.sort_by(f64::total_cmp);
                }
                _ => {}
            }
        }
        clock
    }

    fn recorded(&self, t: f64) -> f64 {
        t * (1.0 + self.scale + self.drift * t / self.seconds)
    }

    fn undone(&self, recorded: f64) -> f64 {
        let mut t = recorded;
        for _ in 0..4 {
            t += recorded - self.recorded(t);
        }
        t
    }

    /// True time of the rotor that a recorded time shows, `word_s` being the length of a lost word.
    pub fn shown(&self, recorded: f64, word_s: f64) -> f64 {
        let lost = self.lost_at.iter().filter(|at| **at < recorded).count();
        self.undone(recorded + lost as f64 * word_s) - self.latency_s
    }
}

/// What disturbs every record of one data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Nuisance {
    /// Standard deviation of a sample's or timestamp's time in s.
    pub jitter_s: f64,
    /// Delay of the record behind the drive in s.
    pub latency_s: f64,
    /// Standard deviation of a run's speed, relative.
    pub gain_spread: f64,
    /// Standard deviation of an edge's place in pitches.
    pub irregular: f64,
    /// What is wrong with the recorder's clock anyway, in parts per million.
    pub clock_ppm: f64,
    /// Share of the records that are cut, and how much of one at most.
    pub truncated: [f64; 2],
}

impl Nuisance {
    /// Draws them; timestamps jitter less than samples.
    pub fn draw(rng: &mut ChaCha8Rng, levels: bool) -> Self {
        Self {
            jitter_s: if levels { log_between(rng, 10e-6, 80e-6) } else { log_between(rng, 2e-6, 25e-6) },
            latency_s: between(rng, 0.05e-3, 1.2e-3),
            gain_spread: between(rng, 0.005, 0.015),
            irregular: between(rng, 0.01, 0.03),
            clock_ppm: 40.0 * normal(rng),
            truncated: [between(rng, 0.05, 0.4), 0.15],
        }
    }
}

/// Writes down one run: edges at true `times`, up to `record_s` of the recorder's time.
pub fn record(
    crossings: &Crossings,
    clock: &Clock,
    nuisance: &Nuisance,
    sample_us: Option<u64>,
    record_s: f64,
    seed: u64,
) -> Record {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let times = &crossings.times;
    let Some(period_us) = sample_us else {
        let mut out: Vec<u64> = Vec::with_capacity(times.len());
        let end_us = (record_s * 1e6) as u64;
        for t in times {
            let at = clock.recorded(t + clock.latency_s) + nuisance.jitter_s * normal(&mut rng);
            let at = ((at * 1e6).round().max(1.0) as u64).max(out.last().map_or(1, |last| last + 1));
            if at >= end_us {
                break;
            }
            out.push(at);
        }
        return Record::Edges { first: crossings.first, times_us: out, end_us };
    };
    let sample_s = period_us as f64 * 1e-6;
    let samples = (record_s / sample_s) as usize;
    let mut levels: Vec<bool> = (0..samples + clock.lost_at.len() * WORD)
        .map(|n| {
            let jitter = nuisance.jitter_s * normal(&mut rng);
            let t = clock.undone(n as f64 * sample_s) - clock.latency_s + jitter;
            crossings.first ^ (times.partition_point(|at| *at <= t) % 2 == 1)
        })
        .collect();
    for at in &clock.lost_at {
        let from = (at / sample_s) as usize;
        if from + WORD < levels.len() {
            levels.drain(from..from + WORD);
        }
    }
    levels.truncate(samples);
    Record::Levels { period_us, levels }
}

/// Recorded edge times in s, as someone reading the file would place them.
pub fn edge_times(record: &Record) -> Vec<f64> {
    match record {
        Record::Levels { period_us, levels } => (1..levels.len())
            .filter(|n| levels[*n] != levels[n - 1])
            .map(|n| (n as f64 - 0.5) * *period_us as f64 * 1e-6)
            .collect(),
        Record::Edges { times_us, .. } => times_us.iter().map(|t| *t as f64 * 1e-6).collect(),
        Record::Control { .. } => Vec::new(),
    }
}

/// Collects travelled angles every [`GRID_S`] of true time.
#[derive(Debug, Clone, Default)]
pub struct Grid {
    /// Angles in rad.
    pub angles: Vec<f64>,
}

impl Grid {
    /// Takes in one step of the rotor.
    pub fn step(&mut self, s: &Step) {
        let dt = s.t[1] - s.t[0];
        loop {
            let tau = self.angles.len() as f64 * GRID_S - s.t[0];
            if tau > dt {
                break;
            }
            let tau = tau.max(0.0);
            self.angles.push(s.angle[0] + (s.speed[0] + 0.5 * (s.speed[1] - s.speed[0]) / dt * tau) * tau);
        }
    }
}
