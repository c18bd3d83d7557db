//! A closed-loop run against the host-side copy of the controller: the first tick that differs, and what kind of difference
//! it is. [`super::closed_loop`] has the residuals of the rest of the loop.
//!
//! A recording of this project is checked bit for bit by [`super::replay`]; this is for what people bring: tables of
//! `time_us,target,position,u,duty,direction`, where `u` may have been rounded when it was printed.

use crate::record::control::recomputed;
use crate::record::measurement::{ControlError, ControlRow, ControlSpec, Run, RunData};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use thiserror::Error;
use twum_shared::step::{Config, ConfigSpec};

/// Differences of `u` up to this many duty steps are printing.
const TOLERANCE_STEPS: f64 = 2e-3;
/// Longest delay looked for, ticks.
const MAX_DELAY: i32 = 20;
/// An explanation has to make this share of the ticks agree.
const EXPLAINS: f64 = 0.99;
/// A gain within this share of the configured one is the configured one.
const SAME_GAIN: f64 = 2e-3;
/// Ticks that differ are lost samples if they are fewer than one in so many.
const ISOLATED_ONE_IN: usize = 1_000;

/// Why a run's controller cannot be recomputed.
#[derive(Debug, Error)]
pub enum ControllerError {
    /// Not a table of control ticks.
    #[error("run `{0}` holds no control ticks: only the `control` format shows what the controller did")]
    NoTicks(String),
    /// The run does not say which controller ran.
    #[error(
        "run `{0}` names no controller that a table can recompute: add `control = \"thesis\"`, `\"default\"` or a table of gains to a \
         folder's run; a gated drive's needs more than its ticks, and `twum replay` checks its recording"
    )]
    NoController(String),
    /// The controller itself is not valid.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// What the controller needs is not in the table.
    #[error(
        "the controller feeds the target's rate forward, which the table does not hold: check the recording with `twum replay`"
    )]
    FeedForward,
    /// Its times do not fit its ticks.
    #[error("run `{run}`: {reason}")]
    TooLong {
        /// The run.
        run: String,
        /// What is wrong.
        reason: crate::signal::SignalError,
    },
}

/// What the check of one run found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControllerCheck {
    /// Ticks recomputed.
    pub ticks: usize,
    /// Ticks whose control signal differs.
    pub mismatched: usize,
    /// The first of them.
    pub first: Option<FirstMismatch>,
    /// What makes the difference go away.
    pub kind: Option<Kind>,
    /// Recomputed against recorded control signal: RMS, duty steps.
    pub rms_steps: f64,
}

/// The first tick that differs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FirstMismatch {
    /// Row of the table, from 0.
    pub row: usize,
    /// Its time, µs.
    pub time_us: f64,
    /// The control signal the controller gives, duty steps.
    pub expected_u: f64,
    /// The control signal in the table, duty steps.
    pub recorded_u: f64,
}

/// What kind of difference it is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Kind {
    /// Other gains; those named differ from the configured ones.
    Gain {
        /// Proportional gain found, if it differs.
        kp: Option<f64>,
        /// Integral gain found, if it differs.
        ki: Option<f64>,
        /// Derivative gain found, if it differs.
        kd: Option<f64>,
    },
    /// The control signal is cut off at ± this many duty steps.
    ClampSignal {
        /// The limit.
        limit: f64,
    },
    /// The integral is kept between other limits (count·s).
    ClampIntegral {
        /// Lower limit.
        min: f64,
        /// Upper limit.
        max: f64,
    },
    /// The control signal comes so many ticks later than it should (negative: earlier).
    Delay {
        /// Ticks.
        ticks: i32,
    },
    /// A tick is missing from the table, or was changed, at this time; what follows agrees again.
    LostSample {
        /// Time of the row behind it, µs.
        time_us: f64,
        /// Whether the times in the table show the hole.
        shown_by_time: bool,
    },
    /// None of these.
    Unknown,
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Gain { kp, ki, kd } => {
                let named = [("kp", kp), ("ki", ki), ("kd", kd)];
                let found: Vec<String> = named
                    .iter()
                    .filter_map(|(name, value)| value.map(|value| format!("{name} = {value:.6}")))
                    .collect();
                write!(f, "other gains: {}", found.join(", "))
            }
            Self::ClampSignal { limit } => write!(f, "the control signal is cut off at \u{b1}{limit} duty steps"),
            Self::ClampIntegral { min, max } => write!(f, "the integral is kept between {min} and {max} count\u{b7}s"),
            Self::Delay { ticks } => write!(f, "the control signal comes {ticks} ticks late"),
            Self::LostSample { time_us, shown_by_time } => {
                let shown = if *shown_by_time { "the times show the hole" } else { "the times do not show it" };
                write!(f, "a sample lost or changed before {time_us:.0} us ({shown})")
            }
            Self::Unknown => f.write_str("neither gain, clamp, delay nor lost samples"),
        }
    }
}

