//! The tables of the suite, in Markdown.

use super::judge::{self, Outcome};
use crate::truth::Kind;
use crate::twins::twins;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Hits of some trials.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Count {
    /// How often.
    pub hits: usize,
    /// Of how many.
    pub of: usize,
}

impl Count {
    /// Counts over outcomes.
    pub fn over<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>, hit: impl Fn(&Outcome) -> bool) -> Self {
        let mut count = Self::default();
        outcomes.into_iter().for_each(|o| count.add(hit(o)));
        count
    }

    /// One more.
    pub fn add(&mut self, hit: bool) {
        self.hits += usize::from(hit);
        self.of += 1;
    }

    /// 95 % Wilson interval, as shares.
    pub fn wilson(&self) -> [f64; 2] {
        let (n, z) = (self.of as f64, 1.959_964);
        let p = self.hits as f64 / n;
        let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
        let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
        [(middle - half).max(0.0), (middle + half).min(1.0)]
    }

    /// `3/4 = 75 % (30–95)`.
    pub fn text(&self) -> String {
        if self.of == 0 {
            return "—".to_owned();
        }
        let [low, high] = self.wilson().map(|v| 100.0 * v);
        format!("{}/{} = {:.0} % ({low:.0}–{high:.0})", self.hits, self.of, 100.0 * self.hits as f64 / self.of as f64)
    }

    fn short(&self) -> String {
        if self.of == 0 { "—".to_owned() } else { format!("{}/{}", self.hits, self.of) }
    }
}

/// All tables.
pub fn markdown(outcomes: &[Outcome]) -> String {
    let mut text = String::new();
    for part in [
        summary(outcomes),
        by_effect(outcomes),
        by_strength(outcomes),
        confusion(outcomes),
        pairs(outcomes),
        outside(outcomes),
        removed(outcomes),
        closed(outcomes),
        coverage(outcomes),
        reliability(outcomes),
        failures(outcomes),
    ] {
        text.push_str(&part);
        text.push('\n');
    }
    text
}

fn of_kind(outcomes: &[Outcome], kind: Kind) -> Vec<&Outcome> {
    outcomes.iter().filter(|o| o.truth.kind == kind).collect()
}

/// Effects whose drawn strength reaches 1 on the whole experiment; sizes are found on a part of it.
fn strong(o: &Outcome) -> bool {
    o.truth.effects.iter().all(|e| e.rho >= 1.0)
}

