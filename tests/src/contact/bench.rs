//! The bench: which runs are made in which order, the encoder's edges, and what the recorder is like.

use super::smooth::normal;
use crate::drive::Drive;
use crate::profile::random::Dice;
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

/// In which order the runs are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// At random.
    Random,
    /// Round by round, each up the duties.
    Rounds,
    /// Up the duties once, with all repetitions of each.
    Sorted,
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
    /// How that order came.
    pub order: Order,
    /// Different on fractions.
    pub duties: usize,
    /// Both directions are run.
    pub both: bool,
    /// Different PWM frequencies.
    pub frequencies: usize,
    /// Deviation of a sample's or timestamp's time in s.
    pub jitter_s: f64,
    /// Steps of a timestamp in µs.
    pub stamp_us: u64,
    /// Delay of the record behind the drive in s.
    pub latency_s: f64,
    /// Deviation of a run's speed.
    pub spread: f64,
    /// Deviation of an edge's place in pitches.
    pub irregular: f64,
    /// Relative error of the recorder's clock.
    pub crystal: f64,
    /// Probability that a record ends early.
    pub ends_early: f64,
}

/// Edges a revolution of wheels that are sold.
const WHEELS: [usize; 10] = [200, 256, 400, 500, 800, 1000, 1600, 2000, 2400, 4096];
/// Levels every millisecond show this many edges a second.
const SAMPLED: f64 = 280.0;
/// Longest experiment in s of drive.
const LONGEST_S: f64 = 150.0;
/// Fewest and most runs.
const RUNS: [usize; 2] = [6, 40];

impl Bench {
    /// Draws one for a motor of `full` rad/s whose wave takes `wave_s`: 6–40 runs of 1.5–8 s.
    pub fn draw(dice: &mut Dice, full: f64, wave_s: f64) -> Self {
        let seen: Vec<usize> = WHEELS.into_iter().filter(|e| *e as f64 * full / TAU < SAMPLED).collect();
        let levels = !seen.is_empty() && dice.chance(0.6);
        let edges = dice.pick(if levels { &seen } else { &WHEELS });
        let duties = duties(dice);
        let both = dice.chance(0.6);
        // Whoever sets up a bench lets the wave rise: four of its times in a period at least.
        let fastest = (0.25 / wave_s).clamp(41.0, 120.0);
        let main = dice.even(40.0, fastest).round();
        let other = dice.even(40.0, fastest).round();
        let frequencies = if (other - main).abs() > 5.0 && dice.chance(0.3) { vec![main, other] } else { vec![main] };
        let mut kinds = Vec::new();
        for duty in &duties {
            for pwm_hz in &frequencies {
                for sign in if both { &[1.0, -1.0][..] } else { &[1.0] } {
                    kinds.push((*duty, *pwm_hz, *sign));
                }
            }
        }
        let [least, most] = RUNS;
        let rounds = dice.whole(1, 4).max(least.div_ceil(kinds.len())).min((most / kinds.len()).max(1));
        let seconds = dice.decade(1.5, 8.0).min(LONGEST_S / (kinds.len() * rounds).min(most) as f64).max(1.5);
        let order = dice.pick(&[Order::Random, Order::Random, Order::Random, Order::Rounds, Order::Sorted]);
        let mut plan = Vec::new();
        for (duty, pwm_hz, sign) in ordered(dice, &kinds, rounds, order) {
            let drive = Drive { duty, sign, pwm_hz, seconds: (seconds * 20.0).round() / 20.0 };
            plan.push(Planned { drive, pause_s: dice.decade(0.5, 15.0), kept: true });
        }
        // More than the most: the rest was never made, somewhere.
        while plan.len() > most {
            plan.remove(dice.whole(0, plan.len() - 1));
        }
        let losing = dice.chance(0.35);
        for run in &mut plan {
            run.kept = !(losing && dice.chance(0.12));
        }
        if plan.iter().filter(|r| r.kept).count() < least {
            plan.iter_mut().for_each(|r| r.kept = true);
        }
        Self {
            edges,
            levels,
            plan,
            order,
            duties: duties.len(),
            both,
            frequencies: frequencies.len(),
            jitter_s: if levels { dice.decade(10e-6, 80e-6) } else { dice.decade(1e-6, 20e-6) },
            stamp_us: dice.pick(&[1, 1, 4, 10]),
            latency_s: dice.even(0.05e-3, 1.0e-3),
            spread: dice.decade(0.005, 0.03),
            irregular: dice.even(0.004, 0.02),
            crystal: (12e-6 * normal(dice)).clamp(-30e-6, 30e-6),
            ends_early: dice.even(0.0, 0.25),
        }
    }

    /// Numbers of the runs whose files are there.
    pub fn kept(&self) -> Vec<usize> {
        (0..self.plan.len()).filter(|k| self.plan[*k].kept).collect()
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("edges_per_rev", self.edges as f64),
            ("runs", self.kept().len() as f64),
            ("seconds", self.plan.first().map_or(0.0, |r| r.drive.seconds)),
            ("duties", self.duties as f64),
            ("directions", if self.both { 2.0 } else { 1.0 }),
            ("pwm_frequencies", self.frequencies as f64),
            ("levels", f64::from(u8::from(self.levels))),
            ("sorted", f64::from(u8::from(self.order == Order::Sorted))),
            ("gain_spread", self.spread),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// Whether these runs could show an effect at all.
    pub fn could_show(&self, name: &str) -> bool {
        match name {
            "direction-asymmetry" => self.both,
            "outside-crossing" => self.both && self.duties >= 5,
            "dropped-samples" => self.levels,
            "dead-zone" | "high-duty-saturation" | "supply-sag" | "contact-stiffening" => self.duties >= 4,
            "duty-quantisation" | "outside-comb" => self.duties >= 6,
            "start-delay" | "stribeck-friction" => self.duties >= 3,
            "run-in-wear" | "outside-tide" | "outside-sessions" => {
                self.kept().len() >= 10 && self.order != Order::Sorted
            }
            "outside-stumbles" => self.plan.iter().map(|r| r.drive.seconds).sum::<f64>() >= 20.0,
            _ => true,
        }
    }
}

/// On fractions of 0.06 to 1: evenly apart, wherever they fell, or crowded at the low end; in hundredths.
fn duties(dice: &mut Dice) -> Vec<f64> {
    let n = dice.whole(3, 12);
    let low = dice.even(0.06, 0.28);
    let high = if dice.chance(0.65) { 1.0 } else { dice.even(0.8, 0.98) };
    let crowded = dice.pick(&[1.0, 1.0, 1.6]);
    let loose = dice.pick(&[0.0, 0.35]);
    let mut list: Vec<f64> = (0..n)
        .map(|k| {
            let inner = k > 0 && k < n - 1;
            let place = k as f64 + if inner { loose * dice.even(-1.0, 1.0) } else { 0.0 };
            let share = (place / (n - 1) as f64).powf(crowded);
            ((low + (high - low) * share) * 100.0).round() / 100.0
        })
        .collect();
    list.dedup();
    list
}

type Setting = (f64, f64, f64);

fn ordered(dice: &mut Dice, kinds: &[Setting], rounds: usize, order: Order) -> Vec<Setting> {
    if order == Order::Sorted {
        return kinds.iter().flat_map(|k| std::iter::repeat_n(*k, rounds)).collect();
    }
    let mut all: Vec<Setting> = (0..rounds).flat_map(|_| kinds.iter().copied()).collect();
    if order == Order::Random {
        for i in (1..all.len()).rev() {
            all.swap(i, dice.whole(0, i));
        }
    }
    all
}
