//! The picture of a whole recording. It is read twice, in pieces: memory does not grow with its length.

use super::PlotError;
use super::encoder::{MAX_SMOOTHED_EDGES, Walk, records, smoothed_speed_panel};
use super::trace::Trace;
use crate::record::convert::changes;
use crate::record::decode::Decoder;
use crate::record::measurement;
use crate::record::pieces::Piece;
use crate::record::recording::{BitsSegment, ControlSegment, EdgesSegment, EventKind, Recording};
use crate::report::figure::{Figure, Panel};
use std::collections::BTreeMap;
use std::path::Path;
use twum_shared::Duty;
use twum_shared::message::Status;

/// Samples of the encoder's level that are kept for the smoother: an hour's.
const MAX_SMOOTHED_SAMPLES: u64 = 3_600_000;

/// What has to be known of a recording before it is drawn.
#[derive(Default)]
struct Survey {
    /// Earliest signal of each of the board's starts, µs.
    first_us: BTreeMap<u32, u64>,
    ticks: u64,
    edges: u64,
    samples: u64,
    /// Changes of the level.
    changes: u64,
}

impl Survey {
    fn take(&mut self, piece: &Piece<'_>) {
        let (session, first_us) = match piece {
            Piece::Control(segment) => {
                self.ticks += segment.samples.len() as u64;
                (segment.session, segment.first_us)
            }
            Piece::Bits(segment) => {
                self.samples += segment.levels.len() as u64;
                self.changes += changes(&segment.levels).count() as u64;
                (segment.session, segment.first_us)
            }
            Piece::Edges(session, edges) => {
                self.edges += edges.len() as u64;
                (*session, edges.first().map_or(u64::MAX, |edge| edge.time_us))
            }
            Piece::Status(_) => return,
        };
        let first = self.first_us.entry(session).or_insert(first_us);
        *first = first_us.min(*first);
    }

    fn is_smoothed(&self) -> bool {
        match self.edges {
            0 => self.samples <= MAX_SMOOTHED_SAMPLES && self.changes <= MAX_SMOOTHED_EDGES as u64,
            edges => edges <= MAX_SMOOTHED_EDGES as u64,
        }
    }
}

/// Position, error, speed and duty of a whole recording against the host's time; and what was lost of it, one sentence each.
///
/// # Errors
/// [`PlotError::Empty`], and as [`Decoder::open`] and [`Decoder::next_item`].
pub fn recording_figure(path: &Path, title: &str) -> Result<(Figure, Vec<String>), PlotError> {
    let mut survey = Survey::default();
    let recording = Recording::read_in_pieces(Decoder::open(path)?, |piece, _| survey.take(&piece))?;
    if survey.ticks + survey.edges + survey.samples == 0 {
        return Err(PlotError::Empty);
    }
    let mut drawn = Drawn::new(&recording, survey);
    Recording::read_in_pieces(Decoder::open(path)?, |piece, goes_on| drawn.take(&piece, goes_on))?;
    Ok((drawn.figure(title), recording.losses()))
}

/// The lines, while they are drawn.
struct Drawn<'a> {
    recording: &'a Recording,
    survey: Survey,
    span_s: f64,
    edges_per_rev: u32,
    target: Trace,
    position: Trace,
    error: Trace,
    duty: Trace,
    walk: Walk,
    last_level: bool,
    /// What the smoother gets, of few edges.
    edges: Vec<EdgesSegment>,
    bits: Vec<BitsSegment>,
}

impl<'a> Drawn<'a> {
    fn new(recording: &'a Recording, survey: Survey) -> Self {
        let ends = (0..).zip(&recording.sessions).map(|(index, session)| time_s(recording, index, session.end_us));
        let span_s = ends.fold(0.0, f64::max);
        let edges_per_rev = recording
            .runs
            .iter()
            .find_map(|run| run.configuration)
            .map_or(measurement::DEFAULT_EDGES_PER_REV, |configuration| u32::from(configuration.edges_per_rev));
        let [target, position, error, duty] = [(); 4].map(|()| Trace::new(span_s));
        let walk = Walk::new(edges_per_rev, span_s);
        let (edges, bits) = (Vec::new(), Vec::new());
        Self {
            recording,
            survey,
            span_s,
            edges_per_rev,
            target,
            position,
            error,
            duty,
            walk,
            last_level: false,
            edges,
            bits,
        }
    }

    fn time_s(&self, session: u32, time_us: u64) -> f64 {
        time_s(self.recording, session, time_us)
    }

