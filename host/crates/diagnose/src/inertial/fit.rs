//! Refitting the plant: damped Gauss–Newton over its numbers and each run's initial speed.
//!
//! The gain of every run scatters a little; as far as it does, it is taken out of the residuals and the derivatives.

use super::data::Data;
use super::effects::Free;
use super::plant::{Motion, goals, simulate, simulate_all, simulate_goals};
use super::values::{P, Values};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

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

/// What a fit goes by.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    /// Variance of a residual as the priors weigh it, in rpm².
    pub variance: f64,
    /// Relative spread of the gains of runs.
    pub gain_spread: f64,
}

impl Noise {
    /// As it is among so many runs: a single run's gain is the plant's.
    pub fn of_runs(self, runs: usize) -> Self {
        if runs == 1 { Self { gain_spread: 0.0, ..self } } else { self }
    }
}

/// Normal equations of one run over the free numbers, the initial speed (last but one) and the predicted speed (last).
struct Normal {
    g: DMatrix<f64>,
    b: DVector<f64>,
    yy: f64,
}

impl Normal {
    /// Takes the gain out as far as it scatters.
    fn without_gain(mut self, noise: Noise) -> Self {
        let n = self.b.len();
        let t = noise.gain_spread * noise.gain_spread;
        let gamma = t / (noise.variance + t * self.g[(n - 1, n - 1)]);
        let column = self.g.column(n - 1).clone_owned();
        let by = self.b[n - 1];
        self.g -= &column * column.transpose() * gamma;
        self.b -= &column * (gamma * by);
        self.yy -= gamma * by * by;
        self
    }
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
    let t = noise.gain_spread * noise.gain_spread;
    let of = |(i, m): (usize, &Motion)| {
        let keep = kept(hidden, i);
        let (mut yy, mut gg, mut gy) = (0.0, 0.0, 0.0);
        for (_, (y, p)) in data.runs[i].rpm.iter().zip(&m.rpm).enumerate().filter(|(k, _)| keep(*k)) {
            let r = y - p;
            yy += r * r;
            gg += p * p;
            gy += p * r;
        }
        yy - t / (noise.variance + t * gg) * gy * gy
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

fn normal(y: &[f64], motion: &Motion, columns: &[Vec<f64>], keep: impl Fn(usize) -> bool) -> Normal {
    let n = columns.len() + 1;
    let mut g = DMatrix::zeros(n, n);
    let mut b = DVector::zeros(n);
    let mut yy = 0.0;
    let mut row = vec![0.0; n];
    for k in (0..y.len()).filter(|k| keep(*k)) {
        for (to, column) in row.iter_mut().zip(columns) {
            *to = column[k];
        }
        row[n - 1] = motion.rpm[k];
        let r = y[k] - motion.rpm[k];
        yy += r * r;
        for i in 0..n {
            b[i] += row[i] * r;
            for j in 0..=i {
                g[(i, j)] += row[i] * row[j];
            }
        }
    }
    for i in 0..n {
        for j in 0..i {
            g[(j, i)] = g[(i, j)];
        }
    }
    Normal { g, b, yy }
}

/// The step of all numbers, and of each run's initial speed.
fn solve(
    runs: &[Normal],
    plant: &Plant,
    free: &[Free],
    noise: Noise,
    damping: f64,
    usual_rpm: f64,
) -> Option<(DVector<f64>, Vec<f64>)> {
    let c = free.len();
    let mut m = DMatrix::zeros(c, c);
    let mut rhs = DVector::zeros(c);
    // The initial speed of a run is eliminated: it touches no other run. Where the rows that show it are left out, it stays.
    let unseen = noise.variance / (usual_rpm * usual_rpm).max(1e-12);
    let own = |r: &Normal| r.g[(c, c)] * (1.0 + damping) + unseen;
    for r in runs {
        let link = r.g.view((c, 0), (1, c)).clone_owned();
        m += r.g.view((0, 0), (c, c)) - link.transpose() * &link / own(r);
        rhs += r.b.rows(0, c) - link.transpose() * (r.b[c] / own(r));
    }
    for (i, f) in free.iter().enumerate() {
        m[(i, i)] += noise.variance / (f.sd * f.sd);
        rhs[i] -= noise.variance * (plant.values.get(f.number) - f.centre) / (f.sd * f.sd);
        m[(i, i)] *= 1.0 + damping;
        m[(i, i)] += 1e-12 * m[(i, i)] + 1e-300;
    }
    let step = if c > 0 { m.cholesky()?.solve(&rhs) } else { rhs };
    let starts = runs.iter().map(|r| (r.b[c] - r.g.view((c, 0), (1, c)).transpose().dot(&step)) / own(r)).collect();
    Some((step, starts))
}

/// The plant after at most `steps` steps; rows `hidden` are not fitted.
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
    mut plant: Plant,
    free: &[Free],
    noise: Noise,
    hidden: &[Block],
    steps: usize,
) -> Plant {
    let noise = noise.of_runs(data.runs.len());
    let mut value = misfit(data, &plant, free, noise, hidden);
    let mut damping = 1e-6;
    for _ in 0..steps {
        let (now, columns) = derivatives(data, &plant, free);
        let runs: Vec<Normal> = (0..data.runs.len())
            .into_par_iter()
            .map(|i| normal(&data.runs[i].rpm, &now[i], &columns[i], kept(hidden, i)).without_gain(noise))
            .collect();
        let before = value;
        for _ in 0..7 {
            let Some((step, starts)) = solve(&runs, &plant, free, noise, damping, data.usual_rpm) else {
                damping *= 10.0;
                continue;
            };
            let mut trial = plant.clone();
            for (f, s) in free.iter().zip(step.iter()) {
                let longest = if f.number == P::LogLag { 1.0 } else { f.sd };
                let moved = trial.values.get(f.number) + s.clamp(-longest, longest);
                trial.values.set(f.number, moved.clamp(f.bounds.0, f.bounds.1));
            }
            for (start, s) in trial.starts.iter_mut().zip(starts) {
                *start += s.clamp(-data.usual_rpm, data.usual_rpm);
            }
            let after = misfit(data, &trial, free, noise, hidden);
            if after < value {
                (plant, value) = (trial, after);
                damping = (damping * 0.1).max(1e-9);
                break;
            }
            damping = (damping * 20.0).min(1e8);
        }
        if before - value <= settled * before.abs() {
            break;
        }
    }
    plant
}
