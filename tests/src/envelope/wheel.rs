//! The encoder's wheel and the recorder behind it.

use super::bench::{Bench, normal};
use super::effects::Effect;
use super::ride::CELL_S;
use crate::folder::Record;
use crate::profile::random::Dice;
use std::f64::consts::TAU;

/// Samples in a word of the recorder.
const WORD: usize = 32;
/// How far back, in pitches, the rotor must turn for the comparator to fall back: more than the bristles spring by when a pulse
/// ends, a quarter of a pitch of the finest wheel.
const HYSTERESIS: f64 = 0.35;
/// Spacing of levels in s.
const SAMPLE_S: f64 = 1e-3;

/// The wheel: where its edges are and how it sits.
#[derive(Debug, Clone)]
pub struct Wheel<'a> {
    /// Angle between edges in rad, were they even.
    pub pitch: f64,
    places: Vec<f64>,
    hidden: &'a [Effect],
}

impl<'a> Wheel<'a> {
    /// A wheel with what is hidden in it.
    pub fn new(bench: &Bench, hidden: &'a [Effect], dice: &mut Dice) -> Self {
        let pitch = TAU / bench.edges as f64;
        let mut new = Self { pitch, places: Vec::new(), hidden };
        new.places = (0..bench.edges)
            .map(|n| {
                let odd = if n % 2 == 1 { new.excess(n as f64 * pitch) } else { 0.0 };
                (n as f64 + odd + bench.irregular * dice.even(-1.0, 1.0)) * pitch
            })
            .collect();
        new
    }

    /// By how many pitches a high slot is wider than a low one, at an angle of the wheel.
    fn excess(&self, angle: f64) -> f64 {
        self.hidden.iter().map(|e| e.slot_excess(angle)).sum()
    }

    /// What the wheel shows of a shaft's angle.
    fn seated(&self, angle: f64) -> f64 {
        angle + self.hidden.iter().map(|e| e.seat(angle)).sum::<f64>()
    }

    fn place(&self, n: i64) -> f64 {
        let round = self.places.len() as i64;
        self.places[n.rem_euclid(round) as usize] + n.div_euclid(round) as f64 * TAU
    }

    /// The angle that somebody reads who takes every slot for even; the irregularity is left out, which is noise.
    pub fn read(&self, angle: f64) -> f64 {
        let seated = self.seated(angle);
        let x = seated / self.pitch;
        let within = x.rem_euclid(2.0);
        let high = 1.0 + self.excess(seated);
        let even = if within < high { within / high } else { 2.0 - (2.0 - within) / (2.0 - high) };
        (x - within + even) * self.pitch
    }

    /// The level at first, and the times at which a shaft passes edges that is at `angles`, one a cell.
    pub fn passed(&self, angles: &[f64]) -> (bool, Vec<f64>) {
        let seated: Vec<f64> = angles.iter().map(|a| self.seated(*a)).collect();
        let start = seated.first().copied().unwrap_or(0.0);
        // The slot begins with the edge below.
        let mut slot = (start / self.pitch).floor() as i64 + 2;
        while self.place(slot) > start {
            slot -= 1;
        }
        let first = slot.rem_euclid(2) == 0;
        let mut times = Vec::new();
        for (n, pair) in seated.windows(2).enumerate() {
            let mut pass = |edge: f64| {
                let share = ((edge - pair[0]) / (pair[1] - pair[0])).clamp(0.0, 1.0);
                times.push((n as f64 + share) * CELL_S);
            };
            while pair[1] >= self.place(slot + 1) {
                slot += 1;
                pass(self.place(slot));
            }
            while pair[1] < self.place(slot) - HYSTERESIS * self.pitch {
                pass(self.place(slot) - HYSTERESIS * self.pitch);
                slot -= 1;
            }
        }
        (first, times)
    }
}

/// A run's recorder: its clock, its delay and the words it loses.
#[derive(Debug, Clone)]
pub struct Recorder<'a> {
    bench: &'a Bench,
    hidden: &'a [Effect],
    seconds: f64,
    /// Recorded samples at which a word is missing.
    lost: Vec<usize>,
    /// Length of the record in s of its own clock.
    pub record_s: f64,
}

impl<'a> Recorder<'a> {
    /// The recorder of one run of `seconds` of drive.
    pub fn new(bench: &'a Bench, hidden: &'a [Effect], seconds: f64, dice: &mut Dice) -> Self {
        let short = if dice.chance(bench.ends_early) { dice.even(0.03, 0.25) } else { 0.0 };
        let record_s = (seconds + dice.even(0.05, 0.5)) * (1.0 - short);
        let mut lost: Vec<usize> =
            hidden.iter().flat_map(|e| e.lost(dice)).map(|share| (share * record_s / SAMPLE_S) as usize).collect();
        lost.sort_unstable();
        Self { bench, hidden, seconds, lost, record_s }
    }

    /// What the recorder's clock shows at a true time.
    fn clock(&self, t: f64) -> f64 {
        t * (1.0 + self.bench.clock) + self.hidden.iter().map(|e| e.clock(t, self.seconds)).sum::<f64>()
    }

    /// True time that is seen at a recorded one.
    pub fn seen(&self, recorded: f64) -> f64 {
        let gone = self.lost.iter().filter(|n| **n as f64 * SAMPLE_S <= recorded).count() * WORD;
        let shown = recorded + gone as f64 * SAMPLE_S;
        let mut t = shown;
        // The clock errs by some per cent: each round leaves as much of what was left.
        for _ in 0..6 {
            t += shown - self.clock(t);
        }
        t - self.bench.latency_s
    }

    /// The file of a run whose edges come at `times`.
    pub fn write(&self, first: bool, times: &[f64], dice: &mut Dice) -> Record {
        let jitter = self.bench.jitter_s;
        if self.bench.levels {
            let samples = (self.record_s / SAMPLE_S) as usize;
            let mut levels = Vec::with_capacity(samples);
            for n in 0..samples {
                let t = self.seen(n as f64 * SAMPLE_S) + jitter * normal(dice);
                levels.push(first ^ (times.partition_point(|at| *at <= t) % 2 == 1));
            }
            return Record::Levels { period_us: 1000, levels };
        }
        let end_us = (self.record_s * 1e6) as u64;
        let mut times_us: Vec<u64> = Vec::with_capacity(times.len());
        for t in times {
            let at = self.clock(t + self.bench.latency_s) + jitter * normal(dice);
            let at = ((at * 1e6).max(1.0) as u64).max(times_us.last().map_or(1, |l| l + 1));
            if at < end_us {
                times_us.push(at);
            }
        }
        Record::Edges { first, times_us, end_us }
    }
}
