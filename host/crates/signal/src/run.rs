//! Position and speed of a recorded run, whatever it was recorded as.

use super::edges::{Directions, EdgeTrain};
use super::smoother::smooth;
use super::thesis::{self, Step, ThesisEstimate};
use super::window::{self, Order};
use super::{RAD_S_TO_RPM, SignalError};
use std::borrow::Cow;
use twum_record::convert::{most_instants, to_levels};
use twum_record::measurement::{Direction, DriveResponse, Run, RunData, RunKind};

/// Sampling period of the thesis's capture in µs (thesis, C.1), used where a record has none of its own.
pub const THESIS_PERIOD_US: f64 = 1000.0;

/// How speed is estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// [`super::smoother`].
    Smoother,
    /// [`super::thesis`], up to this step.
    Thesis(Step),
    /// [`super::window`] over this many samples.
    Window(usize, Order),
}

/// What the estimate takes from outside the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How speed is estimated.
    pub method: Method,
    /// Encoder edges a revolution.
    pub edges_per_rev: u32,
    /// Distance of the estimates in µs; `None` for that of the record's samples, or 1 ms where it has none.
    pub period_us: Option<f64>,
    /// Edges recorded with times are true within plus or minus this, in µs.
    pub edge_uncertainty_us: f64,
}

/// Position and speed over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// In µs, ascending.
    pub time_us: Vec<f64>,
    /// In rad, signed, from the start of the record.
    pub position_rad: Vec<f64>,
    /// In rpm, signed.
    pub speed_rpm: Vec<f64>,
    /// Standard deviation of the speed in rpm, where the method knows it.
    pub speed_sd_rpm: Option<Vec<f64>>,
    /// Edges seen; 0 when the record holds speeds.
    pub edges: usize,
    /// What the smoother found out about the encoder.
    pub encoder: Option<EncoderErrors>,
}

/// The encoder's errors as the smoother found them.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct EncoderErrors {
    /// Standard deviation of the boundaries from equal spacing, in pitches.
    pub irregularity_pitch: f64,
    /// Shift of the odd boundaries against the even ones, in pitches.
    pub odd_shift_pitch: f64,
}

/// When the drive of an open-loop run first goes on, in µs: after the off part of the PWM period that t = 0 lies in. `None`
/// where the run does not say that its drive begins at t = 0 (`drive_on_s`, `duty`).
fn drive_on_us(run: &Run) -> Option<f64> {
    let (duty, _) = run.duty.zip(run.drive_on_s).filter(|(duty, _)| run.kind == RunKind::Speed && *duty > 0.0)?;
    let period_us = 1e6 / run.pwm_hz;
    let into_us = (run.pwm_phase_s * 1e6).rem_euclid(period_us);
    Some(((1.0 - duty) * period_us - into_us).max(0.0))
}

/// The edges of a run, from levels, timestamps or counts. An open-loop run whose drive begins at t = 0 starts from rest.
///
/// # Errors
/// [`SignalError::NoEncoder`] when the run holds no encoder data, and as [`EdgeTrain`]'s constructors.
pub fn edges(run: &Run, edges_per_rev: u32, edge_uncertainty_us: f64) -> Result<EdgeTrain, SignalError> {
    let directions = Directions::constant(run.direction.unwrap_or(Direction::Cw));
    let train = match &run.data {
        RunData::Levels { start_us, period_us, levels } => {
            EdgeTrain::from_levels(*start_us, *period_us, levels, edges_per_rev, &directions)
        }
        RunData::Edges { start_us, end_us, edges, .. } => {
            EdgeTrain::from_times(*start_us, *end_us, edges, edge_uncertainty_us, edges_per_rev, &directions)
        }
        RunData::Control(rows) => {
            let counts: Vec<(f64, f64)> = rows.iter().map(|r| (r.time_us, r.position)).collect();
            EdgeTrain::from_counts(&counts, edges_per_rev)
        }
        RunData::Velocity { .. } | RunData::Drive { .. } => return Err(SignalError::NoEncoder),
    }?;
    // The phase of the PWM may not be known to whoever wrote the folder: what the record shows counts.
    Ok(match drive_on_us(run) {
        Some(on_us) if train.edges.first().is_some_and(|edge| edge.before_us <= on_us) => train.at_rest_until(0.0),
        Some(on_us) => train.at_rest_until(on_us),
        None => train,
    })
}

