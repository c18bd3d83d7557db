//! Nonlinear refits: Gauss–Newton on the common parameters and on the phases of single runs together.
//!
//! The objective is the negative logarithm of a posterior whose likelihood is tempered (see [`super::evidence`]): squared error with
//! the gain of each run taken out as far as gains scatter, the priors, and the phased coefficients under their common power.

use super::design::{Column, RunDesign};
use super::library::Phased;
use super::prior::Prior;
use super::problem::{Model, Problem};
use super::rotor::P;
use nalgebra::DVector;
use rayon::prelude::*;
use twum_fit::descent::{DAMPINGS, descend};
use twum_fit::noise::Noise;
use twum_fit::normal::{Normal, Pull, Solution, solve};

/// A common parameter that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub parameter: P,
    /// How large a change is plausible: the unit of its column.
    pub scale: f64,
    /// Admissible range.
    pub bounds: (f64, f64),
    /// What is known of it.
    pub prior: Prior,
}

/// The free parameters as columns of a design.
pub fn columns_of(free: &[Free]) -> Vec<Column> {
    free.iter()
        .map(|f| Column::Scalar { parameter: f.parameter, scale: f.scale, step: f.scale * 0.02, shape: Vec::new() })
        .collect()
}

/// Plausible size of a phased coefficient before the first round.
pub(super) const FIRST_POWER: f64 = 0.01;

/// Rounds in which the power that all runs share is found from the coefficients of the runs.
const EXPECTATIONS: usize = 6;

/// Fits `free` (the first must be the free speed) and `phased`, starting from `model` or, where that lies beyond the bounds, from there. The noise is
/// of the tempered likelihood, in rpm²·s.
pub fn refit(problem: &Problem, model: Model, free: &[Free], phased: &[Phased], noise: Noise, steps: usize) -> Model {
    let model = within(model, free);
    let mut columns = columns_of(free);
    columns.extend(phased.iter().flat_map(|p| p.columns()));
    let mut power = vec![FIRST_POWER; phased.len()];
    let cost =
        |squares: f64, m: &Model, power: &[f64]| squares + 2.0 * noise.variance * penalty(m, free, phased, power);
    let linearise = |(at, squares): &(Model, f64)| {
        let now = coefficients(at, phased);
        let designs = problem.design(at, &columns);
        let runs: Vec<Normal> = designs.par_iter().zip(&now).map(|(d, z)| equations(d, free.len(), z, noise)).collect();
        for _ in 0..EXPECTATIONS {
            power = expected_power(&runs, free.len(), &power, noise.variance);
        }
        let pulls = free.iter().map(|f| pull(f, at, noise.variance)).collect();
        let before = cost(*squares, at, &power);
        (Around { runs, pulls, now, power: power.clone() }, before)
    };
    let attempt = |(at, _): &(Model, f64), around: &Around, damping: f64| {
        let precision = precision(&around.power, noise.variance);
        let to = solve(&around.runs, &around.pulls, &precision, damping)?;
        let trial = moved(at, free, phased, around, &to, 1.0 / (1.0 + damping));
        let squares = objective(problem, &trial, noise);
        let after = cost(squares, &trial, &around.power);
        Some(((trial, squares), after))
    };
    // A fiftieth of a nat more is nothing that a verdict could hang on.
    let alike = |before: f64, after: f64| before - after < 0.04 * noise.variance;
    let squares = objective(problem, &model, noise);
    descend((model, squares), steps, &DAMPINGS, linearise, attempt, alike).0
}

/// The model with what is free moved to its bounds, where it lies beyond them.
pub fn within(mut model: Model, free: &[Free]) -> Model {
    for f in free {
        model.parameters.set(f.parameter, model.parameters.get(f.parameter).clamp(f.bounds.0, f.bounds.1));
    }
    model
}

/// A model's surroundings: the equations of the runs, in which the common columns are steps and a run's own coefficients whole.
struct Around {
    runs: Vec<Normal>,
    pulls: Vec<Pull>,
    /// Own coefficients of every run.
    now: Vec<Vec<f64>>,
    /// Their common power.
    power: Vec<f64>,
}

/// Negative log prior of a model in nats.
fn penalty(model: &Model, free: &[Free], phased: &[Phased], power: &[f64]) -> f64 {
    let common: f64 = free.iter().map(|f| -f.prior.log_density(model.parameters.get(f.parameter))).sum();
    let own: f64 = coefficients(model, phased)
        .iter()
        .flat_map(|run| run.iter().enumerate())
        .map(|(k, c)| 0.5 * c * c / power[k / 2])
        .sum();
    common + own
}

/// Cosines and sines of every run, in the order of `phased`.
pub fn coefficients(model: &Model, phased: &[Phased]) -> Vec<Vec<f64>> {
    model
        .terms
        .iter()
        .map(|t| {
            phased
                .iter()
                .flat_map(|p| match p {
                    Phased::Runout(h) => [t.runout[2 * h], t.runout[2 * h + 1]],
                    Phased::Eccentricity(h) => [t.eccentricity[2 * h], t.eccentricity[2 * h + 1]],
                    Phased::Gravity => t.gravity,
                })
                .collect()
        })
        .collect()
}

