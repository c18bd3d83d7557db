//! The diagnosis of ordinary motors: drives drawn at random in which something, or nothing, is hidden, and records that are not what
//! they say.

mod table;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::ops::RangeInclusive;
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_host::diagnose::{Details, Options, diagnose};
use twum_host::record::measurement::{DriveResponse, Measurement, Run, RunData, RunKind};
use twum_tests::drives::{Drive, Hidden, Record};

fn answer(records: Vec<Record>) -> Diagnosis {
    answer_without(records, &[]).0
}

/// The answer of a library without some of its effects.
fn answer_without(records: Vec<Record>, names: &[&str]) -> (Diagnosis, Option<Details>) {
    let run = |(i, r): (usize, Record)| {
        let response = r.angle_rad.map_or(DriveResponse::SpeedRpm(r.rpm), DriveResponse::PositionRad);
        Run::new(
            format!("r{i}"),
            RunKind::Speed,
            RunData::Drive { time_us: r.time_us, input: r.input, response, beside: Default::default() },
        )
    };
    let runs = records.into_iter().enumerate().map(run).collect();
    let folder =
        Measurement { name: "drive".into(), motor: "inertial".into(), edges_per_rev: 0, runs, folder: "d".into() };
    let without = names.iter().map(|n| (*n).to_owned()).collect();
    diagnose(&[folder], &Options { quick: true, without, ..Options::default() }, &|_, _| {})
        .expect("it can be diagnosed")
}

/// A drive whose record is short enough for a test.
fn drawn(hidden: Hidden, seed: u64) -> Vec<Record> {
    Drive::draw(&[hidden], seed).lengthened(400, 2).make()
}

/// A name out of nothing is the worst error: motors of all sizes, lags on no grid, inputs of all shapes.
#[test]
fn perfect_linear_motors_get_no_name() {
    get_no_name(1..=2);
}

/// The same of four more.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_perfect_linear_motors_get_no_name() {
    get_no_name(3..=6);
}

fn get_no_name(seeds: RangeInclusive<u64>) {
    let wrong: Vec<(u64, Vec<String>)> = seeds
        .into_par_iter()
        .filter_map(|seed| {
            let d = answer(drawn(Hidden::Nothing, seed));
            let names = d.suspected().into_iter().map(str::to_owned).collect::<Vec<_>>();
            (d.verdict != Verdict::None).then_some((seed, names))
        })
        .collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// The same of a hundred whole records, with every sensor and loops among them.
#[test]
#[ignore = "takes minutes: cargo test --release -p twum-tests --test drives -- --ignored --nocapture a_hundred_perfect"]
fn a_hundred_perfect_linear_motors_get_no_name() {
    let said = |seed: u64| (seed, answer(Drive::draw_any(&[Hidden::Nothing], seed).make()));
    let all: Vec<(u64, Diagnosis)> = (60_001..=60_100).into_par_iter().map(said).collect();
    let none = all.iter().filter(|(_, d)| d.verdict == Verdict::None).count();
    println!("`none` of {none} of {}", all.len());
    let wrong: Vec<_> = all.iter().map(|(seed, d)| (seed, d.named())).filter(|w| !w.1.is_empty()).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Fails if what is hidden is no longer found, or another name comes with it.
#[test]
fn what_is_hidden_in_a_drive_is_found_and_nothing_else() {
    are_found_and_nothing_else(101..=101);
}

/// The same of three more motors of each.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_is_hidden_in_a_drive_is_found_and_nothing_else() {
    are_found_and_nothing_else(102..=104);
}

fn are_found_and_nothing_else(seeds: RangeInclusive<u64>) {
    let kinds = [Hidden::Coulomb, Hidden::DeadZone, Hidden::Saturation, Hidden::Asymmetry, Hidden::Load];
    let asked: Vec<(Hidden, u64)> = kinds.into_iter().flat_map(|h| seeds.clone().map(move |seed| (h, seed))).collect();
    let answers: Vec<(Hidden, u64, Diagnosis)> =
        asked.into_par_iter().map(|(h, seed)| (h, seed, answer(drawn(h, seed)))).collect();
    let told = |d: &Diagnosis, h: Hidden| d.suspected().iter().any(|n| h.names().contains(n));
    for (hidden, seed, d) in &answers {
        assert!(d.named().iter().all(|n| hidden.names().contains(n)), "{hidden:?} {seed}: {:?}", d.named());
    }
    let found = answers.iter().filter(|(h, _, d)| told(d, *h)).count();
    let missed: Vec<(Hidden, u64)> = answers.iter().filter(|(h, _, d)| !told(d, *h)).map(|a| (a.0, a.1)).collect();
    // One in ten may be missed: no motor shows everything.
    assert!(10 * found >= 9 * answers.len(), "{found} of {}; not {missed:?}", answers.len());
}

/// Fails if an order of the angle is no longer seen, or what is outside the line's reach gets another name: encoders that keep their zero, a
/// speed alone, a closed loop; rotors that turn through less than two teeth.
#[test]
fn cogging_is_found_in_its_order() {
    cogging_is_found([71_001]);
}

/// The same in six more motors.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_cogging_is_found_in_its_order() {
    cogging_is_found([71_004, 71_005, 71_008, 71_013, 16_016, 16_020]);
}

