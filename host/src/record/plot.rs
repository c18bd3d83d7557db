//! Pictures of recordings and measurement folders. What is missing is drawn as missing.

use super::convert::to_edges;
use super::measurement::{self, DriveResponse, LevelEdge, Measurement, Run, RunData};
use super::recording::{ControlSegment, EventKind, Recording};
use crate::report::figure::{Figure, Panel};
use crate::signal::edges::{Directions, EdgeTrain};
use crate::signal::smoother::smooth;
use thiserror::Error;

/// A line is thinned to this many columns before it is drawn: more than any picture shows.
const COLUMNS: f64 = 8_000.0;
/// Records of more edges show the speed between neighbouring edges instead of the smoother's estimate.
const MAX_SMOOTHED_EDGES: usize = 20_000;
/// Instants at which the smoother is asked.
const SMOOTHED_POINTS: usize = 2_000;
/// Uncertainty of a timestamped edge: the resolution of its clock, µs.
const EDGE_UNCERTAINTY_US: f64 = 1.0;
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
    /// More runs than fit.
    #[error("{0} runs do not fit one picture (at most {MAX_RUNS_DRAWN}): choose one with --run")]
    TooManyRuns(usize),
}

/// First, lowest, highest and last value of each column of equal width, so that memory does not grow with the record.
struct Trace {
    column_s: f64,
    column: i64,
    points: Vec<(f64, f64)>,
    /// First, lowest, highest, last.
    current: Option<[(f64, f64); 4]>,
}

impl Trace {
    /// A trace of a record `span_s` long.
    fn new(span_s: f64) -> Self {
        Self { column_s: (span_s / COLUMNS).max(1e-9), column: 0, points: Vec::new(), current: None }
    }

    fn push(&mut self, time_s: f64, value: f64) {
        let point = (time_s, value);
        let column = (time_s / self.column_s).floor() as i64;
        match &mut self.current {
            Some([_, low, high, last]) if column == self.column => {
                *last = point;
                if value < low.1 {
                    *low = point;
                }
                if value > high.1 {
                    *high = point;
                }
            }
            _ => {
                self.flush();
                self.column = column;
                self.current = Some([point; 4]);
            }
        }
    }

    /// Breaks the line.
    fn gap(&mut self) {
        self.flush();
        if self.points.last().is_some_and(|point| point.1.is_finite()) {
            self.points.push((f64::NAN, f64::NAN));
        }
    }

    fn flush(&mut self) {
        if let Some([first, low, high, last]) = self.current.take() {
            let (early, late) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            self.points.extend([first, early, late, last]);
            self.points.dedup();
        }
    }

    fn done(mut self) -> Vec<(f64, f64)> {
        self.flush();
        self.points
    }
}

/// Position, error, speed and duty of a whole recording against the host's time.
///
/// # Errors
/// [`PlotError::Empty`].
pub fn recording_figure(recording: &Recording, title: &str) -> Result<Figure, PlotError> {
    let time_s = |session: u32, time_us: u64| recording.host_time_ns(session, time_us) as f64 * 1e-9;
    let span_s =
        (0..).zip(&recording.sessions).map(|(index, session)| time_s(index, session.end_us)).fold(0.0, f64::max);
    let begin_s = first_time_s(recording, &time_s).min(span_s);
    let edges_per_rev = recording
        .runs
        .iter()
        .find_map(|run| run.configuration)
        .map_or(f64::from(measurement::DEFAULT_EDGES_PER_REV), |configuration| f64::from(configuration.edges_per_rev));
    let degrees = 360.0 / edges_per_rev;
    let mut panels = Vec::new();

    if !recording.control.is_empty() {
        let trace = |value: &dyn Fn(&ControlSegment, usize) -> f64| {
            let mut trace = Trace::new(span_s);
            for segment in &recording.control {
                let start_s = time_s(segment.session, segment.first_us);
                let period_s = f64::from(segment.period_us) * 1e-6;
                for index in 0..segment.samples.len() {
                    trace.push(start_s + period_s * index as f64, value(segment, index));
                }
                trace.gap();
            }
            trace.done()
        };
        let target = trace(&|segment, index| f64::from(segment.samples[index].target) * degrees);
        let position = trace(&|segment, index| f64::from(segment.samples[index].position) * degrees);
        let error = trace(&|segment, index| {
            let sample = &segment.samples[index];
            (f64::from(sample.target) - f64::from(sample.position)) * degrees
        });
        panels.push(Panel::new("time (s)", "position (°)").line("target", &target).line("position", &position));
        panels.push(Panel::new("time (s)", "error (°)").line("target − position", &error));
    }

    let records = encoder_records(recording, &time_s);
    if !records.is_empty() {
        let edges_per_rev = edges_per_rev as u32;
        if recording.control.is_empty() {
            panels.push(position_panel(&records, edges_per_rev, span_s));
        }
        panels.push(speed_panel(&records, edges_per_rev, span_s));
    }
    if panels.is_empty() {
        return Err(PlotError::Empty);
    }

    let mut duty = Trace::new(span_s);
    let label = if recording.control.is_empty() {
        for (session, time_us, status) in &recording.status {
            let fraction = f64::from(status.duty.raw()) / f64::from(twum_shared::Duty::FULL.raw());
            duty.push(time_s(*session, *time_us), fraction * f64::from(status.direction.sign()));
        }
        "duty (status)"
    } else {
        for segment in &recording.control {
            for (index, sample) in segment.samples.iter().enumerate() {
                let fraction = f64::from(sample.on_steps) / f64::from(segment.duty_steps.max(1));
                let at_s = time_s(segment.session, segment.time_us(index));
                duty.push(at_s, fraction * f64::from(sample.direction.sign()));
            }
            duty.gap();
        }
        "duty"
    };
    let faults: Vec<f64> = recording
        .events
        .iter()
        .filter(|event| matches!(event.kind, EventKind::Fault(_)))
        .map(|event| event.host_time_ns as f64 * 1e-9)
        .collect();
    let mut panel = Panel::new("time (s)", "drive on, signed (1)").line(label, &duty.done());
    if !faults.is_empty() {
        panel = panel.marks("fault", &faults);
    }
    panels.push(panel);
    let figure = Figure::new(title);
    Ok(panels.into_iter().fold(figure, |figure, panel| figure.panel(panel.x_range(begin_s, span_s))))
}

