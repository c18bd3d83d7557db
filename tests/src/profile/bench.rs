//! The bench: which runs are made, the encoder on the shaft, and what the recorder writes down.

use super::course::CELL_S;
use super::effects::Effect;
use super::random::Dice;
use crate::drive::Drive;
use crate::folder::Record;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// One run of the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Planned {
    /// How it is driven.
    pub drive: Drive,
    /// Pause behind it in s.
    pub pause_s: f64,
    /// Its file is there.
    pub kept: bool,
}

/// Experiment and recorder of one data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Bench {
    /// Edges a revolution.
    pub edges: usize,
    /// Levels every millisecond; otherwise timestamped edges.
    pub levels: bool,
    /// Runs in the order they are made in.
    pub plan: Vec<Planned>,
    /// Different on fractions.
    pub duties: usize,
    /// Both directions are run.
    pub both: bool,
    /// Different PWM frequencies.
    pub frequencies: usize,
    /// Largest error of a sample's time in s, evenly distributed.
    pub jitter_s: f64,
    /// Delay of the record in s, and how much it differs between runs.
    pub latency_s: [f64; 2],
    /// Deviation of a run's speed.
    pub spread: f64,
    /// Its distribution has heavy tails.
    pub heavy: bool,
    /// Deviation of an edge's place in pitches; neighbours go together.
    pub irregular: f64,
    /// Relative error of the recorder's clock.
    pub clock: f64,
    /// Probability that a record ends early.
    pub ends_early: f64,
}

