//! The answer: what other programs read, and the page a person reads.

use super::conclusion::Outcome;
use super::finding::{Curve, Described, Estimate, Finding, Status, Unknown};
use super::library::says;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The verdict on a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// At least one cause is named.
    Named,
    /// Something is there; more than one cause explains it as well.
    Ambiguous,
    /// Something is there that no effect of the library explains.
    Unknown,
    /// Nothing beyond the noise floor.
    None,
}

impl Verdict {
    /// What findings and what is left without a cause come to.
    pub(super) fn of(findings: &[Finding], unknown: &[Unknown]) -> Self {
        let any = |s: Status| findings.iter().any(|f| f.status == s);
        match (any(Status::Named), any(Status::Ambiguous), unknown.is_empty()) {
            (true, _, _) => Self::Named,
            // Beside what no effect explains, possible causes are no answer.
            (_, _, false) => Self::Unknown,
            (_, true, _) => Self::Ambiguous,
            _ => Self::None,
        }
    }

    /// The word used in the JSON.
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Named => "named",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Unknown => "unknown",
            Verdict::None => "none",
        }
    }
}

/// How well a model does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Default)]
pub struct Scores {
    /// r² over run mean speeds.
    pub r2_speed: Option<f64>,
    /// RMS speed error in rpm.
    pub rmse_speed_rpm: Option<f64>,
    /// RMS angle error in degrees.
    pub rmse_position_deg: Option<f64>,
}

/// [`Scores`] of the baseline, with the floor it is held against.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BaselineScores {
    /// Scores.
    #[serde(flatten)]
    pub scores: Scores,
    /// Noise floor in rpm.
    pub noise_floor: f64,
}

/// A parameter in the JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterAnswer {
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Unit.
    pub unit: String,
}

/// One effect in the JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectAnswer {
    /// Name.
    pub name: String,
    /// named, ambiguous or rejected.
    pub status: &'static str,
    /// Held-out gain.
    pub gain_heldout: f64,
    /// Its 95 % interval.
    pub gain_ci95: [f64; 2],
    /// p-value against the null of the whole selection.
    pub p_null: f64,
    /// Parameters.
    pub parameters: BTreeMap<String, ParameterAnswer>,
    /// What explains the data as well.
    pub conflicts_with: Vec<String>,
    /// What would decide.
    pub next_experiment: String,
    /// Probability that it is there, where sets of effects were weighed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Share of the baseline's squared error it removes.
    pub share: f64,
    /// Remarks.
    pub note: String,
    /// The sentence and the equation of the library that it is of.
    #[serde(skip)]
    pub says: (String, String),
}

/// What remains without a cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnknownAnswer {
    /// Where it lives.
    pub lives_in: String,
    /// Held-out gain of a term without physics.
    pub gain_heldout: f64,
    /// p-value.
    pub p_null: f64,
}

/// A term without a cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DescribedAnswer {
    /// Over what.
    pub coordinate: String,
    /// What the model gains by it.
    pub equation: String,
    /// Its numbers.
    pub parameters: BTreeMap<String, ParameterAnswer>,
    /// Held-out gain on top of the extended model.
    pub gain_heldout: f64,
    /// The same for a motor file.
    #[serde(skip)]
    pub curve: Curve,
}

impl DescribedAnswer {
    fn new(d: &Described) -> Self {
        Self {
            coordinate: d.coordinate.clone(),
            equation: d.equation.clone(),
            parameters: d.parameters.iter().map(parameter).collect(),
            gain_heldout: d.gain,
            curve: d.curve.clone(),
        }
    }
}

/// A number as it is answered, by its name.
fn parameter(e: &Estimate) -> (String, ParameterAnswer) {
    (e.name.clone(), ParameterAnswer { value: e.value, ci95: e.interval, unit: e.unit.clone() })
}

/// The whole answer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Version of this shape.
    pub schema: u32,
    /// Verdict.
    pub verdict: Verdict,
    /// Whether runs were repeated, so that whole runs could be held out.
    pub replicated: bool,
    /// The model as it is, own parameters refitted.
    pub baseline: BaselineScores,
    /// Evidence an effect.
    pub effects: Vec<EffectAnswer>,
    /// The model with the accepted effects.
    pub extended: Scores,
    /// Share of the baseline's squared error without a cause.
    pub unexplained_fraction: Option<f64>,
    /// Where something without a cause lives.
    pub unknown: Vec<UnknownAnswer>,
    /// The strongest of it as equations, which name no cause.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub described: Vec<DescribedAnswer>,
    /// Effects that these runs cannot show, with the reason.
    pub not_judged: BTreeMap<String, String>,
    /// What else must be said.
    pub notes: Vec<String>,
    /// Seed of all random choices.
    pub seed: u64,
}

