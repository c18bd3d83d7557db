//! Showing what the simulation gets wrong, naming the cause, and saying how sure that is.
//!
//! [`diagnose`] runs the whole procedure over measurement folders: refit the baseline, search a library of effects with
//! whole runs held out, hold the best against a null that repeats the whole selection, compare it with its rivals, and
//! look for what no effect explains.
//!
//! ```
//! use twum_diagnose::{Options, diagnose};
//! use twum_record::convert::changes;
//! use twum_record::measurement::{DriveResponse, Measurement, Run, RunData, RunKind};
//!
//! // An ordinary motor that stands still below a tenth of its input, swept up and down three times.
//! let input: Vec<f64> = (0..600).map(|i| (f64::from(i) * 0.021).sin()).collect();
//! let rpm = input.iter().map(|u: &f64| 100.0 * u.signum() * (u.abs() - 0.1).max(0.0)).collect();
//! let time_us = (0..600).map(|i| 5e3 * f64::from(i)).collect();
//! let data = RunData::Drive { time_us, input, response: DriveResponse::SpeedRpm(rpm), beside: Default::default() };
//! let runs = ["a", "b", "c"].map(|id| Run::new(id, RunKind::Speed, data.clone())).to_vec();
//! let bench = Measurement { name: "bench".into(), motor: String::new(), edges_per_rev: 0, runs, folder: "bench".into() };
//! let (answer, _) = diagnose(&[bench], &Options { quick: true, ..Options::default() }, &|_, _| ())?;
//! // Where the motor has settled at every sample, friction looks the same: the answer may be the set of both.
//! assert!(answer.suspected().contains(&"dead-zone"), "{:?}", answer.suspected());
//! # Ok::<(), twum_diagnose::DiagnoseError>(())
//! ```
//!
//! `docs/diagnosis.md` walks through it; `docs/detection.md` says how often it errs.

mod amplitude;
pub mod answer;
pub mod baseline;
pub mod cache;
pub mod candidate;
pub mod conclusion;
pub mod controller;
mod cycles;
pub mod described;
pub mod design;
pub mod discrepancy;
pub mod evidence;
pub mod finding;
pub mod form_error;
pub mod formula;
mod free;
pub mod gaps;
mod gaussian;
pub mod ground;
pub mod held_out;
pub mod inertial;
pub mod level;
pub mod library;
pub mod motor;
pub mod numbers;
pub mod observe;
pub mod plan;
pub mod prior;
pub mod problem;
mod pwm_line;
pub mod refit;
mod rhythm;
pub mod rotor;
pub mod runs;
pub mod saved;
pub mod search;
pub mod set;
mod starts;
pub mod stats;
pub mod timing;
#[cfg(test)]
mod trial;
pub mod verdict;
pub mod weighing;

use answer::Diagnosis;
use conclusion::{Outcome, Settings};
use observe::{Observed, observe, shorten, some_of_each};
use problem::Problem;
use rotor::{P, Parameters};
use runs::diagnose_runs;
use std::sync::Arc;
use twum_motor::formula_file::shipped_effects;
use twum_motor::hypothesis::Hypothesis;
use twum_record::convert::changes;
use twum_record::measurement::{Format, Measurement, Run, RunData, RunKind};

/// Why nothing could be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// No folder was given, or none holds a run.
    #[error("there are no runs to diagnose: {0}")]
    NoRuns(String),
    /// Folders of different kinds were mixed.
    #[error("{0}")]
    Mixed(String),
    /// More numbers than there are places for.
    #[error(
        "the effects that are formulas have {given} numbers together; {most} can be fitted at once: leave an effect out"
    )]
    TooManyNumbers {
        /// How many they have.
        given: usize,
        /// How many there may be.
        most: usize,
    },
}

/// Runs that a fast answer looks at, and the first seconds of each: 110 runs of 5 s take an eleventh as long as whole.
const QUICK_RUNS: usize = 24;
const QUICK_S: f64 = 1.5;

