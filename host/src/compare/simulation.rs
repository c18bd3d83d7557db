//! A measurement against the simulation: the speed–duty line, and each run's speed, position and transients.
//!
//! The simulated encoder is recorded the way the run was (sampled levels or edges) and goes through the same estimator, so
//! that what differs is the motor and not the way of looking at it.

use crate::model::actuator::Command;
use crate::model::effects::EffectSet;
use crate::model::motor::Motor;
use crate::model::motor_plant::{History, Solver};
use crate::model::parameters::Flavour;
use crate::model::plant;
use crate::model::simulate::{PlantModel, Program, simulate};
use crate::record::convert::to_levels;
use crate::record::measurement::{Direction, LevelEdge, Measurement, Run, RunData, RunKind};
use crate::signal::SignalError;
use crate::signal::course::{Course, Drive};
use crate::signal::run::{Method, Motion, Options, motion};
use serde::Serialize;

/// Duties below which a line through mean speeds means nothing.
const LEAST_DUTIES: usize = 3;
/// More PWM periods take too long to simulate: a day and a half at 50 Hz.
const MOST_PERIODS: f64 = 7e6;

/// Why a run cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum ComparisonError {
    /// Nothing to simulate.
    #[error("{0} has no open-loop run with a duty and a speed: the simulation needs `kind = \"speed\"` and `duty`")]
    NoRuns(String),
    /// A run that cannot be read as a speed.
    #[error("run `{run}`: {reason}")]
    Signal {
        /// The run.
        run: String,
        /// Why.
        reason: SignalError,
    },
}

/// A measurement beside its simulation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Which reading of the model was simulated.
    pub flavour: Flavour,
    /// Share of the variance of the runs' mean speeds that the simulation explains; none below three duties.
    pub r2_speed: Option<f64>,
    /// RMSE of the speed over all runs, each alike, in rpm.
    pub rmse_speed_rpm: f64,
    /// RMSE of the angle turned since the start of the run, over all runs alike, in degrees.
    pub rmse_position_deg: f64,
    /// The runs.
    pub runs: Vec<RunComparison>,
    /// Runs left out: not open loop, or without a duty.
    pub left_out: Vec<String>,
}

/// One run beside its simulation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunComparison {
    /// The run.
    pub id: String,
    /// Fraction of the PWM period with drive on.
    pub duty: f64,
    /// RMSE of the speed, in rpm.
    pub rmse_speed_rpm: f64,
    /// RMSE of the angle turned since the start, in degrees.
    pub rmse_position_deg: f64,
    /// What was measured.
    pub measured: Transient,
    /// What was simulated.
    pub simulated: Transient,
    /// How it was driven.
    #[serde(skip)]
    pub drive: Drive,
    /// The measured motion, for pictures.
    #[serde(skip)]
    pub motion: Motion,
    /// The simulated speed at its times, rpm.
    #[serde(skip)]
    pub simulated_rpm: Vec<f64>,
}

/// How a run starts, settles and stops. Speeds are positive in the commanded direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Transient {
    /// Mean speed while driven, the first 0.2 s left out, in rpm.
    pub mean_rpm: f64,
    /// The same: the name it had when `mean_rpm` held the start too.
    pub settled_rpm: f64,
    /// Greatest speed in the first 0.2 s, in rpm.
    pub start_peak_rpm: f64,
    /// From the start to 63 % of the settled speed, in s.
    pub rise_s: Option<f64>,
    /// From the end of the drive to 5 % of the settled speed, in s.
    pub stop_s: Option<f64>,
    /// By what share of the settled speed the start goes beyond it.
    pub overshoot: Option<f64>,
    /// Angle turned after the end of the drive, in degrees.
    pub coast_deg: Option<f64>,
}

/// A motor and the effects its file lists.
type Model = (PlantModel, EffectSet);

