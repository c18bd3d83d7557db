//! The procedure: refit, search, test, compare, remove, say what is left.

use super::baseline::{baseline_free, coasts, rated, refit_baseline};
use super::case::{Accepted, Case, strip};
use super::effects::{Effect, could_pose, library, not_judged};
use super::estimate::Fitted;
use super::finding::{Finding, Status, Unknown};
use super::fit::{misfits, objective};
use super::gaps::{self, Gaps};
use super::problem::{Model, Problem};
use super::rotor::{P, Parameters};
use super::stats::{Fold, Group, HeldOut, folds, p_value};
use super::trial::Trial;

/// Smallest held-out gain of a named cause.
pub const LEAST_GAIN: f64 = 0.05;
/// What the rotor equation itself may miss, as a share of the speed: less than this is no effect, however certain it is. The averaged
/// motor model behind the simulated board, timed to a microsecond, leaves 0.1 to 0.2 %.
pub const EQUATION_ERROR: f64 = 0.005;
/// Largest p-value of a named cause.
pub const LARGEST_P: f64 = 0.01;
/// Share of the squared error a cause removes that a term without physics may still find before the cause is no longer believed:
/// real effects do not have the library's forms, and a strong one leaves the difference in sight.
pub const LACK_OF_FIT: f64 = 0.12;
/// A rival that the library lists as a conflict and that gains this share of the winner's gain stays in the set, however
/// narrow the interval of the difference: real effects do not have the library's forms, and the nearer form need not be the
/// cause.
const SAME_FOR_A_CONFLICT: f64 = 0.85;
/// Least squared error that a later effect has to remove, as a share of what those before it removed: less is within the difference
/// between their real form and the library's.
const LATER: f64 = 0.1;
/// The same beside an effect that it looks like.
const LATER_BESIDE_A_CONFLICT: f64 = 0.25;
/// Share of the best candidate's improvement that one has to reach to stand for it, where the best cannot be the cause.
const NEARLY_AS_MUCH: f64 = 0.6;
/// Share of what the baseline leaves that may stay beside a named cause (beyond the sampling), or another friction.
const MOST_LEFT_BESIDE: f64 = 0.5;
/// How much more squared error than the sampling leaves may stay whatever is to blame: the reduced rotor equation itself leaves up
/// to 1.3 times as much.
const LARGEST_MISFIT: f64 = 1.6;
/// Where something lives that no term without physics catches.
pub const NOWHERE: &str = "no one place";
/// Data sets made to see what the sampling leaves.
const MADE: usize = 8;
/// Most effects that are added.
const MOST_EFFECTS: usize = 4;
/// What else than the motor file's friction is tried, once the effects are found: a file may be of another motor, or another preload.
const OTHER_FRICTIONS: [f64; 4] = [0.1, 0.316, 3.16, 10.0];
/// What another friction has to save, in misfits of a mean run, before the search is repeated from there.
const CLEARLY_BETTER: f64 = 1.0;
/// What another friction may cost and still be possible, in misfits of a mean run.
const AS_GOOD: f64 = 2.0;

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
    /// Where nothing was found: a factor on the motor file's friction that leaves much less, and the error that is left then as a share
    /// of the present one.
    pub better_friction: Option<(f64, f64)>,
}

/// What a search has found so far.
struct Found {
    /// Model with all accepted effects.
    model: Model,
    accepted: Vec<Accepted>,
    /// Names of those that were taken out again.
    removed: Vec<String>,
    /// Members of the answers, for their numbers.
    fits: Vec<Fitted>,
    findings: Vec<Finding>,
    /// Every effect on its own beside the baseline.
    alone: Vec<Finding>,
    /// Share of the baseline's squared error that is left.
    left: f64,
    /// Variance of a weighted residual and spread of the run gains.
    noise: (f64, f64),
}

