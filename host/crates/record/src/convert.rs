//! Between a sampled encoder line and its edges.

use super::measurement::{LevelEdge, MAX_LOADED_BYTES, RunData};
use thiserror::Error;

/// A record that would have more samples than fit.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "{samples:.0} samples are asked for, {most} are the most for its edges: take a longer period, or is a time wrong?"
)]
pub struct TooManySamples {
    /// Samples asked for.
    pub samples: f64,
    /// The bound.
    pub most: usize,
}

/// Most instants that a record of so many edges is sampled or estimated at: what is made of it is bounded by its size, not by
/// the times in it. At 1 kHz 5 000 instants an edge are a turn in half an hour; the first million are a quarter of an hour in
/// which nothing moves.
pub fn most_instants(edges: usize) -> usize {
    (1_000_000 + edges.saturating_mul(5_000)).min(MAX_LOADED_BYTES)
}

/// Samples whose level is not that of the one before.
pub fn changes(levels: &[bool]) -> impl DoubleEndedIterator<Item = usize> {
    (1..levels.len()).filter(|k| levels[*k] != levels[k - 1])
}

/// The edges of a sampled encoder line. An edge first seen at sample `k` happened after sample `k - 1`; its time is set to
/// the middle of that interval (thesis, A.7), so it is uncertain by half a sampling period either way.
///
/// Data that are not levels come back as they are.
pub fn to_edges(data: RunData) -> RunData {
    let RunData::Levels { start_us, period_us, levels } = data else { return data };
    let edges = changes(&levels)
        .map(|k| LevelEdge { time_us: start_us + (k as f64 - 0.5) * period_us, level: levels[k] })
        .collect();
    RunData::Edges {
        initial: levels.first().copied().unwrap_or(false),
        start_us,
        edges,
        end_us: start_us + levels.len().saturating_sub(1) as f64 * period_us,
    }
}

/// The encoder line sampled every `period_us` (more than 0) from the start of the record, as a capture at that rate would have
/// seen it.
///
/// Data that are not edges come back as they are.
///
/// # Errors
/// More samples than [`most_instants`].
pub fn to_levels(data: RunData, period_us: f64) -> Result<RunData, TooManySamples> {
    let RunData::Edges { initial, start_us, edges, end_us } = data else { return Ok(data) };
    let samples = ((end_us - start_us) / period_us).floor() + 1.0;
    let most = most_instants(edges.len());
    if samples.is_nan() || samples > most as f64 {
        return Err(TooManySamples { samples, most });
    }
    let count = samples as usize;
    let mut level = initial;
    let mut next = edges.iter().peekable();
    let levels = (0..count)
        .map(|k| {
            let now_us = start_us + k as f64 * period_us;
            while let Some(edge) = next.next_if(|edge| edge.time_us <= now_us) {
                level = edge.level;
            }
            level
        })
        .collect();
    Ok(RunData::Levels { start_us, period_us, levels })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_lies_in_the_middle_of_the_interval_it_was_seen_in() {
        let levels = RunData::Levels { start_us: 100.0, period_us: 1000.0, levels: vec![true, true, false, true] };
        let edges = to_edges(levels.clone());
        let expected = RunData::Edges {
            initial: true,
            start_us: 100.0,
            edges: vec![LevelEdge { time_us: 1600.0, level: false }, LevelEdge { time_us: 2600.0, level: true }],
            end_us: 3100.0,
        };
        assert_eq!(edges, expected);
        assert_eq!(to_levels(edges, 1000.0), Ok(levels));
    }

    #[test]
    fn an_edge_at_a_sample_is_seen_by_it_and_two_between_samples_are_not() {
        let edge = |time_us, level| LevelEdge { time_us, level };
        let edges = RunData::Edges {
            initial: false,
            start_us: 0.0,
            edges: vec![edge(10.0, true), edge(12.0, false), edge(13.0, true)],
            end_us: 25.0,
        };
        let Ok(RunData::Levels { levels, .. }) = to_levels(edges, 10.0) else { panic!() };
        assert_eq!(levels, [false, true, true]);
    }

    #[test]
    fn a_day_at_a_microsecond_is_refused_before_it_is_made() {
        let day = || RunData::Edges { initial: false, start_us: 0.0, edges: Vec::new(), end_us: 86_400e6 };
        assert!(matches!(to_levels(day(), 1.0), Err(TooManySamples { samples, .. }) if samples == 86_400e6 + 1.0));
        assert!(to_levels(day(), f64::NAN).is_err() && to_levels(day(), 0.0).is_err());
        assert_eq!(to_levels(day(), 1e6).unwrap().len(), 86_401);
    }
}
