//! Ordinary motors (plant `inertial`): what input makes of speed, and what the line that anyone writes gets wrong.
//!
//! The plant is simulated freely from its input, every number of it is fitted, and sets of effects are weighed and judged as those of
//! a TWUM: [`super::evidence`], [`super::level`], [`super::verdict`].

mod angle;
mod apart;
mod aside;
mod columns;
mod compensation;
mod conclude;
mod data;
mod doubts;
mod effects;
mod fit;
mod held_out;
mod model;
mod numbers;
mod plan;
mod plant;
mod report;
mod ripple;
mod search;
mod sets;
mod swing;
mod thin;
mod values;
mod weigh;

pub use compensation::{Compensation, Fitted};
pub use conclude::InertialOutcome;
pub use data::{Data, DriveRun};
pub use effects::EFFECTS;
pub use fit::Plant;
pub use model::{Model, ModelError, RunAgainst};
pub use plan::{InputRun, Piece, next_inputs};
pub use report::{MotorReport, Number};
pub use values::{P, Values};

use super::Options;
use super::answer::{Diagnosis, UnknownAnswer, Verdict, effect_answer};
use super::finding::Estimate;
use sets::Ground;
use twum_record::measurement::Run;

/// The sentence and the equation of an effect of an ordinary motor.
fn says(name: &str) -> Option<(String, String)> {
    EFFECTS.iter().find(|e| e.name == name).map(|e| (e.says.to_owned(), e.equation.to_owned()))
}

/// The answer that other programs read.
fn answer_of(outcome: &InertialOutcome, replicated: bool, notes: Vec<String>, seed: u64) -> Diagnosis {
    let (base, extended, floor) = (outcome.held_out.rmse(0), outcome.held_out.rmse(1), outcome.noise_floor);
    let mut d = Diagnosis::impossible(notes, seed);
    d.verdict = Verdict::of(&outcome.findings, &outcome.unknown);
    d.replicated = replicated;
    d.baseline.scores.rmse_speed_rpm = Some(base);
    d.baseline.noise_floor = floor;
    d.extended.rmse_speed_rpm = Some(extended);
    d.effects = outcome.findings.iter().map(|f| effect_answer(f, says(&f.name))).collect();
    d.unexplained_fraction = Some(((extended * extended - floor * floor) / (base * base)).clamp(0.0, 1.0));
    d.unknown = outcome
        .unknown
        .iter()
        .map(|u| UnknownAnswer { lives_in: u.lives_in.to_owned(), gain_heldout: u.gain, p_null: u.p_null })
        .collect();
    d.not_judged = outcome.not_judged.iter().cloned().collect();
    d
}

/// Why an effect cannot be judged from these runs, if it cannot.
fn not_judged_reason(name: &str, data: &Data) -> Option<String> {
    let reaches = |side: f64| data.runs.iter().any(|r| r.input.iter().any(|u| u * side > 0.05));
    let both = reaches(1.0) && reaches(-1.0);
    match name {
        "direction-asymmetry" | "load-bias" if !both => Some("needs inputs of both signs".to_owned()),
        "direction-asymmetry" | "load-bias" if data.unsigned => Some("needs a speed with its sign".to_owned()),
        "dead-time" | "second-lag" | "coupling-resonance" if data.passes_once() => {
            Some("needs an input that comes back: over one pass a delay looks like a threshold".to_owned())
        }
        "coupling-resonance" if data.starts() < 2 => {
            Some("needs a second start: over one, a swing looks like what friction and delays make of it".to_owned())
        }
        "heating" => match data.temperature {
            None => Some("needs a column `temperature`".to_owned()),
            Some((_, change)) if change < LEAST_WARMTH_K => {
                Some(format!("needs a temperature that changes: here by {change:.1} K"))
            }
            Some(_) => None,
        },
        _ => None,
    }
}

/// Kelvins by which a temperature has to change before anything can go with it: copper makes 2 % of them, as much as gains usually scatter by.
const LEAST_WARMTH_K: f64 = 5.0;

