//! The full statistical suite: how often the diagnosis finds what is hidden, and how often it errs.
//!
//! `cargo run --release -p twum-tests --example detection -- [--scale 1.0] [--out docs/detection.md]`
//! Every data set is drawn from a stated seed; `--scale` multiplies the number of data sets of every part; `--shift 50000`
//! takes other seeds than those the thresholds were chosen on.
//! `--only NAME,NAME [--rho 1]` looks at single effects alone, and prints a line a data set.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Instant;
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_host::diagnose::{Options, diagnose};
use twum_host::model::motor::Motor;
use twum_host::model::parameters::{Flavour, Parameters};
use twum_host::record::measurement::{Direction, Format, Measurement, Run, RunData, RunKind};
use twum_tests::experiment::{DataSet, Design, Sealed};
use twum_tests::hidden::{Hidden, OPEN_LOOP, OUTSIDE};

/// Pairs that one measurement of this design need not tell apart; the answer may be the set.
const DECLARED: [(&str, &str); 8] = [
    ("preload-runout", "encoder-eccentricity"),
    ("dead-zone", "start-delay"),
    ("resonance-heating", "run-in-wear"),
    ("supply-sag", "high-duty-saturation"),
    ("supply-sag", "resonance-heating"),
    ("dead-zone", "high-duty-saturation"),
    ("dead-zone", "stribeck-friction"),
    ("start-delay", "stribeck-friction"),
];

fn declared(a: &str, b: &str) -> bool {
    DECLARED.iter().any(|(p, q)| (*p == a && *q == b) || (*p == b && *q == a))
}

fn measurement(data: &DataSet) -> Measurement {
    let runs = data
        .runs
        .iter()
        .map(|r| Run {
            id: r.id.clone(),
            kind: RunKind::Speed,
            file: String::new(),
            format: Format::Levels,
            duty: Some(r.duty),
            direction: Some(if r.sign > 0.0 { Direction::Cw } else { Direction::Ccw }),
            pwm_hz: r.pwm_hz,
            drive_on_s: Some(r.seconds),
            pwm_phase_s: 0.0,
            aligned: false,
            order: Some(r.order as u32),
            control: None,
            data: RunData::Levels { start_us: 0.0, period_us: 1000.0, levels: r.levels.clone() },
        })
        .collect();
    Measurement {
        name: "sealed".into(),
        motor: "pcbmotor-30mm".into(),
        edges_per_rev: 400,
        runs,
        folder: "sealed".into(),
    }
}

/// The answer's number that stands for what was hidden, where the two have one in common.
fn size_of(name: &str) -> Option<&'static str> {
    Some(match name {
        "dead-zone" => "threshold_duty",
        "start-delay" => "delay_s",
        "direction-asymmetry" => "speed_asymmetry",
        "unequal-edges" => "high_slot_excess",
        "clock-error" => "relative_clock_error",
        "supply-sag" => "speed_lost_at_full_duty",
        "encoder-eccentricity" => "eccentricity_rad",
        _ => return None,
    })
}

fn answer(data: &DataSet, seed: u64, without: &[&str]) -> Diagnosis {
    answer_with(data, seed, without, None)
}

fn answer_with(data: &DataSet, seed: u64, without: &[&str], motor: Option<Parameters>) -> Diagnosis {
    let without = without.iter().map(|s| (*s).to_owned()).collect();
    let options = Options { seed, without, motor, ..Options::default() };
    diagnose(&[measurement(data)], &options, &|_, _| {}).expect("generated data can be diagnosed").0
}

fn hide(sealed: &Sealed, name: &'static str, rho: f64, seed: u64) -> (Hidden, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut hidden = Hidden::draw(name, &mut rng);
    let achieved = sealed.scale_to(&mut hidden, rho);
    (hidden, achieved)
}

#[derive(Default)]
struct Count {
    hits: usize,
    of: usize,
}

impl Count {
    fn add(&mut self, hit: bool) {
        self.hits += usize::from(hit);
        self.of += 1;
    }

    /// Share with its 95 % Wilson interval.
    fn text(&self) -> String {
        if self.of == 0 {
            return "—".to_owned();
        }
        let (n, p) = (self.of as f64, self.hits as f64 / self.of as f64);
        let z = 1.96;
        let centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
        let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
        format!(
            "{}/{} = {:.0} % ({:.0}–{:.0})",
            self.hits,
            self.of,
            100.0 * p,
            100.0 * (centre - half),
            100.0 * (centre + half)
        )
    }
}

