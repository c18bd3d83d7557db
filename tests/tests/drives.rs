//! The diagnosis of ordinary motors: drives drawn at random in which something, or nothing, is hidden, and records that are not what
//! they say.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_host::diagnose::{Options, diagnose};
use twum_host::record::measurement::{DriveResponse, Measurement, Run, RunData, RunKind};
use twum_tests::drives::{Drive, Hidden, Record};

fn answer(records: Vec<Record>) -> Diagnosis {
    let run = |(i, r): (usize, Record)| {
        let response = DriveResponse::SpeedRpm(r.rpm);
        Run::new(format!("r{i}"), RunKind::Speed, RunData::Drive { time_us: r.time_us, input: r.input, response })
    };
    let runs = records.into_iter().enumerate().map(run).collect();
    let folder =
        Measurement { name: "drive".into(), motor: "inertial".into(), edges_per_rev: 0, runs, folder: "d".into() };
    diagnose(&[folder], &Options { quick: true, ..Options::default() }, &|_, _| {}).expect("it can be diagnosed").0
}

/// A drive whose record is short enough for a test.
fn drawn(hidden: Hidden, seed: u64) -> Vec<Record> {
    Drive::draw(hidden, seed).lengthened(400, 2).make()
}

/// A name out of nothing is the worst error: motors of all sizes, lags on no grid, inputs of all shapes.
#[test]
fn perfect_linear_motors_get_no_name() {
    let wrong: Vec<(u64, Vec<String>)> = (1..=12u64)
        .into_par_iter()
        .filter_map(|seed| {
            let d = answer(drawn(Hidden::Nothing, seed));
            let names = d.suspected().into_iter().map(str::to_owned).collect::<Vec<_>>();
            (d.verdict != Verdict::None).then_some((seed, names))
        })
        .collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Fails if what is hidden is no longer found, or another name comes with it.
#[test]
fn what_is_hidden_in_a_drive_is_found_and_nothing_else() {
    let kinds = [Hidden::Coulomb, Hidden::DeadZone, Hidden::Saturation, Hidden::Asymmetry, Hidden::Load];
    let asked: Vec<(Hidden, u64)> = kinds.into_iter().flat_map(|h| (101..=104).map(move |seed| (h, seed))).collect();
    let answers: Vec<(Hidden, u64, Diagnosis)> =
        asked.into_par_iter().map(|(h, seed)| (h, seed, answer(drawn(h, seed)))).collect();
    let told = |d: &Diagnosis, h: Hidden| d.suspected().iter().any(|n| h.names().contains(n));
    for (hidden, seed, d) in &answers {
        assert!(d.named().iter().all(|n| hidden.names().contains(n)), "{hidden:?} {seed}: {:?}", d.named());
    }
    let found = answers.iter().filter(|(h, _, d)| told(d, *h)).count();
    let missed: Vec<(Hidden, u64)> = answers.iter().filter(|(h, _, d)| !told(d, *h)).map(|a| (a.0, a.1)).collect();
    assert!(found >= 18, "{found} of 20; not {missed:?}");
}

/// Two runs of a linear motor of 900 rpm and so many seconds' lag, sampled every 5 ms.
fn linear(gain: f64, lag_s: f64) -> Vec<Record> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut run = || {
        let levels: Vec<f64> = (0..60).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut speed = 0.0;
        let mut record = Record { time_us: Vec::new(), input: Vec::new(), rpm: Vec::new() };
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

/// Fails if a record that cannot be what it says gets a name, or no word.
#[test]
fn a_record_that_is_not_what_it_says_is_questioned() {
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
    let cases: Vec<(&str, Vec<Record>, &str)> = vec![
        ("ms for µs", of(&|r| r.time_us.iter_mut().for_each(|t| *t /= 1e3)), "time_us"),
        ("a constant input", of(&|r| r.input.fill(0.5)), "input never changes"),
        ("no motion", of(&|r| r.rpm.fill(0.0)), "no run shows motion"),
        ("too fast", of(&|r| r.rpm.iter_mut().for_each(|v| *v *= 1e3)), "no motor turns so fast"),
        ("swapped columns", of(&|r| std::mem::swap(&mut r.input, &mut r.rpm)), "columns swapped"),
        ("one sign flipped", one(&|r| r.rpm.iter_mut().for_each(|v| *v = -*v)), "not of one motor"),
        ("one run in rad/s", one(&|r| r.rpm.iter_mut().for_each(|v| *v *= 0.10472)), "not of one motor"),
        ("another motor", mixed, "not of one motor"),
    ];
    for (what, records, word) in cases {
        let d = answer(records);
        assert!(d.suspected().is_empty(), "{what}: {:?}", d.suspected());
        assert!(d.notes.iter().any(|n| n.contains(word)), "{what}: {:?}", d.notes);
    }
    let d = answer(good());
    assert_eq!(d.verdict, Verdict::None, "{:?}", d.suspected());
    assert!(!d.notes.iter().any(|n| n.contains("closed loop") || n.contains("not of one motor")), "{:?}", d.notes);
}

/// A linear motor under a PI controller with noise on its speed: the input is made from what is measured.
#[test]
fn a_closed_loop_is_said_to_be_one_and_names_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut run = || {
        let targets: Vec<f64> = (0..20).map(|_| rng.random_range(-600.0..600.0)).collect();
        let (mut speed, mut integral) = (0.0, 0.0);
        let mut record = Record { time_us: Vec::new(), input: Vec::new(), rpm: Vec::new() };
        for k in 0..800 {
            let measured = speed + 4.0 * rng.random_range(-1.7..1.7);
            let error = targets[k / 40] - measured;
            integral += error * 5e-3;
            let input = 2e-3 * error + 0.02 * integral;
            record.time_us.push(5e3 * k as f64);
            record.input.push(input);
            record.rpm.push(measured);
            speed = 900.0 * input + (speed - 900.0 * input) * (-5e-3_f64 / 0.08).exp();
        }
        record
    };
    let d = answer(vec![run(), run(), run()]);
    assert!(d.suspected().is_empty(), "{:?}", d.suspected());
    assert!(d.notes.iter().any(|n| n.contains("closed loop")), "{:?}", d.notes);
}
