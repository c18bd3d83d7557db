//! The search over sets of effects: best first, with removals and swaps.
//!
//! Every set is refitted together with the baseline's own parameters and weighed by its evidence. From a set, all forms of all other
//! effects are weighed linearly; those of the few best effects are refitted and join the pool. The search is bounded by counts.

use super::baseline::{baseline_free, first_noise, valleys};
use super::discrepancy::{SIZE, Term, terms};
use super::evidence::{Equations, Question, Spreads, Start, Weighed, independent, weigh};
use super::level::Level;
use super::library::{Coordinate, Effect, Form, Phased, Size};
use super::prior::Prior;
use super::problem::{Column, Model, Problem};
use super::refit::{Free, Noise, coefficients, columns_of, objective, refit};
use super::rotor::{P, Parameters};
use rayon::prelude::*;

/// What an effect costs before the data, in nats: one in twenty effects is there.
const EFFECT_COST: f64 = 3.0;
/// What a second effect over the same coordinate costs besides: the difference between the library's form of one and the real one lies
/// there too.
const SAME_COORDINATE: f64 = 10.0;
/// What a term without physics costs: a cause of the library is the likelier explanation by far, but not beyond all evidence.
const TERM_COST: f64 = 10.0;
/// The same where an effect of the library acts over the term's coordinate: there the term is a form of that effect that nobody knows.
const FREE_FORM_COST: f64 = 20.0;
/// Most effects in a set.
const MOST_EFFECTS: usize = 4;
/// Most sets from which others are looked for.
const MOST_EXPANDED: usize = 6;
/// Effects of a set's candidates that are refitted.
const TRIED: usize = 4;
/// A set this far behind the best, in nats, is not looked at further: what it leads to has to make up for that too.
const WINDOW: f64 = 9.0;
/// Share of the root's noise below which its baseline is doubted: half the noise is half the evidence that it was chosen by.
const MOST_NOISE_LEFT: f64 = 0.5;
/// Other rotors that are refitted for a few steps.
const LOOKED_AT: usize = 3;
/// Relative error of speed from which a wheel is no wheel: it would read motion out of its own error.
const MOST_OF_A_WHEEL: f64 = 0.7;
/// Linear gain in nats from which a form is refitted: a refit seldom finds more than another nat, and an effect costs three.
const LEAST_LOOK: f64 = 2.0;
/// Nats behind what the best candidate brought from which one waits for a later set: what a linear look promises is often not kept.
const FAR_BEHIND: f64 = 20.0;
/// A plausible amplitude of what goes with the angle (relative, or rad), and its log deviation.
const AMPLITUDE: (f64, f64) = (0.08, 1.2);

/// One effect in a set.
#[derive(Debug, Clone)]
pub struct Part {
    /// Index in the library.
    pub effect: usize,
    /// Index among the effect's forms.
    pub form: usize,
    /// Its common parameters.
    pub free: Vec<Free>,
    /// Its phased pairs.
    pub phased: Vec<Phased>,
}

