//! Runs of a TWUM, one or many, open or closed loop: lost time put back, the baseline refitted, sets weighed, the answer's parts.

use super::baseline::refit_baseline;
use super::discrepancy::Term;
use super::evidence::independent;
use super::finding::{Finding, Status, Unknown};
use super::gaps::{self, Gaps};
use super::held_out::Scorer;
use super::library::{Coordinate, Effect, library, not_judged};
use super::numbers::estimates;
use super::problem::{Model, Problem};
use super::pwm_line::clock_errors;
use super::refit::{Noise, objective, refit};
use super::rotor::{P, Parameters};
use super::search::{Ground, Set, strip};
use super::stats::{Group, HeldOut};
use super::verdict::{ALIKE, CLOSED_TEMPERATURE, Judgement, NAMED, TEMPERATURE, judge};

/// What the search is asked to do.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// Repetitions of the null.
    pub repetitions: usize,
    /// Names taken out of the library.
    pub without: Vec<String>,
}

/// Everything that was found.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The runs as they were compared: lost time put back, stretches of several edges.
    pub problem: Problem,
    /// Refitted baseline.
    pub baseline: Model,
    /// Model with all accepted effects.
    pub extended: Model,
    /// Held-out errors of baseline (0) and extended (1).
    pub held_out: HeldOut,
    /// r² over run mean speeds of baseline and extended, held out.
    pub r2: [Option<f64>; 2],
    /// Position error of baseline and extended in degrees.
    pub position_deg: [f64; 2],
    /// Evidence an effect, accepted ones first.
    pub findings: Vec<Finding>,
    /// What no effect explains.
    pub unknown: Vec<Unknown>,
    /// Effects that could not be judged, with the reason.
    pub not_judged: Vec<(String, String)>,
    /// Noise floor in rpm.
    pub noise_floor: f64,
}

/// Diagnoses runs, starting from the motor file's rotor.
pub fn diagnose_runs(
    problem: &Problem,
    home: &Parameters,
    settings: &Settings,
    progress: &dyn Fn(&str, f64),
) -> Outcome {
    let effects: Vec<Effect> = library(home.get(P::OnAcceleration), &clock_errors(problem))
        .into_iter()
        .filter(|e| !settings.without.iter().any(|w| w == e.name))
        .collect();
    let mut refused = vec![(
        "presliding".to_owned(),
        "an elastic return is smaller than the encoder's pitch; a finer encoder would show it".to_owned(),
    )];
    let mut usable = Vec::new();
    for (i, effect) in effects.iter().enumerate() {
        match not_judged(effect, problem) {
            Some(reason) => refused.push((effect.name.to_owned(), reason)),
            None => usable.push(i),
        }
    }
    progress("refitting the baseline", 0.02);
    let original = problem.clone().widened();
    let counted = |p: &Problem| {
        let rows: usize = p.runs.iter().map(|r| r.windows.len()).sum();
        independent(rows as f64, p.runs.len())
    };
    let unrepaired = refit_baseline(&original, home, counted(&original));
    progress("looking for lost samples", 0.06);
    let mut lost = lost_samples(problem, &problem.model(unrepaired.parameters.clone()), settings);
    let compare = |lost: &Option<Gaps>| match lost {
        Some(gaps) => {
            let repaired = gaps.problem.clone().widened();
            let baseline = refit_baseline(&repaired, home, counted(&repaired));
            (repaired, baseline)
        }
        None => (original.clone(), unrepaired.clone()),
    };
    let (mut compared, baseline) = compare(&lost);
    let mut sets = Ground::new(&compared, home.clone(), &effects, usable.clone()).search(baseline, progress);
    if lost.is_none() && !sets[0].parts.is_empty() {
        // Behind another effect's error they may not have shown.
        lost = lost_samples(problem, &sets[0].model, settings);
        if lost.is_some() {
            let (repaired, baseline) = compare(&lost);
            compared = repaired;
            sets = Ground::new(&compared, home.clone(), &effects, usable.clone()).search(baseline, progress);
        }
    }
    progress("measuring what was found", 0.85);
    let mut outcome = conclude(&Ground::new(&compared, home.clone(), &effects, usable), &sets, settings);
    if let Some(gaps) = lost {
        let before = Ground::new(&original, home.clone(), &effects, Vec::new());
        let root = before.root(unrepaired);
        let held = Scorer::new(&before, settings.seed).held_out(&root);
        outcome.held_out = held.against(&outcome.held_out);
        outcome.findings.insert(0, gaps.finding);
    }
    outcome.not_judged = refused;
    outcome
}