/// What is asked.
struct Asked<'a> {
    usable: Vec<usize>,
    /// Whether a torque over the angle is among them.
    angle: bool,
    not_judged: Vec<(String, String)>,
    repetitions: usize,
    seed: u64,
    progress: &'a dyn Fn(&str, f64),
}

impl<'a> Asked<'a> {
    fn of(data: &Data, options: &Options, progress: &'a dyn Fn(&str, f64)) -> Self {
        let (mut usable, mut not_judged) = (Vec::new(), Vec::new());
        for (i, effect) in EFFECTS.iter().enumerate().filter(|(_, e)| options.without.iter().all(|w| w != e.name)) {
            match not_judged_reason(effect.name, data) {
                Some(reason) => not_judged.push((effect.name.to_owned(), reason)),
                None => usable.push(i),
            }
        }
        let repetitions = if options.quick { 150 } else { 200 };
        let angle = usable.iter().any(|e| EFFECTS[*e].coordinate == effects::Coordinate::Angle);
        Self { usable, angle, not_judged, repetitions, seed: options.seed, progress }
    }
}

/// Diagnoses the runs of an ordinary motor.
pub fn diagnose_drives(
    runs: &[&Run],
    options: &Options,
    progress: &dyn Fn(&str, f64),
) -> (Diagnosis, Option<InertialOutcome>) {
    let (data, mut notes) = Data::read(runs);
    let outcome = match doubts::refused(&data) {
        Some(reason) => Err(reason),
        None => judged(&data, &Asked::of(&data, options, progress)),
    };
    let outcome = match outcome {
        Ok(outcome) => outcome,
        Err(reason) => {
            notes.push(reason);
            return (Diagnosis::impossible(notes, options.seed), None);
        }
    };
    if data.unsigned {
        notes.push("the speeds have no sign though the inputs have: magnitudes are compared".to_owned());
    }
    if data.runs.len() == 1 {
        notes.push("one run only: parts of it are held out instead of whole runs, replication is missing".to_owned());
    }
    notes.extend(doubts::loop_hides(&data));
    let apart = !outcome.notes.is_empty();
    notes.extend(outcome.notes.iter().cloned());
    let lag = outcome.own.iter().find(|e| e.name == "lag_s");
    notes.extend(lag.and_then(|lag| doubts::slow(lag.value)));
    if !outcome.own.is_empty() {
        let number = |e: &Estimate| {
            format!("{} {:.4} {} ({:.4} to {:.4})", e.name, e.value, e.unit, e.interval[0], e.interval[1])
        };
        let numbers: Vec<String> = outcome.own.iter().map(number).collect();
        let largest = data.largest_input;
        notes.push(format!("the motor itself (inputs relative to the largest, {largest}): {}", numbers.join("; ")));
    }
    let diagnosis = answer_of(&outcome, data.runs.len() > 1 && !apart, notes, options.seed);
    (diagnosis, Some(outcome))
}

/// The outcome of runs that move; why there is none otherwise.
fn judged(data: &Data, asked: &Asked) -> Result<InertialOutcome, String> {
    let mut ground = Ground::new(data, asked.usable.clone());
    let root = ground.root();
    if let Some(reason) = doubts::refused_line(data, &root.plant) {
        return Err(reason);
    }
    // An order of the angle is looked for in what the line leaves; or, once what hides it is known, in what the best set leaves.
    let orders = |plant: &Plant, independent| asked.angle.then(|| ripple::aligned(data, plant, independent)).flatten();
    let aligned = orders(&root.plant, ground.independent);
    let line = root.clone();
    if let Some(aligned) = &aligned {
        ground = Ground::new(aligned, asked.usable.clone());
    }
    let mut sets = ground.visit(root, asked.progress);
    let later = if aligned.is_none() { orders(&sets[0].plant, ground.independent) } else { None };
    if let Some(later) = &later {
        ground = Ground::new(later, asked.usable.clone());
        sets = ground.visit(line, asked.progress);
    }
    let told = ground.has_angle(&sets[0]).then(|| ground.followed(&sets[0]));
    if let Some(told) = &told {
        let mut anew = Ground::new(told, asked.usable.clone());
        let line = sets.iter().find(|s| s.parts.is_empty()).cloned().unwrap_or_else(|| anew.root());
        let again = anew.again(sets.clone(), line);
        // Told worse where the plant does not follow the motor.
        if again[0].weighed.left < sets[0].weighed.left {
            (ground, sets) = (anew, again);
        }
    }
    if let Some(own) = apart::differ(&ground, &sets[0]) {
        return each(data, asked, &own);
    }
    (asked.progress)("measuring what was found", 0.85);
    let outcome = conclude::conclude(&ground, &sets, asked.repetitions, asked.seed);
    Ok(InertialOutcome { not_judged: asked.not_judged.clone(), ..outcome })
}

