//! The encoder's wheel on the shaft, its edges, and what the recorder writes of them.

use super::bench::Bench;
use super::effects::Effect;
use super::motor::Step;
use super::smooth::{Ring, normal};
use crate::folder::Record;
use crate::profile::random::Dice;
use std::f64::consts::TAU;

/// The wheel: where its edges are and how it sits.
#[derive(Debug, Clone)]
pub struct Wheel {
    /// Angle between edges in rad, were they even.
    pub pitch: f64,
    irregular: Vec<f64>,
    /// Distances off the centre over the radius, where they show, and the tilts over them.
    seats: Vec<[f64; 4]>,
    /// How much wider high slots are than a pitch, and by how much that varies round the wheel.
    excess: [f64; 2],
    varying: Option<Ring>,
}

impl Wheel {
    /// A wheel with what is hidden in it.
    pub fn new(bench: &Bench, hidden: &[Effect], dice: &mut Dice) -> Self {
        let mut wheel = Self {
            pitch: TAU / bench.edges as f64,
            irregular: (0..bench.edges).map(|_| bench.irregular * normal(dice).clamp(-3.0, 3.0)).collect(),
            seats: Vec::new(),
            excess: [0.0; 2],
            varying: None,
        };
        for e in hidden {
            match (e.name, e.form) {
                ("encoder-eccentricity", form) => {
                    let tilt = if form == "off centre" { 0.0 } else { e.even(1, 0.1, 0.5) };
                    wheel.seats.push([e.size, TAU * e.knob[0], tilt, TAU * e.knob[2]]);
                }
                ("unequal-edges", form) => {
                    let varying = if form == "even round the wheel" { 0.0 } else { 0.25 };
                    (wheel.excess, wheel.varying) = ([e.size, varying * e.size], Some(e.ring.clone()));
                }
                _ => {}
            }
        }
        wheel
    }

    /// What passes the reading head at a shaft's angle: a circle seen from beside its centre.
    fn seated(&self, angle: f64) -> f64 {
        let error = |[off, at, tilt, tilted]: &[f64; 4]| {
            (off * (angle - at).sin()).asin() + off * tilt * (2.0 * angle - tilted).sin()
        };
        angle + self.seats.iter().map(error).sum::<f64>()
    }

    fn excess(&self, pair: i64) -> f64 {
        let angle = pair as f64 * 2.0 * self.pitch;
        self.excess[0] + self.varying.as_ref().map_or(0.0, |r| self.excess[1] * r.at(angle).clamp(-2.0, 2.0))
    }

    /// Place of edge `n` on the wheel in rad; slots from even edges on are high.
    fn edge(&self, n: i64) -> f64 {
        let own = self.irregular[n.rem_euclid(self.irregular.len() as i64) as usize];
        let wide = if n.rem_euclid(2) == 1 { self.excess(n.div_euclid(2)) } else { 0.0 };
        (n as f64 + own + wide) * self.pitch
    }

    /// The angle that a reader takes who knows nothing of the wheel's errors; the irregularity is left out.
    pub fn read(&self, angle: f64) -> f64 {
        let x = self.seated(angle) / self.pitch;
        let pair = (0.5 * x).floor();
        let high = 1.0 + self.excess(pair as i64);
        let within = x - 2.0 * pair;
        let read = if within < high { within / high } else { 1.0 + (within - high) / (2.0 - high) };
        (2.0 * pair + read) * self.pitch
    }
}

/// Edges that pass the head during one run.
#[derive(Debug, Clone)]
pub struct Edges<'a> {
    wheel: &'a Wheel,
    /// The last edge below the head.
    below: i64,
    seated: f64,
    /// Level at first.
    pub first: bool,
    /// Times in s, ascending.
    pub times: Vec<f64>,
}

impl<'a> Edges<'a> {
    /// Of a shaft that starts at an angle.
    pub fn new(wheel: &'a Wheel, angle: f64) -> Self {
        let seated = wheel.seated(angle);
        let mut below = (seated / wheel.pitch).floor() as i64 + 2;
        while wheel.edge(below) > seated {
            below -= 1;
        }
        Self { wheel, below, seated, first: below.rem_euclid(2) == 0, times: Vec::new() }
    }

    /// Takes in one step of the rotor.
    pub fn step(&mut self, step: &Step) {
        if step.angle[0] == step.angle[1] {
            return;
        }
        let to = self.wheel.seated(step.angle[1]);
        loop {
            let up = self.wheel.edge(self.below + 1);
            let down = self.wheel.edge(self.below);
            if to >= up {
                self.passed(step, to, up);
                self.below += 1;
            } else if to < down {
                self.passed(step, to, down);
                self.below -= 1;
            } else {
                break;
            }
        }
        self.seated = to;
    }