/// A set of effects, refitted and weighed.
#[derive(Debug, Clone)]
pub struct Set {
    /// The effects.
    pub parts: Vec<Part>,
    /// The model with them.
    pub model: Model,
    /// Log evidence with costs and priors.
    pub score: f64,
    /// What was found by integrating.
    pub weighed: Weighed,
    /// Terms without physics that the data ask for beside them, strongest first, with the squared error that is then left.
    pub terms: Vec<(&'static str, f64)>,
    /// Share of the squared error left that a course of each run's own over time or angle would take, by the term's name.
    pub courses: Vec<(&'static str, f64)>,
    expanded: bool,
}

impl Set {
    /// Indices of its effects, sorted.
    pub fn key(&self) -> Vec<usize> {
        key(&self.parts)
    }
}

#[cfg(test)]
impl Set {
    /// A set of these effects with a score and a squared error left, and nothing else to say of it.
    pub fn of(effects: &[usize], score: f64, left: f64) -> Self {
        let part = |effect: &usize| Part { effect: *effect, form: 0, free: Vec::new(), phased: Vec::new() };
        let weighed = Weighed {
            log: score,
            left,
            variance: 1.0,
            taus: [0.01; 5],
            gains: Vec::new(),
            common: Vec::new(),
            powers: Vec::new(),
        };
        let model = Model { parameters: Parameters::new(1.0, 1.0, 1.0, 0.0, 0.0), terms: Vec::new() };
        let parts = effects.iter().map(part).collect();
        Self { parts, model, score, weighed, terms: Vec::new(), courses: Vec::new(), expanded: false }
    }
}

fn key(parts: &[Part]) -> Vec<usize> {
    let mut k: Vec<usize> = parts.iter().map(|p| p.effect).collect();
    k.sort_unstable();
    k
}

/// What a search works on.
pub struct Ground<'a> {
    /// The runs.
    pub problem: &'a Problem,
    /// The motor file's rotor.
    pub home: Parameters,
    /// The library.
    pub effects: &'a [Effect],
    /// Indices of the effects that these runs can show.
    pub usable: Vec<usize>,
    /// What the gains of the runs scatter by.
    pub level: Level,
    /// How many independent residuals the runs count as.
    pub independent: f64,
    /// Terms without physics.
    pub terms: Vec<Term>,
}

/// A form of an effect beside a set.
struct Candidate {
    effect: usize,
    form: usize,
    gain: f64,
    values: Vec<f64>,
}

impl<'a> Ground<'a> {
    /// Of some runs.
    pub fn new(problem: &'a Problem, home: Parameters, effects: &'a [Effect], usable: Vec<usize>) -> Self {
        let rows: usize = problem.runs.iter().map(|r| r.windows.len()).sum();
        let independent = independent(rows as f64, problem.runs.len());
        Self { level: Level::new(problem), terms: terms(problem), problem, home, effects, usable, independent }
    }

    /// What is free in a set: the baseline's own parameters and the effects'.
    pub fn free(&self, model: &Model, parts: &[Part]) -> Vec<Free> {
        let mut free = baseline_free(&model.parameters, &self.home, self.problem.closed());
        free.retain(|own| parts.iter().all(|p| p.free.iter().all(|f| f.parameter != own.parameter)));
        free.extend(parts.iter().flat_map(|p| p.free.iter().copied()));
        free
    }

    /// Log prior of what is free.
    fn log_prior(&self, model: &Model, parts: &[Part]) -> f64 {
        self.free(model, parts).iter().map(|f| f.prior.log_density(model.parameters.get(f.parameter))).sum()
    }

    /// Squared error in rpm²·s less what the priors are worth of it.
    fn misfit(&self, model: &Model, parts: &[Part], noise: Noise) -> f64 {
        objective(self.problem, model, noise) - 2.0 * noise.variance * self.log_prior(model, parts)
    }

    /// The refitted baseline, weighed.
    pub fn root(&self, baseline: Model) -> Set {
        self.weigh_set(Vec::new(), baseline, None)
    }

    /// Searches from the refitted baseline; every set that was visited, best first.
    pub fn search(&self, baseline: Model, progress: &dyn Fn(&str, f64)) -> Vec<Set> {
        let mut pool = vec![self.root(baseline)];
        self.settle(&mut pool);
        self.missing_friction(&mut pool);
        for round in 0..MOST_EXPANDED {
            progress("weighing sets of effects", 0.1 + 0.7 * round as f64 / MOST_EXPANDED as f64);
            // Terms without physics give way to what explains them, so that they do not close the way to it.
            let reach = |s: &Set| s.score - FREE_FORM_COST * s.terms.len() as f64;
            let best = pool.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
            let open = |s: &Set| !s.expanded && s.parts.len() < MOST_EFFECTS && s.score > best - WINDOW;
            let next =
                (0..pool.len()).filter(|i| open(&pool[*i])).max_by(|a, b| pool[*a].score.total_cmp(&pool[*b].score));
            let Some(at) = next else { break };
            pool[at].expanded = true;
            let from = pool[at].clone();
            self.expand(&from, &self.usable, TRIED, false, &mut pool);
            if round == 0 {
                self.reseat(&mut pool);
                self.reseat_beside(&mut pool);
            }
            self.remove(&mut pool);
        }
        self.swap(&mut pool);
        pool.sort_by(|a, b| b.score.total_cmp(&a.score));
        pool
    }