fn summary(outcomes: &[Outcome]) -> String {
    let kind = |k| of_kind(outcomes, k);
    let (null, mut single, mut pair) = (kind(Kind::Null), kind(Kind::Single), kind(Kind::Pair));
    single.retain(|o| strong(o));
    pair.retain(|o| strong(o));
    let (outside, removed, closed) = (kind(Kind::Outside), kind(Kind::Removed), kind(Kind::Closed));
    let wrong = |o: &Outcome| !o.wrong_names().is_empty();
    let any = |o: &Outcome| !o.with_status("named").is_empty();
    let one_of = |o: &Outcome| o.hidden().iter().any(|n| o.found(n));
    let all_of = |o: &Outcome| o.hidden().iter().all(|n| o.found(n));
    let both_kinds = || null.iter().chain(&single).chain(&pair).chain(&outside).copied();
    let mut covered = Count::default();
    outcomes.iter().flat_map(Outcome::covered).for_each(|(_, hit)| covered.add(hit));
    let mut shares: Vec<f64> = single.iter().filter_map(|o| o.share_of_oracle()).collect();
    shares.sort_by(f64::total_cmp);
    let mut sure = Count::default();
    named_probabilities(outcomes).iter().filter(|(p, _)| *p >= 0.95).for_each(|(_, right)| sure.add(*right));
    let mut t = String::from("| test | measured | accept |\n|---|---|---|\n");
    let mut row = |what: &str, measured: String, accept: &str| {
        writeln!(t, "| {what} | {measured} | {accept} |").expect("writing to a string cannot fail");
    };
    row("nothing hidden: any name", Count::over(null.iter().copied(), any).text(), "≤ 2 %");
    row("nothing hidden: `none`", Count::over(null.iter().copied(), |o| o.verdict() == "none").text(), "≥ 95 %");
    row(
        "one effect, ρ ≥ 1: alone or in a set of at most 3",
        Count::over(single.iter().copied(), all_of).text(),
        "≥ 92 %, every effect ≥ 75 %",
    );
    row("two effects, each ρ ≥ 1: both", Count::over(pair.iter().copied(), all_of).text(), "≥ 75 %");
    row("two effects, each ρ ≥ 1: at least one", Count::over(pair.iter().copied(), one_of).text(), "≥ 97 %");
    row(
        "a wrong name: nothing, one, two hidden, or something outside the library",
        Count::over(both_kinds(), wrong).text(),
        "≤ 3 %",
    );
    row("outside the library: `unknown`", Count::over(outside.iter().copied(), |o| o.right()).text(), "≥ 85 %");
    row(
        "outside the library: `unknown`, in the right coordinate",
        Count::over(outside.iter().copied(), |o| o.right() && o.described_rightly()).text(),
        "≥ 85 %",
    );
    let no_twin = |o: &Outcome| o.with_status("named").iter().any(|n| !twins(n, o.hidden()[0]));
    row(
        "truth removed from the library: a wrong name, twins apart",
        Count::over(removed.iter().copied(), no_twin).text(),
        "≤ 10 %",
    );
    row(
        "truth removed from the library: a twin's name",
        Count::over(removed.iter().copied(), |o| any(o) && !no_twin(o)).text(),
        "",
    );
    row("95 % intervals cover the hidden number", covered.text(), "90–98 %");
    row("said probability 0.95–1.00: right", sure.text(), "≥ 93 %");
    let at = |share: f64| shares.get((share * shares.len() as f64) as usize).copied();
    let percent = |v: Option<f64>| v.map_or("—".to_owned(), |v| format!("{:.0} %", 100.0 * v));
    row(&format!("error removed over what an oracle removes, median of {}", shares.len()), percent(at(0.5)), "≥ 90 %");
    row("the same, worst tenth", percent(at(0.1)), "≥ 60 %");
    row("closed loops: right or in the set", Count::over(closed.iter().copied(), closed_right).text(), "≥ 85 %");
    row("closed loops: a wrong name", Count::over(closed.iter().copied(), wrong).text(), "0 %");
    t
}

/// In a closed loop nothing hidden must be `none`; an effect may be in a set.
fn closed_right(o: &Outcome) -> bool {
    if o.truth.effects.is_empty() { o.verdict() == "none" } else { o.hidden().iter().all(|n| o.found(n)) }
}

fn by_effect(outcomes: &[Outcome]) -> String {
    let mut table: BTreeMap<&str, [Count; 4]> = BTreeMap::new();
    for o in of_kind(outcomes, Kind::Single).into_iter().filter(|o| strong(o)) {
        let name = o.hidden()[0];
        let row = table.entry(name).or_default();
        row[0].add(o.found(name));
        row[1].add(o.with_status("named").contains(&name));
        row[2].add(!o.wrong_names().is_empty());
        row[3].add(matches!(o.verdict(), "none"));
    }
    let mut t = String::from(
        "## One effect, ρ ≥ 1\n\n| effect | found, alone or in a set of at most 3 | named | a wrong name | `none` |\n|---|---|---|---|---|\n",
    );
    for (name, [found, named, wrong, none]) in &table {
        writeln!(t, "| {name} | {} | {} | {} | {} |", found.text(), named.short(), wrong.short(), none.short())
            .expect("writing to a string cannot fail");
    }
    t
}

fn by_strength(outcomes: &[Outcome]) -> String {
    let edges = [1.0, 1.5, 2.5, 4.0, 100.0];
    let mut t = String::from("## One effect, by strength\n\n| ρ | found | a wrong name |\n|---|---|---|\n");
    for pair in edges.windows(2) {
        let of: Vec<&Outcome> = of_kind(outcomes, Kind::Single)
            .into_iter()
            .filter(|o| (pair[0]..pair[1]).contains(&o.truth.effects[0].rho))
            .collect();
        let found = Count::over(of.iter().copied(), |o| o.found(o.hidden()[0]));
        let wrong = Count::over(of.iter().copied(), |o| !o.wrong_names().is_empty());
        let upper = if pair[1] > 10.0 { String::from("up") } else { format!("{}", pair[1]) };
        writeln!(t, "| {} – {upper} | {} | {} |", pair[0], found.text(), wrong.text())
            .expect("writing to a string cannot fail");
    }
    t
}