impl Bench {
    /// Draws one for a motor of `full` rad/s: 6–60 runs of 1–10 s.
    pub fn draw(dice: &mut Dice, full: f64) -> Self {
        let per_turn = [200, 300, 400, 500, 600, 900, 1000, 1200, 2000, 2500, 3600, 4096];
        // A pulse shorter than three samples is lost now and then.
        let samplable: Vec<usize> = per_turn.into_iter().filter(|e| *e as f64 * full / TAU < 290.0).collect();
        let levels = !samplable.is_empty() && dice.chance(0.55);
        let edges = if levels { dice.pick(&samplable) } else { dice.pick(&per_turn) };
        let duties = duties(dice);
        let both = dice.chance(0.65);
        let main = dice.pick(&[50.0, 80.0, 100.0]);
        let other = dice.pick(&[50.0, 80.0, 100.0]);
        let frequencies = if other != main && dice.chance(0.3) { vec![main, other] } else { vec![main] };
        let kinds = duties.len() * frequencies.len() * if both { 2 } else { 1 };
        let trials = dice.whole(1, 5).clamp(6_usize.div_ceil(kinds), (60 / kinds).max(1));
        let seconds = dice.decade(1.0, 10.0).min(280.0 / (kinds * trials) as f64).max(1.0);
        let mut plan = arranged(dice, &duties, both, &frequencies, trials, (seconds * 4.0).round() / 4.0);
        plan.truncate(60);
        let losing = dice.chance(0.35);
        for run in &mut plan {
            run.kept = !(losing && dice.chance(0.12));
        }
        if plan.iter().filter(|r| r.kept).count() < 6 {
            plan.iter_mut().for_each(|r| r.kept = true);
        }
        Self {
            edges,
            levels,
            plan,
            duties: duties.len(),
            both,
            frequencies: frequencies.len(),
            jitter_s: if levels { dice.even(20e-6, 120e-6) } else { dice.even(3e-6, 40e-6) },
            latency_s: [dice.even(0.0, 1.0e-3), dice.even(0.0, 60e-6)],
            spread: dice.even(0.005, 0.014),
            heavy: dice.chance(0.5),
            irregular: dice.even(0.01, 0.03),
            clock: 30e-6 * dice.box_shaped(),
            ends_early: dice.even(0.0, 0.3),
        }
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("edges_per_rev", self.edges as f64),
            ("runs", self.plan.iter().filter(|r| r.kept).count() as f64),
            ("seconds", self.plan.first().map_or(0.0, |r| r.drive.seconds)),
            ("duties", self.duties as f64),
            ("directions", if self.both { 2.0 } else { 1.0 }),
            ("pwm_frequencies", self.frequencies as f64),
            ("levels", f64::from(u8::from(self.levels))),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// Whether the plan could show an effect.
    pub fn could_show(&self, name: &str) -> bool {
        match name {
            "direction-asymmetry" | "outside-memory" => self.both,
            "dropped-samples" => self.levels,
            "dead-zone" | "high-duty-saturation" | "supply-sag" | "contact-stiffening" => self.duties >= 4,
            "duty-quantisation" | "outside-notch" => self.duties >= 5,
            "start-delay" | "stribeck-friction" => self.duties >= 3,
            "run-in-wear" | "outside-days" => self.plan.iter().filter(|r| r.kept).count() >= 10,
            _ => true,
        }
    }
}

/// On fractions: sixteenths, percents, or closer together at the low end.
fn duties(dice: &mut Dice) -> Vec<f64> {
    let n = dice.whole(3, 12);
    let mut list: Vec<f64> = match dice.whole(0, 2) {
        0 => {
            let from = dice.whole(1, 3) as f64;
            (0..n).map(|k| ((from + (16.0 - from) * k as f64 / (n - 1) as f64).round()) / 16.0).collect()
        }
        1 => {
            let (low, high) = (dice.even(0.05, 0.2), dice.even(0.85, 1.0));
            (0..n).map(|k| ((low + (high - low) * k as f64 / (n - 1) as f64) * 100.0).round() / 100.0).collect()
        }
        _ => {
            let low: f64 = dice.even(0.06, 0.15);
            (0..n).map(|k| (low.powf(1.0 - k as f64 / (n - 1) as f64) * 200.0).round() / 200.0).collect()
        }
    };
    list.dedup();
    list
}

/// The order: shuffled throughout, shuffled within each trial, or up the duties and down again.
fn arranged(
    dice: &mut Dice,
    duties: &[f64],
    both: bool,
    frequencies: &[f64],
    trials: usize,
    seconds: f64,
) -> Vec<Planned> {
    let manner = dice.whole(0, 3);
    let mut all = Vec::new();
    for trial in 0..trials {
        let mut part = Vec::new();
        for pwm_hz in frequencies {
            for duty in duties {
                for sign in if both { &[1.0, -1.0][..] } else { &[1.0][..] } {
                    let drive = Drive { duty: *duty, sign: *sign, pwm_hz: *pwm_hz, seconds };
                    part.push(Planned { drive, pause_s: dice.decade(1.0, 20.0), kept: true });
                }
            }
        }
        if manner == 1 {
            shuffle(dice, &mut part);
        } else if trial % 2 == 1 {
            part.reverse();
        }
        all.extend(part);
    }
    if manner >= 2 {
        shuffle(dice, &mut all);
    }
    all
}

fn shuffle(dice: &mut Dice, of: &mut [Planned]) {
    for i in (1..of.len()).rev() {
        of.swap(i, dice.whole(0, i));
    }
}

/// The disc: angles of its edges over a turn, and the error of its seat.
#[derive(Debug, Clone)]
pub struct Disc {
    /// Angle between edges in rad, were they even.
    pub pitch: f64,
    places: Vec<f64>,
    seat: Vec<Effect>,
    excess: f64,
}

impl Disc {
    /// A disc with what is hidden in it.
    pub fn new(bench: &Bench, hidden: &[Effect], dice: &mut Dice) -> Self {
        let pitch = TAU / bench.edges as f64;
        let excess: f64 = hidden.iter().filter(|e| e.name == "unequal-edges").map(|e| e.size).sum();
        // Neighbours go together: a first-order process run twice round, so that it closes.
        let keep: f64 = 0.5;
        let mut x = 0.0;
        let mut error = vec![0.0; bench.edges];
        for n in 0..2 * bench.edges {
            x = keep * x + (1.0 - keep * keep).sqrt() * dice.box_shaped();
            error[n % bench.edges] = x;
        }
        let odd = |n: usize| if n % 2 == 1 { excess } else { 0.0 };
        let places = error.iter().enumerate().map(|(n, x)| (n as f64 + odd(n) + bench.irregular * x) * pitch).collect();
        let seat = hidden.iter().filter(|e| e.name == "encoder-eccentricity").cloned().collect();
        Self { pitch, places, seat, excess }
    }

    /// What the disc shows of a shaft's angle.
    fn seated(&self, angle: f64) -> f64 {
        let error = |e: &Effect| {
            let first = e.periodic.lowest();
            // The wanted size is that of the first harmonic; the others weigh a third of what was drawn.
            let pure = first * (angle + 1.0).sin();
            e.size * ((e.periodic.at(angle) - pure) * 0.3 + pure) / first
        };
        angle + self.seat.iter().map(error).sum::<f64>()
    }

    fn place(&self, n: i64) -> f64 {
        let turns = n.div_euclid(self.places.len() as i64);
        self.places[n.rem_euclid(self.places.len() as i64) as usize] + turns as f64 * TAU
    }