    /// Finds when `edge` passes: false position on the cubic of the step, halving the share of an end that stays.
    fn passed(&mut self, step: &Step, to: f64, edge: f64) {
        let (mut a, mut b) = ((0.0, self.seated - edge), (1.0, to - edge));
        let mut kept = 0;
        let mut share = 1.0;
        for _ in 0..12 {
            if (b.1 - a.1).abs() < 1e-15 {
                break;
            }
            share = (b.0 - b.1 * (b.0 - a.0) / (b.1 - a.1)).clamp(0.0, 1.0);
            let off = self.wheel.seated(step.angle_at(share)) - edge;
            if off.abs() < 1e-7 * self.wheel.pitch {
                break;
            }
            if (off > 0.0) == (b.1 > 0.0) {
                b = (share, off);
                a.1 *= if kept == 1 { 0.5 } else { 1.0 };
                kept = 1;
            } else {
                a = (share, off);
                b.1 *= if kept == -1 { 0.5 } else { 1.0 };
                kept = -1;
            }
        }
        self.times.push(step.t[0] + share * (step.t[1] - step.t[0]));
    }
}

/// Samples that go missing together.
const WORD: usize = 32;
/// Sampling period of levels in s.
const SAMPLE_S: f64 = 1e-3;

/// The recorder of one run.
#[derive(Debug, Clone)]
pub struct Recorder<'a> {
    bench: &'a Bench,
    hidden: &'a [Effect],
    seconds: f64,
    /// Samples at which a word is missing.
    lost: Vec<usize>,
    /// Length of the record in s of its own clock.
    pub record_s: f64,
}

impl<'a> Recorder<'a> {
    /// Of a run of `seconds`.
    pub fn new(bench: &'a Bench, hidden: &'a [Effect], seconds: f64, dice: &mut Dice) -> Self {
        let early = if dice.chance(bench.ends_early) { dice.even(0.02, 0.2) } else { 0.0 };
        let record_s = (seconds + dice.even(0.03, 0.4)) * (1.0 - early);
        let mut lost = Vec::new();
        for e in hidden.iter().filter(|e| e.name == "dropped-samples") {
            let in_one = if e.form == "bursts" { dice.whole(2, 3) } else { 1 };
            let events = e.size / in_one as f64;
            let events = events.floor() as usize + usize::from(dice.chance(events.fract()));
            for _ in 0..events {
                let at = (dice.even(0.03, 0.92) * record_s / SAMPLE_S) as usize;
                lost.extend(std::iter::repeat_n(at, in_one));
            }
        }
        lost.sort_unstable();
        Self { bench, hidden, seconds, lost, record_s }
    }

    /// Recorded time of a true one in s.
    fn clock(&self, t: f64) -> f64 {
        let wrong: f64 = self.hidden.iter().map(|e| e.clock(t / self.seconds)).sum();
        t * (1.0 + self.bench.crystal + wrong)
    }

    fn undone(&self, recorded: f64) -> f64 {
        let mut t = recorded;
        for _ in 0..5 {
            t += recorded - self.clock(t);
        }
        t
    }

    /// True time in s that is seen at a recorded one.
    pub fn seen(&self, recorded: f64) -> f64 {
        let gone = self.lost.iter().filter(|at| **at as f64 * SAMPLE_S <= recorded).count() * WORD;
        self.undone(recorded + gone as f64 * SAMPLE_S) - self.bench.latency_s
    }

    /// The file of a run whose edges pass at `times`.
    pub fn write(&self, first: bool, times: &[f64], dice: &mut Dice) -> Record {
        let jitter = self.bench.jitter_s;
        if self.bench.levels {
            let samples = (self.record_s / SAMPLE_S) as usize;
            let seen = |n: usize| self.seen(n as f64 * SAMPLE_S);
            let level = |t: f64| first ^ (times.partition_point(|at| *at <= t) % 2 == 1);
            let levels = (0..samples).map(|n| level(seen(n) + jitter * normal(dice))).collect();
            return Record::Levels { period_us: 1000, levels };
        }
        let end_us = (self.record_s * 1e6) as u64;
        let step = self.bench.stamp_us;
        let mut times_us: Vec<u64> = Vec::with_capacity(times.len());
        for t in times {
            let at = self.clock(t + self.bench.latency_s) + jitter * normal(dice);
            let stamp = (at * 1e6).max(0.0) as u64 / step * step;
            let stamp = stamp.max(times_us.last().map_or(1, |last| last + 1));
            if stamp >= end_us {
                break;
            }
            times_us.push(stamp);
        }
        Record::Edges { first, times_us, end_us }
    }
}

/// Recorded edge times in s, as someone reading the file would place them.
pub fn edge_times(record: &Record) -> Vec<f64> {
    match record {
        Record::Levels { levels, .. } => {
            (1..levels.len()).filter(|n| levels[*n] != levels[n - 1]).map(|n| (n as f64 - 0.5) * SAMPLE_S).collect()
        }
        Record::Edges { times_us, .. } => times_us.iter().map(|t| *t as f64 * 1e-6).collect(),
        Record::Control { .. } => Vec::new(),
    }
}