/// What is asked for.
#[derive(Debug, Clone)]
pub struct Options {
    /// Seed of every random choice.
    pub seed: u64,
    /// Answer fast: two repetitions of each run, two seconds of each, a null of 150 repetitions.
    pub quick: bool,
    /// Whether the baseline lets the rotor coast while the drive is off (flavour `thesis`).
    pub coasting: bool,
    /// The motor to start from; the 30 mm PCBMotor's friction without one.
    pub motor: Option<twum_motor::parameters::Parameters>,
    /// Effects taken out of the library.
    pub without: Vec<String>,
    /// Effects of the user's own, which are searched for like those of the library.
    pub formulas: Vec<Arc<Hypothesis>>,
}

impl Default for Options {
    fn default() -> Self {
        Self { seed: 1, quick: false, coasting: false, motor: None, without: Vec::new(), formulas: Vec::new() }
    }
}

/// What the answer was drawn from, for reports and saved models.
#[derive(Debug, Clone)]
pub enum Details {
    /// Several runs of a TWUM.
    Runs {
        /// The runs.
        problem: Problem,
        /// What the search found.
        outcome: Box<Outcome>,
    },
    /// Runs of an ordinary motor.
    Inertial(Box<inertial::InertialOutcome>),
}

/// The effects that are formulas: those shipped, and the user's own, of which one may stand in the place of a shipped one.
fn formulas(options: &Options) -> Result<Vec<Arc<Hypothesis>>, DiagnoseError> {
    let replaced = |shipped: &&Arc<Hypothesis>| options.formulas.iter().any(|own| own.name == shipped.name);
    let shipped = shipped_effects().iter().filter(|h| !replaced(h));
    let all: Vec<Arc<Hypothesis>> = shipped.chain(&options.formulas).cloned().collect();
    let given = all.iter().map(|h| h.numbers.len()).sum();
    let most = P::FORMULA.len();
    if given > most { Err(DiagnoseError::TooManyNumbers { given, most }) } else { Ok(all) }
}

/// Diagnoses measurement folders together.
///
/// # Errors
/// When there is no run at all, when folders of different plants are mixed, or when formulas have too many numbers. Data that can be
/// read but say too little give an answer that says so.
pub fn diagnose(
    measurements: &[Measurement],
    options: &Options,
    progress: &dyn Fn(&str, f64),
) -> Result<Answered, DiagnoseError> {
    let total: usize = measurements.iter().map(|m| m.runs.len()).sum();
    if total == 0 {
        return Err(DiagnoseError::NoRuns("the folders hold no [[run]]".to_owned()));
    }
    if let Some(answer) = ordinary(measurements, options, progress)? {
        return Ok(answer);
    }
    let formulas = formulas(options)?;
    let (mut runs, mut notes) = observed(measurements);
    if options.quick {
        let before = runs.len();
        some_of_each(&mut runs, QUICK_RUNS);
        shorten(&mut runs, QUICK_S);
        notes.push(format!(
            "quick: {} of {before} runs, the first {QUICK_S} s of each, a null of 150 repetitions; small effects and slow ones may be missed",
            runs.len()
        ));
    }
    if let Some(why) = unusable(&runs) {
        notes.push(why);
        return Ok((Diagnosis::impossible(notes, options.seed), None));
    }
    let start = starting_rotor(&runs, options);
    if runs.len() == 1 {
        notes.push("one run only: later turns are held out instead of whole runs; replication is missing, and nothing can be said about run-to-run spread".to_owned());
    }
    let replicated = runs.len() >= 4;
    if !replicated && runs.len() > 1 {
        notes.push("fewer than four runs: no replication, nothing can be said about run-to-run spread".to_owned());
    }
    let problem = Problem::new(runs).with(formulas);
    if problem.duties() == 1 && problem.runs.iter().all(|r| r.kind == RunKind::Speed) {
        notes.push("one duty only: effects over duty (dead zone, saturation, sag, rounding) cannot be seen; add runs at two other duties".to_owned());
    }
    let settings = Settings {
        seed: options.seed,
        repetitions: if options.quick { 150 } else { 200 },
        without: options.without.clone(),
    };
    let mut outcome = diagnose_runs(&problem, &start, &settings, progress);
    if !outcome.alone.is_empty() {
        let advice = if options.quick {
            "--quick may have left out those that do"
        } else {
            "repeat it, or add a duty beside it"
        };
        notes.push(format!(
            "{}: no other run shows what the motor does there; fitted, but not scored on runs held out: {advice}",
            outcome.alone.join(", ")
        ));
    }
    notes.extend(doubted_rates(&start, &outcome.extended.parameters));
    let tracks: Vec<&Run> = measurements.iter().flat_map(|m| &m.runs).filter(|r| r.kind == RunKind::Track).collect();
    if !tracks.is_empty() {
        let parity = controller::parity(&tracks, settings.repetitions, options.seed, &options.without);
        if let Some(rms) = parity.rms_steps {
            notes.push(format!(
                "control signal recomputed from target and position: {rms:.4} duty steps RMS from the logged one"
            ));
        }
        notes.extend(parity.notes);
        outcome.findings.splice(0..0, parity.findings);
    }
    let diagnosis = Diagnosis::new(&outcome, replicated, notes, options.seed);
    Ok((diagnosis, Some(Details::Runs { problem: outcome.problem.clone(), outcome: Box::new(outcome) })))
}