    fn take(&mut self, piece: &Piece<'_>, goes_on: bool) {
        match piece {
            Piece::Control(segment) => self.control(segment, goes_on),
            Piece::Edges(session, edges) => {
                for (index, edge) in edges.iter().enumerate() {
                    let at_s = self.time_s(*session, edge.time_us);
                    if index == 0 && !goes_on {
                        self.walk.begin(at_s);
                        self.edges.push(EdgesSegment { session: *session, first_edge: 0, edges: Vec::new() });
                    }
                    self.walk.step(at_s, edge.direction.sign().into());
                }
                if let Some(segment) = self.edges.last_mut().filter(|_| self.survey.is_smoothed()) {
                    segment.edges.extend_from_slice(edges);
                }
            }
            Piece::Bits(segment) if self.survey.edges == 0 => self.levels(segment, goes_on),
            Piece::Status(status) if self.survey.ticks == 0 => {
                let (session, time_us, Status { duty, direction, .. }) = status;
                let fraction = f64::from(duty.raw()) / f64::from(Duty::FULL.raw());
                self.duty.push(self.time_s(*session, *time_us), fraction * f64::from(direction.sign()));
            }
            Piece::Bits(_) | Piece::Status(_) => {}
        }
    }

    fn control(&mut self, segment: &ControlSegment, goes_on: bool) {
        if !goes_on {
            [&mut self.target, &mut self.position, &mut self.error, &mut self.duty].into_iter().for_each(Trace::gap);
        }
        let degrees = 360.0 / f64::from(self.edges_per_rev);
        let (start_s, period_s) = (self.time_s(segment.session, segment.first_us), f64::from(segment.period_us) * 1e-6);
        for (index, sample) in segment.samples.iter().enumerate() {
            let at_s = start_s + period_s * index as f64;
            let (target, position) = (f64::from(sample.target), f64::from(sample.position));
            self.target.push(at_s, target * degrees);
            self.position.push(at_s, position * degrees);
            self.error.push(at_s, (target - position) * degrees);
            let fraction = f64::from(sample.on_steps) / f64::from(segment.duty_steps.max(1));
            let at_s = self.time_s(segment.session, segment.time_us(index));
            self.duty.push(at_s, fraction * f64::from(sample.direction.sign()));
        }
    }

    /// Changes of the level, each between its two samples.
    fn levels(&mut self, segment: &BitsSegment, goes_on: bool) {
        let start_s = self.time_s(segment.session, segment.first_us);
        if !goes_on {
            self.walk.begin(start_s);
            self.last_level = segment.levels.first().is_some_and(|level| *level);
            self.bits.push(BitsSegment { levels: Vec::new(), ..*segment });
        }
        for (index, &level) in segment.levels.iter().enumerate() {
            if level != self.last_level {
                self.walk.step(start_s + (index as f64 - 0.5) * 1e-3, 1);
            }
            self.last_level = level;
        }
        if let Some(kept) = self.bits.last_mut().filter(|_| self.survey.is_smoothed()) {
            kept.levels.extend_from_slice(&segment.levels);
        }
    }

    fn figure(self, title: &str) -> Figure {
        let recording = self.recording;
        let first = self.survey.first_us.iter().map(|(session, first_us)| time_s(recording, *session, *first_us));
        let begin_s = first.fold(f64::INFINITY, f64::min).min(self.span_s);
        let is_controlled = self.survey.ticks > 0;
        let mut panels = Vec::new();
        if is_controlled {
            let position = Panel::new("time (s)", "position (°)");
            panels.push(position.line("target", &self.target.done()).line("position", &self.position.done()));
            panels.push(Panel::new("time (s)", "error (°)").line("target − position", &self.error.done()));
        }
        if self.survey.edges + self.survey.samples > 0 {
            let is_smoothed = self.survey.is_smoothed();
            let (position, mut speed) = self.walk.panels();
            if is_smoothed {
                let time_s = |session, time_us| time_s(recording, session, time_us);
                let records = records(&self.edges, &self.bits, &time_s);
                speed = smoothed_speed_panel(&records, self.edges_per_rev, self.span_s);
            }
            panels.extend((!is_controlled).then_some(position));
            panels.push(speed);
        }
        let faults: Vec<f64> = recording
            .events
            .iter()
            .filter(|event| matches!(event.kind, EventKind::Fault(_)))
            .map(|event| event.host_time_ns as f64 * 1e-9)
            .collect();
        let label = if is_controlled { "duty" } else { "duty (status)" };
        let mut duty = Panel::new("time (s)", "drive on, signed (1)").line(label, &self.duty.done());
        if !faults.is_empty() {
            duty = duty.marks("fault", &faults);
        }
        panels.push(duty);
        let span_s = self.span_s;
        panels.into_iter().fold(Figure::new(title), |figure, panel| figure.panel(panel.x_range(begin_s, span_s)))
    }
}

fn time_s(recording: &Recording, session: u32, time_us: u64) -> f64 {
    recording.host_time_ns(session, time_us) as f64 * 1e-9
}
