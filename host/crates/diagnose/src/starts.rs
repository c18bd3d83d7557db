//! Sets that no linear look from the baseline leads to: clocks that err by periods of the PWM, effects as large as is plausible, and pairs of them,
//! with the motor refitted beside them.

use super::baseline::at_speed;
use super::candidate::free_of;
use super::ground::{Ground, Scatter};
use super::library::Form;
use super::problem::{Model, Problem};
use super::rotor::{P, Parameters};
use super::search::{FEW_STEPS, TRIED};
use super::set::{Part, Set};
use rayon::prelude::*;

/// Pairs of effects that are refitted.
const PAIRS: usize = 2;

/// Effects beside a motor, fitted to a few of the runs.
struct Start {
    misfit: f64,
    parts: Vec<Part>,
    parameters: Parameters,
}

impl Ground<'_> {
    /// A clock error from the motor that was refitted beside a wrong `clock`, and from where the PWM's line stands.
    pub(super) fn wrong_clocks(&self, clock: Option<&Model>, pool: &mut Vec<Set>) {
        let at = |error: f64| {
            let Model { parameters, terms } = &pool[0].model;
            Model { parameters: parameters.with(P::ClockError, error), terms: terms.clone() }
        };
        let at_lines: Vec<Model> = self.lines().map(at).collect();
        for model in clock.into_iter().chain(&at_lines) {
            if let Some(set) = self.wrong_clock(model, &pool[0]) {
                self.put(set, pool);
            }
        }
    }

    /// Clock errors at which the PWM's line stands: a linear look from no error does not get as far as half a period of drift.
    fn lines(&self) -> impl Iterator<Item = f64> {
        let forms = self.usable.iter().flat_map(|e| &self.effects[*e].forms);
        let sizes = forms.filter(|f| f.sizes.len() == 1).map(|f| &f.sizes[0]);
        sizes.filter(|s| s.parameter == P::ClockError && s.step.abs() >= s.scale).map(|s| s.step)
    }

    /// The set of a clock error alone, from a motor that was refitted beside it, in the form that is meant for so large a one.
    fn wrong_clock(&self, model: &Model, root: &Set) -> Option<Set> {
        let error = model.parameters.get(P::ClockError).abs();
        let of_error = |f: &Form| f.sizes.len() == 1 && f.sizes[0].parameter == P::ClockError;
        let far = |f: &Form| (f.sizes[0].scale / error.max(1e-9)).ln().abs();
        let forms =
            self.usable.iter().flat_map(|e| self.effects[*e].forms.iter().enumerate().map(move |(k, f)| (*e, k, f)));
        let (effect, form, spec) = forms.filter(|f| of_error(f.2)).min_by(|a, b| far(a.2).total_cmp(&far(b.2)))?;
        let parts = vec![Part { effect, form, free: free_of(spec), phased: Vec::new() }];
        let model = self.refitted(model.clone(), &parts, self.scatter(root), 8);
        Some(self.weigh_set(parts, model, Some(root)))
    }

    /// Effects that do most alone where they are as large as is plausible and the motor is refitted beside them, to a few of the runs: what the
    /// baseline's refit has taken up of an effect, no look around that baseline shows.
    pub(super) fn each_alone(&self, other: &Set, pool: &mut Vec<Set>) {
        let scatter = self.scatter(&pool[0]);
        let few = self.problem.thinned();
        let (ground, scatter_of_few) = self.of_some_runs(&few, scatter);
        let motors = [&pool[0], other].map(|set| set.model.parameters.clone());
        let held = |effect: &usize| ground.held(*effect, &motors, scatter_of_few);
        let alone = self.usable.par_iter().filter_map(held).collect();
        self.refit_the_best(alone, TRIED, scatter, pool);
    }

    /// The misfit of the best of `motors` refitted beside an effect that is as large as is plausible; `None` of one that has no size.
    fn held(&self, effect: usize, motors: &[Parameters], scatter: Scatter) -> Option<Start> {
        let common = |f: &&Form| !f.sizes.is_empty() && f.phased.is_empty();
        let (form, spec) = self.effects[effect].forms.iter().enumerate().find(|f| common(&f.1))?;
        let both_ways = spec.sizes.iter().all(|s| s.bounds.0 < 0.0);
        let signs = [1.0, -1.0].into_iter().take(1 + usize::from(both_ways));
        let starts = signs.flat_map(|sign| motors.iter().map(move |motor| (sign, motor)));
        let held = starts.map(|(sign, motor)| {
            let shaped = spec.shapes.iter().fold(motor.clone(), |p, s| p.with(s.parameter, s.start));
            let sized = spec.sizes.iter().fold(shaped, |p, s| p.with(s.parameter, sign * s.scale));
            let model = self.refitted(at_speed(self.problem, self.problem.model(sized)), &[], scatter, FEW_STEPS);
            (self.misfit(&model, &[], scatter), model.parameters)
        });
        let (misfit, parameters) = held.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let part = Part { effect, form, free: free_of(spec), phased: Vec::new() };
        Some(Start { misfit, parts: vec![part], parameters })
    }

    /// Pairs of the effects that do most alone, from the motor of either: the other one's motor may have taken up so much that beside it the second
    /// effect does nothing at all.
    pub(super) fn both_alone(&self, pool: &mut Vec<Set>) {
        let root = pool[0].score;
        let common = |s: &&Set| s.parts.len() == 1 && s.parts[0].phased.is_empty() && s.score.is_finite();
        let mut alone: Vec<&Set> = pool.iter().filter(common).collect();
        alone.sort_by(|a, b| b.score.total_cmp(&a.score));
        alone.truncate(TRIED);
        let pairs = alone.iter().enumerate().flat_map(|(i, b)| alone[..i].iter().map(move |a| [*a, *b]));
        let may_be = |[a, b]: &[&Set; 2]| a.score > root && self.may_join(&a.parts[0], &b.parts[0]);
        let pairs: Vec<[&Set; 2]> = pairs.filter(may_be).collect();
        if pairs.is_empty() {
            return;
        }
        let scatter = self.scatter(alone[0]);
        let few = self.problem.thinned();
        let (ground, scatter_of_few) = self.of_some_runs(&few, scatter);
        let from_either = |pair: [&Set; 2]| {
            let parts = pair.map(|s| s.parts[0].clone()).to_vec();
            let joined = |[motor, other]: [&Set; 2]| {
                let Part { effect, form, .. } = other.parts[0];
                let Form { sizes, shapes, .. } = &self.effects[effect].forms[form];
                let values = sizes.iter().map(|s| s.parameter).chain(shapes.iter().map(|s| s.parameter));
                let both = |p: Parameters, which: P| p.with(which, other.model.parameters.get(which));
                let start = few.model(values.fold(motor.model.parameters.clone(), both));
                let model = ground.refitted(start, &parts, scatter_of_few, FEW_STEPS);
                (ground.misfit(&model, &parts, scatter_of_few), model.parameters)
            };
            let [a, b] = pair;
            let [one, two] = [[a, b], [b, a]].map(joined);
            let (misfit, parameters) = if one.0 <= two.0 { one } else { two };
            Start { misfit, parts, parameters }
        };
        let joined = pairs.into_par_iter().map(from_either).collect();
        self.refit_the_best(joined, PAIRS, scatter, pool);
    }

    /// The `most` that fit best of what was fitted to a few of the runs, refitted to all.
    fn refit_the_best(&self, mut starts: Vec<Start>, most: usize, scatter: Scatter, pool: &mut Vec<Set>) {
        starts.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
        starts.truncate(most);
        let root = &pool[0];
        let refitted = |Start { parts, parameters, .. }: Start| {
            let model = self.refitted(self.problem.model(parameters), &parts, scatter, 8);
            self.weigh_set(parts, model, Some(root))
        };
        self.put_all(starts.into_par_iter().map(refitted).collect(), pool);
    }

    /// The same for some of the runs, and the noise beside which as much of the data says as many nats.
    pub(super) fn of_some_runs<'a>(&'a self, few: &'a Problem, scatter: Scatter) -> (Ground<'a>, Scatter) {
        let ground = Ground::new(few, self.home.clone(), self.effects, self.usable.clone());
        let share = few.windows() / self.problem.windows() * self.independent / ground.independent;
        (ground, Scatter { variance: scatter.variance * share, ..scatter })
    }
}
