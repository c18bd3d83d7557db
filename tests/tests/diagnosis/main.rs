//! The diagnosis against data in which something, or nothing, is hidden: the thinned suite (the full one is the
//! `detection` example), real data, and bad input.

mod cases;
mod loops;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_host::diagnose::{Options, diagnose};
use twum_host::model::effects::EffectSet;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant, Solver};
use twum_host::model::parameters::Flavour;
use twum_host::model::plant::{Drive as PlantDrive, Plant};
use twum_host::record::measurement::{Direction, Format, LevelEdge, Measurement, Run, RunData};
use twum_shared::Direction as Pin;
use twum_tests::experiment::{Design, Sealed};
use twum_tests::hidden::Hidden;
use twum_tests::twins::twins;

fn small() -> Design {
    Design { trials: 2, seconds: 1.5, ..Design::small() }
}

/// Writes the folder and reads it back, as a user would.
fn answered(sealed: &Sealed, hidden: impl IntoIterator<Item = Hidden>, options: &Options) -> Diagnosis {
    let hidden: Vec<Hidden> = hidden.into_iter().collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    sealed.make(&hidden).write(folder.path(), "sealed").expect("the folder can be written");
    let measurement = Measurement::load(folder.path()).expect("the folder can be read");
    diagnose(&[measurement], options, &|_, _| {}).expect("it can be diagnosed").0
}

fn through_a_folder(hidden: &[Hidden], seed: u64, without: &[&str]) -> Diagnosis {
    let options = Options { seed, without: without.iter().map(|s| (*s).to_owned()).collect(), ..Options::default() };
    answered(&Sealed::new(small(), seed), hidden.iter().cloned(), &options)
}

fn hide(name: &'static str, rho: f64, seed: u64) -> Hidden {
    let mut hidden = Hidden::draw(name, &mut ChaCha8Rng::seed_from_u64(seed));
    Sealed::new(small(), seed).scale_to(&mut hidden, rho);
    hidden
}

/// A name out of nothing is the worst error; the full suite measures its rate.
#[test]
fn nothing_hidden_names_nothing() {
    nothing_is_named(1..=2);
}

/// The same of two more.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_nothing_hidden_names_nothing() {
    nothing_is_named(3..=4);
}

fn nothing_is_named(seeds: RangeInclusive<u64>) {
    for seed in seeds {
        let d = through_a_folder(&[], seed, &[]);
        assert_eq!(d.verdict, Verdict::None, "seed {seed}: {:?}", d.suspected());
    }
}

/// The averaged motor model driven for 1.2 s, its edges timed to a microsecond.
fn timed_edges(flavour: Flavour, duty: f64, direction: Direction, start_pitch: f64) -> RunData {
    let parameters = Motor::pcbmotor_30mm().parameters(flavour);
    let mut plant = MotorPlant::new(parameters, flavour, Solver::Averaged, &EffectSet::default(), History::default());
    let pitch = std::f64::consts::TAU / 400.0;
    let place = |plant: &MotorPlant| start_pitch + plant.position_rad() / pitch;
    let level = |place: f64| place.rem_euclid(2.0) < 1.0;
    let pin = if direction == Direction::Cw { Pin::Cw } else { Pin::Ccw };
    let mut edges = Vec::new();
    let mut before = place(&plant);
    for step in 0..28_000_u32 {
        let t = f64::from(step) * 50e-6;
        let on = t < 1.2 && t.rem_euclid(0.02) >= 0.02 * (1.0 - duty) - 1e-9;
        plant.advance(t + 50e-6, PlantDrive { level: f64::from(u8::from(on)), direction: pin, duty }, &mut |_| {});
        let now = place(&plant);
        if level(now) != level(before) {
            let edge = if now > before { now.floor() } else { before.floor() };
            let time_us = ((t + 50e-6 * (edge - before) / (now - before)) * 1e6).round();
            edges.push(LevelEdge { time_us, level: level(now) });
        }
        before = now;
    }
    RunData::Edges { initial: level(start_pitch), start_us: 0.0, edges, end_us: 1.4e6 }
}

