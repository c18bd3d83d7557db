//! The page of `twum compare`: every number it found, and the pictures.

use super::figure::{Figure, Panel};
use super::page::Page;
use super::speed::{self, Simulated};
use super::table::table;
use crate::compare::closed_loop::{ClosedLoop, rpm, stretches};
use crate::compare::simulation::{Comparison, RunComparison};
use crate::record::measurement::ControlRow;
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

impl std::fmt::Display for Comparison {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let seconds = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{:.0}", v * 1e3));
        let both = |v: [f64; 2]| format!("{:.3} {:.3}", v[0], v[1]);
        let row = |r: &RunComparison| {
            let (m, s) = (&r.measured, &r.simulated);
            vec![
                r.id.clone(),
                format!("{:.2}", r.duty),
                both([m.mean_rpm, s.mean_rpm]),
                both([m.start_peak_rpm, s.start_peak_rpm]),
                format!("{} {}", seconds(m.rise_s), seconds(s.rise_s)),
                format!("{} {}", seconds(m.stop_s), seconds(s.stop_s)),
                format!("{:.3}", r.rmse_speed_rpm),
                format!("{:.2}", r.rmse_position_deg),
            ]
        };
        let header = ["run", "duty", "mean rpm", "start peak rpm", "rise ms", "stop ms", "RMSE rpm", "RMSE °"];
        write!(f, "{}", table(&header, &self.runs.iter().map(row).collect::<Vec<_>>()))?;
        writeln!(f, "(two numbers: measured, simulated with the {} model)", self.flavour)?;
        let r2 = self.r2_speed.map_or("needs three duties".to_owned(), |v| format!("{v:.4}"));
        writeln!(f, "R² of speed against duty: {r2}")?;
        writeln!(f, "RMSE of the speed: {:.3} rpm, of the angle: {:.2}°", self.rmse_speed_rpm, self.rmse_position_deg)?;
        if !self.left_out.is_empty() {
            writeln!(f, "left out (closed loop, or no duty): {}", self.left_out.join(", "))?;
        }
        Ok(())
    }
}

impl Comparison {
    /// Of several runs, speeds against time, their difference, and mean speeds against duty; of one, what
    /// [`speed::figure`] shows of it with the simulation beside it.
    ///
    /// # Errors
    /// As [`speed::figure`].
    pub fn figure(&self, title: &str) -> Result<Figure, SignalError> {
        if let [run] = self.runs.as_slice() {
            let times_s = run.motion.time_us.iter().map(|t| t * 1e-6);
            let simulated = Simulated { speed: times_s.zip(run.simulated_rpm.iter().copied()).collect() };
            return speed::figure(&format!("{title}, run {}", run.id), &run.motion, run.drive, Some(&simulated));
        }
        Ok(self.overview(title))
    }

    fn overview(&self, title: &str) -> Figure {
        /// More names than this make a legend nobody reads.
        const MOST_NAMED: usize = 6;
        let mut speeds = Panel::new("time (s)", "speed (rpm)").title("Measured and simulated");
        let mut differences = Panel::new("time (s)", "difference (rpm)").title("Measured less simulated");
        for run in &self.runs {
            let named = self.runs.len() <= MOST_NAMED;
            let name = |what: &str| if named { format!("{} {what}", run.id) } else { what.to_owned() };
            let (measured, simulated) = (&run.motion.speed_rpm, &run.simulated_rpm);
            let column = |f: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
                run.motion.time_us.iter().enumerate().map(|(i, t)| (t * 1e-6, f(i))).collect()
            };
            speeds = speeds
                .line(name("measured"), &column(&|i| measured[i]))
                .dashed(name("simulated"), &column(&|i| simulated[i]));
            differences =
                differences.line(if named { run.id.as_str() } else { "" }, &column(&|i| measured[i] - simulated[i]));
        }
        let of = |f: &dyn Fn(&RunComparison) -> f64| -> Vec<(f64, f64)> {
            self.runs.iter().map(|r| (100.0 * r.duty, f(r))).collect()
        };
        let r2 = self.r2_speed.map_or(String::new(), |v| format!(" (R\u{b2} {v:.3})"));
        let duty = Panel::new("duty (%)", "mean speed (rpm)")
            .title(format!("Speed against duty{r2}"))
            .x_range(0.0, 100.0)
            .points("measured", &of(&|r| r.measured.mean_rpm))
            .points("simulated", &of(&|r| r.simulated.mean_rpm));
        Figure::new(title).size(1000, 960).panel(speeds).panel(differences).panel(duty)
    }
}

impl ClosedLoop {
    /// Position against time, recorded and replayed, and what the replay lacks.
    pub fn panels(&self) -> [Panel; 2] {
        let degrees = 360.0 / f64::from(self.edges_per_rev);
        let line = |f: &dyn Fn(&(ControlRow, f64)) -> f64| -> Vec<(f64, f64)> {
            self.ticks.iter().map(|tick| (tick.0.time_us * 1e-6, f(tick) * degrees)).collect()
        };
        let rows: Vec<ControlRow> = self.ticks.iter().map(|tick| tick.0).collect();
        let replayed: Vec<f64> = self.ticks.iter().map(|tick| tick.1).collect();
        let left: Vec<(f64, f64)> = stretches(&rows, &replayed)
            .into_iter()
            .map(|(time_s, length_s, m, s)| (time_s, rpm(m - s, length_s, self.edges_per_rev)))
            .collect();
        [
            Panel::new("time (s)", "position (\u{b0})")
                .title(format!("{}: motor and simulated motor under the recorded duty", self.run))
                .line("target", &line(&|tick| tick.0.target))
                .line("measured", &line(&|tick| tick.0.position))
                .dashed("simulated", &line(&|tick| tick.1)),
            Panel::new("time (s)", "difference (rpm)")
                .title(format!("{}: measured less simulated speed, over 0.1 s each", self.run))
                .line(self.run.as_str(), &left),
        ]
    }
}