/// What is answered, with what it was found by.
type Answered = (Diagnosis, Option<Details>);

/// The answer on runs of an ordinary motor, where these are such.
fn ordinary(
    measurements: &[Measurement],
    options: &Options,
    progress: &dyn Fn(&str, f64),
) -> Result<Option<Answered>, DiagnoseError> {
    let inertial = measurements.iter().filter(|m| m.runs.iter().any(|r| r.format == Format::Drive)).count();
    if inertial == 0 {
        return Ok(None);
    }
    if inertial < measurements.len() {
        return Err(DiagnoseError::Mixed(
            "runs of an ordinary motor (format `drive`) and of a TWUM cannot be diagnosed together: name one kind of folder".to_owned(),
        ));
    }
    if !options.formulas.is_empty() {
        return Err(DiagnoseError::Mixed(
            "an effect of one's own acts on a TWUM's wave or duty; these are runs of an ordinary motor (format `drive`)".to_owned(),
        ));
    }
    let runs: Vec<&Run> = measurements.iter().flat_map(|m| &m.runs).collect();
    let (diagnosis, outcome) = inertial::diagnose_drives(&runs, options, progress);
    Ok(Some((diagnosis, outcome.map(|o| Details::Inertial(Box::new(o))))))
}

/// The runs of all folders that can be used, in the order that the folders are named, with what is to be said of the others.
fn observed(measurements: &[Measurement]) -> (Vec<Observed>, Vec<String>) {
    let mut notes = Vec::new();
    let mut runs = Vec::new();
    for (part, m) in measurements.iter().enumerate() {
        for run in &m.runs {
            notes.extend(contradictions(run));
            match observe(run, m.edges_per_rev) {
                Ok(mut o) => {
                    o.order = o.order.map(|k| k.saturating_add(1_000_000 * part as u32));
                    runs.push(o);
                }
                Err(refusal) => notes.push(format!("{refusal}; left out")),
            }
        }
    }
    notes.extend(if measurements.len() == 1 { doubled_order(&runs) } else { None });
    notes.extend(edges_of_no_rotor(&runs));
    (runs, notes)
}

/// Names of all effects that can be found, of TWUMs and of ordinary motors.
pub fn known_effects() -> Vec<String> {
    let mut names = library::known_effects();
    for effect in inertial::EFFECTS {
        if names.iter().all(|n| n != effect.name) {
            names.push(effect.name.to_owned());
        }
    }
    names
}

/// Why these runs say nothing of a motor.
fn unusable(runs: &[Observed]) -> Option<String> {
    if runs.is_empty() {
        return Some("no run can be used".to_owned());
    }
    if runs.iter().all(|r| r.revolutions() < 0.02) {
        return Some(
            "no run shows motion: less than 0.02 turns in any of them. Whether the motor, the drive or the encoder is silent \
             cannot be told from here; look at the encoder line with the motor turned by hand"
                .to_owned(),
        );
    }
    let edges: usize = runs.iter().map(|r| r.windows.len()).sum();
    (edges < 30).then(|| {
        format!("only {edges} edge intervals in all: too little to tell an effect from sampling noise; make runs of several seconds")
    })
}

