//! Refitting the plant: damped Gauss–Newton over its numbers and each run's initial speed.
//!
//! The gain of every run scatters a little; as far as it does, it is taken out of the residuals and the derivatives.

use super::data::Data;
use super::effects::Free;
use super::plant::{Motion, goals, simulate, simulate_all, simulate_goals};
use super::values::{P, Values};
use rayon::prelude::*;
use twum_fit::descent::{DAMPINGS, descend};
use twum_fit::noise::Noise;
use twum_fit::normal::{Normal, Pull, Solution, solve};

/// Share of the misfit below which a step gains nothing: a hundredth of a nat of two hundred residuals.
const SETTLED: f64 = 1e-4;

/// A plant with the initial speed of every run in rpm.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    /// Its numbers.
    pub values: Values,
    /// One initial speed a run.
    pub starts: Vec<f64>,
}

/// Rows of one run that are left out of a fit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// The run.
    pub run: usize,
    /// Its rows.
    pub rows: std::ops::Range<usize>,
}

/// Rows of a run that are fitted.
fn kept(hidden: &[Block], run: usize) -> impl Fn(usize) -> bool + '_ {
    let blocks: Vec<&Block> = hidden.iter().filter(|b| b.run == run).collect();
    move |k| blocks.iter().all(|b| !b.rows.contains(&k))
}

/// Squared error in rpm² less what the priors are worth of it.
pub fn misfit(data: &Data, plant: &Plant, free: &[Free], noise: Noise, hidden: &[Block]) -> f64 {
    let motions = simulate_all(data, &plant.values, &plant.starts);
    misfit_of(data, &motions, noise, hidden) - 2.0 * noise.variance * log_prior(&plant.values, free)
}

/// Log prior of what is free.
pub fn log_prior(values: &Values, free: &[Free]) -> f64 {
    free.iter().map(|f| f.log_density(values.get(f.number))).sum()
}

fn misfit_of(data: &Data, motions: &[Motion], noise: Noise, hidden: &[Block]) -> f64 {
    let of = |(i, m): (usize, &Motion)| {
        let keep = kept(hidden, i);
        let (mut yy, mut gg, mut gy) = (0.0, 0.0, 0.0);
        for (_, (y, p)) in data.runs[i].rpm.iter().zip(&m.rpm).enumerate().filter(|(k, _)| keep(*k)) {
            let r = y - p;
            yy += r * r;
            gg += p * p;
            gy += p * r;
        }
        noise.squared_error(yy, gg, gy)
    };
    motions.iter().enumerate().map(of).sum()
}

/// Predicted speeds, and their derivatives by what is free (first) and by the initial speed (last), a list a run.
pub fn derivatives(data: &Data, plant: &Plant, free: &[Free]) -> (Vec<Motion>, Vec<Vec<Vec<f64>>>) {
    let now = simulate_all(data, &plant.values, &plant.starts);
    let columns = (0..data.runs.len())
        .into_par_iter()
        .map(|i| {
            let run = &data.runs[i];
            let same = goals(run, &plant.values);
            let slope = |moved: &Motion, step: f64| -> Vec<f64> {
                moved.rpm.iter().zip(&now[i].rpm).map(|(a, b)| (a - b) / step).collect()
            };
            let mut columns: Vec<Vec<f64>> = free
                .par_iter()
                .map(|f| {
                    let value = plant.values.get(f.number);
                    let step = if value + f.step > f.bounds.1 { -f.step } else { f.step };
                    let values = plant.values.with(f.number, value + step);
                    let moved = match Values::is_of_actuator(f.number) {
                        true => simulate(run, &values, plant.starts[i], data.unsigned),
                        false => simulate_goals(run, &values, &same, plant.starts[i], data.unsigned),
                    };
                    slope(&moved, step)
                })
                .collect();
            let step = 1e-4 * data.usual_rpm;
            let later = simulate_goals(run, &plant.values, &same, plant.starts[i] + step, data.unsigned);
            columns.push(slope(&later, step));
            columns
        })
        .collect();
    (now, columns)
}

