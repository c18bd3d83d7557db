//! What a measurement folder holds, and what a person should know before trusting it.

use super::convert::changes;
use super::measurement::{ControlSpec, Direction, Format, Measurement, Run, RunData, RunKind};
use serde::Serialize;

/// The summary of a measurement folder.
#[derive(Debug, Clone, Serialize)]
pub struct FolderCheck {
    /// Free name of the measurement.
    pub name: String,
    /// Motor parameter set or file.
    pub motor: String,
    /// Encoder edges a revolution.
    pub edges_per_rev: u32,
    /// One entry a run.
    pub runs: Vec<RunCheck>,
}

/// The summary of one run.
#[derive(Debug, Clone, Serialize)]
pub struct RunCheck {
    /// The run's id.
    pub id: String,
    /// Open or closed loop.
    pub kind: RunKind,
    /// Format of its file.
    pub format: Format,
    /// Fraction of the PWM period with drive on.
    pub duty: Option<f64>,
    /// Commanded direction.
    pub direction: Option<Direction>,
    /// Number of samples.
    pub samples: usize,
    /// Number of encoder edges, where the format shows them.
    pub edges: Option<usize>,
    /// Time from the first to the last sample in seconds.
    pub duration_s: f64,
    /// What is missing or looks wrong without making the run unreadable.
    pub notes: Vec<String>,
}

/// Summarises a folder. Nothing here is an error: those end [`Measurement::load`].
pub fn check(measurement: &Measurement) -> FolderCheck {
    FolderCheck {
        name: measurement.name.clone(),
        motor: measurement.motor.clone(),
        edges_per_rev: measurement.edges_per_rev,
        runs: measurement.runs.iter().map(check_run).collect(),
    }
}

fn check_run(run: &Run) -> RunCheck {
    let (start_us, end_us) = run.span_us();
    RunCheck {
        id: run.id.clone(),
        kind: run.kind,
        format: run.format,
        duty: run.duty,
        direction: run.direction,
        samples: run.data.len(),
        edges: edge_count(&run.data),
        duration_s: (end_us - start_us) * 1e-6,
        notes: notes(run, end_us * 1e-6),
    }
}

fn edge_count(data: &RunData) -> Option<usize> {
    match data {
        RunData::Levels { levels, .. } => Some(changes(levels).count()),
        RunData::Edges { edges, .. } => Some(edges.len()),
        _ => None,
    }
}

fn notes(run: &Run, end_s: f64) -> Vec<String> {
    let mut notes = Vec::new();
    let drive_on_s = run.drive_on_s.unwrap_or(0.0);
    if run.stopped_by_equal_words() {
        let mut note = format!("the capture stopped at {end_s:.3} s by its own rule (5 equal words of 32 samples)");
        if drive_on_s > end_s {
            note += &format!(
                ", while the drive was on until {drive_on_s} s: what the motor did later is unknown, not zero"
            );
        }
        notes.push(note);
    } else if drive_on_s > end_s {
        notes.push(format!("the record ends at {end_s:.3} s, before the drive was switched off at {drive_on_s} s"));
    }
    if run.kind == RunKind::Speed && run.format != Format::Drive {
        if run.duty.is_none() {
            notes.push("no duty: the run cannot be held against a model".to_owned());
        }
        if run.direction.is_none() {
            notes.push("no direction: the encoder does not show it".to_owned());
        }
    }
    if run.kind == RunKind::Track && run.control.is_none() {
        notes.push("no control: the controller cannot be recomputed".to_owned());
    }
    match &run.data {
        RunData::Levels { levels, .. } => {
            let edges: Vec<usize> = changes(levels).collect();
            let close = edges.windows(2).filter(|pair| pair[1] - pair[0] < 2).count();
            if edges.is_empty() {
                notes.push("no edge: the motor did not turn, or the encoder was silent".to_owned());
            } else if close > 0 {
                notes.push(format!(
                    "{close} edges one sample apart: near the sampling limit, where edges go missing unseen"
                ));
            }
        }
        RunData::Edges { edges, .. } if edges.is_empty() => {
            notes.push("no edge: the motor did not turn, or the encoder was silent".to_owned());
        }
        RunData::Control(rows) => {
            let period_us = match run.control {
                Some(ControlSpec::Table(gains)) => Some(gains.period_us),
                _ => median(rows.windows(2).map(|pair| pair[1].time_us - pair[0].time_us).collect()),
            };
            if let Some(period_us) = period_us {
                let missing = |pair: &[super::measurement::ControlRow]| {
                    ((pair[1].time_us - pair[0].time_us) / period_us).round() - 1.0
                };
                let gaps: Vec<f64> = rows.windows(2).map(missing).filter(|ticks| *ticks >= 1.0).collect();
                if !gaps.is_empty() {
                    let ticks: f64 = gaps.iter().sum();
                    notes.push(format!("{} gaps, {ticks} control ticks missing (period {period_us} µs)", gaps.len()));
                }
            }
        }
        _ => {}
    }
    notes
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::ControlRow;

    fn levels(levels: Vec<bool>) -> RunData {
        RunData::Levels { start_us: 0.0, period_us: 1000.0, levels }
    }

    fn noted(run: &Run) -> String {
        check_run(run).notes.join("; ")
    }

    #[test]
    fn a_record_that_ends_before_the_drive_does_is_said_to() {
        let mut run = Run::new("a", RunKind::Speed, levels(vec![false; 320]));
        run.drive_on_s = Some(5.0);
        assert!(noted(&run).contains("ends at 0.319 s, before the drive"));
        run.format = Format::Packed;
        assert!(noted(&run).contains("unknown, not zero"));
        run.drive_on_s = Some(0.1);
        assert!(noted(&run).contains("by its own rule") && !noted(&run).contains("unknown"));
    }

    #[test]
    fn missing_control_ticks_are_counted() {
        let row = |tick: u32| ControlRow {
            time_us: f64::from(tick) * 500.0,
            target: 0.0,
            position: 0.0,
            u: 0.0,
            duty: 0.0,
            direction: Direction::Cw,
        };
        let rows = [0, 1, 2, 3, 6, 7, 9].map(row).to_vec();
        let run = Run::new("a", RunKind::Track, RunData::Control(rows));
        assert!(noted(&run).contains("2 gaps, 3 control ticks missing"), "{}", noted(&run));
    }

    #[test]
    fn edges_are_counted_and_their_absence_noted() {
        let run = Run::new("a", RunKind::Speed, levels(vec![false, true, true, false, true]));
        assert_eq!(check_run(&run).edges, Some(3));
        assert!(noted(&run).contains("1 edges one sample apart"));
        assert!(noted(&Run::new("a", RunKind::Speed, levels(vec![true; 9]))).contains("no edge"));
    }
}