/// Checks one closed-loop run.
///
/// # Errors
/// When the run does not hold what is needed.
pub fn check(run: &Run) -> Result<ControllerCheck, ControllerError> {
    let RunData::Control(rows) = &run.data else { return Err(ControllerError::NoTicks(run.id.clone())) };
    let control = run.control.ok_or_else(|| ControllerError::NoController(run.id.clone()))?;
    check_rows(rows, control)
}

/// As [`check`], for the ticks themselves. The controller starts at rest with the first row.
///
/// # Errors
/// A controller that is not valid, or needs more than the table holds.
pub fn check_rows(rows: &[ControlRow], control: ControlSpec) -> Result<ControllerCheck, ControllerError> {
    let spec = control.config()?;
    if spec.feed_forward != 0 {
        return Err(ControllerError::FeedForward);
    }
    let expected = recompute(rows, spec)?;
    let differs = |index: usize| (expected[index] - rows[index].u).abs() > TOLERANCE_STEPS;
    let mismatched = (0..rows.len()).filter(|index| differs(*index)).count();
    let first = (0..rows.len()).find(|index| differs(*index)).map(|row| FirstMismatch {
        row,
        time_us: rows[row].time_us,
        expected_u: expected[row],
        recorded_u: rows[row].u,
    });
    let kind = match first {
        Some(first) => Some(explain(rows, spec, &expected, first.row)?),
        None => None,
    };
    let rms_steps = root_mean(rows.iter().zip(&expected).map(|(row, u)| row.u - u), rows.len());
    Ok(ControllerCheck { ticks: rows.len(), mismatched, first, kind, rms_steps })
}

fn recompute(rows: &[ControlRow], spec: ConfigSpec) -> Result<Vec<f64>, ControlError> {
    Ok(recomputed(spec, rows.iter().map(|row| row.inputs(0)))?)
}

/// Share of the ticks on which two signals agree.
fn agreement(rows: &[ControlRow], u: impl Fn(usize) -> Option<f64>) -> f64 {
    let (mut agree, mut counted) = (0usize, 0usize);
    for (index, row) in rows.iter().enumerate() {
        if let Some(u) = u(index) {
            counted += 1;
            agree += usize::from((u - row.u).abs() <= TOLERANCE_STEPS);
        }
    }
    agree as f64 / counted.max(1) as f64
}

/// Tries the simplest explanations first.
fn explain(rows: &[ControlRow], spec: ConfigSpec, expected: &[f64], first: usize) -> Result<Kind, ControllerError> {
    if let Some(kind) = hole(rows, &spec, first) {
        return Ok(kind);
    }
    if let Some(kind) = isolated(rows, expected, &spec, first) {
        return Ok(kind);
    }
    let delayed = |ticks: i32| {
        agreement(rows, |index| expected.get(usize::try_from(index as i64 - i64::from(ticks)).ok()?).copied())
    };
    let unchanging = expected.windows(2).filter(|pair| pair[0] == pair[1]).count() as f64;
    let best = (1..=MAX_DELAY).flat_map(|ticks| [ticks, -ticks]).find(|ticks| delayed(*ticks) >= EXPLAINS);
    // A signal that hardly changes agrees with itself at every delay.
    if let Some(ticks) = best.filter(|_| unchanging < EXPLAINS * expected.len() as f64) {
        return Ok(Kind::Delay { ticks });
    }
    let limit = rows.iter().map(|row| row.u.abs()).fold(0.0, f64::max);
    let cut_off = expected.iter().filter(|u| u.abs() > limit + TOLERANCE_STEPS).count();
    if cut_off > 0 && agreement(rows, |index| Some(expected[index].clamp(-limit, limit))) >= EXPLAINS {
        return Ok(Kind::ClampSignal { limit });
    }
    if let Some(kind) = other_integral_limits(rows, spec)? {
        return Ok(kind);
    }
    if let Some(kind) = other_gains(rows, spec)? {
        return Ok(kind);
    }
    Ok(Kind::Unknown)
}

