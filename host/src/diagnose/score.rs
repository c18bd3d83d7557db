//! How well a model does on runs it was not fitted to, and who has earned what of it.

use super::case::{Accepted, Case, Local, strip};
use super::estimate::{DISCREPANCY, discrepancy};
use super::finding::{Finding, Status};
use super::fit::{Phased, objective, refit};
use super::observe::Observed;
use super::problem::{Model, RPM, RunDesign};
use super::search::EQUATION_ERROR;
use super::stats::{Fold, Grams, Group, HeldOut};
use crate::record::measurement::RunKind;
use nalgebra::DVector;

impl Case<'_> {
    /// Held-out errors at a fitted model: everything common is refitted without the runs that are scored. `noise` is the variance of a
    /// weighted residual and the spread of the run gains, where they are known.
    pub fn held_out(&self, model: &Model, accepted: &[Accepted], noise: Option<(f64, f64)>) -> HeldOut {
        let Local { grams, set, pairs } = self.local(model, accepted);
        let grams = match noise {
            Some((v, s)) => grams.with_noise(v, s),
            None => grams,
        };
        let mut held = grams.hold_out(&set, &Group::Linear(Vec::new()));
        if !pairs.is_empty() {
            // Phases were fitted on the very runs that are scored: take off what that is worth by chance.
            let freedom = grams.phased_freedom(&pairs, &amplitudes(model, accepted));
            for (r, f) in freedom.iter().enumerate() {
                let chance = 2.0 * grams.variance * f;
                held.loss[r].iter_mut().chain(&mut held.plain[r]).for_each(|error| *error += chance);
            }
        }
        held
    }

    /// r² of the mean speeds of held-out runs; none below three duties.
    pub fn mean_speed_r2(&self, model: &Model, accepted: &[Accepted]) -> Option<f64> {
        if self.problem.duties() < 3 {
            return None;
        }
        let (designs, scales, _) = self.designs(model, accepted);
        let set: Vec<usize> = (0..self.free(model, accepted).len()).collect();
        let grams = Grams::new(&designs, 0, &scales, Some(self.keys), self.divisions.to_vec());
        let mut errors = vec![0.0; designs.len()];
        for (fold, beta) in grams.fold_fits(&set) {
            for r in fold.test {
                errors[r] = mean_error(&designs[r], &set, &beta);
            }
        }
        let speeds: Vec<f64> = self.problem.runs.iter().map(|r| r.mean_speed_rpm()).collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
        let total: f64 = speeds.iter().map(|s| (s - mean).powi(2)).sum();
        let rest: f64 = errors.iter().map(|e| e * e).sum();
        (total > 0.0).then(|| 1.0 - rest / total)
    }

    /// How much more squared error each of `models` leaves than exact times, the spread of the run gains and the rotor equation's own
    /// errors explain: a share of the speed, and of the free speed in the milliseconds after each switching. `None` unless every run is
    /// open loop with timestamped edges.
    pub fn misfits_of_exact_times(&self, models: [&Model; 2], gain_spread: f64) -> Option<[f64; 2]> {
        let exact = |r: &Observed| r.kind == RunKind::Speed && r.pitch > 0.0 && r.half_sample_s() == 0.0;
        if !self.problem.runs.iter().all(exact) {
            return None;
        }
        let seconds: f64 = self.problem.runs.iter().map(|r| r.compared_s()).sum::<f64>().max(1e-9);
        let last = models[1];
        let switching: f64 = self.problem.design(last, &discrepancy()).iter().flat_map(|d| &d.x).map(|x| x * x).sum();
        let expected = self.noise_floor(last, gain_spread).powi(2)
            + (EQUATION_ERROR * self.problem.rms_speed_rpm()).powi(2)
            + DISCREPANCY * DISCREPANCY * switching / seconds;
        Some(models.map(|m| objective(self.problem, m, 1.0, 0.0) / seconds / expected.max(1e-12)))
    }

    /// What sampling and the spread of the run gains leave, in rpm.
    pub fn noise_floor(&self, model: &Model, gain_spread: f64) -> f64 {
        let (mut sum, mut seconds) = (0.0, 0.0);
        for (run, r) in self.problem.runs.iter().zip(self.problem.residuals(model)) {
            for (k, w) in run.windows.iter().enumerate() {
                let dt = run.duration(w).max(1e-6);
                let (a, b) = (r.speed[w.from], r.speed[w.to]);
                let timing = if w.low == w.high { run.time_spread * (a * a + b * b).sqrt() / dt * RPM } else { 0.0 };
                let gain = gain_spread * r.predicted[k];
                sum += (timing * timing + gain * gain) * dt;
                seconds += dt;
            }
        }
        (sum / seconds.max(1e-12)).sqrt()
    }

    /// Root mean square angle error of a replay, in degrees.
    pub fn position_error_deg(&self, model: &Model) -> f64 {
        let (mut sum, mut seconds) = (0.0, 0.0);
        for (run, r) in self.problem.runs.iter().zip(self.problem.residuals(model)) {
            let (mut error, mut at) = (0.0, 0);
            for (k, w) in run.windows.iter().enumerate() {
                // Stretches overlap: from one to the next that begins where it ends.
                if w.from < at {
                    continue;
                }
                at = w.to;
                let dt = run.duration(w);
                error += r.rpm[k] * dt * 6.0;
                sum += error * error * dt;
                seconds += dt;
            }
        }
        (sum / f64::max(seconds, 1e-12)).sqrt()
    }

    /// Shares of the baseline's squared error that each effect removes, averaged over the orders of adding them.
    pub fn share_out(&self, model: &Model, accepted: &[Accepted], findings: &mut [Finding]) {
        let n = accepted.len();
        if n == 0 {
            return;
        }
        let runs = self.problem.runs.len();
        let everything = [Fold { train: (0..runs).collect(), test: (0..runs).collect() }];
        let unkeyed = Case { keys: &[], divisions: &everything, ..self.clone() };
        let error: Vec<f64> = (0..1usize << n)
            .map(|subset| {
                let mut m = model.clone();
                for (k, a) in accepted.iter().enumerate() {
                    if subset & (1 << k) == 0 {
                        m = strip(&m, a);
                    }
                }
                let (m, _) = refit(self.problem, m, &self.base_free, &[], 2);
                let held = unkeyed.held_out(&m, &[], None);
                held.plain.iter().map(|p| p[0]).sum()
            })
            .collect();
        let factorial = |k: usize| (1..=k).map(|v| v as f64).product::<f64>();
        for (k, a) in accepted.iter().enumerate() {
            let mut share = 0.0;
            for subset in 0..1usize << n {
                if subset & (1 << k) == 0 {
                    let s = subset.count_ones() as usize;
                    let weight = factorial(s) * factorial(n - s - 1) / factorial(n);
                    share += weight * (error[subset] - error[subset | (1 << k)]);
                }
            }
            if let Some(f) =
                findings.iter_mut().find(|f| f.name == self.effects[a.effect].name && f.status != Status::Rejected)
            {
                f.share = share / error[0].max(1e-12);
            }
        }
    }
}

fn amplitudes(model: &Model, accepted: &[Accepted]) -> Vec<f64> {
    let n = model.terms.len().max(1) as f64;
    let mut out = Vec::new();
    for p in accepted.iter().flat_map(|a| &a.phased) {
        let power: f64 = model
            .terms
            .iter()
            .map(|t| {
                let c = match p {
                    Phased::Runout(h) => [t.runout[2 * h], t.runout[2 * h + 1]],
                    Phased::Eccentricity => t.eccentricity,
                    Phased::Gravity => t.gravity,
                };
                c[0] * c[0] + c[1] * c[1]
            })
            .sum();
        out.push((power / n).sqrt());
    }
    out
}

fn mean_error(d: &RunDesign, set: &[usize], beta: &DVector<f64>) -> f64 {
    let mut sum = 0.0;
    for k in 0..d.y.len() {
        let fit: f64 = set.iter().zip(beta.iter()).map(|(c, b)| d.x[k * d.columns + c] * b).sum();
        sum += (d.y[k] - fit) * d.weight[k];
    }
    sum / d.seconds.max(1e-12)
}
