//! Runs of a TWUM, one or many, open or closed loop: lost time put back, the baseline refitted, sets weighed.

use super::baseline::{baseline_free, first_covariance, refit_baseline};
use super::conclusion::{Outcome, Settings, conclude};
use super::evidence::independent;
use super::free::Free;
use super::gaps::{self, Beside, Gaps};
use super::ground::Ground;
use super::held_out::Scorer;
use super::library::{Effect, library, not_judged};
use super::prior::Prior;
use super::problem::{Model, Problem};
use super::pwm_line::{LARGEST as LARGEST_CLOCK_ERROR, clock_errors};
use super::refit::{refit, squared_error};
use super::rotor::{P, Parameters};

/// Diagnoses runs, starting from the motor file's rotor.
pub fn diagnose_runs(
    problem: &Problem,
    home: &Parameters,
    settings: &Settings,
    progress: &dyn Fn(&str, f64),
) -> Outcome {
    let effects: Vec<Effect> = library(&clock_errors(problem), &problem.formulas)
        .into_iter()
        .filter(|e| !settings.without.iter().any(|w| *w == e.name))
        .collect();
    let (usable, refused) = judged(&effects, problem);
    progress("refitting the baseline", 0.02);
    let original = problem.clone().widened();
    let counted = |p: &Problem| {
        let rows: usize = p.runs.iter().map(|r| r.windows.len()).sum();
        independent(rows as f64, p.runs.len())
    };
    let unrepaired = refit_baseline(&original, home, counted(&original));
    progress("looking for lost samples", 0.06);
    let mut moved = shifted(problem, &problem.model(unrepaired.parameters.clone()), home, Beside::Unknown, settings);
    let compare = |moved: &Option<Shifted>| match moved {
        Some(Shifted::Lost(gaps)) => {
            let repaired = gaps.problem.clone().widened();
            let baseline = refit_baseline(&repaired, home, counted(&repaired));
            (repaired, baseline)
        }
        _ => (original.clone(), unrepaired.clone()),
    };
    let searched = |compared: &Problem, baseline: Model, moved: &Option<Shifted>| {
        let clock = if let Some(Shifted::Clock(model)) = moved { Some(model.as_ref()) } else { None };
        let mut ground = Ground::new(compared, home.clone(), &effects, usable.clone());
        let sets = ground.search(baseline, clock, progress);
        (sets, ground.terms)
    };
    let (mut compared, baseline) = compare(&moved);
    let (mut sets, mut terms) = searched(&compared, baseline, &moved);
    // Behind another effect's error they may not have shown, be it one that is not certain; or that error looked like them.
    let found = sets.iter().find(|s| !s.parts.is_empty()).map(|s| &s.model);
    let clock = sets[0].parts.iter().any(|p| p.changes(P::ClockError));
    let of_clock = |e: &usize| {
        let mut sizes = effects[*e].forms.iter().flat_map(|f| &f.sizes);
        sizes.any(|s| s.parameter == P::ClockError)
    };
    let again = match (&moved, found) {
        (Some(Shifted::Lost(gaps)), _) if sets[0].parts.is_empty() => (!gaps.stand_alone()).then_some(None),
        (_, None) => None,
        (Some(Shifted::Lost(before)), Some(found)) => {
            let again = lost(problem, found, Beside::Found, settings);
            let same = again.as_ref().is_some_and(|again| again.lost == before.lost);
            (!same).then(|| again.map(Shifted::Lost))
        }
        (None, Some(found)) if !clock => shifted(problem, found, home, Beside::Found, settings).map(Some),
        (Some(Shifted::Clock(_)), _) if !clock && !usable.iter().any(of_clock) => None,
        // Beside a clock that is known to be wrong, no clock does as well; and one that did, and is not in the best set, was none.
        (_, Some(found)) => lost(problem, found, Beside::Found, settings).map(|gaps| Some(Shifted::Lost(gaps))),
    };
    if let Some(again) = again {
        moved = again;
        let baseline;
        (compared, baseline) = compare(&moved);
        (sets, terms) = searched(&compared, baseline, &moved);
    }
    progress("measuring what was found", 0.85);
    let ground = Ground { terms, ..Ground::new(&compared, home.clone(), &effects, usable) };
    let mut outcome = conclude(&ground, &sets, settings);
    if let Some(Shifted::Lost(gaps)) = moved {
        let before = Ground::new(&original, home.clone(), &effects, Vec::new());
        let root = before.root(unrepaired);
        let held = Scorer::new(&before, &root, settings.seed).held_out(&root);
        outcome.held_out = held.against(&outcome.held_out);
        outcome.findings.insert(0, gaps.finding);
    }
    outcome.not_judged = refused;
    outcome
}

