//! The procedure: refit, search, test, compare, remove, say what is left.

use super::effects::{Effect, Shape, library, not_judged};
use super::fit::{Free, PHASED_SCALE, Phased, bias, columns_of, priors_at, refit};
use super::problem::{Basis, Column, Model, Problem, RPM, RunDesign};
use super::rotor::{P, Parameters};
use super::stats::{Fold, Grams, Group, HeldOut, PhasedFit, Prior, folds, p_value};
use nalgebra::DVector;

/// Smallest held-out gain of a named cause.
pub const LEAST_GAIN: f64 = 0.05;
/// Largest p-value of a named cause.
pub const LARGEST_P: f64 = 0.01;
/// Share of the squared error a cause removes that a term without physics may still find before the cause is no longer believed:
/// real effects do not have the library's forms, and a strong one leaves the difference in sight.
pub const LACK_OF_FIT: f64 = 0.12;
/// A rival that the library lists as a conflict and that gains this share of the winner's gain stays in the set, however
/// narrow the interval of the difference: real effects do not have the library's forms, and the nearer form need not be the
/// cause.
const SAME_FOR_A_CONFLICT: f64 = 0.85;
/// How much more squared error than the sampling leaves may stay with nothing to blame: the reduced rotor equation itself leaves up
/// to 1.3 times as much.
const LARGEST_MISFIT: f64 = 1.6;
/// Data sets made to see what the sampling leaves.
const MADE: usize = 8;
/// Most effects that are added.
const MOST_EFFECTS: usize = 4;

/// What the search is asked to do.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// Repetitions of the null.
    pub repetitions: usize,
    /// Names taken out of the library.
    pub without: Vec<String>,
    /// Whether the baseline lets the rotor coast with the drive off (flavour `thesis`).
    pub coasting: bool,
    /// How many candidates are refitted without linearising.
    pub refitted: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { seed: 1, repetitions: 400, without: Vec::new(), coasting: false, refitted: 4 }
    }
}

/// How a cause is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// All conditions hold.
    Named,
    /// Real, but another cause explains it as well.
    Ambiguous,
    /// Looked for, not supported.
    Rejected,
}

/// An estimated parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Name in the JSON.
    pub name: String,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub interval: [f64; 2],
    /// Unit.
    pub unit: String,
}

/// One effect's evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Name of the effect.
    pub name: String,
    /// Verdict on it.
    pub status: Status,
    /// Held-out gain when it was added.
    pub gain: f64,
    /// Its 95 % interval.
    pub gain_interval: [f64; 2],
    /// Share of null data sets in which some candidate does as well.
    pub p_null: f64,
    /// Parameters.
    pub parameters: Vec<Estimate>,
    /// Effects that explain the data as well.
    pub conflicts: Vec<String>,
    /// What would decide.
    pub next_experiment: String,
    /// Share of the baseline's squared error it removes (Shapley).
    pub share: f64,
    /// Why it was not taken, or what is special.
    pub note: String,
}

/// A term without physics that still explains something.
#[derive(Debug, Clone, PartialEq)]
pub struct Unknown {
    /// Where it lives: "time", "angle", ...
    pub lives_in: &'static str,
    /// Held-out gain on top of the extended model.
    pub gain: f64,
    /// Its p-value.
    pub p_null: f64,
}

/// Everything the search found.
#[derive(Debug, Clone)]
pub struct Outcome {
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
    /// Evidence a candidate, named ones first.
    pub findings: Vec<Finding>,
    /// Flexible terms that still matter.
    pub unknown: Vec<Unknown>,
    /// Effects that could not be judged, with the reason.
    pub not_judged: Vec<(String, String)>,
    /// Noise floor in rpm.
    pub noise_floor: f64,
    /// The runs as they were compared: lost time put back, stretches of several edges.
    pub problem: Problem,
    /// Effects that were found, put in, and taken out again.
    pub removed: Vec<String>,
}

/// A candidate in the linear search.
struct Candidate {
    effect: usize,
    shape: usize,
    group: Group,
}

/// An effect in the model.
#[derive(Clone)]
struct Accepted {
    effect: usize,
    free: Vec<Free>,
    phased: Vec<Phased>,
}

/// A member of an answer with the model it was estimated in.
struct Fitted {
    own: Accepted,
    others: Vec<Accepted>,
    model: Model,
}

/// The baseline's own parameters at `p`; `home` are the motor file's.
pub fn baseline_free(p: &Parameters, home: &Parameters, coasting: bool) -> Vec<Free> {
    let w = p.get(P::FreeSpeed);
    let a = p.get(P::OnAcceleration);
    let coasts = p.get(P::RingDown) > 0.0;
    let free = |parameter: P, scale: f64, bounds: (f64, f64)| Free { parameter, scale, bounds, prior: None };
    // A rotor that coasts is not the file's motor.
    let rate = |parameter: P, scale: f64, lowest: f64| {
        let listed = home.get(parameter);
        if coasts || listed <= 0.0 {
            return free(parameter, scale, (lowest, 20.0 * a));
        }
        Free { prior: Some((listed, RATE_LOG_SD)), ..free(parameter, scale, (0.02 * listed, 20.0 * listed)) }
    };
    // Damping hardly shows in open loop: it is left where the file has it, give or take a factor of two.
    let listed = home.get(P::Viscous);
    let viscous =
        Free { prior: (listed > 0.0).then_some((listed, 0.7)), ..free(P::Viscous, 1.0, (0.02 * listed, 50.0)) };
    let mut all = vec![
        free(P::FreeSpeed, w, (0.02 * w, 50.0 * w)),
        rate(P::OnAcceleration, a, 0.02 * a),
        viscous,
        free(P::Latency, 2e-3, (-5e-3, 1e-2)),
    ];
    if !coasting {
        all.insert(2, rate(P::OffDeceleration, a.max(p.get(P::OffDeceleration)), 0.0));
    }
    if coasts {
        all.push(free(P::RingDown, 5e-4, (1e-6, 5e-3)));
    }
    all
}

