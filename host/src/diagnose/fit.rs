//! Nonlinear refits: Gauss–Newton on the common parameters, with the phases of single runs fitted on the way.

use super::problem::{Column, Model, Problem, RunDesign};
use super::rotor::P;
use super::stats::{Fold, Grams, PhasedFit, Prior};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// A common parameter that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub parameter: P,
    /// How large a change is plausible.
    pub scale: f64,
    /// Admissible range.
    pub bounds: (f64, f64),
    /// What is known before the data: centre, and standard deviation of the logarithm.
    pub prior: Option<(f64, f64)>,
}

impl Free {
    /// The prior for a step in units of `scale` from `value`, where one standard deviation costs `weight`.
    fn prior_at(&self, value: f64, weight: f64) -> Prior {
        match self.prior {
            Some((centre, sd)) if value > 0.0 => {
                let slope = self.scale / (value * sd);
                let precision = weight * slope * slope;
                Prior { precision, pull: -weight * slope * (value / centre).ln() / sd, noise: weight * precision }
            }
            _ => Prior::default(),
        }
    }
}

/// The priors of `free` at `model`. One standard deviation costs the misfit of one mean run: windows of a run err together, so
/// their number says little of what a run tells.
pub fn priors_at(free: &[Free], model: &Model, misfit_a_run: f64) -> Vec<Prior> {
    free.iter().map(|f| f.prior_at(model.parameters.get(f.parameter), misfit_a_run)).collect()
}

/// What the priors add to the objective.
pub fn penalty(free: &[Free], model: &Model, misfit_a_run: f64) -> f64 {
    free.iter()
        .filter_map(|f| f.prior.map(|(centre, sd)| (model.parameters.get(f.parameter) / centre, sd)))
        .filter(|(ratio, _)| *ratio > 0.0)
        .map(|(ratio, sd)| misfit_a_run * (ratio.ln() / sd).powi(2))
        .sum()
}

/// Which phased coefficients are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phased {
    /// Drive modulation, pair 0 (once a turn) or 1 (twice a turn).
    Runout(usize),
    /// Encoder angle error.
    Eccentricity,
    /// Load torque.
    Gravity,
}

impl Phased {
    /// The cosine and the sine as columns of a design.
    pub fn columns(self) -> [Column; 2] {
        match self {
            Phased::Runout(h) => [Column::Runout(2 * h), Column::Runout(2 * h + 1)],
            Phased::Eccentricity => [Column::Eccentricity(0), Column::Eccentricity(1)],
            Phased::Gravity => [Column::Gravity(0), Column::Gravity(1)],
        }
    }

    /// Writes the coefficients of every run.
    pub fn store(self, model: &mut Model, coefficients: &[[f64; 2]]) {
        for (terms, c) in model.terms.iter_mut().zip(coefficients) {
            match self {
                Phased::Runout(h) => terms.runout[2 * h..2 * h + 2].copy_from_slice(c),
                Phased::Eccentricity => terms.eccentricity = *c,
                Phased::Gravity => terms.gravity = *c,
            }
        }
    }
}

/// The free parameters as columns of a design.
pub fn columns_of(free: &[Free]) -> Vec<Column> {
    free.iter()
        .map(|f| Column::Scalar { parameter: f.parameter, scale: f.scale, step: f.scale * 0.02, shape: Vec::new() })
        .collect()
}

/// Plausible sizes of the phased coefficients.
pub const PHASED_SCALE: f64 = 0.3;

/// Divides designs (one a run) further, for problems of one run.
pub type Split<'a> = &'a (dyn Fn(Vec<RunDesign>) -> Vec<RunDesign> + Sync);

/// Fits `free` (the first must be the free speed) and `phased`, starting from `model`.
pub fn refit(
    problem: &Problem,
    mut model: Model,
    free: &[Free],
    phased: &[Phased],
    iterations: usize,
) -> (Model, Vec<PhasedFit>) {
    let mut fits: Vec<PhasedFit> = Vec::new();
    let rounds = if phased.is_empty() { 1 } else { 5 };
    let zero = vec![[0.0; 2]; problem.runs.len()];
    for p in phased {
        p.store(&mut model, &zero);
    }
    for _ in 0..rounds {
        if !phased.is_empty() {
            let mut columns = columns_of(free);
            let mut scales: Vec<f64> = vec![1.0; free.len()];
            let mut pairs = Vec::new();
            for p in phased {
                let at = columns.len();
                pairs.push([at, at + 1]);
                columns.extend(p.columns());
                scales.extend([PHASED_SCALE; 2]);
            }
            let mut designs = problem.design(&model, &columns);
            // Around what the last round found, the whole of it is fitted again: a strong effect is not linear from zero.
            for (fit, pair) in fits.iter().zip(&pairs) {
                for (design, c) in designs.iter_mut().zip(&fit.coefficients) {
                    for (y, x) in design.y.iter_mut().zip(design.x.chunks_exact(design.columns)) {
                        *y += x[pair[0]] * c[0] + x[pair[1]] * c[1];
                    }
                }
            }
            let grams = Grams::new(&designs, 0, &scales, Some(&[]), vec![everything(problem.runs.len())]);
            let base: Vec<usize> = (0..free.len()).collect();
            fits = grams.fit_phased(&base, &pairs);
            for (p, fit) in phased.iter().zip(&fits) {
                p.store(&mut model, &fit.coefficients);
            }
        }
        model = gauss_newton(problem, model, free, iterations);
    }
    (model, fits)
}