/// Estimates the motion of a run. A record of speeds is handed on as it is, its position by the trapezoidal rule.
///
/// # Errors
/// [`SignalError::NoEncoder`] when there is neither encoder data nor speed, and what the method refuses.
pub fn motion(run: &Run, options: &Options) -> Result<Motion, SignalError> {
    match &run.data {
        RunData::Velocity { time_us, rpm } => return Ok(Motion::of_speeds(time_us, rpm)),
        RunData::Drive { time_us, response: DriveResponse::SpeedRpm(rpm), .. } => {
            return Ok(Motion::of_speeds(time_us, rpm));
        }
        _ => {}
    }
    match options.method {
        Method::Smoother => smoothed(run, options),
        Method::Thesis(step) => of_thesis(run, options, step),
        Method::Window(samples, order) => windowed(run, options, samples, order),
    }
}

/// Every step of the thesis's method on a run, with the sign of its direction left out.
///
/// # Errors
/// [`SignalError::NoEncoder`] when the run holds no encoder line, and as [`thesis::estimate`].
pub fn thesis_steps(run: &Run, options: &Options) -> Result<ThesisEstimate, SignalError> {
    let (start_us, period_us, levels) = thesis_levels(run, options)?;
    thesis::estimate(start_us, period_us, &levels, options.edges_per_rev)
}

/// Start and period (µs) of a run's levels, sampled as the thesis did where its edges have times.
fn thesis_levels<'a>(run: &'a Run, options: &Options) -> Result<(f64, f64, Cow<'a, [bool]>), SignalError> {
    let sampled = match &run.data {
        RunData::Levels { start_us, period_us, levels } => return Ok((*start_us, *period_us, levels.into())),
        data @ RunData::Edges { .. } => {
            let period_us = options.period_us.unwrap_or(THESIS_PERIOD_US);
            super::check_positive("the period of the estimates (µs)", period_us)?;
            to_levels(data.clone(), period_us)?
        }
        _ => return Err(SignalError::NoEncoder),
    };
    match sampled {
        RunData::Levels { start_us, period_us, levels } => Ok((start_us, period_us, levels.into())),
        _ => Err(SignalError::NoEncoder),
    }
}

impl Motion {
    /// A record of speeds, its position by the trapezoidal rule.
    pub fn of_speeds(time_us: &[f64], speed_rpm: &[f64]) -> Self {
        let mut position_rad = Vec::with_capacity(time_us.len());
        let mut angle = 0.0;
        for i in 0..time_us.len() {
            if i > 0 {
                let step_s = (time_us[i] - time_us[i - 1]) * 1e-6;
                angle += 0.5 * (speed_rpm[i] + speed_rpm[i - 1]) / RAD_S_TO_RPM * step_s;
            }
            position_rad.push(angle);
        }
        Self {
            time_us: time_us.to_vec(),
            position_rad,
            speed_rpm: speed_rpm.to_vec(),
            speed_sd_rpm: None,
            edges: 0,
            encoder: None,
        }
    }
}

/// Times at which the run is estimated.
fn grid(run: &Run, options: &Options, train: &EdgeTrain) -> Result<Vec<f64>, SignalError> {
    let own = match &run.data {
        RunData::Levels { period_us, .. } => *period_us,
        _ => THESIS_PERIOD_US,
    };
    let mut period_us = options.period_us.unwrap_or(own);
    super::check_positive("the period of the estimates (µs)", period_us)?;
    let span_us = train.end_us - train.start_us;
    let mut count = (span_us / period_us + 1e-6).floor() as usize + 1;
    let most = most_instants(train.edges.len()).max(run.data.len());
    if count > most {
        if options.period_us.is_some() {
            return Err(SignalError::TooMany { samples: count, most });
        }
        // Hours in which nothing moves need no estimate every millisecond.
        (count, period_us) = (most, span_us / (most - 1) as f64);
    }
    Ok((0..count).map(|i| train.start_us + i as f64 * period_us).collect())
}

fn smoothed(run: &Run, options: &Options) -> Result<Motion, SignalError> {
    let train = edges(run, options.edges_per_rev, options.edge_uncertainty_us)?;
    let found = smooth(&train, &grid(run, options, &train)?)?;
    Ok(Motion {
        time_us: found.time_us,
        position_rad: found.position_rad,
        speed_rpm: found.speed_rpm,
        speed_sd_rpm: Some(found.speed_sd_rpm),
        edges: train.edges.len(),
        encoder: Some(EncoderErrors {
            irregularity_pitch: found.irregularity_pitch,
            odd_shift_pitch: found.odd_shift_pitch,
        }),
    })
}