/// Lost words of samples beside a model, unless a wrong clock does as well.
fn lost_samples(problem: &Problem, model: &Model, settings: &Settings) -> Option<Gaps> {
    if settings.without.iter().any(|w| w == "dropped-samples") {
        return None;
    }
    gaps::find(problem, model, settings.seed).filter(|g| !clock_explains(problem, model, g))
}

/// Whether a wrong clock does as well as lost samples: both move the PWM line.
fn clock_explains(problem: &Problem, baseline: &Model, gaps: &Gaps) -> bool {
    let noise = Noise { variance: 1.0, gain_spread: 0.0 };
    let with_gaps = objective(&gaps.problem, baseline, noise);
    // Near nothing, where the line may not part from its place, and about the lines.
    let near = (-30..=30).filter(|k| *k != 0).map(|k| 4e-4 * f64::from(k));
    let lines = clock_errors(problem).into_iter().flat_map(|e| (-5..=5).map(move |k| e + 2e-4 * f64::from(k)));
    near.chain(lines).any(|error| {
        let mut m = baseline.clone();
        m.parameters.set(P::ClockError, error);
        objective(problem, &m, noise) < 1.05 * with_gaps
    })
}

/// Scores, numbers and left-overs of the sets that were visited, best first.
fn conclude(ground: &Ground, visited: &[Set], settings: &Settings) -> Outcome {
    let scorer = Scorer::new(ground, settings.seed);
    let root = visited.iter().find(|s| s.parts.is_empty()).unwrap_or(&visited[0]);
    let alike = |a: usize, b: usize| ground.effects[a].looks_like(&ground.effects[b]);
    let temperature = if ground.problem.closed() { CLOSED_TEMPERATURE } else { TEMPERATURE };
    let mut standing = visited.to_vec();
    let mut uncertain: Vec<(usize, f64)> = Vec::new();
    let mut judged = loop {
        let judged = judge(&standing, root, temperature, &alike, &|k, tau| ground.level.log_prior_of(k, tau));
        let struck = uncertain_effects(ground, &scorer, &standing, root, &judged, settings.seed);
        if struck.is_empty() {
            break judged;
        }
        uncertain.extend(struck.iter().map(|e| (*e, inclusion(&judged, *e))));
        // What leant on them is judged anew without them, and what looks like them does not take their place.
        let gone = |e: &usize| struck.iter().any(|s| s == e || alike(*s, *e) && !judged.named.contains(e));
        standing.retain(|s| !s.key().iter().any(gone));
    };
    let sets = standing.as_slice();
    if judged.named.is_empty() && judged.one_of.is_empty() && judged.lives_in.is_empty() {
        // Something is there, though none of the effects that were fitted says what.
        let sure = uncertain.iter().filter(|(_, p)| *p >= NAMED);
        judged.lives_in.extend(sure.map(|(e, _)| (ground.effects[*e].coordinate.name(), 0.0)));
    }
    judged.inclusion.extend(&uncertain);
    let accepted = accepted_set(sets, &judged, root);
    let base = scorer.held_out(root);
    let held_out = base.against(&scorer.held_out(accepted));
    let mut findings = Vec::new();
    // Chance is judged with the gains that the accepted effects leave.
    let chance = scorer.chance(root, &accepted.weighed.gains, settings.repetitions, settings.seed);
    for part in &accepted.parts {
        let effect = &ground.effects[part.effect];
        let less = without(ground, sets, accepted, part.effect);
        let held = scorer.held_out(&less).against(&scorer.held_out(accepted));
        // One start, or one course of warmth, cannot be replicated: it is not told from what else happens once.
        let once = matches!(effect.coordinate, Coordinate::Start | Coordinate::Order) && ground.problem.runs.len() == 1;
        let ambiguous = judged.one_of.contains(&part.effect) || once;
        let conflicts: Vec<String> = if once {
            effect.conflicts.iter().map(|c| (*c).to_owned()).collect()
        } else if ambiguous {
            judged.one_of.iter().filter(|e| **e != part.effect).map(|e| ground.effects[*e].name.to_owned()).collect()
        } else {
            Vec::new()
        };
        findings.push(Finding {
            name: effect.name.to_owned(),
            status: if ambiguous { Status::Ambiguous } else { Status::Named },
            probability: Some(inclusion(&judged, part.effect)),
            gain: held.gain(),
            gain_interval: held.gain_interval(settings.seed),
            p_null: chance.p(&held),
            parameters: estimates(&scorer, effect, accepted, part),
            conflicts,
            next_experiment: effect.next_experiment.to_owned(),
            share: 0.0,
            note: String::new(),
        });
    }
    share_out(root, sets, accepted, ground, &mut findings);
    for (effect, probability) in &judged.inclusion {
        let e = &ground.effects[*effect];
        if findings.iter().any(|f| f.name == e.name) {
            continue;
        }
        let rival = judged.one_of.contains(effect);
        let held = chance.alone(*effect).cloned().unwrap_or_default();
        let set = visited.iter().find(|s| s.key().contains(effect));
        let parameters = set
            .and_then(|s| s.parts.iter().find(|p| p.effect == *effect).map(|p| estimates(&scorer, e, s, p)))
            .unwrap_or_default();
        findings.push(Finding {
            name: e.name.to_owned(),
            status: if rival { Status::Ambiguous } else { Status::Rejected },
            probability: Some(*probability),
            gain: held.gain(),
            gain_interval: held.gain_interval(settings.seed),
            p_null: chance.p(&held),
            parameters,
            conflicts: if rival {
                judged.one_of.iter().filter(|o| *o != effect).map(|o| ground.effects[*o].name.to_owned()).collect()
            } else {
                Vec::new()
            },
            next_experiment: e.next_experiment.to_owned(),
            share: 0.0,
            note: if uncertain.iter().any(|(e, _)| e == effect) {
                "likely, but on runs it was not fitted to it does not help for certain".to_owned()
            } else if judged.withheld {
                "explains part of it, but more lives where no effect acts: not the cause".to_owned()
            } else {
                String::new()
            },
        });
    }
    for (effect, held) in &chance.alone {
        let e = &ground.effects[*effect];
        if findings.iter().all(|f| f.name != e.name) {
            findings.push(Finding {
                name: e.name.to_owned(),
                status: Status::Rejected,
                probability: Some(inclusion(&judged, *effect)),
                gain: held.gain(),
                gain_interval: held.gain_interval(settings.seed),
                p_null: chance.p(held),
                parameters: Vec::new(),
                conflicts: Vec::new(),
                next_experiment: e.next_experiment.to_owned(),
                share: 0.0,
                note: String::new(),
            });
        }
    }
    let unknown = left_over(ground, &scorer, &judged, &sets[0]);
    let [structured, all] = [sets[0].terms.last().map_or(sets[0].weighed.left, |t| t.1), sets[0].weighed.left];
    // What is left without any structure is noise, whatever made it.
    let structureless = held_out.rmse(1) * (structured / all.max(1e-12)).sqrt();
    Outcome {
        noise_floor: scorer.noise_floor(accepted).max(structureless).min(held_out.rmse(1)),
        r2: [scorer.mean_speed_r2(root), scorer.mean_speed_r2(accepted)],
        position_deg: [scorer.position_error_deg(&root.model), scorer.position_error_deg(&accepted.model)],
        problem: ground.problem.clone(),
        baseline: root.model.clone(),
        extended: accepted.model.clone(),
        held_out,
        findings,
        unknown,
        not_judged: Vec::new(),
    }
}