/// The model itself, timed so well that everything is certain. Fails if the rotor equation misses the averaged model, which it stands for, by
/// more than the half per cent of the speed below which nothing is named, or if what it misses gets a name (a start delay, in flavour
/// `thesis`).
#[test]
fn timed_edges_of_the_motor_model_name_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    Sealed::new(small(), 1).make(&[]).write(folder.path(), "template").expect("the folder can be written");
    let mut measurement = Measurement::load(folder.path()).expect("the folder can be read");
    let run = measurement.runs[0].clone();
    for (flavour, coasting) in [(Flavour::Physical, false), (Flavour::Thesis, true)] {
        measurement.runs.clear();
        for (order, duty) in [0.6, 0.2, 1.0, 0.4, 0.8, 0.2, 0.6, 0.4, 1.0, 0.8].into_iter().enumerate() {
            for (k, direction) in [Direction::Cw, Direction::Ccw].into_iter().enumerate() {
                let order = 2 * order + k;
                measurement.runs.push(Run {
                    id: format!("r{order}"),
                    format: Format::Edges,
                    duty: Some(duty),
                    direction: Some(direction),
                    drive_on_s: Some(1.2),
                    order: Some(order as u32),
                    data: timed_edges(flavour, duty, direction, 0.09 * order as f64),
                    ..run.clone()
                });
            }
        }
        let motor = Some(Motor::pcbmotor_30mm().parameters(flavour));
        let options = Options { motor, coasting, ..Options::default() };
        let d = diagnose(std::slice::from_ref(&measurement), &options, &|_, _| {}).expect("it can be diagnosed").0;
        assert_eq!(d.verdict, Verdict::None, "{flavour:?}: {:?} {:?}", d.suspected(), d.unknown);
        let missed = d.baseline.scores.rmse_speed_rpm.expect("speeds were compared");
        assert!(missed < 0.1, "{flavour:?}: {missed} rpm of 23 to 30 rpm");
    }
}

/// Fails if the friction's refit swallows the dead zone again, or the sampling bends it: the hidden threshold is known.
#[test]
fn a_dead_zone_comes_with_its_threshold() {
    let hidden = hide("dead-zone", 1.5, 12);
    let truth = hidden.comparable().expect("the two forms have the number in common");
    let d = through_a_folder(&[hidden], 12, &[]);
    let p = &d.effects.iter().find(|e| e.name == "dead-zone").expect("it was judged").parameters["threshold_duty"];
    assert!((p.value - truth).abs() < 0.25 * truth && p.ci95[0] < truth && truth < p.ci95[1], "{truth} {p:?}");
}

/// Fails if the numbers hang on a motor file that is of quite another motor: the shipped one's friction is ten times the hidden one's. At one
/// frequency a start delay beside a top that is flat over the last 3 % of the duty does as well.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_motor_file_that_is_far_off_does_not_move_the_numbers() {
    let sealed = Sealed::new(Design::two_frequencies(), 1000);
    let mut hidden = Hidden::draw("dead-zone", &mut ChaCha8Rng::seed_from_u64(1000));
    sealed.scale_to(&mut hidden, 1.0);
    let truth = hidden.comparable().expect("the two forms have the number in common");
    let motor = Motor::shipped("pcbmotor-30mm").expect("it is shipped").parameters(Flavour::Physical);
    let d = answered(&sealed, [hidden], &Options { motor: Some(motor), ..Options::default() });
    assert_eq!(d.named(), ["dead-zone"], "{:?}", d.effects.iter().take(3).collect::<Vec<_>>());
    let found = &d.effects.iter().find(|e| e.name == "dead-zone").expect("it is named").parameters["threshold_duty"];
    // The wave's time takes up a part: the interval has to say so.
    assert!((found.value - truth).abs() < 0.25 * truth, "{truth} {found:?}");
    assert!(found.ci95[0] < truth && truth < found.ci95[1], "{truth} {found:?}");
}

/// What is hidden, looked for without its effect.
fn taken_out(name: &'static str, design: Design) -> Diagnosis {
    let sealed = Sealed::new(design, 3001);
    let mut hidden = Hidden::draw(name, &mut ChaCha8Rng::seed_from_u64(3001));
    sealed.scale_to(&mut hidden, 1.0);
    let options = Options { without: vec![name.to_owned()], ..Options::default() };
    answered(&sealed, [hidden], &options)
}

fn lends_its_data_to_no_other(name: &'static str, design: Design) {
    let d = taken_out(name, design);
    let suspected = d.suspected();
    assert!(d.verdict != Verdict::None, "{name}");
    let alike = |other: &&str| twins(other, name) || suspected.iter().any(|t| twins(t, name) && twins(t, other));
    assert!(suspected.iter().all(alike), "{name}: {} {suspected:?}", d.verdict.word());
}

/// Fails if the data of a cause that is not in the library go to another that does not look like it: nothing else does what an asymmetry does.
#[test]
fn a_cause_that_is_not_in_the_library_lends_its_data_to_no_other() {
    lends_its_data_to_no_other("direction-asymmetry", small());
}

/// The same of a saturation: only its twins, or what looks like these, may be suspected of it.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_saturation_that_is_not_in_the_library_lends_its_data_to_its_twins() {
    lends_its_data_to_no_other("high-duty-saturation", Design::two_frequencies());
}

