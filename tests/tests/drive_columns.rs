//! Columns recorded beside input and motion of an ordinary motor: what the answer makes of them, and what it says that it does not use.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_host::diagnose::inertial::{InertialOutcome, Model};
use twum_host::diagnose::{Details, Options, diagnose};
use twum_host::record::measurement::{Beside, DriveResponse, Measurement, Run, RunData, RunKind};

/// Time between samples in s, and the small steps that one is simulated in.
const PERIOD_S: f64 = 5e-3;
const STEPS: usize = 20;
/// What the largest load, of 0.4 N·m, takes of the largest input, and what a kelvin takes of the gain.
const LOAD_SHARE: f64 = 0.2;
const LOSS_PER_KELVIN: f64 = 0.004;

/// Three runs of a motor of 900 rpm and 50 ms, loaded or warming, with all four columns recorded.
fn runs(loaded: bool, warming: bool) -> Vec<Run> {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let samples = 600;
    let load_nm = |run: usize, t: f64| 0.2 + 0.2 * (2.1 * t + f64::from(run as u8)).sin() * (0.7 * t).cos();
    let warmth = |run: usize, t: f64| 30.0 + 5.0 * run as f64 + 30.0 * (1.0 - (-t / 1.5).exp());
    let mean: f64 = (0..3).flat_map(|run| (0..samples).map(move |k| warmth(run, PERIOD_S * k as f64))).sum::<f64>()
        / (3 * samples) as f64;
    let mut made = Vec::new();
    for run in 0..3 {
        let levels: Vec<f64> = (0..60).map(|_| rng.random_range(-1.0..1.0)).collect();
        let time = |k: usize| PERIOD_S * k as f64;
        let input: Vec<f64> = (0..samples).map(|k| levels[k / 10]).collect();
        let (mut speed, mut rpm) = (0.0, Vec::new());
        for (k, u) in input.iter().enumerate() {
            rpm.push(speed + 4.0 * rng.random_range(-1.7..1.7));
            for step in 0..STEPS {
                let t = time(k) + (step as f64 + 0.5) * PERIOD_S / STEPS as f64;
                let gain = if warming { 1.0 - LOSS_PER_KELVIN * (warmth(run, t) - mean) } else { 1.0 };
                let load = if loaded { LOAD_SHARE * load_nm(run, t) / 0.4 } else { 0.0 };
                speed += PERIOD_S / STEPS as f64 / 0.05 * (900.0 * (u * gain - load) - speed);
            }
        }
        let column = |of: &dyn Fn(f64) -> f64| (0..samples).map(|k| of(time(k))).collect::<Vec<f64>>();
        let beside = [
            (Beside::Load, column(&|t| load_nm(run, t))),
            (Beside::Temperature, column(&|t| warmth(run, t))),
            (Beside::Current, input.clone()),
            (Beside::Reference, input.iter().map(|u| 900.0 * u).collect()),
        ];
        let response = DriveResponse::SpeedRpm(rpm);
        let time_us = (0..samples).map(|k| 1e6 * time(k)).collect();
        let data = RunData::Drive { time_us, input, response, beside: beside.into() };
        made.push(Run::new(format!("r{run}"), RunKind::Speed, data));
    }
    made
}

/// The runs with only some of their columns.
fn with(columns: &[Beside], mut runs: Vec<Run>) -> Vec<Run> {
    for run in &mut runs {
        let RunData::Drive { beside, .. } = &mut run.data else { continue };
        beside.retain(|column, _| columns.contains(column));
    }
    runs
}

fn answer(runs: Vec<Run>) -> (Diagnosis, Box<InertialOutcome>) {
    let folder =
        Measurement { name: "drive".into(), motor: "inertial".into(), edges_per_rev: 0, runs, folder: "d".into() };
    let (answer, details) =
        diagnose(&[folder], &Options { quick: true, ..Options::default() }, &|_, _| {}).expect("it can be diagnosed");
    let Some(Details::Inertial(outcome)) = details else { panic!("{:?}", answer.notes) };
    (answer, outcome)
}