/// How well a motor file is believed to know its friction: standard deviation of the logarithm of both rates. Friction of one motor
/// varies by a third from day to day, between motors by more; without any belief the rates run away to swallow what a dead zone
/// or a delay does to each pulse.
pub const RATE_LOG_SD: f64 = 0.3;

/// How much better a rotor that coasts must fit before it is believed of a motor whose friction is said to clamp it.
const COASTING_GAIN: f64 = 0.2;

/// Where the fit of the dying wave's braking starts: twice the build-up time of the 30 mm motor's stator (2·Ms/Cs; thesis,
/// A.4), in s.
const RING_DOWN_S: f64 = 4.6e-4;

/// The baseline's own parameters, refitted from several starts: a rotor that is clamped, one that coasts and one that starts
/// slowly lie in valleys of their own.
pub fn refit_baseline(problem: &Problem, start: &Parameters, coasting: bool) -> Model {
    let mut starts = vec![start.clone(), start.with(P::OnAcceleration, 0.3 * start.get(P::OnAcceleration))];
    if !coasting {
        starts.push(start.with(P::OffDeceleration, 0.1 * start.get(P::OffDeceleration)));
    }
    let coasting_start = start.with(P::OffDeceleration, 0.0).with(P::RingDown, RING_DOWN_S);
    starts.push(coasting_start.clone());
    // A rotor that coasts is faster at part duty than the duty says: the start's free speed is read off the duty.
    let fastest = problem.runs.iter().map(|r| r.mean_speed_rpm().abs() / RPM).fold(0.0, f64::max);
    if fastest > 0.0 && fastest < 0.8 * start.get(P::FreeSpeed) {
        starts.push(coasting_start.with(P::FreeSpeed, fastest));
    }
    let fitted = |from: &Parameters, iterations: usize| {
        let free = baseline_free(from, start, coasting);
        let model = refit(problem, problem.model(from.clone()), &free, &[], iterations).0;
        let misfit = super::fit::objective(problem, &model, 1.0, 0.0);
        let value = misfit + super::fit::penalty(&free, &model, misfit / problem.runs.len() as f64);
        let doubt = if !coasting && coasts(&model) { 1.0 / (1.0 - COASTING_GAIN) } else { 1.0 };
        (doubt * value, model)
    };
    let best = starts.iter().map(|s| fitted(s, 4)).min_by(|a, b| a.0.total_cmp(&b.0));
    let near = best.map_or_else(|| start.clone(), |b| b.1.parameters);
    fitted(&near, 12).1
}

