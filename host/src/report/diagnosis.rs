//! The report: the same residuals before and after, against everything they could depend on.

use super::figure::{Figure, Panel};
use super::page::Page;
use crate::diagnose::Details;
use crate::diagnose::answer::{DescribedAnswer, Diagnosis, ParameterAnswer, text};
use crate::diagnose::conclusion::Outcome;
use crate::diagnose::inertial::InertialOutcome;
use crate::diagnose::problem::Problem;
use serde_json::Value;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// Builds the HTML report. `title` names the data.
pub fn page(title: &str, d: &Diagnosis, details: Option<&Details>) -> Page {
    let json = serde_json::to_value(d).expect("an answer always serialises");
    let mut page =
        Page::new(format!("Diagnosis: {title}")).callout(&sentence(&json)).heading("The answer").code(&text(d));
    if let Some(details) = details {
        page = page.heading("Residuals before and after");
        page = match details {
            Details::Runs { problem, outcome } => page.figure(
                residual_figure(problem, outcome),
                "Measured minus simulated speed, averaged in bins: the refitted simulation before, the extended model after. \
                 What is flat at zero is explained.",
            ),
            Details::Inertial(o) => page.figure(inertial_figure(o), "Speeds over time, and what the plants miss over time, input and speed."),
        };
    }
    page = page.heading("Evidence");
    let percent = |v: f64| format!("{:.1}", 100.0 * v);
    let rows: Vec<Vec<String>> = d
        .effects
        .iter()
        .map(|e| {
            vec![
                e.name.clone(),
                e.status.to_owned(),
                e.probability.map_or("-".to_owned(), |p| format!("{p:.2}")),
                percent(e.gain_heldout),
                format!("{} to {}", percent(e.gain_ci95[0]), percent(e.gain_ci95[1])),
                format!("{:.3}", e.p_null),
                e.conflicts_with.join(", "),
                e.note.clone(),
            ]
        })
        .collect();
    let header =
        ["effect", "status", "probability", "held-out gain (%)", "95 % interval", "p of chance", "as good", "note"];
    page = page.table(&header, &rows);
    if !d.described.is_empty() {
        page =
            page.heading("Without a cause").table(&["over", "equation", "numbers", "held-out gain (%)"], &described(d));
    }
    page = page.heading("Error budget");
    let mut rows: Vec<Vec<String>> = d
        .effects
        .iter()
        .filter(|e| e.status != "rejected" && e.share > 0.0)
        .map(|e| vec![e.name.clone(), percent(e.share)])
        .collect();
    if let (Some(rmse), Some(u)) = (d.baseline.scores.rmse_speed_rpm, d.unexplained_fraction) {
        let floor = (d.baseline.noise_floor / rmse).powi(2).min(1.0);
        rows.push(vec!["noise floor".to_owned(), percent(floor)]);
        rows.push(vec!["unknown".to_owned(), percent(u)]);
    }
    page = page.table(&["part", "share of the baseline's squared error (%)"], &rows);
    page.paragraph(&format!(
        "Every random choice (hold-out, bootstrap, null) is drawn from seed {}; the same seed gives the same answer.",
        d.seed
    ))
}

/// The terms that name no cause, a row each.
fn described(d: &Diagnosis) -> Vec<Vec<String>> {
    let number = |(name, p): (&String, &ParameterAnswer)| {
        let unit = if p.unit == "1" { "" } else { &p.unit };
        format!("{name} = {:.4} [{:.4}, {:.4}] {unit}", p.value, p.ci95[0], p.ci95[1])
    };
    let row = |t: &DescribedAnswer| {
        let numbers: Vec<String> = t.parameters.iter().map(number).collect();
        let gain = format!("{:.1}", 100.0 * t.gain_heldout);
        vec![t.coordinate.clone(), t.equation.clone(), numbers.join(", "), gain]
    };
    d.described.iter().map(row).collect()
}

