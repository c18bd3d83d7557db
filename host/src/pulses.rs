//! Whether a driver board, and the motor behind it, follow short pulses: what a gated drive needs to know.
//!
//! Half duty is half drive at any PWM frequency, in pulses of half a period. A board that follows pulses of 10 ms but not those of 1 ms
//! turns the rotor at the one frequency and not at the other; nothing else of the two runs differs.

use crate::diagnose::plan::PlannedRun;
use crate::record::measurement::{Measurement, RunData, RunKind};
use serde::Serialize;
use thiserror::Error;
use twum_shared::step::ConfigSpec;

/// PWM frequencies of the runs, Hz: pulses of 10 ms, which every driver of this motor has followed, then of 2, 1 and 0.5 ms.
const PWM_HZ: [f64; 4] = [50.0, 250.0, 500.0, 1_000.0];
/// PWM frequencies that a board makes, Hz.
const BOARD_HZ: std::ops::RangeInclusive<f64> = 10.0..=2_000.0;
/// Length of each run, s: half a turn and more.
const SECONDS: f64 = 3.0;
/// Speed in proportion to that of the longest pulses from which on a pulse is followed. The firmware's judge of the encoder lets half of a
/// pulse go into the start, and stops a motor that loses more.
const FOLLOWED: f64 = 0.5;

/// The runs that decide it: every pulse, both ways.
pub fn plan() -> Vec<PlannedRun> {
    let run = |pwm_hz: f64, direction| PlannedRun {
        duty: 0.5,
        direction,
        pwm_hz,
        seconds: SECONDS,
        pause_s: 0.5,
        why: format!("are pulses of {} ms followed?", 500.0 / pwm_hz),
    };
    PWM_HZ.into_iter().flat_map(|pwm_hz| [run(pwm_hz, "cw"), run(pwm_hz, "ccw")]).collect()
}

/// What pulses of a length did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pulse {
    /// Length of the pulse, and of the rest after it, ms.
    pub pulse_ms: f64,
    /// Mean speed of all runs with it, either way, edges/s.
    pub edges_s: f64,
    /// In proportion to the longest pulses'.
    pub share: f64,
    /// Whether it is followed.
    pub followed: bool,
}

/// What a folder says of pulses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pulses {
    /// The longest first.
    pub pulses: Vec<Pulse>,
    /// `shortest_pulse_ticks` of a gated drive: the shortest pulse that is followed, as those longer than it are.
    pub shortest_pulse_ticks: u8,
}

/// Why a folder says nothing.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PulsesError {
    /// No runs to compare.
    #[error(
        "there are no two runs at half duty with different PWM frequencies: `twum experiment run --pulses --out FOLDER` makes them"
    )]
    NoRuns,
    /// A rotor that stands.
    #[error("the rotor did not turn with the longest pulses, of {0} ms: nothing can be said of shorter ones")]
    Stands(f64),
}

/// Reads it off the runs at half duty.
///
/// # Errors
/// A folder without such runs, or of a rotor that stood.
pub fn judge(measurement: &Measurement) -> Result<Pulses, PulsesError> {
    let mut found: Vec<(f64, f64, f64)> = Vec::new();
    for run in measurement.runs.iter().filter(|run| run.kind == RunKind::Speed && run.duty == Some(0.5)) {
        let RunData::Edges { edges, .. } = &run.data else { continue };
        let driven_s = run.drive_on_s.unwrap_or((run.span_us().1 - run.span_us().0) * 1e-6);
        if !(driven_s > 0.0 && BOARD_HZ.contains(&run.pwm_hz)) {
            continue;
        }
        let edges = edges.iter().filter(|edge| (0.0..=driven_s * 1e6).contains(&edge.time_us)).count() as f64;
        match found.iter_mut().find(|(pwm_hz, ..)| *pwm_hz == run.pwm_hz) {
            Some((_, all, seconds)) => (*all, *seconds) = (*all + edges, *seconds + driven_s),
            None => found.push((run.pwm_hz, edges, driven_s)),
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [(slowest_hz, edges, seconds), _, ..] = found[..] else { return Err(PulsesError::NoRuns) };
    let longest = edges / seconds;
    if edges < 10.0 {
        return Err(PulsesError::Stands(500.0 / slowest_hz));
    }
    let pulses: Vec<Pulse> = found
        .iter()
        .map(|(pwm_hz, edges, seconds)| {
            let (edges_s, pulse_ms) = (edges / seconds, 500.0 / pwm_hz);
            Pulse { pulse_ms, edges_s, share: edges_s / longest, followed: edges_s >= FOLLOWED * longest }
        })
        .collect();
    // The longest is followed: all are measured by it.
    let followed = pulses.iter().take_while(|pulse| pulse.followed);
    let shortest_ms = followed.fold(500.0 / slowest_hz, |_, pulse| pulse.pulse_ms);
    let ticks = (shortest_ms * 1e3 / f64::from(ConfigSpec::GATED.period_us)).ceil();
    Ok(Pulses { pulses, shortest_pulse_ticks: ticks as u8 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::measurement::{LevelEdge, Run};

    /// Runs of 3 s at half duty, with so many edges.
    fn folder(runs: &[(f64, usize)]) -> Measurement {
        let runs = runs.iter().enumerate().map(|(index, (pwm_hz, count))| {
            let edges = (0..*count).map(|k| LevelEdge { time_us: 3e6 * k as f64 / *count as f64, level: k % 2 == 0 });
            let data = RunData::Edges { initial: false, start_us: 0.0, edges: edges.collect(), end_us: 3.2e6 };
            let mut run = Run::new(format!("{index}"), RunKind::Speed, data);
            (run.duty, run.pwm_hz, run.drive_on_s) = (Some(0.5), *pwm_hz, Some(3.0));
            run
        });
        let (name, motor) = (String::new(), "pcbmotor-30mm".to_owned());
        Measurement { name, motor, edges_per_rev: 400, runs: runs.collect(), folder: Default::default() }
    }

    /// Fails when a pulse below one that is not followed is taken, or when the directions are not taken together.
    #[test]
    fn the_shortest_pulse_is_the_last_that_is_followed() {
        let runs = [(50.0, 350), (50.0, 340), (250.0, 320), (500.0, 200), (500.0, 190), (1_000.0, 20)];
        let found = judge(&folder(&runs)).unwrap();
        assert_eq!(found.shortest_pulse_ticks, 2);
        assert_eq!(found.pulses.iter().map(|p| p.followed).collect::<Vec<_>>(), [true, true, true, false]);
        let gap = [(50.0, 350), (250.0, 10), (500.0, 340)];
        assert_eq!(judge(&folder(&gap)).unwrap().shortest_pulse_ticks, 20);
    }

    #[test]
    fn what_says_nothing_says_why() {
        assert_eq!(judge(&folder(&[(50.0, 350), (50.0, 340)])), Err(PulsesError::NoRuns));
        assert_eq!(judge(&folder(&[(50.0, 3), (500.0, 2)])), Err(PulsesError::Stands(10.0)));
        // A folder may say anything: no board makes such a pulse.
        assert_eq!(judge(&folder(&[(50.0, 350), (1e-300, 350), (f64::INFINITY, 9)])), Err(PulsesError::NoRuns));
    }
}