    /// Refits the baseline with the noise that it leaves, until that changes nothing: the first look took the noise from the misfit.
    fn settle(&self, pool: &mut [Set]) {
        for _ in 0..3 {
            let model = self.refitted(pool[0].model.clone(), &[], self.noise(&pool[0]), 8);
            let again = self.root(model);
            if again.score < pool[0].score + 0.1 {
                break;
            }
            pool[0] = again;
        }
    }

    /// In closed loops, what the root's own friction without a wave departs from the file's, said as `off-phase-braking`: a linear look
    /// around the root finds none, for it has adapted already.
    fn missing_friction(&self, pool: &mut Vec<Set>) {
        let brakes = |e: &&usize| self.effects[**e].forms[0].sizes.iter().any(|s| s.parameter == P::OffLoss);
        let Some(&effect) = self.usable.iter().find(brakes) else { return };
        let mut model = pool[0].model.clone();
        let rate = |p: P| self.home.get(p).max(1e-9);
        let like = rate(P::OffDeceleration) / rate(P::OnAcceleration) * model.parameters.get(P::OnAcceleration);
        let missing = 1.0 - model.parameters.get(P::OffDeceleration) / like;
        if missing <= 0.0 {
            return;
        }
        model.parameters.set(P::OffDeceleration, like);
        model.parameters.set(P::OffLoss, missing);
        let spec = &self.effects[effect].forms[0];
        let parts = vec![Part { effect, form: 0, free: free_of(spec), phased: Vec::new() }];
        let model = self.refitted(model, &parts, self.noise(&pool[0]), 8);
        let set = self.weigh_set(parts, model, Some(&pool[0]));
        pool.push(set);
    }

    /// A better baseline, where a set without its effect leads to one: the refit had stopped in another valley.
    fn reseat(&self, pool: &mut Vec<Set>) {
        let Some(best) = pool.iter().skip(1).max_by(|a, b| a.score.total_cmp(&b.score)) else { return };
        if best.parts.len() != 1 {
            return;
        }
        let model = self.refitted(strip(&best.model, &best.parts[0]), &[], self.noise(best), 8);
        let again = self.root(model);
        if again.score > pool[0].score + 1.0 {
            *pool = vec![again];
        }
    }

