//! The main job, whole: a small experiment on a motor in which something is hidden, and what the diagnosis says of it.

use super::DemoError;
use crate::diagnose::plan::{PlannedRun, first_experiment};
use crate::diagnose::{Options, diagnose};
use crate::link::bench::{Action, Experiment, perform};
use crate::link::{LinkError, Session, SimulatedLink};
use crate::model::effects::{EffectSet, Kind, info};
use crate::model::motor::Motor;
use crate::model::parameters::Flavour;
use crate::record::load::load_runs;
use crate::report::diagnosis;
use crate::report::page::Page;
use crate::sim::Setup;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use twum_shared::message::{CaptureMode, Configuration, RunEnd};
use twum_shared::step::ConfigSpec;

/// What chance may hide: what shows in speeds at constant duty, and has no twin there. A runout and an eccentric encoder are
/// told apart by re-seating the rotor alone; hidden by name, either is one of two.
const POOL: [&str; 6] = [
    "dead-zone",
    "direction-asymmetry",
    "frequency-settling",
    "high-duty-saturation",
    "resonance-heating",
    "unequal-edges",
];
/// Sizes, in those at which an effect is plain to see: what a first look should find, not the edge of what can be found.
const SIZES: std::ops::Range<f64> = 1.5..3.0;
/// The experiment: eight turns a run at full drive are enough for what repeats each turn; two of each tell a cause from chance.
const DUTIES: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
const TRIALS: usize = 2;
const SECONDS: f64 = 3.0;
const PWM_HZ: f64 = 50.0;
/// The flavour that the diagnosis starts from.
const FLAVOUR: Flavour = Flavour::Physical;

/// What to hide.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Hide {
    /// One that shows in speeds at constant duty and has no twin there, by the seed.
    Random,
    /// Nothing.
    Nothing,
    /// This effect, with a size by the seed.
    Effect(String),
}

impl std::str::FromStr for Hide {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "random" => Ok(Self::Random),
            "none" => Ok(Self::Nothing),
            name => info(name).map(|info| Self::Effect(info.name.to_owned())).map_err(|error| error.to_string()),
        }
    }
}

/// What was hidden, and what was found.
#[derive(Debug, Clone, Serialize)]
pub struct Found {
    /// Seed of the choice and the sizes.
    pub seed: u64,
    /// The effect hidden; none when nothing was.
    pub hidden: Option<String>,
    /// Its parameters.
    pub parameters: BTreeMap<&'static str, f64>,
    /// The diagnosis' verdict: `named`, `ambiguous`, `unknown` or `none`.
    pub verdict: String,
    /// The effects it named.
    pub named: Vec<String>,
    /// What was found, in one sentence.
    pub sentence: String,
    /// Whether what was named is what was hidden, and nothing else.
    pub right: bool,
}

/// Makes the experiment into `folder`, diagnoses it, and begins the page.
pub(super) fn experiment(
    folder: &Path,
    hide: &Hide,
    seed: u64,
    progress: &mut dyn FnMut(&str),
) -> Result<(Page, Found), DemoError> {
    let (hidden, effects, parameters) = choose(hide, seed)?;
    let motor = Motor::pcbmotor_30mm();
    let setup = Setup::hybrid(&motor, FLAVOUR, &effects)?;
    let mut session = Session::new(SimulatedLink::new(setup));
    let runs = first_experiment(&DUTIES, TRIALS, SECONDS, PWM_HZ);
    for (number, run) in runs.iter().enumerate() {
        progress(&format!("experiment on a motor with something hidden: run {} of {}", number + 1, runs.len()));
        make(&mut session, run, folder.join(format!("{}.mcap", run.id(number))), &motor.name)?;
    }
    progress("looking for the cause");
    let (mut measurement, _) = load_runs(folder)?;
    measurement.name = "demo".to_owned();
    let options = Options { seed, motor: Some(motor.parameters(FLAVOUR)), ..Options::default() };
    let (diagnosis, details) = diagnose(&[measurement], &options, &|what, _| {
        let _ = what;
    })?;
    let found = read(&serde_json::to_value(&diagnosis)?, seed, hidden, parameters);
    let page = diagnosis::page("a motor with something hidden", &diagnosis, details.as_ref());
    Ok((page, found))
}