    /// The angle that a reader without knowledge of the disc's errors takes; the irregularity is left out.
    pub fn read(&self, angle: f64) -> f64 {
        let x = self.seated(angle) / self.pitch;
        let slot = x.rem_euclid(2.0);
        let wide = 1.0 + self.excess;
        let even = if slot < wide { slot / wide } else { 2.0 - (2.0 - slot) / (2.0 - wide) };
        (x - slot + even) * self.pitch
    }

    /// Times at which a shaft, starting at `zero` and followed cell by cell, passes edges; and the level at first.
    pub fn passed(&self, angles: &[f64], zero: f64, sign: f64) -> (bool, Vec<f64>) {
        let start = self.seated(zero);
        let mut n = (start / self.pitch).floor() as i64 - 2;
        while self.place(n + 1) <= start {
            n += 1;
        }
        let first = n.rem_euclid(2) == 0;
        let mut next = if sign > 0.0 { n + 1 } else { n };
        let mut times = Vec::new();
        let mut from = start;
        for (k, angle) in angles.iter().enumerate().skip(1) {
            let to = self.seated(zero + sign * angle);
            while sign * (to - self.place(next)) >= 0.0 && to != from {
                let share = ((self.place(next) - from) / (to - from)).clamp(0.0, 1.0);
                times.push((k as f64 - 1.0 + share) * CELL_S);
                next += if sign > 0.0 { 1 } else { -1 };
            }
            from = to;
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
    latency_s: f64,
    /// Recorded samples at which a word is missing.
    lost: Vec<usize>,
    /// Length of the record in s of its own clock.
    pub record_s: f64,
}

const WORD: usize = 32;
const SAMPLE_S: f64 = 1e-3;

impl<'a> Recorder<'a> {
    /// The recorder of one run.
    pub fn new(bench: &'a Bench, hidden: &'a [Effect], seconds: f64, dice: &mut Dice) -> Self {
        let early = if dice.chance(bench.ends_early) { dice.even(0.02, 0.2) } else { 0.0 };
        let record_s = (seconds + dice.even(0.02, 0.4)) * (1.0 - early);
        let latency_s = bench.latency_s[0] + bench.latency_s[1] * dice.even(-1.0, 1.0);
        let mut lost = Vec::new();
        for e in hidden.iter().filter(|e| e.name == "dropped-samples") {
            // About `size` words a run: a whole number on either side of it.
            let words = e.size.floor() + f64::from(u8::from(dice.chance(e.size.fract())));
            lost.extend((0..words as usize).map(|_| (dice.even(0.05, 0.9) * record_s / SAMPLE_S) as usize));
        }
        lost.sort_unstable();
        Self { bench, hidden, seconds, latency_s, lost, record_s }
    }

    /// Recorded time of a true one: the integral of the clock's rate.
    fn clock(&self, t: f64) -> f64 {
        let half = |e: &Effect| {
            0.5 * (e.clock(0.0, self.seconds) + e.clock(t, self.seconds)) * 0.4 + 0.6 * e.clock(0.5 * t, self.seconds)
        };
        t * (1.0 + self.bench.clock + self.hidden.iter().map(half).sum::<f64>())
    }

    fn undone(&self, recorded: f64) -> f64 {
        let mut t = recorded;
        for _ in 0..5 {
            t += recorded - self.clock(t);
        }
        t
    }

    /// True time that is seen at a recorded one.
    pub fn seen(&self, recorded: f64) -> f64 {
        let gone = self.lost.iter().filter(|at| **at as f64 * SAMPLE_S <= recorded).count() * WORD;
        self.undone(recorded + gone as f64 * SAMPLE_S) - self.latency_s
    }

    /// The file of a run whose edges come at `times`.
    pub fn write(&self, first: bool, times: &[f64], dice: &mut Dice) -> Record {
        let jitter = self.bench.jitter_s;
        if self.bench.levels {
            let samples = (self.record_s / SAMPLE_S) as usize;
            let mut levels = Vec::with_capacity(samples);
            for n in 0..samples {
                let t = self.seen(n as f64 * SAMPLE_S) + dice.even(-jitter, jitter);
                levels.push(first ^ (times.partition_point(|at| *at <= t) % 2 == 1));
            }
            return Record::Levels { period_us: 1000, levels };
        }
        let end_us = (self.record_s * 1e6) as u64;
        let mut times_us: Vec<u64> = Vec::with_capacity(times.len());
        for t in times {
            let at = self.clock(t + self.latency_s) + dice.even(-jitter, jitter);
            let at = ((at * 1e6).max(1.0) as u64).max(times_us.last().map_or(1, |l| l + 1));
            if at < end_us {
                times_us.push(at);
            }
        }
        Record::Edges { first, times_us, end_us }
    }
}