/// Simulates every open-loop run of a measurement with a motor and compares.
///
/// # Errors
/// [`ComparisonError::NoRuns`] when no run can be simulated; a run that is not a speed.
pub fn compare(measurement: &Measurement, motor: &Motor, flavour: Flavour) -> Result<Comparison, ComparisonError> {
    let plant = PlantModel::Motor { parameters: motor.parameters(flavour), flavour, solver: Solver::Averaged };
    let model = (plant, motor.effects());
    let (mut runs, mut left_out) = (Vec::new(), Vec::new());
    for run in &measurement.runs {
        match run.duty.filter(|_| run.kind == RunKind::Speed && !matches!(run.data, RunData::Drive { .. })) {
            Some(duty) => runs.push(
                compare_run(run, duty, measurement.edges_per_rev, &model)
                    .map_err(|reason| ComparisonError::Signal { run: run.id.clone(), reason })?,
            ),
            None => left_out.push(run.id.clone()),
        }
    }
    if runs.is_empty() {
        return Err(ComparisonError::NoRuns(measurement.folder.display().to_string()));
    }
    let rms =
        |f: &dyn Fn(&RunComparison) -> f64| (runs.iter().map(|r| f(r).powi(2)).sum::<f64>() / runs.len() as f64).sqrt();
    Ok(Comparison {
        flavour,
        r2_speed: r2_of_speeds(&runs),
        rmse_speed_rpm: rms(&|r| r.rmse_speed_rpm),
        rmse_position_deg: rms(&|r| r.rmse_position_deg),
        left_out,
        runs,
    })
}

/// How far the mean speeds of a motor are off those of all open-loop runs, and these speeds: root mean squares in rpm. `None` where nothing can
/// be simulated.
pub fn mean_speeds_off(measurements: &[Measurement], motor: &Motor, flavour: Flavour) -> Option<[f64; 2]> {
    let compared = measurements.iter().filter_map(|m| compare(m, motor, flavour).ok()).flat_map(|c| c.runs);
    let pairs: Vec<[f64; 2]> = compared
        .map(|run| [run.simulated.mean_rpm - run.measured.mean_rpm, run.measured.mean_rpm])
        .filter(|pair| pair.iter().all(|rpm| rpm.is_finite()))
        .collect();
    let rms = |k: usize| (pairs.iter().map(|pair| pair[k].powi(2)).sum::<f64>() / pairs.len() as f64).sqrt();
    (!pairs.is_empty()).then(|| [rms(0), rms(1)])
}

fn compare_run(run: &Run, duty: f64, edges_per_rev: u32, model: &Model) -> Result<RunComparison, SignalError> {
    let options = Options { method: Method::Smoother, edges_per_rev, period_us: None, edge_uncertainty_us: 2.0 };
    let measured = motion(run, &options)?;
    let simulated_run = Run { data: simulated_data(run, duty, edges_per_rev, model)?, ..run.clone() };
    let simulated = motion(&simulated_run, &options)?;
    let sign = run.direction.unwrap_or(Direction::Cw).sign();
    let simulated_rpm = at_times(&simulated, &simulated.speed_rpm, &measured.time_us);
    let simulated_rad = at_times(&simulated, &simulated.position_rad, &measured.time_us);
    let turned = |rad: &[f64], i: usize| (rad[i] - rad[0]).to_degrees();
    let n = measured.time_us.len();
    let rms = |f: &dyn Fn(usize) -> f64| ((0..n).map(|i| f(i).powi(2)).sum::<f64>() / n.max(1) as f64).sqrt();
    let course = |motion: &Motion| transient(&Course::of(motion, Drive::of(run)), sign);
    let beside = Motion { position_rad: simulated_rad.clone(), speed_rpm: simulated_rpm.clone(), ..measured.clone() };
    Ok(RunComparison {
        id: run.id.clone(),
        drive: Drive::of(run),
        duty,
        rmse_speed_rpm: rms(&|i| measured.speed_rpm[i] - simulated_rpm[i]),
        rmse_position_deg: rms(&|i| turned(&measured.position_rad, i) - turned(&simulated_rad, i)),
        measured: course(&measured),
        simulated: course(&beside),
        motion: measured,
        simulated_rpm,
    })
}