/// Equations of one run over what is free and the initial speed, the gain taken out.
fn equations(y: &[f64], motion: &Motion, columns: &[Vec<f64>], keep: impl Fn(usize) -> bool, noise: Noise) -> Normal {
    let rows: Vec<usize> = (0..y.len()).filter(|k| keep(*k)).collect();
    let row = |k: &usize| columns.iter().map(|c| c[*k]).chain([motion.rpm[*k]]).collect::<Vec<f64>>();
    let x: Vec<f64> = rows.iter().flat_map(row).collect();
    let y: Vec<f64> = rows.iter().map(|k| y[*k] - motion.rpm[*k]).collect();
    Normal::new(columns.len() + 1, &x, &y).without_gain(columns.len(), noise).first(columns.len())
}

/// The plant after at most `steps` steps; rows `hidden` are not fitted. The noise is as the priors weigh it, in rpm².
pub fn refit(data: &Data, plant: Plant, free: &[Free], noise: Noise, hidden: &[Block], steps: usize) -> Plant {
    refit_until(SETTLED, data, plant, free, noise, hidden, steps)
}

/// The plant where no step gains more than a share of the misfit that is a hundredth of a nat of all rows: intervals count them all.
pub fn refit_to_the_end(data: &Data, plant: Plant, free: &[Free], noise: Noise, steps: usize) -> Plant {
    refit_until(0.02 / data.rows() as f64, data, plant, free, noise, &[], steps)
}

fn refit_until(
    settled: f64,
    data: &Data,
    plant: Plant,
    free: &[Free],
    noise: Noise,
    hidden: &[Block],
    steps: usize,
) -> Plant {
    let noise = noise_of_runs(noise, data.runs.len());
    // An initial speed is like any other. Where the rows that show it are left out, it stays.
    let precision = [noise.variance / (data.usual_rpm * data.usual_rpm).max(1e-12)];
    let linearise = |at: &Plant| {
        let (now, columns) = derivatives(data, at, free);
        let runs: Vec<Normal> = (0..data.runs.len())
            .into_par_iter()
            .map(|i| equations(&data.runs[i].rpm, &now[i], &columns[i], kept(hidden, i), noise))
            .collect();
        let pulls: Vec<Pull> = free.iter().map(|f| pull(f, at, noise.variance)).collect();
        ((runs, pulls), misfit_of(data, &now, noise, hidden) - 2.0 * noise.variance * log_prior(&at.values, free))
    };
    let attempt = |at: &Plant, (runs, pulls): &(Vec<Normal>, Vec<Pull>), damping: f64| {
        let by = solve(runs, pulls, &precision, damping)?;
        let trial = moved(data, at, free, &by, 1.0 / (1.0 + damping));
        let after = misfit(data, &trial, free, noise, hidden);
        Some((trial, after))
    };
    let alike = |before: f64, after: f64| before - after <= settled * before.abs();
    descend(plant, steps, &DAMPINGS, linearise, attempt, alike)
}

/// Noise as it is among so many runs: a single run's gain is the plant's.
pub fn noise_of_runs(noise: Noise, runs: usize) -> Noise {
    if runs == 1 { Noise { gain_spread: 0.0, ..noise } } else { noise }
}

/// What is known of a number.
fn pull(free: &Free, at: &Plant, variance: f64) -> Pull {
    let curvature = variance / (free.sd * free.sd);
    Pull { slope: curvature * (at.values.get(free.number) - free.centre), curvature }
}

/// The plant after a step; the initial speeds go a share of theirs.
fn moved(data: &Data, plant: &Plant, free: &[Free], by: &Solution, own_share: f64) -> Plant {
    let mut trial = plant.clone();
    for (f, s) in free.iter().zip(by.common.iter()) {
        let longest = if f.number == P::LogLag { 1.0 } else { f.sd };
        let moved = trial.values.get(f.number) + s.clamp(-longest, longest);
        trial.values.set(f.number, moved.clamp(f.bounds.0, f.bounds.1));
    }
    for (start, s) in trial.starts.iter_mut().zip(&by.own) {
        *start += (own_share * s[0]).clamp(-data.usual_rpm, data.usual_rpm);
    }
    trial
}
