//! Position and speed from the encoder.

use super::trace::Trace;
use crate::record::measurement::{self, LevelEdge, RunData};
use crate::record::recording::{BitsSegment, EdgesSegment};
use crate::report::figure::Panel;
use crate::signal::edges::{Directions, EdgeTrain};
use crate::signal::smoother::smooth;
use twum_fit::quantile::NORMAL_95;

/// Records of more edges show the speed between neighbouring edges instead of the smoother's estimate.
pub(super) const MAX_SMOOTHED_EDGES: usize = 20_000;
/// Instants at which the smoother is asked.
const SMOOTHED_POINTS: usize = 2_000;
/// Uncertainty of a timestamped edge: the resolution of its clock, µs.
pub(super) const EDGE_UNCERTAINTY_US: f64 = 1.0;

/// A record of the encoder without a gap.
pub(super) struct EncoderRecord {
    /// Levels or edges.
    pub data: RunData,
    pub directions: Directions,
    /// Time of its clock's zero in the picture.
    pub offset_s: f64,
    pub uncertainty_us: f64,
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
pub(super) fn records(
    edges: &[EdgesSegment],
    bits: &[BitsSegment],
    time_s: &dyn Fn(u32, u64) -> f64,
) -> Vec<EncoderRecord> {
    if edges.iter().any(|segment| !segment.edges.is_empty()) {
        let records = edges.iter().filter_map(|segment| {
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
    let records = bits.iter().filter(|segment| segment.levels.len() > 1).map(|segment| EncoderRecord {
        data: RunData::Levels { start_us: 0.0, period_us: 1000.0, levels: segment.levels.clone() },
        directions: Directions::constant(measurement::Direction::Cw),
        offset_s: time_s(segment.session, segment.first_us),
        uncertainty_us: EDGE_UNCERTAINTY_US,
    });
    records.collect()
}

/// Position and speed of any number of edges, one after the other.
pub(super) struct Walk {
    edges_per_rev: f64,
    position: Trace,
    speed: Trace,
    count: i64,
    /// Time and count of the edges before, the last one last.
    before: [Option<(f64, i64)>; 2],
}

impl Walk {
    pub fn new(edges_per_rev: u32, span_s: f64) -> Self {
        let (position, speed) = (Trace::new(span_s), Trace::new(span_s));
        Self { edges_per_rev: f64::from(edges_per_rev), position, speed, count: 0, before: [None; 2] }
    }

    /// A record without a gap begins.
    pub fn begin(&mut self, time_s: f64) {
        self.position.gap();
        self.speed.gap();
        (self.count, self.before) = (0, [None; 2]);
        self.position.push(time_s, 0.0);
    }

    /// An edge; the speed is over each two pitches, which odd and even edges of unequal length do not disturb.
    pub fn edge(&mut self, time_s: f64, count: i64) {
        self.count = count;
        self.position.push(time_s, count as f64 * 360.0 / self.edges_per_rev);
        let [first, middle] = self.before;
        if let (Some(first), Some(middle)) = (first, middle)
            && time_s > first.0
        {
            let turns = (count - first.1) as f64 / self.edges_per_rev;
            self.speed.push(middle.0, 60.0 * turns / (time_s - first.0));
        }
        self.before = [middle, Some((time_s, count))];
    }

    /// An edge by the direction of its step.
    pub fn step(&mut self, time_s: f64, sign: i64) {
        self.edge(time_s, self.count + sign);
    }

    fn records(mut self, records: &[EncoderRecord], edges_per_rev: u32) -> Self {
        for record in records {
            let Some(train) = record.train(edges_per_rev) else { continue };
            self.begin(record.offset_s + train.start_us * 1e-6);
            for edge in &train.edges {
                self.edge(record.offset_s + edge.middle_us() * 1e-6, edge.count_after());
            }
        }
        self
    }

    /// Position and speed.
    pub fn panels(self) -> (Panel, Panel) {
        let position = Panel::new("time (s)", "position (°)").line("edges counted", &self.position.done());
        let speed = Panel::new("time (s)", "speed (rpm)").line("speed over two pitches", &self.speed.done());
        (position, speed)
    }
}

/// Position and speed of records in memory.
pub(super) fn panels(records: &[EncoderRecord], edges_per_rev: u32, span_s: f64) -> (Panel, Panel) {
    let (position, speed) = Walk::new(edges_per_rev, span_s).records(records, edges_per_rev).panels();
    let edges = |record: &EncoderRecord| record.train(edges_per_rev).map_or(0, |train| train.edges.len());
    match records.iter().map(edges).sum::<usize>() {
        few if few <= MAX_SMOOTHED_EDGES => (position, smoothed_speed_panel(records, edges_per_rev, span_s)),
        _ => (position, speed),
    }
}

/// The smoother's estimate of the speed, of few edges.
pub(super) fn smoothed_speed_panel(records: &[EncoderRecord], edges_per_rev: u32, span_s: f64) -> Panel {
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
            let (rpm, spread) = (smoothed.speed_rpm[index], NORMAL_95 * smoothed.speed_sd_rpm[index]);
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