/// The times themselves jump where the ticks begin to differ.
fn hole(rows: &[ControlRow], spec: &ConfigSpec, first: usize) -> Option<Kind> {
    let before = rows.get(first.checked_sub(1)?)?;
    let step_us = rows[first].time_us - before.time_us;
    (step_us > 1.5 * f64::from(spec.period_us))
        .then_some(Kind::LostSample { time_us: rows[first].time_us, shown_by_time: true })
}

/// The integral that the recorded control signal implies, and whether its ends as limits explain the record.
fn other_integral_limits(rows: &[ControlRow], spec: ConfigSpec) -> Result<Option<Kind>, ControlError> {
    let ki_tick: f64 = spec.ki_tick.to_num();
    if ki_tick == 0.0 {
        return Ok(None);
    }
    let without = ConfigSpec { ki_tick: Default::default(), ..spec };
    let proportional = recompute(rows, without)?;
    let implied: Vec<f64> = rows.iter().zip(&proportional).map(|(row, u)| (row.u - u) / ki_tick).collect();
    let low = implied.iter().copied().fold(0.0, f64::min).round();
    let high = implied.iter().copied().fold(0.0, f64::max).round();
    if low < f64::from(i32::MIN) || high > f64::from(i32::MAX) {
        return Ok(None);
    }
    let period_s = f64::from(spec.period_us) * 1e-6;
    // A limit that was never reached is not known: it is left as it is.
    for (min, max) in [(low as i32, spec.integral_max), (spec.integral_min, high as i32), (low as i32, high as i32)] {
        let limited = ConfigSpec { integral_min: min, integral_max: max, ..spec };
        if (min, max) != (spec.integral_min, spec.integral_max) && Config::try_from(limited).is_ok() {
            let u = recompute(rows, limited)?;
            if agreement(rows, |index| Some(u[index])) >= EXPLAINS {
                return Ok(Some(Kind::ClampIntegral {
                    min: f64::from(min) * period_s,
                    max: f64::from(max) * period_s,
                }));
            }
        }
    }
    Ok(None)
}

/// Least squares of the recorded control signal over error, integral and difference of the error.
fn other_gains(rows: &[ControlRow], spec: ConfigSpec) -> Result<Option<Kind>, ControlError> {
    let unit = |change: fn(&mut ConfigSpec)| {
        let mut only = ConfigSpec {
            kp: Default::default(),
            ki_tick: Default::default(),
            kd_tick: Default::default(),
            conditional_integration: false,
            ..spec
        };
        change(&mut only);
        recompute(rows, only)
    };
    // The integral does not depend on the gains; a small one keeps it inside the range of the control signal.
    let terms = [
        unit(|only| only.kp = fixed::types::I32F32::ONE)?,
        unit(|only| only.ki_tick = fixed::types::I16F48::lit("0.0078125"))?,
        unit(|only| only.kd_tick = fixed::types::I32F32::ONE)?,
    ];
    let configured =
        Vector3::new(spec.kp.to_num::<f64>(), spec.ki_tick.to_num::<f64>() * 128.0, spec.kd_tick.to_num::<f64>());
    // Terms that never move say nothing about their gain: they stay as configured.
    let moves: Vec<bool> = terms.iter().map(|term| term.iter().any(|value| *value != term[0])).collect();
    let (mut normal, mut right) = (Matrix3::<f64>::identity(), configured);
    for i in (0..3).filter(|i| moves[*i]) {
        let rest = |row: usize| {
            rows[row].u - (0..3).filter(|j| !moves[*j]).map(|j| configured[j] * terms[j][row]).sum::<f64>()
        };
        right[i] = (0..rows.len()).map(|row| terms[i][row] * rest(row)).sum();
        for j in 0..3 {
            normal[(i, j)] = if moves[j] { terms[i].iter().zip(&terms[j]).map(|(a, b)| a * b).sum() } else { 0.0 };
        }
    }
    let Some(found) = normal.lu().solve(&right) else { return Ok(None) };
    let fits = agreement(rows, |row| Some((0..3).map(|i| found[i] * terms[i][row]).sum()));
    if fits < EXPLAINS {
        return Ok(None);
    }
    let period_s = f64::from(spec.period_us) * 1e-6;
    let scale = [1.0, 1.0 / (128.0 * period_s), period_s];
    let other = |i: usize| {
        let largest = terms[i].iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let off = (found[i] - configured[i]).abs();
        (off > SAME_GAIN * configured[i].abs() && off * largest > TOLERANCE_STEPS).then_some(found[i] * scale[i])
    };
    let (kp, ki, kd) = (other(0), other(1), other(2));
    Ok((kp.is_some() || ki.is_some() || kd.is_some()).then_some(Kind::Gain { kp, ki, kd }))
}

