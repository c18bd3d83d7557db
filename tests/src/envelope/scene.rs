//! A motor on a bench: its runs with and without what is hidden, as traces and as records.

use super::acting::{Acting, Past};
use super::bench::Bench;
use super::effects::Effect;
use super::motor::Motor;
use super::ride::{CELL_S, Roughness, followed};
use super::wheel::{Recorder, Wheel};
use crate::folder::{Folder, Record, Run};
use crate::profile::random::Dice;
use crate::strength::{Floor, GRID_S, Refit, Traces};
use crate::truth::{Hidden, Kind, Made, Truth};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Runs that sizes are found on: a dozen show every duty.
const RUNS_FOR_SIZES: usize = 12;

/// Weakest effect that is hidden: just beyond the noise.
pub const LEAST_RHO: f64 = 1.05;

/// Smallest error of a clock that is hidden: a ten-thousandth is within what clocks err by anyway.
const CLOCK_LEAST: f64 = 3e-3;

/// A motor on a bench.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The motor.
    pub motor: Motor,
    /// The experiment.
    pub bench: Bench,
    /// What the noise comes from.
    pub seed: u64,
}

impl Scene {
    /// Random numbers of run `k`, for one purpose: the same whatever is hidden.
    fn dice(&self, k: usize, purpose: &str) -> Dice {
        Dice::new(self.seed.wrapping_add(104_729 * k as u64), purpose)
    }

    fn wheel<'a>(&self, hidden: &'a [Effect]) -> Wheel<'a> {
        Wheel::new(&self.bench, hidden, &mut Dice::new(self.seed, "e wheel"))
    }

    fn recorder<'a>(&'a self, k: usize, hidden: &'a [Effect]) -> Recorder<'a> {
        Recorder::new(&self.bench, hidden, self.bench.plan[k].drive.seconds, &mut self.dice(k, "e recorder"))
    }

    /// Angles of run `k`, cell by cell, up to a true time; with the chance of a run or as a run would be without.
    fn angles(&self, motor: &Motor, k: usize, past: Past, hidden: &[Effect], until: f64, chance: bool) -> Vec<f64> {
        let planned = &self.bench.plan[k];
        let mut acting = Acting::new(hidden, motor, planned.drive, past, self.seed.wrapping_add(k as u64));
        let zero = self.dice(k, "e zero").even(0.0, TAU);
        let gain = if chance { planned.gain } else { 1.0 };
        let rough = chance.then(|| Roughness::new(&self.bench, self.dice(k, "e roughness")));
        followed(motor, &planned.drive, &mut acting, rough, [zero, gain, until])
    }

    /// Run `k` without noise, as it would be read.
    fn trace(&self, motor: &Motor, k: usize, past: Past, hidden: &[Effect]) -> Vec<f64> {
        let (wheel, recorder) = (self.wheel(hidden), self.recorder(k, hidden));
        let angles = self.angles(motor, k, past, hidden, recorder.seen(recorder.record_s) + 0.05, false);
        let rest = wheel.read(angles[0]);
        let at = |t: f64| {
            let x = (t / CELL_S).max(0.0);
            let n = (x as usize).min(angles.len() - 2);
            angles[n] + (x - n as f64).min(1.0) * (angles[n + 1] - angles[n])
        };
        let points = (recorder.record_s / GRID_S) as usize;
        (0..points).map(|n| wheel.read(at(recorder.seen(n as f64 * GRID_S))) - rest).collect()
    }

    fn record(&self, k: usize, past: Past, hidden: &[Effect]) -> Record {
        let recorder = self.recorder(k, hidden);
        let until = recorder.seen(recorder.record_s) + 0.1;
        let angles = self.angles(&self.motor, k, past, hidden, until, true);
        let (first, times) = self.wheel(hidden).passed(&angles);
        recorder.write(first, &times, &mut self.dice(k, "e samples"))
    }

    /// The runs whose files are there.
    pub fn kept(&self) -> Vec<usize> {
        (0..self.bench.plan.len()).filter(|k| self.bench.plan[*k].kept).collect()
    }

    /// A dozen runs spread over the experiment, at the shuffled places of an evenly spaced choice.
    pub fn some(&self) -> Vec<usize> {
        let kept = self.kept();
        let take = kept.len().min(RUNS_FOR_SIZES);
        let mut dice = Dice::new(self.seed, "e some");
        // One of each stretch of the order, which one by chance: no step shares a factor with the plan's.
        (0..take)
            .map(|n| {
                let [from, to] = [n, n + 1].map(|n| n * kept.len() / take);
                kept[dice.whole(from, to - 1)]
            })
            .collect()
    }

    /// Some runs with nothing hidden, refitted by `nudges` of the motor's parameters.
    pub fn view(&self, runs: &[usize], nudges: usize) -> View {
        let past = Past::of(&self.bench.plan, &[]);
        let seen: Vec<(Traces, Floor)> = runs
            .par_iter()
            .map(|k| {
                let plain = self.trace(&self.motor, *k, past[*k], &[]);
                let nudged = (0..nudges).map(|p| self.trace(&self.motor.nudged(p), *k, past[*k], &[])).collect();
                let (period_s, pitch) = (1.0 / self.bench.plan[*k].drive.pwm_hz, TAU / self.bench.edges as f64);
                let mut floor = Floor::default();
                floor.add(&edges_s(&self.record(*k, past[*k], &[])), &plain, pitch, period_s);
                (Traces { plain, nudged, period_s, pitch }, floor)
            })
            .collect();
        let (traces, floors): (Vec<Traces>, Vec<Floor>) = seen.into_iter().unzip();
        let floor = floors.into_iter().fold(Floor::default(), Floor::with).rpm();
        View { runs: runs.to_vec(), refit: Refit::new(&traces), floor }
    }

    /// The data set with what is hidden in it; `view` is of all its runs.
    pub fn made(&self, seed: u64, kind: Kind, hidden: &[Effect], view: &View) -> Made {
        let past = Past::of(&self.bench.plan, hidden);
        let run = |k: &usize| {
            let drive = self.bench.plan[*k].drive;
            Run {
                id: format!("run{:02}-{}", k, if drive.sign > 0.0 { "cw" } else { "ccw" }),
                duty: drive.duty,
                sign: drive.sign,
                pwm_hz: drive.pwm_hz,
                drive_on_s: drive.seconds,
                order: *k,
                aligned: false,
                record: self.record(*k, past[*k], hidden),
            }
        };
        let effects = hidden.iter().map(|e| Hidden {
            name: e.name.to_owned(),
            form: e.form.to_owned(),
            size: e.size,
            rho: view.rho(self, e),
            parameters: e.parameters(),
            coordinate: e.name.starts_with("outside").then(|| e.form.to_owned()),
        });
        let effect_rpm = if hidden.is_empty() { [0.0; 2] } else { view.left_by(self, hidden) };
        let truth = Truth {
            generator: "e".to_owned(),
            seed,
            kind,
            effects: effects.collect(),
            floor_rpm: view.floor,
            effect_rpm,
            oracle_gain: [0, 1].map(|k| 1.0 - view.floor[k] / view.floor[k].hypot(effect_rpm[k])),
            motor: self.motor.numbers(),
            design: self.bench.numbers(),
        };
        let runs = view.runs.par_iter().map(run).collect();
        Made { folder: Folder { name: format!("rounds {seed}"), edges_per_rev: self.bench.edges as u32, runs }, truth }
    }
}