fn cogging_is_found<const N: usize>(seeds: [u64; N]) {
    let answers: Vec<(u64, Diagnosis)> =
        seeds.into_par_iter().map(|seed| (seed, answer(Drive::draw_any(&[Hidden::Cogging], seed).make()))).collect();
    for (seed, d) in &answers {
        assert_eq!(d.named(), ["cogging"], "{seed}: {:?} {:?}", d.suspected(), d.unknown);
        let size = &d.effects.iter().find(|e| e.name == "cogging").expect("it is named").parameters;
        let order = Drive::draw_any(&[Hidden::Cogging], *seed).ripples();
        assert_eq!(size["cogging_order"].value, order, "{seed}");
    }
}

/// Fails if a load that swings on its coupling is no longer seen, on either side of it, or has another frequency.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_coupling_is_found_with_its_frequency() {
    let answers: Vec<(u64, Diagnosis)> = [18_402, 18_404, 18_413]
        .into_par_iter()
        .map(|seed| (seed, answer(Drive::draw_any(&[Hidden::Coupling], seed).make())))
        .collect();
    for (seed, d) in &answers {
        assert_eq!(d.named(), ["coupling-resonance"], "{seed}: {:?} {:?}", d.suspected(), d.unknown);
        let told =
            d.effects.iter().find(|e| e.name == "coupling-resonance").expect("it is named").parameters["swing_s"].value;
        let truth = Drive::draw_any(&[Hidden::Coupling], *seed).truth(&[]);
        let (_, swing_s) = truth.into_iter().find(|t| t.0 == "swing_s").expect("it has one");
        assert!((told / swing_s - 1.0).abs() < 0.01, "{seed}: {told} {swing_s}");
    }
}

/// Fails if a swing that dies at once, that no input shakes or that is as slow as the lag, or a ripple of the torque over less than two of its
/// periods, is named for what is not in the library: nothing but a friction is.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_is_not_in_the_library_is_no_swing_and_no_ripple() {
    let asked = [
        (Hidden::Warmth, 80_323, Vec::new()),
        (Hidden::Warmth, 80_306, Vec::new()),
        (Hidden::DeadZone, 18_577, vec!["dead-zone"]),
        (Hidden::DeadZone, 80_151, vec!["dead-zone"]),
    ];
    for (hidden, seed, without) in asked {
        let d = answer_without(Drive::draw_any(&[hidden], seed).make(), &without).0;
        assert!(d.named().iter().all(|n| *n == "coulomb-friction"), "{seed}: {:?}", d.named());
    }
}

/// Fails if nothing is said of a form that is not the motor's: a load stands for an asymmetry that is not in the library.
#[test]
fn a_form_that_leaves_structure_says_so() {
    let d = answer_without(Drive::draw_any(&[Hidden::Asymmetry], 18_099).make(), &["direction-asymmetry"]).0;
    assert_eq!(d.named(), ["load-bias"], "{:?}", d.suspected());
    assert!(d.effects[0].note.contains("follows from sample to sample"), "{:?}", d.effects[0].note);
}

