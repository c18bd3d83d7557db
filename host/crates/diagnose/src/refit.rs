//! Nonlinear refits: Gauss–Newton on the common parameters and on the phases of single runs together.
//!
//! The objective is the negative logarithm of a posterior whose likelihood is tempered (see [`super::evidence`]): the squared error that is left
//! beside gains of the runs that scatter as the evidence believes them to, over duty, direction and order alike; the priors, and the phased
//! coefficients under their common power. With gains that are each run's own, a refit works on in vain what the evidence forgives, and a set with one
//! effect more came out worse than the one without.

use super::design::RunDesign;
use super::evidence::{Question, reduce};
use super::free::{Free, columns_of};
use super::gaussian::{Said, Together, beside_gains};
use super::library::Phased;
use super::observe::Observed;
use super::prior::Prior;
use super::problem::{Model, Problem, RunResidual};
use super::rotor::P;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use twum_fit::descent::{DAMPINGS, descend};
use twum_fit::noise::Noise;
use twum_fit::normal::{Normal, Pull, Solution, damped};

/// Plausible size of a phased coefficient before the first round.
pub(super) const FIRST_POWER: f64 = 0.01;

/// Rounds in which the power that all runs share is found from the coefficients of the runs.
const EXPECTATIONS: usize = 6;

/// Covariance of the residuals: each scatters by itself, and all of a run by its gain.
#[derive(Debug, Clone)]
pub struct Covariance {
    /// Variance of a residual of the tempered likelihood, in rpm²·s.
    pub variance: f64,
    /// Covariance of the runs' gains.
    pub gains: DMatrix<f64>,
}

impl Covariance {
    /// Of gains that differ by chance alone.
    pub fn by_chance(runs: usize, Noise { variance, gain_spread }: Noise) -> Self {
        Self { variance, gains: DMatrix::from_diagonal_element(runs, runs, gain_spread * gain_spread) }
    }
}

/// Fits `free` (the first must be the free speed) and `phased`, starting from `model` or, where that lies beyond the bounds, from there.
pub fn refit(
    problem: &Problem,
    model: Model,
    free: &[Free],
    phased: &[Phased],
    covariance: &Covariance,
    steps: usize,
) -> Model {
    let model = within(model, free);
    let refit = Refit { problem, free, phased, covariance };
    let mut power = vec![FIRST_POWER; phased.len()];
    let linearise = |at: &At| {
        let around = refit.around(&at.model, &power);
        power.clone_from(&around.power);
        let before = refit.cost(at, &around.power);
        (around, before)
    };
    let attempt = |at: &At, around: &Around, damping: f64| {
        let to = refit.solve(around, damping)?;
        let trial = refit.at(moved(&at.model, phased, around, &to, 1.0 / (1.0 + damping)));
        let after = refit.cost(&trial, &around.power);
        Some((trial, after))
    };
    // A fiftieth of a nat more is nothing that a verdict could hang on.
    let alike = |before: f64, after: f64| before - after < 0.04 * covariance.variance;
    descend(refit.at(model), steps, &DAMPINGS, linearise, attempt, alike).model
}

/// A model with what it leaves, in rpm²·s.
struct At {
    model: Model,
    left: f64,
}

/// What is fitted to what.
struct Refit<'a> {
    problem: &'a Problem,
    free: &'a [Free],
    phased: &'a [Phased],
    covariance: &'a Covariance,
}

/// A model's surroundings: the equations of the runs, in which the common columns are steps and a run's own coefficients whole.
struct Around {
    /// What is fitted, in steps that fit the model.
    free: Vec<Free>,
    runs: Vec<Normal>,
    /// All that the runs say of the common columns, their own coefficients integrated.
    together: Together,
    pulls: Vec<Pull>,
    /// Own coefficients of every run.
    now: Vec<Vec<f64>>,
    /// Their common power.
    power: Vec<f64>,
}