/// Refuses a run that takes longer to simulate than its samples can ask for: time is bounded by their number, not by the
/// times in them. A sample may stand for a thousand PWM periods (20 s at 50 Hz), and half an hour is simulated in any case.
///
/// # Errors
/// [`SignalError::TooLong`].
pub(super) fn can_be_simulated(run: &Run) -> Result<(), SignalError> {
    let periods = run.span_us().1 * 1e-6 * run.pwm_hz;
    let most = (1e5 + 1e3 * run.data.len() as f64).min(MOST_PERIODS);
    if periods > most { Err(SignalError::TooLong { periods, most }) } else { Ok(()) }
}

/// What the run would have recorded of the simulated motor. The encoder's phase is that of an aligned motor, or the middle
/// of a pitch where it is unknown.
fn simulated_data(run: &Run, duty: f64, edges_per_rev: u32, (plant, effects): &Model) -> Result<RunData, SignalError> {
    let end_s = run.span_us().1 * 1e-6;
    can_be_simulated(run)?;
    let direction = match run.direction.unwrap_or(Direction::Cw) {
        Direction::Cw => plant::Direction::Cw,
        Direction::Ccw => plant::Direction::Ccw,
    };
    let pitch_rad = std::f64::consts::TAU / f64::from(edges_per_rev);
    let mut commands = vec![Command { time_s: 0.0, duty, direction }];
    commands.extend(run.drive_on_s.map(|time_s| Command { time_s, duty: 0.0, direction }));
    let program = Program {
        commands,
        pwm_hz: run.pwm_hz,
        pwm_phase_s: run.pwm_phase_s,
        end_s,
        edges_per_rev,
        encoder_phase_rad: if run.aligned { 0.0 } else { 0.5 * pitch_rad },
    };
    let trace = simulate(&program, plant, effects, History::default());
    let edges = trace.edges.iter().map(|e| LevelEdge { time_us: e.time_s * 1e6, level: e.level }).collect();
    let edges = RunData::Edges { initial: trace.initial, start_us: 0.0, edges, end_us: trace.end_s * 1e6 };
    match run.data {
        RunData::Levels { period_us, .. } => Ok(to_levels(edges, period_us)?),
        _ => Ok(edges),
    }
}

/// Values of a motion at other times: straight lines between, the end values beyond.
fn at_times(motion: &Motion, values: &[f64], times_us: &[f64]) -> Vec<f64> {
    let mut i = 0;
    times_us
        .iter()
        .map(|t| {
            while i + 2 < motion.time_us.len() && motion.time_us[i + 1] < *t {
                i += 1;
            }
            let Some(((t0, t1), (v0, v1))) =
                motion.time_us.get(i).zip(motion.time_us.get(i + 1)).zip(values.get(i).zip(values.get(i + 1)))
            else {
                return values.first().copied().unwrap_or(0.0);
            };
            v0 + (v1 - v0) * ((t - t0) / (t1 - t0)).clamp(0.0, 1.0)
        })
        .collect()
}

/// The figures of a course, speeds positive in the commanded direction.
fn transient(course: &Course, sign: f64) -> Transient {
    let mean_rpm = sign * course.mean_rpm.unwrap_or(0.0);
    Transient {
        mean_rpm,
        settled_rpm: mean_rpm,
        start_peak_rpm: sign * course.start_peak_rpm.unwrap_or(0.0),
        rise_s: course.rise_s,
        stop_s: course.stop_s,
        overshoot: course.overshoot,
        coast_deg: course.coast_deg,
    }
}

