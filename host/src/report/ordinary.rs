//! An ordinary motor against a saved one, as `twum compare` shows it.

use super::figure::{Figure, Panel};
use super::page::Page;
use super::table::table;
use crate::compare::ordinary::Ordinary;
use crate::diagnose::inertial::RunAgainst;

/// Runs that are drawn: more are rows of the table.
const DRAWN: usize = 6;

impl Ordinary {
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |r: &RunAgainst| {
            vec![r.id.clone(), format!("{:.3}", r.rmse_rpm), format!("{:.2}", 100.0 * r.rmse_relative)]
        };
        self.runs.iter().map(row).collect()
    }

    fn summary(&self) -> String {
        format!("RMSE of the speed {:.3} rpm, against the saved motor {}", self.rmse_speed_rpm, self.motor)
    }

    /// Measured and simulated speeds.
    pub fn figure(&self, name: &str) -> Figure {
        let panel = |r: &RunAgainst| {
            let line = |rpm: &[f64]| -> Vec<(f64, f64)> { r.time_s.iter().copied().zip(rpm.iter().copied()).collect() };
            Panel::new("time (s)", "speed (rpm)")
                .title(format!("{}: {:.3} rpm RMS", r.id, r.rmse_rpm))
                .line("measured", &line(&r.measured_rpm))
                .line("saved motor", &line(&r.simulated_rpm))
        };
        self.runs.iter().take(DRAWN).map(panel).fold(Figure::new(name), Figure::panel)
    }

    /// The page.
    pub fn page(&self, name: &str) -> Page {
        let page = Page::new(format!("{name}, compared"))
            .callout(&format!("{}.", self.summary()))
            .table(&HEADER, &self.rows())
            .figure(self.figure(name), "Measured and simulated speed.");
        if self.left_out.is_empty() { page } else { page.list(&self.left_out) }
    }
}

const HEADER: [&str; 3] = ["run", "RMSE rpm", "% of the spread of its speeds"];

impl std::fmt::Display for Ordinary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", table(&HEADER, &self.rows()))?;
        writeln!(f, "{}", self.summary())?;
        self.left_out.iter().try_for_each(|note| writeln!(f, "left out: {note}"))
    }
}
