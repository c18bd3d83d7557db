//! How well a set of effects does where it was not fitted.

use super::design::Column;
use super::discrepancy::SIZE;
use super::free::columns_of;
use super::ground::Ground;
use super::library::Phased;
use super::observe::{Observed, Window};
use super::problem::{Model, Problem, RPM};
use super::refit::{coefficients, refit};
use super::set::{Part, Set, phased_of};
use super::stats::{Fold, Grams, Group, HeldOut, Prior, folds};
use std::f64::consts::{PI, TAU};
use twum_record::measurement::RunKind;

/// Divisions of the runs that are held out together.
const FOLDS: usize = 5;
/// Least number of runs of which whole ones are held out; of fewer, later turns are.
pub const LEAST_RUNS: usize = 4;
/// End of the start-up in s: of few runs it happens once or twice, and is neither fitted nor scored.
const START_UP_S: f64 = 0.1;

/// Runs whose speed the others foretell quite otherwise, by more than this share of it, alone show what the motor does there. So far from where
/// it was fitted nothing here is linear, and no error of theirs says anything.
const LARGEST_CHANGE: f64 = 0.5;

/// What chance can do.
pub struct Chance {
    /// Largest improvement of any candidate in each null data set.
    null: Vec<f64>,
    /// Every effect alone beside the baseline, linearly, in its best form.
    pub alone: Vec<(usize, HeldOut)>,
}

impl Chance {
    /// Share of null data sets in which some candidate does as well.
    pub fn p(&self, held: &HeldOut) -> f64 {
        super::stats::p_value(held.improvement(), &self.null)
    }

    /// The errors of an effect alone.
    pub fn alone(&self, effect: usize) -> Option<&HeldOut> {
        self.alone.iter().find(|a| a.0 == effect).map(|a| &a.1)
    }
}

/// How runs are held out.
pub struct Scorer<'a> {
    pub(super) ground: &'a Ground<'a>,
    /// Runs with equal keys repeat each other.
    pub keys: Vec<String>,
    divisions: Vec<Fold>,
    /// Runs that alone show a parameter of the motor: they are fitted and cannot be scored.
    pub alone: Vec<usize>,
}

impl<'a> Scorer<'a> {
    /// Seeded divisions of the runs; which can be scored is the same for every set, and decided by `root`.
    pub fn new(ground: &'a Ground<'a>, root: &Set, seed: u64) -> Self {
        let runs = &ground.problem.runs;
        let keys: Vec<String> = runs
            .iter()
            .map(|r| format!("{:?}/{:.6}/{}/{}", r.kind, r.duty.unwrap_or(-1.0), r.direction, r.pwm_hz))
            .collect();
        let count = if runs.len() < 2 * FOLDS { runs.len() } else { FOLDS };
        let mut scorer = Self { ground, divisions: folds(&keys, count, seed), keys, alone: Vec::new() };
        if runs.len() >= LEAST_RUNS {
            let alone = scorer.shown_alone(root);
            // Where most are, it is the motor that these runs do not determine, and leaving them out would hide it.
            if 2 * alone.len() < runs.len() {
                scorer.alone = alone;
            }
        }
        scorer
    }

    /// Runs that would be quite another without what they say of the motor themselves.
    fn shown_alone(&self, root: &Set) -> Vec<usize> {
        let (grams, free, _) = self.equations(root, &[]);
        let own: Vec<usize> = (0..free).collect();
        let designs = self.ground.problem.design(&root.model, &columns_of(&self.ground.free(&root.model, &root.parts)));
        let moved = |run: usize, steps: &[f64]| {
            let d = &designs[run];
            let rows = d.x.chunks_exact(d.columns);
            let squares = rows.map(|row| {
                let step: f64 = row.iter().zip(steps).map(|(x, b)| x * b).sum();
                [step * step, row[0] * row[0]]
            });
            let [step, speed] = squares.fold([0.0; 2], |sum, s| [sum[0] + s[0], sum[1] + s[1]]);
            (step / speed.max(1e-12)).sqrt()
        };
        let folds = grams.fold_fits(&own).into_iter();
        let of = |(fold, steps): (Fold, nalgebra::DVector<f64>)| {
            let quite_another = |run: &usize| moved(*run, steps.as_slice()) > LARGEST_CHANGE;
            fold.test.into_iter().filter(quite_another).collect::<Vec<_>>()
        };
        folds.flat_map(of).collect()
    }

