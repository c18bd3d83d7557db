//! An effect that only its user knows: a formula, searched for like those of the library, saved and simulated.

use super::mirror::{DUTIES, Design, FLAVOUR, difference, measurement, traces};
use std::sync::Arc;
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_host::diagnose::motor::free_speed;
use twum_host::diagnose::saved::file;
use twum_host::diagnose::{Details, Options, diagnose};
use twum_host::model::effects::EffectSet;
use twum_host::model::hypothesis::{ActsOn, Formula, Hypothesis, Now};
use twum_host::model::motor::{Motor, parse_hypotheses};
use twum_host::model::parameters::Parameters;

/// A supply that swings slowly: the library has nothing that comes and goes.
const SWING: &str = r#"
[effects.mine]
says = "the supply swings"
acts_on = "speed"
change = "depth*sin(2*PI*time_s/period)"
[effects.mine.numbers]
depth = { typical = 0.1, min = -0.5, max = 0.5 }
period = { start = 0.7, min = 0.4, max = 1.2 }
"#;

/// A driver that gives less in one direction, the more the harder it is driven.
const LOPSIDED: &str = r#"
[effects.lopsided]
acts_on = "duty"
change = "-loss*duty*(1 + direction)/2"
[effects.lopsided.numbers]
loss = { typical = 0.1, min = -0.5, max = 0.5 }
"#;

fn hidden(text: &str, values: &[f64]) -> EffectSet {
    let hypothesis = read(text).remove(0);
    let mut effects = EffectSet::default();
    effects.put(Formula { hypothesis, values: values.to_vec(), voltage_per_speed: 1.0 });
    effects
}

fn read(text: &str) -> Vec<Arc<Hypothesis>> {
    parse_hypotheses("mine.toml", text).expect("the formulas can be read").into_iter().map(Arc::new).collect()
}

/// Relative change of the motor's speed over one of its voltage.
fn speed_per_voltage() -> f64 {
    let p = Motor::pcbmotor_30mm().parameters(FLAVOUR);
    let speed = |volts: f64| free_speed(Parameters { force_factor_n_v: volts * p.force_factor_n_v, ..p }, FLAVOUR);
    (speed(1.1) - speed(0.9)) / 0.2 / speed(1.0)
}

/// The answer, the saved motor, and by how much its runs miss those that were diagnosed.
fn asked(effects: &EffectSet, formulas: Option<&str>) -> (Diagnosis, Motor, f64) {
    let design = Design { duties: DUTIES, trials: 2, seconds: 1.5 };
    let motor = Motor::pcbmotor_30mm();
    let made = traces(design, motor.parameters(FLAVOUR), effects);
    let options = Options {
        motor: Some(motor.parameters(FLAVOUR)),
        formulas: formulas.map(read).unwrap_or_default(),
        ..Options::default()
    };
    let (d, details) = diagnose(&[measurement(design, &made)], &options, &|_, _| {}).expect("there is something");
    let details = details.expect("the runs can be used");
    let Details::Runs { problem, outcome } = &details else { panic!("they are a TWUM's") };
    let text = file(&motor, FLAVOUR, &outcome.extended, problem, &d).expect("it can be written");
    let saved =
        Motor::parse("saved.toml", &text).unwrap_or_else(|e| panic!("a saved model is a motor file: {e}\n{text}"));
    let replayed = traces(design, saved.parameters(FLAVOUR), &saved.effects());
    let off = difference(&made, &replayed);
    (d, saved, off)
}

/// Hides one of the two, and searches for both.
fn found_saved_and_repeated(text: &str, values: &[f64], [name, number]: [&str; 2]) {
    let effects = hidden(text, values);
    let (d, saved, off) = asked(&effects, Some(&[SWING, LOPSIDED].concat()));
    assert_eq!(d.named(), [name], "{}", twum_host::diagnose::answer::text(&d));
    let found = &d.effects[0].parameters[number];
    // Of a hidden voltage the speed shows less.
    let size = values[0] * if number == "depth" { speed_per_voltage() } else { 1.0 };
    assert!((found.value / size - 1.0).abs() < 0.1, "{number}: {found:?}, hidden {size}");
    assert_eq!(saved.effects().formulas.iter().map(|f| &f.hypothesis.name).collect::<Vec<_>>(), [name]);
    assert!(off < super::REPEATED, "the saved model is {off} off");
    let (without, ..) = asked(&effects, None);
    assert!(without.extended.rmse_speed_rpm > d.extended.rmse_speed_rpm, "the library has what was to be new to it");
}

/// Fails if the formula is not searched for, is given another's numbers, acts otherwise in the search than in the motor model, or is lost
/// when it is saved.
#[test]
fn a_formula_of_ones_own_is_found_saved_and_repeats_the_data() {
    found_saved_and_repeated(LOPSIDED, &[0.2], ["lopsided", "loss"]);
}

/// The same of one over time, that has a rate beside its size.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_formula_over_time_is_found_saved_and_repeats_the_data() {
    found_saved_and_repeated(SWING, &[0.1, 0.65], ["mine", "depth"]);
}

/// Fails if a formula that acts on nothing in the data is called a cause.
#[test]
fn a_formula_that_the_data_do_not_show_is_no_cause() {
    let (d, ..) = asked(&EffectSet::default(), Some(SWING));
    assert!(d.suspected().is_empty(), "{:?}", d.suspected());
}

/// Poles of the contact, five to the turn: nothing in the library goes with the angle more than four times a turn.
const POLES: &str = r#"
[effects.mine]
acts_on = "speed"
change = "depth*cos(5*turned_rad - 1)"
[effects.mine.numbers]
depth = { typical = 0.1, min = -0.5, max = 0.5 }
"#;

/// Fails if what has no cause is described over another coordinate, with another size or phase, or if the saved motor does not have it.
#[test]
fn what_has_no_cause_is_described_and_saved() {
    let depth = 0.08;
    let effects = hidden(POLES, &[depth]);
    let (d, saved, off) = asked(&effects, None);
    assert_eq!(d.verdict, Verdict::Unknown, "{:?}", d.suspected());
    let strongest = &d.described[0];
    assert!(strongest.coordinate.contains("angle") && strongest.equation.contains("cos(5θ"), "{strongest:?}");
    let amplitude = &strongest.parameters["a5"];
    let size = depth * speed_per_voltage();
    assert!((amplitude.value / size - 1.0).abs() < 0.15, "{amplitude:?}, hidden {size}");
    assert!(amplitude.ci95[0] < size && size < amplitude.ci95[1], "{amplitude:?}, hidden {size}");
    assert!(strongest.gain_heldout > 0.2, "{strongest:?}");
    let (saved, hidden) = (saved.effects(), effects);
    let (is, was) = (&saved.formulas[0], &hidden.formulas[0]);
    assert_eq!(is.hypothesis.name, "described");
    for k in 0..40 {
        let now = Now { turned_rad: 0.15 * f64::from(k), direction: 1.0, ..Now::default() };
        let [is, was] = [is, was].map(|e| e.voltage_per_speed * e.change_of(ActsOn::Speed, &now));
        assert!((is - was).abs() < 0.25 * depth, "{now:?}: {is}, hidden {was}");
    }
    assert!(off < super::REPEATED, "the saved model is {off} off");
}