/// A twin may be suspected for want of the right cause, and should not be named.
#[test]
#[ignore = "known shortfall: a dead zone is named for a saturation that is not in the library"]
fn a_twin_is_not_named_for_want_of_the_right_cause() {
    let d = taken_out("high-duty-saturation", Design::two_frequencies());
    assert!(d.named().is_empty(), "{:?}", d.named());
}

/// Fails if an effect is no longer found, or comes with a wrong name beside it.
fn is_found_alone(name: &str, d: &Diagnosis) {
    let suspected = d.suspected();
    assert!(suspected.contains(&name), "{name}: {:?} {suspected:?}", d.verdict);
    assert!(d.named().iter().all(|n| *n == name), "{name}: {suspected:?}");
}

/// Two that others look like, and two that do not.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_hidden_effects_are_found_without_being_told() {
    for name in ["preload-runout", "clock-error", "unequal-edges", "duty-quantisation"] {
        is_found_alone(name, &through_a_folder(&[hide(name, 1.5, 11)], 11, &[]));
    }
}

/// The same motor, experiment and noise with nothing hidden say how much of the error goes with what is hidden. Fails if that is not found, or the
/// gain is a constant, or that of the runs that were fitted, or if the p-value is small whatever is there, or the width of a slot drifts.
#[test]
fn what_is_hidden_is_found_and_gain_and_chance_are_those_of_an_oracle() {
    let clean = through_a_folder(&[], 11, &[]);
    let left_rpm = clean.baseline.scores.rmse_speed_rpm.expect("there are runs to score");
    for (name, rho) in [("direction-asymmetry", 1.5), ("unequal-edges", 2.5), ("frequency-settling", 1.5)] {
        let hidden = hide(name, rho, 11);
        let truth = hidden.comparable();
        let d = through_a_folder(&[hidden], 11, &[]);
        is_found_alone(name, &d);
        let oracle = 1.0 - left_rpm / d.baseline.scores.rmse_speed_rpm.expect("there are runs to score");
        let effect = d.effects.iter().find(|e| e.name == name).expect("it was judged");
        assert!((effect.gain_heldout - oracle).abs() < 0.05, "{name}: {} where {oracle} goes", effect.gain_heldout);
        assert!(effect.p_null <= 0.01, "{name}: {}", effect.p_null);
        if name == "unequal-edges" {
            let (truth, p) = (truth.expect("it is hidden"), &effect.parameters["high_slot_excess"]);
            assert!((p.value - truth).abs() < 0.15 * truth.abs(), "{truth} {p:?}");
            assert!(p.ci95[0] < p.value && p.value < p.ci95[1], "{p:?}");
        }
    }
    // p is that of the best of the whole library: 0.01 comes up once in a hundred such data sets.
    for effect in &clean.effects {
        assert!(effect.p_null > 0.01 && effect.gain_heldout.abs() < 0.02, "{effect:?}");
    }
}

/// Fails if something without a cause gets a name, or is overlooked, or is not described over the coordinate that it hangs on.
#[test]
fn what_no_effect_explains_is_unknown() {
    let d = through_a_folder(&[hide("outside-cogging", 1.5, 13)], 13, &[]);
    assert_eq!(d.verdict, Verdict::Unknown, "{:?} {:?}", d.suspected(), d.unknown);
    let json = serde_json::to_value(&d).expect("an answer always serialises");
    let strongest = &json["described"][0];
    assert!(strongest["coordinate"].as_str().is_some_and(|c| c.contains("angle")), "{strongest}");
    assert!(strongest["equation"].as_str().is_some_and(|e| e.contains("a7·cos(7θ")), "{strongest}");
    let numbers = strongest["parameters"].as_object().expect("numbers by name");
    assert!(
        !numbers.is_empty() && numbers.values().all(|n| n["ci95"][1].as_f64() > n["ci95"][0].as_f64()),
        "{strongest}"
    );
    assert!(strongest["gain_heldout"].as_f64().is_some_and(|g| g > 0.0), "{strongest}");
}

/// A notch in the speed-duty line around one duty is overlooked: the answer is `none`. At least nothing gets its name.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_notch_at_one_duty_names_nothing() {
    let d = through_a_folder(&[hide("outside-notch", 1.5, 14)], 14, &[]);
    assert!(d.named().is_empty(), "{:?}", d.suspected());
}

/// What the test above should find.
#[test]
#[ignore = "known shortfall: two trials of 1.5 s are too few for the null to see a notch at one duty; three of 2.5 s are enough"]
fn a_notch_at_one_duty_is_unknown() {
    let d = through_a_folder(&[hide("outside-notch", 1.5, 14)], 14, &[]);
    assert_eq!(d.verdict, Verdict::Unknown, "{:?} {:?}", d.suspected(), d.unknown);
}

