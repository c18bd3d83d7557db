//! The page of `twum compare`: every number it found, and the pictures.

use super::figure::Figure;
use super::page::Page;
use crate::compare::closed_loop::ClosedLoop;
use crate::compare::simulation::{Comparison, RunComparison};
use crate::signal::SignalError;
use std::fmt::Display;

/// Makes the page of a measurement called `name`.
///
/// # Errors
/// When a run's spectrum cannot be taken.
pub fn page(name: &str, open_loop: Option<&Comparison>, closed_loops: &[ClosedLoop]) -> Result<Page, SignalError> {
    let mut page = Page::new(format!("{name}, compared"));
    if let Some(comparison) = open_loop {
        page = open_loop_section(page, name, comparison)?;
    }
    if !closed_loops.is_empty() {
        page = closed_loop_section(page, closed_loops);
    }
    Ok(page)
}

fn open_loop_section(page: Page, name: &str, comparison: &Comparison) -> Result<Page, SignalError> {
    let summary = format!(
        "RMSE of the speed {} rpm, of the angle {}\u{b0}; R\u{b2} of speed against duty: {}.",
        number(comparison.rmse_speed_rpm, 3),
        number(comparison.rmse_position_deg, 2),
        comparison.r2_speed.map_or("needs three duties".to_owned(), |r2| number(r2, 4))
    );
    let seconds = |v: Option<f64>| v.map_or("n/a".to_owned(), |v| number(v * 1e3, 0));
    let row = |r: &RunComparison| {
        let (m, s) = (&r.measured, &r.simulated);
        vec![
            r.id.clone(),
            number(r.duty, 3),
            number(r.rmse_speed_rpm, 3),
            number(r.rmse_position_deg, 2),
            number(m.mean_rpm, 3),
            number(s.mean_rpm, 3),
            number(m.start_peak_rpm, 2),
            number(s.start_peak_rpm, 2),
            seconds(m.rise_s),
            seconds(s.rise_s),
            seconds(m.stop_s),
            seconds(s.stop_s),
        ]
    };
    let header = [
        "run",
        "duty",
        "RMSE rpm",
        "RMSE \u{b0}",
        "mean rpm",
        "simulated",
        "start peak rpm",
        "simulated",
        "rise ms",
        "simulated",
        "stop ms",
        "simulated",
    ];
    let rows: Vec<Vec<String>> = comparison.runs.iter().map(row).collect();
    let page = page
        .heading("Open loop")
        .paragraph(&format!("Against the simulation with the {} model.", comparison.flavour))
        .callout(&summary)
        .table(&header, &rows)
        .figure(comparison.figure(name)?, "Measured and simulated speed.");
    Ok(match comparison.left_out.as_slice() {
        [] => page,
        left_out => page.paragraph(&format!("Left out (closed loop, or no duty): {}.", left_out.join(", "))),
    })
}

fn closed_loop_section(page: Page, closed_loops: &[ClosedLoop]) -> Page {
    fn shown<T: Copy>(value: Option<T>, text: impl Fn(T) -> String) -> String {
        value.map_or("n/a".to_owned(), text)
    }
    let row = |r: &ClosedLoop| {
        let check = r.controller.as_ref();
        vec![
            r.run.clone(),
            shown(check.map(|c| c.ticks), |v| v.to_string()),
            shown(check.map(|c| c.mismatched), |v| v.to_string()),
            shown(check.map(|c| c.rms_steps), |v| number(v, 4)),
            shown(r.actuator.map(|a| a.duty_rms), |v| number(v, 5)),
            shown(r.actuator.map(|a| a.wrong_direction), |v| number(100.0 * v, 2)),
            shown(r.plant.gain, |v| number(v, 3)),
            shown(r.plant.explained, |v| number(v, 3)),
            number(r.plant.rms_rpm, 2),
            number(100.0 * r.sensor.against_direction, 2),
        ]
    };
    let header = [
        "run",
        "ticks recomputed",
        "differ",
        "controller, duty steps RMS",
        "actuator, duty RMS",
        "wrong direction %",
        "plant, turned so many times as far",
        "explained",
        "plant, rpm RMS",
        "counts against direction %",
    ];
    let rows: Vec<Vec<String>> = closed_loops.iter().map(row).collect();
    let mut page = page
        .heading("Closed loop")
        .paragraph(
            "Controller: the control signal recomputed from target and position. Actuator: duty and direction against the \
             control signal. Plant: the simulated motor under the recorded duty. Sensor: counts against the direction pin.",
        )
        .table(&header, &rows);
    let found: Vec<String> = closed_loops
        .iter()
        .filter_map(|r| {
            let what: &dyn Display = match (&r.not_recomputed, r.controller.as_ref().and_then(|c| c.kind.as_ref())) {
                (Some(reason), _) => reason,
                (None, Some(kind)) => kind,
                (None, None) => return None,
            };
            Some(format!("{}: {what}", r.run))
        })
        .collect();
    if !found.is_empty() {
        page = page.list(&found);
    }
    for run in closed_loops {
        let figure = run.panels().into_iter().fold(Figure::new(""), Figure::panel);
        page = page.figure(figure, &format!("Run {}.", run.run));
    }
    page
}

/// A number with a true minus sign.
fn number(value: f64, decimals: usize) -> String {
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}