impl Diagnosis {
    /// An answer that says only why there is none.
    pub fn impossible(notes: Vec<String>, seed: u64) -> Self {
        Self {
            schema: 1,
            verdict: Verdict::Unknown,
            replicated: false,
            baseline: BaselineScores { scores: Scores::default(), noise_floor: 0.0 },
            effects: Vec::new(),
            extended: Scores::default(),
            unexplained_fraction: None,
            unknown: Vec::new(),
            described: Vec::new(),
            not_judged: BTreeMap::new(),
            notes,
            seed,
        }
    }

    /// Puts the answer together.
    pub fn new(outcome: &Outcome, replicated: bool, notes: Vec<String>, seed: u64) -> Self {
        let findings = &outcome.findings;
        let base = outcome.held_out.rmse(0);
        let extended = outcome.held_out.rmse(1);
        let floor = outcome.noise_floor;
        Self {
            schema: 1,
            verdict: Verdict::of(findings, &outcome.unknown),
            replicated,
            baseline: BaselineScores {
                scores: Scores {
                    r2_speed: outcome.r2[0],
                    rmse_speed_rpm: Some(base),
                    rmse_position_deg: Some(outcome.position_deg[0]),
                },
                noise_floor: floor,
            },
            effects: findings.iter().map(|f| effect_answer(f, says(&f.name, &outcome.problem.formulas))).collect(),
            extended: Scores {
                r2_speed: outcome.r2[1],
                rmse_speed_rpm: Some(extended),
                rmse_position_deg: Some(outcome.position_deg[1]),
            },
            unexplained_fraction: Some(((extended * extended - floor * floor) / (base * base)).clamp(0.0, 1.0)),
            unknown: outcome
                .unknown
                .iter()
                .map(|u: &Unknown| UnknownAnswer {
                    lives_in: u.lives_in.to_owned(),
                    gain_heldout: u.gain,
                    p_null: u.p_null,
                })
                .collect(),
            described: outcome.described.iter().map(DescribedAnswer::new).collect(),
            not_judged: outcome.not_judged.iter().cloned().collect(),
            notes,
            seed,
        }
    }

    /// Effects that are suspected, and those that look like them.
    fn candidates(&self) -> Vec<&str> {
        let suspects = self.effects.iter().filter(|e| e.status != "rejected");
        let mut names = Vec::new();
        for name in suspects.flat_map(|e| std::iter::once(&e.name).chain(&e.conflicts_with)) {
            if !names.contains(&name.as_str()) {
                names.push(name.as_str());
            }
        }
        names
    }

    /// Named effects.
    pub fn named(&self) -> Vec<&str> {
        self.effects.iter().filter(|e| e.status == "named").map(|e| e.name.as_str()).collect()
    }

    /// Named or ambiguous effects.
    pub fn suspected(&self) -> Vec<&str> {
        self.effects.iter().filter(|e| e.status != "rejected").map(|e| e.name.as_str()).collect()
    }
}

/// A finding as it is answered, with what the library that it is of says of it.
pub(super) fn effect_answer(f: &Finding, says: Option<(String, String)>) -> EffectAnswer {
    EffectAnswer {
        name: f.name.clone(),
        status: match f.status {
            Status::Named => "named",
            Status::Ambiguous => "ambiguous",
            Status::Rejected => "rejected",
        },
        gain_heldout: f.gain,
        gain_ci95: f.gain_interval,
        p_null: f.p_null,
        parameters: f.parameters.iter().map(parameter).collect(),
        conflicts_with: f.conflicts.clone(),
        next_experiment: f.next_experiment.clone(),
        probability: f.probability,
        share: f.share,
        note: f.note.clone(),
        says: says.unwrap_or_default(),
    }
}