/// Searches for what `start` gets wrong on `problem`.
///
/// If, with the effects found, quite another friction than the motor file's leaves less, the search is repeated from there.
pub fn search(problem: &Problem, start: &Parameters, settings: &Settings, progress: &dyn Fn(&str, f64)) -> Outcome {
    let ground = Ground::new(problem, start.clone(), settings, progress);
    let found = find(&ground, settings, progress);
    let (possible, better) = other_frictions(&ground.case(settings), &found);
    if let Some(factor) = better {
        let elsewhere = Ground::new(problem, rated(start, factor), settings, progress);
        let there = find(&elsewhere, settings, progress);
        let (variance, spread) = found.noise;
        let [here_left, there_left] =
            [(&ground, &found), (&elsewhere, &there)].map(|(g, f)| objective(&g.problem, &f.model, variance, spread));
        if there_left < here_left {
            let (possible, _) = other_frictions(&elsewhere.case(settings), &there);
            return conclude(&elsewhere, there, &possible, settings, progress);
        }
    }
    conclude(&ground, found, &possible, settings, progress)
}

/// Where a search stands: the runs, the baseline, and what may be looked for.
struct Ground {
    /// The runs as they came, compared in stretches.
    original: Problem,
    /// The baseline of those.
    unrepaired: Model,
    /// The runs with lost time put back.
    problem: Problem,
    /// The baseline.
    baseline: Model,
    /// The lost time.
    lost: Option<Finding>,
    home: Parameters,
    effects: Vec<Effect>,
    /// Indices of the effects that these runs can show.
    usable: Vec<usize>,
    /// The others, with the reason.
    refused: Vec<(String, String)>,
    keys: Vec<String>,
    divisions: Vec<Fold>,
}

impl Ground {
    fn new(problem: &Problem, home: Parameters, settings: &Settings, progress: &dyn Fn(&str, f64)) -> Self {
        let effects: Vec<Effect> = library(home.get(P::OnAcceleration))
            .into_iter()
            .filter(|e| !settings.without.iter().any(|w| w == e.name))
            .collect();
        let mut refused = vec![(
            "presliding".to_owned(),
            "an elastic return is smaller than the encoder's pitch; a finer encoder would show it".to_owned(),
        )];
        let mut usable = Vec::new();
        for (i, effect) in effects.iter().enumerate() {
            match not_judged(effect.name, problem, settings.coasting) {
                Some(reason) => refused.push((effect.name.to_owned(), reason)),
                None => usable.push(i),
            }
        }
        let keys: Vec<String> = problem
            .runs
            .iter()
            .map(|r| format!("{:?}/{:.6}/{}/{}", r.kind, r.duty.unwrap_or(-1.0), r.direction, r.pwm_hz))
            .collect();
        let divisions = folds(&keys, if problem.runs.len() < 8 { problem.runs.len() } else { 5 }, settings.seed);
        progress("looking for lost samples", 0.02);
        let gaps = lost_samples(problem, &home, settings);
        progress("refitting the baseline", 0.06);
        let original = problem.clone().widened();
        let unrepaired = refit_baseline(&original, &home, settings.coasting);
        let (problem, baseline, lost) = match gaps {
            Some(gaps) => {
                let repaired = gaps.problem.widened();
                let baseline = refit_baseline(&repaired, &home, settings.coasting);
                (repaired, baseline, Some(gaps.finding))
            }
            None => (original.clone(), unrepaired.clone(), None),
        };
        Self { original, unrepaired, problem, baseline, lost, home, effects, usable, refused, keys, divisions }
    }

    fn case(&self, settings: &Settings) -> Case<'_> {
        Case {
            problem: &self.problem,
            base_free: baseline_free(&self.baseline.parameters, &self.home, settings.coasting),
            home: self.home.clone(),
            effects: &self.effects,
            keys: &self.keys,
            divisions: &self.divisions,
            seed: settings.seed,
        }
    }
}

