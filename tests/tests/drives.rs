//! The diagnosis of ordinary motors: drives drawn at random in which something, or nothing, is hidden, and records that are not what
//! they say.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use twum_host::diagnose::answer::{Diagnosis, EffectAnswer, Verdict};
use twum_host::diagnose::{Details, Options, diagnose};
use twum_host::record::measurement::{DriveResponse, Measurement, Run, RunData, RunKind};
use twum_tests::drives::{Drive, Hidden, Record};

fn answer(records: Vec<Record>) -> Diagnosis {
    answer_with(records).0
}

fn answer_with(records: Vec<Record>) -> (Diagnosis, Option<Details>) {
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
    diagnose(&[folder], &Options { quick: true, ..Options::default() }, &|_, _| {}).expect("it can be diagnosed")
}

/// A drive whose record is short enough for a test.
fn drawn(hidden: Hidden, seed: u64) -> Vec<Record> {
    Drive::draw(&[hidden], seed).lengthened(400, 2).make()
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

/// Fails if an order of the angle is no longer seen, or what is outside the line's reach gets another name: encoders that keep their zero, a
/// speed alone, a closed loop.
#[test]
fn cogging_is_found_in_its_order() {
    let answers: Vec<(u64, Diagnosis)> = [71_001, 71_004, 71_005, 71_008, 71_013]
        .into_par_iter()
        .map(|seed| (seed, answer(Drive::draw_any(&[Hidden::Cogging], seed).make())))
        .collect();
    for (seed, d) in &answers {
        assert_eq!(d.named(), ["cogging"], "{seed}: {:?} {:?}", d.suspected(), d.unknown);
        let size = &d.effects.iter().find(|e| e.name == "cogging").expect("it is named").parameters;
        let order = Drive::draw_any(&[Hidden::Cogging], *seed).ripples();
        assert_eq!(size["cogging_order"].value, order, "{seed}");
    }
}

/// Fails if a delay that sines of other frequencies show as other lags is taken for other motors.
#[test]
fn a_delay_under_sines_is_no_other_motor() {
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
fn windows_of_an_encoder_are_no_closed_loop() {
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

/// Seeds from which nothing in the diagnosis was chosen.
const UNSEEN: u64 = 30_001;

/// A share with its 95 % Wilson interval, in per cent.
fn share(hits: usize, of: usize) -> String {
    if of == 0 {
        return "–".to_owned();
    }
    let (n, p, z) = (of as f64, hits as f64 / of as f64, 1.96_f64);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt() / (1.0 + z * z / n);
    format!(
        "{hits}/{of} = {:.0} % ({:.0}–{:.0})",
        100.0 * p,
        100.0 * (middle - half).max(0.0),
        100.0 * (middle + half).min(1.0)
    )
}

/// A number that was said, and what it is.
#[derive(Debug)]
struct Told {
    name: &'static str,
    value: f64,
    interval: [f64; 2],
    truth: f64,
}

impl Told {
    fn is_held(&self) -> bool {
        self.interval[0] <= self.truth && self.truth <= self.interval[1]
    }
}

/// One motor drawn at random, and what was said of it.
struct Case {
    hidden: Vec<Hidden>,
    seed: u64,
    answer: Diagnosis,
    /// Every number that has a truth.
    numbers: Vec<Told>,
    seconds: f64,
}

impl Case {
    fn of(hidden: Vec<Hidden>, seed: u64) -> Self {
        let drive = Drive::draw_any(&hidden, seed);
        let records = drive.make();
        let begun = std::time::Instant::now();
        let truth = drive.truth(&records);
        let (answer, details) = answer_with(records);
        let own = |name: &str| match &details {
            Some(Details::Inertial(outcome)) => {
                outcome.own.iter().find(|e| e.name == name).map(|e| (e.value, e.interval))
            }
            _ => None,
        };
        let said = |name: &str| {
            let suspected = answer.effects.iter().filter(|e| e.status != "rejected");
            let of = suspected.filter_map(|e| e.parameters.get(name)).next();
            of.map(|p| (p.value, p.ci95)).or_else(|| own(name))
        };
        let told = |(name, truth)| said(name).map(|(value, interval)| Told { name, value, interval, truth });
        let numbers: Vec<Told> = truth.into_iter().filter_map(told).collect();
        let seconds = begun.elapsed().as_secs_f64();
        println!(
            "{hidden:?} {seed}: {:?} named {:?} suspected {:?} unknown {:?}; {}; {numbers:?} {seconds:.1} s",
            answer.verdict,
            answer.named(),
            answer.suspected(),
            answer.unknown.iter().map(|u| u.lives_in.as_str()).collect::<Vec<_>>(),
            drive.describe()
        );
        Self { hidden, seed, answer, numbers, seconds }
    }

    /// Alone or in a set of at most three.
    fn found(&self, hidden: Hidden) -> bool {
        let set = self.answer.suspected();
        set.iter().any(|n| hidden.names().contains(n)) && (set.len() <= 2 + self.hidden.len())
    }

    fn named(&self, hidden: Hidden) -> bool {
        self.answer.named().iter().any(|n| hidden.names().contains(n))
    }

    fn wrong_name(&self) -> bool {
        self.answer.named().iter().any(|n| !self.hidden.iter().any(|h| h.names().contains(n)))
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

/// The table of what is found and of what is said wrongly; `TWUM_WRITE_DOCS` writes it to docs/drives.md. `TWUM_DRIVES` divides the
/// numbers of motors, `TWUM_DRIVES_FROM` is the first seed.
#[test]
#[ignore = "340 motors: cargo test --release -p twum-tests --test drives -- --ignored --nocapture three_hundred"]
fn three_hundred_drives() {
    let number = |name: &str, otherwise: u64| {
        std::env::var(name).ok().and_then(|v| v.parse().ok()).filter(|v| *v > 0).unwrap_or(otherwise)
    };
    let (part, from) = (number("TWUM_DRIVES", 1), number("TWUM_DRIVES_FROM", UNSEEN));
    let mut asked: Vec<(Vec<Hidden>, u64)> = Vec::new();
    let mut next = from;
    let mut ask = |hidden: &[Hidden], times: u64| {
        for _ in 0..times.div_ceil(part) {
            asked.push((hidden.to_vec(), next));
            next += 1;
        }
    };
    let singles: Vec<Hidden> = Hidden::ALL.into_iter().filter(|h| *h != Hidden::Nothing).collect();
    ask(&[Hidden::Nothing], 100);
    singles.iter().filter(|h| **h != Hidden::Cogging).for_each(|h| ask(&[*h], 20));
    let pairs = [
        [Hidden::Coulomb, Hidden::Saturation],
        [Hidden::Coulomb, Hidden::Asymmetry],
        [Hidden::DeadZone, Hidden::Load],
        [Hidden::Load, Hidden::DeadTime],
        [Hidden::Saturation, Hidden::Asymmetry],
    ];
    pairs.iter().for_each(|p| ask(p, 10));
    [Hidden::Cogging, Hidden::Warmth].iter().for_each(|h| ask(&[*h], 25));
    let cases: Vec<Case> = asked.into_par_iter().map(|(hidden, seed)| Case::of(hidden, seed)).collect();
    let of = |keep: &dyn Fn(&Case) -> bool| cases.iter().filter(|c| keep(c)).collect::<Vec<_>>();
    let count = |some: &[&Case], hit: &dyn Fn(&Case) -> bool| share(some.iter().filter(|c| hit(c)).count(), some.len());
    let known = |c: &Case| singles.contains(&c.hidden[0]);
    let null = of(&|c| c.hidden == [Hidden::Nothing]);
    let single = of(&|c| c.hidden.len() == 1 && known(c));
    let pair = of(&|c| c.hidden.len() == 2);
    let outside = of(&|c| !known(c) && c.hidden != [Hidden::Nothing]);
    let mut table = String::from("| test | measured | accept |\n|---|---|---|\n");
    let mut row = |what: &str, measured: String, accept: &str| {
        table.push_str(&format!("| {what} | {measured} | {accept} |\n"));
    };
    row("nothing hidden: any name", count(&null, &|c| !c.answer.named().is_empty()), "≤ 2 %");
    row("nothing hidden: `none`", count(&null, &|c| c.answer.verdict == Verdict::None), "≥ 95 %");
    row("one effect: alone or in a set of at most 3", count(&single, &|c| c.found(c.hidden[0])), "≥ 92 %");
    row("two effects: both", count(&pair, &|c| c.hidden.iter().all(|h| c.found(*h))), "≥ 75 %");
    row("two effects: at least one", count(&pair, &|c| c.hidden.iter().any(|h| c.found(*h))), "≥ 97 %");
    row("a wrong name, all", count(&of(&|_| true), &Case::wrong_name), "≤ 3 %");
    row("outside the library: `unknown`", count(&outside, &|c| c.answer.verdict == Verdict::Unknown), "≥ 85 %");
    row("outside the library: a name", count(&outside, &|c| !c.answer.named().is_empty()), "≤ 10 %");
    // What is said with a probability is right as often, and an interval holds the truth as often, as it says; an interval where what is
    // hidden was found without a wrong name beside it.
    let sure = cases.iter().flat_map(|c| c.answer.effects.iter().map(move |e| (c, e)));
    let sure: Vec<_> = sure.filter(|(_, e)| e.status == "named" && e.probability.is_some_and(|p| p >= 0.95)).collect();
    let right = |(c, e): &&(&Case, &EffectAnswer)| c.hidden.iter().any(|h| h.names().contains(&e.name.as_str()));
    row("named with a probability ≥ 0.95: right", share(sure.iter().filter(right).count(), sure.len()), "≥ 93 %");
    let judged = |c: &&Case| {
        let found = c.hidden.iter().all(|h| c.found(*h) || *h == Hidden::Nothing);
        found && !c.wrong_name() && c.hidden[0] != Hidden::Warmth
    };
    let numbers: Vec<&Told> = cases.iter().filter(judged).flat_map(|c| &c.numbers).collect();
    let held = |some: &[&Told]| share(some.iter().filter(|n| n.is_held()).count(), some.len());
    row("95 % intervals that hold the truth, all", held(&numbers), "90 to 98 %");
    let mut names: Vec<&str> = numbers.iter().map(|n| n.name).collect();
    names.sort_unstable();
    names.dedup();
    table.push_str("\n| number | 95 % intervals that hold the truth | error of the middle one | half width of the middle one |\n|---|---|---|---|\n");
    for name in names {
        let some: Vec<&Told> = numbers.iter().copied().filter(|n| n.name == name).collect();
        let middle = |of: &dyn Fn(&Told) -> f64| {
            let mut all: Vec<f64> = some.iter().map(|n| 100.0 * of(n) / n.truth.abs()).collect();
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        };
        let (error, half) =
            (middle(&|n| (n.value - n.truth).abs()), middle(&|n| 0.5 * (n.interval[1] - n.interval[0])));
        table.push_str(&format!("| `{name}` | {} | {error:.1} % | {half:.1} % |\n", held(&some)));
    }
    table.push_str("\n| hidden | found | named | a wrong name | `none` |\n|---|---|---|---|---|\n");
    for h in singles.iter().chain(&[Hidden::Warmth]) {
        let some = of(&|c| c.hidden == [*h]);
        let n = |hit: &dyn Fn(&Case) -> bool| some.iter().filter(|c| hit(c)).count();
        table.push_str(&format!(
            "| {h:?} | {}/{} | {} | {} | {} |\n",
            n(&|c| c.found(*h)),
            some.len(),
            n(&|c| c.named(*h)),
            n(&Case::wrong_name),
            n(&|c| c.answer.verdict == Verdict::None)
        ));
    }
    let longest = cases.iter().map(|c| c.seconds).fold(0.0, f64::max);
    println!("{table}\nlongest {longest:.1} s; seeds {from} to {}", cases.iter().map(|c| c.seed).max().unwrap_or(from));
    if std::env::var_os("TWUM_WRITE_DOCS").is_some() {
        let less = if part == 1 { String::new() } else { format!("TWUM_DRIVES={part} ") };
        let text = format!(
            "# Ordinary motors: how often the diagnosis finds what is hidden, and how often it errs\n\nPrinted by `TWUM_WRITE_DOCS=1 {less}cargo test --release \
             -p twum-tests --test drives -- --ignored --nocapture three_hundred` from {} motors that nothing in the diagnosis was chosen on (seeds from \
             {from}): orders of magnitude of gain, lag, noise and sampling, seven shapes of input, one of them a closed loop, and three kinds of sensor are \
             drawn. Sizes are not scaled to what the record can show. Intervals are 95 % Wilson intervals.\n\n{table}",
            cases.len()
        );
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/drives.md");
        std::fs::write(path, text).expect("docs can be written");
    }
    assert!(cases.iter().filter(|c| c.wrong_name()).count() * 10 <= cases.len(), "more than one wrong name in ten");
}