/// Indices of the effects that the runs can show; the others with the reason.
fn judged(effects: &[Effect], problem: &Problem) -> (Vec<usize>, Vec<(String, String)>) {
    let mut refused = vec![(
        "presliding".to_owned(),
        "an elastic return is smaller than the encoder's pitch; a finer encoder would show it".to_owned(),
    )];
    let mut usable = Vec::new();
    for (i, effect) in effects.iter().enumerate() {
        match not_judged(effect, problem) {
            Some(reason) => refused.push((effect.name.to_string(), reason)),
            None => usable.push(i),
        }
    }
    (usable, refused)
}

/// What moves the record against the drive.
enum Shifted {
    /// Words of samples are lost.
    Lost(Box<Gaps>),
    /// The clock is wrong, in a motor that is refitted beside it.
    Clock(Box<Model>),
}

/// Lost words of samples beside a model, or a wrong clock that does as well.
fn shifted(
    problem: &Problem,
    model: &Model,
    home: &Parameters,
    beside: Beside,
    settings: &Settings,
) -> Option<Shifted> {
    let gaps = lost(problem, model, beside, settings)?;
    let clock = clock_instead(problem, model, home, &gaps).map(Box::new);
    Some(clock.map_or(Shifted::Lost(gaps), Shifted::Clock))
}

/// Lost words of samples beside a model.
fn lost(problem: &Problem, model: &Model, beside: Beside, settings: &Settings) -> Option<Box<Gaps>> {
    let asked = !settings.without.iter().any(|w| w == "dropped-samples");
    asked.then(|| gaps::find(problem, model, beside, settings.seed)).flatten().map(Box::new)
}

/// Steps in which a clock is fitted together with the motor: it begins within a line's width of where it ends.
const CLOCK_STEPS: usize = 6;

/// A wrong clock that does as well as lost samples: both move the PWM line. The motor is refitted beside either, because what it was fitted
/// to had the error in it.
fn clock_instead(problem: &Problem, baseline: &Model, home: &Parameters, gaps: &Gaps) -> Option<Model> {
    let rows: usize = problem.runs.iter().map(|r| r.windows.len()).sum();
    let refitted = |of: &Problem, home: &Parameters| refit_baseline(of, home, rows as f64);
    let with_gaps = squared_error(&gaps.problem, &refitted(&gaps.problem, home));
    let beside = |error: f64| {
        let model = refitted(problem, &home.with(P::ClockError, error));
        let mut free = baseline_free(&model.parameters, home, false);
        let bounds = (-LARGEST_CLOCK_ERROR, LARGEST_CLOCK_ERROR);
        free.retain(|own| own.parameter != P::ClockError);
        free.push(Free { parameter: P::ClockError, scale: 1e-3, bounds, prior: Prior::Flat });
        let covariance = first_covariance(problem, &model, rows as f64);
        refit(problem, model, &free, &[], &covariance, CLOCK_STEPS)
    };
    // Near nothing the line may not part from its place.
    let at = |error: f64| {
        let mut m = baseline.clone();
        m.parameters.set(P::ClockError, error);
        (squared_error(problem, &m), error)
    };
    let near = (-30..=30).filter(|k| *k != 0).map(|k| at(4e-4 * f64::from(k)));
    let nearest = near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|n| n.1);
    let clocks = clock_errors(problem).into_iter().chain(nearest).map(beside);
    let (misfit, clock) =
        clocks.map(|model| (squared_error(problem, &model), model)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    // Of another error that neither touches, a twentieth may be more than all that the gaps take.
    let taken = (squared_error(problem, baseline) - with_gaps).max(0.0);
    (misfit - with_gaps < 0.05 * with_gaps.min(taken)).then_some(clock)
}