/// Context of one step of the search: designs and normal equations around the present model.
struct Step {
    base: Vec<usize>,
    candidates: Vec<Candidate>,
    flexible: Vec<(&'static str, Group)>,
    grams: Grams,
}

/// Searches for what `start` gets wrong on `problem`.
pub fn search(problem: &Problem, start: Parameters, settings: &Settings, progress: &dyn Fn(&str, f64)) -> Outcome {
    let effects: Vec<Effect> = library(start.get(P::OnAcceleration))
        .into_iter()
        .filter(|e| !settings.without.iter().any(|w| w == e.name))
        .collect();
    let mut refused = vec![(
        "presliding".to_owned(),
        "an elastic return is smaller than the encoder's pitch; a finer encoder would show it".to_owned(),
    )];
    let usable: Vec<usize> = (0..effects.len())
        .filter(|i| match not_judged(effects[*i].name, problem, settings.coasting) {
            Some(reason) => {
                refused.push((effects[*i].name.to_owned(), reason));
                false
            }
            None => true,
        })
        .collect();
    let keys: Vec<String> = problem
        .runs
        .iter()
        .map(|r| format!("{:?}/{:.6}/{}/{}", r.kind, r.duty.unwrap_or(-1.0), r.direction, r.pwm_hz))
        .collect();
    let divisions = folds(&keys, if problem.runs.len() < 8 { problem.runs.len() } else { 5 }, settings.seed);

    let mut findings: Vec<Finding> = Vec::new();
    progress("looking for lost samples", 0.02);
    let gaps = if settings.without.iter().any(|w| w == "dropped-samples") {
        None
    } else {
        let baseline = refit_baseline(problem, &start, settings.coasting);
        super::gaps::find(problem, &baseline, settings.seed).filter(|g| !clock_explains(problem, &baseline, g))
    };
    progress("refitting the baseline", 0.06);
    let original = problem.clone().widened();
    let unrepaired = refit_baseline(&original, &start, settings.coasting);
    let (problem, baseline) = match gaps {
        Some(gaps) => {
            findings.push(gaps.finding);
            let repaired = gaps.problem.widened();
            let baseline = refit_baseline(&repaired, &start, settings.coasting);
            (repaired, baseline)
        }
        None => (original.clone(), unrepaired.clone()),
    };
    let problem = &problem;
    let base_free = baseline_free(&baseline.parameters, &start, settings.coasting);

    let mut model = baseline.clone();
    let mut accepted: Vec<Accepted> = Vec::new();
    let mut first_evidence: Vec<Finding> = Vec::new();
    let mut noise: Option<(f64, f64)> = None;
    let mut fits: Vec<Fitted> = Vec::new();
    for round in 0..=MOST_EFFECTS {
        progress("searching the library", 0.1 + 0.15 * round as f64);
        let step = linearise(problem, &model, &effects, &usable, &accepted, &base_free, &keys, &divisions);
        noise = Some((step.grams.variance, step.grams.gain_spread));
        let groups: Vec<Group> = step.candidates.iter().map(|c| c.group.clone()).collect();
        if groups.is_empty() || round == MOST_EFFECTS {
            break;
        }
        let (improvements, null) =
            step.grams.screen(&step.base, &groups, settings.repetitions, settings.seed + 1000 * round as u64);
        // The best shape of each effect.
        let mut best: Vec<(usize, usize)> = Vec::new();
        for effect in &usable {
            let shapes = (0..step.candidates.len()).filter(|c| step.candidates[*c].effect == *effect);
            if let Some(c) = shapes.max_by(|a, b| improvements[*a].total_cmp(&improvements[*b])) {
                best.push((*effect, c));
            }
        }
        best.sort_by(|a, b| improvements[b.1].total_cmp(&improvements[a.1]));
        if round == 0 {
            first_evidence = best
                .iter()
                .map(|(e, c)| {
                    let held = step.grams.hold_out(&step.base, &step.candidates[*c].group);
                    Finding {
                        name: effects[*e].name.to_owned(),
                        status: Status::Rejected,
                        gain: held.gain(),
                        gain_interval: held.gain_interval(settings.seed),
                        p_null: p_value(improvements[*c], &null),
                        parameters: Vec::new(),
                        conflicts: Vec::new(),
                        next_experiment: effects[*e].next_experiment.to_owned(),
                        share: 0.0,
                        note: String::new(),
                    }
                })
                .collect();
        }
        let significant: Vec<(usize, usize)> = best
            .iter()
            .copied()
            .filter(|(_, c)| improvements[*c] > 0.0 && p_value(improvements[*c], &null) <= LARGEST_P)
            .take(settings.refitted)
            .collect();
        if significant.is_empty() {
            break;
        }
        progress("refitting the best candidates", 0.15 + 0.15 * round as f64);
        let before = step.grams.hold_out(&step.base, &Group::Linear(Vec::new()));
        let variance = step.grams.variance;
        let spread = step.grams.gain_spread;
        let mut trials: Vec<Trial> = significant
            .iter()
            .map(|(e, c)| {
                let mut trial = try_candidate(
                    problem,
                    &start,
                    &model,
                    &effects[*e],
                    *e,
                    &step,
                    *c,
                    &accepted,
                    &base_free,
                    &keys,
                    &divisions,
                    (variance, spread),
                );
                for (l, b) in trial.held.loss.iter_mut().zip(&before.loss) {
                    l[0] = b[0];
                }
                for (l, b) in trial.held.plain.iter_mut().zip(&before.plain) {
                    l[0] = b[0];
                }
                trial.p_null = p_value(improvements[*c], &null);
                trial
            })
            .collect();
        trials.sort_by(|a, b| b.held.improvement().total_cmp(&a.held.improvement()));
        let winner = &trials[0];
        let gain = winner.held.gain();
        let interval = winner.held.gain_interval(settings.seed);
        let sizes_ok = winner.estimates_ok;
        if gain < LEAST_GAIN || interval[0] <= 0.0 || !sizes_ok {
            // The next best may still qualify only as part of the truth of a winner that is inadmissible.
            if let Some(f) = first_evidence.iter_mut().find(|f| f.name == effects[winner.accepted.effect].name) {
                f.note = if !sizes_ok {
                    "its size is not distinguishable from absent, or not admissible".to_owned()
                } else {
                    format!("significant, but its gain of {:.1} % is below {:.0} %", 100.0 * gain, 100.0 * LEAST_GAIN)
                };
            }
            let other = trials.iter().skip(1).position(|t| {
                t.estimates_ok && t.held.gain() >= LEAST_GAIN && t.held.gain_interval(settings.seed)[0] > 0.0
            });
            match other {
                Some(k) if !sizes_ok => trials.swap(0, k + 1),
                _ => break,
            }
        }
        let winner = &trials[0];
        let rivals: Vec<&Trial> = trials[1..]
            .iter()
            .filter(|t| {
                t.held.gain() >= 0.5 * winner.held.gain()
                    && t.estimates_ok
                    && (winner.held.lead_interval(&t.held, settings.seed)[0] <= 0.0
                        || (conflict(&effects[winner.accepted.effect], &effects[t.accepted.effect])
                            && t.held.gain() >= SAME_FOR_A_CONFLICT * winner.held.gain()))
            })
            .collect();
        let mut set: Vec<&Trial> = vec![winner];
        set.extend(&rivals);
        for t in &set {
            let effect = &effects[t.accepted.effect];
            findings.push(Finding {
                name: effect.name.to_owned(),
                status: if rivals.is_empty() { Status::Named } else { Status::Ambiguous },
                gain: t.held.gain(),
                gain_interval: t.held.gain_interval(settings.seed),
                p_null: t.p_null,
                parameters: t.estimates.clone(),
                conflicts: set
                    .iter()
                    .filter(|o| o.accepted.effect != t.accepted.effect)
                    .map(|o| effects[o.accepted.effect].name.to_owned())
                    .collect(),
                next_experiment: effect.next_experiment.to_owned(),
                share: 0.0,
                note: String::new(),
            });
        }
        fits.extend(set.iter().filter(|t| t.accepted.phased.is_empty()).map(|t| Fitted {
            own: t.accepted.clone(),
            others: accepted.clone(),
            model: t.model.clone(),
        }));
        model = winner.model.clone();
        accepted.push(winner.accepted.clone());
    }

    // Backward: what is no longer needed goes.
    let mut removed = Vec::new();
    progress("checking what can be left out", 0.85);
    if accepted.len() > 1 {
        let mut k = 0;
        while k < accepted.len() && accepted.len() > 1 {
            let without: Vec<Accepted> =
                accepted.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, a)| a.clone()).collect();
            let smaller = refit_accepted(problem, &strip(&model, &accepted[k]), &base_free, &without).0;
            let full = held_out_at(problem, &model, &base_free, &accepted, &keys, &divisions, noise);
            let less = held_out_at(problem, &smaller, &base_free, &without, &keys, &divisions, noise);
            if full.lead_interval(&less, settings.seed)[0] <= 0.0 {
                let name = effects[accepted[k].effect].name;
                removed.push(name.to_owned());
                if let Some(f) = findings.iter_mut().find(|f| f.name == name) {
                    f.status = Status::Rejected;
                    f.note = "not needed beside the others".to_owned();
                }
                model = smaller;
                accepted.remove(k);
            } else {
                k += 1;
            }
        }
    }

    settle(&mut findings);

    progress("measuring what the sampling does to the numbers", 0.87);
    for fit in &mut fits {
        let Some(finding) =
            findings.iter_mut().find(|f| f.name == effects[fit.own.effect].name && f.status != Status::Rejected)
        else {
            continue;
        };
        if accepted.iter().any(|a| a.effect == fit.own.effect) {
            // What was accepted later has moved it.
            fit.model = model.clone();
            fit.others = accepted.iter().filter(|a| a.effect != fit.own.effect).cloned().collect();
        }
        let spread = noise.map_or(0.01, |n| n.1);
        finding.parameters = calibrated(problem, fit, &effects, &base_free, &keys, &divisions, spread, settings);
    }

    progress("looking for what no candidate explains", 0.9);
    let mut unknown = Vec::new();
    {
        let step = linearise(problem, &model, &effects, &[], &accepted, &base_free, &keys, &divisions);
        let groups: Vec<Group> = step.flexible.iter().map(|f| f.1.clone()).collect();
        let (improvements, null) = step.grams.screen(&step.base, &groups, settings.repetitions, settings.seed + 77_777);
        for (k, (lives_in, group)) in step.flexible.iter().enumerate() {
            let p = p_value(improvements[k], &null);
            if improvements[k] > 0.0 && p <= LARGEST_P {
                let gain = step.grams.hold_out(&step.base, group).gain();
                if gain > 0.0 {
                    unknown.push(Unknown { lives_in, gain, p_null: p });
                }
            }
        }
        unknown.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        // Where no cause is found and no term without physics catches it, the sampling still says how much too much is left.
        if accepted.is_empty() {
            let (variance, spread) = (step.grams.variance, step.grams.gain_spread);
            let misfit = super::fit::misfit(problem, &model, variance, spread, MADE, settings.seed).unwrap_or(1.0);
            if misfit > LARGEST_MISFIT {
                let gain = 1.0 - (1.0 / misfit).sqrt();
                unknown.push(Unknown { lives_in: "no one place", gain, p_null: 1.0 / (1 + MADE) as f64 });
            }
        }
    }

    let base_held = held_out_at(&original, &unrepaired, &base_free, &[], &keys, &divisions, noise);
    let full_held = held_out_at(problem, &model, &base_free, &accepted, &keys, &divisions, noise);
    let mut held_out = base_held.clone();
    for (h, f) in held_out.loss.iter_mut().zip(&full_held.loss) {
        h[1] = f[0];
    }
    for (h, f) in held_out.plain.iter_mut().zip(&full_held.plain) {
        h[1] = f[0];
    }
    shapley(problem, &model, &base_free, &accepted, &effects, &mut findings);
    for f in first_evidence {
        if !findings.iter().any(|g| g.name == f.name) {
            findings.push(f);
        }
    }
    let r2 = [
        mean_speed_r2(problem, &baseline, &base_free, &[], &keys, &divisions),
        mean_speed_r2(problem, &model, &base_free, &accepted, &keys, &divisions),
    ];
    Outcome {
        // What is left bounds the floor from above.
        noise_floor: noise_floor(problem, &model, noise.map_or(0.01, |n| n.1)).min(held_out.rmse(1)),
        problem: problem.clone(),
        r2,
        position_deg: [position_error_deg(problem, &baseline), position_error_deg(problem, &model)],
        baseline,
        extended: model,
        held_out,
        findings,
        unknown,
        not_judged: refused,
        removed,
    }
}