/// The effects that pass every test.
fn find(ground: &Ground, settings: &Settings, progress: &dyn Fn(&str, f64)) -> Found {
    let case = ground.case(settings);
    let mut found = add(&case, ground, settings, progress);
    progress("checking what can be left out", 0.8);
    leave_out(&case, &mut found);
    settle(&mut found.findings);
    doubt(&mut found.findings, &ground.effects, &ground.refused);
    progress("holding other frictions against the motor file's", 0.85);
    found
}

/// Numbers, left-overs and scores of what was found.
fn conclude(
    ground: &Ground,
    mut found: Found,
    possible: &[f64],
    settings: &Settings,
    progress: &dyn Fn(&str, f64),
) -> Outcome {
    let case = ground.case(settings);
    progress("measuring what the sampling does to the numbers", 0.87);
    measure(&case, &mut found, possible);
    progress("looking for what no candidate explains", 0.9);
    let unknown = unexplained(&case, &ground.baseline, &found, settings);
    let Found { model, accepted, mut findings, alone, noise, removed, .. } = found;
    let before = Case { problem: &ground.original, ..case.clone() }.held_out(&ground.unrepaired, &[], Some(noise));
    let held_out = before.against(&case.held_out(&model, &accepted, Some(noise)));
    case.share_out(&model, &accepted, &mut findings);
    let lost = accepted.is_empty() && !unknown.is_empty();
    let better_friction = if lost { better_friction(ground, noise, settings) } else { None };
    for f in alone {
        if !findings.iter().any(|g| g.name == f.name) {
            findings.push(f);
        }
    }
    Outcome {
        // What is left bounds the floor from above.
        noise_floor: case.noise_floor(&model, noise.1).min(held_out.rmse(1)),
        r2: [case.mean_speed_r2(&ground.baseline, &[]), case.mean_speed_r2(&model, &accepted)],
        position_deg: [case.position_error_deg(&ground.baseline), case.position_error_deg(&model)],
        problem: ground.problem.clone(),
        baseline: ground.baseline.clone(),
        extended: model,
        held_out,
        findings,
        unknown,
        not_judged: ground.refused.clone(),
        removed,
        better_friction,
    }
}

/// Where nothing is found and something is left: the factor on the file's friction with which the baseline leaves less than half, and how
/// large its error then is beside the present one.
fn better_friction(ground: &Ground, noise: (f64, f64), settings: &Settings) -> Option<(f64, f64)> {
    let error = |m: &Model| objective(&ground.problem, m, noise.0, noise.1);
    let here = error(&ground.baseline);
    let there = |factor: f64| {
        let model = refit_baseline(&ground.problem, &rated(&ground.home, factor), settings.coasting);
        (factor, error(&model) / here.max(1e-12))
    };
    let best = OTHER_FRICTIONS.map(there).into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    (best.1 < MOST_LEFT_BESIDE).then(|| (best.0, best.1.sqrt()))
}

/// Lost words of samples, unless a wrong clock does as well.
fn lost_samples(problem: &Problem, start: &Parameters, settings: &Settings) -> Option<Gaps> {
    if settings.without.iter().any(|w| w == "dropped-samples") {
        return None;
    }
    let baseline = refit_baseline(problem, start, settings.coasting);
    gaps::find(problem, &baseline, settings.seed).filter(|g| !clock_explains(problem, &baseline, g))
}