impl Refit<'_> {
    fn at(&self, model: Model) -> At {
        At { left: objective(self.problem, &model, self.covariance), model }
    }

    /// What a model costs where the own coefficients have this power.
    fn cost(&self, at: &At, power: &[f64]) -> f64 {
        at.left + 2.0 * self.covariance.variance * penalty(&at.model, self.free, self.phased, power)
    }

    /// The surroundings of a model; the power of the own coefficients is found from one that it was before.
    fn around(&self, model: &Model, power: &[f64]) -> Around {
        let Self { covariance, free, phased, .. } = self;
        let free: Vec<Free> = free.iter().map(|f| f.near(&model.parameters)).collect();
        let mut columns = columns_of(&free);
        columns.extend(phased.iter().flat_map(|p| p.columns()));
        let now = coefficients(model, phased);
        let designs = self.problem.design(model, &columns);
        let runs: Vec<Normal> = designs.par_iter().zip(&now).map(|(d, z)| equations(d, free.len(), z)).collect();
        let beside_gain: Vec<Normal> = runs.iter().enumerate().map(|(i, run)| self.beside_gain(i, run)).collect();
        let mut power = power.to_vec();
        for _ in 0..EXPECTATIONS {
            power = expected_power(&beside_gain, free.len(), &power, covariance.variance);
        }
        let question = Question {
            common: (0..free.len()).map(|column| (column, 1.0)).collect(),
            own: (0..2 * phased.len()).map(|k| (free.len() + k, k / 2)).collect(),
            ..Question::default()
        };
        let said: Vec<Said> = runs
            .iter()
            .enumerate()
            .map(|(i, run)| reduce(run, i, &question, &power, covariance.variance).said)
            .collect();
        let pulls: Vec<Pull> = free.iter().map(|f| pull(f, model, covariance.variance)).collect();
        let precision: Vec<f64> = pulls.iter().map(|pull| pull.curvature / covariance.variance).collect();
        Around { together: Together::new(said.iter(), &precision), free, runs, pulls, now, power }
    }

    /// The equations of run `i` with its gain left free as far as gains scatter.
    fn beside_gain(&self, i: usize, run: &Normal) -> Normal {
        let Covariance { variance, gains } = self.covariance;
        run.clone().without_gain(0, Noise { variance: *variance, gain_spread: gains[(i, i)].sqrt() })
    }

    /// Where the equations lead: the gains and the runs' own coefficients are eliminated, and what is left is [`damped`]. Nothing where there is no one
    /// solution.
    fn solve(&self, around: &Around, damping: f64) -> Option<Solution> {
        let beside = beside_gains(&around.together, &self.covariance.gains)?;
        let slopes = DVector::from_iterator(around.pulls.len(), around.pulls.iter().map(|pull| pull.slope));
        let common = damped(beside.g.clone(), &(&beside.b - slopes / self.covariance.variance), damping)?;
        let (gains, _) = beside.gains(&common);
        let precision = precision(&around.power, self.covariance.variance);
        let (c, k) = (common.len(), precision.len());
        let own = |(run, gain): (&Normal, &f64)| {
            let link = run.g.view((c, 0), (k, c));
            let rest = run.b.rows(c, k) - link * &common - link.column(0) * *gain;
            run.own_inverse(c, &precision) * rest
        };
        Some(Solution { own: around.runs.iter().zip(gains.iter()).map(own).collect(), common })
    }
}