fn r2_of_speeds(runs: &[RunComparison]) -> Option<f64> {
    let mut duties: Vec<u64> = runs.iter().map(|r| r.duty.to_bits()).collect();
    duties.sort_unstable();
    duties.dedup();
    if duties.len() < LEAST_DUTIES {
        return None;
    }
    let mean = runs.iter().map(|r| r.measured.mean_rpm).sum::<f64>() / runs.len() as f64;
    let all: f64 = runs.iter().map(|r| (r.measured.mean_rpm - mean).powi(2)).sum();
    let left: f64 = runs.iter().map(|r| (r.measured.mean_rpm - r.simulated.mean_rpm).powi(2)).sum();
    (all > 0.0).then(|| 1.0 - left / all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    /// A measurement of the model itself, as a lab would have recorded it.
    fn measured(duties: &[f64], slower: f64) -> Measurement {
        let motor = Motor::pcbmotor_30mm();
        let flavour = Flavour::Physical;
        let model = (
            PlantModel::Motor { parameters: motor.parameters(flavour), flavour, solver: Solver::Averaged },
            EffectSet::default(),
        );
        let runs = duties
            .iter()
            .map(|duty| {
                let end = RunData::Velocity { time_us: vec![0.0, 0.7e6], rpm: vec![0.0; 2] };
                let mut run = Run::new(format!("d{}", 100.0 * duty), RunKind::Speed, end);
                (run.duty, run.direction, run.drive_on_s) = (Some(*duty), Some(Direction::Ccw), Some(0.5));
                let Ok(RunData::Edges { initial, start_us, edges, end_us }) = simulated_data(&run, *duty, 400, &model)
                else {
                    unreachable!("only levels become levels")
                };
                let edges =
                    edges.iter().map(|e| LevelEdge { time_us: e.time_us * slower, level: e.level }).collect::<Vec<_>>();
                let kept = edges.into_iter().filter(|e| e.time_us < end_us).collect();
                run.data = to_levels(RunData::Edges { initial, start_us, edges: kept, end_us }, 1000.0).unwrap();
                run
            })
            .collect();
        Measurement {
            name: "model".into(),
            motor: "pcbmotor-30mm".into(),
            edges_per_rev: 400,
            runs,
            folder: PathBuf::from("model"),
        }
    }

    #[test]
    fn a_measurement_of_the_model_itself_agrees() {
        let found = compare(&measured(&[0.5, 0.75, 1.0], 1.0), &Motor::pcbmotor_30mm(), Flavour::Physical).unwrap();
        assert!(found.r2_speed.unwrap() > 0.9999, "{found}");
        assert!(found.rmse_speed_rpm < 1e-6 && found.rmse_position_deg < 1e-6, "{found}");
        let full = &found.runs[2];
        assert!(full.measured.settled_rpm > 10.0 && full.measured.rise_s.unwrap() < 0.1, "{full:?}");
        assert!(full.measured.stop_s.unwrap() < 0.1, "{full:?}");
    }

    #[test]
    fn a_slower_motor_is_told_by_how_much() {
        let found = compare(&measured(&[0.5, 1.0], 1.1), &Motor::pcbmotor_30mm(), Flavour::Physical).unwrap();
        assert_eq!(found.r2_speed, None);
        let full = &found.runs[1];
        let ratio = full.simulated.settled_rpm / full.measured.settled_rpm;
        assert!((ratio - 1.1).abs() < 0.02, "{ratio}: {found}");
        assert!(found.to_string().contains("needs three duties"));
        found.figure("Model").unwrap().svg().unwrap();
    }

    #[test]
    fn a_run_that_would_take_days_to_simulate_is_refused() {
        let mut measurement = measured(&[1.0], 1.0);
        measurement.runs[0].data = RunData::Velocity { time_us: vec![9e14, 9.1e14], rpm: vec![1.0; 2] };
        let error = compare(&measurement, &Motor::pcbmotor_30mm(), Flavour::Physical).unwrap_err();
        assert!(error.to_string().starts_with("run `d100`: it ends 45500000000 PWM periods after t = 0"), "{error}");
    }

    #[test]
    fn a_folder_without_duties_is_refused() {
        let mut measurement = measured(&[1.0], 1.0);
        measurement.runs[0].duty = None;
        let found = compare(&measurement, &Motor::pcbmotor_30mm(), Flavour::Physical);
        assert!(matches!(found, Err(ComparisonError::NoRuns(_))));
    }
}