/// A rotor to start the refit from: the motor's friction, the free speed the data show.
pub fn starting_rotor(runs: &[Observed], options: &Options) -> Parameters {
    let mut speeds: Vec<f64> = runs
        .iter()
        .filter(|r| r.kind == RunKind::Speed)
        .filter_map(|r| r.duty.filter(|d| *d > 0.05).map(|d| r.mean_speed_rpm().abs() / problem::RPM / d))
        .filter(|w| *w > 0.0)
        .collect();
    speeds.sort_by(f64::total_cmp);
    let free = if speeds.is_empty() { 3.6466 } else { speeds[(speeds.len() - 1) * 3 / 4] };
    // u·Fext·R0/Jr, Ctheta/Jr and 2·Ms/Cs of the 30 mm PCBMotor (thesis, A.4) where no motor is given.
    let [drive, brake, viscous] = options.motor.as_ref().map_or([1888.0, 1888.0, 0.261], motor::rates);
    let wave_time_s = options.motor.as_ref().map_or(2.28e-4, motor::wave_time_s);
    Parameters::new(free, drive, if options.coasting { 0.0 } else { brake }, viscous, 0.02)
        .with(P::WaveTime, wave_time_s)
        .with(P::Dying, baseline::DYING.median)
        .with(P::Lift, baseline::LIFT.median)
        .with(P::Ahead, baseline::AHEAD.median)
        .with(P::Hysteresis, baseline::HYSTERESIS.median)
}

/// Friction of the motor file that the runs do not bear out.
fn doubted_rates(listed: &Parameters, fitted: &Parameters) -> Option<String> {
    let rates = [(P::OnAcceleration, "under drive"), (P::OffDeceleration, "without drive")];
    let (rate, when) = rates.into_iter().find(|(rate, _)| {
        let ratio = fitted.get(*rate) / listed.get(*rate);
        ratio > 0.0 && ratio.is_finite() && ratio.ln().abs() > 2.0 * baseline::SAME_MOTOR_LOG_SD
    })?;
    Some(format!(
        "these runs do not bear out the motor file's friction {when}: {:.0} rad/s^2 over the inertia there, {:.0} here. The answer is drawn \
         from the latter; narrower intervals need the friction measured (twum identify friction), or the motor these runs were made with \
         (--motor, --flavour)",
        listed.get(rate),
        fitted.get(rate)
    ))
}

/// Metadata that contradict the record.
fn contradictions(run: &Run) -> Vec<String> {
    let mut out = Vec::new();
    let id = &run.id;
    let last_edge_s = match &run.data {
        RunData::Levels { start_us, period_us, levels } => {
            changes(levels).next_back().map(|i| (start_us + i as f64 * period_us) * 1e-6)
        }
        RunData::Edges { edges, .. } => edges.last().map(|e| e.time_us * 1e-6),
        _ => None,
    };
    if let (Some(edge), Some(end)) = (last_edge_s, run.drive_on_s)
        && edge > end + 0.2
    {
        out.push(format!(
            "run {id}: edges until {edge:.2} s, but the drive is said to end at {end:.2} s (drive_on_s); what follows it by more than 0.2 s is left out"
        ));
    }
    if run.duty == Some(0.0) && last_edge_s.is_some() {
        out.push(format!(
            "run {id}: duty 0, and yet the encoder shows edges: the duty is wrong, or something else turned the motor"
        ));
    }
    out
}

/// Edges that follow each other faster than any rotor of these records turned.
fn edges_of_no_rotor(runs: &[Observed]) -> Option<String> {
    let counts = || runs.iter().map(|run| (run, run.impossible().len())).filter(|(_, n)| *n > 0);
    let (first, total) = (counts().next()?.0, counts().map(|(_, n)| n).sum::<usize>());
    Some(format!(
        "{total} of the edges, the first in {}, follow the one before faster than this rotor turns: not compared. The encoder chatters there, or \
         samples are lost",
        first.id
    ))
}

/// Two runs that claim the same place in the order.
fn doubled_order(runs: &[Observed]) -> Option<String> {
    let mut orders: Vec<u32> = runs.iter().filter_map(|r| r.order).collect();
    let count = orders.len();
    orders.sort_unstable();
    orders.dedup();
    (orders.len() < count)
        .then(|| "two runs have the same `order`: effects of warmth and wear may be misjudged".to_owned())
}