fn confusion(outcomes: &[Outcome]) -> String {
    let mut cells: BTreeMap<(&str, String), usize> = BTreeMap::new();
    for o in outcomes.iter().filter(|o| matches!(o.truth.kind, Kind::Null | Kind::Single) && strong(o)) {
        *cells.entry((o.hidden().first().copied().unwrap_or("nothing"), o.says())).or_default() += 1;
    }
    let mut t = String::from(
        "## What was answered\n\nA set that cannot be told apart stands in braces.\n\n| hidden | answer | times |\n|---|---|---|\n",
    );
    for ((name, says), times) in &cells {
        writeln!(t, "| {name} | {says} | {times} |").expect("writing to a string cannot fail");
    }
    t
}

fn listed(outcomes: &[&Outcome], title: &str) -> String {
    let mut t = format!("## {title}\n\n| data set | hidden (ρ) | answer | |\n|---|---|---|---|\n");
    for o in outcomes {
        let hidden: Vec<String> = o.truth.effects.iter().map(|e| format!("{} ({:.1})", e.name, e.rho)).collect();
        let found: Vec<&str> = o.hidden().iter().map(|n| if o.found(n) { "found" } else { "—" }).collect();
        let wrong = o.wrong_names();
        let wrong = if wrong.is_empty() { String::new() } else { format!("; wrong: {}", wrong.join(", ")) };
        writeln!(
            t,
            "| {} {} | {} | {} | {}{wrong} |",
            o.truth.generator,
            o.truth.seed,
            hidden.join(" + "),
            o.says(),
            found.join(", ")
        )
        .expect("writing to a string cannot fail");
    }
    t
}

fn pairs(outcomes: &[Outcome]) -> String {
    listed(&of_kind(outcomes, Kind::Pair), "Two effects")
}

fn outside(outcomes: &[Outcome]) -> String {
    let mut table: BTreeMap<(&str, &str), [Count; 3]> = BTreeMap::new();
    for o in of_kind(outcomes, Kind::Outside) {
        let e = &o.truth.effects[0];
        let row = table.entry((&e.name, e.coordinate.as_deref().unwrap_or("—"))).or_default();
        row[0].add(o.right());
        row[1].add(o.right() && o.described_rightly());
        row[2].add(!o.wrong_names().is_empty());
    }
    let mut t = String::from(
        "## Outside the library\n\n| hidden | hangs on | `unknown` | in the right coordinate | a name |\n|---|---|---|---|---|\n",
    );
    for ((name, coordinate), [unknown, described, wrong]) in &table {
        writeln!(t, "| {name} | {coordinate} | {} | {} | {} |", unknown.short(), described.short(), wrong.short())
            .expect("writing to a string cannot fail");
    }
    t
}

fn removed(outcomes: &[Outcome]) -> String {
    let mut table: BTreeMap<&str, ([Count; 3], BTreeMap<String, usize>)> = BTreeMap::new();
    for o in of_kind(outcomes, Kind::Removed) {
        let name = o.hidden()[0];
        let (row, answers) = table.entry(name).or_default();
        let named = o.with_status("named");
        row[0].add(o.verdict() == "unknown" && named.is_empty());
        row[1].add(named.iter().any(|n| !twins(n, name)));
        row[2].add(!named.is_empty() && named.iter().all(|n| twins(n, name)));
        *answers.entry(o.says()).or_default() += 1;
    }
    let mut t = String::from(
        "## Truth removed from the library\n\n| removed | `unknown` | a wrong name | a twin's name | answers |\n|---|---|---|---|---|\n",
    );
    for (name, ([unknown, wrong, twin], answers)) in &table {
        let answers: Vec<String> = answers.iter().map(|(a, n)| format!("{a} ×{n}")).collect();
        writeln!(t, "| {name} | {} | {} | {} | {} |", unknown.short(), wrong.short(), twin.short(), answers.join("; "))
            .expect("writing to a string cannot fail");
    }
    t
}

