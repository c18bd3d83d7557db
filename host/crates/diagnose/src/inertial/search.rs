//! The search over sets of effects of an ordinary motor: the engine's order, costs and bounds, with this plant's refits.

use super::super::form_error::FormError;
use super::super::search::{MOST_EFFECTS, MOST_EXPANDED, TRIED};
use super::super::verdict::ALIKE;
use super::effects::{EFFECTS, Form, is_time, twin};
use super::fit::{Plant, misfit, refit};
use super::sets::{Ground, LEAST_INDEPENDENT, LOOK, Part, Set, key, memory};
use super::thin::thinned;
use super::values::{P, Values};
use rayon::prelude::*;

/// A set this far behind the best, in nats, is not looked at further: what it leads to has to make up for that too.
const WINDOW: f64 = 9.0;
/// Nats behind the best set within which a set found in a part of the record is refitted on the whole: that far a rival counts.
const NEAR: f64 = ALIKE;
/// Steps of such a refit: it begins where the same motor was fitted, and each step at least halves what is left.
const AGAIN: usize = 8;
/// Most sets that are.
const MOST_KEPT: usize = 16;
/// Starts of an effect from which a few steps are made: those that look best as they are.
const STARTS: usize = 10;

impl Ground<'_> {
    /// Every set that was visited, best first. Of a long record the search looks at parts; what stands is refitted on the whole.
    pub fn visit(&mut self, root: Set, progress: &dyn Fn(&str, f64)) -> Vec<Set> {
        let Some(thin) = thinned(self.data, root.plant.values.lag_s()) else { return self.search(root, progress) };
        let mut small = Ground::new(&thin, self.usable.clone());
        let begun = small.root();
        let found = small.search(begun, progress);
        progress("refitting on the whole record", 0.75);
        self.again(found, root)
    }

    /// Sets that were found in other data of the same runs, refitted and weighed in these: those near the best, and the single effects.
    pub fn again(&mut self, found: Vec<Set>, root: Set) -> Vec<Set> {
        let near = found[0].score - NEAR;
        let kept = found.into_iter().filter(|s| s.score > near || s.parts.len() == 1).filter(|s| !s.parts.is_empty());
        let kept: Vec<Set> = kept.take(MOST_KEPT).collect();
        let sets = kept.into_par_iter().map(|set| {
            let mut plant = Plant { values: set.plant.values, starts: root.plant.starts.clone() };
            plant.values.set(P::Skew, root.plant.values.get(P::Skew));
            let free = self.free(&set.parts);
            let plant = refit(self.data, plant, &free, self.noise(&root.plant), &[], AGAIN);
            self.weigh_set(set.parts, plant, Some(&root))
        });
        let mut pool: Vec<Set> = sets.collect();
        pool.push(root);
        self.reweigh(&mut pool);
        pool
    }

    fn search(&mut self, root: Set, progress: &dyn Fn(&str, f64)) -> Vec<Set> {
        let mut pool = vec![root];
        for round in 0..MOST_EXPANDED {
            progress("weighing sets of effects", 0.1 + 0.7 * round as f64 / MOST_EXPANDED as f64);
            let best = pool.iter().map(|s| s.score).fold(f64::NEG_INFINITY, f64::max);
            let open = |s: &Set| !s.expanded && s.parts.len() < MOST_EFFECTS && s.score > best - WINDOW;
            let next =
                (0..pool.len()).filter(|i| open(&pool[*i])).max_by(|a, b| pool[*a].score.total_cmp(&pool[*b].score));
            let Some(at) = next else { break };
            pool[at].expanded = true;
            let from = pool[at].clone();
            self.expand(&from, if round == 0 { self.usable.len() } else { TRIED }, &mut pool);
            if round == 0 {
                self.zone_under_a_bend(&from, &mut pool);
            }
            self.remove(&mut pool);
            self.exchange(&mut pool);
            self.reform(&best_of(&pool), &mut pool);
        }
        self.reweigh(&mut pool);
        // Forms that looked alike beside a line that misses all may now be told apart, in the best set and in those with one effect less.
        let best = pool[0].clone();
        let less = (0..best.parts.len()).map(|k| self.without(&best, k, &pool));
        let near: Vec<Set> = less.collect();
        for set in std::iter::once(best).chain(near) {
            self.reform(&set, &mut pool);
        }
        self.reweigh(&mut pool);
        pool
    }

    /// Weighs all sets anew with as many independent residuals as the best set leaves: what follows from sample to sample is counted
    /// once; and with an error of form that is no more than what it leaves. Best first.
    fn reweigh(&mut self, pool: &mut Vec<Set>) {
        let best = best_of(pool);
        let fewer = memory(self.data, &best.plant);
        self.independent = (self.data.rows() as f64 / fewer).clamp(LEAST_INDEPENDENT, self.independent);
        self.form_error = FormError::no_more_than(best.weighed.left);
        let old = std::mem::take(pool);
        let root = old.iter().find(|s| s.parts.is_empty()).map(|s| self.weigh_set(Vec::new(), s.plant.clone(), None));
        let others = old.into_par_iter().filter(|s| !s.parts.is_empty());
        *pool = others.map(|s| self.weigh_set(s.parts, s.plant, root.as_ref())).collect();
        pool.extend(root);
        pool.retain(|s| s.score.is_finite());
        pool.sort_by(|a, b| b.score.total_cmp(&a.score));
    }

    /// Sets with one more effect than `from`, those of the `most` most promising ones.
    fn expand(&self, from: &Set, most: usize, pool: &mut Vec<Set>) {
        let present = from.key();
        let tasks: Vec<Part> = self
            .usable
            .iter()
            .filter(|e| !present.contains(e))
            .flat_map(|e| (0..EFFECTS[*e].forms.len()).map(|form| Part { effect: *e, form }))
            .filter(|p| self.makes_sense(*p, &from.parts))
            .collect();
        let mut looks: Vec<(f64, Vec<Part>, Plant)> = tasks
            .into_par_iter()
            .filter_map(|part| self.look(&from.plant, [from.parts.clone(), vec![part]].concat()))
            .collect();
        looks.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut effects: Vec<usize> = Vec::new();
        let mut chosen = Vec::new();
        for look in looks {
            let effect = look.1[look.1.len() - 1].effect;
            if !effects.contains(&effect) {
                if effects.len() == most {
                    continue;
                }
                effects.push(effect);
            }
            chosen.push(look);
        }
        let found: Vec<Set> = chosen
            .into_par_iter()
            .map(|(_, parts, plant)| {
                let plant = self.refitted(plant, &parts);
                self.weigh_set(parts, plant, Some(&pool[0]))
            })
            .collect();
        for set in found {
            keep(pool, set);
        }
    }

    /// The last part of a set, begun beside the others from all its starts and refitted for some steps.
    fn look(&self, from: &Plant, parts: Vec<Part>) -> Option<(f64, Vec<Part>, Plant)> {
        let (free, noise) = (self.free(&parts), self.noise(from));
        let value = |p: &Plant| misfit(self.data, p, &free, noise, &[]);
        let mut begun: Vec<(f64, Plant)> =
            self.begin(from, *parts.last()?).into_iter().map(|p| (value(&p), p)).collect();
        begun.sort_by(|a, b| a.0.total_cmp(&b.0));
        let begun = begun.into_iter().take(STARTS);
        let near = begun.map(|(_, p)| refit(self.data, p, &free, noise, &[], LOOK)).map(|p| (value(&p), p));
        near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(v, p)| (v, parts, p))
    }

    /// A set with another form of each effect: beside what was found since, it may be the nearer one.
    fn reform(&self, set: &Set, pool: &mut Vec<Set>) {
        let known = pool.iter_mut().find(|s| s.key() == set.key());
        if known.is_some_and(|s| std::mem::replace(&mut s.reformed, true)) {
            return;
        }
        let mut tasks = Vec::new();
        for k in 0..set.parts.len() {
            let mut rest = set.parts.clone();
            let now = rest.remove(k);
            for form in (0..EFFECTS[now.effect].forms.len()).filter(|f| *f != now.form) {
                let part = Part { form, ..now };
                if self.makes_sense(part, &rest) {
                    let mut plant = set.plant.clone();
                    for p in EFFECTS[now.effect].forms[now.form].numbers {
                        plant.values.set(*p, 0.0);
                    }
                    tasks.push((plant, [rest.clone(), vec![part]].concat()));
                }
            }
        }
        let root = pool.iter().find(|s| s.parts.is_empty()).cloned();
        let found: Vec<Set> = tasks
            .into_par_iter()
            .filter_map(|(plant, parts)| self.look(&plant, parts))
            .map(|(_, parts, plant)| {
                let plant = self.refitted(plant, &parts);
                self.weigh_set(parts, plant, root.as_ref())
            })
            .collect();
        for set in found {
            keep(pool, set);
        }
    }

    /// Plants from which a form is looked for: its sizes, and lags that it may have been mistaken for.
    fn begin(&self, from: &Plant, part: Part) -> Vec<Plant> {
        let form = &EFFECTS[part.effect].forms[part.form];
        let period = self.data.runs.iter().map(|r| r.period_s).fold(f64::INFINITY, f64::min);
        // A line takes part of a threshold or of a bend for a lag, also where speeds were logged once they had settled.
        let from_line = [P::Coulomb, P::DeadZone, P::Bend].iter().all(|p| from.values.get(*p) == 0.0);
        let lag = from.values.get(P::LogLag);
        let settled = (0.2 * period).ln();
        let mut lags = vec![(lag, from.values.get(P::Skew))];
        if from_line {
            lags.push((lag - 1.2, from.values.get(P::Skew)));
        }
        if lag > settled + 0.5 {
            lags.push((settled, -1.0));
        }
        let mut begun = Vec::new();
        for start in form.starts {
            for (log_lag, skew) in lags.iter().copied() {
                for (companion, value) in companions(&from.values, form.numbers) {
                    let mut plant = from.clone();
                    plant.values.set(companion, value);
                    for (p, v) in form.numbers.iter().zip(*start) {
                        plant.values.set(*p, if is_time(*p) { v * period } else { *v });
                    }
                    plant.values.set(P::LogLag, log_lag);
                    plant.values.set(P::Skew, skew);
                    begun.push(self.with_gain(plant));
                }
            }
        }
        begun
    }

    /// A dead zone and a bend together: each hides the other, so that neither alone leads to both.
    fn zone_under_a_bend(&self, root: &Set, pool: &mut Vec<Set>) {
        let of = |p: P| self.usable.iter().copied().find(|e| EFFECTS[*e].forms[0].numbers[0] == p);
        let (Some(zone), Some(bend)) = (of(P::DeadZone), of(P::Bend)) else { return };
        let parts = vec![Part { effect: zone, form: 0 }, Part { effect: bend, form: 0 }];
        let (free, noise) = (self.free(&parts), self.noise(&root.plant));
        let value = |p: &Plant| misfit(self.data, p, &free, noise, &[]);
        let begun = self.begin(&root.plant, parts[0]).into_iter().flat_map(|plant| {
            [1.0, 3.0, 6.0].map(|b| {
                let values = plant.values.with(P::Bend, b);
                self.with_gain(Plant { values, starts: plant.starts.clone() })
            })
        });
        let mut begun: Vec<(f64, Plant)> = begun.map(|p| (value(&p), p)).collect();
        begun.sort_by(|a, b| a.0.total_cmp(&b.0));
        let near = begun.into_par_iter().take(STARTS).map(|(_, p)| refit(self.data, p, &free, noise, &[], LOOK));
        let near = near.map(|p| (value(&p), p)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, plant)) = near {
            let plant = self.refitted(plant, &parts);
            let set = self.weigh_set(parts, plant, Some(root));
            keep(pool, set.clone());
            // Looked on from whatever it weighs: a threshold that differs by direction weighs little as an even one.
            self.expand(&set, TRIED, pool);
        }
    }

    /// Sets that lack one effect of the best.
    fn remove(&self, pool: &mut Vec<Set>) {
        let best = best_of(pool);
        for k in 0..best.parts.len() {
            let less = self.without(&best, k, pool);
            keep(pool, less);
        }
    }

    /// The best sets with friction in the place of a dead zone, or the other way round: over slow changes they are the same.
    fn exchange(&self, pool: &mut Vec<Set>) {
        let best = pool.iter().map(|s| s.score).fold(f64::NEG_INFINITY, f64::max);
        let open = |s: &&mut Set| !s.exchanged && s.score > best - WINDOW;
        let near: Vec<Set> = pool
            .iter_mut()
            .filter(open)
            .map(|s| {
                s.exchanged = true;
                s.clone()
            })
            .collect();
        let number = |e: usize| EFFECTS[e].forms[0].numbers[0];
        let other = |e: usize| self.usable.iter().copied().find(|o| twin(number(e)) == Some(number(*o)));
        for set in near {
            for k in 0..set.parts.len() {
                let Some(effect) = other(set.parts[k].effect).filter(|o| !set.key().contains(o)) else { continue };
                let mut parts = set.parts.clone();
                parts[k] = Part { effect, form: 0 };
                if pool.iter().any(|s| s.key() == key(&parts) && s.score >= set.score) {
                    continue;
                }
                let mut plant = set.plant.clone();
                for part in &mut parts {
                    let forms = EFFECTS[part.effect].forms;
                    let twins: Vec<Option<P>> = forms[part.form].numbers.iter().map(|n| twin(*n)).collect();
                    let same = |f: &Form| twins.iter().zip(f.numbers).all(|(t, n)| t.is_none() || *t == Some(*n));
                    if twins.iter().all(Option::is_none) {
                        continue;
                    }
                    part.form =
                        forms.iter().position(|f| f.numbers.len() == twins.len() && same(f)).unwrap_or(part.form);
                }
                for from in set.parts.iter().flat_map(|p| EFFECTS[p.effect].forms[p.form].numbers) {
                    if let Some(to) = twin(*from) {
                        plant.values.set(to, set.plant.values.get(*from));
                        plant.values.set(*from, 0.0);
                    }
                }
                // As it is, or begun anew beside the others.
                let twin = parts.remove(k);
                parts.push(twin);
                let bare = Plant { values: plant.values.with(number(effect), 0.0), ..plant.clone() };
                let anew = self.look(&bare, parts.clone()).map(|l| l.2);
                let root = pool.iter().find(|s| s.parts.is_empty()).cloned();
                for plant in std::iter::once(plant).chain(anew) {
                    let plant = self.refitted(plant, &parts);
                    keep(pool, self.weigh_set(parts.clone(), plant, root.as_ref()));
                }
            }
        }
    }
}