/// When the first signal begins.
fn first_time_s(recording: &Recording, time_s: &dyn Fn(u32, u64) -> f64) -> f64 {
    let control = recording.control.iter().map(|segment| time_s(segment.session, segment.first_us));
    let bits = recording.bits.iter().map(|segment| time_s(segment.session, segment.first_us));
    let edges = recording
        .edges
        .iter()
        .filter_map(|segment| segment.edges.first().map(|edge| time_s(segment.session, edge.time_us)));
    control.chain(bits).chain(edges).fold(f64::INFINITY, f64::min)
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
            vec![speed_panel(&records, edges_per_rev, span_s), position_panel(&records, edges_per_rev, span_s)]
        }
        RunData::Velocity { time_us, rpm } => {
            vec![Panel::new("time (s)", "speed (rpm)").line("speed", &series(time_us, rpm))]
        }
        RunData::Drive { time_us, input, response } => {
            let (label, name, values) = match response {
                DriveResponse::PositionRad(values) => ("position (rad)", "position", values),
                DriveResponse::SpeedRpm(values) => ("speed (rpm)", "speed", values),
            };
            vec![
                Panel::new("time (s)", label).line(name, &series(time_us, values)),
                Panel::new("time (s)", "input").line("input", &series(time_us, input)),
            ]
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

/// A record of the encoder without a gap.
struct EncoderRecord {
    /// Levels or edges.
    data: RunData,
    directions: Directions,
    /// Time of its clock's zero in the picture.
    offset_s: f64,
    uncertainty_us: f64,
}

impl EncoderRecord {
    fn train(&self, edges_per_rev: u32) -> Option<EdgeTrain> {
        let train = match &self.data {
            RunData::Levels { start_us, period_us, levels } => {
                EdgeTrain::from_levels(*start_us, *period_us, levels, edges_per_rev, &self.directions)
            }
            RunData::Edges { start_us, edges, end_us, .. } => {
                EdgeTrain::from_times(*start_us, *end_us, edges, self.uncertainty_us, edges_per_rev, &self.directions)
            }
            _ => return None,
        };
        train.ok()
    }
}

/// The encoder of a recording: its edges, or its bits where no edges were captured.
fn encoder_records(recording: &Recording, time_s: &dyn Fn(u32, u64) -> f64) -> Vec<EncoderRecord> {
    if recording.edges.iter().any(|segment| !segment.edges.is_empty()) {
        let records = recording.edges.iter().filter_map(|segment| {
            let (first, last) = (segment.edges.first()?, segment.edges.last()?);
            let zero_us = first.time_us;
            let at = |time_us: u64| (time_us - zero_us) as f64;
            let side = |direction: twum_shared::Direction| {
                if direction.pin_high() { measurement::Direction::Cw } else { measurement::Direction::Ccw }
            };
            let in_order = segment.edges.windows(2).filter(|pair| pair[0].direction != pair[1].direction);
            let changes: Vec<(f64, measurement::Direction)> =
                in_order.map(|pair| (at(pair[1].time_us) - 0.5, side(pair[1].direction))).collect();
            let edges = segment
                .edges
                .iter()
                .map(|edge| LevelEdge { time_us: at(edge.time_us.max(zero_us)), level: edge.level });
            Some(EncoderRecord {
                data: RunData::Edges {
                    initial: !first.level,
                    start_us: 0.0,
                    edges: edges.collect(),
                    end_us: at(last.time_us),
                },
                directions: Directions::changing(side(first.direction), &changes),
                offset_s: time_s(segment.session, zero_us),
                uncertainty_us: EDGE_UNCERTAINTY_US,
            })
        });
        return records.collect();
    }
    let records = recording.bits.iter().filter(|segment| segment.levels.len() > 1).map(|segment| EncoderRecord {
        data: RunData::Levels { start_us: 0.0, period_us: 1000.0, levels: segment.levels.clone() },
        directions: Directions::constant(measurement::Direction::Cw),
        offset_s: time_s(segment.session, segment.first_us),
        uncertainty_us: EDGE_UNCERTAINTY_US,
    });
    records.collect()
}

fn position_panel(records: &[EncoderRecord], edges_per_rev: u32, span_s: f64) -> Panel {
    let mut trace = Trace::new(span_s);
    for record in records {
        if let Some(train) = record.train(edges_per_rev) {
            let degrees = train.pitch_rad.to_degrees();
            trace.push(record.offset_s + train.start_us * 1e-6, 0.0);
            for edge in &train.edges {
                trace.push(record.offset_s + edge.middle_us() * 1e-6, edge.count_after() as f64 * degrees);
            }
        }
        trace.gap();
    }
    Panel::new("time (s)", "position (°)").line("edges counted", &trace.done())
}

fn speed_panel(records: &[EncoderRecord], edges_per_rev: u32, span_s: f64) -> Panel {
    let total: usize = records
        .iter()
        .map(|record| match to_edges(record.data.clone()) {
            RunData::Edges { edges, .. } => edges.len(),
            _ => 0,
        })
        .sum();
    if total > MAX_SMOOTHED_EDGES {
        return interval_speed_panel(records, edges_per_rev, span_s);
    }
    let (mut line, mut band) = (Vec::new(), Vec::new());
    for record in records {
        let Some(train) = record.train(edges_per_rev).filter(|train| train.edges.len() > 1) else { continue };
        let length_us = train.end_us - train.start_us;
        let share = length_us * 1e-6 / span_s.max(1e-6);
        let points = ((share * SMOOTHED_POINTS as f64) as usize).clamp(2, SMOOTHED_POINTS);
        let at_us: Vec<f64> =
            (0..points).map(|index| train.start_us + length_us * index as f64 / (points - 1) as f64).collect();
        let Ok(smoothed) = smooth(&train, &at_us) else { continue };
        for index in 0..points {
            let at_s = record.offset_s + smoothed.time_us[index] * 1e-6;
            let (rpm, spread) = (smoothed.speed_rpm[index], 1.96 * smoothed.speed_sd_rpm[index]);
            line.push((at_s, rpm));
            band.push((at_s, rpm - spread, rpm + spread));
        }
        line.push((f64::NAN, f64::NAN));
        band.push((f64::NAN, f64::NAN, f64::NAN));
    }
    let panel = Panel::new("time (s)", "speed (rpm)").line("speed", &line).band("95 %", &band);
    let finite = || line.iter().map(|point| point.1).filter(|rpm| rpm.is_finite());
    let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    // Where the estimate is poor its band would leave nothing of the line.
    let margin = 0.4 * (high - low).max(1.0);
    if low <= high { panel.y_range(low - margin, high + margin) } else { panel }
}

/// The speed over each two pitches, which odd and even edges of unequal length do not disturb.
fn interval_speed_panel(records: &[EncoderRecord], edges_per_rev: u32, span_s: f64) -> Panel {
    let mut trace = Trace::new(span_s);
    for record in records {
        for three in record.train(edges_per_rev).iter().flat_map(|train| train.edges.windows(3)) {
            let [first, middle, last] = three else { continue };
            let time_s = (last.middle_us() - first.middle_us()) * 1e-6;
            let turns = (last.count_after() - first.count_after()) as f64 / f64::from(edges_per_rev);
            if time_s > 0.0 {
                trace.push(record.offset_s + middle.middle_us() * 1e-6, 60.0 * turns / time_s);
            }
        }
        trace.gap();
    }
    Panel::new("time (s)", "speed (rpm)").line("speed over two pitches", &trace.done())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::measurement::RunKind;
    use crate::record::synthetic::{Line, configured, control_blocks};
    use twum_shared::message::DeviceMessage;
    use twum_shared::step::ConfigSpec;

    #[test]
    fn a_trace_keeps_extremes_and_gaps_and_forgets_the_rest() {
        let mut trace = Trace::new(100.0);
        for index in 0..1_000_000 {
            let time_s = f64::from(index) * 1e-4;
            trace.push(time_s, if index == 512_345 { 9.0 } else { time_s.sin() });
            if index == 700_000 {
                trace.gap();
            }
        }
        let points = trace.done();
        assert!(points.len() < 4 * 8_001 + 10, "{}", points.len());
        assert_eq!(points.iter().filter(|point| point.1 == 9.0).count(), 1);
        assert_eq!(points.iter().filter(|point| point.1.is_nan()).count(), 1);
    }

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
            let recording = Recording::load(&path).unwrap();
            recording_figure(&recording, "a").unwrap().svg().unwrap()
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
                RunData::Drive { time_us, input: vec![1.0; 4], response: DriveResponse::PositionRad(vec![0.5; 4]) },
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
        }
        let error = measurement_figure(&measurement, Some("z")).unwrap_err().to_string();
        assert_eq!(error, "no run `z`; the runs are: v, d, e");
    }
}