/// Adds one effect after the other, as long as each passes every test.
fn add(case: &Case, ground: &Ground, settings: &Settings, progress: &dyn Fn(&str, f64)) -> Found {
    let usable = &ground.usable;
    let mut found = Found {
        model: ground.baseline.clone(),
        accepted: Vec::new(),
        removed: Vec::new(),
        fits: Vec::new(),
        findings: ground.lost.iter().cloned().collect(),
        alone: Vec::new(),
        left: 1.0,
        noise: (1.0, 0.01),
    };
    for round in 0..=MOST_EFFECTS {
        progress("searching the library", 0.1 + 0.15 * round as f64);
        let step = case.step(&found.model, &found.accepted, usable);
        let grams = &step.around.grams;
        found.noise = (grams.variance, grams.gain_spread);
        if step.candidates.is_empty() || round == MOST_EFFECTS {
            break;
        }
        let groups: Vec<Group> = step.candidates.iter().map(|c| c.group.clone()).collect();
        let seed = settings.seed + 1000 * round as u64;
        let (improvements, null) = grams.screen(&step.around.base, &groups, settings.repetitions, seed);
        // The best shape of each effect, the best effect first.
        let mut best: Vec<usize> = usable
            .iter()
            .filter_map(|effect| {
                let shapes = (0..step.candidates.len()).filter(|c| step.candidates[*c].effect == *effect);
                shapes.max_by(|a, b| improvements[*a].total_cmp(&improvements[*b]))
            })
            .collect();
        best.sort_by(|a, b| improvements[*b].total_cmp(&improvements[*a]));
        let p_of = |c: usize| p_value(improvements[c], &null);
        if round == 0 {
            let evidence = |c: &usize| {
                let candidate = &step.candidates[*c];
                let held = grams.hold_out(&step.around.base, &candidate.group);
                let effect = &case.effects[candidate.effect];
                Finding { p_null: p_of(*c), ..finding(effect, &held, Status::Rejected, settings.seed) }
            };
            found.alone = best.iter().map(evidence).collect();
        }
        best.retain(|c| improvements[*c] > 0.0 && p_of(*c) <= LARGEST_P);
        best.truncate(settings.refitted);
        if best.is_empty() {
            break;
        }
        progress("refitting the best candidates", 0.15 + 0.15 * round as f64);
        let before = grams.hold_out(&step.around.base, &Group::Linear(Vec::new()));
        let mut trials: Vec<Trial> = best
            .iter()
            .map(|c| {
                let trial = case.trial(&step, &step.candidates[*c], &found.model, &found.accepted);
                Trial { held: before.against(&trial.held), p_null: p_of(*c), ..trial }
            })
            .collect();
        trials.sort_by(|a, b| b.held.improvement().total_cmp(&a.held.improvement()));
        let Some(stands) = standing(case, &trials, &mut found) else { break };
        trials.swap(0, stands);
        accept(case, &trials, &mut found);
    }
    found
}

/// The trial that may be a cause, if any, and in `found.alone` why others may not. Where the best is refused, one that explains nearly as
/// much may stand for it; where none does, the library has no answer.
fn standing(case: &Case, trials: &[Trial], found: &mut Found) -> Option<usize> {
    let effect = |a: &Accepted| &case.effects[a.effect];
    let mut stands = None;
    for (k, trial) in trials.iter().enumerate() {
        let beside = found.accepted.iter().any(|a| conflict(effect(a), effect(&trial.accepted)));
        let reason = refusal(trial, found.left, beside, EQUATION_ERROR * case.problem.rms_speed_rpm(), case.seed);
        if reason.is_none() && trial.held.improvement() >= NEARLY_AS_MUCH * trials[0].held.improvement() {
            stands = stands.or(Some(k));
        }
        if let (Some(reason), Some(f)) =
            (reason, found.alone.iter_mut().find(|f| f.name == effect(&trial.accepted).name))
        {
            f.note = reason;
        }
    }
    stands
}

/// Takes the first of `trials` into the model, and it with its rivals into the answer.
fn accept(case: &Case, trials: &[Trial], found: &mut Found) {
    let winner = &trials[0];
    let effect = |t: &Trial| &case.effects[t.accepted.effect];
    let rival = |t: &&Trial| {
        let listed = conflict(effect(winner), effect(t));
        t.held.gain() >= 0.5 * winner.held.gain()
            && t.estimates_ok
            && (winner.held.lead_interval(&t.held, case.seed)[0] <= 0.0
                || (listed && t.held.gain() >= SAME_FOR_A_CONFLICT * winner.held.gain()))
    };
    let set: Vec<&Trial> = std::iter::once(winner).chain(trials[1..].iter().filter(rival)).collect();
    for t in &set {
        let status = if set.len() == 1 { Status::Named } else { Status::Ambiguous };
        let others = set.iter().map(|o| effect(o).name).filter(|name| *name != effect(t).name);
        found.findings.push(Finding {
            p_null: t.p_null,
            parameters: t.estimates.clone(),
            conflicts: others.map(str::to_owned).collect(),
            ..finding(effect(t), &t.held, status, case.seed)
        });
    }
    found.fits.extend(set.iter().filter(|t| t.accepted.phased.is_empty()).map(|t| Fitted {
        own: t.accepted.clone(),
        others: found.accepted.clone(),
        model: t.model.clone(),
    }));
    found.left *= (1.0 - winner.held.gain()).powi(2);
    found.model = winner.model.clone();
    found.accepted.push(winner.accepted.clone());
}