/// Fails if something small that an effect takes of an error gets a name beside the structure of all the rest.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_cogging_that_is_not_in_the_library_lends_its_error_to_no_other() {
    let d = answer_without(Drive::draw_any(&[Hidden::Cogging], 15_042).make(), &["cogging"]).0;
    assert_eq!((d.verdict, d.named().len()), (Verdict::Unknown, 0), "{:?}", d.suspected());
}

/// Fails if the error on what was not fitted is that of a form before it was refined: a friction that falls with the speed beside one that
/// falls at once, which misses by five times the noise.
#[test]
fn the_error_afterwards_is_that_of_the_refined_form() {
    let d = answer(Drive::draw_any(&[Hidden::Stribeck], 16_010).make());
    let [before, after] = [d.baseline.scores.rmse_speed_rpm, d.extended.rmse_speed_rpm].map(Option::unwrap);
    assert!(after < 0.15 * before, "{after} of {before} rpm");
}

/// Fails if a delay that sines of other frequencies show as other lags is taken for other motors.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_delay_under_sines_is_no_other_motor() {
    let d = answer(Drive::draw(&[Hidden::DeadTime], 5).lengthened(900, 3).make());
    assert!(!d.notes.iter().any(|n| n.contains("not of one motor")), "{:?}", d.notes);
    assert!(d.suspected().contains(&"dead-time"), "{:?} {:?}", d.suspected(), d.notes);
}

/// Fails if the sense in which speeds are counted changes what is found, or friction drives a motor that is counted the other way round.
#[test]
fn a_speed_counted_the_other_way_round_changes_nothing() {
    let mut records = drawn(Hidden::Coulomb, 101);
    let before = answer(records.clone());
    records.iter_mut().flat_map(|r| &mut r.rpm).for_each(|v| *v = -*v);
    let after = answer(records);
    assert_eq!(before.named(), ["coulomb-friction"]);
    assert_eq!(after.named(), before.named(), "{:?}", after.suspected());
    let size = |d: &Diagnosis| d.effects[0].parameters["coulomb"].value;
    assert!((size(&after) - size(&before)).abs() < 0.01 * size(&before), "{} {}", size(&after), size(&before));
}

/// Three runs of a linear motor of 900 rpm and so many seconds' lag, sampled every 5 ms.
fn linear(gain: f64, lag_s: f64) -> Vec<Record> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut run = || {
        let levels: Vec<f64> = (0..60).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut speed = 0.0;
        let mut record = Record { time_us: Vec::new(), input: Vec::new(), rpm: Vec::new(), angle_rad: None };
        for k in 0..600 {
            let input = levels[k / 10];
            record.time_us.push(5e3 * k as f64);
            record.input.push(input);
            record.rpm.push(speed + 4.0 * rng.random_range(-1.7..1.7));
            speed = gain * input + (speed - gain * input) * (-5e-3 / lag_s).exp();
        }
        record
    };
    vec![run(), run(), run()]
}

/// What is done to a record, the record, and a word of what is said of it.
type Spoilt = (&'static str, Vec<Record>, &'static str);