/// Whether a wrong clock does as well as lost samples: both move the PWM line.
fn clock_explains(problem: &Problem, baseline: &Model, gaps: &super::gaps::Gaps) -> bool {
    let square = |p: &Problem, m: &Model| super::fit::objective(p, m, 1.0, 0.0);
    let with_gaps = square(&gaps.problem, baseline);
    (-30..=30).filter(|k| *k != 0).any(|k| {
        let mut m = baseline.clone();
        m.parameters.set(P::ClockError, 4e-4 * f64::from(k));
        square(problem, &m) < 1.05 * with_gaps
    })
}

/// A rival that earned a place of its own in a later step was no rival: its first entry goes, and what it left alone is named.
fn settle(findings: &mut Vec<Finding>) {
    let mut k = 0;
    while k < findings.len() {
        let name = findings[k].name.clone();
        let later = findings[k + 1..].iter().any(|f| f.name == name && f.status != Status::Rejected);
        if findings[k].status == Status::Ambiguous && later {
            findings.remove(k);
            for f in findings.iter_mut().take_while(|f| f.name != name) {
                f.conflicts.retain(|c| *c != name);
                if f.status == Status::Ambiguous && f.conflicts.is_empty() {
                    f.status = Status::Named;
                }
            }
        } else {
            k += 1;
        }
    }
}

fn conflict(a: &Effect, b: &Effect) -> bool {
    a.conflicts.contains(&b.name) || b.conflicts.contains(&a.name)
}

struct Trial {
    accepted: Accepted,
    model: Model,
    held: HeldOut,
    estimates: Vec<Estimate>,
    estimates_ok: bool,
    p_null: f64,
}

