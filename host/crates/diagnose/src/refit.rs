//! Nonlinear refits: Gauss–Newton on the common parameters and on the phases of single runs together.
//!
//! The objective is the negative logarithm of a posterior whose likelihood is tempered (see [`super::evidence`]): squared error with
//! the gain of each run taken out as far as gains scatter, the priors, and the phased coefficients under their common power.
//! Reference: Nocedal & Wright, Numerical Optimization, 2nd ed., chapter 10 (Gauss–Newton, damped after Marquardt); the runs' own
//! coefficients are eliminated by their Schur complement.

use super::design::{Column, RunDesign};
use super::library::Phased;
use super::prior::Prior;
use super::problem::{Model, Problem};
use super::rotor::P;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

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

/// What the residuals scatter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance of a weighted residual under the tempered likelihood, in rpm²·s: two of them are one nat.
    pub variance: f64,
    /// Relative spread of the runs' gains.
    pub gain_spread: f64,
}

/// The free parameters as columns of a design.
pub fn columns_of(free: &[Free]) -> Vec<Column> {
    free.iter()
        .map(|f| Column::Scalar { parameter: f.parameter, scale: f.scale, step: f.scale * 0.02, shape: Vec::new() })
        .collect()
}

/// How much larger the diagonal of the normal equations is made where the step before went too far (Marquardt, SIAM J. Appl. Math. 11 (1963)
/// 431): the first step is Gauss and Newton's, the last a thirtieth of each parameter's own.
const DAMPINGS: [f64; 5] = [0.0, 0.03, 0.3, 3.0, 30.0];

/// Plausible size of a phased coefficient before the first round.
const FIRST_POWER: f64 = 0.01;

/// Rounds in which the power that all runs share is found from the coefficients of the runs.
const EXPECTATIONS: usize = 6;