/// What else is begun at other values beside some numbers: a bend hides a threshold and the other way round, and neither alone is near what
/// both are together.
fn companions(now: &Values, numbers: &[P]) -> Vec<(P, f64)> {
    let thresholds = [P::DeadZone, P::Coulomb];
    if numbers.iter().any(|n| thresholds.contains(n)) && now.get(P::Bend) > 0.0 {
        return vec![(P::Bend, now.get(P::Bend)), (P::Bend, 2.0), (P::Bend, 6.0)];
    }
    match thresholds.into_iter().find(|t| numbers.contains(&P::Bend) && now.get(*t) > 0.0) {
        Some(t) => vec![(t, now.get(t)), (t, 0.12), (t, 0.25)],
        None => vec![(P::Gain, now.get(P::Gain))],
    }
}

/// The set of the highest score.
fn best_of(pool: &[Set]) -> Set {
    pool.iter().max_by(|a, b| a.score.total_cmp(&b.score)).expect("the root is in it").clone()
}

/// Puts a set into the pool, in the place of the same set with a worse form.
fn keep(pool: &mut Vec<Set>, set: Set) {
    match pool.iter().position(|s| s.key() == set.key()) {
        Some(k) if pool[k].score >= set.score => {}
        Some(k) => pool[k] = set,
        None => pool.push(set),
    }
}
