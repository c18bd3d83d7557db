//! The experiment: which runs are made in which order, and how well they repeat and are recorded.

use crate::drive::Drive;
use crate::profile::random::Dice;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Seconds of drive in all runs of an experiment: what is simulated within some seconds.
const MOST_S: f64 = 160.0;

/// One run of the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Planned {
    /// How it is driven.
    pub drive: Drive,
    /// Pause behind it in s.
    pub pause_s: f64,
    /// Its file is there.
    pub kept: bool,
    /// Its own factor on the speed.
    pub gain: f64,
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
    /// The runs go up the duties.
    pub sorted: bool,
    /// Deviation of the runs' gains, and how much of it one run leaves to the next.
    pub spread: [f64; 2],
    /// Deviation of a sample's or an edge's time in s.
    pub jitter_s: f64,
    /// Delay of the record in s.
    pub latency_s: f64,
    /// Largest error of a slot's place in pitches.
    pub irregular: f64,
    /// Relative error of the recorder's clock.
    pub clock: f64,
    /// Deviation of the contact's friction within a run, and for how long it stays in s.
    pub rough: [f64; 2],
    /// Probability that a record ends early.
    pub ends_early: f64,
}

impl Bench {
    /// Draws one for a motor of `full` rad/s: 6–60 runs of 1–10 s.
    pub fn draw(dice: &mut Dice, full: f64) -> Self {
        let edges = (200.0 * dice.decade(1.0, 4096.0 / 200.0) / 2.0).round() as usize * 2;
        // Where an edge comes within three samples, some would be lost at the speed's peaks.
        let levels = edges as f64 * full / TAU < 300.0 && dice.chance(0.75);
        let duties = duties(dice);
        let both = dice.chance(0.6);
        let main = dice.pick(&[50.0, 80.0]);
        let frequencies = if dice.chance(0.25) { vec![main, 130.0 - main] } else { vec![main] };
        let spread = [dice.decade(0.002, 0.02), if dice.chance(0.35) { dice.even(0.2, 0.6) } else { 0.0 }];
        let kinds = duties.len() * frequencies.len() * if both { 2 } else { 1 };
        let trials = dice.whole(1, 6).clamp(6_usize.div_ceil(kinds), (60 / kinds).max(1));
        let seconds = dice.decade(1.0, 10.0).min(MOST_S / (kinds * trials) as f64).max(1.0);
        let (order, mut plan) = planned(dice, &duties, both, &frequencies, trials, (10.0 * seconds).round() / 10.0);
        plan.truncate(60);
        let losing = dice.chance(0.4);
        let mut last = 0.0;
        for run in &mut plan {
            run.kept = !(losing && dice.chance(0.15));
            last = spread[1] * last + (1.0 - spread[1] * spread[1]).sqrt() * normal(dice);
            run.gain = 1.0 + spread[0] * last;
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
            sorted: order == 0,
            spread,
            jitter_s: if levels { dice.decade(10e-6, 80e-6) } else { dice.decade(1e-6, 25e-6) },
            latency_s: dice.even(0.0, 0.8e-3),
            irregular: dice.even(0.003, 0.02),
            clock: 12e-6 * normal(dice),
            rough: [dice.even(0.005, 0.03), dice.decade(5e-3, 0.1)],
            ends_early: dice.even(0.0, 0.25),
        }
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        let flag = |is| f64::from(u8::from(is));
        [
            ("edges_per_rev", self.edges as f64),
            ("runs", self.plan.iter().filter(|r| r.kept).count() as f64),
            ("seconds", self.plan.first().map_or(0.0, |r| r.drive.seconds)),
            ("duties", self.duties as f64),
            ("directions", 1.0 + flag(self.both)),
            ("pwm_frequencies", self.frequencies as f64),
            ("levels", flag(self.levels)),
            ("sorted", flag(self.sorted)),
            ("gain_spread", self.spread[0]),
            ("gain_kept_from_run_to_run", self.spread[1]),
            ("slot_error_pitches", self.irregular),
            ("clock_error", self.clock),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// Whether the plan could show an effect: it varies what the effect hangs on.
    pub fn could_show(&self, name: &str) -> bool {
        let runs = self.plan.iter().filter(|r| r.kept).count();
        match name {
            "direction-asymmetry" | "outside-heading-drift" => self.both,
            "dropped-samples" => self.levels,
            "dead-zone" | "high-duty-saturation" | "supply-sag" | "contact-stiffening" => self.duties >= 4,
            "duty-quantisation" | "outside-driver-resonance" => self.duties >= 5,
            "run-in-wear" => runs >= 10,
            // What comes and goes between runs is told from their gains by many of them.
            "outside-weather" | "outside-changed-part" => runs >= 12 && !self.sorted,
            _ => true,
        }
    }
}

/// Near enough to a normal deviate of deviation 1: three even ones, so never beyond 3.
pub fn normal(dice: &mut Dice) -> f64 {
    (0..3).map(|_| dice.even(-1.0, 1.0)).sum()
}

/// On fractions: evenly spaced percents, steps of a power of two, or drawn at random and kept apart.
fn duties(dice: &mut Dice) -> Vec<f64> {
    let n = dice.whole(3, 12);
    let even = |k: usize| k as f64 / (n - 1) as f64;
    let mut list: Vec<f64> = match dice.whole(0, 2) {
        0 => {
            let (low, high) = (dice.even(0.08, 0.25), dice.even(0.8, 1.0));
            (0..n).map(|k| ((low + (high - low) * even(k)) * 100.0).round() / 100.0).collect()
        }
        1 => {
            let steps = dice.pick(&[32.0, 64.0, 128.0]);
            let low = dice.even(0.06, 0.2);
            (0..n).map(|k| ((low + (1.0 - low) * even(k)) * steps).round() / steps).collect()
        }
        _ => {
            let mut drawn: Vec<f64> =
                (0..n).map(|k| (0.1 + 0.9 * (k as f64 + dice.even(0.0, 0.9)) / n as f64).min(1.0)).collect();
            drawn.iter_mut().for_each(|u| *u = (*u * 250.0).round() / 250.0);
            drawn
        }
    };
    list.dedup();
    list
}

/// Runs in order: by duty (0), by duty within each round (1), or anyhow (2, 3).
fn planned(
    dice: &mut Dice,
    duties: &[f64],
    both: bool,
    frequencies: &[f64],
    trials: usize,
    seconds: f64,
) -> (usize, Vec<Planned>) {
    let order = dice.whole(0, 3);
    let signs = if !both { vec![dice.pick(&[1.0, -1.0])] } else { vec![1.0, -1.0] };
    let longest = dice.decade(2.0, 120.0);
    let mut all: Vec<(usize, Planned)> = Vec::new();
    for trial in 0..trials {
        for pwm_hz in frequencies {
            for duty in duties {
                for sign in &signs {
                    let drive = Drive { duty: *duty, sign: *sign, pwm_hz: *pwm_hz, seconds };
                    let pause_s = dice.decade(0.5, longest);
                    all.push((trial, Planned { drive, pause_s, kept: true, gain: 1.0 }));
                }
            }
        }
    }
    match order {
        0 => all.sort_by(|a, b| a.1.drive.duty.total_cmp(&b.1.drive.duty)),
        1 => all.sort_by(|a, b| {
            (a.0, a.1.drive.duty).partial_cmp(&(b.0, b.1.drive.duty)).unwrap_or(std::cmp::Ordering::Equal)
        }),
        _ => (1..all.len()).rev().for_each(|i| all.swap(i, dice.whole(0, i))),
    }
    (order, all.into_iter().map(|(_, run)| run).collect())
}