/// Lead in nats from which an effect needs no second opinion: that of runs held out is linear around the fit and knows of the noise only
/// what single runs say. By less, forms alone may lead.
const BEYOND_DOUBT: f64 = ALIKE;

/// An effect that does not for certain help on runs it was not fitted to, with those that it cannot be told from; empty if all do.
fn uncertain_effects(
    ground: &Ground,
    scorer: &Scorer,
    sets: &[Set],
    root: &Set,
    judged: &Judgement,
    seed: u64,
) -> Vec<usize> {
    let accepted = accepted_set(sets, judged, root);
    let all = scorer.held_out(accepted);
    let doubtful = accepted.parts.iter().filter(|p| lead(sets, p.effect) < BEYOND_DOUBT).find(|p| {
        let held = scorer.held_out(&without(ground, sets, accepted, p.effect)).against(&all);
        held.gain_interval(seed)[0] <= 0.0
    });
    match doubtful.map(|p| p.effect) {
        Some(effect) if judged.one_of.contains(&effect) => judged.one_of.clone(),
        effect => effect.into_iter().collect(),
    }
}

/// Nats by which the best set with an effect leads the best without.
fn lead(sets: &[Set], effect: usize) -> f64 {
    let best = |with: bool| {
        let of = sets.iter().filter(|s| s.key().contains(&effect) == with);
        of.map(|s| s.score).fold(f64::NEG_INFINITY, f64::max)
    };
    best(true) - best(false)
}