/// Records of a linear motor that are not what they say.
fn spoilt() -> Vec<Spoilt> {
    let good = || linear(900.0, 0.05);
    let of = |change: &dyn Fn(&mut Record)| {
        let mut records = good();
        records.iter_mut().for_each(change);
        records
    };
    let one = |change: &dyn Fn(&mut Record)| {
        let mut records = good();
        change(&mut records[1]);
        records
    };
    let mut mixed = good();
    mixed[2] = linear(2400.0, 0.15).remove(2);
    vec![
        ("µs for ms", of(&|r| r.time_us.iter_mut().for_each(|t| *t *= 1e3)), "long for a motor"),
        ("one run in turns a second", one(&|r| r.rpm.iter_mut().for_each(|v| *v /= 60.0)), "not of one motor"),
        ("input of zeros", of(&|r| r.input.fill(0.0)), "input never changes"),
        ("ms for µs", of(&|r| r.time_us.iter_mut().for_each(|t| *t /= 1e3)), "time_us"),
        ("a constant input", of(&|r| r.input.fill(0.5)), "input never changes"),
        ("no motion", of(&|r| r.rpm.fill(0.0)), "no run shows motion"),
        ("too fast", of(&|r| r.rpm.iter_mut().for_each(|v| *v *= 1e3)), "no motor turns so fast"),
        ("swapped columns", of(&|r| std::mem::swap(&mut r.input, &mut r.rpm)), "columns swapped"),
        ("one sign flipped", one(&|r| r.rpm.iter_mut().for_each(|v| *v = -*v)), "not of one motor"),
        ("one run in rad/s", one(&|r| r.rpm.iter_mut().for_each(|v| *v *= 0.10472)), "not of one motor"),
        ("another motor", mixed, "not of one motor"),
    ]
}

/// Fails if a record that cannot be what it says gets a name, or no word.
fn are_questioned(spoilt: impl Iterator<Item = Spoilt>) {
    for (what, records, word) in spoilt {
        let d = answer(records);
        assert!(d.suspected().is_empty(), "{what}: {:?}", d.suspected());
        assert!(d.notes.iter().any(|n| n.contains(word)), "{what}: {:?}", d.notes);
    }
}

/// Every second of them.
#[test]
fn a_record_that_is_not_what_it_says_is_questioned() {
    are_questioned(spoilt().into_iter().step_by(2));
}

/// The others.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_record_that_is_not_what_it_says_is_questioned() {
    are_questioned(spoilt().into_iter().skip(1).step_by(2));
}

/// Fails if what is asked of a record that is not what it says is asked of a sound one.
#[test]
fn a_sound_record_is_not_questioned() {
    let d = answer(linear(900.0, 0.05));
    assert_eq!(d.verdict, Verdict::None, "{:?}", d.suspected());
    assert!(!d.notes.iter().any(|n| n.contains("closed loop") || n.contains("not of one motor")), "{:?}", d.notes);
}

/// Three runs of a linear motor under a PI controller with noise on its speed; its target, its input or both stand as the input.
fn closed_loop(recorded: &dyn Fn(f64, f64) -> f64) -> Vec<Record> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut run = || {
        let targets: Vec<f64> = (0..20).map(|_| rng.random_range(-600.0..600.0)).collect();
        let (mut speed, mut integral) = (0.0, 0.0);
        let mut record = Record { time_us: Vec::new(), input: Vec::new(), rpm: Vec::new(), angle_rad: None };
        for k in 0..800 {
            let measured = speed + 4.0 * rng.random_range(-1.7..1.7);
            let error = targets[k / 40] - measured;
            integral += error * 5e-3;
            let input = 2e-3 * error + 0.02 * integral;
            record.time_us.push(5e3 * k as f64);
            record.input.push(recorded(input, targets[k / 40]));
            record.rpm.push(measured);
            speed = 900.0 * input + (speed - 900.0 * input) * (-5e-3_f64 / 0.08).exp();
        }
        record
    };
    vec![run(), run(), run()]
}

/// The input is made from what is measured.
#[test]
fn a_closed_loop_is_said_to_be_one_and_names_nothing() {
    let d = answer(closed_loop(&|input, _| input));
    assert!(d.suspected().is_empty(), "{:?}", d.suspected());
    assert!(d.notes.iter().any(|n| n.contains("closed loop")), "{:?}", d.notes);
}

/// Counts of an encoder give speeds of windows, in which inputs change: fails if such a window is taken to foretell the input.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_windows_of_an_encoder_are_no_closed_loop() {
    for seed in [10_058, 10_191] {
        let d = answer(Drive::draw_any(&[Hidden::Nothing], seed).make());
        assert_eq!(d.verdict, Verdict::None, "{seed}: {:?} {:?}", d.unknown, d.notes);
    }
}

/// What a loop makes of its reference is a linear system of a higher order: no cause.
#[test]
fn a_reference_that_stands_as_the_input_names_nothing() {
    let d = answer(closed_loop(&|_, target| target));
    assert!(d.named().is_empty(), "{:?}", d.named());
    println!("{:?} {:?} {:?}", d.verdict, d.suspected(), d.unknown);
}