/// Only a tick here and there differs, or what the integral took along from it. A tick that is missing from the table
/// changes the next difference of the error, and leaves its own error out of the integral for good.
fn isolated(rows: &[ControlRow], expected: &[f64], spec: &ConfigSpec, first: usize) -> Option<Kind> {
    let largest_error = rows.iter().map(|row| (row.target - row.position).abs()).fold(0.0, f64::max);
    let left_out = 4.0 * spec.ki_tick.to_num::<f64>().abs() * largest_error;
    let is_far = |index: &usize| (rows[*index].u - expected[*index]).abs() > TOLERANCE_STEPS + left_out;
    let far = (0..rows.len()).filter(is_far).count();
    (far <= (rows.len() / ISOLATED_ONE_IN).max(2))
        .then_some(Kind::LostSample { time_us: rows[first].time_us, shown_by_time: false })
}

/// Root of the mean square of `count` values.
pub(super) fn root_mean(values: impl Iterator<Item = f64>, count: usize) -> f64 {
    (values.map(|value| value * value).sum::<f64>() / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::measurement::Direction;

    /// A controller written from its formula in doubles, with what a test changes about it.
    struct Loop {
        kp: f64,
        ki: f64,
        kd: f64,
        integral: (f64, f64),
        limit: f64,
        delay: usize,
        /// Tick that ran but was not written down.
        lost: Option<usize>,
    }

    const THESIS: Loop =
        Loop { kp: 1.3, ki: 0.0015, kd: 0.00004, integral: (0.0, 31.0), limit: f64::MAX, delay: 0, lost: None };

    /// Ten seconds of a sine, at 500 µs, over a rotor that turns at 350 counts/s under full drive.
    fn run(control: Loop) -> Vec<ControlRow> {
        let dt = 500e-6;
        let (mut position, mut previous, mut integral) = (0.0_f64, 0.0, 0.0_f64);
        let mut signals = Vec::new();
        let mut rows = Vec::new();
        for tick in 0..20_000 {
            let target = (89.0 * (1.257 * tick as f64 * dt).sin()).trunc();
            let error = target - position.trunc();
            integral = (integral + error * dt).clamp(control.integral.0, control.integral.1);
            let u = control.kp * error + control.ki * integral + control.kd * (error - previous) / dt;
            previous = error;
            signals.push(u.clamp(-control.limit, control.limit));
            let u = if tick >= control.delay { signals[tick - control.delay] } else { 0.0 };
            let on = 32.0 - (31.0 - u.abs()).max(0.0).trunc();
            let direction = if u > 0.0 { Direction::Cw } else { Direction::Ccw };
            if control.lost != Some(tick) {
                let time_us = (rows.len() * 500) as f64;
                rows.push(ControlRow { time_us, target, position: position.trunc(), u, duty: on / 32.0, direction });
            }
            position += direction.sign() * (on - 1.0) / 31.0 * 350.0 * dt;
        }
        rows
    }

    fn kind(control: Loop) -> Kind {
        check_rows(&run(control), ControlSpec::Thesis).unwrap().kind.unwrap()
    }

    #[test]
    fn the_configured_controller_has_no_mismatch() {
        let found = check_rows(&run(THESIS), ControlSpec::Thesis).unwrap();
        assert_eq!((found.ticks, found.mismatched, found.kind), (20_000, 0, None));
        assert!(found.rms_steps < 1e-4, "{}", found.rms_steps);
    }

    #[test]
    fn another_gain_is_named_with_its_value() {
        let Kind::Gain { kp: Some(kp), ki: None, kd: None } = kind(Loop { kp: 1.5, ..THESIS }) else { panic!() };
        assert!((kp - 1.5).abs() < 1e-3, "{kp}");
        let Kind::Gain { kp: None, ki: Some(ki), kd: None } = kind(Loop { ki: 0.15, ..THESIS }) else { panic!() };
        assert!((ki - 0.15).abs() < 1e-3, "{ki}");
        let Kind::Gain { kp: None, ki: None, kd: Some(kd) } = kind(Loop { kd: 0.0008, ..THESIS }) else { panic!() };
        assert!((kd - 0.0008).abs() < 1e-6, "{kd}");
    }

    #[test]
    fn a_delay_is_named_in_ticks() {
        assert_eq!(kind(Loop { delay: 3, ..THESIS }), Kind::Delay { ticks: 3 });
    }

    #[test]
    fn a_cut_off_signal_is_named_with_its_limit() {
        let Kind::ClampSignal { limit } = kind(Loop { limit: 10.0, ..THESIS }) else { panic!() };
        assert_eq!(limit, 10.0);
    }

    #[test]
    fn other_limits_of_the_integral_are_named() {
        let gains = crate::record::measurement::ControlGains {
            kp: 1.3,
            ki: 0.5,
            kd: 0.00004,
            period_us: 500.0,
            duty_steps: 32,
            integral_min: -31.0,
            integral_max: 31.0,
        };
        let rows = run(Loop { ki: 0.5, integral: (-31.0, 4.0), ..THESIS });
        let found = check_rows(&rows, ControlSpec::Table(gains)).unwrap();
        let Some(Kind::ClampIntegral { min, max }) = found.kind else { panic!("{:?}", found.kind) };
        assert!((max - 4.0).abs() < 0.01, "{min} {max}");
    }

    #[test]
    fn a_lost_sample_is_named_where_it_is_missing() {
        // A tick on which the error changes: the next difference is then taken from another error.
        let rows = run(THESIS);
        let error = |row: &ControlRow| row.target - row.position;
        let tick = (5000..).find(|tick| error(&rows[*tick]) != error(&rows[tick - 1])).unwrap();
        let found = check_rows(&run(Loop { lost: Some(tick), ..THESIS }), ControlSpec::Thesis).unwrap();
        assert_eq!(found.first.unwrap().row, tick);
        assert_eq!(found.kind, Some(Kind::LostSample { time_us: tick as f64 * 500.0, shown_by_time: false }));
        let mut rows = run(Loop { lost: Some(tick), ..THESIS });
        for row in &mut rows[tick..] {
            row.time_us += 500.0;
        }
        let found = check_rows(&rows, ControlSpec::Thesis).unwrap();
        assert_eq!(found.kind, Some(Kind::LostSample { time_us: (tick + 1) as f64 * 500.0, shown_by_time: true }));
    }

    #[test]
    fn what_cannot_be_recomputed_says_why() {
        let error = check_rows(&run(THESIS), ControlSpec::Default).unwrap_err();
        assert!(matches!(error, ControllerError::FeedForward));
        let speed = Run::new(
            "a",
            crate::record::measurement::RunKind::Speed,
            RunData::Velocity { time_us: vec![0.0, 1.0], rpm: vec![0.0; 2] },
        );
        assert!(check(&speed).unwrap_err().to_string().contains("no control ticks"));
    }
}