/// Times of an open-loop record's edges in s, in the middle between the samples that differ.
fn edges_s(record: &Record) -> Vec<f64> {
    match record {
        Record::Levels { period_us, levels } => {
            let changes = (1..levels.len()).filter(|n| levels[*n] != levels[n - 1]);
            changes.map(|n| (n as f64 - 0.5) * *period_us as f64 * 1e-6).collect()
        }
        Record::Edges { times_us, .. } => times_us.iter().map(|t| *t as f64 * 1e-6).collect(),
        Record::Control { .. } => Vec::new(),
    }
}

/// Some runs of a scene, refitted.
pub struct View {
    runs: Vec<usize>,
    refit: Refit,
    floor: [f64; 2],
}

impl View {
    /// What is left of effects after the refit, in rpm at both scales.
    fn left_by(&self, scene: &Scene, hidden: &[Effect]) -> [f64; 2] {
        let past = Past::of(&scene.bench.plan, hidden);
        let with: Vec<Vec<f64>> =
            self.runs.par_iter().map(|k| scene.trace(&scene.motor, *k, past[*k], hidden)).collect();
        self.refit.beyond(&with)
    }

    /// Strength of an effect: the larger of the two scales'.
    pub fn rho(&self, scene: &Scene, effect: &Effect) -> f64 {
        let [fine, coarse] = self.left_by(scene, std::slice::from_ref(effect));
        (fine / self.floor[0]).max(coarse / self.floor[1])
    }

    /// The effect as strong as `rho`; unless it must be just that, as strong as it gets beyond [`LEAST_RHO`].
    pub fn fitted(&self, scene: &Scene, mut effect: Effect, rho: f64, just_that: bool) -> Option<Effect> {
        let sign = effect.size.signum();
        let [mut below, mut above] = [0.0, effect.largest()];
        let mut now = 0.0;
        // Eight rounds halve what is between the bounds to less than a hundredth.
        for _ in 0..8 {
            now = self.rho(scene, &effect);
            let size = effect.size.abs();
            if (0.93..1.08).contains(&(now / rho)) || (now < rho && size >= effect.largest()) {
                break;
            }
            if now < rho {
                below = size;
            } else {
                above = size;
            }
            // In proportion first; where that leaves the bounds, to the largest if nothing has been too strong yet, or halfway.
            let aimed = size * (rho / now.max(0.01)).clamp(0.25, 4.0);
            let next = match aimed {
                a if a > below && a < above => a,
                _ if above >= effect.largest() => above,
                _ => 0.5 * (below + above),
            };
            effect.size = sign * next;
            now = self.rho(scene, &effect);
        }
        if effect.name == "clock-error" && effect.size.abs() < CLOCK_LEAST {
            effect.size = sign * CLOCK_LEAST;
            now = self.rho(scene, &effect);
            // A clock that shows more strongly than all else is another experiment's.
            return (now < 12.0).then_some(effect);
        }
        let least = if just_that { 0.8 * rho } else { LEAST_RHO };
        (now >= least && now < 1.5 * rho).then_some(effect)
    }
}