#[allow(clippy::too_many_arguments)]
fn linearise(
    problem: &Problem,
    model: &Model,
    effects: &[Effect],
    usable: &[usize],
    accepted: &[Accepted],
    base_free: &[Free],
    keys: &[String],
    divisions: &[Fold],
) -> Step {
    let free = free_around(model, base_free, accepted);
    let mut columns = columns_of(&free);
    let mut scales = vec![1.0; columns.len()];
    let base: Vec<usize> = (0..columns.len()).collect();
    let mut add = |column: Column, scale: f64| {
        if let Some(k) = columns.iter().position(|c| *c == column) {
            return k;
        }
        columns.push(column);
        scales.push(scale);
        columns.len() - 1
    };
    let mut candidates = Vec::new();
    for &e in usable {
        if accepted.iter().any(|a| a.effect == e) {
            continue;
        }
        for (s, shape) in effects[e].shapes.iter().enumerate() {
            let k: Vec<usize> =
                shape.columns.iter().map(|c| add(c.clone(), if shape.phased { PHASED_SCALE } else { 1.0 })).collect();
            candidates.push(Candidate { effect: e, shape: s, group: group_of(shape, k) });
        }
    }
    let mut flexible = Vec::new();
    if usable.is_empty() {
        let mut linear = |name: &'static str, bases: Vec<Basis>| {
            let k: Vec<usize> = bases.into_iter().map(|b| add(Column::Flexible(b), 0.3)).collect();
            flexible.push((name, Group::Linear(k)));
        };
        linear("time", (0..6).map(|j| Basis::Time(j, 6)).collect());
        let duties = distinct(problem.runs.iter().filter_map(|r| r.duty));
        if duties >= 3 {
            let n = duties.min(6);
            linear("duty", (0..n).map(|j| Basis::Duty(j, n)).collect());
        }
        if problem.runs.iter().any(|r| r.direction > 0.0) && problem.runs.iter().any(|r| r.direction < 0.0) {
            linear("direction", vec![Basis::Direction]);
            if duties >= 3 {
                linear("duty and direction", (0..3).map(|j| Basis::DutyDirection(j, 3)).collect());
            }
        }
        if problem.ordered() && problem.runs.len() >= 6 {
            linear("order", (0..5).map(|j| Basis::Order(j, 5)).collect());
        }
        if problem.runs.iter().any(|r| r.duty.is_some_and(|d| d < 1.0)) {
            linear("PWM phase", (0..8).map(|j| Basis::Phase(j, 8)).collect());
        }
        if problem.runs.iter().any(|r| r.level.iter().any(|l| *l != 0)) {
            linear("encoder slots", vec![Basis::Slot]);
        }
        if problem.runs.iter().any(|r| r.duty.is_some_and(|d| d < 1.0)) {
            let k = (0..6).map(|j| add(Column::Lag(j, 6), 1.0)).collect();
            flexible.push(("timing against the PWM", Group::Linear(k)));
        }
        if problem.runs.iter().any(|r| r.revolutions() > 0.6) {
            for (name, from) in [("angle", 0), ("angle, three and more times a turn", 2)] {
                let pairs = (from..from + if from == 0 { 2 } else { 6 })
                    .map(|h| [2 * h, 2 * h + 1].map(|j| add(Column::Flexible(Basis::Angle(j)), PHASED_SCALE)))
                    .collect();
                flexible.push((name, Group::Phased(pairs)));
            }
        }
    }
    let designs = problem.design(model, &columns);
    let grams = Grams::new(&designs, 0, &scales, Some(keys), divisions.to_vec());
    let misfit = grams.misfit_a_run();
    let grams = grams.with_prior(priors_at(&free, model, misfit));
    Step { base, candidates, flexible, grams }
}

fn distinct(values: impl Iterator<Item = f64>) -> usize {
    let mut v: Vec<f64> = values.collect();
    v.sort_by(f64::total_cmp);
    v.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    v.len()
}

fn group_of(shape: &Shape, columns: Vec<usize>) -> Group {
    if shape.phased {
        Group::Phased(columns.chunks_exact(2).map(|c| [c[0], c[1]]).collect())
    } else {
        Group::Linear(columns)
    }
}

#[allow(clippy::too_many_arguments)]
fn try_candidate(
    problem: &Problem,
    home: &Parameters,
    model: &Model,
    effect: &Effect,
    index: usize,
    step: &Step,
    candidate: usize,
    accepted: &[Accepted],
    base_free: &[Free],
    keys: &[String],
    divisions: &[Fold],
    noise: (f64, f64),
) -> Trial {
    let chosen = &step.candidates[candidate];
    let shape = &effect.shapes[chosen.shape];
    let mut start = model.clone();
    let mut own = Accepted { effect: index, free: Vec::new(), phased: Vec::new() };
    match &chosen.group {
        Group::Linear(columns) => {
            let all: Vec<usize> = (0..problem.runs.len()).collect();
            let set = [step.base.clone(), columns.clone()].concat();
            let beta = step.grams.fit(&all, &set);
            for (q, v) in &shape.pinned {
                start.parameters.set(*q, *v);
            }
            for (k, column) in shape.columns.iter().enumerate() {
                if let Column::Scalar { parameter, scale, .. } = column {
                    let bounds = effect
                        .reported
                        .iter()
                        .find(|r| r.parameter == *parameter)
                        .map_or((f64::NEG_INFINITY, f64::INFINITY), |r| r.bounds);
                    let value = beta[step.base.len() + k].clamp(-3.0, 3.0) * scale;
                    start.parameters.set(*parameter, value.clamp(bounds.0.min(0.0), bounds.1));
                    let scale = if *parameter == P::ClockError { 1e-3 } else { *scale };
                    own.free.push(Free {
                        parameter: *parameter,
                        scale,
                        bounds: (bounds.0.min(0.0), bounds.1),
                        prior: None,
                    });
                }
            }
            for (q, v) in &shape.pinned {
                let integer = *q == P::QuantSteps;
                let free_carry = *q != P::HeatCarry || (problem.ordered() && *v > 0.0);
                if !integer && free_carry {
                    let bounds =
                        effect.reported.iter().find(|r| r.parameter == *q).map_or((0.0, f64::INFINITY), |r| r.bounds);
                    own.free.push(Free { parameter: *q, scale: (0.5 * v).max(1e-3), bounds, prior: None });
                }
            }
        }
        Group::Phased(_) => {
            own.phased = shape
                .columns
                .chunks_exact(2)
                .map(|c| match c[0] {
                    Column::Runout(h) => Phased::Runout(h / 2),
                    Column::Eccentricity(_) => Phased::Eccentricity,
                    _ => Phased::Gravity,
                })
                .collect();
        }
    }
    let mut all = accepted.to_vec();
    all.push(own.clone());
    if own.phased.is_empty() {
        start = best_start(problem, home, model, start, effect, shape, base_free, &all, noise);
    }
    let (fitted, phased_fits) = refit_accepted(problem, &start, base_free, &all);
    let held = held_out_at(problem, &fitted, base_free, &all, keys, divisions, Some(noise));
    let (estimates, estimates_ok) =
        estimate(problem, &fitted, base_free, &all, effect, &own, &phased_fits, keys, divisions);
    Trial { accepted: own, model: fitted, held, estimates, estimates_ok, p_null: 1.0 }
}