/// Fits `free` (the first must be the free speed) and `phased`, starting from `model`.
pub fn refit(
    problem: &Problem,
    mut model: Model,
    free: &[Free],
    phased: &[Phased],
    noise: Noise,
    steps: usize,
) -> Model {
    let mut power = vec![FIRST_POWER; phased.len()];
    for _ in 0..steps {
        let mut columns = columns_of(free);
        columns.extend(phased.iter().flat_map(|p| p.columns()));
        let designs = problem.design(&model, &columns);
        let now = coefficients(&model, phased);
        let runs: Vec<RunEquations> =
            designs.par_iter().zip(&now).map(|(d, z)| RunEquations::new(d, free.len(), z, noise)).collect();
        for _ in 0..EXPECTATIONS {
            power = expected_power(&runs, &power, noise.variance);
        }
        let target = |m: &Model| objective(problem, m, noise) + 2.0 * noise.variance * penalty(m, free, phased, &power);
        let before = target(&model);
        let accepted = DAMPINGS.into_iter().find_map(|damping| {
            let (step, z) = solve(&runs, free, &model, &power, noise.variance, damping)?;
            let trial = moved(&model, free, &step, phased, &now, &z, 1.0 / (1.0 + damping));
            let after = target(&trial);
            (after < before).then_some((trial, after))
        });
        let Some((trial, after)) = accepted else { break };
        model = trial;
        // A fiftieth of a nat more is nothing that a verdict could hang on.
        if before - after < 0.04 * noise.variance {
            break;
        }
    }
    model
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

/// Normal equations of one run: common columns first, then its own; its own coefficients are absolute, the common ones steps.
struct RunEquations {
    common: usize,
    g: DMatrix<f64>,
    b: DVector<f64>,
}

impl RunEquations {
    fn new(design: &RunDesign, common: usize, own: &[f64], noise: Noise) -> Self {
        let n = design.columns;
        let mut g = DMatrix::zeros(n, n);
        let mut b = DVector::zeros(n);
        for (row, y) in design.x.chunks_exact(n).zip(&design.y) {
            for i in 0..n {
                b[i] += row[i] * y;
                for j in i..n {
                    g[(i, j)] += row[i] * row[j];
                }
            }
        }
        g.fill_lower_triangle_with_upper_triangle();
        let around = DVector::from_fn(n, |i, _| if i < common { 0.0 } else { own[i - common] });
        b += &g * around;
        // The gain of a run is its own within the spread of gains.
        let t = noise.gain_spread * noise.gain_spread;
        let gamma = t / (noise.variance + t * g[(0, 0)]);
        let column = g.column(0).clone_owned();
        b -= &column * (gamma * b[0]);
        g -= &column * column.transpose() * gamma;
        Self { common, g, b }
    }

    fn own(&self) -> usize {
        self.b.len() - self.common
    }

    /// Inverse of the own block under the common power.
    fn inverse(&self, power: &[f64], variance: f64) -> DMatrix<f64> {
        let (c, k) = (self.common, self.own());
        let mut m = self.g.view((c, c), (k, k)).clone_owned();
        for i in 0..k {
            m[(i, i)] += variance / power[i / 2];
        }
        m.try_inverse().unwrap_or_else(|| DMatrix::zeros(k, k))
    }
}

/// The power of each pair that its coefficients in all runs, and their uncertainty, make likely (expectation–maximisation).
fn expected_power(runs: &[RunEquations], power: &[f64], variance: f64) -> Vec<f64> {
    let mut sums = vec![0.0; power.len()];
    for run in runs {
        let inverse = run.inverse(power, variance);
        let z = &inverse * run.b.rows(run.common, run.own());
        for i in 0..run.own() {
            sums[i / 2] += 0.5 * (z[i] * z[i] + variance * inverse[(i, i)]);
        }
    }
    sums.iter().map(|s| (s / runs.len().max(1) as f64).max(1e-9)).collect()
}

/// Steps of the common parameters (in their scales), damped, and the coefficients of every run.
fn solve(
    runs: &[RunEquations],
    free: &[Free],
    model: &Model,
    power: &[f64],
    variance: f64,
    damping: f64,
) -> Option<(DVector<f64>, Vec<DVector<f64>>)> {
    let c = free.len();
    let mut m = DMatrix::zeros(c, c);
    let mut rhs = DVector::zeros(c);
    let inverses: Vec<DMatrix<f64>> = runs.par_iter().map(|r| r.inverse(power, variance)).collect();
    for (run, inverse) in runs.iter().zip(&inverses) {
        let k = run.own();
        let link = run.g.view((c, 0), (k, c));
        m += run.g.view((0, 0), (c, c)) - link.transpose() * inverse * link;
        rhs += run.b.rows(0, c) - link.transpose() * (inverse * run.b.rows(c, k));
    }
    for (i, f) in free.iter().enumerate() {
        let (slope, curvature) = f.prior.pull(model.parameters.get(f.parameter));
        m[(i, i)] += variance * curvature * f.scale * f.scale;
        rhs[i] -= variance * slope * f.scale;
        // Rows that the data say nothing of stay where they are.
        m[(i, i)] += (damping + 1e-9) * m[(i, i)].abs() + 1e-12;
    }
    let step = m.cholesky()?.solve(&rhs);
    let own = runs
        .iter()
        .zip(&inverses)
        .map(|(run, inverse)| {
            let k = run.own();
            inverse * (run.b.rows(c, k) - run.g.view((c, 0), (k, c)) * &step)
        })
        .collect();
    Some((step, own))
}

fn moved(
    model: &Model,
    free: &[Free],
    step: &DVector<f64>,
    phased: &[Phased],
    now: &[Vec<f64>],
    own: &[DVector<f64>],
    own_share: f64,
) -> Model {
    let mut trial = model.clone();
    for (f, s) in free.iter().zip(step.iter()) {
        let value = trial.parameters.get(f.parameter);
        let value = after_step(f, value, s.clamp(-3.0, 3.0) * f.scale);
        trial.parameters.set(f.parameter, value.clamp(f.bounds.0, f.bounds.1));
    }
    let values: Vec<Vec<f64>> = now
        .iter()
        .zip(own)
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
    let t = noise.gain_spread * noise.gain_spread;
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
            yy - t / (noise.variance + t * gg) * gy * gy
        })
        .sum()
}