/// Fails if a measured load is not the plant's own input, or its size or sign is another; and if a saved motor forgets it.
#[test]
fn a_load_that_was_measured_is_an_input() {
    let (d, outcome) = answer(with(&[Beside::Load], runs(true, false)));
    assert_eq!(d.verdict, Verdict::None, "{:?} {:?}", d.suspected(), d.unknown);
    let share = outcome.own.iter().find(|e| e.name == "load_share").expect("a load was measured");
    // The runs' own largest load is a little below 0.4 N·m.
    assert!((share.value / LOAD_SHARE - 1.0).abs() < 0.05, "{share:?}");
    let model = Model::of("loaded", &outcome).expect("the runs are of one motor");
    let text = model.file(&d).expect("it can be written");
    let saved = Model::parse("saved.toml", &text).expect("it can be read");
    let again = with(&[Beside::Load], runs(true, false));
    let of = |runs: &[Run]| {
        let runs: Vec<&Run> = runs.iter().collect();
        saved.against(&runs)
    };
    let (whole, notes) = of(&again);
    // The largest load of one run is not that of all: its numbers are of those that the motor was fitted to.
    let (one, _) = of(&again[..1]);
    assert!(notes.is_empty() && whole.iter().all(|r| r.rmse_rpm < 5.0), "{notes:?} {:?}", whole[0].rmse_rpm);
    assert!((one[0].rmse_rpm - whole[0].rmse_rpm).abs() < 1e-9, "{} {}", one[0].rmse_rpm, whole[0].rmse_rpm);
    let (bare, notes) = of(&with(&[], again));
    assert!(notes.iter().any(|n| n.contains("load")) && bare[0].rmse_rpm > 20.0, "{notes:?} {:?}", bare[0].rmse_rpm);
    let broken = text.replace("largest_load", "# largest_load");
    assert!(Model::parse("m.toml", &broken).unwrap_err().to_string().contains("needs largest_load"));
}

/// Fails if the same load, not recorded, is taken for nothing, or a column that never changes is used.
#[test]
fn a_load_that_was_not_measured_is_not_nothing() {
    let (d, _) = answer(with(&[], runs(true, false)));
    assert_ne!(d.verdict, Verdict::None);
    let mut steady = with(&[Beside::Load], runs(false, false));
    for run in &mut steady {
        let RunData::Drive { beside, .. } = &mut run.data else { continue };
        beside.values_mut().for_each(|v| v.fill(0.3));
    }
    let (d, outcome) = answer(steady);
    assert!(d.notes.iter().any(|n| n.contains("`load` never changes")), "{:?}", d.notes);
    assert!(outcome.own.iter().all(|e| e.name != "load_share"));
}

/// Fails if what goes with the temperature is not named where it was recorded, has another size, or is named where it was not.
#[test]
fn heating_is_named_by_the_temperature() {
    let (d, outcome) = answer(with(&[Beside::Temperature], runs(false, true)));
    assert_eq!(d.named(), ["heating"], "{:?} {:?}", d.suspected(), d.unknown);
    let loss = &d.effects.iter().find(|e| e.name == "heating").expect("it is named").parameters["loss_per_kelvin"];
    assert!((loss.value / LOSS_PER_KELVIN - 1.0).abs() < 0.1, "{loss:?}");
    let model = Model::of("warm", &outcome).expect("the runs are of one motor");
    let saved = Model::parse("saved.toml", &model.file(&d).expect("it can be written")).expect("it can be read");
    // A run alone has another mean temperature.
    let again = with(&[Beside::Temperature], runs(false, true));
    let (one, _) = saved.against(&[&again[2]]);
    assert!(one[0].rmse_rpm < 5.0, "{}", one[0].rmse_rpm);
    let (d, _) = answer(with(&[], runs(false, true)));
    assert!(!d.suspected().contains(&"heating") && d.verdict != Verdict::None, "{:?}", d.suspected());
    assert!(d.not_judged["heating"].contains("`temperature`"), "{:?}", d.not_judged);
}

/// Fails if columns about which there is nothing to find give a name, or one that is not used is not said to be.
#[test]
fn what_is_not_used_is_said() {
    let (d, _) = answer(runs(false, false));
    assert_eq!(d.verdict, Verdict::None, "{:?} {:?}", d.suspected(), d.unknown);
    for word in ["`current` is not used", "`reference` says that a controller"] {
        assert!(d.notes.iter().any(|n| n.contains(word)), "{word}: {:?}", d.notes);
    }
    let mut some = with(&[Beside::Load, Beside::Temperature], runs(false, false));
    let RunData::Drive { beside, .. } = &mut some[1].data else { unreachable!() };
    beside.clear();
    let (d, outcome) = answer(some);
    for word in ["`load` is in 2 of 3 runs: not used", "`temperature` is in 2 of 3 runs: not used"] {
        assert!(d.notes.iter().any(|n| n.contains(word)), "{word}: {:?}", d.notes);
    }
    assert!(outcome.own.iter().all(|e| e.name != "load_share"));
}