/// The linear estimate may lie in another valley than the optimum: a few sizes are tried for two iterations each.
#[allow(clippy::too_many_arguments)]
fn best_start(
    problem: &Problem,
    home: &Parameters,
    model: &Model,
    linear: Model,
    effect: &Effect,
    shape: &Shape,
    base_free: &[Free],
    all: &[Accepted],
    noise: (f64, f64),
) -> Model {
    let Some(Column::Scalar { parameter, scale, .. }) = shape.columns.first() else { return linear };
    let bounds = effect.reported.iter().find(|r| r.parameter == *parameter).map_or((-1.0, 1.0), |r| r.bounds);
    let sense = if bounds.0 < 0.0 { linear.parameters.get(*parameter).signum() } else { 1.0 };
    let mut free = base_free.to_vec();
    free[0].scale = model.parameters.get(P::FreeSpeed);
    for a in all {
        free.extend(a.free.iter().copied());
    }
    let mut best: Option<(f64, Model)> = None;
    let mut starts = vec![linear.clone()];
    for size in [0.3, 1.0] {
        let mut s = linear.clone();
        let sense = if *parameter == P::ClockError { 1.0 } else { sense };
        s.parameters.set(*parameter, (sense * size * scale).clamp(bounds.0.min(0.0), bounds.1));
        starts.push(s);
    }
    // The baseline's refit may have taken part of the effect into its own rates: each start is tried with the motor's as well.
    if !coasts(model) {
        for k in 0..starts.len() {
            let mut s = starts[k].clone();
            for rate in [P::OnAcceleration, P::OffDeceleration, P::Viscous] {
                s.parameters.set(rate, home.get(rate));
            }
            starts.push(s);
        }
    }
    for start in starts {
        let (fitted, _) = refit(problem, start, &free, &[], 4);
        let misfit = super::fit::objective(problem, &fitted, noise.0, noise.1);
        let value = misfit + super::fit::penalty(&free, &fitted, misfit / problem.runs.len() as f64);
        if best.as_ref().is_none_or(|b| value < b.0) {
            best = Some((value, fitted));
        }
    }
    best.map_or(linear, |b| b.1)
}

/// Whether the fitted rotor runs on with the drive off.
fn coasts(model: &Model) -> bool {
    model.parameters.get(P::RingDown) > 0.0 || model.parameters.get(P::OffDeceleration) <= 0.0
}

fn refit_accepted(
    problem: &Problem,
    start: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
) -> (Model, Vec<PhasedFit>) {
    let mut free = base_free.to_vec();
    free[0].scale = start.parameters.get(P::FreeSpeed);
    let mut phased = Vec::new();
    for a in accepted {
        free.extend(a.free.iter().copied());
        phased.extend(a.phased.iter().copied());
    }
    refit(problem, start.clone(), &free, &phased, 8)
}

/// The model with one effect absent.
fn strip(model: &Model, effect: &Accepted) -> Model {
    let mut m = model.clone();
    for f in &effect.free {
        if is_size(f.parameter) {
            m.parameters.set(f.parameter, 0.0);
        }
    }
    let zero = vec![[0.0; 2]; m.terms.len()];
    for p in &effect.phased {
        p.store(&mut m, &zero);
    }
    m
}

fn is_size(p: P) -> bool {
    !matches!(
        p,
        P::HeatTau | P::HeatCarry | P::SettleTau | P::SagTime | P::QuantSteps | P::StribeckSpeed | P::WearRevolutions
    )
}