    /// Normal equations of a set with further columns, priors and noise in them, and the columns of its own parameters and pairs.
    pub fn equations(&self, set: &Set, more: &[Column]) -> (Grams, usize, Vec<[usize; 2]>) {
        let free = self.ground.free(&set.model, &set.parts);
        let mut columns = columns_of(&free);
        let mut pairs = Vec::new();
        for p in set.parts.iter().flat_map(|p| &p.phased) {
            pairs.push([columns.len(), columns.len() + 1]);
            columns.extend(p.columns());
        }
        let from = columns.len();
        columns.extend(more.iter().cloned());
        let noise = self.ground.noise(set);
        let prior_of = |k: usize| -> Prior {
            if k >= from {
                let precision = noise.variance / (SIZE * SIZE);
                return Prior { precision, pull: 0.0, noise: noise.variance * precision };
            }
            let Some(f) = free.get(k) else { return Prior::default() };
            let (slope, curvature) = f.prior.pull(set.model.parameters.get(f.parameter));
            let precision = noise.variance * curvature * f.scale * f.scale;
            Prior { precision, pull: -noise.variance * slope * f.scale, noise: noise.variance * precision }
        };
        let priors = (0..columns.len()).map(prior_of).collect();
        let designs = self.ground.problem.design(&set.model, &columns);
        // The scales only keep a singular matrix from being one: what is known is in the priors.
        let grams = Grams::new(&designs, 0, &vec![30.0; columns.len()], Some(&self.keys), self.divisions.clone());
        (grams.beside(noise).with_prior(priors), free.len(), pairs)
    }

    /// Errors on runs that were not fitted: everything common is fitted again without them, linearly around the set's model.
    pub fn held_out(&self, set: &Set) -> HeldOut {
        if self.ground.problem.runs.len() < LEAST_RUNS {
            return self.later_turns(set);
        }
        let (grams, free, pairs) = self.equations(set, &[]);
        let own: Vec<usize> = (0..free).collect();
        let mut held = hold_out(&grams, &grams.clone().beside_sampling(), &own, &Group::Linear(Vec::new()));
        if !pairs.is_empty() {
            // Phases were fitted on the very runs that are scored: take off what that is worth by chance.
            let amplitudes: Vec<f64> = set.weighed.powers.iter().map(|p| (2.0 * p).sqrt()).collect();
            for (r, f) in grams.phased_freedom(&pairs, &amplitudes).iter().enumerate() {
                let chance = 2.0 * grams.variance * f;
                held.loss[r].iter_mut().chain(&mut held.plain[r]).for_each(|error| *error += chance);
            }
        }
        for &r in &self.alone {
            (held.loss[r], held.plain[r], held.seconds[r]) = ([0.0; 2], [0.0; 2], 0.0);
        }
        held
    }

    /// The same for few runs: fitted on the first turn of each, scored by half turns on what follows.
    fn later_turns(&self, set: &Set) -> HeldOut {
        let problem = self.ground.problem;
        let mut first = problem.clone();
        for run in &mut first.runs {
            let started = |w: &Window| run.kind == RunKind::Track || w.middle(&run.times) >= START_UP_S;
            let keep: Vec<Window> = run.windows.iter().copied().filter(|w| !is_later(run, w) && started(w)).collect();
            run.windows = keep;
        }
        let model = self.refit_on(&first, &set.model, &set.parts, set);
        let mut held = HeldOut::default();
        for (run, residual) in problem.runs.iter().zip(problem.residuals(&model)) {
            let mut pieces: std::collections::BTreeMap<usize, (f64, f64)> = std::collections::BTreeMap::new();
            for (w, rpm) in run.windows.iter().zip(&residual.rpm) {
                if !is_later(run, w) || w.middle(&run.times) > run.drive_end {
                    continue;
                }
                let piece = pieces.entry((w.middle(&run.angles).abs() / PI) as usize).or_default();
                piece.0 += rpm * rpm * run.duration(w);
                piece.1 += run.duration(w);
            }
            for (error, seconds) in pieces.into_values() {
                held.loss.push([error; 2]);
                held.plain.push([error; 2]);
                held.seconds.push(seconds);
            }
        }
        held
    }

    fn refit_on(&self, problem: &Problem, model: &Model, parts: &[Part], set: &Set) -> Model {
        // Under full drive a rotor starts once and never stops: a turn of it says nothing of its friction.
        let mut free = self.ground.free(model, parts);
        if !problem.pulsed() {
            free.truncate(1);
        }
        let covariance = self.ground.covariance(self.ground.scatter(set));
        refit(problem, model.clone(), &free, &phased_of(parts), &covariance, 8)
    }