fn inclusion(judged: &Judgement, effect: usize) -> f64 {
    judged.inclusion.iter().find(|i| i.0 == effect).map_or(0.0, |i| i.1)
}

/// The best set that holds every named effect, one of the ambiguous ones, and nothing else.
fn accepted_set<'a>(sets: &'a [Set], judged: &Judgement, root: &'a Set) -> &'a Set {
    let allowed = |s: &&Set| {
        let key = s.key();
        judged.named.iter().all(|e| key.contains(e))
            && key.iter().all(|e| judged.named.contains(e) || judged.one_of.contains(e))
            && (judged.one_of.is_empty() || key.iter().any(|e| judged.one_of.contains(e)))
    };
    sets.iter().find(allowed).unwrap_or(root)
}

/// The accepted set without one of its effects: visited, or refitted.
fn without(ground: &Ground, sets: &[Set], accepted: &Set, effect: usize) -> Set {
    let mut key = accepted.key();
    key.retain(|e| *e != effect);
    if let Some(set) = sets.iter().find(|s| s.key() == key) {
        return set.clone();
    }
    let mut set = accepted.clone();
    if let Some(k) = set.parts.iter().position(|p| p.effect == effect) {
        let gone = set.parts.remove(k);
        let from: usize = accepted.parts[..k].iter().map(|p| p.phased.len()).sum();
        set.weighed.powers.drain(from..from + gone.phased.len());
        let model = strip(&set.model, &gone);
        let phased: Vec<_> = set.parts.iter().flat_map(|p| p.phased.iter().copied()).collect();
        let free = ground.free(&model, &set.parts);
        set.model = refit(ground.problem, model, &free, &phased, ground.noise(accepted), 4);
    }
    set
}

/// Shares of the baseline's squared error that each effect removes: the mean of adding it first and adding it last.
fn share_out(root: &Set, sets: &[Set], accepted: &Set, ground: &Ground, findings: &mut [Finding]) {
    let error = |s: &Set| objective(ground.problem, &s.model, Noise { variance: 1.0, gain_spread: 0.0 });
    let (none, all) = (error(root), error(accepted));
    let removed: Vec<f64> = accepted
        .parts
        .iter()
        .map(|p| {
            let first = sets.iter().find(|s| s.key() == [p.effect]).map_or(none, &error);
            let last = error(&without(ground, sets, accepted, p.effect));
            (0.5 * ((none - first) + (last - all))).max(0.0)
        })
        .collect();
    let total: f64 = removed.iter().sum();
    for (f, r) in findings.iter_mut().zip(&removed) {
        f.share = r / total.max(1e-12) * (1.0 - all / none.max(1e-12)).max(0.0);
    }
}

/// Terms without physics that the data ask for beside the best set, with what they would gain on runs that were not fitted.
fn left_over(ground: &Ground, scorer: &Scorer, judged: &Judgement, best: &Set) -> Vec<Unknown> {
    judged
        .lives_in
        .iter()
        .map(|(place, share)| {
            let term: Option<&Term> = ground.terms.iter().find(|t| t.lives_in == *place);
            let gain = term.map_or(0.0, |t| {
                let (grams, free, _) = scorer.equations(best, &t.columns);
                let own: Vec<usize> = (0..free).collect();
                let from = grams.columns() - t.columns.len();
                let columns: Vec<usize> = (from..grams.columns()).collect();
                let group = if t.own {
                    Group::Phased(columns.chunks_exact(2).map(|c| [c[0], c[1]]).collect())
                } else {
                    Group::Linear(columns)
                };
                grams.hold_out(&own, &group).gain()
            });
            Unknown { lives_in: place, gain, share: *share, p_null: super::verdict::LARGEST_P }
        })
        .collect()
}
