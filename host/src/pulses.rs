//! Whether a driver board, and the motor behind it, follow short pulses: what a gated drive needs to know.
//!
//! Half duty is half drive at any PWM frequency, in pulses of half a period. A board that follows pulses of 10 ms but not those of 1 ms
//! turns the rotor at the one frequency and not at the other; nothing else of the two runs differs. A board made for a PWM of 50 Hz
//! may follow short pulses only as seldom as that: so they are also asked for one by one, every 20 ms.

use crate::diagnose::plan::PlannedRun;
use crate::record::measurement::{Measurement, RunData, RunKind};
use serde::Serialize;
use thiserror::Error;
use twum_shared::step::ConfigSpec;

/// Duty and PWM frequency (Hz) of the runs, the longest pulse first, for one that is not followed may be the last: pulses of 10 ms, which every
/// driver of this motor has followed, then of 2, 1 and 0.5 ms at half duty, and of 4, 2 and 1 ms every 20 ms.
const RUNS: [(f64, f64); 7] =
    [(HALF, 50.0), (0.2, 50.0), (0.1, 50.0), (HALF, 250.0), (0.05, 50.0), (HALF, 500.0), (HALF, 1_000.0)];
const HALF: f64 = 0.5;
/// PWM frequencies that a board makes, Hz.
const BOARD_HZ: std::ops::RangeInclusive<f64> = 10.0..=2_000.0;
/// Length of each run, s: half a turn and more.
const SECONDS: f64 = 3.0;
/// Speed in proportion to that of the longest pulses from which on a pulse is followed. The firmware's judge of the encoder lets half of a
/// pulse go into the start, and stops a motor that loses more.
const FOLLOWED: f64 = 0.5;

/// The runs that decide it: every pulse, both ways.
pub fn plan() -> Vec<PlannedRun> {
    let run = |(duty, pwm_hz), direction| PlannedRun {
        duty,
        direction,
        pwm_hz,
        seconds: SECONDS,
        pause_s: 0.5,
        why: format!("are pulses of {} ms followed, one every {} ms?", 1e3 * duty / pwm_hz, 1e3 / pwm_hz),
    };
    RUNS.into_iter().flat_map(|of| [run(of, "cw"), run(of, "ccw")]).collect()
}

/// What pulses of a length did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pulse {
    /// Length of the pulse, ms.
    pub pulse_ms: f64,
    /// From one pulse to the next, ms.
    pub every_ms: f64,
    /// Mean speed of all runs with it, either way, edges/s.
    pub edges_s: f64,
    /// Of a time with the drive on, in proportion to the longest pulses'.
    pub share: f64,
    /// Whether it is followed.
    pub followed: bool,
}

/// What a folder says of pulses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pulses {
    /// At half duty, the longest first.
    pub pulses: Vec<Pulse>,
    /// `shortest_pulse_ticks` of a gated drive: the shortest pulse that is followed, as those longer than it are.
    pub shortest_pulse_ticks: u8,
    /// At lower duties and the longest pulses' frequency, likewise; empty where there are no such runs.
    pub one_by_one: Vec<Pulse>,
    /// `shortest_pulse_ticks` of a planned drive.
    pub shortest_planned_ticks: Option<u8>,
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
    let found = runs(measurement);
    let half: Vec<&Runs> = found.iter().filter(|runs| runs.duty == HALF).collect();
    let [longest, _, ..] = half[..] else { return Err(PulsesError::NoRuns) };
    if longest.edges < 10.0 {
        return Err(PulsesError::Stands(longest.pulse_ms()));
    }
    let against = |runs: &Runs| {
        let share = (runs.edges_s() / runs.duty) / (longest.edges_s() / longest.duty);
        let (pulse_ms, every_ms) = (runs.pulse_ms(), 1e3 / runs.pwm_hz);
        Pulse { pulse_ms, every_ms, edges_s: runs.edges_s(), share, followed: share >= FOLLOWED }
    };
    let pulses: Vec<Pulse> = half.iter().map(|runs| against(runs)).collect();
    let seldom = found.iter().filter(|runs| runs.duty < HALF && runs.pwm_hz == longest.pwm_hz);
    let one_by_one: Vec<Pulse> = seldom.map(against).collect();
    // The longest is followed: all are measured by it.
    let shortest_pulse_ticks = shortest(&pulses, longest);
    let shortest_planned_ticks = (!one_by_one.is_empty()).then(|| shortest(&one_by_one, longest));
    Ok(Pulses { pulses, shortest_pulse_ticks, one_by_one, shortest_planned_ticks })
}

