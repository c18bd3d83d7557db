//! The search over sets of effects: best first, with removals and swaps.
//!
//! Every set is refitted together with the baseline's own parameters and weighed by its evidence. From a set, all forms of all other
//! effects are weighed linearly; those of the few best effects are refitted and join the pool. The search is bounded by counts.

use super::baseline::{as_listed, at_speed, valleys};
use super::candidate::{LEAST_LOOK, free_of};
use super::cycles::cycles;
use super::discrepancy::FREE_FORM_COST;
use super::form_error::{FORM_ERROR, FormError};
use super::ground::Ground;
use super::library::{Coordinate, Form};
use super::problem::Model;
use super::refit::{coefficients, put_coefficients, within};
use super::rotor::P;
use super::set::{Part, Set, key, strip};
use super::verdict::MOST_OF_A_COURSE;
use rayon::prelude::*;

/// Most effects in a set.
pub(super) const MOST_EFFECTS: usize = 4;
/// Most sets from which others are looked for.
pub(super) const MOST_EXPANDED: usize = 6;
/// Effects of a set's candidates that are refitted.
pub(super) const TRIED: usize = 4;
/// Sets from which others are looked for in vain before it is enough.
const IN_VAIN: usize = 2;
/// Times that the search goes on from another set that leads once rivals were put in the places of the best one's effects.
const SWAPS: usize = 2;
/// Share of the root's noise below which its baseline is doubted: a fifth of what it was chosen by was none.
const MOST_NOISE_LEFT: f64 = 0.8;
/// How many other rotors are refitted to a few of the runs beside a set, and for how many steps: each one a little, the best of these further.
const LOOKS: [(usize, usize); 2] = [(usize::MAX, 1), (TRIED, FEW_STEPS)];
/// Most sets that are refitted to the end, and for how many steps.
const FINISHED: usize = 8;
const LAST_STEPS: usize = 24;
/// Nats that the last refit of a set may lose: its least error, beside the priors, lies a little off the greatest evidence.
const NOT_KEPT: f64 = 1.0;
/// Share of the error of form that was counted below which all sets are weighed anew: a tenth less is as many nats as an effect may be behind.
const LEAST_SHRUNK: f64 = 0.9;
/// Steps of a first look: beside an effect of a given size, from another rotor, without an effect.
pub(super) const FEW_STEPS: usize = 4;
/// Nats behind what the best candidate brought from which one waits for a later set, and behind the best set from which a set is not looked at
/// further: what a linear look promises is often not kept.
const FAR_BEHIND: f64 = 20.0;