/// What was found, in one sentence: of an answer as its JSON has it.
pub fn sentence(d: &Value) -> String {
    let off = |part: &str| d[part]["rmse_speed_rpm"].as_f64().map(|rpm| format!("{rpm:.2} rpm"));
    let missed = off("baseline").map_or("The simulation differs from this motor".to_owned(), |rpm| {
        format!("The simulation missed the motor's speed by {rpm}")
    });
    let effects = || d["effects"].as_array().into_iter().flatten();
    let with_status = |status: &'static str| effects().filter(move |e| e["status"] == status);
    let possible = || {
        let with_rivals = |e: &'_ Value| {
            let rivals = e["conflicts_with"].as_array().cloned().unwrap_or_default();
            std::iter::once(e["name"].clone()).chain(rivals)
        };
        let names = with_status("ambiguous").flat_map(with_rivals);
        let names: BTreeSet<String> = names.filter_map(|name| name.as_str().map(str::to_owned)).collect();
        names.into_iter().collect::<Vec<_>>()
    };
    match d["verdict"].as_str() {
        Some("none") => match off("baseline") {
            Some(rpm) => {
                format!("Nothing is wrong: the {rpm} by which the simulation missed the motor's speed are noise.")
            }
            None => "Nothing is wrong: what the simulation misses is noise.".to_owned(),
        },
        Some("named") => {
            let names: Vec<&str> = with_status("named").filter_map(|e| e["name"].as_str()).collect();
            let left =
                off("extended").map_or(String::new(), |rpm| format!(", and with it in the model {rpm} are left"));
            format!("{missed}; the cause is {}{left}.", names.join(" and "))
        }
        Some("ambiguous") => match possible().as_slice() {
            [alone] => format!("{missed}; {alone} may be the cause."),
            several => format!("{missed}; the cause is one of {}.", several.join(", ")),
        },
        _ if with_status("ambiguous").next().is_some() => {
            format!(
                "{missed}, and no cause in the library explains it for certain; possible: {}.",
                possible().join(", ")
            )
        }
        _ => format!("{missed}, and no cause in the library explains it."),
    }
}

/// Binned residuals of several runs.
pub fn residual_figure(problem: &Problem, outcome: &Outcome) -> Figure {
    let before = problem.residuals(&outcome.baseline);
    let after = problem.residuals(&outcome.extended);
    let n = problem.runs.len() as f64;
    let mut samples: Vec<[f64; 7]> = Vec::new();
    for (i, run) in problem.runs.iter().enumerate() {
        let order = run.order.map_or(i as f64, f64::from);
        for (k, w) in run.windows.iter().enumerate() {
            if w.low != w.high {
                continue;
            }
            let t = 0.5 * (run.times[w.from] + run.times[w.to]);
            let theta = (0.5 * (run.angles[w.from] + run.angles[w.to])).rem_euclid(TAU) * 360.0 / TAU;
            samples.push([
                t,
                theta,
                run.duty.unwrap_or(f64::NAN),
                run.direction,
                order,
                before[i].rpm[k],
                after[i].rpm[k],
            ]);
        }
    }
    let bins = |axis: usize, count: usize, column: usize| -> Vec<(f64, f64)> {
        let (low, high) = samples
            .iter()
            .map(|s| s[axis])
            .filter(|v| v.is_finite())
            .fold((f64::MAX, f64::MIN), |a, v| (a.0.min(v), a.1.max(v)));
        let width = ((high - low) / count as f64).max(1e-9);
        let mut sums = vec![(0.0, 0.0); count];
        for s in &samples {
            if s[axis].is_finite() {
                let k = (((s[axis] - low) / width) as usize).min(count - 1);
                sums[k].0 += s[column];
                sums[k].1 += 1.0;
            }
        }
        sums.iter()
            .enumerate()
            .filter(|(_, s)| s.1 > 0.0)
            .map(|(k, s)| (low + width * (k as f64 + 0.5), s.0 / s.1))
            .collect()
    };
    let panel = |label: &str, axis: usize, count: usize| {
        Panel::new(label, "residual (rpm)").dashed("before", &bins(axis, count, 5)).line("after", &bins(axis, count, 6))
    };
    let first: Vec<(f64, f64)> = samples.iter().step_by((samples.len() / 1500).max(1)).map(|s| (s[0], s[5])).collect();
    let last: Vec<(f64, f64)> = samples.iter().step_by((samples.len() / 1500).max(1)).map(|s| (s[0], s[6])).collect();
    Figure::new("")
        .columns(2)
        .size(1000, 1100)
        .panel(panel("time in the run (s)", 0, 40))
        .panel(panel("angle since the start (degrees)", 1, 36))
        .panel(panel("duty", 2, 20))
        .panel(panel("direction (1 = cw)", 3, 2))
        .panel(panel("order of the run", 4, (n as usize).clamp(2, 60)))
        .panel(Panel::new("time in the run (s)", "residual (rpm)").points("before", &first).points("after", &last))
}