/// All runs of one kind of pulse.
struct Runs {
    duty: f64,
    pwm_hz: f64,
    edges: f64,
    driven_s: f64,
}

impl Runs {
    fn pulse_ms(&self) -> f64 {
        1e3 * self.duty / self.pwm_hz
    }

    fn edges_s(&self) -> f64 {
        self.edges / self.driven_s
    }
}

/// The runs by what their pulses are, the longest first.
fn runs(measurement: &Measurement) -> Vec<Runs> {
    let mut found: Vec<Runs> = Vec::new();
    for run in measurement.runs.iter().filter(|run| run.kind == RunKind::Speed) {
        let (RunData::Edges { edges, .. }, Some(duty)) = (&run.data, run.duty) else { continue };
        // What a board makes of a duty is a 32 768th of one.
        let duty = (duty * 1e3).round() / 1e3;
        let driven_s = run.drive_on_s.unwrap_or((run.span_us().1 - run.span_us().0) * 1e-6);
        if !(driven_s > 0.0 && duty > 0.0 && duty <= HALF && BOARD_HZ.contains(&run.pwm_hz)) {
            continue;
        }
        let edges = edges.iter().filter(|edge| (0.0..=driven_s * 1e6).contains(&edge.time_us)).count() as f64;
        match found.iter_mut().find(|runs| (runs.duty, runs.pwm_hz) == (duty, run.pwm_hz)) {
            Some(runs) => (runs.edges, runs.driven_s) = (runs.edges + edges, runs.driven_s + driven_s),
            None => found.push(Runs { duty, pwm_hz: run.pwm_hz, edges, driven_s }),
        }
    }
    found.sort_by(|a, b| b.pulse_ms().total_cmp(&a.pulse_ms()));
    found
}

/// The shortest that is followed, as those longer than it are, in control periods.
fn shortest(pulses: &[Pulse], longest: &Runs) -> u8 {
    let followed = pulses.iter().take_while(|pulse| pulse.followed);
    let ms = followed.fold(longest.pulse_ms(), |_, pulse| pulse.pulse_ms);
    (ms * 1e3 / f64::from(ConfigSpec::GATED.period_us)).ceil() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::measurement::{LevelEdge, Run};

    /// Runs of 3 s at half duty, with so many edges.
    fn folder(runs: &[(f64, usize)]) -> Measurement {
        of_duties(&runs.iter().map(|(pwm_hz, count)| (HALF, *pwm_hz, *count)).collect::<Vec<_>>())
    }

    fn of_duties(runs: &[(f64, f64, usize)]) -> Measurement {
        let runs = runs.iter().enumerate().map(|(index, (duty, pwm_hz, count))| {
            let edges = (0..*count).map(|k| LevelEdge { time_us: 3e6 * k as f64 / *count as f64, level: k % 2 == 0 });
            let data = RunData::Edges { initial: false, start_us: 0.0, edges: edges.collect(), end_us: 3.2e6 };
            let mut run = Run::new(format!("{index}"), RunKind::Speed, data);
            (run.duty, run.pwm_hz, run.drive_on_s) = (Some(*duty), *pwm_hz, Some(3.0));
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

    /// Fails when seldom pulses are measured by the speed and not by the time with the drive on, or mixed with those at half duty.
    #[test]
    fn pulses_that_are_followed_one_by_one_are_told_apart() {
        let found = judge(&of_duties(&[
            (0.5, 50.0, 350),
            (0.5, 500.0, 10),
            (0.2, 50.0, 140),
            (0.1, 50.0, 40),
            (0.05, 50.0, 3),
        ]));
        let found = found.unwrap();
        assert_eq!((found.shortest_pulse_ticks, found.shortest_planned_ticks), (20, Some(4)));
        let neither = judge(&folder(&[(50.0, 350), (250.0, 320)])).unwrap();
        assert_eq!((neither.shortest_pulse_ticks, neither.shortest_planned_ticks), (4, None));
    }

    #[test]
    fn what_says_nothing_says_why() {
        assert_eq!(judge(&folder(&[(50.0, 350), (50.0, 340)])), Err(PulsesError::NoRuns));
        assert_eq!(judge(&folder(&[(50.0, 3), (500.0, 2)])), Err(PulsesError::Stands(10.0)));
        // A folder may say anything: no board makes such a pulse.
        assert_eq!(judge(&folder(&[(50.0, 350), (1e-300, 350), (f64::INFINITY, 9)])), Err(PulsesError::NoRuns));
    }
}