/// The outcomes of runs that are not of one motor.
fn each(data: &Data, asked: &Asked, own: &[Plant]) -> Result<InertialOutcome, String> {
    let (mut outcomes, mut notes) = (Vec::new(), vec![apart::note(data, own)]);
    for run in &data.runs {
        match judged(&data.of(std::slice::from_ref(run)), asked) {
            Ok(outcome) => outcomes.push((run.id.clone(), outcome)),
            Err(reason) => notes.push(format!("run {}: {reason}", run.id)),
        }
    }
    if outcomes.is_empty() {
        return Err(notes.join("; "));
    }
    Ok(InertialOutcome { notes, ..apart::joined(data, outcomes) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Steps at random into a plant, with a noise of one per cent of the largest speed.
    fn record(hidden: &[(P, f64)], seed: u64) -> Data {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let runs = (0..3)
            .map(|i| {
                let levels: Vec<f64> = (0..40).map(|_| rng.random_range(-1.0..1.0)).collect();
                let input: Vec<f64> = (0..600).map(|k| levels[k / 15]).collect();
                let mut run = DriveRun {
                    id: format!("r{i}"),
                    time: (0..600).map(|k| 5e-3 * f64::from(k)).collect(),
                    period_s: 5e-3,
                    rpm: vec![0.0; 600],
                    windows: None,
                    turns: vec![0.0; 600],
                    ripple: Vec::new(),
                    beside: Vec::new(),
                    input,
                };
                let values = hidden.iter().fold(Values::line(900.0, 0.03), |v, (p, to)| v.with(*p, *to));
                let clean = plant::simulate(&run, &values, 0.0, false).rpm;
                run.rpm = clean.iter().map(|v| v + 9.0 * rng.random_range(-1.7..1.7)).collect();
                run
            })
            .collect();
        Data {
            runs,
            largest_input: 1.0,
            usual_rpm: 400.0,
            unsigned: false,
            ripples: Vec::new(),
            largest_load: None,
            temperature: None,
            controlled: false,
        }
    }

    fn judged(data: &Data) -> InertialOutcome {
        let mut ground = Ground::new(data, (0..EFFECTS.len()).collect());
        let root = ground.root();
        let sets = ground.visit(root, &|_, _| {});
        conclude::conclude(&ground, &sets, 50, 1)
    }

    fn named(outcome: &InertialOutcome) -> Vec<&str> {
        let of = outcome.findings.iter().filter(|f| f.status == super::super::finding::Status::Named);
        of.map(|f| f.name.as_str()).collect()
    }

    /// A name out of nothing is the worst error.
    #[test]
    fn a_linear_motor_names_nothing() {
        let outcome = judged(&record(&[], 1));
        assert!(outcome.findings.iter().all(|f| f.status == super::super::finding::Status::Rejected));
        assert!(outcome.unknown.is_empty(), "{:?}", outcome.unknown);
    }

    /// Fails if friction in the dynamics is taken for a dead zone of the input, or its size is off.
    #[test]
    fn friction_and_a_dead_zone_come_with_their_own_names_and_sizes() {
        for (number, name) in [(P::Coulomb, "coulomb-friction"), (P::DeadZone, "dead-zone")] {
            let outcome = judged(&record(&[(number, 0.15)], 2));
            assert_eq!(named(&outcome), [name]);
            let size = &outcome.findings[0].parameters[0];
            assert!((size.value - 0.15).abs() < 0.01 && size.interval[0] < 0.15 && 0.15 < size.interval[1], "{size:?}");
        }
    }
}