/// Speeds of ordinary motors over time, and what the plants miss over time, input and speed.
pub fn inertial_figure(o: &InertialOutcome) -> Figure {
    let mut panels = [
        Panel::new("time (s)", "speed (rpm)"),
        Panel::new("time (s)", "residual (rpm)"),
        Panel::new("input (largest = 1)", "residual (rpm)"),
        Panel::new("speed (rpm)", "residual (rpm)"),
    ];
    let (before, after) = (&o.before, &o.after);
    for (i, run) in o.data.runs.iter().enumerate() {
        let rows: Vec<usize> = (0..run.rpm.len()).step_by((run.rpm.len() / 1500).max(1)).collect();
        let at = |x: &dyn Fn(usize) -> f64, y: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
            rows.iter().map(|k| (x(*k), y(*k))).collect()
        };
        let time = |k: usize| run.time[run.sample(k)];
        let (id, measured) = (&run.id, |k: usize| run.rpm[k]);
        let (first, last) = (|k: usize| run.rpm[k] - before[i][k], |k: usize| run.rpm[k] - after[i][k]);
        let [speed, over_time, over_input, over_speed] = panels;
        panels = [
            speed
                .points(format!("{id} measured"), &at(&time, &measured))
                .line(format!("{id} extended"), &at(&time, &|k| after[i][k])),
            over_time
                .points(format!("{id} before"), &at(&time, &first))
                .points(format!("{id} after"), &at(&time, &last)),
            over_input
                .points(format!("{id} before"), &at(&|k| run.input[run.sample(k)], &first))
                .points(format!("{id} after"), &at(&|k| run.input[run.sample(k)], &last)),
            over_speed
                .points(format!("{id} before"), &at(&measured, &first))
                .points(format!("{id} after"), &at(&measured, &last)),
        ];
    }
    panels.into_iter().fold(Figure::new("").columns(2).size(1000, 900), Figure::panel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn one_sentence_says_what_was_found() {
        let effects = json!([{"name": "dead-zone", "status": "named"}, {"name": "start-delay", "status": "rejected"}]);
        let (before, after) = (json!({"rmse_speed_rpm": 3.24}), json!({"rmse_speed_rpm": 0.2}));
        let d = json!({"verdict": "named", "effects": effects, "baseline": before, "extended": after});
        let expected = "The simulation missed the motor's speed by 3.24 rpm; the cause is dead-zone, and with it in the \
                        model 0.20 rpm are left.";
        assert_eq!(sentence(&d), expected);
        let effects =
            json!([{"name": "preload-runout", "status": "ambiguous", "conflicts_with": ["encoder-eccentricity"]}]);
        let d = json!({"verdict": "ambiguous", "effects": effects, "baseline": before, "extended": after});
        assert!(sentence(&d).ends_with("the cause is one of encoder-eccentricity, preload-runout."));
        let d = json!({"verdict": "none", "effects": [], "baseline": {"rmse_speed_rpm": null}});
        assert_eq!(sentence(&d), "Nothing is wrong: what the simulation misses is noise.");
        let d = json!({"verdict": "unknown", "effects": [], "baseline": before});
        assert!(sentence(&d).ends_with("3.24 rpm, and no cause in the library explains it."));
        let effects = json!([{"name": "unequal-edges", "status": "ambiguous", "conflicts_with": []}]);
        let d = json!({"verdict": "ambiguous", "effects": effects, "baseline": before});
        assert!(sentence(&d).ends_with("3.24 rpm; unequal-edges may be the cause."));
        let d = json!({"verdict": "unknown", "effects": effects, "baseline": before});
        assert!(sentence(&d).ends_with("explains it for certain; possible: unequal-edges."));
    }
}