fn closed(outcomes: &[Outcome]) -> String {
    let mut table: BTreeMap<&str, ([Count; 2], BTreeMap<String, usize>)> = BTreeMap::new();
    for o in of_kind(outcomes, Kind::Closed) {
        let (row, answers) = table.entry(o.hidden().first().copied().unwrap_or("nothing")).or_default();
        row[0].add(closed_right(o));
        row[1].add(!o.wrong_names().is_empty());
        *answers.entry(o.says()).or_default() += 1;
    }
    let mut t = String::from(
        "## Closed loops\n\n| hidden | right or in the set | a wrong name | answers |\n|---|---|---|---|\n",
    );
    for (name, ([right, wrong], answers)) in &table {
        let answers: Vec<String> = answers.iter().map(|(a, n)| format!("{a} ×{n}")).collect();
        writeln!(t, "| {name} | {} | {} | {} |", right.short(), wrong.short(), answers.join("; "))
            .expect("writing to a string cannot fail");
    }
    t
}

fn coverage(outcomes: &[Outcome]) -> String {
    let mut table: BTreeMap<&str, Count> = BTreeMap::new();
    outcomes.iter().flat_map(Outcome::covered).for_each(|(name, hit)| table.entry(name).or_default().add(hit));
    let mut t = String::from(
        "## 95 % intervals\n\nOnly forms whose number the library has too.\n\n| effect | covered |\n|---|---|\n",
    );
    for (name, count) in &table {
        writeln!(t, "| {name} | {} |", count.text()).expect("writing to a string cannot fail");
    }
    t
}

/// Said probability of each effect that is named or held possible, and whether it is hidden.
fn said_probabilities(outcomes: &[Outcome]) -> Vec<(f64, bool)> {
    let mut all = Vec::new();
    for o in outcomes.iter().filter(|o| matches!(o.truth.kind, Kind::Null | Kind::Single | Kind::Pair | Kind::Outside))
    {
        for e in o.effects() {
            if let (Some(p), Some(name)) = (e["probability"].as_f64(), e["name"].as_str()) {
                all.push((p, o.hidden().contains(&name)));
            }
        }
    }
    all
}

fn named_probabilities(outcomes: &[Outcome]) -> Vec<(f64, bool)> {
    let mut all = Vec::new();
    for o in outcomes.iter().filter(|o| o.truth.kind != Kind::Removed) {
        for e in o.effects().iter().filter(|e| e["status"] == "named") {
            if let (Some(p), Some(name)) = (e["probability"].as_f64(), e["name"].as_str()) {
                all.push((p, o.hidden().contains(&name)));
            }
        }
    }
    all
}

fn reliability(outcomes: &[Outcome]) -> String {
    let (said, named) = (said_probabilities(outcomes), named_probabilities(outcomes));
    let mut t = String::from(
        "## Said probability against how often it is right\n\n| said | mean said | effects judged: hidden | named: hidden |\n|---|---|---|---|\n",
    );
    for bin in [0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0].windows(2) {
        let inside = |p: f64| p >= bin[0] && (p < bin[1] || bin[1] >= 1.0);
        let (mut all, mut of_named, mut sum) = (Count::default(), Count::default(), 0.0);
        for (p, right) in said.iter().filter(|(p, _)| inside(*p)) {
            all.add(*right);
            sum += p;
        }
        named.iter().filter(|(p, _)| inside(*p)).for_each(|(_, right)| of_named.add(*right));
        let mean = if all.of == 0 { "—".to_owned() } else { format!("{:.3}", sum / all.of as f64) };
        writeln!(t, "| {:.2}–{:.2} | {mean} | {} | {} |", bin[0], bin[1], all.text(), of_named.text())
            .expect("writing to a string cannot fail");
    }
    t
}

fn failures(outcomes: &[Outcome]) -> String {
    let mut seconds: Vec<f64> = outcomes.iter().map(|o| o.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let median = seconds.get(seconds.len() / 2).copied().unwrap_or(0.0);
    let mut t = format!(
        "## Time and failures\n\n{} data sets; median {median:.1} s each, longest {:.1} s.\n",
        outcomes.len(),
        seconds.last().copied().unwrap_or(0.0)
    );
    for o in outcomes.iter().filter(|o| o.error.is_some()) {
        writeln!(t, "- {}", judge::line(o)).expect("writing to a string cannot fail");
    }
    t
}
