//! How often the diagnosis of ordinary motors finds what is hidden, and how often it errs: docs/drives.md.

use super::answer_without;
use rayon::prelude::*;
use twum_host::diagnose::Details;
use twum_host::diagnose::answer::{Diagnosis, EffectAnswer, Verdict};
use twum_tests::drives::{Drive, Hidden};

/// Seeds from which nothing in the diagnosis was chosen.
const UNSEEN: u64 = 150_001;
/// Effects of which, where one is out of the library, another stands for it: all of the first hold the motor at small inputs, both of the second
/// make it faster one way than the other.
const TWINS: [&[&str]; 2] =
    [&["coulomb-friction", "dead-zone", "stribeck-friction"], &["direction-asymmetry", "load-bias"]];
/// Every name of the library: without them a line with a lag is left, as anyone fits it.
const LIBRARY: [&str; 11] = [
    "coulomb-friction",
    "dead-zone",
    "stribeck-friction",
    "direction-asymmetry",
    "load-bias",
    "high-duty-saturation",
    "dead-time",
    "second-lag",
    "coupling-resonance",
    "cogging",
    "heating",
];
/// What two fits of one motor may differ by: an oracle that gains no more is none.
const LEAST_ORACLE: f64 = 0.03;

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

/// A motor to be drawn.
#[derive(Debug, Clone)]
struct Asked {
    hidden: Vec<Hidden>,
    seed: u64,
    /// Whether what is hidden is taken out of the library.
    removed: bool,
}

/// One motor drawn at random, and what was said of it.
struct Case {
    asked: Asked,
    /// ρ of each that is hidden: [`Drive::rho`].
    rho: Vec<f64>,
    answer: Diagnosis,
    /// Every number that has a truth.
    numbers: Vec<Told>,
    /// Error that the extended model removes, over what goes with the effect itself.
    of_oracle: Option<f64>,
    seconds: f64,
}

impl Case {
    fn of(asked: Asked) -> Self {
        let hidden = &asked.hidden;
        let drive = Drive::draw_any(hidden, asked.seed);
        let records = drive.make();
        let truth = drive.truth(&records);
        let rho = hidden.iter().map(|h| drive.rho(*h, &records)).collect();
        let out: Vec<&str> = hidden.iter().filter(|_| asked.removed).flat_map(|h| h.names()).copied().collect();
        let begun = std::time::Instant::now();
        let (answer, details) = answer_without(records, &out);
        let seconds = begun.elapsed().as_secs_f64();
        let numbers = numbers(truth, &answer, details.as_ref());
        let alone = !asked.removed && hidden.len() == 1 && !hidden[0].names().is_empty();
        let of_oracle = if alone { of_oracle(&answer, &drive.without(hidden[0])) } else { None };
        let case = Self { asked, rho, answer, numbers, of_oracle, seconds };
        println!("{}; {}", case.told(), drive.describe());
        case
    }

    fn told(&self) -> String {
        let Self { asked, rho, answer, numbers, of_oracle, seconds } = self;
        let lives_in: Vec<&str> = answer.unknown.iter().map(|u| u.lives_in.as_str()).collect();
        format!(
            "{:?} {}{}: {:?} named {:?} suspected {:?} unknown {lives_in:?}; rho {rho:.2?}; of the oracle's gain {of_oracle:.2?}; {numbers:?} {seconds:.1} s",
            asked.hidden,
            asked.seed,
            if asked.removed { " removed" } else { "" },
            answer.verdict,
            answer.named(),
            answer.suspected(),
        )
    }

    fn hidden(&self) -> &[Hidden] {
        &self.asked.hidden
    }

    /// Whether the record shows all that is hidden.
    fn shows(&self) -> bool {
        self.rho.iter().all(|r| *r >= 1.0)
    }

    /// Named, or one of a set of at most three that cannot be told apart.
    fn found(&self, hidden: Hidden) -> bool {
        let ambiguous: Vec<&EffectAnswer> = self.answer.effects.iter().filter(|e| e.status == "ambiguous").collect();
        let small = |e: &&EffectAnswer| {
            let rivals = &e.conflicts_with;
            let in_set = |a: &&&EffectAnswer| a.name == e.name || rivals.is_empty() || rivals.contains(&a.name);
            ambiguous.iter().filter(in_set).count() <= 3
        };
        self.named(hidden) || ambiguous.iter().filter(|e| hidden.names().contains(&e.name.as_str())).any(small)
    }