fn finding(effect: &Effect, held: &HeldOut, status: Status, seed: u64) -> Finding {
    Finding {
        name: effect.name.to_owned(),
        status,
        gain: held.gain(),
        gain_interval: held.gain_interval(seed),
        p_null: 1.0,
        parameters: Vec::new(),
        conflicts: Vec::new(),
        next_experiment: effect.next_experiment.to_owned(),
        share: 0.0,
        note: String::new(),
    }
}

/// Takes out again what is no longer needed.
fn leave_out(case: &Case, found: &mut Found) {
    let mut k = 0;
    while k < found.accepted.len() && found.accepted.len() > 1 {
        let mut without = found.accepted.clone();
        let candidate = without.remove(k);
        let smaller = case.refit(&strip(&found.model, &candidate), &without).0;
        let full = case.held_out(&found.model, &found.accepted, Some(found.noise));
        let less = case.held_out(&smaller, &without, Some(found.noise));
        if needed(&full, &less, case.seed) {
            k += 1;
            continue;
        }
        let name = case.effects[candidate.effect].name;
        found.removed.push(name.to_owned());
        if let Some(f) = found.findings.iter_mut().find(|f| f.name == name) {
            f.status = Status::Rejected;
            f.note = "not needed beside the others".to_owned();
        }
        found.model = smaller;
        found.accepted = without;
    }
}

/// A cause that looks like one these runs cannot judge is not named alone.
fn doubt(findings: &mut [Finding], effects: &[Effect], refused: &[(String, String)]) {
    for f in findings.iter_mut().filter(|f| f.status == Status::Named) {
        let Some(own) = effects.iter().find(|e| e.name == f.name) else { continue };
        let posing = |(name, _): &&(String, String)| {
            could_pose(name) && effects.iter().any(|e| e.name == name && conflict(own, e))
        };
        for (name, reason) in refused.iter().filter(posing) {
            f.status = Status::Ambiguous;
            f.conflicts.push(name.clone());
            f.note = format!("{name} looks like it and cannot be judged from these runs: {reason}");
        }
    }
}

/// Factors on the motor file's friction that explain the runs as well beside the effects found, and the one that explains them so
/// much better that the search belongs there.
fn other_frictions(case: &Case, found: &Found) -> (Vec<f64>, Option<f64>) {
    // Phases of their own in every run follow any friction: beside them the data say nothing of it.
    let phased = found.accepted.iter().any(|a| !a.phased.is_empty());
    if found.accepted.is_empty() || phased || coasts(&found.model) {
        return (Vec::new(), None);
    }
    let (variance, spread) = found.noise;
    let error = |m: &Model| objective(case.problem, m, variance, spread);
    let here = error(&found.model);
    let a_run = here / case.problem.runs.len() as f64;
    let costs = OTHER_FRICTIONS.map(|factor| {
        let other = case.believing(factor);
        (factor, error(&other.refit(&other.at_home(&found.model), &found.accepted).0))
    });
    let (factor, least) = costs.into_iter().fold((1.0, here), |a, b| if b.1 < a.1 { b } else { a });
    let possible = costs.iter().filter(|c| c.1 <= least + AS_GOOD * a_run).map(|c| c.0).collect();
    (possible, (least < here - CLEARLY_BETTER * a_run).then_some(factor))
}