/// Smallest diagonal and largest other cell of the confusion of what is not declared to look alike, each with where it is. The cell of an
/// effect and a name is the share of the answers to that effect in which the name is suspected.
fn separable(confusion: &BTreeMap<(&str, String), usize>) -> [String; 2] {
    let mut diagonal = (1.0, String::new());
    let mut other = (0.0, String::new());
    for name in OPEN_LOOP {
        let answers: Vec<(&String, f64)> =
            confusion.iter().filter(|((n, _), _)| *n == name).map(|((_, says), k)| (says, *k as f64)).collect();
        let total: f64 = answers.iter().map(|a| a.1).sum();
        let share = |k: f64| k / total.max(1.0);
        let suspects = |says: &str, of: &str| says.split('+').any(|s| s == of);
        let found: f64 = answers.iter().filter(|a| suspects(a.0, name)).map(|a| a.1).sum();
        if total > 0.0 && share(found) < diagonal.0 {
            diagonal = (share(found), format!(" ({name}, {found} of {total})"));
        }
        for rival in OPEN_LOOP.into_iter().filter(|r| *r != name && !declared(name, r)) {
            let said: f64 = answers.iter().filter(|a| suspects(a.0, rival)).map(|a| a.1).sum();
            if share(said) > other.0 {
                other = (share(said), format!(" ({rival} where {name} is hidden, {said} of {total})"));
            }
        }
    }
    [diagonal, other].map(|(value, place)| format!("{value:.2}{place}"))
}

