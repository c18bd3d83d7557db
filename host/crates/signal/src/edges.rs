//! Edges of the encoder line as crossings of known angles.
//!
//! The line changes level at equally spaced angles, the boundaries. A forward edge crosses the boundary above the rotor,
//! a backward edge the one below, so that after a reversal the boundary crossed last is crossed again. The line does
//! not show the direction; it is read off the direction pin, and a rotor that coasts on after the pin has changed is
//! counted the wrong way (`reversal-miscount` among the effects).

use super::{SignalError, check_positive};
use twum_record::convert::changes;
use twum_record::measurement::{Direction, LevelEdge};

/// Direction of rotation over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Directions {
    initial: Direction,
    changes: Vec<(f64, Direction)>,
}

impl Directions {
    /// One direction throughout.
    pub fn constant(direction: Direction) -> Self {
        Self { initial: direction, changes: Vec::new() }
    }

    /// `initial` at first, then each direction from its time (µs, in any order) on.
    pub fn changing(initial: Direction, changes: &[(f64, Direction)]) -> Self {
        let mut changes = changes.to_vec();
        changes.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { initial, changes }
    }

    /// The direction at a time in µs.
    pub fn at(&self, time_us: f64) -> Direction {
        match self.changes.partition_point(|(from, _)| *from <= time_us) {
            0 => self.initial,
            n => self.changes[n - 1].1,
        }
    }
}

/// One crossing of a boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// The crossing happened at this time or later, in µs.
    pub after_us: f64,
    /// The crossing happened at this time or earlier, in µs.
    pub before_us: f64,
    /// Which boundary, in pitches from the one below the rotor at the start.
    pub boundary: i64,
    /// 1 forwards (clockwise), -1 backwards.
    pub step: i8,
}

impl Edge {
    /// The middle of the interval, in µs.
    pub fn middle_us(&self) -> f64 {
        0.5 * (self.after_us + self.before_us)
    }

    /// Pitches passed since the start, after this edge.
    pub fn count_after(&self) -> i64 {
        if self.step > 0 { self.boundary } else { self.boundary - 1 }
    }
}

/// The edges of one record.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeTrain {
    /// First instant observed, in µs.
    pub start_us: f64,
    /// Last instant observed, in µs.
    pub end_us: f64,
    /// Angle between boundaries, in rad.
    pub pitch_rad: f64,
    /// The crossings in order of time.
    pub edges: Vec<Edge>,
    /// The rotor is known to have stood still until this time (the drive went on), in µs; `None` where nothing is known.
    pub rest_until_us: Option<f64>,
}

impl EdgeTrain {
    /// States that the rotor stood still until the drive went on at `time_us`. A record that shows an edge before that time,
    /// or begins after it, says otherwise, and is left as it was.
    #[must_use]
    pub fn at_rest_until(mut self, time_us: f64) -> Self {
        let turned = self.edges.first().is_some_and(|edge| edge.before_us <= time_us);
        if !turned && self.start_us <= time_us && time_us < self.end_us {
            self.rest_until_us = Some(time_us);
            if let Some(first) = self.edges.first_mut() {
                first.after_us = first.after_us.max(time_us);
            }
        }
        self
    }

    /// Edges of a line sampled every `period_us` from `start_us`: each lies between the last sample before it and the
    /// first after it. At most one edge a sample can be seen: above `60e6 / (period_us * edges_per_rev)` rpm (150 rpm at
    /// 1 kHz and 400 edges) edges are lost without a trace.
    ///
    /// # Errors
    /// A period or a number of edges that is not above zero.
    pub fn from_levels(
        start_us: f64,
        period_us: f64,
        levels: &[bool],
        edges_per_rev: u32,
        directions: &Directions,
    ) -> Result<Self, SignalError> {
        check_positive("the sampling period (µs)", period_us)?;
        let at = |i: usize| start_us + i as f64 * period_us;
        let intervals = changes(levels).map(|i| (at(i - 1), at(i)));
        Self::new(start_us, at(levels.len().saturating_sub(1)), edges_per_rev, intervals, directions)
    }