/// The model with what is free moved to its bounds, where it lies beyond them.
pub fn within(mut model: Model, free: &[Free]) -> Model {
    for f in free {
        model.parameters.set(f.parameter, model.parameters.get(f.parameter).clamp(f.bounds.0, f.bounds.1));
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

/// Equations of one run, in which its own coefficients are whole.
pub(super) fn equations(design: &RunDesign, common: usize, own: &[f64]) -> Normal {
    let around = DVector::from_fn(design.columns, |i, _| if i < common { 0.0 } else { own[i - common] });
    Normal::new(design.columns, &design.x, &design.y).whole(&around)
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
fn moved(model: &Model, phased: &[Phased], around: &Around, to: &Solution, own_share: f64) -> Model {
    let mut trial = model.clone();
    for (f, s) in around.free.iter().zip(to.common.iter()) {
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

/// Squared error in rpm²·s beside gains that scatter.
pub fn objective(problem: &Problem, model: &Model, covariance: &Covariance) -> f64 {
    let mut squares = 0.0;
    let mut said = Vec::new();
    for (r, run) in problem.residuals(model).iter().zip(&problem.runs) {
        let (mut gg, mut gy) = (0.0, 0.0);
        for (k, w) in run.windows.iter().enumerate() {
            let dt = run.duration(w);
            squares += r.rpm[k] * r.rpm[k] * dt;
            gg += r.predicted[k] * r.predicted[k] * dt;
            gy += r.predicted[k] * r.rpm[k] * dt;
        }
        said.push(Said::of_a_gain(gg / covariance.variance, gy / covariance.variance));
    }
    let together = Together::new(said.iter(), &[]);
    squares - beside_gains(&together, &covariance.gains).map_or(0.0, |beside| covariance.variance * beside.explained)
}

/// Squared error in rpm²·s.
pub fn squared_error(problem: &Problem, model: &Model) -> f64 {
    let of = |(r, run): (&RunResidual, &Observed)| {
        r.rpm.iter().zip(&run.windows).map(|(rpm, w)| rpm * rpm * run.duration(w)).sum::<f64>()
    };
    problem.residuals(model).iter().zip(&problem.runs).map(of).sum()
}

#[cfg(test)]
mod tests {
    use super::super::observe::Window;
    use super::super::problem::RPM;
    use super::super::rotor::{Parameters, Schedule};
    use super::*;
    use crate::{Options, starting_rotor, trial};

    /// Two seconds of a rotor at half duty, and what eight steps of a refit find of its braking (600 rad/s²) from another one.
    fn braking_found(from: f64) -> f64 {
        let times: Vec<f64> = (0..200).map(|k| 0.01 * f64::from(k)).collect();
        let window = |to: usize| Window { from: to - 1, to, low: 0.0, high: 0.0 };
        let run = Observed {
            schedule: Schedule::constant(0.5, 1.0, 50.0, 0.0, 2.0),
            drive_end: 2.0,
            angles: vec![0.0; times.len()],
            level: vec![0; times.len()],
            windows: (1..times.len()).map(window).collect(),
            record_end: 2.0,
            times,
            ..Observed::unrecorded()
        };
        let rotor = Parameters::new(3.6, 900.0, 600.0, 0.3, 0.02).with(P::WaveTime, 4e-4);
        let mut problem = Problem::new(vec![run]);
        let speeds = problem.residuals(&problem.model(rotor.clone())).remove(0).predicted;
        for (w, rpm) in problem.runs[0].windows.iter_mut().zip(&speeds) {
            w.low = rpm / RPM * 0.01;
            w.high = w.low;
        }
        let free = [
            Free { parameter: P::FreeSpeed, scale: 3.6, bounds: (0.1, 100.0), prior: Prior::Flat },
            Free {
                parameter: P::OffDeceleration,
                scale: from,
                bounds: (1.0, 1e5),
                prior: Prior::LogNormal { median: 600.0, log_sd: 2.0 },
            },
        ];
        let start = problem.model(rotor.with(P::OffDeceleration, from));
        let covariance = Covariance::by_chance(1, Noise { variance: 1e-4, gain_spread: 1e-3 });
        refit(&problem, start, &free, &[], &covariance, 8).parameters.get(P::OffDeceleration)
    }

    /// Fails if a number is moved, or its slope found, in steps of what it was where the refit began: then no step from a fortieth is longer than three
    /// fortieths, and eight end at 550.
    #[test]
    fn a_number_that_is_far_off_is_found() {
        for from in [15.0, 24_000.0] {
            let found = braking_found(from);
            assert!((found / 600.0 - 1.0).abs() < 0.01, "{found} from {from}");
        }
    }

    /// Fails if gains that runs of a direction share are taken for each run's own: then eight runs say eight times what they say.
    #[test]
    fn what_runs_share_is_said_once() {
        let runs = trial::runs(&|_, direction, _, _| 0.01 * direction);
        let rotor = starting_rotor(&runs, &Options::default());
        let problem = Problem::new(runs).widened();
        let spread: f64 = 0.02;
        let shared = DMatrix::from_fn(8, 8, |i, j| {
            spread
                * spread
                * (problem.runs[i].direction * problem.runs[j].direction + f64::from(u8::from(i == j)) * 1e-3)
        });
        let asymmetry = |gains: DMatrix<f64>| {
            let model = problem.model(rotor.clone());
            let speed = rotor.get(P::FreeSpeed);
            let free = [
                Free { parameter: P::FreeSpeed, scale: speed, bounds: (0.1 * speed, 10.0 * speed), prior: Prior::Flat },
                Free {
                    parameter: P::AsymSpeed,
                    scale: 0.1,
                    bounds: (-0.5, 0.5),
                    prior: Prior::Normal { centre: 0.0, sd: 0.007 },
                },
            ];
            refit(&problem, model, &free, &[], &Covariance { variance: 1e-3, gains }, 20).parameters.get(P::AsymSpeed)
        };
        let own = Covariance::by_chance(8, Noise { variance: 1e-3, gain_spread: spread }).gains;
        // By the precisions of prior and runs: 0.01/(1 + (0.02/0.007)²/8) and 0.01/(1 + (0.02/0.007)²).
        let [own, shared] = [own, shared].map(asymmetry);
        assert!((own - 0.0049).abs() < 3e-4, "{own}");
        assert!((shared - 0.0011).abs() < 3e-4, "{shared}");
    }
}