    /// Baselines anew beside effects that take most of the error away: the noise that they made before hid which rotor it is.
    fn reseat_beside(&self, pool: &mut [Set]) {
        let root = pool[0].weighed.variance;
        let mut clear: Vec<usize> =
            (1..pool.len()).filter(|i| pool[*i].weighed.variance < MOST_NOISE_LEFT * root).collect();
        clear.sort_by(|a, b| pool[*b].score.total_cmp(&pool[*a].score));
        for at in clear.into_iter().take(TRIED) {
            let set = &pool[at];
            let noise = self.noise(set);
            let value = |m: &Model| self.misfit(m, &set.parts, noise);
            let mut others: Vec<(f64, Model)> =
                valleys(self.problem, &self.home, &set.model).into_iter().skip(1).map(|m| (value(&m), m)).collect();
            others.sort_by(|a, b| a.0.total_cmp(&b.0));
            let near = others.into_iter().take(LOOKED_AT).map(|(_, m)| self.refitted(m, &set.parts, noise, 4));
            let Some(best) = near.min_by(|a, b| value(a).total_cmp(&value(b))) else { continue };
            let model = self.refitted(best, &set.parts, noise, 8);
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
        for c in &self.candidates(from, among) {
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

    /// Sets that lack one effect of the best.
    fn remove(&self, pool: &mut Vec<Set>) {
        let Some(best) = pool.iter().max_by(|a, b| a.score.total_cmp(&b.score)).cloned() else { return };
        if best.parts.len() < 2 {
            return;
        }
        for k in 0..best.parts.len() {
            if let Some(set) = self.without(&best, k, pool) {
                pool.push(set);
            }
        }
    }

    /// The set without its effect `k`, unless it was visited.
    fn without(&self, set: &Set, k: usize, pool: &[Set]) -> Option<Set> {
        let mut parts = set.parts.clone();
        let gone = parts.remove(k);
        let target = key(&parts);
        if pool.iter().any(|s| s.key() == target) {
            return None;
        }
        let model = strip(&set.model, &gone);
        let model = self.refitted(model, &parts, self.noise(set), 4);
        Some(self.weigh_set(parts, model, Some(&pool[0])))
    }

    /// Rivals in the place of each effect of the best set.
    fn swap(&self, pool: &mut Vec<Set>) {
        let Some(best) = pool.iter().max_by(|a, b| a.score.total_cmp(&b.score)).cloned() else { return };
        for k in 0..best.parts.len() {
            let effect = &self.effects[best.parts[k].effect];
            if effect.coordinate == Coordinate::Angle {
                self.exchange_twin(&best, k, pool);
            }
            let present = best.key();
            let rivals: Vec<usize> = self
                .usable
                .iter()
                .copied()
                .filter(|e| !present.contains(e) && self.effects[*e].looks_like(effect))
                .collect();
            // A baseline that was refitted without the effect has taken up part of it, and of what does the same: rivals are looked for
            // where it leaves a gap.
            let mut parts = best.parts.clone();
            let gone = parts.remove(k);
            let gap = self.weigh_set(parts, strip(&best.model, &gone), Some(&pool[0]));
            let mut seen = Vec::new();
            for c in self.candidates(&gap, &rivals) {
                if !seen.contains(&c.effect) {
                    seen.push(c.effect);
                    self.put(self.with(&gap, &c, &pool[0]), pool);
                }
            }
            // Beside what was found since, another form of the effect itself may be the nearer one.
            if let Some(base) = pool.iter().find(|s| s.key() == gap.key()).cloned() {
                self.expand(&base, &[gone.effect], 1, true, pool);
            }
        }
    }

    /// The set in the pool, in the place of one of the same effects that is worse.
    fn put(&self, set: Set, pool: &mut Vec<Set>) {
        let key = set.key();
        match pool.iter().position(|s| s.key() == key) {
            Some(k) if pool[k].score >= set.score => {}
            Some(k) => pool[k] = set,
            None => pool.push(set),
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
                super::refit::put_coefficients(&mut model, &spec.phased, &values);
                let model = self.refitted(model, &parts, self.noise(set), 6);
                self.put(self.weigh_set(parts, model, Some(&pool[0])), pool);
            }
        }
    }

    /// What residuals scatter in a set.
    pub fn noise(&self, set: &Set) -> Noise {
        let [chance, duty, direction, both, order] = set.weighed.taus;
        let spread = [chance, duty, direction, both, order].iter().map(|t| t * t).sum::<f64>().sqrt();
        Noise { variance: set.weighed.variance, gain_spread: spread.clamp(3e-3, 0.1) }
    }

    /// The model refitted with the effects in it.
    fn refitted(&self, model: Model, parts: &[Part], noise: Noise, steps: usize) -> Model {
        let phased: Vec<Phased> = parts.iter().flat_map(|p| p.phased.iter().copied()).collect();
        let free = self.free(&model, parts);
        refit(self.problem, model, &free, &phased, noise, steps)
    }

    /// Columns of a set: gain, other free parameters, phased pairs; and what is asked of them.
    fn columns(&self, model: &Model, parts: &[Part]) -> (Vec<Column>, Question) {
        let free = self.free(model, parts);
        let mut columns = columns_of(&free);
        let common = free
            .iter()
            .enumerate()
            .skip(1)
            .map(|(k, f)| (k, (f.prior.sd_near(model.parameters.get(f.parameter)) / f.scale).min(10.0)))
            .collect();
        let mut own = Vec::new();
        for (group, p) in parts.iter().flat_map(|p| &p.phased).enumerate() {
            for column in p.columns() {
                own.push((columns.len(), group));
                columns.push(column);
            }
        }
        (columns, Question { common, own })
    }

    /// Weighs a refitted set; `root` is the set without effects.
    fn weigh_set(&self, parts: Vec<Part>, model: Model, root: Option<&Set>) -> Set {
        let (mut columns, base) = self.columns(&model, &parts);
        let own_columns = base.own_range();
        let at: Vec<std::ops::Range<usize>> = self
            .terms
            .iter()
            .map(|t| {
                let from = columns.len();
                columns.extend(t.columns.iter().cloned());
                from..columns.len()
            })
            .collect();
        let phased: Vec<Phased> = parts.iter().flat_map(|p| p.phased.iter().copied()).collect();
        let designs = self.problem.design(&model, &columns);
        let equations = Equations::new(&designs, own_columns, &coefficients(&model, &phased));
        let without = root.map_or(0.0, |r| r.weighed.left);
        let start = Start {
            variance: root
                .map_or_else(|| first_noise(self.problem, &model, self.independent).variance, |r| r.weighed.variance),
            taus: self.level.believed(),
            without,
            spreads: Spreads::Anywhere,
        };
        let ask = |terms: &[usize], start: &Start, level: &Level| {
            let mut q = base.clone();
            for t in terms {
                if self.terms[*t].own {
                    // Each harmonic has a power of its own; the knots of a wander share one.
                    let group = q.own.iter().map(|o| o.1 + 1).max().unwrap_or(0);
                    let pair = |i: usize| if self.terms[*t].harmonic { i / 2 } else { 0 };
                    q.own.extend(at[*t].clone().enumerate().map(|(i, c)| (c, group + pair(i))));
                } else {
                    let sd = if self.terms[*t].lives_in == "timing against the PWM" { 1.0 } else { SIZE };
                    q.common.extend(at[*t].clone().map(|c| (c, sd)));
                }
            }
            weigh(&equations, level, &q, start)
        };
        let failed = || Weighed {
            log: f64::NEG_INFINITY,
            left: f64::INFINITY,
            variance: start.variance,
            taus: start.taus,
            gains: vec![0.0; self.problem.runs.len()],
            common: Vec::new(),
            powers: Vec::new(),
        };
        let mut weighed = ask(&[], &start, &self.level).unwrap_or_else(failed);
        if let Some(r) = root {
            let shift = weighed.gains.iter().zip(&r.weighed.gains).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let level = self.level.beside_a_shift((shift / weighed.gains.len().max(1) as f64).sqrt());
            weighed = ask(&[], &Start { taus: weighed.taus, spreads: Spreads::Near, ..start.clone() }, &level)
                .unwrap_or_else(failed);
        }
        // Terms without physics, one after the other, at the spreads that the gains have without them.
        let without = without.max(weighed.left);
        let near = Start { variance: weighed.variance, taus: weighed.taus, without, spreads: Spreads::Stay };
        let mut chosen: Vec<usize> = Vec::new();
        let mut best = weighed.log;
        let mut left = Vec::new();
        let mut courses = Vec::new();
        for round in 0..2 {
            let looks: Vec<(usize, f64, f64)> = (0..self.terms.len())
                .into_par_iter()
                .filter(|t| !chosen.contains(t))
                .filter_map(|t| {
                    let more = [chosen.clone(), vec![t]].concat();
                    ask(&more, &near, &self.level).map(|w| (t, w.log - self.term_cost(t), w.left))
                })
                .collect();
            if round == 0 {
                let of_runs = looks.iter().filter(|l| self.terms[l.0].own);
                let all = weighed.left + equations.floor();
                courses = of_runs.map(|l| (self.terms[l.0].lives_in, (weighed.left - l.2) / all.max(1e-12))).collect();
            }
            let Some((t, log, rest)) = looks.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
            let cost: f64 = chosen.iter().map(|c| self.term_cost(*c)).sum();
            if log - cost <= best {
                break;
            }
            best = log - cost;
            chosen.push(t);
            left.push((self.terms[t].lives_in, rest));
        }
        let prior = self.log_prior(&model, &parts);
        let amplitude: f64 = weighed
            .powers
            .iter()
            .map(|p| -0.5 * (((2.0 * p).sqrt() / AMPLITUDE.0).ln() / AMPLITUDE.1).powi(2))
            .sum::<f64>();
        let amplitude = if self.parts_admissible(&parts, &weighed.powers) { amplitude } else { f64::NEG_INFINITY };
        let ways: f64 = parts.iter().map(|p| (self.effects[p.effect].ways() as f64).ln()).sum();
        let coordinates: std::collections::BTreeSet<_> =
            parts.iter().map(|p| self.effects[p.effect].coordinate as u8).collect();
        let shared = (parts.len() - coordinates.len()) as f64;
        let score = best + prior + amplitude - EFFECT_COST * parts.len() as f64 - SAME_COORDINATE * shared - ways;
        Set { parts, model, score, weighed, terms: left, courses, expanded: false }
    }

    fn term_cost(&self, term: usize) -> f64 {
        let over = |e: &usize| self.terms[term].coordinates.contains(&self.effects[*e].coordinate);
        if self.usable.iter().any(over) { FREE_FORM_COST } else { TERM_COST }
    }

    /// Whether what goes with the angle goes with it once or twice a turn before all: a rhythm of the third harmonic and beyond is another
    /// cause (poles, teeth, a contact of many points).
    fn parts_admissible(&self, parts: &[Part], powers: &[f64]) -> bool {
        let mut at = 0;
        parts.iter().all(|part| {
            let errs = |(p, power): (&Phased, &f64)| match p {
                Phased::Eccentricity(h) => (h + 1) as f64 * (2.0 * power).sqrt(),
                _ => 0.0,
            };
            let wheel: f64 = part.phased.iter().zip(powers.iter().skip(at)).map(errs).sum();
            let own = &powers[at.min(powers.len())..(at + part.phased.len()).min(powers.len())];
            at += part.phased.len();
            let order = |p: &Phased| match p {
                Phased::Runout(h) | Phased::Eccentricity(h) => *h,
                Phased::Gravity => 0,
            };
            let (low, high) = part.phased.iter().zip(own).fold((0.0, 0.0), |(low, high), (p, power)| {
                if order(p) < 2 { (low + power, high) } else { (low, high + power) }
            });
            high <= low && wheel < MOST_OF_A_WHEEL
        })
    }

    /// All forms of the effects `among` beside a set, weighed linearly: the two best forms of each, best effects first.
    fn candidates(&self, from: &Set, among: &[usize]) -> Vec<Candidate> {
        let (mut columns, base) = self.columns(&from.model, &from.parts);
        let own_columns = base.own_range();
        let present = from.key();
        let mut forms = Vec::new();
        for &effect in among {
            if present.contains(&effect) || self.excluded(effect, &present) {
                continue;
            }
            // What a part changes already has one size.
            let taken = |f: &Form| {
                let free = |s: &Size| from.parts.iter().any(|p| p.free.iter().any(|f| f.parameter == s.parameter));
                f.sizes.iter().any(free)
            };
            let forms_of = self.effects[effect].forms.iter().enumerate().filter(|(_, f)| !taken(f));
            for (k, form) in forms_of {
                let sizes: Vec<usize> = form.columns().into_iter().map(|c| place(&mut columns, c)).collect();
                let shape: Vec<(P, f64)> = form.shapes.iter().map(|s| (s.parameter, s.start)).collect();
                let pairs: Vec<usize> = form
                    .phased
                    .iter()
                    .flat_map(|p| p.columns())
                    .map(|c| {
                        place(
                            &mut columns,
                            if shape.is_empty() { c } else { Column::Shaped(Box::new(c), shape.clone()) },
                        )
                    })
                    .collect();
                forms.push((effect, k, sizes, pairs));
            }
        }
        let phased: Vec<Phased> = from.parts.iter().flat_map(|p| p.phased.iter().copied()).collect();
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
            .filter_map(|(effect, form, sizes, pairs)| {
                let spec = &self.effects[*effect].forms[*form];
                let looks = [from.weighed.taus, believed]
                    .into_iter()
                    .filter_map(|t| ask(sizes, pairs, &start(t, Spreads::Stay)));
                let best = looks.max_by(|a, b| a.log.total_cmp(&b.log))?;
                let values = self.admissible(spec, &best.common[base.common.len()..])?;
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
        let of = |c: &Candidate| forms.iter().find(|f| f.0 == c.effect && f.1 == c.form);
        kept.par_iter_mut().for_each(|c| {
            if let Some((_, _, sizes, pairs)) = of(c)
                && let Some(w) = ask(sizes, pairs, &start(from.weighed.taus, Spreads::Near))
                && let Some(values) =
                    self.admissible(&self.effects[c.effect].forms[c.form], &w.common[base.common.len()..])
            {
                c.gain = w.log - now.log;
                c.values = values;
            }
        });
        kept.retain(|c| c.gain > LEAST_LOOK);
        kept.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        kept
    }

    /// Effects that are not both in a set: they are one thing seen from two sides.
    fn excluded(&self, effect: usize, present: &[usize]) -> bool {
        present.iter().any(|p| self.effects[effect].is_twin(&self.effects[*p]))
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
    fn with(&self, from: &Set, candidate: &Candidate, root: &Set) -> Set {
        let spec = &self.effects[candidate.effect].forms[candidate.form];
        let part =
            Part { effect: candidate.effect, form: candidate.form, free: free_of(spec), phased: spec.phased.clone() };
        let mut start = from.model.clone();
        for s in &spec.shapes {
            start.parameters.set(s.parameter, s.start);
        }
        let mut parts = from.parts.clone();
        parts.push(part);
        let noise = self.noise(from);
        let noise = Noise { gain_spread: noise.gain_spread.min(0.02), ..noise };
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
            let mut file = at(1.0);
            for rate in [P::OnAcceleration, P::OffDeceleration, P::Viscous, P::SlipBand, P::WaveTime] {
                if self.home.get(rate) > 0.0 {
                    file.parameters.set(rate, self.home.get(rate));
                }
            }
            starts.push(file);
            if spec.sizes.iter().all(|s| s.step.abs() < 0.99 * s.scale) {
                starts.push(at(0.4));
            }
        }
        let value = |m: &Model| self.misfit(m, &parts, noise);
        let looked: Vec<Model> = starts.into_iter().map(|s| self.refitted(s, &parts, noise, 2)).collect();
        let best = looked.into_iter().min_by(|a, b| value(a).total_cmp(&value(b)));
        let model = best.unwrap_or(start);
        let model = self.refitted(model, &parts, noise, 6);
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
fn free_of(form: &Form) -> Vec<Free> {
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
            prior: Prior::log_normal(p.median, p.log_sd),
        })
    });
    form.sizes.iter().map(size).chain(shapes).collect()
}

/// The model without an effect.
pub fn strip(model: &Model, part: &Part) -> Model {
    let mut m = model.clone();
    let absent = Parameters::new(1.0, 1.0, 1.0, 0.0, 0.0);
    for f in &part.free {
        m.parameters.set(f.parameter, absent.get(f.parameter));
    }
    for shape in [P::RunoutSpeed, P::RunoutTorque, P::RunoutBrake] {
        if part.phased.iter().any(|p| matches!(p, Phased::Runout(_))) {
            m.parameters.set(shape, absent.get(shape));
        }
    }
    let zero = vec![vec![0.0; 2 * part.phased.len()]; m.terms.len()];
    super::refit::put_coefficients(&mut m, &part.phased, &zero);
    m
}
