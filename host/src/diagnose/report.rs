//! The report: the same residuals before and after, against everything they could depend on.

use super::Details;
use super::answer::{Diagnosis, text};
use super::inertial::InertialOutcome;
use super::problem::Problem;
use super::runs::Outcome;
use crate::report::figure::{Figure, FigureError, Panel};
use crate::report::html::Page;
use std::f64::consts::TAU;

/// Builds the HTML report. `title` names the data.
///
/// # Errors
/// When a figure cannot be drawn.
pub fn page(title: &str, d: &Diagnosis, details: Option<&Details>) -> Result<Page, FigureError> {
    let mut page = Page::new(format!("Diagnosis: {title}"));
    let headline = text(d).lines().next().unwrap_or_default().to_owned();
    page = page.callout(&headline).heading("The answer").code(&text(d));
    if let Some(details) = details {
        page = page.heading("Residuals before and after");
        page = match details {
            Details::Runs { problem, outcome } => page.figure(
                &residual_figure(problem, outcome),
                "Measured minus simulated speed, averaged in bins: the refitted simulation before, the extended model after. \
                 What is flat at zero is explained.",
            )?,
            Details::Inertial(o) => page.figure(&inertial_figure(o), "Speed over input, and what the models miss.")?,
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
                percent(e.gain_heldout),
                format!("{} to {}", percent(e.gain_ci95[0]), percent(e.gain_ci95[1])),
                format!("{:.3}", e.p_null),
                e.conflicts_with.join(", "),
                e.note.clone(),
            ]
        })
        .collect();
    page = page
        .table(&["effect", "status", "held-out gain (%)", "95 % interval", "p of chance", "as good", "note"], &rows);
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
    page = page.paragraph(&format!(
        "Every random choice (hold-out, bootstrap, null) is drawn from seed {}; the same seed gives the same answer.",
        d.seed
    ));
    Ok(page)
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
        let mut sums = vec![(0.0, 0.0); count + 1];
        for s in &samples {
            if s[axis].is_finite() {
                let k = (((s[axis] - low) / width) as usize).min(count);
                sums[k].0 += s[column];
                sums[k].1 += 1.0;
            }
        }
        sums.iter()
            .enumerate()
            .filter(|(_, s)| s.1 > 0.0)
            .map(|(k, s)| (low + width * (k as f64 + if k == count { 0.0 } else { 0.5 }), s.0 / s.1))
            .collect()
    };
    let panel = |label: &str, axis: usize, count: usize| {
        Panel::new(label, "residual (rpm)").dashed("before", &bins(axis, count, 5)).line("after", &bins(axis, count, 6))
    };
    let first: Vec<(f64, f64)> = samples.iter().step_by((samples.len() / 1500).max(1)).map(|s| (s[0], s[5])).collect();
    let last: Vec<(f64, f64)> = samples.iter().step_by((samples.len() / 1500).max(1)).map(|s| (s[0], s[6])).collect();
    Figure::new("Residuals before and after")
        .columns(2)
        .size(1000, 1100)
        .panel(panel("time in the run (s)", 0, 40))
        .panel(panel("angle since the start (degrees)", 1, 36))
        .panel(panel("duty", 2, 20))
        .panel(panel("direction (1 = cw)", 3, 2))
        .panel(panel("order of the run", 4, (n as usize).clamp(2, 60)))
        .panel(Panel::new("time in the run (s)", "residual (rpm)").points("before", &first).points("after", &last))
}

/// Speed over input of ordinary motors.
pub fn inertial_figure(o: &InertialOutcome) -> Figure {
    let mut speed = Panel::new("input (largest = 1)", "speed (rpm)");
    let mut rest = Panel::new("input (largest = 1)", "residual (rpm)");
    for (run, predicted) in o.runs.iter().zip(&o.predicted) {
        let at = |v: &[f64]| run.input.iter().copied().zip(v.iter().copied()).collect::<Vec<_>>();
        speed = speed
            .points(format!("{} measured", run.id), &at(&run.rpm))
            .line(format!("{} extended", run.id), &at(predicted));
        let before: Vec<f64> = run.rpm.iter().zip(&run.input).map(|(y, u)| y - u * o.gain_rpm).collect();
        let after: Vec<f64> = run.rpm.iter().zip(predicted).map(|(y, p)| y - p).collect();
        rest = rest.dashed(format!("{} before", run.id), &at(&before)).line(format!("{} after", run.id), &at(&after));
    }
    Figure::new("Speed over input").size(1000, 800).panel(speed).panel(rest)
}
