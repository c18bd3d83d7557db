//! Effects that might join a set: all their forms, weighed linearly, and the set with one of them.

use super::baseline::as_listed;
use super::design::Column;
use super::evidence::{Equations, Spreads, Start, weigh};
use super::free::Free;
use super::ground::{Ground, Scatter};
use super::library::{Form, Size};
use super::prior::Prior;
use super::problem::Model;
use super::refit::coefficients;
use super::rotor::P;
use super::set::{Part, Set, phased_of};
use rayon::prelude::*;

/// Linear gain in nats from which a form is refitted: a refit seldom finds more than another nat, and an effect costs three.
pub(super) const LEAST_LOOK: f64 = 2.0;

/// A form of an effect beside a set.
pub(super) struct Candidate {
    /// Index in the library.
    pub effect: usize,
    /// Index among the effect's forms.
    pub form: usize,
    /// Nats that it would bring, linearly.
    pub gain: f64,
    values: Vec<f64>,
}

/// A form with its places among the columns.
struct Laid {
    effect: usize,
    form: usize,
    sizes: Vec<usize>,
    pairs: Vec<usize>,
}

impl Ground<'_> {
    /// All forms of the effects `among` beside a set, weighed linearly: the two best forms of each, best effects first, that bring `least` nats.
    pub(super) fn candidates(&self, from: &Set, among: &[usize], least: f64) -> Vec<Candidate> {
        let (mut columns, base) = self.columns(&from.model, &from.parts);
        let own_columns = base.own_range();
        let forms = self.lay_out(from, among, &mut columns);
        let phased = phased_of(&from.parts);
        let designs = self.problem.design(&from.model, &columns);
        let equations = Equations::new(&designs, own_columns, &coefficients(&from.model, &phased));
        let ask = |sizes: &[usize], pairs: &[usize], start: &Start| {
            let mut q = base.clone();
            q.common.extend(sizes.iter().map(|c| (*c, 1.0)));
            let group = q.own.iter().map(|o| o.1 + 1).max().unwrap_or(0);
            q.own.extend(pairs.iter().enumerate().map(|(i, c)| (*c, group + i / 2)));
            weigh(&equations, &self.level, &q, start)
        };
        let start = |taus, spreads| Start {
            variance: from.weighed.variance,
            taus,
            without: from.weighed.left.max(0.0),
            spreads,
        };
        let believed = self.level.believed();
        let Some(now) = ask(&[], &[], &start(from.weighed.taus, Spreads::Stay)) else { return Vec::new() };
        let mut weighed: Vec<Candidate> = forms
            .par_iter()
            .filter_map(|Laid { effect, form, sizes, pairs }| {
                let spec = &self.effects[*effect].forms[*form];
                let looks = [from.weighed.taus, believed]
                    .into_iter()
                    .filter_map(|t| ask(sizes, pairs, &start(t, Spreads::Stay)));
                let best = looks.max_by(|a, b| a.log.total_cmp(&b.log))?;
                let values = self.admissible(spec, &best.shared[base.common.len()..])?;
                Some(Candidate { effect: *effect, form: *form, gain: best.log - now.log, values })
            })
            .collect();
        weighed.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        // The two best forms of each effect, with the spreads of the gains found anew.
        let mut kept: Vec<Candidate> = Vec::new();
        for c in weighed {
            if kept.iter().filter(|k| k.effect == c.effect).count() < 2 {
                kept.push(c);
            }
        }
        let of = |c: &Candidate| forms.iter().find(|f| f.effect == c.effect && f.form == c.form);
        kept.par_iter_mut().for_each(|c| {
            if let Some(Laid { sizes, pairs, .. }) = of(c)
                && let Some(w) = ask(sizes, pairs, &start(from.weighed.taus, Spreads::Near))
                && let Some(values) =
                    self.admissible(&self.effects[c.effect].forms[c.form], &w.shared[base.common.len()..])
            {
                c.gain = w.log - now.log;
                c.values = values;
            }
        });
        kept.retain(|c| c.gain > least);
        kept.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        kept
    }

    /// The columns of all forms of the effects `among` that may join a set, added to `columns`.
    fn lay_out(&self, from: &Set, among: &[usize], columns: &mut Vec<Column>) -> Vec<Laid> {
        let present = from.key();
        let mut forms = Vec::new();
        for &effect in among {
            if present.contains(&effect) || self.excluded(effect, &present) {
                continue;
            }
            // What a part changes already has one size.
            let taken = |f: &Form| f.sizes.iter().any(|s| from.parts.iter().any(|p| p.changes(s.parameter)));
            let forms_of = self.effects[effect].forms.iter().enumerate().filter(|(_, f)| !taken(f));
            for (k, form) in forms_of {
                let sizes: Vec<usize> = form.columns().into_iter().map(|c| place(columns, c)).collect();
                let shape: Vec<(P, f64)> = form.shapes.iter().map(|s| (s.parameter, s.start)).collect();
                let pairs: Vec<usize> = form
                    .phased
                    .iter()
                    .flat_map(|p| p.columns())
                    .map(|c| {
                        place(columns, if shape.is_empty() { c } else { Column::Shaped(Box::new(c), shape.clone()) })
                    })
                    .collect();
                forms.push(Laid { effect, form: k, sizes, pairs });
            }
        }
        forms
    }

    /// Effects that are not both in a set: they are one thing seen from two sides.
    fn excluded(&self, effect: usize, present: &[usize]) -> bool {
        present.iter().any(|p| self.effects[effect].is_twin(&self.effects[*p]))
    }

    /// Whether two effects may be in one set, as these forms of them.
    pub(super) fn may_join(&self, one: &Part, other: &Part) -> bool {
        !self.excluded(one.effect, &[other.effect]) && one.free.iter().all(|f| !other.changes(f.parameter))
    }

    /// Sizes from the coefficients of a linear search, if they can be.
    fn admissible(&self, form: &Form, coefficients: &[f64]) -> Option<Vec<f64>> {
        form.sizes
            .iter()
            .zip(coefficients)
            .map(|(s, c)| {
                let value = c * s.scale;
                let secant = s.step.abs() >= 0.99 * s.scale;
                // A secant stands for sizes near its own; a size of one sign cannot be of the other.
                let near = !secant || (0.4..=1.8).contains(&(value / s.step));
                let sign = s.bounds.0 < 0.0 || value >= 0.4 * s.bounds.0.max(0.0) && value > 0.0;
                (near && sign).then(|| value.clamp(s.bounds.0, s.bounds.1))
            })
            .collect()
    }

    /// The set with a candidate in it, refitted.
    pub(super) fn with(&self, from: &Set, candidate: &Candidate, root: &Set) -> Set {
        let spec = &self.effects[candidate.effect].forms[candidate.form];
        let part =
            Part { effect: candidate.effect, form: candidate.form, free: free_of(spec), phased: spec.phased.clone() };
        let mut start = from.model.clone();
        for s in &spec.shapes {
            start.parameters.set(s.parameter, s.start);
        }
        let mut parts = from.parts.clone();
        parts.push(part);
        // What the gains scatter by for want of the effect is not theirs.
        let Scatter { variance, taus } = self.scatter(from);
        let believed = self.level.believed();
        let scatter = Scatter { variance, taus: std::array::from_fn(|k| taus[k].min(believed[k])) };
        let at = |share: f64| {
            let mut m = start.clone();
            for (s, v) in spec.sizes.iter().zip(&candidate.values) {
                m.parameters.set(s.parameter, share * v);
            }
            m
        };
        // The linear size may lie in another valley than the optimum, and the baseline's refit may have taken part of the effect.
        let mut starts = vec![at(1.0)];
        if !spec.sizes.is_empty() {
            let own = at(1.0);
            starts.push(Model { parameters: as_listed(&own.parameters, &self.home), terms: own.terms });
            if spec.sizes.iter().all(|s| s.step.abs() < 0.99 * s.scale) {
                starts.push(at(0.4));
            }
        }
        let value = |m: &Model| self.misfit(m, &parts, scatter);
        let looked: Vec<Model> = starts.into_par_iter().map(|s| self.refitted(s, &parts, scatter, 2)).collect();
        let best = looked.into_iter().min_by(|a, b| value(a).total_cmp(&value(b)));
        let model = best.unwrap_or(start);
        let model = self.refitted(model, &parts, scatter, 6);
        self.weigh_set(parts, model, Some(root))
    }
}

/// The index of a column, which is added if it is new.
fn place(columns: &mut Vec<Column>, column: Column) -> usize {
    columns.iter().position(|c| *c == column).unwrap_or_else(|| {
        columns.push(column);
        columns.len() - 1
    })
}

/// What of a form is fitted.
pub(super) fn free_of(form: &Form) -> Vec<Free> {
    let size = |s: &Size| Free {
        parameter: s.parameter,
        scale: if s.parameter == P::ClockError { s.scale.min(1e-3) } else { s.scale },
        bounds: s.bounds,
        // A number that lies in a range away from zero is there as a whole.
        prior: Prior::Normal {
            centre: if s.bounds.0 > 0.0 { 0.5 * (s.bounds.0 + s.bounds.1) } else { 0.0 },
            sd: if s.bounds.0 > 0.0 { 0.05 } else { s.scale },
        },
    };
    let shapes = form.shapes.iter().filter_map(|s| {
        s.prior.map(|p| Free {
            parameter: s.parameter,
            scale: 0.5 * s.start,
            bounds: s.bounds,
            prior: Prior::LogNormal { median: p.median, log_sd: p.log_sd },
        })
    });
    form.sizes.iter().map(size).chain(shapes).collect()
}