/// Writes cosines and sines of every run.
pub fn put_coefficients(model: &mut Model, phased: &[Phased], values: &[Vec<f64>]) {
    for (t, z) in model.terms.iter_mut().zip(values) {
        for (p, c) in phased.iter().zip(z.chunks_exact(2)) {
            match p {
                Phased::Runout(h) => t.runout[2 * h..2 * h + 2].copy_from_slice(c),
                Phased::Eccentricity(h) => t.eccentricity[2 * h..2 * h + 2].copy_from_slice(c),
                Phased::Gravity => t.gravity.copy_from_slice(c),
            }
        }
    }
}

/// Equations of one run, the gain taken out that its first column, the free speed, stands for.
pub(super) fn equations(design: &RunDesign, common: usize, own: &[f64], noise: Noise) -> Normal {
    let around = DVector::from_fn(design.columns, |i, _| if i < common { 0.0 } else { own[i - common] });
    Normal::new(design.columns, &design.x, &design.y).whole(&around).without_gain(0, noise)
}

/// What is known of a parameter, in its scale.
fn pull(free: &Free, at: &Model, variance: f64) -> Pull {
    let (slope, curvature) = free.prior.pull(at.parameters.get(free.parameter));
    Pull { slope: variance * slope * free.scale, curvature: variance * curvature * free.scale * free.scale }
}

/// How well a run's own coefficients are known beside the data: a cosine and a sine share their power.
pub(super) fn precision(power: &[f64], variance: f64) -> Vec<f64> {
    power.iter().flat_map(|p| [variance / p; 2]).collect()
}

/// The power of each pair that its coefficients in all runs, and their uncertainty, make likely (expectation–maximisation).
pub(super) fn expected_power(runs: &[Normal], common: usize, power: &[f64], variance: f64) -> Vec<f64> {
    let precision = precision(power, variance);
    let mut sums = vec![0.0; power.len()];
    for run in runs {
        let inverse = run.own_inverse(common, &precision);
        let z = &inverse * run.b.rows(common, precision.len());
        for i in 0..precision.len() {
            sums[i / 2] += 0.5 * (z[i] * z[i] + variance * inverse[(i, i)]);
        }
    }
    sums.iter().map(|s| (s / runs.len().max(1) as f64).max(1e-9)).collect()
}

/// The model after a step; the runs' own coefficients go a share of their way.
fn moved(model: &Model, free: &[Free], phased: &[Phased], around: &Around, to: &Solution, own_share: f64) -> Model {
    let mut trial = model.clone();
    for (f, s) in free.iter().zip(to.common.iter()) {
        let value = trial.parameters.get(f.parameter);
        let value = after_step(f, value, s.clamp(-3.0, 3.0) * f.scale);
        trial.parameters.set(f.parameter, value.clamp(f.bounds.0, f.bounds.1));
    }
    let values: Vec<Vec<f64>> = around
        .now
        .iter()
        .zip(&to.own)
        .map(|(from, to)| from.iter().zip(to.iter()).map(|(a, b)| a + own_share * (b - a)).collect())
        .collect();
    put_coefficients(&mut trial, phased, &values);
    trial
}

/// A parameter after a step of a linear fit. A number that is positive is moved by a factor: a step beyond zero would end at a bound, where
/// the data say nothing of it any more. The angle that starting and stopping costs goes with the inverse of the rates, so a step of theirs
/// is one of the inverse.
fn after_step(free: &Free, value: f64, step: f64) -> f64 {
    if !matches!(free.prior, Prior::LogNormal { .. }) || value <= 0.0 {
        return value + step;
    }
    let step = step / value;
    let factor = match free.parameter {
        P::OnAcceleration | P::OffDeceleration if step < 1.0 => 1.0 / (1.0 - step),
        P::OnAcceleration | P::OffDeceleration => MOST_FACTOR,
        _ => step.exp(),
    };
    value * factor.clamp(1.0 / MOST_FACTOR, MOST_FACTOR)
}

/// By how much a positive number changes in one step at most: no slope is believed further.
const MOST_FACTOR: f64 = 4.0;

/// Squared error in rpm²·s with the gain of each run taken out as far as gains scatter.
pub fn objective(problem: &Problem, model: &Model, noise: Noise) -> f64 {
    problem
        .residuals(model)
        .iter()
        .zip(&problem.runs)
        .map(|(r, run)| {
            let (mut yy, mut gg, mut gy) = (0.0, 0.0, 0.0);
            for (k, w) in run.windows.iter().enumerate() {
                let dt = run.duration(w);
                yy += r.rpm[k] * r.rpm[k] * dt;
                gg += r.predicted[k] * r.predicted[k] * dt;
                gy += r.predicted[k] * r.rpm[k] * dt;
            }
            noise.squared_error(yy, gg, gy)
        })
        .sum()
}