/// The effect, and its parameters: sizes by chance, scales as they typically are, angles anywhere.
type Choice = (Option<String>, EffectSet, BTreeMap<&'static str, f64>);

fn choose(hide: &Hide, seed: u64) -> Result<Choice, DemoError> {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let random = POOL.choose(&mut chance).expect("the pool is not empty");
    let name = match hide {
        Hide::Nothing => return Ok((None, EffectSet::default(), BTreeMap::new())),
        Hide::Random => random,
        Hide::Effect(name) => name.as_str(),
    };
    let info = info(name)?;
    let values: Vec<f64> = info
        .parameters
        .iter()
        .map(|p| match p.kind {
            Kind::Linear => (p.absent + (p.typical - p.absent) * chance.random_range(SIZES)).clamp(p.lower, p.upper),
            Kind::Scale => p.typical,
            Kind::Angle => chance.random_range(-std::f64::consts::PI..std::f64::consts::PI),
        })
        .collect();
    let mut effects = EffectSet::default();
    effects.set(info.name, &values)?;
    let parameters = info.parameters.iter().map(|p| p.name).zip(values).collect();
    Ok((Some(info.name.to_owned()), effects, parameters))
}

fn make(
    session: &mut Session<SimulatedLink>,
    run: &PlannedRun,
    path: std::path::PathBuf,
    motor: &str,
) -> Result<(), DemoError> {
    let experiment = Experiment {
        configuration: Some(Configuration::with_control(ConfigSpec::DEFAULT)),
        capture: CaptureMode { bits: false, edges: true, control: false },
        action: Action::Speed(run.in_series(0).speed_run().expect("a planned run can be made")),
        recording: Some(path),
        motor: motor.to_owned(),
    };
    match perform(session, &experiment, None, |_| {})?.run.map(|run| run.end) {
        Some(RunEnd::Fault(fault)) => Err(LinkError::Fault(fault).into()),
        _ => Ok(()),
    }
}

/// Reads the answer as any other program would.
fn read(d: &Value, seed: u64, hidden: Option<String>, parameters: BTreeMap<&'static str, f64>) -> Found {
    let verdict = d["verdict"].as_str().unwrap_or("unknown").to_owned();
    let with_status = |status: &str| -> Vec<String> {
        let effects = d["effects"].as_array().into_iter().flatten();
        effects.filter(|e| e["status"] == status).filter_map(|e| Some(e["name"].as_str()?.to_owned())).collect()
    };
    let named = with_status("named");
    let right = match &hidden {
        Some(hidden) => named == [hidden.clone()],
        None => named.is_empty(),
    };
    Found { seed, hidden, parameters, verdict, named, sentence: diagnosis::sentence(d), right }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_decides_what_is_hidden_and_a_board_can_have_it() {
        let mut names: Vec<String> = (0..40)
            .map(|seed| {
                let (name, effects, parameters) = choose(&Hide::Random, seed).unwrap();
                assert_eq!(choose(&Hide::Random, seed).unwrap().2, parameters);
                Setup::hybrid(&Motor::pcbmotor_30mm(), FLAVOUR, &effects).unwrap();
                name.unwrap()
            })
            .collect();
        names.sort();
        names.dedup();
        assert!(names.len() >= 6, "{names:?}");
        assert_eq!(choose(&Hide::Nothing, 1).unwrap().1, EffectSet::default());
        assert!("dead-zon".parse::<Hide>().unwrap_err().contains("dead-zone"));
    }

    #[test]
    fn the_answer_is_read_from_its_json() {
        let d = serde_json::json!({"verdict": "named", "effects": [
            {"name": "dead-zone", "status": "named"}, {"name": "start-delay", "status": "rejected"}],
            "baseline": {"rmse_speed_rpm": 3.24}, "extended": {"rmse_speed_rpm": 0.2}});
        let found = read(&d, 1, Some("dead-zone".to_owned()), BTreeMap::new());
        assert!(found.right && found.named == ["dead-zone"]);
        assert!(!read(&d, 1, None, BTreeMap::new()).right);
    }
}