/// The page a person reads.
pub fn text(d: &Diagnosis) -> String {
    let mut out = String::new();
    let mut line = |s: String| {
        let _ = writeln!(out, "{s}");
    };
    let possible = d.candidates().join(", ");
    line(match d.verdict {
        Verdict::Named => format!("NAMED: {}", d.named().join(", ")),
        Verdict::Ambiguous if d.candidates().len() == 1 => format!("AMBIGUOUS: perhaps {possible}"),
        Verdict::Ambiguous => format!("AMBIGUOUS: one of {possible}"),
        Verdict::Unknown if !possible.is_empty() => {
            format!("UNKNOWN: no effect of the library explains for certain what is there; possible: {possible}")
        }
        Verdict::Unknown => "UNKNOWN: something is there that no effect of the library explains".to_owned(),
        Verdict::None => "NONE: nothing beyond the noise floor".to_owned(),
    });
    line(String::new());
    if let Some(rmse) = d.baseline.scores.rmse_speed_rpm {
        line(format!(
            "What is wrong   the simulation, its own parameters refitted, misses the speed by {rmse:.2} rpm RMS on runs it was \
             not fitted to; the noise floor is {:.2} rpm.",
            d.baseline.noise_floor
        ));
    }
    if let Some(r2) = d.baseline.scores.r2_speed {
        line(format!("                r² of the run mean speeds: {r2:.4}."));
    }
    for e in d.effects.iter().filter(|e| e.status != "rejected") {
        line(String::new());
        line(suspect(e));
    }
    line(String::new());
    if let (Some(a), Some(u)) = (d.extended.rmse_speed_rpm, d.unexplained_fraction) {
        line(format!(
            "Afterwards      {a:.2} rpm RMS on runs not fitted; {:.0} % of the squared error stays unexplained.",
            100.0 * u
        ));
    }
    for u in &d.unknown {
        line(format!(
            "Left over       a term without physics over {} would still gain {} (p = {:.3}).",
            u.lives_in,
            gained(u.gain_heldout),
            u.p_null
        ));
    }
    for term in &d.described {
        line(described(term));
    }
    let near: Vec<&EffectAnswer> = d.effects.iter().filter(|e| e.status == "rejected" && !e.note.is_empty()).collect();
    for e in near {
        line(format!("Not named       {}: {}", e.name, e.note));
    }
    if !d.not_judged.is_empty() {
        line(String::new());
        line("Cannot be judged from these runs:".to_owned());
        for (name, reason) in &d.not_judged {
            line(format!("  {name}: {reason}"));
        }
    }
    for note in &d.notes {
        line(format!("Note: {note}"));
    }
    out
}

/// What is said of a cause, or of a possible one.
fn suspect(e: &EffectAnswer) -> String {
    let (sentence, equation) = &e.says;
    let heading = if e.status == "named" { "Cause        " } else { "Possible cause" };
    let mut lines = vec![format!("{heading}   {} — {sentence}.", e.name), format!("  model gains   {equation}")];
    for (name, p) in &e.parameters {
        lines.push(format!(
            "                {name} = {} {}  (95 %: {} to {})",
            short(p.value),
            unit(&p.unit),
            short(p.ci95[0]),
            short(p.ci95[1])
        ));
    }
    lines.push(format!(
        "  how sure      it removes {:.0} % of the error on runs it was not fitted to (95 %: {:.0} to {:.0} %); chance, \
         with the whole search repeated, does as well with p = {:.3}.",
        100.0 * e.gain_heldout,
        100.0 * e.gain_ci95[0],
        100.0 * e.gain_ci95[1],
        e.p_null
    ));
    if e.share > 0.0 {
        lines.push(format!("  its share     {:.0} % of the baseline's squared error.", 100.0 * e.share));
    }
    if e.conflicts_with.is_empty() {
        lines.push("  mistaken for  no other effect of the library does as well.".to_owned());
    } else {
        lines.push(format!("  mistaken for  {}", e.conflicts_with.join(", ")));
        lines.push(format!("  what decides  {}", e.next_experiment));
    }
    if !e.note.is_empty() {
        lines.push(format!("  note          {}", e.note));
    }
    lines.join("\n")
}

/// What is said of a term without a cause: as many of its largest numbers as a line holds.
fn described(term: &DescribedAnswer) -> String {
    let mut largest: Vec<(&String, &ParameterAnswer)> = term.parameters.iter().collect();
    largest.sort_by(|a, b| b.1.value.abs().total_cmp(&a.1.value.abs()));
    let number = |(name, p): &(&String, &ParameterAnswer)| {
        let [value, low, high] = [p.value, p.ci95[0], p.ci95[1]].map(short);
        format!("{name} = {value} {} (95 %: {low} to {high})", unit(&p.unit)).replace("  ", " ")
    };
    let numbers: Vec<String> = largest.iter().take(2).map(number).collect();
    format!(
        "Described       over {}: {}; {}. It gains {} on runs not fitted, and is no cause.",
        term.coordinate,
        term.equation,
        numbers.join(", "),
        gained(term.gain_heldout)
    )
}

/// A gain that is a loss helps nobody by its size.
fn gained(share: f64) -> String {
    if share > 0.0 { format!("{:.1} %", 100.0 * share) } else { "nothing".to_owned() }
}

fn unit(u: &str) -> &str {
    if u == "1" { "" } else { u }
}

fn short(v: f64) -> String {
    if v == 0.0 {
        "0".to_owned()
    } else if v.abs() >= 1e5 || v.abs() < 1e-3 {
        format!("{v:.2e}")
    } else {
        let digits = (3 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
        format!("{v:.digits$}")
    }
}