fn look_at(names: &[&str], rho: f64, seeds: u64) {
    for name in OPEN_LOOP.into_iter().filter(|n| names.contains(n)) {
        for seed in 1000..1000 + seeds {
            let sealed = Sealed::new(Design::small(), seed);
            let (hidden, achieved) = hide(&sealed, name, rho, seed);
            let d = answer(&sealed.make(&[hidden]), seed, &[]);
            println!("{name} rho {achieved:.2} seed {seed}: {} {}", d.verdict.word(), d.suspected().join("+"));
        }
    }
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|k| args.get(k + 1));
    let scale: f64 = value("--scale").map_or(1.0, |s| s.parse().expect("--scale takes a number"));
    let shift: u64 = value("--shift").map_or(0, |s| s.parse().expect("--shift takes a number"));
    let out = value("--out").cloned();
    let times = |n: usize| ((n as f64 * scale).round() as usize).max(1) as u64;
    let start = Instant::now();
    if let Some(only) = value("--only") {
        let rho = value("--rho").map_or(1.0, |s| s.parse().expect("--rho takes a number"));
        look_at(&only.split(',').collect::<Vec<_>>(), rho, times(8));
        return;
    }
    let mut doc = String::new();

    // Nothing hidden.
    let mut named = Count::default();
    let mut verdicts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut floor: BTreeMap<u64, f64> = BTreeMap::new();
    for seed in shift + 1..=shift + times(200) {
        let data = Sealed::new(Design::small(), seed).make(&[]);
        let d = answer(&data, seed, &[]);
        named.add(!d.suspected().is_empty());
        *verdicts.entry(d.verdict.word()).or_default() += 1;
        if !d.suspected().is_empty() {
            eprintln!("null seed {seed}: {:?} {:?}", d.verdict, d.suspected());
        }
        floor.insert(seed, d.baseline.scores.rmse_speed_rpm.unwrap_or(0.0));
    }
    eprintln!("null: {} {verdicts:?} after {:.0} s", named.text(), start.elapsed().as_secs_f64());
    let null_line = format!("{}; verdicts {verdicts:?}", named.text());

    // One effect at a time.
    let strengths = [0.5, 1.0, 2.0];
    let mut power: BTreeMap<(&str, usize), Count> = BTreeMap::new();
    let mut total: Vec<Count> = strengths.iter().map(|_| Count::default()).collect();
    let mut confusion: BTreeMap<(&str, String), usize> = BTreeMap::new();
    let mut wrong = Count::default();
    let mut in_set = Count::default();
    let mut conflict_wrong = Count::default();
    let mut coverage: BTreeMap<&str, Count> = BTreeMap::new();
    let mut bias: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut shares: Vec<f64> = Vec::new();
    let mut unreached: BTreeMap<&str, usize> = BTreeMap::new();
    for (k, rho) in strengths.iter().enumerate() {
        for name in OPEN_LOOP {
            for seed in shift + 1000..shift + 1000 + times(if *rho == 1.0 { 8 } else { 4 }) {
                let sealed = Sealed::new(Design::small(), seed);
                let (hidden, achieved) = hide(&sealed, name, *rho, seed);
                if achieved < 0.8 * rho {
                    *unreached.entry(name).or_default() += 1;
                    continue;
                }
                let data = sealed.make(std::slice::from_ref(&hidden));
                let d = answer(&data, seed, &[]);
                let suspected = d.suspected();
                let named = d.named();
                let found = suspected.contains(&name) && suspected.iter().all(|s| *s == name || declared(s, name));
                power.entry((name, k)).or_default().add(found);
                total[k].add(found);
                let says = if suspected.is_empty() { d.verdict.word().to_owned() } else { suspected.join("+") };
                eprintln!("{name} rho {achieved:.2} seed {seed}: {says}");
                wrong.add(named.iter().any(|n| *n != name));
                if *rho >= 1.0 {
                    *confusion.entry((name, says)).or_default() += 1;
                    if DECLARED.iter().any(|(a, b)| *a == name || *b == name) {
                        in_set.add(suspected.contains(&name));
                        conflict_wrong.add(!named.is_empty() && !suspected.contains(&name));
                    }
                }
                let judged = d.effects.iter().find(|e| e.name == name && e.status != "rejected");
                if let (Some(truth), Some(parameter), Some(e)) = (hidden.comparable(), size_of(name), judged)
                    && let Some(p) = e.parameters.get(parameter)
                {
                    coverage.entry(name).or_default().add(p.ci95[0] <= truth && truth <= p.ci95[1]);
                    bias.entry(name).or_default().push(p.value / truth);
                }
                if let Some(base) = d.baseline.scores.rmse_speed_rpm
                    && found
                {
                    let clean = answer(&sealed.make(&[]), seed, &[]).baseline.scores.rmse_speed_rpm.unwrap_or(base);
                    let oracle = 1.0 - clean / base;
                    let ours = 1.0 - d.extended.rmse_speed_rpm.unwrap_or(base) / base;
                    if oracle > 0.03 && seed < shift + 1002 {
                        shares.push(ours / oracle);
                    }
                }
            }
        }
        eprintln!("rho {rho}: {} after {:.0} s", total[k].text(), start.elapsed().as_secs_f64());
    }

    // Outside the library, and truth removed from it.
    let mut outside = Count::default();
    let mut outside_wrong = Count::default();
    for name in OUTSIDE {
        for seed in shift + 2000..shift + 2000 + times(6) {
            let sealed = Sealed::new(Design::small(), seed);
            let (hidden, _) = hide(&sealed, name, 1.0, seed);
            let d = answer(&sealed.make(&[hidden]), seed, &[]);
            eprintln!("{name} seed {seed}: {:?} {:?}", d.verdict, d.suspected());
            outside.add(d.verdict == Verdict::Unknown);
            outside_wrong.add(!d.named().is_empty());
        }
    }
    let mut removed: [BTreeMap<&str, [Count; 2]>; 2] = [BTreeMap::new(), BTreeMap::new()];
    for (removed, design) in removed.iter_mut().zip([Design::small(), Design::two_frequencies()]) {
        for name in OPEN_LOOP {
            for seed in shift + 3000..shift + 3000 + times(3) {
                let sealed = Sealed::new(design.clone(), seed);
                let (hidden, achieved) = hide(&sealed, name, 1.0, seed);
                if achieved < 0.8 {
                    continue;
                }
                let d = answer(&sealed.make(&[hidden]), seed, &[name]);
                eprintln!("without {name} seed {seed} {:?} Hz: {:?} {:?}", design.pwm_hz, d.verdict, d.suspected());
                let counts = removed.entry(name).or_default();
                counts[0].add(d.verdict == Verdict::Unknown);
                counts[1].add(!d.named().is_empty());
            }
        }
    }

    // A motor file of quite another motor: the shipped one's physical flavour has ten times the generator's friction.
    let far = Motor::shipped("pcbmotor-30mm").expect("it is shipped").parameters(Flavour::Physical);
    let mut far_named = Count::default();
    let mut far_wrong = Count::default();
    let mut far_covered = Count::default();
    for seed in shift + 1..=shift + times(20) {
        let sealed = Sealed::new(Design::small(), seed);
        far_wrong.add(!answer_with(&sealed.make(&[]), seed, &[], Some(far)).named().is_empty());
    }
    for name in ["dead-zone", "start-delay", "supply-sag", "direction-asymmetry", "unequal-edges", "clock-error"] {
        for seed in shift + 1000..shift + 1000 + times(4) {
            let sealed = Sealed::new(Design::small(), seed);
            let (hidden, achieved) = hide(&sealed, name, 1.0, seed);
            if achieved < 0.5 {
                continue;
            }
            let truth = hidden.comparable();
            let d = answer_with(&sealed.make(&[hidden]), seed, &[], Some(far));
            eprintln!("far file, {name} seed {seed}: {:?} {:?}", d.verdict, d.suspected());
            far_named
                .add(d.suspected().iter().all(|s| *s == name || declared(name, s)) && d.suspected().contains(&name));
            far_wrong.add(d.named().iter().any(|n| *n != name));
            let size = d.effects.iter().find(|e| e.name == name).and_then(|e| e.parameters.get(size_of(name)?));
            if let (Some(truth), Some(p)) = (truth, size) {
                far_covered.add(p.ci95[0] <= truth && truth <= p.ci95[1]);
            }
        }
    }

    // Two at once.
    let pairs = [
        ("resonance-heating", "preload-runout"),
        ("dead-zone", "direction-asymmetry"),
        ("unequal-edges", "high-duty-saturation"),
        ("clock-error", "encoder-eccentricity"),
        ("frequency-settling", "supply-sag"),
        ("run-in-wear", "direction-asymmetry"),
    ];
    let mut both = Count::default();
    let mut third = Count::default();
    for (a, b) in pairs {
        for seed in shift + 4000..shift + 4000 + times(3) {
            let sealed = Sealed::new(Design::small(), seed);
            let (first, _) = hide(&sealed, a, 1.0, seed);
            let (second, _) = hide(&sealed, b, 1.0, seed + 1);
            let d = answer(&sealed.make(&[first, second]), seed, &[]);
            let suspected = d.suspected();
            eprintln!("{a} and {b} seed {seed}: {:?} {suspected:?}", d.verdict);
            both.add(suspected.contains(&a) && suspected.contains(&b));
            third.add(d.named().iter().any(|n| *n != a && *n != b));
        }
    }

    let minutes = start.elapsed().as_secs_f64() / 60.0;
    let mut w = |s: String| {
        doc.push_str(&s);
        doc.push('\n');
    };
    w("# How often the diagnosis finds what is hidden, and how often it errs\n".into());
    w(format!(
        "Printed by `cargo run --release -p twum-tests --example detection -- --scale {scale} --shift {shift} --out docs/detection.md` on {} in {minutes:.0} \
         minutes of a shared two-core machine. Data come from the generator of the `tests` crate, which shares no model code with the host; \
         each data set is 36 runs (6 duties, both directions, 3 trials of 2.5 s, levels at 1 ms). Intervals are 95 % Wilson intervals.\n",
        date()
    ));
    w("| test | measured | accept |\n|---|---|---|".into());
    w(format!("| nothing hidden (seeds {}–{}), any name | {null_line} | ≤ 2 % |", shift + 1, shift + times(200)));
    for (k, rho) in strengths.iter().enumerate() {
        w(format!(
            "| found at ρ = {rho} (alone, or in a set of its declared conflicts) | {} | {} |",
            total[k].text(),
            ["≥ 80 %", "≥ 95 %", "monotone"][k]
        ));
    }
    w(format!("| a wrong name among the named, ρ ≥ 0.5 | {} | ≤ 5 % |", wrong.text()));
    let [diagonal, other] = separable(&confusion);
    w(format!("| confusion of separable pairs, ρ ≥ 1: smallest diagonal | {diagonal} | ≥ 0.85 |"));
    w(format!("| confusion of separable pairs, ρ ≥ 1: largest other cell | {other} | ≤ 0.05 |"));
    w(format!("| declared conflicts, ρ ≥ 1: truth in the set | {} | ≥ 95 % |", in_set.text()));
    w(format!("| declared conflicts, ρ ≥ 1: wrong single name | {} | ≤ 5 % |", conflict_wrong.text()));
    for (removed, at) in removed.iter().zip(["one PWM frequency", "two PWM frequencies"]) {
        let (mut u, mut n) = (Count::default(), Count::default());
        for c in removed.values() {
            u.hits += c[0].hits;
            u.of += c[0].of;
            n.hits += c[1].hits;
            n.of += c[1].of;
        }
        w(format!("| truth removed from the library, {at}: unknown | {} | ≥ 80 % |", u.text()));
        w(format!("| truth removed from the library, {at}: wrong name | {} | ≤ 10 % |", n.text()));
    }
    w(format!("| effects of no library: unknown | {} | ≥ 80 % |", outside.text()));
    w(format!("| effects of no library: wrong name | {} | ≤ 10 % |", outside_wrong.text()));
    w(format!("| motor file of ten times the friction, ρ = 1: found | {} | |", far_named.text()));
    w(format!(
        "| motor file of ten times the friction, nothing hidden or ρ = 1: wrong name | {} | |",
        far_wrong.text()
    ));
    w(format!("| motor file of ten times the friction: 95 % intervals cover | {} | |", far_covered.text()));
    w(format!("| two at once: both found | {} | ≥ 70 % |", both.text()));
    w(format!("| two at once: a third named | {} | |", third.text()));
    let mut all = Count::default();
    for c in coverage.values() {
        all.hits += c.hits;
        all.of += c.of;
    }
    w(format!("| 95 % intervals cover the hidden number | {} | 90–98 % |", all.text()));
    shares.sort_by(f64::total_cmp);
    let median = shares.get(shares.len() / 2).copied().unwrap_or(f64::NAN);
    w(format!("| gain over what an oracle removes, median of {} | {:.0} % | ≥ 80 % |", shares.len(), 100.0 * median));
    w("\n## Power by effect\n\n| effect | ρ = 0.5 | ρ = 1 | ρ = 2 | strength not reachable |\n|---|---|---|---|---|"
        .into());
    for name in OPEN_LOOP {
        let cell = |k: usize| power.get(&(name, k)).map_or("—".to_owned(), |c| format!("{}/{}", c.hits, c.of));
        w(format!(
            "| {name} | {} | {} | {} | {} |",
            cell(0),
            cell(1),
            cell(2),
            unreached.get(name).copied().unwrap_or(0)
        ));
    }
    w("\nA strength counts as not reachable when no admissible size of the effect leaves that much after the motor's own parameters are refitted: \
       the refit has swallowed it, and no analysis of such data could see it.\n\n## What was answered (ρ ≥ 1)\n\n| hidden | answer | times |\n|---|---|---|"
        .into());
    for ((name, says), count) in &confusion {
        w(format!("| {name} | {says} | {count} |"));
    }
    w("\n## Coverage by effect\n\nThe hidden form differs from the fitted one, so the fitted number need not tend to the hidden one: the ratio shows \
       that bias.\n\n| effect | covered | fitted over hidden, median |\n|---|---|---|"
        .into());
    for (name, c) in &coverage {
        let mut ratios = bias[name].clone();
        ratios.sort_by(f64::total_cmp);
        w(format!("| {name} | {}/{} | {:.3} |", c.hits, c.of, ratios[ratios.len() / 2]));
    }
    w("\n## Truth removed, by effect\n\nAt 50 Hz alone, and at 50 and 100 Hz.\n\n| effect | unknown | wrong name | unknown, two frequencies | wrong name, two frequencies |\n|---|---|---|---|---|"
        .into());
    for name in OPEN_LOOP {
        let cell = |k: usize, what: usize| {
            removed[k].get(name).map_or("—".to_owned(), |c| format!("{}/{}", c[what].hits, c[what].of))
        };
        w(format!("| {name} | {} | {} | {} | {} |", cell(0, 0), cell(0, 1), cell(1, 0), cell(1, 1)));
    }
    let mut text = String::new();
    let _ = write!(text, "{doc}");
    println!("{text}");
    if let Some(path) = out {
        std::fs::write(&path, text).expect("the document can be written");
    }
}

/// Today, from the system clock (days since 1970 turned into a civil date).
fn date() -> String {
    let days =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_secs() / 86400) as i64;
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let day = doy - (153 * mp + 2) / 5 + 1;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}