fn everything(n: usize) -> Fold {
    Fold { train: (0..n).collect(), test: (0..n).collect() }
}

fn gauss_newton(problem: &Problem, mut model: Model, free: &[Free], iterations: usize) -> Model {
    let scales = vec![1.0; free.len()];
    let set: Vec<usize> = (0..free.len()).collect();
    let all: Vec<usize> = (0..problem.runs.len()).collect();
    for _ in 0..iterations {
        let designs = problem.design(&model, &columns_of(free));
        let grams = Grams::new(&designs, 0, &scales, Some(&[]), vec![everything(problem.runs.len())]);
        let (variance, spread) = (grams.variance, grams.gain_spread);
        let misfit = grams.misfit_a_run();
        let target = |m: &Model| objective(problem, m, variance, spread) + penalty(free, m, misfit);
        let before = target(&model);
        let step = grams.with_prior(priors_at(free, &model, misfit)).fit(&all, &set);
        let mut accepted = None;
        let mut factor = 1.0;
        for _ in 0..5 {
            let mut trial = model.clone();
            for (f, s) in free.iter().zip(step.iter()) {
                let value =
                    moved(f.parameter, trial.parameters.get(f.parameter), factor * s.clamp(-3.0, 3.0) * f.scale);
                trial.parameters.set(f.parameter, value.clamp(f.bounds.0, f.bounds.1));
            }
            let after = target(&trial);
            if after < before {
                accepted = Some((trial, after));
                break;
            }
            factor *= 0.4;
        }
        let Some((trial, after)) = accepted else { break };
        model = trial;
        if before - after < 1e-4 * before {
            break;
        }
    }
    model
}

/// How much more squared error each of `models` leaves than the last of them leaves on data of its own making, sampled like the measured
/// ones: 1 if nothing is left but the sampling. `None` unless every run was sampled.
pub fn misfits<const N: usize>(
    problem: &Problem,
    models: [&Model; N],
    variance: f64,
    spread: f64,
    repetitions: usize,
    seed: u64,
) -> Option<[f64; N]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let last = models.last()?;
    let a_second = |p: &Problem, model: &Model| {
        let seconds: f64 = p.runs.iter().map(super::observe::Observed::compared_s).sum();
        objective(p, model, variance, spread) / seconds.max(1e-9)
    };
    let mut floor = 0.0;
    for _ in 0..repetitions {
        floor += a_second(&problem.remade(last, spread, &mut rng)?, last) / repetitions as f64;
    }
    Some(models.map(|m| a_second(problem, m) / floor.max(1e-12)))
}

/// How far the fit of `free` lies from what made the data, on average over `repetitions` data sets made by `model` itself and
/// sampled like the measured ones, and the standard error of that. Sampling bends estimates: a rise of 2 ms seen every
/// millisecond looks slower than it is. `None` unless every run was sampled.
pub fn bias(
    problem: &Problem,
    model: &Model,
    free: &[Free],
    gain_spread: f64,
    repetitions: usize,
    seed: u64,
) -> Option<Vec<[f64; 2]>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let set: Vec<usize> = (0..free.len()).collect();
    let all: Vec<usize> = (0..problem.runs.len()).collect();
    let mut sums = vec![[0.0; 2]; free.len()];
    for _ in 0..repetitions {
        let made = problem.remade(model, gain_spread, &mut rng)?;
        let designs = made.design(model, &columns_of(free));
        let everything = vec![everything(made.runs.len())];
        let grams = Grams::new(&designs, 0, &vec![1.0; free.len()], Some(&[]), everything);
        let misfit = grams.misfit_a_run();
        let step = grams.with_prior(priors_at(free, model, misfit)).fit(&all, &set);
        for ((sum, f), s) in sums.iter_mut().zip(free).zip(step.iter()) {
            let value = model.parameters.get(f.parameter);
            let off = moved(f.parameter, value, s.clamp(-0.5, 0.5) * f.scale) - value;
            sum[0] += off;
            sum[1] += off * off;
        }
    }
    let n = repetitions.max(1) as f64;
    let error = |sum: &[f64; 2]| ((sum[1] / n - (sum[0] / n).powi(2)).max(0.0) / (n - 1.0).max(1.0)).sqrt();
    Some(sums.iter().map(|sum| [sum[0] / n, error(sum)]).collect())
}

/// A parameter after a step of a linear fit. The angle that starting and stopping costs goes with the inverse of the rates, so a
/// step of theirs is one of the inverse.
fn moved(parameter: P, value: f64, step: f64) -> f64 {
    if matches!(parameter, P::OnAcceleration | P::OffDeceleration) && value > 0.0 {
        let inverse = 1.0 - step / value;
        if inverse > 0.0 { value / inverse } else { f64::INFINITY }
    } else {
        value + step
    }
}

/// Squared error in rpm²·s with a random run gain of relative spread `spread` taken out.
pub fn objective(problem: &Problem, model: &Model, variance: f64, spread: f64) -> f64 {
    let t = spread * spread;
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
            yy - t / (variance + t * gg) * gy * gy
        })
        .sum()
}