    fn named(&self, hidden: Hidden) -> bool {
        self.answer.named().iter().any(|n| hidden.names().contains(n))
    }

    fn wrong_names(&self) -> impl Iterator<Item = &str> {
        self.answer.named().into_iter().filter(|n| !self.hidden().iter().any(|h| h.names().contains(n)))
    }

    fn wrong_name(&self) -> bool {
        self.wrong_names().next().is_some()
    }

    /// Whether all wrong names are those of twins of what was taken out of the library.
    fn only_twins(&self) -> bool {
        let own = |name: &&str| self.hidden().iter().any(|h| h.names().contains(name));
        self.wrong_names().all(|n| TWINS.iter().any(|t| t.contains(&n) && t.iter().any(own)))
    }

    /// Whether what is outside the library is told of where it lives.
    fn described(&self) -> bool {
        let place = self.hidden()[0].lives_in();
        self.answer.verdict == Verdict::Unknown && self.answer.unknown.iter().any(|u| u.lives_in.starts_with(place))
    }
}

/// Every number that has a truth, as it was told: of an effect, or of the motor itself.
fn numbers(truth: Vec<(&'static str, f64)>, answer: &Diagnosis, details: Option<&Details>) -> Vec<Told> {
    let own = |name: &str| match details {
        Some(Details::Inertial(outcome)) => outcome.own.iter().find(|e| e.name == name).map(|e| (e.value, e.interval)),
        _ => None,
    };
    let said = |name: &str| {
        let suspected = answer.effects.iter().filter(|e| e.status != "rejected");
        let of = suspected.filter_map(|e| e.parameters.get(name)).next();
        of.map(|p| (p.value, p.ci95)).or_else(|| own(name))
    };
    let told = |(name, truth)| said(name).map(|(value, interval)| Told { name, value, interval, truth });
    truth.into_iter().filter_map(told).collect()
}

/// The error that an answer removes on what was not fitted, over what goes with the effect itself: that of a line beside the same motor
/// without it.
fn of_oracle(answer: &Diagnosis, clean: &Drive) -> Option<f64> {
    let line = answer_without(clean.make(), &LIBRARY).0.baseline.scores.rmse_speed_rpm?;
    let base = answer.baseline.scores.rmse_speed_rpm?;
    let oracle = 1.0 - line / base;
    (oracle > LEAST_ORACLE).then(|| (1.0 - answer.extended.rmse_speed_rpm.unwrap_or(base) / base) / oracle)
}

/// What is drawn: all kinds, `part` of each, from a seed on.
fn asked(part: u64, from: u64) -> Vec<Asked> {
    let mut all: Vec<Asked> = Vec::new();
    let mut ask = |hidden: &[Hidden], times: u64, removed: bool| {
        for _ in 0..times.div_ceil(part) {
            all.push(Asked { hidden: hidden.to_vec(), seed: from + all.len() as u64, removed });
        }
    };
    ask(&[Hidden::Nothing], 60, false);
    let pairs = [
        [Hidden::Coulomb, Hidden::Saturation],
        [Hidden::Coulomb, Hidden::Asymmetry],
        [Hidden::DeadZone, Hidden::Load],
        [Hidden::Load, Hidden::DeadTime],
        [Hidden::Saturation, Hidden::Asymmetry],
    ];
    pairs.iter().for_each(|p| ask(p, 10, false));
    for hidden in Hidden::KNOWN {
        ask(&[hidden], 16, false);
        ask(&[hidden], 5, true);
    }
    ask(&[Hidden::Warmth], 24, false);
    all
}

/// The rows that the issue asks for, and what each number is worth.
struct Table {
    cases: Vec<Case>,
    text: String,
}

impl Table {
    fn of(&self, keep: impl Fn(&Case) -> bool) -> Vec<&Case> {
        self.cases.iter().filter(|c| keep(c)).collect()
    }

    fn row(&mut self, what: &str, measured: String, accept: &str) {
        self.text.push_str(&format!("| {what} | {measured} | {accept} |\n"));
    }

    /// How often what is hidden is found, and what else is said.
    fn rows(&mut self) {
        fn count(some: &[&Case], hit: impl Fn(&Case) -> bool) -> String {
            share(some.iter().filter(|c| hit(c)).count(), some.len())
        }
        let library = |c: &Case| !c.asked.removed && c.hidden().iter().all(|h| Hidden::KNOWN.contains(h));
        let null = self.of(|c| c.hidden() == [Hidden::Nothing]);
        let single = self.of(|c| library(c) && c.hidden().len() == 1 && c.shows());
        let pair = self.of(|c| library(c) && c.hidden().len() == 2 && c.shows());
        let faint = self.of(|c| library(c) && !c.shows());
        let outside = self.of(|c| c.hidden() == [Hidden::Warmth]);
        let removed = self.of(|c| c.asked.removed);
        let whole = self.of(|c| !c.asked.removed);
        let all = |c: &Case| c.hidden().iter().all(|h| c.found(*h));
        let twins = |c: &Case| c.wrong_name() && c.only_twins();
        let mut shares: Vec<f64> = self.cases.iter().filter(|c| c.shows()).filter_map(|c| c.of_oracle).collect();
        shares.sort_by(f64::total_cmp);
        let at = |q: f64| shares.get((q * shares.len() as f64) as usize).map_or(f64::NAN, |s| 100.0 * s);
        let rows = [
            ("nothing hidden: any name", count(&null, |c| !c.answer.named().is_empty()), "≤ 2 %"),
            ("nothing hidden: `none`", count(&null, |c| c.answer.verdict == Verdict::None), "≥ 95 %"),
            ("one effect, ρ ≥ 1: alone or in a set of at most 3", count(&single, all), "≥ 92 %"),
            ("two effects, each ρ ≥ 1: both", count(&pair, all), "≥ 75 %"),
            (
                "two effects, each ρ ≥ 1: at least one",
                count(&pair, |c| c.hidden().iter().any(|h| c.found(*h))),
                "≥ 97 %",
            ),
            ("one or two effects, ρ < 1 of one: all found", count(&faint, all), "–"),
            ("a wrong name, the whole library", count(&whole, Case::wrong_name), "≤ 3 %"),
            ("outside the library: `unknown`, its place told", count(&outside, Case::described), "≥ 85 %"),
            (
                "truth out of the library: a wrong name, no twin's",
                count(&removed, |c| c.wrong_name() && !twins(c)),
                "≤ 10 %",
            ),
            ("truth out of the library: the name of a twin", count(&removed, twins), "–"),
            (
                "error removed over what an oracle removes, median",
                format!("{:.0} % of {}", at(0.5), shares.len()),
                "≥ 90 %",
            ),
            ("the same, its worst tenth", format!("{:.0} %", at(0.1)), "≥ 60 %"),
        ];
        self.text.push_str("| test | measured | accept |\n|---|---|---|\n");
        rows.into_iter().for_each(|(what, measured, accept)| self.row(what, measured, accept));
    }

    /// What is said with a probability is right as often, and an interval holds the truth as often, as it says; an interval where what is
    /// hidden was found without a wrong name beside it.
    fn calibration(&mut self) {
        let whole = self.of(|c| !c.asked.removed);
        let sure = whole.iter().flat_map(|c| c.answer.effects.iter().map(move |e| (*c, e)));
        let sure: Vec<_> =
            sure.filter(|(_, e)| e.status == "named" && e.probability.is_some_and(|p| p >= 0.95)).collect();
        let right = |(c, e): &&(&Case, &EffectAnswer)| c.hidden().iter().any(|h| h.names().contains(&e.name.as_str()));
        let sure = share(sure.iter().filter(right).count(), sure.len());
        let judged = |c: &&&Case| {
            let found = c.hidden().iter().all(|h| c.found(*h) || *h == Hidden::Nothing);
            found && !c.wrong_name()
        };
        let numbers: Vec<&Told> = whole.iter().filter(judged).flat_map(|c| &c.numbers).collect();
        let held = |some: &[&Told]| share(some.iter().filter(|n| n.is_held()).count(), some.len());
        let mut names: Vec<&str> = numbers.iter().map(|n| n.name).collect();
        names.sort_unstable();
        names.dedup();
        let mut lines = String::from(
            "\n| number | 95 % intervals that hold the truth | error of the middle one | half width of the middle one |\n|---|---|---|---|\n",
        );
        for name in names {
            let some: Vec<&Told> = numbers.iter().copied().filter(|n| n.name == name).collect();
            let middle = |of: &dyn Fn(&Told) -> f64| {
                let mut all: Vec<f64> = some.iter().map(|n| 100.0 * of(n) / n.truth.abs()).collect();
                all.sort_by(f64::total_cmp);
                all[all.len() / 2]
            };
            let error = middle(&|n| (n.value - n.truth).abs());
            let half = middle(&|n| 0.5 * (n.interval[1] - n.interval[0]));
            lines.push_str(&format!("| `{name}` | {} | {error:.1} % | {half:.1} % |\n", held(&some)));
        }
        let all = held(&numbers);
        self.row("named with a probability ≥ 0.95: right", sure, "≥ 93 %");
        self.row("95 % intervals that hold the truth, all", all, "90 to 98 %");
        self.text.push_str(&lines);
    }

    /// What is said of each effect.
    fn effects(&mut self) {
        let mut lines = String::from(
            "\n| hidden alone, ρ ≥ 1 | found | named | a wrong name | `none` | wrong with it out of the library, twins apart |\n|---|---|---|---|---|---|\n",
        );
        for h in Hidden::KNOWN.iter().chain(&[Hidden::Warmth]) {
            let some = self.of(|c| c.hidden() == [*h] && !c.asked.removed && c.shows());
            let removed = self.of(|c| c.hidden() == [*h] && c.asked.removed);
            let n = |hit: &dyn Fn(&Case) -> bool| some.iter().filter(|c| hit(c)).count();
            lines.push_str(&format!(
                "| {h:?} | {}/{} | {} | {} | {} | {}/{} |\n",
                n(&|c| c.found(*h)),
                some.len(),
                n(&|c| c.named(*h)),
                n(&Case::wrong_name),
                n(&|c| c.answer.verdict == Verdict::None),
                removed.iter().filter(|c| c.wrong_name() && !c.only_twins()).count(),
                removed.len()
            ));
        }
        self.text.push_str(&lines);
    }
}

/// The table of what is found and of what is said wrongly; `TWUM_WRITE_DOCS` writes it to docs/drives.md. `TWUM_DRIVES` divides the
/// numbers of motors, `TWUM_DRIVES_FROM` is the first seed.
#[test]
#[ignore = "300 motors: cargo test --release -p twum-tests --test drives -- --ignored --nocapture three_hundred"]
fn three_hundred_drives() {
    let number = |name: &str, otherwise: u64| {
        std::env::var(name).ok().and_then(|v| v.parse().ok()).filter(|v| *v > 0).unwrap_or(otherwise)
    };
    let (part, from) = (number("TWUM_DRIVES", 1), number("TWUM_DRIVES_FROM", UNSEEN));
    let cases: Vec<Case> = asked(part, from).into_par_iter().map(Case::of).collect();
    let count = cases.len();
    let mut table = Table { cases, text: String::new() };
    table.rows();
    table.calibration();
    table.effects();
    let longest = table.cases.iter().map(|c| c.seconds).fold(0.0, f64::max);
    println!("{}\nlongest {longest:.1} s; {count} motors, seeds from {from}", table.text);
    if std::env::var_os("TWUM_WRITE_DOCS").is_some() {
        let less = if part == 1 { String::new() } else { format!("TWUM_DRIVES={part} ") };
        let text = format!(
            "# Ordinary motors: how often the diagnosis finds what is hidden, and how often it errs\n\nPrinted by `TWUM_WRITE_DOCS=1 {less}cargo test --release \
             -p twum-tests --test drives -- --ignored --nocapture three_hundred` from {count} motors that nothing in the diagnosis was chosen on (seeds from \
             {from}): orders of magnitude of gain, lag, noise and sampling, seven shapes of input, one of them a closed loop, and three kinds of sensor are \
             drawn. Sizes are not scaled to what the record can show; ρ says what it shows: the root mean square of what an effect does to the speeds, less \
             what gain, lag and initial speeds of a motor without it make of that, over that of the noise, from simulations of the generator without noise \
             (`tests/src/drives/visible.rs`). An oracle removes the error that goes with the effect itself. Intervals are 95 % Wilson intervals.\n\n{}",
            table.text
        );
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/drives.md");
        std::fs::write(path, text).expect("docs can be written");
    }
    let wrong = table.cases.iter().filter(|c| !c.asked.removed && c.wrong_name()).count();
    assert!(wrong * 10 <= count, "more than one wrong name in ten");
}
