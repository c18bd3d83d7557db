//! One answer held against what was hidden.

use crate::truth::{Hidden, Kind, Truth};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What came out for one data set: a line of a results file.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// What was hidden.
    pub truth: Truth,
    /// The command's JSON; null where it failed.
    pub answer: Value,
    /// What the command said where it failed.
    pub error: Option<String>,
    /// How long it took in s, on a machine as busy as it was.
    pub seconds: f64,
    /// The baseline's error in rpm on the same data with nothing hidden, where that was asked for.
    pub clean_rmse_rpm: Option<f64>,
}

impl Outcome {
    /// The verdict's word.
    pub fn verdict(&self) -> &str {
        self.answer["verdict"].as_str().unwrap_or("failed")
    }

    /// Names of what is hidden.
    pub fn hidden(&self) -> Vec<&str> {
        self.truth.effects.iter().map(|e| e.name.as_str()).collect()
    }

    /// Names of the effects with a status.
    pub fn with_status(&self, status: &str) -> Vec<&str> {
        self.effects().iter().filter(|e| e["status"] == status).filter_map(|e| e["name"].as_str()).collect()
    }

    /// The answer's effects.
    pub fn effects(&self) -> &[Value] {
        self.answer["effects"].as_array().map_or(&[], Vec::as_slice)
    }

    /// The answer's entry of an effect that it names or holds possible.
    pub fn entry(&self, name: &str) -> Option<&Value> {
        self.effects().iter().find(|e| e["name"] == name && e["status"] != "rejected")
    }

    /// Whether an effect is named, or one of a set of at most three that cannot be told apart.
    pub fn found(&self, name: &str) -> bool {
        let ambiguous = self.with_status("ambiguous");
        if self.with_status("named").contains(&name) {
            return true;
        }
        let Some(entry) = ambiguous.contains(&name).then(|| self.entry(name)).flatten() else { return false };
        let rivals: Vec<&str> =
            entry["conflicts_with"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let set = ambiguous.iter().filter(|a| **a == name || rivals.is_empty() || rivals.contains(a)).count();
        set <= 3
    }

    /// Names that are not hidden.
    pub fn wrong_names(&self) -> Vec<&str> {
        let hidden = self.hidden();
        self.with_status("named").into_iter().filter(|n| !hidden.contains(n)).collect()
    }

    /// Everything hidden is found and nothing else is named.
    pub fn right(&self) -> bool {
        let clean = self.wrong_names().is_empty();
        match self.truth.kind {
            Kind::Outside | Kind::Removed => self.verdict() == "unknown" && clean,
            _ if self.truth.effects.is_empty() => self.verdict() == "none" && clean,
            _ => clean && self.hidden().iter().all(|n| self.found(n)),
        }
    }

    /// Whether what is described, or where it is said to live, is the coordinate that the hidden thing hangs on.
    pub fn described_rightly(&self) -> bool {
        let Some(coordinate) = self.truth.effects.first().and_then(|e| e.coordinate.as_deref()) else { return false };
        let words: &[&str] = match coordinate {
            "angle" => &["angle", "theta", "θ", "wheel", "turn"],
            "time" => &["time"],
            "order" => &["order", "day"],
            "duty" => &["duty"],
            "direction" => &["direction"],
            "phase" => &["phase", "pulse"],
            _ => &[],
        };
        let said = |value: &Value| {
            let text = value.to_string().to_lowercase();
            !value.is_null() && words.iter().any(|w| text.contains(w))
        };
        // The strongest term, by its coordinate; an answer without terms, by where it says that something lives.
        match self.answer["described"].as_array().and_then(|d| d.first()) {
            Some(term) if !term["coordinate"].is_null() => said(&term["coordinate"]),
            Some(term) => said(term),
            None if !self.answer["described"].is_null() => said(&self.answer["described"]),
            None => said(&self.answer["unknown"]),
        }
    }

    /// For each hidden number that the answer also gives: whether its interval covers it.
    pub fn covered(&self) -> Vec<(&str, bool)> {
        let mut all = Vec::new();
        for e in &self.truth.effects {
            let Some(entry) = self.entry(&e.name) else { continue };
            for (parameter, truth) in &e.parameters {
                let ci = &entry["parameters"][parameter]["ci95"];
                if let (Some(low), Some(high)) = (ci[0].as_f64(), ci[1].as_f64()) {
                    all.push((e.name.as_str(), low <= *truth && *truth <= high));
                }
            }
        }
        all
    }

    /// Error that the extended model removes, over what goes with the effect itself, where its twin was diagnosed.
    pub fn share_of_oracle(&self) -> Option<f64> {
        let base = self.answer["baseline"]["rmse_speed_rpm"].as_f64()?;
        let extended = self.answer["extended"]["rmse_speed_rpm"].as_f64()?;
        let oracle = 1.0 - self.clean_rmse_rpm? / base;
        // Less than 3 % is within what two fits differ by.
        (oracle > 0.03).then(|| (1.0 - extended / base) / oracle)
    }

    /// What the answer says, shortly.
    pub fn says(&self) -> String {
        if let Some(error) = &self.error {
            return format!("failed ({})", error.lines().next().unwrap_or(""));
        }
        let (named, ambiguous) = (self.with_status("named"), self.with_status("ambiguous"));
        let mut text = self.verdict().to_owned();
        if !named.is_empty() {
            text = named.join(" + ");
        }
        if !ambiguous.is_empty() {
            text = format!("{text} {{{}}}", ambiguous.join(", "));
        }
        text
    }
}

/// One line for the eye.
pub fn line(o: &Outcome) -> String {
    // A closed loop's form is its whole controller, and its strength is not measured.
    let told = |e: &Hidden| {
        if e.rho > 0.0 { format!("{} ({}, ρ {:.1})", e.name, e.form, e.rho) } else { e.name.clone() }
    };
    let hidden: Vec<String> = o.truth.effects.iter().map(told).collect();
    format!(
        "{} {} {} {}: {} -> {} [{:.0} s]",
        if o.right() { "right" } else { "  -  " },
        o.truth.generator,
        o.truth.kind.word(),
        o.truth.seed,
        if hidden.is_empty() { "nothing".to_owned() } else { hidden.join(" + ") },
        o.says(),
        o.seconds
    )
}