    /// Edges with a time of their own, each true within `± uncertainty_us` (resolution of the timer and spread of the
    /// interrupt's latency).
    ///
    /// # Errors
    /// An uncertainty or a number of edges that is not above zero; times that do not increase.
    pub fn from_times(
        start_us: f64,
        end_us: f64,
        edges: &[LevelEdge],
        uncertainty_us: f64,
        edges_per_rev: u32,
        directions: &Directions,
    ) -> Result<Self, SignalError> {
        check_positive("the uncertainty of an edge's time (µs)", uncertainty_us)?;
        let in_order = |w: &[LevelEdge]| w[0].time_us < w[1].time_us;
        if let Some(i) = edges.windows(2).position(|w| !in_order(w)) {
            return Err(SignalError::Time { index: i + 1, time_us: edges[i + 1].time_us });
        }
        let intervals = edges.iter().map(|e| (e.time_us - uncertainty_us, e.time_us + uncertainty_us));
        Self::new(start_us, end_us, edges_per_rev, intervals, directions)
    }

    /// Edges behind a count read now and then, `(time in µs, count)`: a count that has moved by `n` has crossed `n`
    /// boundaries since the reading before, taken as evenly spread.
    ///
    /// # Errors
    /// A number of edges that is not above zero, times that do not increase, or a count that moves by more than 1000 at
    /// once.
    pub fn from_counts(counts: &[(f64, f64)], edges_per_rev: u32) -> Result<Self, SignalError> {
        const FASTEST: i64 = 1000;
        check_positive("edges a revolution", f64::from(edges_per_rev))?;
        let mut edges = Vec::new();
        let start = counts.first().map_or(0.0, |c| c.1);
        for (i, pair) in counts.windows(2).enumerate() {
            let [(from_us, from), (to_us, to)] = [pair[0], pair[1]];
            if from_us.is_nan() || to_us.is_nan() || from_us >= to_us {
                return Err(SignalError::Time { index: i + 1, time_us: to_us });
            }
            let (before, after) = ((from - start).round() as i64, (to - start).round() as i64);
            let moved = after.abs_diff(before);
            if moved > FASTEST as u64 {
                return Err(SignalError::Jump { index: i + 1, from, to });
            }
            let step = if after > before { 1 } else { -1 };
            for j in 0..moved {
                let share = |k: u64| from_us + (to_us - from_us) * k as f64 / moved as f64;
                let count = before + step * j as i64;
                edges.push(Edge {
                    after_us: share(j),
                    before_us: share(j + 1),
                    boundary: count.max(count + step),
                    step: step as i8,
                });
            }
        }
        let end = |c: Option<&(f64, f64)>| c.map_or(0.0, |c| c.0);
        Ok(Self {
            start_us: end(counts.first()),
            end_us: end(counts.last()),
            pitch_rad: std::f64::consts::TAU / f64::from(edges_per_rev),
            edges,
            rest_until_us: None,
        })
    }

    fn new(
        start_us: f64,
        end_us: f64,
        edges_per_rev: u32,
        intervals: impl Iterator<Item = (f64, f64)>,
        directions: &Directions,
    ) -> Result<Self, SignalError> {
        check_positive("edges a revolution", f64::from(edges_per_rev))?;
        let mut count = 0;
        let edges = intervals
            .map(|(after_us, before_us)| {
                let step = match directions.at(0.5 * (after_us + before_us)) {
                    Direction::Cw => 1,
                    Direction::Ccw => -1,
                };
                let boundary = count.max(count + i64::from(step));
                count += i64::from(step);
                Edge { after_us, before_us, boundary, step }
            })
            .collect();
        let pitch_rad = std::f64::consts::TAU / f64::from(edges_per_rev);
        Ok(Self { start_us, end_us, pitch_rad, edges, rest_until_us: None })
    }

