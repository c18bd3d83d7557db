//! Runs of a TWUM, one or many, open or closed loop: lost time put back, the baseline refitted, sets weighed.

use super::baseline::refit_baseline;
use super::conclusion::{Outcome, Settings, conclude};
use super::evidence::independent;
use super::gaps::{self, Gaps};
use super::ground::Ground;
use super::held_out::Scorer;
use super::library::{Effect, library, not_judged};
use super::problem::{Model, Problem};
use super::pwm_line::clock_errors;
use super::refit::{Noise, objective};
use super::rotor::{P, Parameters};

/// Diagnoses runs, starting from the motor file's rotor.
pub fn diagnose_runs(
    problem: &Problem,
    home: &Parameters,
    settings: &Settings,
    progress: &dyn Fn(&str, f64),
) -> Outcome {
    let effects: Vec<Effect> = library(home.get(P::OnAcceleration), &clock_errors(problem), problem.mine.as_deref())
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
        let held = Scorer::new(&before, &root, settings.seed).held_out(&root);
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