    /// r² of the mean speeds of held-out runs; none below three duties.
    pub fn mean_speed_r2(&self, set: &Set) -> Option<f64> {
        let problem = self.ground.problem;
        if problem.duties() < 3 || problem.runs.len() < LEAST_RUNS {
            return None;
        }
        let (grams, free, _) = self.equations(set, &[]);
        let designs = problem.design(&set.model, &columns_of(&self.ground.free(&set.model, &set.parts)));
        let own: Vec<usize> = (0..free).collect();
        let mut errors = vec![0.0; designs.len()];
        for (fold, beta) in grams.fold_fits(&own) {
            for r in fold.test.into_iter().filter(|r| !self.alone.contains(r)) {
                let d = &designs[r];
                let rest = |k: usize| -> f64 {
                    d.y[k] - own.iter().zip(beta.iter()).map(|(c, b)| d.x[k * d.columns + c] * b).sum::<f64>()
                };
                errors[r] = (0..d.y.len()).map(|k| rest(k) * d.weight[k]).sum::<f64>() / d.seconds.max(1e-12);
            }
        }
        let scored = (0..errors.len()).filter(|r| !self.alone.contains(r));
        let speeds: Vec<f64> = scored.map(|r| problem.runs[r].mean_speed_rpm()).collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
        let total: f64 = speeds.iter().map(|s| (s - mean).powi(2)).sum();
        (total > 0.0).then(|| 1.0 - errors.iter().map(|e| e * e).sum::<f64>() / total)
    }

    /// What sampling and the spread of the gains leave, in rpm.
    pub fn noise_floor(&self, set: &Set) -> f64 {
        let problem = self.ground.problem;
        let (mut sum, mut seconds) = (0.0, 0.0);
        for (run, r) in problem.runs.iter().zip(problem.residuals(&set.model)) {
            for (k, w) in run.windows.iter().enumerate() {
                let dt = run.duration(w).max(1e-6);
                let (a, b) = (r.trajectory.speed[w.from], r.trajectory.speed[w.to]);
                let timing = if w.low == w.high { run.time_spread * (a * a + b * b).sqrt() / dt * RPM } else { 0.0 };
                let gain = set.weighed.taus[0] * r.predicted[k];
                sum += (timing * timing + gain * gain) * dt;
                seconds += dt;
            }
        }
        (sum / f64::max(seconds, 1e-12)).sqrt()
    }

    /// Root mean square angle error of a replay, in degrees.
    pub fn position_error_deg(&self, model: &Model) -> f64 {
        let problem = self.ground.problem;
        let (mut sum, mut seconds) = (0.0, 0.0);
        for (run, r) in problem.runs.iter().zip(problem.residuals(model)) {
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

    /// Share of null data sets in which some candidate of the library does as well as each of `forms` on runs that were not fitted, around
    /// the set `root`; see [`Grams::screen`].
    pub fn chance(&self, root: &Set, gains: &[f64], repetitions: usize, seed: u64) -> Chance {
        let ground = self.ground;
        let mut columns: Vec<Column> = Vec::new();
        let mut groups = Vec::new();
        let base = ground.free(&root.model, &root.parts).len();
        for &effect in &ground.usable {
            for form in &ground.effects[effect].forms {
                let at = base + columns.len();
                if form.phased.is_empty() {
                    columns.extend(form.columns());
                    groups.push((effect, Group::Linear((at..base + columns.len()).collect())));
                } else {
                    columns.extend(form.phased.iter().flat_map(|p| p.columns()));
                    groups.push((
                        effect,
                        Group::Phased((0..form.phased.len()).map(|k| [at + 2 * k, at + 2 * k + 1]).collect()),
                    ));
                }
            }
        }
        let (grams, free, _) = self.equations(root, &columns);
        let own: Vec<usize> = (0..free).collect();
        let plain: Vec<Group> = groups.iter().map(|g| g.1.clone()).collect();
        let sampled = grams.clone().beside_sampling();
        let (improvements, null) = sampled.screen(&own, &plain, gains, repetitions, seed);
        let alone = ground
            .usable
            .iter()
            .filter_map(|effect| {
                let forms = (0..groups.len()).filter(|k| groups[*k].0 == *effect);
                let best = forms.max_by(|a, b| improvements[*a].total_cmp(&improvements[*b]))?;
                Some((*effect, hold_out(&grams, &sampled, &own, &plain[best])))
            })
            .collect();
        Chance { null, alone }
    }

    /// Phased coefficients of every run of a set, pair by pair.
    pub fn phases(&self, set: &Set, pair: Phased) -> Vec<[f64; 2]> {
        coefficients(&set.model, &[pair]).iter().map(|z| [z[0], z[1]]).collect()
    }
}

/// Errors on runs that were not fitted, under the likelihood that the model was fitted under; what decides is held against chance beside `sampled` noise.
fn hold_out(grams: &Grams, sampled: &Grams, own: &[usize], group: &Group) -> HeldOut {
    let loss = sampled.hold_out_around_a_fit(own, group).loss;
    HeldOut { loss, ..grams.hold_out_around_a_fit(own, group) }
}

/// Whether a window lies in the part of a run that is scored: after the first turn, or, of less than one and a half, after half the time.
pub fn is_later(run: &Observed, w: &Window) -> bool {
    let by_turns = run.revolutions() >= 1.5 && run.reversals.is_empty();
    if by_turns {
        w.middle(&run.angles).abs() >= TAU
    } else {
        w.middle(&run.times) >= 0.5 * run.drive_end.min(run.record_end)
    }
}