    /// Mean speed from the first edge to the last, in rpm, signed; `None` below two edges.
    pub fn mean_rpm(&self) -> Option<f64> {
        let (first, last) = (self.edges.first()?, self.edges.last()?);
        let time_s = (last.middle_us() - first.middle_us()) * 1e-6;
        let turned_rad = (last.boundary - first.boundary) as f64 * self.pitch_rad;
        (time_s > 0.0).then(|| turned_rad / time_s * super::RAD_S_TO_RPM)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_that_shows_an_edge_before_the_drive_did_not_start_from_rest() {
        let train =
            EdgeTrain::from_levels(0.0, 1000.0, &levels("0011"), 400, &Directions::constant(Direction::Cw)).unwrap();
        let rested = train.clone().at_rest_until(1500.0);
        assert_eq!(
            (rested.rest_until_us, rested.edges[0].after_us, rested.edges[0].before_us),
            (Some(1500.0), 1500.0, 2000.0)
        );
        for time_us in [2000.0, -1.0, 3000.0, f64::NAN] {
            assert_eq!(train.clone().at_rest_until(time_us), train);
        }
    }

    fn levels(text: &str) -> Vec<bool> {
        text.chars().map(|c| c == '1').collect()
    }

    #[test]
    fn an_edge_lies_between_the_samples_that_differ() {
        let train = EdgeTrain::from_levels(100.0, 1000.0, &levels("001110"), 400, &Directions::constant(Direction::Cw))
            .unwrap();
        assert_eq!(train.end_us, 5100.0);
        let intervals: Vec<_> = train.edges.iter().map(|e| (e.after_us, e.before_us, e.boundary)).collect();
        assert_eq!(intervals, [(1100.0, 2100.0, 1), (4100.0, 5100.0, 2)]);
        assert!((train.mean_rpm().unwrap() - 60.0 / 400.0 / 3e-3).abs() < 1e-9);
    }

    #[test]
    fn a_reversal_crosses_the_last_boundary_again() {
        let directions = Directions::changing(Direction::Cw, &[(4500.0, Direction::Ccw)]);
        let train = EdgeTrain::from_levels(0.0, 1000.0, &levels("0101010101"), 400, &directions).unwrap();
        let boundaries: Vec<i64> = train.edges.iter().map(|e| e.boundary).collect();
        assert_eq!(boundaries, [1, 2, 3, 4, 4, 3, 2, 1, 0]);
        assert_eq!(train.edges.last().unwrap().count_after(), -1);
    }

    #[test]
    fn a_count_that_moves_crosses_boundaries_between_its_readings() {
        let train = EdgeTrain::from_counts(&[(0.0, 5.0), (500.0, 7.0), (1000.0, 7.0), (1500.0, 6.0)], 400).unwrap();
        let got: Vec<_> = train.edges.iter().map(|e| (e.after_us, e.before_us, e.boundary, e.step)).collect();
        assert_eq!(got, [(0.0, 250.0, 1, 1), (250.0, 500.0, 2, 1), (1000.0, 1500.0, 2, -1)]);
        assert!(matches!(
            EdgeTrain::from_counts(&[(0.0, 0.0), (1.0, 1e12)], 400),
            Err(SignalError::Jump { index: 1, .. })
        ));
    }

    #[test]
    fn times_are_widened_by_their_uncertainty_and_must_increase() {
        let edge = |time_us| LevelEdge { time_us, level: true };
        let cw = Directions::constant(Direction::Cw);
        let train = EdgeTrain::from_times(0.0, 100.0, &[edge(10.0), edge(30.0)], 1.0, 400, &cw).unwrap();
        assert_eq!((train.edges[1].after_us, train.edges[1].before_us), (29.0, 31.0));
        assert!(matches!(
            EdgeTrain::from_times(0.0, 100.0, &[edge(10.0), edge(10.0)], 1.0, 400, &cw),
            Err(SignalError::Time { index: 1, .. })
        ));
        assert!(matches!(
            EdgeTrain::from_times(0.0, 100.0, &[], f64::NAN, 400, &cw),
            Err(SignalError::NotPositive { .. })
        ));
    }
}
