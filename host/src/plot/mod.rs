//! Pictures of recordings and measurement folders. What is missing is drawn as missing.

mod encoder;
mod recording;
mod trace;

pub use recording::{recording_figure, timing_panel};

use crate::record::measurement::{self, DriveResponse, Measurement, Run, RunData};
use crate::record::store::StoreError;
use crate::report::figure::{Figure, Panel};
use crate::signal::edges::Directions;
use encoder::{EDGE_UNCERTAINTY_US, EncoderRecord, panels};
use thiserror::Error;
use trace::Trace;

/// Runs drawn into one picture of a folder.
pub const MAX_RUNS_DRAWN: usize = 24;

/// Why there is nothing to draw.
#[derive(Debug, Error)]
pub enum PlotError {
    /// No signal at all.
    #[error("no encoder or control data to plot; the recording's events are in `twum export --to csv`")]
    Empty,
    /// No run of that name.
    #[error("no run `{asked}`; the runs are: {known}")]
    NoSuchRun {
        /// What was asked for.
        asked: String,
        /// What there is.
        known: String,
    },
    /// The recording cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// More runs than fit.
    #[error("{0} runs do not fit one picture (at most {MAX_RUNS_DRAWN}): choose one with --run")]
    TooManyRuns(usize),
}

/// The runs of a measurement folder: one panel each, or every quantity of the one asked for.
///
/// # Errors
/// A run that is not there, or more runs than fit.
pub fn measurement_figure(measurement: &Measurement, run: Option<&str>) -> Result<Figure, PlotError> {
    let figure = Figure::new(&measurement.name);
    let asked = match run {
        None if measurement.runs.len() > 1 => {
            if measurement.runs.len() > MAX_RUNS_DRAWN {
                return Err(PlotError::TooManyRuns(measurement.runs.len()));
            }
            let columns = if measurement.runs.len() > 3 { 2 } else { 1 };
            let panels = measurement.runs.iter().filter_map(|run| {
                let panel = run_panels(run, measurement.edges_per_rev).into_iter().next()?;
                Some(panel.title(run_title(run)))
            });
            return Ok(panels.fold(figure.columns(columns), Figure::panel));
        }
        None => measurement.runs.first(),
        Some(id) => measurement.runs.iter().find(|run| run.id == id),
    };
    let Some(found) = asked else {
        let known: Vec<&str> = measurement.runs.iter().take(40).map(|run| run.id.as_str()).collect();
        return Err(PlotError::NoSuchRun { asked: run.unwrap_or_default().to_owned(), known: known.join(", ") });
    };
    let figure = Figure::new(format!("{}: {}", measurement.name, run_title(found)));
    Ok(run_panels(found, measurement.edges_per_rev).into_iter().fold(figure, Figure::panel))
}

fn run_title(run: &Run) -> String {
    let duty = run.duty.map_or(String::new(), |duty| format!(", duty {duty:.3}"));
    let direction = run.direction.map_or(String::new(), |direction| format!(", {direction:?}").to_lowercase());
    format!("{}{duty}{direction}", run.id)
}

/// The panels of one run, the most telling one first.
fn run_panels(run: &Run, edges_per_rev: u32) -> Vec<Panel> {
    let (start_us, end_us) = run.span_us();
    let span_s = (end_us - start_us) * 1e-6;
    let series = |time_us: &[f64], values: &[f64]| {
        let mut trace = Trace::new(span_s);
        let usual_us = median_step(time_us);
        for (index, (time_us_here, value)) in time_us.iter().zip(values).enumerate() {
            if index > 0 && time_us_here - time_us[index - 1] > 3.0 * usual_us {
                trace.gap();
            }
            trace.push(time_us_here * 1e-6, *value);
        }
        trace.done()
    };
    match &run.data {
        RunData::Levels { .. } | RunData::Edges { .. } => {
            let sign = run.direction.unwrap_or(measurement::Direction::Cw);
            let record = EncoderRecord {
                data: run.data.clone(),
                directions: Directions::constant(sign),
                offset_s: 0.0,
                uncertainty_us: EDGE_UNCERTAINTY_US,
            };
            let records = [record];
            let (position, speed) = panels(&records, edges_per_rev, span_s);
            vec![speed, position]
        }
        RunData::Velocity { time_us, rpm } => {
            vec![Panel::new("time (s)", "speed (rpm)").line("speed", &series(time_us, rpm))]
        }
        RunData::Drive { time_us, input, response, beside } => {
            let (label, name, values) = match response {
                DriveResponse::PositionRad(values) => ("position (rad)", "position", values),
                DriveResponse::SpeedRpm(values) => ("speed (rpm)", "speed", values),
            };
            let mut panels = vec![
                Panel::new("time (s)", label).line(name, &series(time_us, values)),
                Panel::new("time (s)", "input").line("input", &series(time_us, input)),
            ];
            let more = |(column, values): (&measurement::Beside, &Vec<f64>)| {
                Panel::new("time (s)", column.name()).line(column.name(), &series(time_us, values))
            };
            panels.extend(beside.iter().map(more));
            panels
        }
        RunData::Control(rows) => {
            let time_us: Vec<f64> = rows.iter().map(|row| row.time_us).collect();
            let degrees = 360.0 / f64::from(edges_per_rev);
            let column = |value: &dyn Fn(&measurement::ControlRow) -> f64| {
                let values: Vec<f64> = rows.iter().map(value).collect();
                series(&time_us, &values)
            };
            vec![
                Panel::new("time (s)", "position (°)")
                    .line("target", &column(&|row| row.target * degrees))
                    .line("position", &column(&|row| row.position * degrees)),
                Panel::new("time (s)", "error (°)")
                    .line("target − position", &column(&|row| (row.target - row.position) * degrees)),
                Panel::new("time (s)", "control signal u (duty steps)").line("u", &column(&|row| row.u)),
                Panel::new("time (s)", "drive on, signed (1)")
                    .line("duty", &column(&|row| row.duty * row.direction.sign())),
            ]
        }
    }
}

