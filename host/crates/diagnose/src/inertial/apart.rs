//! Runs that are not of one motor: each is judged on its own.

use super::conclude::InertialOutcome;
use super::data::Data;
use super::fit::{Plant, misfit, refit};
use super::held_out::squared_error;
use super::sets::{GAIN_SPREAD, Ground, Set};
use super::values::P;
use crate::finding::{Finding, Status};
use crate::stats::HeldOut;
use twum_fit::noise::Noise;

/// Share of the squared error that is left when every run has numbers of its own, below which the runs are not of one motor: half the
/// error, and more, is then that they differ.
const LEFT_APART: f64 = 0.25;
/// Share of the usual speed below which differences between runs are warmth and supply: twice what gains usually scatter by.
const SMALL: f64 = 2.0 * GAIN_SPREAD;
/// Steps of a run's own refit.
const STEPS: usize = 12;

/// What each run's own fit says where the runs are not of one motor.
pub fn differ(ground: &Ground, set: &Set) -> Option<Vec<Plant>> {
    let data = ground.data;
    let negligible = (SMALL * data.usual_rpm).powi(2) * data.rows() as f64;
    if data.runs.len() < 2 || squared_error(data, &set.plant) < negligible {
        return None;
    }
    let free = ground.free_with(&set.parts, asymmetries(set));
    let common = refit(data, set.plant.clone(), &free, ground.noise(&set.plant), &[], STEPS);
    let together = squared_error(data, &common);
    let (mut apart, mut own) = (0.0, Vec::new());
    for (i, run) in data.runs.iter().enumerate() {
        let alone = data.of(std::slice::from_ref(run));
        let start = |sign: f64| {
            let mut plant = Plant { values: common.values, starts: vec![common.starts[i]] };
            plant.values.set(P::Gain, sign * plant.values.get(P::Gain));
            plant
        };
        let fitted = [1.0, -1.0].map(|sign| {
            let from = start(sign);
            let variance = misfit(&alone, &from, &[], Noise::PLAIN, &[]) / ground.independent;
            refit(&alone, from, &free, Noise { variance: variance.max(1e-12), gain_spread: 0.0 }, &[], STEPS)
        });
        let error = |p: &Plant| squared_error(&alone, p);
        let [a, b] = fitted;
        let best = if error(&b) < error(&a) { b } else { a };
        apart += error(&best);
        own.push(best);
    }
    (apart < LEFT_APART * together).then_some(own)
}

/// Ways in which one motor may favour a direction and the next the other, so that they cancel in what all have in common.
fn asymmetries(set: &Set) -> &'static [P] {
    let has = |p: P| set.plant.values.get(p) != 0.0;
    match (has(P::GainSplit), has(P::DeadZone), has(P::Coulomb)) {
        (true, ..) => &[],
        (false, true, _) => &[P::GainSplit, P::DeadSplit],
        (false, false, true) => &[P::GainSplit, P::FrictionSplit],
        _ => &[P::GainSplit],
    }
}

/// What is said of such runs.
pub fn note(data: &Data, own: &[Plant]) -> String {
    let one = |(run, plant): (&super::data::DriveRun, &Plant)| {
        format!(
            "{}: {:.0} rpm at the largest input, lag {:.3} s",
            run.id,
            plant.values.get(P::Gain),
            plant.values.lag_s()
        )
    };
    let each: Vec<String> = data.runs.iter().zip(own).map(one).collect();
    format!(
        "the runs are not of one motor, or not in one unit or sign: numbers of its own for each predict far better than common ones ({}). Each \
         is judged on its own, parts of it held out instead of whole runs; what is said of an effect names its runs",
        each.join("; ")
    )
}

/// The outcomes of single runs as one: an effect is named if every run that shows it names it.
pub fn joined(data: &Data, outcomes: Vec<(String, InertialOutcome)>) -> InertialOutcome {
    let mut findings: Vec<Finding> = Vec::new();
    for (id, outcome) in &outcomes {
        for new in &outcome.findings {
            let suspected = new.status != Status::Rejected;
            let place = if suspected { format!("in {id}") } else { String::new() };
            match findings.iter_mut().find(|f| f.name == new.name) {
                None => findings.push(Finding { note: join(&place, &new.note), ..new.clone() }),
                Some(known) => merge(known, new, &place),
            }
        }
    }
    findings.sort_by_key(|f| (f.status == Status::Rejected) as u8);
    let all = |of: &dyn Fn(&InertialOutcome) -> Vec<Vec<f64>>| outcomes.iter().flat_map(|o| of(&o.1)).collect();
    let floors: f64 = outcomes.iter().map(|o| o.1.noise_floor.powi(2)).sum();
    let held = |of: &dyn Fn(&HeldOut) -> Vec<[f64; 2]>| outcomes.iter().flat_map(|o| of(&o.1.held_out)).collect();
    InertialOutcome {
        data: data.clone(),
        before: all(&|o| o.before.clone()),
        after: all(&|o| o.after.clone()),
        findings,
        unknown: outcomes.iter().flat_map(|o| o.1.unknown.clone()).collect(),
        not_judged: outcomes[0].1.not_judged.clone(),
        held_out: HeldOut {
            loss: held(&|h| h.loss.clone()),
            plain: held(&|h| h.plain.clone()),
            seconds: outcomes.iter().flat_map(|o| o.1.held_out.seconds.clone()).collect(),
        },
        noise_floor: (floors / outcomes.len() as f64).sqrt(),
        own: Vec::new(),
        fitted: None,
        notes: Vec::new(),
    }
}

fn join(a: &str, b: &str) -> String {
    [a, b].iter().filter(|s| !s.is_empty()).copied().collect::<Vec<_>>().join("; ")
}

/// Adds what another run says of an effect.
fn merge(known: &mut Finding, new: &Finding, place: &str) {
    if new.status == Status::Rejected {
        return;
    }
    if known.status == Status::Rejected {
        *known = Finding { note: join(place, &new.note), ..new.clone() };
        return;
    }
    if new.status == Status::Ambiguous {
        known.status = Status::Ambiguous;
    }
    for rival in &new.conflicts {
        if !known.conflicts.contains(rival) {
            known.conflicts.push(rival.clone());
        }
    }
    for e in &mut known.parameters {
        if let Some(n) = new.parameters.iter().find(|n| n.name == e.name) {
            // Intervals span the runs.
            e.interval = [e.interval[0].min(n.interval[0]), e.interval[1].max(n.interval[1])];
            e.value = 0.5 * (e.value + n.value);
        }
    }
    known.note = join(&known.note, place);
}