/// Held-out errors at a fitted model: everything common is refitted without the runs that are scored.
fn held_out_at(
    problem: &Problem,
    model: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
    keys: &[String],
    divisions: &[Fold],
    noise: Option<(f64, f64)>,
) -> HeldOut {
    let (grams, set, pairs) = local(problem, model, base_free, accepted, keys, divisions);
    let grams = match noise {
        Some((v, s)) => grams.with_noise(v, s),
        None => grams,
    };
    let mut held = grams.hold_out(&set, &Group::Linear(Vec::new()));
    if !pairs.is_empty() {
        // Phases were fitted on the very runs that are scored: take off what that is worth by chance.
        let freedom = grams.phased_freedom(&pairs, &amplitudes(model, accepted));
        for (r, f) in freedom.iter().enumerate() {
            held.loss[r][0] += 2.0 * grams.variance * f;
            held.plain[r][0] += 2.0 * grams.variance * f;
        }
    }
    held
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

/// What is free near `model`: the baseline's own parameters and the accepted effects'.
fn free_around(model: &Model, base_free: &[Free], accepted: &[Accepted]) -> Vec<Free> {
    let mut free = base_free.to_vec();
    free[0].scale = model.parameters.get(P::FreeSpeed);
    free.extend(accepted.iter().flat_map(|a| a.free.iter().copied()));
    free
}

/// Normal equations of the accepted model: the set of common columns, and the phased pairs.
fn local(
    problem: &Problem,
    model: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
    keys: &[String],
    divisions: &[Fold],
) -> (Grams, Vec<usize>, Vec<[usize; 2]>) {
    let (designs, scales, set, pairs) = local_designs(problem, model, base_free, accepted);
    let grams = Grams::new(&designs, 0, &scales, Some(keys), divisions.to_vec());
    let misfit = grams.misfit_a_run();
    (grams.with_prior(priors_at(&free_around(model, base_free, accepted), model, misfit)), set, pairs)
}

fn local_designs(
    problem: &Problem,
    model: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
) -> (Vec<RunDesign>, Vec<f64>, Vec<usize>, Vec<[usize; 2]>) {
    let free = free_around(model, base_free, accepted);
    let mut columns = columns_of(&free);
    let set: Vec<usize> = (0..columns.len()).collect();
    let mut scales = vec![1.0; columns.len()];
    let mut pairs = Vec::new();
    for p in accepted.iter().flat_map(|a| &a.phased) {
        let at = columns.len();
        pairs.push([at, at + 1]);
        columns.extend(p.columns());
        scales.extend([PHASED_SCALE; 2]);
    }
    (problem.design(model, &columns), scales, set, pairs)
}

#[allow(clippy::too_many_arguments)]
fn estimate(
    problem: &Problem,
    model: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
    effect: &Effect,
    own: &Accepted,
    phased_fits: &[PhasedFit],
    keys: &[String],
    divisions: &[Fold],
) -> (Vec<Estimate>, bool) {
    let mut out = Vec::new();
    let mut ok = true;
    if own.phased.is_empty() {
        let free = free_around(model, base_free, accepted);
        let columns = [columns_of(&free), discrepancy()].concat();
        let scales = vec![1.0; columns.len()];
        let grams = Grams::new(&problem.design(model, &columns), 0, &scales, Some(keys), divisions.to_vec());
        let mut priors = priors_at(&free, model, grams.misfit_a_run());
        let precision = grams.variance / (DISCREPANCY * DISCREPANCY);
        priors.resize(columns.len(), Prior { precision, pull: 0.0, noise: grams.variance * precision });
        let set: Vec<usize> = (0..free.len()).collect();
        let (beta, cov) = grams.with_prior(priors).fit_all(&(0..columns.len()).collect::<Vec<_>>());
        let first = set.len() - own.free.len();
        let quantile = student_975(problem.runs.len().saturating_sub(set.len().min(problem.runs.len() - 1)).max(1));
        for reported in &effect.reported {
            let value_now = model.parameters.get(reported.parameter);
            let Some(k) = own.free.iter().position(|f| f.parameter == reported.parameter) else {
                if !reported.size && reported.parameter == P::QuantSteps {
                    out.push(Estimate {
                        name: reported.name.to_owned(),
                        value: value_now,
                        interval: [value_now, value_now],
                        unit: reported.unit.to_owned(),
                    });
                }
                continue;
            };
            let scale = own.free[k].scale;
            let value = value_now + beta[first + k].clamp(-0.5, 0.5) * scale;
            let half = quantile * cov[(first + k, first + k)].max(0.0).sqrt() * scale;
            let interval = [value - half, value + half];
            if reported.size {
                let excludes_absent = interval[0] > 0.0 || interval[1] < 0.0;
                let admissible = interval[1] >= reported.bounds.0 && interval[0] <= reported.bounds.1 && {
                    // A size whose sign physics forbids is not admissible.
                    value >= reported.bounds.0 && value <= reported.bounds.1
                };
                ok &= excludes_absent && admissible;
            }
            out.push(Estimate {
                name: reported.name.to_owned(),
                value: value * reported.factor,
                interval: [interval[0] * reported.factor, interval[1] * reported.factor],
                unit: reported.unit.to_owned(),
            });
        }
    } else {
        let skip = phased_fits.len() - own.phased.len();
        let mut any = false;
        for (p, fit) in own.phased.iter().zip(&phased_fits[skip..]) {
            let (name, unit) = match p {
                Phased::Runout(0) => ("once_a_turn", "1"),
                Phased::Runout(_) => ("twice_a_turn", "1"),
                Phased::Eccentricity => ("eccentricity_rad", "rad"),
                Phased::Gravity => ("gravity_torque_over_inertia", "rad/s^2"),
            };
            let half = 1.96 * fit.spread;
            any |= fit.amplitude > half;
            out.push(Estimate {
                name: name.to_owned(),
                value: fit.amplitude,
                interval: [(fit.amplitude - half).max(0.0), fit.amplitude + half],
                unit: unit.to_owned(),
            });
        }
        ok = any;
    }
    (out, ok)
}

/// Estimates of an effect without what the sampling adds to them: the same fit, repeated on data that the fitted model made,
/// shows how far it lies from what made them.
#[allow(clippy::too_many_arguments)]
fn calibrated(
    problem: &Problem,
    fit: &Fitted,
    effects: &[Effect],
    base_free: &[Free],
    keys: &[String],
    divisions: &[Fold],
    gain_spread: f64,
    settings: &Settings,
) -> Vec<Estimate> {
    let effect = &effects[fit.own.effect];
    let all = [fit.others.clone(), vec![fit.own.clone()]].concat();
    let mut estimates = estimate(problem, &fit.model, base_free, &all, effect, &fit.own, &[], keys, divisions).0;
    let mut free = base_free.to_vec();
    free.extend(all.iter().flat_map(|a| a.free.iter().copied()));
    free[0].scale = fit.model.parameters.get(P::FreeSpeed);
    if let Some(bias) = bias(problem, &fit.model, &free, gain_spread, CALIBRATIONS, settings.seed) {
        for e in &mut estimates {
            let Some(reported) = effect.reported.iter().find(|r| r.name == e.name) else { continue };
            let Some(k) = free.iter().rposition(|f| f.parameter == reported.parameter) else { continue };
            let [shift, error] = bias[k].map(|b| b * reported.factor);
            let half = (0.5 * (e.interval[1] - e.interval[0])).hypot(1.96 * error);
            e.value -= shift;
            e.interval = [e.value - half, e.value + half];
        }
    }
    estimates
}

/// Data sets made to see what the sampling does to an estimate.
const CALIBRATIONS: usize = 12;

/// How much of the free speed the rotor equation may miss in each of the first milliseconds after a switching (standard
/// deviation): the wave's build-up of a quarter of a millisecond and the softness of the contact are not in it.
const DISCREPANCY: f64 = 0.1;

fn discrepancy() -> Vec<Column> {
    [true, false]
        .into_iter()
        .flat_map(|rise| (0..3).map(move |k| Column::Flexible(Basis::AfterSwitching(rise, k))))
        .collect()
}

/// 97.5 % quantile of Student's t.
fn student_975(degrees: usize) -> f64 {
    use statrs::distribution::{ContinuousCDF, StudentsT};
    StudentsT::new(0.0, 1.0, degrees as f64).map_or(1.96, |t| t.inverse_cdf(0.975))
}

/// Shares of the baseline's squared error that each effect removes, averaged over the orders of adding them.
fn shapley(
    problem: &Problem,
    model: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
    effects: &[Effect],
    findings: &mut [Finding],
) {
    let n = accepted.len();
    if n == 0 {
        return;
    }
    let everything = vec![Fold { train: (0..problem.runs.len()).collect(), test: (0..problem.runs.len()).collect() }];
    let error: Vec<f64> = (0..1usize << n)
        .map(|subset| {
            let mut m = model.clone();
            for (k, a) in accepted.iter().enumerate() {
                if subset & (1 << k) == 0 {
                    m = strip(&m, a);
                }
            }
            let (m, _) = refit(problem, m, base_free, &[], 2);
            let held = held_out_at(problem, &m, base_free, &[], &[], &everything, None);
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
        if let Some(f) = findings.iter_mut().find(|f| f.name == effects[a.effect].name && f.status != Status::Rejected)
        {
            f.share = share / error[0].max(1e-12);
        }
    }
}

/// What sampling and the spread of the run gains leave, in rpm.
fn noise_floor(problem: &Problem, model: &Model, gain_spread: f64) -> f64 {
    let (mut sum, mut seconds) = (0.0, 0.0);
    for (run, r) in problem.runs.iter().zip(problem.residuals(model)) {
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
fn position_error_deg(problem: &Problem, model: &Model) -> f64 {
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

/// r² of the mean speeds of held-out runs; none below three duties.
fn mean_speed_r2(
    problem: &Problem,
    model: &Model,
    base_free: &[Free],
    accepted: &[Accepted],
    keys: &[String],
    divisions: &[Fold],
) -> Option<f64> {
    if distinct(problem.runs.iter().filter_map(|r| r.duty)) < 3 {
        return None;
    }
    let (designs, scales, set, _) = local_designs(problem, model, base_free, accepted);
    let grams = Grams::new(&designs, 0, &scales, Some(keys), divisions.to_vec());
    let mut errors = vec![0.0; designs.len()];
    for (fold, beta) in grams.fold_fits(&set) {
        for r in fold.test {
            errors[r] = mean_error(&designs[r], &set, &beta);
        }
    }
    let speeds: Vec<f64> = problem.runs.iter().map(|r| r.mean_speed_rpm()).collect();
    let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
    let total: f64 = speeds.iter().map(|s| (s - mean).powi(2)).sum();
    let rest: f64 = errors.iter().map(|e| e * e).sum();
    (total > 0.0).then(|| 1.0 - rest / total)
}

fn mean_error(d: &RunDesign, set: &[usize], beta: &DVector<f64>) -> f64 {
    let mut sum = 0.0;
    for k in 0..d.y.len() {
        let fit: f64 = set.iter().zip(beta.iter()).map(|(c, b)| d.x[k * d.columns + c] * b).sum();
        sum += (d.y[k] - fit) * d.weight[k];
    }
    sum / d.seconds.max(1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(name: &str, status: Status, conflicts: &[&str]) -> Finding {
        Finding {
            name: name.into(),
            status,
            gain: 0.2,
            gain_interval: [0.1, 0.3],
            p_null: 0.002,
            parameters: Vec::new(),
            conflicts: conflicts.iter().map(|c| (*c).to_owned()).collect(),
            next_experiment: String::new(),
            share: 0.0,
            note: String::new(),
        }
    }

    /// Fails if an effect appears twice, or if its former partner stays ambiguous with nobody.
    #[test]
    fn a_rival_that_is_found_on_its_own_is_listed_once() {
        let mut findings = vec![
            finding("dead-zone", Status::Ambiguous, &["direction-asymmetry"]),
            finding("direction-asymmetry", Status::Ambiguous, &["dead-zone"]),
            finding("direction-asymmetry", Status::Named, &[]),
        ];
        settle(&mut findings);
        assert_eq!(
            findings,
            [finding("dead-zone", Status::Named, &[]), finding("direction-asymmetry", Status::Named, &[])]
        );
    }
}