/// Fails if lost words are no longer put back.
#[test]
fn lost_words_are_found() {
    let hidden = Hidden { size: 0.4, ..Hidden::draw("dropped-samples", &mut ChaCha8Rng::seed_from_u64(15)) };
    let d = through_a_folder(&[hidden], 15, &[]);
    assert_eq!(d.named(), ["dropped-samples"], "{:?}", d.verdict);
}

/// Fails if a choice is made that the seed does not decide, or that hangs on how many threads share the work.
#[test]
fn equal_seeds_give_equal_answers() {
    let sealed = Sealed::new(small(), 16);
    let answer = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = Options { seed: 16, quick: true, ..Options::default() };
        pool.install(|| answered(&sealed, [hide("direction-asymmetry", 1.0, 16)], &options))
    };
    assert_eq!(answer(1), answer(3));
}

fn measured(name: &str) -> PathBuf {
    PathBuf::from(std::env::var_os("TWUM_DATA").expect("TWUM_DATA names the folder of measured data")).join(name)
}

/// The answer of the command: from the motor file that the folder names.
fn answer(folder: &Path) -> Diagnosis {
    let measurement = Measurement::load(folder).expect("the folder can be read");
    let motor = Motor::shipped(&measurement.motor).ok().map(|m| m.parameters(Flavour::Physical));
    diagnose(&[measurement], &Options { motor, ..Options::default() }, &|_, _| {}).expect("it can be diagnosed").0
}

/// The real motor: two ripples a turn are the drive's, and one run is not a replication. Least squares with a slope and two
/// harmonics, fitted on the same turn, reaches 1.52 rpm.
#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn the_real_motor_has_runout() {
    let folder = measured("twum-speed");
    let d = answer(&folder);
    assert!(d.named().contains(&"preload-runout"), "{:?}", d.suspected());
    assert!(!d.replicated);
    let rmse = d.extended.rmse_speed_rpm.expect("there is speed");
    assert!(rmse < 1.52, "{rmse}");
    let settling = d.effects.iter().find(|e| e.name == "frequency-settling").expect("the start-up was judged");
    assert_ne!(settling.status, "named", "one start cannot be replicated");
}

/// An ordinary gear motor: its flattening top is found.
#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn the_gear_motor_has_a_flat_top() {
    let folder = measured("micromouse");
    let d = answer(&folder);
    assert!(d.suspected().contains(&"high-duty-saturation"), "{:?}", d.suspected());
}

/// The same motor does not move below an input of about 40 of 255 one way and 44 to 65 the other. Fails if a value is no
/// longer fitted together with the others.
#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn the_gear_motor_has_an_uneven_dead_zone() {
    let folder = measured("micromouse");
    let d = answer(&folder);
    let suspected = d.suspected();
    assert!(suspected.contains(&"dead-zone") && suspected.contains(&"direction-asymmetry"), "{suspected:?}");
    let zone = d.effects.iter().find(|e| e.name == "dead-zone").expect("it was found");
    let threshold = &zone.parameters["threshold"];
    assert!((0.14..0.22).contains(&threshold.value), "{threshold:?}");
}

fn folder_with(toml: &str, csv: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("measurement.toml"), toml).expect("it can be written");
    std::fs::write(folder.path().join("a.csv"), csv).expect("it can be written");
    folder
}

/// A motor that stands gives an answer, not a fit.
#[test]
fn no_motion_is_said() {
    let toml = "name = \"still\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\n\
                format = \"levels\"\nduty = 0.5\ndirection = \"cw\"\ndrive_on_s = 1.0\n";
    let mut csv = String::from("time_us,level\n");
    for k in 0..1000 {
        csv.push_str(&format!("{},0\n", k * 1000));
    }
    let folder = folder_with(toml, &csv);
    let d = answer(folder.path());
    assert!(d.notes.iter().any(|n| n.contains("no run shows motion")), "{:?}", d.notes);
    assert!(d.suspected().is_empty());
}

/// One duty in one direction: the answer says what it cannot say.
#[test]
fn one_duty_says_what_it_cannot_say() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let design = Design { duties: vec![0.5], trials: 5, seconds: 1.5, both_directions: false, ..Design::small() };
    Sealed::new(design, 21).make(&[]).write(folder.path(), "one").expect("the folder can be written");
    let d = answer(folder.path());
    assert!(d.baseline.scores.r2_speed.is_none());
    for name in ["dead-zone", "supply-sag", "direction-asymmetry"] {
        assert!(d.not_judged.contains_key(name), "{name}: {:?}", d.not_judged);
    }
    assert!(d.notes.iter().any(|n| n.contains("one duty only")), "{:?}", d.notes);
}