/// Puts the numbers into the findings: in the final model, without what the sampling adds to them.
fn measure(case: &Case, found: &mut Found, possible: &[f64]) {
    for fit in &mut found.fits {
        let name = case.effects[fit.own.effect].name;
        let Some(finding) = found.findings.iter_mut().find(|f| f.name == name && f.status != Status::Rejected) else {
            continue;
        };
        if found.accepted.iter().any(|a| a.effect == fit.own.effect) {
            // What was accepted later has moved it.
            fit.model = found.model.clone();
            fit.others = found.accepted.iter().filter(|a| a.effect != fit.own.effect).cloned().collect();
        }
        finding.parameters = case.numbers(fit, found.noise.1, possible);
    }
}

/// What terms without physics still find beside the model, the strongest first.
fn unexplained(case: &Case, baseline: &Model, found: &Found, settings: &Settings) -> Vec<Unknown> {
    let flexible = case.flexible(&found.model, &found.accepted);
    let (base, grams) = (&flexible.around.base, &flexible.around.grams);
    let groups: Vec<Group> = flexible.terms.iter().map(|f| f.1.clone()).collect();
    let (improvements, null) = grams.screen(base, &groups, settings.repetitions, settings.seed + 77_777);
    let mut unknown: Vec<Unknown> = flexible
        .terms
        .iter()
        .zip(improvements)
        .map(|((lives_in, group), improvement)| (lives_in, group, improvement, p_value(improvement, &null)))
        .filter(|(.., improvement, p)| *improvement > 0.0 && *p <= LARGEST_P)
        .map(|(lives_in, group, _, p_null)| (lives_in, grams.hold_out(base, group), p_null))
        .filter(|(_, held, _)| held.removed_rpm() > EQUATION_ERROR * case.problem.rms_speed_rpm())
        .map(|(lives_in, held, p_null)| Unknown { lives_in, gain: held.gain(), p_null })
        .collect();
    unknown.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    // Where no cause is found and no term without physics catches it, or where the cause leaves most of it, the sampling still says how
    // much too much is left.
    let models = [baseline, &found.model];
    let sampled = misfits(case.problem, models, grams.variance, grams.gain_spread, MADE, settings.seed);
    let left = sampled.or_else(|| case.misfits_of_exact_times(models, grams.gain_spread));
    let Some([before, after]) = left else { return unknown };
    let most_is_left = found.accepted.is_empty() || after - 1.0 > MOST_LEFT_BESIDE * (before - 1.0);
    if after > LARGEST_MISFIT && most_is_left {
        let gain = 1.0 - (1.0 / after).sqrt();
        unknown.push(Unknown { lives_in: NOWHERE, gain, p_null: 1.0 / (1 + MADE) as f64 });
    }
    unknown
}

/// Why a candidate that is significant cannot be the cause. `left` is the share of the baseline's squared error that the effects found
/// so far leave; `beside_a_conflict` says that one of them looks like the candidate; `least_rpm` is what the rotor equation itself may miss.
fn refusal(trial: &Trial, left: f64, beside_a_conflict: bool, least_rpm: f64, seed: u64) -> Option<String> {
    let gain = trial.held.gain();
    if !trial.estimates_ok {
        return Some("its size is not distinguishable from absent, or not admissible".to_owned());
    }
    if gain < LEAST_GAIN || trial.held.gain_interval(seed)[0] <= 0.0 {
        return Some(format!(
            "significant, but its gain of {:.1} % is below {:.0} % or not certain",
            100.0 * gain,
            100.0 * LEAST_GAIN
        ));
    }
    let removed_rpm = trial.held.removed_rpm();
    if removed_rpm < least_rpm {
        return Some(format!(
            "removes {removed_rpm:.3} rpm, and the reduced motor model itself may be wrong by {least_rpm:.3} rpm ({} % of the speed)",
            100.0 * EQUATION_ERROR
        ));
    }
    let more = left * (1.0 - (1.0 - gain).powi(2));
    let least = if beside_a_conflict { LATER_BESIDE_A_CONFLICT } else { LATER };
    (more < least * (1.0 - left)).then(|| {
        format!(
            "removes {:.1} % of what was removed before it: too little to tell from the difference between the real form of that and the \
             library's",
            100.0 * more / (1.0 - left)
        )
    })
}