fn of_thesis(run: &Run, options: &Options, step: Step) -> Result<Motion, SignalError> {
    let (start_us, period_us, levels) = thesis_levels(run, options)?;
    let fit = thesis::local_fit(period_us, &levels, options.edges_per_rev)?;
    let sign = run.direction.unwrap_or(Direction::Cw).sign();
    let signed = |values: Vec<f64>| values.into_iter().map(|v| sign * v).collect();
    Ok(Motion {
        time_us: thesis::times_us(start_us, period_us, &fit),
        speed_rpm: signed(thesis::filtered(&fit.raw_rpm, period_us, step)?),
        position_rad: signed(fit.position_rad),
        speed_sd_rpm: None,
        edges: edges(run, options.edges_per_rev, options.edge_uncertainty_us)?.edges.len(),
        encoder: None,
    })
}

fn windowed(run: &Run, options: &Options, samples: usize, order: Order) -> Result<Motion, SignalError> {
    let train = edges(run, options.edges_per_rev, options.edge_uncertainty_us)?;
    let time_us = grid(run, options, &train)?;
    let period_us = time_us.get(1).map_or(THESIS_PERIOD_US, |t| t - time_us[0]);
    let speed_rpm = window::speed_rpm(&train, period_us, time_us.len(), samples, order)?;
    // Where the window knows no speed, the position stays.
    let known: Vec<f64> = speed_rpm.iter().map(|v| if v.is_finite() { *v } else { 0.0 }).collect();
    let position_rad = Motion::of_speeds(&time_us, &known).position_rad;
    Ok(Motion { position_rad, speed_rpm, time_us, speed_sd_rpm: None, edges: train.edges.len(), encoder: None })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::Step;
    use crate::trial::{self, Trial};
    use twum_record::measurement::{ControlRow, LevelEdge, RunKind};

    fn options(method: Method) -> Options {
        Options { method, edges_per_rev: 400, period_us: None, edge_uncertainty_us: 1.0 }
    }

    fn run(data: RunData) -> Run {
        Run { direction: Some(Direction::Ccw), ..Run::new("a", RunKind::Speed, data) }
    }

    #[test]
    fn every_method_gives_the_signed_speed_of_levels() {
        let trial = Trial::new(trial::Motion::Steady { rpm: 30.9 }, 1);
        let run = run(RunData::Levels { start_us: 0.0, period_us: 1000.0, levels: trial.levels().to_vec() });
        for method in [
            Method::Smoother,
            Method::Thesis(Step::LocalCubic),
            Method::Thesis(Step::Butterworth),
            Method::Thesis(Step::MovingAverage),
            Method::Thesis(Step::Median),
            Method::Window(61, Order::Cubic),
        ] {
            let got = motion(&run, &options(method)).unwrap();
            let middle = &got.speed_rpm[500..2500];
            let mean = middle.iter().sum::<f64>() / middle.len() as f64;
            assert!((mean + 30.9).abs() < 0.1, "{method:?}: {mean}");
            let turned = got.position_rad[2500] - got.position_rad[500];
            assert!((turned / (30.9 / RAD_S_TO_RPM * 2.0) + 1.0).abs() < 0.01, "{method:?}: {turned}");
        }
    }

    #[test]
    fn counts_of_a_control_loop_give_its_speed() {
        let rows = (0..4000)
            .map(|i| ControlRow {
                time_us: f64::from(i) * 500.0,
                target: 0.0,
                position: -(f64::from(i) * 0.1).floor(),
                u: 0.0,
                duty: 0.0,
                direction: Direction::Ccw,
            })
            .collect();
        let got = motion(&run(RunData::Control(rows)), &options(Method::Smoother)).unwrap();
        assert!((got.speed_rpm[1000] + 30.0).abs() < 0.01, "{}", got.speed_rpm[1000]);
    }

    #[test]
    fn speeds_are_handed_on_and_integrated() {
        let data = RunData::Velocity { time_us: vec![0.0, 1e6, 2e6], rpm: vec![0.0, 60.0, 60.0] };
        let got = motion(&run(data), &options(Method::Smoother)).unwrap();
        assert_eq!(got.speed_rpm, [0.0, 60.0, 60.0]);
        assert!((got.position_rad[2] - 1.5 * std::f64::consts::TAU).abs() < 1e-9);
    }

    /// A speed through an encoder that begins half a pitch past a boundary, as levels at 1 kHz and as edges.
    fn recorded(speed_rpm: impl Fn(f64) -> f64, length_s: f64) -> [Run; 2] {
        const STEP_S: f64 = 1e-5;
        let (mut pitches, mut levels, mut edges) = (0.5_f64, Vec::new(), Vec::new());
        for step in 0..(length_s / STEP_S) as usize {
            if step % 100 == 0 {
                levels.push(pitches as i64 % 2 == 1);
            }
            let next = pitches + speed_rpm((step as f64 + 0.5) * STEP_S) / 60.0 * 400.0 * STEP_S;
            if next.floor() > pitches.floor() {
                let share = (next.floor() - pitches) / (next - pitches);
                let time_us = (step as f64 + share) * STEP_S * 1e6;
                edges.push(LevelEdge { time_us, level: next as i64 % 2 == 1 });
            }
            pitches = next;
        }
        let levels = RunData::Levels { start_us: 0.0, period_us: 1000.0, levels };
        let edges = RunData::Edges { initial: false, start_us: 0.0, edges, end_us: length_s * 1e6 };
        [levels, edges].map(|data| Run {
            duty: Some(1.0),
            drive_on_s: Some(length_s),
            direction: Some(Direction::Cw),
            ..run(data)
        })
    }

    #[test]
    fn a_driven_run_starts_from_rest() {
        let [run, _] = recorded(|t| 35.0 * (1.0 - (-t / 0.001).exp()), 0.6);
        let got = motion(&run, &options(Method::Smoother)).unwrap();
        assert!(got.speed_rpm[0].abs() < 1e-6, "{}", got.speed_rpm[0]);
        // The first edge comes at 4 ms: 63 % are reached somewhere before it.
        let risen = got.speed_rpm.iter().position(|v| *v > 0.63 * 35.0).unwrap();
        assert!((1..4).contains(&risen), "{:?}", &got.speed_rpm[..6]);
        let worst = got.speed_rpm[5..590].iter().map(|v| (v - 35.0).abs()).fold(0.0, f64::max);
        assert!(worst < 1.0, "{worst}");
        // Without the drive's times nobody knows, and the speed of the first edges is carried back.
        let unknown = Run { drive_on_s: None, ..run };
        assert!(motion(&unknown, &options(Method::Smoother)).unwrap().speed_rpm[0] > 30.0);
    }

    #[test]
    fn the_drive_begins_after_the_off_part_of_its_first_period() {
        let [mut run, _] = recorded(|t| if t < 0.01 { 0.0 } else { 35.0 }, 0.3);
        run.duty = Some(0.5);
        assert_eq!(edges(&run, 400, 1.0).unwrap().rest_until_us, Some(10_000.0));
        run.pwm_phase_s = 0.004;
        assert_eq!(edges(&run, 400, 1.0).unwrap().rest_until_us, Some(6_000.0));
        // An edge before that says that the phase was another.
        run.duty = Some(0.01);
        assert_eq!(edges(&run, 400, 1.0).unwrap().rest_until_us, Some(0.0));
    }

    #[test]
    #[ignore = "needs measured data: .ci/run measured"]
    fn the_start_of_the_real_motor_is_seen_through_its_edges() {
        let data = std::env::var_os("TWUM_DATA").expect("TWUM_DATA names the folder of measured data");
        let folder = std::path::Path::new(&data).join("twum-speed");
        let measured = twum_record::measurement::Measurement::load(folder).unwrap();
        let RunData::Velocity { rpm, .. } = &measured.runs[0].data else { panic!() };
        let runs = recorded(|t| rpm[((t * 1e3).round() as usize).min(rpm.len() - 1)], 3.3);
        for (run, within_rpm) in runs.iter().zip([1.8, 0.6]) {
            let got = motion(run, &options(Method::Smoother)).unwrap();
            let (peak, at_ms) =
                (0..200).map(|i| (got.speed_rpm[i], i)).fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
            assert!((peak - 48.0).abs() < within_rpm && (8..=22).contains(&at_ms), "{peak} at {at_ms} ms");
            assert!((got.speed_rpm[16] - 47.9).abs() < within_rpm, "{}", got.speed_rpm[16]);
            // At rest before the drive, settled by 0.09 s.
            assert!(got.speed_rpm[0].abs() < 1e-6);
            assert!(got.speed_rpm[92..200].iter().all(|v| (v - 33.5).abs() < 0.8), "{:?}", &got.speed_rpm[92..200]);
        }
    }

    #[test]
    fn a_position_sensor_is_not_an_encoder_line() {
        let response = DriveResponse::PositionRad(vec![0.0]);
        let data = RunData::Drive { time_us: vec![0.0], input: vec![0.0], response, beside: Default::default() };
        assert_eq!(motion(&run(data), &options(Method::Smoother)), Err(SignalError::NoEncoder));
    }
}