/// The runs of a folder of measured data, each with its error in rpm on what was not fitted.
fn measured(name: &str, alone: bool) -> Vec<(String, Diagnosis, f64)> {
    let data =
        std::path::PathBuf::from(std::env::var_os("TWUM_DATA").expect("TWUM_DATA names the folder of measured data"));
    let all = Measurement::load(data.join(name)).expect("the folder can be read");
    let one = |run: &Run| Measurement { runs: vec![run.clone()], ..all.clone() };
    let folders = if alone { all.runs.iter().map(one).collect() } else { vec![all.clone()] };
    let told = |folder: Measurement| {
        let id = format!("{name} {:?}", folder.runs.iter().map(|r| r.id.as_str()).collect::<Vec<_>>());
        let d = diagnose(&[folder], &Options::default(), &|_, _| {}).expect("it can be diagnosed").0;
        println!("{id}: {:?} {:?} {:?}", d.verdict, d.suspected(), d.extended.rmse_speed_rpm);
        let error = d.extended.rmse_speed_rpm.unwrap_or(f64::INFINITY);
        (id, d, error)
    };
    folders.into_iter().map(told).collect()
}

/// Real motors with friction, and what a model of ten lines predicts of a run that it was not fitted to (the limits, in rpm).
#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn measured_motors_are_told_by_their_friction() {
    for (name, limit) in [("micromouse-more/delay-left", 9.2), ("micromouse-more/delay-right", 6.9), ("laas-sine", 6.9)]
    {
        let (id, d, error) = measured(name, false).remove(0);
        assert!(error <= limit, "{id}: {error} rpm");
        assert!(d.suspected().contains(&"coulomb-friction"), "{id}: {:?}", d.suspected());
        assert!(
            d.suspected().iter().all(|n| ["coulomb-friction", "dead-zone"].contains(n)),
            "{id}: {:?}",
            d.suspected()
        );
        assert!(matches!(d.verdict, Verdict::Named | Verdict::Ambiguous), "{id}: {:?}", d.verdict);
    }
    for (name, limit) in [("micromouse-more/cal-left", 18.3), ("micromouse-more/cal-right", 21.7)] {
        let (id, d, error) = measured(name, false).remove(0);
        assert!(error <= limit, "{id}: {error} rpm");
        assert!(
            ["dead-zone", "high-duty-saturation"].iter().all(|n| d.suspected().contains(n)),
            "{id}: {:?}",
            d.suspected()
        );
    }
}

/// Fails if a single run is said to show nothing, or is predicted much worse than beside others.
#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn measured_runs_alone_are_not_nothing() {
    for (id, d, _) in ["micromouse-more/delay-left", "micromouse-more/delay-right"].map(|n| measured(n, true)).concat()
    {
        assert!(matches!(d.verdict, Verdict::Named | Verdict::Ambiguous), "{id}: {:?}", d.verdict);
    }
    for (name, limit) in [("micromouse-more/cal-left", 18.3), ("micromouse-more/cal-right", 21.7)] {
        for (id, _, error) in measured(name, true) {
            assert!(error <= 1.3 * limit, "{id}: {error} rpm");
        }
    }
}

/// The time that long records take.
#[test]
#[ignore = "prints times: cargo test --release -p twum-tests --test drives -- --ignored --nocapture long_records --test-threads 1"]
fn long_records() {
    for samples in [40_000, 250_000] {
        for (hidden, seed) in
            [(Hidden::Nothing, 3), (Hidden::Coulomb, 1), (Hidden::Saturation, 4), (Hidden::DeadTime, 5)]
        {
            let records = Drive::draw(&[hidden], seed).lengthened(samples / 3, 3).make();
            let begun = std::time::Instant::now();
            let d = answer(records);
            println!(
                "{samples} samples in 3 runs, {hidden:?}: {:.1} s, {:?}",
                begun.elapsed().as_secs_f64(),
                d.named()
            );
        }
    }
}