impl Ground<'_> {
    /// Searches from the refitted baseline, and from a motor beside a wrong `clock` where one was read off the records; every set that was
    /// visited, best first.
    pub fn search(&mut self, baseline: Model, clock: Option<&Model>, progress: &dyn Fn(&str, f64)) -> Vec<Set> {
        let own = within(baseline.clone(), &self.free(&baseline, &[]));
        let hardened = own.parameters.get(P::SlipBand) < baseline.parameters.get(P::SlipBand);
        let mut pool = vec![self.root(own)];
        self.settle(&mut pool);
        self.terms.extend(cycles(self.problem, &pool[0].model.parameters));
        pool[0] = self.root(pool[0].model.clone());
        self.missing_friction(&mut pool);
        if hardened {
            self.soft_contact(baseline, &mut pool);
        }
        self.wrong_clocks(clock, &mut pool);
        // Which motor it is may have been answered wrongly for want of an effect: they are looked for around both.
        let other = self.of_the_file(&mut pool);
        self.expand(&other, &self.usable, TRIED, true, &mut pool);
        self.each_alone(&other, &mut pool);
        self.each_on_its_course(&mut pool);
        for turn in 0..=SWAPS {
            self.grow(&mut pool, turn, progress);
            let before = best(&pool).key();
            self.swap(&mut pool);
            if best(&pool).key() == before {
                break;
            }
        }
        self.finish(&mut pool);
        self.bound_form(&mut pool);
        pool.sort_by(|a, b| b.score.total_cmp(&a.score));
        pool
    }

    /// Sets with more effects, from the best on, until what is near the best leads nowhere.
    fn grow(&mut self, pool: &mut Vec<Set>, turn: usize, progress: &dyn Fn(&str, f64)) {
        let mut in_vain = 0;
        for round in 0..MOST_EXPANDED {
            progress(
                "weighing sets of effects",
                0.1 + 0.7 * (turn as f64 + round as f64 / MOST_EXPANDED as f64) / (SWAPS + 1) as f64,
            );
            // Terms without physics give way to what explains them, so that they do not close the way to it.
            let reach = |s: &Set| s.score - FREE_FORM_COST * s.terms.len() as f64;
            let farthest = pool.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
            let near = |s: &Set| s.parts.len() < MOST_EFFECTS && s.score > farthest - FAR_BEHIND;
            // What is no better than with an effect less has one that does nothing: it leads where that led.
            let leads = |s: &Set| !pool.iter().any(|less| less.expanded && less.is_worth_no_less_than(s));
            let open = |s: &Set| !s.expanded && near(s) && leads(s);
            let next =
                (0..pool.len()).filter(|i| open(&pool[*i])).max_by(|a, b| pool[*a].score.total_cmp(&pool[*b].score));
            let Some(at) = next else { break };
            pool[at].expanded = true;
            let from = pool[at].clone();
            let before = best(pool).score;
            self.expand(&from, &self.usable, TRIED, false, pool);
            if turn == 0 && round == 0 {
                self.reseat(pool);
                self.reseat_beside(pool);
                // After what the best alone leads to, which would be looked for no more from behind a pair.
                self.both_alone(pool);
            }
            in_vain = if best(pool).score > before { 0 } else { in_vain + 1 };
            if in_vain == 0 {
                self.extend_forms(pool);
            }
            self.remove(pool);
            if self.bound_form(pool) {
                in_vain = 0;
            }
            if in_vain == IN_VAIN {
                break;
            }
        }
    }

    /// Weighs all sets anew where the best leaves less than was counted as error of the forms, or what has one is less; whether it did.
    fn bound_form(&mut self, pool: &mut Vec<Set>) -> bool {
        let leader = best(pool);
        let exact: Vec<usize> = leader.key().into_iter().filter(|e| self.effects[*e].is_exact()).collect();
        let beside_exact = pool.iter().find(|s| s.key() == exact).unwrap_or(&pool[0]);
        let left = leader.weighed.left.min(FORM_ERROR * beside_exact.weighed.left);
        if left > LEAST_SHRUNK * self.form_error.of(pool[0].weighed.left) {
            return false;
        }
        self.form_error = FormError::no_more_than(left);
        for set in pool.split_off(1) {
            let expanded = set.expanded;
            let set = self.weigh_set(set.parts, set.model, Some(&pool[0]));
            pool.push(Set { expanded, ..set });
        }
        true
    }

    /// Refits what is near the best until nothing changes, and looks from the best's motor at what lacks one of its effects: none may lead because
    /// another one stopped early, or in another valley.
    fn finish(&self, pool: &mut Vec<Set>) {
        let mut done: Vec<Vec<usize>> = Vec::new();
        let mut led: Vec<Vec<usize>> = Vec::new();
        for _ in 0..FINISHED {
            let leader = best(pool);
            let open = |s: &&Set| s.score > leader.score - FAR_BEHIND && !done.contains(&s.key());
            let Some(next) = pool.iter().filter(open).max_by(|a, b| a.score.total_cmp(&b.score)).cloned() else {
                break;
            };
            done.push(next.key());
            let model = self.refitted(next.model.clone(), &next.parts, self.scatter(&next), LAST_STEPS);
            let finished = self.weigh_beside(next.parts, model, &pool[0]);
            // Also where it is worse: what the equations promise around a model that is not refitted to the end may not be kept.
            let counts = |s: &Set| finished.score > s.score || finished.score < s.score - NOT_KEPT;
            if let Some(set) = pool.iter_mut().find(|s| s.key() == finished.key() && counts(s)) {
                *set = Set { expanded: set.expanded, ..finished };
            }
            let leader = best(pool).clone();
            if !led.contains(&leader.key()) {
                led.push(leader.key());
                self.put_all(self.each_without(&leader, &pool[0]), pool);
            }
        }
    }

    /// Refits the baseline with the noise that it leaves, until that changes nothing: the first look took the noise from the misfit.
    fn settle(&self, pool: &mut [Set]) {
        for _ in 0..3 {
            let model = self.refitted(pool[0].model.clone(), &[], self.scatter(&pool[0]), 8);
            let again = self.root(model);
            if again.score < pool[0].score + 0.1 {
                break;
            }
            pool[0] = again;
        }
    }

    /// The motor file's own motor, refitted; the better baseline of the two is the first of the pool, the other one comes back.
    fn of_the_file(&self, pool: &mut [Set]) -> Set {
        let own = &pool[0].model;
        let listed = Model { parameters: as_listed(&own.parameters, &self.home), terms: own.terms.clone() };
        let model = self.refitted(at_speed(self.problem, listed), &[], self.scatter(&pool[0]), 8);
        let listed = self.root(model);
        if listed.score > pool[0].score { std::mem::replace(&mut pool[0], listed) } else { listed }
    }

    /// Effects that a course which each run has of its own may be, whatever they weigh: the phase of each run costs the evidence more than such a
    /// course leaves in doubt.
    fn each_on_its_course(&self, pool: &mut Vec<Set>) {
        let root = pool[0].clone();
        let beyond = root.courses.iter().filter(|c| c.share > MOST_OF_A_COURSE);
        let coordinates: Vec<Coordinate> = beyond.flat_map(|c| self.coordinates(c.lives_in)).copied().collect();
        let makes = |e: &&usize| coordinates.contains(&self.effects[**e].coordinate);
        let unseen = |e: &&usize| pool.iter().all(|s| s.key() != [**e]);
        let effects: Vec<usize> = self.usable.iter().filter(makes).filter(unseen).copied().collect();
        for effect in effects {
            if let Some(c) = self.candidates(&root, &[effect], f64::NEG_INFINITY).first() {
                self.put(self.with(&root, c, &pool[0]), pool);
            }
        }
    }

    /// In closed loops, what the root's own friction without a wave departs from the file's, said as `off-phase-braking`: a linear look
    /// around the root finds none, for it has adapted already.
    fn missing_friction(&self, pool: &mut Vec<Set>) {
        let mut model = pool[0].model.clone();
        let rate = |p: P| self.home.get(p).max(1e-9);
        let like = rate(P::OffDeceleration) / rate(P::OnAcceleration) * model.parameters.get(P::OnAcceleration);
        let missing = 1.0 - model.parameters.get(P::OffDeceleration) / like;
        if missing > 0.0 {
            model.parameters.set(P::OffDeceleration, like);
            self.put_as(P::OffLoss, missing, model, pool);
        }
    }

    /// The whole softness of a baseline whose contact is too soft to be the motor's own, said as `contact-stiffening`: the root, which has hardened,
    /// took what else there is for it.
    fn soft_contact(&self, mut baseline: Model, pool: &mut Vec<Set>) {
        let [band, listed] = [baseline.parameters.get(P::SlipBand), self.home.get(P::SlipBand)];
        baseline.parameters.set(P::SlipBand, listed);
        self.put_as(P::SlipExtra, band - listed, baseline, pool);
    }

    /// A model whose own parameter departs from the motor's, as the set of the effect that has this `size`, refitted.
    fn put_as(&self, size: P, value: f64, mut model: Model, pool: &mut Vec<Set>) {
        let sized = |e: &&usize| self.effects[**e].forms[0].sizes.iter().any(|s| s.parameter == size);
        let Some(&effect) = self.usable.iter().find(sized) else { return };
        model.parameters.set(size, value);
        let parts = vec![Part { effect, form: 0, free: free_of(&self.effects[effect].forms[0]), phased: Vec::new() }];
        let model = self.refitted(model, &parts, self.scatter(&pool[0]), 8);
        self.put(self.weigh_set(parts, model, Some(&pool[0])), pool);
    }

    /// A better baseline, where a set without its effects leads to one: the refit had stopped in another valley. What was found stays, refitted
    /// and weighed beside the new one, and what shows beside that joins it.
    fn reseat(&self, pool: &mut Vec<Set>) {
        let Some(best) = pool.iter().skip(1).max_by(|a, b| a.score.total_cmp(&b.score)) else { return };
        let bare = best.parts.iter().fold(best.model.clone(), |model, part| strip(&model, part));
        let model = self.refitted(bare, &[], self.scatter(best), 8);
        let again = self.root(model);
        if again.score > pool[0].score + 1.0 {
            let others = pool.split_off(1);
            pool[0] = again;
            for set in others {
                let model = self.refitted(set.model.clone(), &set.parts, self.scatter(&set), 8);
                self.put(self.weigh_set(set.parts, model, Some(&pool[0])), pool);
            }
            let root = pool[0].clone();
            self.expand(&root, &self.usable, TRIED, true, pool);
        }
    }

    /// Baselines anew, from every rotor, beside effects that take much of the noise away: what they made before hid which rotor it is.
    fn reseat_beside(&self, pool: &mut [Set]) {
        let root = pool[0].weighed.variance;
        let near = best(pool).score - FAR_BEHIND;
        let clear = |i: &usize| pool[*i].score > near && pool[*i].weighed.variance < MOST_NOISE_LEFT * root;
        let mut clear: Vec<usize> = (1..pool.len()).filter(clear).collect();
        let all = clear.clone();
        let leads = |i: &usize| !all.iter().any(|less| pool[*less].is_worth_no_less_than(&pool[*i]));
        clear.retain(leads);
        clear.sort_by(|a, b| pool[*b].score.total_cmp(&pool[*a].score));
        let few = self.problem.thinned();
        for at in clear.into_iter().take(TRIED) {
            let set = &pool[at];
            let scatter = self.scatter(set);
            let (ground, scatter_of_few) = self.of_some_runs(&few, scatter);
            let sorted = |models: Vec<Model>| {
                let value = |m: Model| (ground.misfit(&m, &set.parts, scatter_of_few), m);
                let mut valued: Vec<(f64, Model)> = models.into_par_iter().map(value).collect();
                valued.sort_by(|a, b| a.0.total_cmp(&b.0));
                valued.into_iter().map(|(_, m)| m)
            };
            let mut others = valleys(&few, &self.home, &self.problem.of_the_runs_of(&few, &set.model)).split_off(1);
            for (count, steps) in LOOKS {
                let looked = sorted(others).take(count).collect::<Vec<_>>().into_par_iter();
                others = looked.map(|m| ground.refitted(m, &set.parts, scatter_of_few, steps)).collect();
            }
            let Some(Model { parameters, .. }) = sorted(others).next() else { continue };
            let model = self.refitted(Model { parameters, ..set.model.clone() }, &set.parts, scatter, 8);
            let again = self.weigh_set(set.parts.clone(), model, Some(&pool[0]));
            if again.score > pool[at].score {
                pool[at] = again;
            }
        }
    }

    /// Sets with one more effect than `from`; `again` also those that were visited, with other forms.
    fn expand(&self, from: &Set, among: &[usize], most: usize, again: bool, pool: &mut Vec<Set>) {
        let mut tried: Vec<(usize, usize)> = Vec::new();
        let mut brought = f64::NEG_INFINITY;
        for c in &self.candidates(from, among, LEAST_LOOK) {
            if c.gain < brought - FAR_BEHIND {
                break;
            }
            // A second form of an effect is worth a refit where no parameter joins it to the first.
            let forms: Vec<usize> = tried.iter().filter(|t| t.0 == c.effect).map(|t| t.1).collect();
            let effects: std::collections::BTreeSet<usize> = tried.iter().map(|t| t.0).collect();
            let another = match forms.first() {
                None => effects.len() < most,
                Some(first) => {
                    forms.len() < 2
                        && self.effects[c.effect].forms[*first].differs(&self.effects[c.effect].forms[c.form])
                }
            };
            if !another {
                continue;
            }
            tried.push((c.effect, c.form));
            let mut target = from.key();
            target.push(c.effect);
            target.sort_unstable();
            if pool.iter().any(|s| s.key() == target) && forms.is_empty() && from.parts.len() > 1 && !again {
                continue;
            }
            let set = self.with(from, c, &pool[0]);
            brought = brought.max(set.score - from.score);
            self.put(set, pool);
        }
    }

    /// The best set with effects in forms that have further numbers beside those they have now. No linear look leads there from where the effect was
    /// not: a clock that drifts is found from one that errs by as much all along.
    fn extend_forms(&self, pool: &mut Vec<Set>) {
        let leader = best(pool).clone();
        let mut wider: Vec<(Vec<Part>, Model)> = Vec::new();
        for (k, part) in leader.parts.iter().enumerate() {
            let forms = &self.effects[part.effect].forms;
            let mut seen: Vec<&Form> = Vec::new();
            for (form, spec) in forms.iter().enumerate() {
                if spec.extends(&forms[part.form]) && seen.iter().all(|other| other.differs(spec)) {
                    seen.push(spec);
                    let mut parts = leader.parts.clone();
                    parts[k] = Part { form, free: free_of(spec), ..part.clone() };
                    let mut model = leader.model.clone();
                    for s in spec.shapes.iter().filter(|s| !part.changes(s.parameter)) {
                        model.parameters.set(s.parameter, s.start);
                    }
                    wider.push((parts, model));
                }
            }
        }
        let scatter = self.scatter(&leader);
        let refitted = |(parts, model): (Vec<Part>, Model)| {
            let model = self.refitted(model, &parts, scatter, 8);
            self.weigh_set(parts, model, Some(&pool[0]))
        };
        let wider = wider.into_par_iter().map(refitted).collect();
        self.put_all(wider, pool);
    }

    /// Sets that lack one effect of the best and were not visited.
    fn remove(&self, pool: &mut Vec<Set>) {
        let leader = best(pool).clone();
        if leader.parts.len() < 2 {
            return;
        }
        for k in 0..leader.parts.len() {
            let mut parts = leader.parts.clone();
            parts.remove(k);
            if pool.iter().all(|s| s.key() != key(&parts)) {
                pool.push(self.without(&leader, k, FEW_STEPS, &pool[0]));
            }
        }
    }

    /// What lacks one of a set's effects, refitted from where the set is.
    pub(super) fn each_without(&self, set: &Set, root: &Set) -> Vec<Set> {
        (0..set.parts.len()).into_par_iter().map(|k| self.without(set, k, FEW_STEPS, root)).collect()
    }

    /// The set without its effect `k`, refitted from where it is.
    fn without(&self, set: &Set, k: usize, steps: usize, root: &Set) -> Set {
        let mut parts = set.parts.clone();
        let gone = parts.remove(k);
        let model = self.refitted(strip(&set.model, &gone), &parts, self.scatter(set), steps);
        self.weigh_beside(parts, model, root)
    }

    /// A model weighed with its effects beside the root, or as a root.
    fn weigh_beside(&self, parts: Vec<Part>, model: Model, root: &Set) -> Set {
        if parts.is_empty() { self.root(model) } else { self.weigh_set(parts, model, Some(root)) }
    }

    /// Rivals in the place of each effect of the best set: what looks like it, and beside others also what does the most, for the first effect
    /// that was found may have stood for another, and those that joined it for what it lacked.
    fn swap(&self, pool: &mut Vec<Set>) {
        let best = best(pool).clone();
        for k in 0..best.parts.len() {
            let effect = &self.effects[best.parts[k].effect];
            if effect.coordinate == Coordinate::Angle {
                self.exchange_twin(&best, k, pool);
            }
            // A baseline that was refitted without the effect has taken up part of it, and of what does the same: rivals are looked for
            // where it leaves a gap.
            let mut parts = best.parts.clone();
            let gone = parts.remove(k);
            let gap = self.weigh_set(parts, strip(&best.model, &gone), Some(&pool[0]));
            let mut seen = Vec::new();
            let mut others = 0;
            let mut rivals = self.candidates(&gap, &self.usable, LEAST_LOOK);
            rivals.retain(|c| {
                if seen.contains(&c.effect) || c.effect == gone.effect {
                    return false;
                }
                seen.push(c.effect);
                let like = self.effects[c.effect].looks_like(effect);
                others += usize::from(!like);
                like || best.parts.len() > 1 && others <= TRIED
            });
            self.put_all(rivals.par_iter().map(|c| self.with(&gap, c, &pool[0])).collect(), pool);
            // Beside what was found since, another form of the effect itself may be the nearer one.
            if let Some(base) = pool.iter().find(|s| s.key() == gap.key()).cloned() {
                self.expand(&base, &[gone.effect], 1, true, pool);
            }
        }
    }

    /// The set in the pool, in the place of one of the same effects that is worse.
    pub(super) fn put(&self, set: Set, pool: &mut Vec<Set>) {
        let key = set.key();
        match pool.iter().position(|s| s.key() == key) {
            Some(k) if pool[k].score >= set.score => {}
            Some(k) => pool[k] = set,
            None => pool.push(set),
        }
    }

    /// The sets in the pool, one after the other.
    pub(super) fn put_all(&self, sets: Vec<Set>, pool: &mut Vec<Set>) {
        for set in sets {
            self.put(set, pool);
        }
    }

    /// Runout in the place of an eccentric wheel, or the other way round, from where the other's coefficients put it: a linear search
    /// from nothing does not get as far as they are.
    fn exchange_twin(&self, set: &Set, k: usize, pool: &mut Vec<Set>) {
        let part = &set.parts[k];
        let now = coefficients(&set.model, &part.phased);
        let twins =
            self.usable.iter().filter(|e| **e != part.effect && self.effects[**e].is_twin(&self.effects[part.effect]));
        for &effect in twins {
            // The forms with the same harmonics.
            let has = |f: &Form, h: Option<usize>| f.phased.iter().any(|p| p.harmonic() == h);
            let enough = |f: &Form| part.phased.iter().all(|p| has(f, p.harmonic()));
            let fewest = self.effects[effect].forms.iter().filter(|f| enough(f)).map(|f| f.phased.len()).min();
            for (form, spec) in self.effects[effect].forms.iter().enumerate() {
                if !enough(spec) || Some(spec.phased.len()) != fewest {
                    continue;
                }
                let mut parts = set.parts.clone();
                parts[k] = Part { effect, form, free: free_of(spec), phased: spec.phased.clone() };
                let mut model = strip(&set.model, part);
                for s in &spec.shapes {
                    model.parameters.set(s.parameter, s.start);
                }
                let values: Vec<Vec<f64>> = now
                    .iter()
                    .map(|run| {
                        let of = |h: usize| part.phased.iter().position(|p| p.harmonic() == Some(h));
                        let pairs = spec.phased.iter().map(|p| match of(p.harmonic().unwrap_or(0)) {
                            Some(i) => p.from_twin([run[2 * i], run[2 * i + 1]]),
                            None => [0.0; 2],
                        });
                        pairs.flatten().collect()
                    })
                    .collect();
                put_coefficients(&mut model, &spec.phased, &values);
                let model = self.refitted(model, &parts, self.scatter(set), 6);
                self.put(self.weigh_set(parts, model, Some(&pool[0])), pool);
            }
        }
    }
}

/// The best of a pool, which is never without its root.
fn best(pool: &[Set]) -> &Set {
    pool.iter().fold(&pool[0], |best, set| if set.score > best.score { set } else { best })
}