fn median_step(time_us: &[f64]) -> f64 {
    let mut steps: Vec<f64> = time_us.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let middle = steps.len() / 2;
    if steps.is_empty() { f64::INFINITY } else { *steps.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::measurement::{LevelEdge, RunKind};
    use crate::record::synthetic::{Line, configured, control_blocks};
    use twum_shared::message::DeviceMessage;
    use twum_shared::step::ConfigSpec;

    #[test]
    fn a_recording_with_a_gap_is_drawn_with_a_gap_and_the_same_bytes_every_time() {
        let dir = tempfile::tempdir().unwrap();
        let draw = |name: &str, lost: std::ops::Range<usize>| {
            let path = dir.path().join(name);
            let mut line = Line::new(&path);
            line.device(configured(ConfigSpec::THESIS));
            for (index, block) in control_blocks(ConfigSpec::THESIS, 1000, 60).into_iter().enumerate() {
                line.now_us = block.first_us + 8000;
                let message = DeviceMessage::Control(block);
                if lost.contains(&index) { line.lost(message) } else { line.device(message) }
            }
            line.finish();
            recording_figure(&path, "a").unwrap().0.svg().unwrap()
        };
        let lines = |svg: &str| svg.lines().filter(|line| line.starts_with("<polyline")).count();
        let gapped = draw("a", 20..40);
        assert_eq!(gapped, draw("b", 20..40));
        // Target, position, error and duty fall into two stretches each.
        assert_eq!(lines(&gapped), lines(&draw("c", 0..0)) + 4);
    }

    #[test]
    fn every_kind_of_run_is_drawn_and_a_missing_one_is_named() {
        let time_us = vec![0.0, 1000.0, 2000.0, 9000.0];
        let edges = (0..40).map(|i| LevelEdge { time_us: 3000.0 * f64::from(i + 1), level: i % 2 == 0 }).collect();
        let runs = vec![
            Run::new("v", RunKind::Speed, RunData::Velocity { time_us: time_us.clone(), rpm: vec![1.0; 4] }),
            Run::new(
                "d",
                RunKind::Speed,
                RunData::Drive {
                    time_us,
                    input: vec![1.0; 4],
                    response: DriveResponse::PositionRad(vec![0.5; 4]),
                    beside: [(measurement::Beside::Load, vec![0.1; 4])].into(),
                },
            ),
            Run::new("e", RunKind::Speed, RunData::Edges { initial: false, start_us: 0.0, edges, end_us: 130_000.0 }),
        ];
        let measurement = Measurement {
            name: "bench".into(),
            motor: "x".into(),
            edges_per_rev: 400,
            runs,
            folder: Default::default(),
        };
        for run in [None, Some("v"), Some("d"), Some("e")] {
            let svg = measurement_figure(&measurement, run).unwrap().svg().unwrap();
            assert!(svg.contains("speed (rpm)") || svg.contains("position (rad)"));
            assert_eq!(svg.contains("load"), run == Some("d"), "{run:?}");
        }
        let error = measurement_figure(&measurement, Some("z")).unwrap_err().to_string();
        assert_eq!(error, "no run `z`; the runs are: v, d, e");
    }
}