/// Whether a wrong clock does as well as lost samples: both move the PWM line.
fn clock_explains(problem: &Problem, baseline: &Model, gaps: &Gaps) -> bool {
    let square = |p: &Problem, m: &Model| objective(p, m, 1.0, 0.0);
    let with_gaps = square(&gaps.problem, baseline);
    (-30..=30).filter(|k| *k != 0).any(|k| {
        let mut m = baseline.clone();
        m.parameters.set(P::ClockError, 4e-4 * f64::from(k));
        square(problem, &m) < 1.05 * with_gaps
    })
}

/// Whether the fuller model does better on runs it was not fitted to: with the gain of each run free, or with it as it is.
fn needed(full: &HeldOut, less: &HeldOut, seed: u64) -> bool {
    full.lead_interval(less, seed)[0] > 0.0 || less.against(full).gain_interval(seed)[0] > 0.0
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

    /// Fails if a cause is named alone although one that looks like it could not be judged, or not named because of one that does not act
    /// in such runs.
    #[test]
    fn what_cannot_be_judged_may_pose_as_a_cause() {
        let refused =
            [("dead-zone".to_owned(), "needs three duties".to_owned()), ("gravity-load".to_owned(), String::new())];
        let mut findings =
            vec![finding("start-delay", Status::Named, &[]), finding("direction-asymmetry", Status::Named, &[])];
        doubt(&mut findings, &library(1888.0), &refused);
        assert_eq!(
            (findings[0].status, &findings[0].conflicts[..]),
            (Status::Ambiguous, &["dead-zone".to_owned()][..])
        );
        assert!(findings[0].note.contains("needs three duties"), "{}", findings[0].note);
        assert_eq!(findings[1].status, Status::Named);
    }

    fn trial(gain: f64) -> Trial {
        // Twenty runs that all gain alike.
        let pair = [1.0, (1.0 - gain).powi(2)];
        Trial {
            accepted: Accepted { effect: 0, free: Vec::new(), phased: Vec::new() },
            model: Model { parameters: Parameters::new(3.6, 1888.0, 1888.0, 0.26, 0.02), terms: Vec::new() },
            held: HeldOut { loss: vec![pair; 20], plain: vec![pair; 20], seconds: vec![1.0; 20] },
            estimates: Vec::new(),
            estimates_ok: true,
            p_null: 0.002,
        }
    }

    /// Fails if an effect is named that only mends the form of the one before it.
    #[test]
    fn a_later_effect_has_to_remove_more_than_a_difference_of_forms() {
        // The first removed 80 %: a gain of 9 % of the rest is 4 % of that, one of 40 % is 16 %.
        assert!(refusal(&trial(0.09), 1.0, false, 0.1, 1).is_none());
        assert!(refusal(&trial(0.09), 0.2, false, 0.1, 1).is_some_and(|r| r.contains("4.3 %")));
        assert!(refusal(&trial(0.4), 0.2, false, 0.1, 1).is_none());
        assert!(refusal(&trial(0.4), 0.2, true, 0.1, 1).is_some());
        assert!(refusal(&trial(0.04), 1.0, false, 0.1, 1).is_some());
    }

    /// Fails if something gets a name that is smaller than the rotor equation's own error: timed to a microsecond, everything is certain.
    #[test]
    fn less_than_the_equation_may_miss_is_no_effect() {
        // A gain of 40 % on 1 rpm removes 0.8 rpm.
        assert!(refusal(&trial(0.4), 1.0, false, 0.7, 1).is_none());
        assert!(refusal(&trial(0.4), 1.0, false, 0.9, 1).is_some_and(|r| r.contains("0.800 rpm")));
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
