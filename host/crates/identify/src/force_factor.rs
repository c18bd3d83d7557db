//! The force factor from speeds, with what it trades off against.
//!
//! The thesis tuned η by hand until the simulated speeds looked right, and doubted the outcome: η may have made up for errors
//! elsewhere. Here the averaged model is fitted to the steady speed and the start-up lag of every run, with η free and each
//! parameter that could stand in for it free within what is known of it (a Gaussian prior on its logarithm from the motor
//! file's uncertainty, or 10 % where the file gives none). The interval of η then holds all of those trades, and the report
//! says which parameter takes part in it, by how much, and whether the data or only the prior separates the two.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use twum_motor::effects::EffectSet;
use twum_motor::motor::Motor;
use twum_motor::motor_plant::{History, Solver};
use twum_motor::parameters::{Flavour, Parameters};
use twum_motor::plant::Direction;
use twum_motor::simulate::{PlantModel, Program, simulate};
use twum_record::measurement::{Direction as Sense, Measurement, Run, RunData, RunKind};

/// What may trade with the force factor, by its name in the motor file. `stator` is a common factor on Ms, Cs and Ks: the
/// admittance fixes their ratios, and only together with η their size.
const RIVALS: [&str; 9] = ["stator", "Vrms", "f", "Rr", "Fext", "u", "uoff", "Ctheta", "Cn"];
/// Relative standard uncertainty where a motor file gives none; the drive's frequency is known far better.
const DEFAULT_PRIOR: f64 = 0.1;
const DEFAULT_PRIOR_F: f64 = 0.002;
/// Edges a revolution of the simulated encoder.
const FINE_EDGES: u32 = 20_000;
/// Relative standard uncertainty of a speed under load and of a stall torque.
const TORQUE_RELATIVE: f64 = 0.02;
/// From here a motor counts as run up (s): the thesis's motor takes some 50 ms.
const RUN_UP_S: f64 = 0.5;

/// Why no force factor could be had.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ForceFactorError {
    /// A load that the motor cannot have turned against.
    #[error(
        "a speed under {load_nm} N m: the contact of this motor transmits {most_nm:.6} N m at most; is the unit N m, and \
         the motor file's friction right?"
    )]
    Load {
        /// The load, N·m.
        load_nm: f64,
        /// What the contact transmits, N·m.
        most_nm: f64,
    },
    /// Nothing to go by.
    #[error(
        "{0}: no speed run with a duty, a direction and at least 0.8 s of drive after the start: record some with `twum speed`"
    )]
    NoRuns(String),
    /// The model does not turn where the motor did.
    #[error(
        "the model does not turn at any duty with eta up to {largest} N/V: check Fext, u and Vrms of the motor file"
    )]
    Stuck {
        /// The largest force factor tried (N/V).
        largest: f64,
    },
}

/// A measured speed under a known load, beside the runs of a folder.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
pub struct Loaded {
    /// Duty, 0 to 1.
    pub duty: f64,
    /// Load against the motion (N·m).
    pub load_nm: f64,
    /// Speed (rpm).
    pub rpm: f64,
}

/// What a torque bench adds to the speed runs of a folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TorqueRuns {
    /// Speeds under load.
    pub loaded: Vec<Loaded>,
    /// Torques at which the rotor stalled at full drive (N·m).
    pub stall_nm: Vec<f64>,
}

/// Why a file of torque runs could not be read.
#[derive(Debug, thiserror::Error)]
pub enum TorqueError {
    /// It is no CSV, or could not be opened.
    #[error("{}: {cause}; expected the columns duty,load_nm,rpm", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: csv::Error,
    },
    /// A row cannot be.
    #[error("{}, line {line}: {message}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        message: String,
    },
}

/// Beyond what any motor of this kind does (mN m, and some tens of rpm) by three orders of magnitude, and by more than one: such a row
/// is a mistake, has no linearisation, and a model that turns so fast takes minutes.
const MAX_LOAD_NM: f64 = 10.0;
const MAX_RPM: f64 = 1_000.0;
/// A motor that a micronewton metre stops turns nothing: its friction alone is more.
const MIN_STALL_NM: f64 = 1e-6;

impl TorqueRuns {
    /// Adds the rows of a CSV file with the columns `duty`, `load_nm` and `rpm`; a row at full duty with `rpm` 0 is a stall.
    ///
    /// # Errors
    /// [`TorqueError`], with the line.
    pub fn read(&mut self, path: &Path) -> Result<(), TorqueError> {
        let csv_error = |cause| TorqueError::Csv { path: path.to_owned(), cause };
        let bytes =
            twum_files::input::bytes(path, twum_files::input::MEASURED).map_err(|cause| csv_error(cause.into()))?;
        let mut reader =
            csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(bytes.as_slice());
        let mut rows = reader.deserialize();
        while let Some(row) = rows.next() {
            let row: Loaded = row.map_err(csv_error)?;
            let line = rows.reader().position().line().saturating_sub(1);
            self.add(row).map_err(|message| TorqueError::Row { path: path.to_owned(), line, message })?;
        }
        Ok(())
    }

    /// Adds one speed under load, or a stall.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn add(&mut self, row: Loaded) -> Result<(), String> {
        let Loaded { duty, load_nm, rpm } = row;
        if !(duty > 0.0 && duty <= 1.0) {
            return Err(format!("duty {duty} is outside 0 to 1"));
        }
        if !(load_nm.abs() <= MAX_LOAD_NM && rpm.abs() <= MAX_RPM) {
            return Err(format!("load {load_nm} N m and {rpm} rpm must be within {MAX_LOAD_NM} N m and {MAX_RPM} rpm"));
        }
        if rpm > 0.0 {
            self.loaded.push(row);
        } else if rpm == 0.0 && duty == 1.0 && load_nm >= MIN_STALL_NM {
            self.stall_nm.push(load_nm);
        } else if rpm == 0.0 {
            return Err(format!(
                "a stall must be at duty 1 and a torque of {MIN_STALL_NM} N m or more, got duty {duty} and {load_nm} N m"
            ));
        } else {
            return Err(format!("{rpm} rpm: a load drives no motor backwards; take its sense as positive"));
        }
        Ok(())
    }
}

/// One run against the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunResult {
    /// Run.
    pub id: String,
    /// Duty.
    pub duty: f64,
    /// Load against the motion (N·m).
    pub load_nm: f64,
    /// Steady speed measured (rpm).
    pub rpm: f64,
    /// Steady speed of the fitted model (rpm).
    pub model_rpm: f64,
    /// Start-up lag measured: how far the motor is behind one that ran steadily from t = 0 (s).
    pub lag_s: Option<f64>,
    /// Start-up lag of the fitted model (s).
    pub model_lag_s: Option<f64>,
}

/// How a parameter trades with the force factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trade {
    /// Parameter.
    pub with: String,
    /// Correlation of the two after the fit.
    pub correlation: f64,
    /// Per cent of η that one per cent of the parameter is answered by, everything else held.
    pub exchange: f64,
    /// Relative standard uncertainty before the fit.
    pub prior_relative: f64,
    /// And after.
    pub posterior_relative: f64,
    /// Value the fit settled on over the motor file's.
    pub ratio: f64,
}

/// The answer of `twum identify force-factor`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of this shape.
    pub schema: u32,
    /// Folder read.
    pub source: String,
    /// Motor file it starts from.
    pub motor: String,
    /// Reading of the model.
    pub flavour: Flavour,
    /// Force factor (N/V).
    pub eta_n_v: f64,
    /// Its 95 % interval with every trade in it (N/V).
    pub ci95: [f64; 2],
    /// Its 95 % interval were every other parameter exact (N/V).
    pub ci95_others_exact: [f64; 2],
    /// Parameters it trades with, the strongest first.
    pub trades: Vec<Trade>,
    /// Each run.
    pub runs: Vec<RunResult>,
    /// Stall torque of the fitted model (N·m).
    pub stall_nm: f64,
    /// Stall torques measured (N·m).
    pub stall_measured_nm: Vec<f64>,
    /// Coefficient of determination over the steady speeds; null below three.
    pub r2_speed: Option<f64>,
    /// Factor by which the residual exceeds the measurement's scatter; 1 is none.
    pub misfit: f64,
    /// What a reader should know.
    pub notes: Vec<String>,
}

struct Observed {
    id: String,
    duty: f64,
    sign: f64,
    load_nm: f64,
    pwm_hz: f64,
    pwm_phase_s: f64,
    rpm: f64,
    sigma_rpm: f64,
    /// Lag and its standard deviation (s).
    lag: Option<(f64, f64)>,
}

/// Fits the force factor of `motor` to the speed runs of a measurement and to loaded speeds.
///
/// # Errors
/// [`ForceFactorError`].
pub fn identify(
    measurement: &Measurement,
    torque: &TorqueRuns,
    motor: &Motor,
    flavour: Flavour,
) -> Result<Report, ForceFactorError> {
    let mut observed: Vec<Observed> =
        measurement.runs.iter().filter_map(|run| observe(run, measurement.edges_per_rev)).collect();
    if observed.is_empty() && torque.loaded.is_empty() {
        return Err(ForceFactorError::NoRuns(measurement.folder.display().to_string()));
    }
    scatter(&mut observed);
    let contact = motor.parameters(flavour);
    let most_nm = contact.friction * contact.preload_n * contact.contact_radius_m;
    if let Some(beyond) = torque.loaded.iter().find(|l| l.load_nm.abs() >= most_nm) {
        return Err(ForceFactorError::Load { load_nm: beyond.load_nm, most_nm });
    }
    observed.extend(torque.loaded.iter().map(|l| Observed {
        id: format!("load {} N m", l.load_nm),
        duty: l.duty,
        sign: 1.0,
        load_nm: l.load_nm,
        pwm_hz: 50.0,
        pwm_phase_s: 0.0,
        rpm: l.rpm,
        sigma_rpm: TORQUE_RELATIVE * l.rpm.max(1.0),
        lag: None,
    }));
    let base = motor.parameters(flavour);
    let priors: Vec<f64> = RIVALS.iter().map(|name| prior(motor, flavour, name)).collect();
    let (data, sigma) = targets(&observed, &torque.stall_nm);
    let predict = |x: &DVector<f64>| predictions(&observed, torque.stall_nm.len(), &with(&base, x), flavour);
    let search = Search { data: &data, sigma: &sigma, priors: &priors, predict: &predict };
    let mut best = search.settle(start(&observed, &base, flavour, &data, &sigma)?, false, None);
    let (mut low, mut high);
    let mut restarts = 0;
    loop {
        (low, high) = (search.end(&best, -1.0), search.end(&best, 1.0));
        let better = [&low, &high].into_iter().filter_map(|e| e.better.clone()).next();
        match better {
            // The way to an end of the interval led to a better fit: go on from there.
            Some(x) if restarts < 3 => {
                restarts += 1;
                best = search.settle(x, false, None);
            }
            _ => break,
        }
    }
    let (normal, _) = search.normal_equations(&best);
    let covariance = normal.clone().try_inverse().unwrap_or_else(|| DMatrix::identity(best.x.len(), best.x.len()));
    let alone = 1.0 / normal[(0, 0)].sqrt();
    Ok(report(
        measurement,
        motor,
        flavour,
        &base,
        &observed,
        &torque.stall_nm,
        &best.x,
        &best.y,
        &best.jacobian,
        &sigma,
        &priors,
        &covariance,
        [low.x0, high.x0],
        alone,
        best.misfit,
    ))
}

/// A point of the search: logarithms of η and its rivals over the motor file's, what the model makes of them, its slopes.
struct Point {
    x: DVector<f64>,
    y: DVector<f64>,
    jacobian: DMatrix<f64>,
    misfit: f64,
}

/// An end of the interval: ln(η over the motor file's), and a better fit than the best one if the way there met it.
struct End {
    x0: f64,
    better: Option<DVector<f64>>,
}

struct Search<'a, P: Fn(&DVector<f64>) -> DVector<f64>> {
    data: &'a [f64],
    sigma: &'a [f64],
    priors: &'a [f64],
    predict: &'a P,
}

impl<P: Fn(&DVector<f64>) -> DVector<f64>> Search<'_, P> {
    /// Squared distance from data and priors, the data's scatter widened by `misfit`.
    fn cost(&self, x: &DVector<f64>, y: &DVector<f64>, misfit: f64) -> f64 {
        let from_data: f64 =
            self.data.iter().zip(y.iter()).zip(self.sigma).map(|((d, y), s)| ((d - y) / (s * misfit)).powi(2)).sum();
        from_data + penalty(x, self.priors)
    }

    fn normal_equations(&self, at: &Point) -> (DMatrix<f64>, DVector<f64>) {
        normal_equations(&at.jacobian, self.data, &at.y, self.sigma, &at.x, self.priors, at.misfit)
    }

    /// Gauss–Newton with the priors as further residuals; a step that does not help is shortened. `held` keeps η where it is,
    /// `misfit` is estimated on the way unless given.
    fn settle(&self, x: DVector<f64>, held: bool, misfit: Option<f64>) -> Point {
        let y = (self.predict)(&x);
        let jacobian = slopes(&x, self.predict);
        let mut at = Point { misfit: misfit.unwrap_or_else(|| excess(self.data, &y, self.sigma)), x, y, jacobian };
        for _ in 0..20 {
            at.misfit = misfit.unwrap_or_else(|| excess(self.data, &at.y, self.sigma));
            let (mut normal, mut gradient) = self.normal_equations(&at);
            if held {
                normal.row_mut(0).fill(0.0);
                normal.column_mut(0).fill(0.0);
                (normal[(0, 0)], gradient[0]) = (1.0, 0.0);
            }
            let Some(full) = normal.cholesky().map(|c| c.solve(&gradient)) else { break };
            let full = full.map(|d| d.clamp(-0.5, 0.5));
            let before = self.cost(&at.x, &at.y, at.misfit);
            let mut factor = 1.0;
            let mut gained = 0.0;
            while factor > 0.02 {
                let x = &at.x + &full * factor;
                let y = (self.predict)(&x);
                let after = self.cost(&x, &y, at.misfit);
                if after < before {
                    (at.x, at.y) = (x, y);
                    gained = before - after;
                    break;
                }
                factor *= 0.4;
            }
            if gained < 1e-3 {
                break;
            }
            at.jacobian = slopes(&at.x, self.predict);
        }
        at
    }

    /// An end of the 95 % interval by profile likelihood (Venzon and Moolgavkar, Applied Statistics 37, 1988): where the best
    /// fit with η held costs 1.96² more than the best of all. The model bends too much for the covariance to say.
    fn end(&self, best: &Point, sense: f64) -> End {
        let (normal, _) = self.normal_equations(best);
        let covariance = normal.try_inverse().unwrap_or_else(|| DMatrix::identity(best.x.len(), best.x.len()));
        let along = covariance.column(0) / covariance[(0, 0)];
        let least = self.cost(&best.x, &best.y, best.misfit);
        let (mut inside, mut outside) = ((0.0, 0.0), None);
        let mut nearest = best.x.clone();
        let mut away = (1.96 * covariance[(0, 0)].sqrt()).clamp(1e-4, 1.0);
        for _ in 0..10 {
            // From the nearest point already settled, along the valley the best fit lies in.
            let shift = best.x[0] + sense * away - nearest[0];
            let there = self.settle(&nearest + &along * shift, true, Some(best.misfit));
            let more = self.cost(&there.x, &there.y, best.misfit) - least;
            if more < -0.05 {
                return End { x0: there.x[0], better: Some(there.x) };
            }
            let distance = more.max(0.0).sqrt();
            if (distance - 1.96).abs() < 0.02 {
                inside = (away, distance);
                break;
            }
            if distance < 1.96 {
                (inside, nearest) = ((away, distance), there.x);
            } else {
                outside = Some((away, distance));
            }
            away = match outside {
                None => away * (1.96 / distance.max(0.5)).clamp(1.1, 2.0),
                // Close to the straight line through both, and never stuck at either.
                Some((far, more)) => {
                    let share = (1.96 - inside.1) / (more - inside.1);
                    inside.0 + (far - inside.0) * share.clamp(0.15, 0.85)
                }
            };
            if away > 3.0 {
                break;
            }
        }
        End { x0: best.x[0] + sense * inside.0.max(if outside.is_none() { away.min(3.0) } else { 0.0 }), better: None }
    }
}

/// Parameters with η and its rivals scaled by exp(x).
fn with(base: &Parameters, x: &DVector<f64>) -> Parameters {
    let mut p = *base;
    p.force_factor_n_v *= x[0].exp();
    for (name, x) in RIVALS.iter().zip(x.iter().skip(1)) {
        let k = x.exp();
        match *name {
            "stator" => {
                p.modal_mass_kg *= k;
                p.modal_damping_ns_m *= k;
                p.modal_stiffness_n_m *= k;
            }
            "Vrms" => p.vrms_v *= k,
            "f" => p.frequency_hz *= k,
            "Rr" => p.radial_shape *= k,
            "Fext" => p.preload_n *= k,
            "u" => p.friction *= k,
            "uoff" => p.off_friction *= k,
            "Ctheta" => p.rotational_damping_nms *= k,
            _ => p.contact_stiffness_n_m2 *= k,
        }
    }
    p
}

fn prior(motor: &Motor, flavour: Flavour, name: &str) -> f64 {
    let key = if name == "stator" { "Ms" } else { name };
    let entry = motor.entry(flavour, key);
    let stated = entry.and_then(|e| Some((e.uncertainty? / e.value).abs())).filter(|r| r.is_finite() && *r > 0.0);
    // Beyond a factor of e either way a logarithm's prior says nothing any more.
    stated.unwrap_or(if name == "f" { DEFAULT_PRIOR_F } else { DEFAULT_PRIOR }).min(1.0)
}

/// Speed and lag of a run, from its window after the run-up.
fn observe(run: &Run, edges_per_rev: u32) -> Option<Observed> {
    if run.kind != RunKind::Speed {
        return None;
    }
    let (duty, sense) = (run.duty?, run.direction?);
    let (start, end) = run.span_us();
    let end_s = run.drive_on_s.unwrap_or(f64::INFINITY).min(end * 1e-6);
    let begin_s = RUN_UP_S.max(start * 1e-6);
    if end_s - begin_s < 0.3 {
        return None;
    }
    let pitch = TAU / f64::from(edges_per_rev);
    let edge_times: Vec<f64> = match &run.data {
        RunData::Edges { edges, .. } => edges.iter().map(|e| e.time_us * 1e-6).collect(),
        RunData::Levels { start_us, period_us, levels } => levels
            .windows(2)
            .enumerate()
            .filter(|(_, w)| w[0] != w[1])
            // The edge lies between two samples.
            .map(|(i, _)| (start_us + (i as f64 + 0.5) * period_us) * 1e-6)
            .collect(),
        RunData::Velocity { time_us, rpm } => {
            return Some(from_velocity(run, duty, sense, time_us, rpm, begin_s, end_s));
        }
        _ => return None,
    };
    let inside: Vec<usize> = (0..edge_times.len()).filter(|&i| (begin_s..end_s).contains(&edge_times[i])).collect();
    let observed = |rpm: f64, sigma_rpm: f64, lag| Observed {
        id: run.id.clone(),
        duty,
        sign: sense.sign(),
        load_nm: 0.0,
        pwm_hz: run.pwm_hz,
        pwm_phase_s: run.pwm_phase_s,
        rpm,
        sigma_rpm,
        lag,
    };
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else {
        return Some(observed(0.0, 60.0 / TAU * pitch / (end_s - begin_s), None));
    };
    let Some((speed, intercept)) = line(&edge_times, first, last, pitch) else {
        return Some(observed(0.0, 60.0 / TAU * pitch / (end_s - begin_s), None));
    };
    let resolution = match &run.data {
        RunData::Levels { period_us, .. } => period_us * 1e-6 / 12f64.sqrt(),
        _ => 1e-5,
    };
    // Aligned, the encoder stands at the beginning of a pulse and the first edge comes a pitch later; otherwise anywhere
    // within one.
    let (ahead, phase) = if run.aligned { (1.0, 0.0) } else { (0.5, 1.0 / 12f64.sqrt()) };
    let lag = intercept - ahead * pitch / speed;
    let sigma_lag = (phase * pitch / speed).hypot(resolution).max(5e-4);
    let span = edge_times[last] - edge_times[first];
    let starts = start <= 0.0;
    Some(observed(
        speed * 60.0 / TAU,
        speed * 60.0 / TAU * resolution * 2f64.sqrt() / span,
        starts.then_some((lag, sigma_lag)),
    ))
}

/// Straight line of time over angle through the edges `first..=last`: the speed (rad/s) and the time at which edge 0 would
/// have come at that speed (s). All edges take part, so that PWM ripple and uneven edges average out.
fn line(edge_times: &[f64], first: usize, last: usize, pitch: f64) -> Option<(f64, f64)> {
    let n = (last + 1).saturating_sub(first) as f64;
    if n < 4.0 {
        return None;
    }
    let (mk, mt) = ((first + last) as f64 / 2.0, edge_times[first..=last].iter().sum::<f64>() / n);
    let (mut skk, mut skt) = (0.0, 0.0);
    for (i, t) in edge_times[first..=last].iter().enumerate() {
        let k = (first + i) as f64 - mk;
        skk += k * k;
        skt += k * (t - mt);
    }
    let second_an_edge = skt / skk;
    (second_an_edge > 0.0).then(|| (pitch / second_an_edge, mt - mk * second_an_edge))
}

fn from_velocity(
    run: &Run,
    duty: f64,
    sense: Sense,
    time_us: &[f64],
    rpm: &[f64],
    begin_s: f64,
    end_s: f64,
) -> Observed {
    let window: Vec<f64> = time_us
        .iter()
        .zip(rpm)
        .filter(|(t, v)| (begin_s..end_s).contains(&(*t * 1e-6)) && v.is_finite())
        .map(|(_, v)| v.abs())
        .collect();
    let n = window.len().max(1) as f64;
    let mean = window.iter().sum::<f64>() / n;
    let spread = (window.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    // A smoothed velocity's samples are not independent: some fifty milliseconds are one.
    let independent = ((end_s - begin_s) / 0.05).max(1.0);
    let lost: f64 = time_us
        .windows(2)
        .zip(rpm)
        .filter(|(t, v)| t[1] * 1e-6 < begin_s && v.is_finite())
        .map(|(t, v)| (1.0 - v.abs() / mean) * (t[1] - t[0]) * 1e-6)
        .sum();
    let starts = time_us.first().is_some_and(|t| *t < 20_000.0) && mean > 0.0;
    Observed {
        id: run.id.clone(),
        duty,
        sign: sense.sign(),
        load_nm: 0.0,
        pwm_hz: run.pwm_hz,
        pwm_phase_s: run.pwm_phase_s,
        rpm: mean,
        sigma_rpm: spread / independent.sqrt(),
        lag: starts.then_some((lost, 5e-3)),
    }
}

/// Runs of the same duty show how far a run repeats; where none do, 1 % is assumed.
fn scatter(observed: &mut [Observed]) {
    let mut sum = 0.0;
    let mut freedom = 0.0;
    for (i, o) in observed.iter().enumerate() {
        let same: Vec<f64> =
            observed.iter().filter(|p| p.duty == o.duty && p.sign == o.sign && o.rpm > 0.0).map(|p| p.rpm).collect();
        let first = observed.iter().position(|p| p.duty == o.duty && p.sign == o.sign) == Some(i);
        if first && same.len() > 1 {
            let mean = same.iter().sum::<f64>() / same.len() as f64;
            sum += same.iter().map(|v| (v / mean - 1.0).powi(2)).sum::<f64>();
            freedom += same.len() as f64 - 1.0;
        }
    }
    let relative = if freedom > 0.0 { (sum / freedom).sqrt() } else { 0.01 };
    for o in observed {
        o.sigma_rpm = o.sigma_rpm.hypot(relative * o.rpm).max(1e-3);
    }
}

fn targets(observed: &[Observed], stall_nm: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let speeds = observed.iter().map(|o| (o.rpm, o.sigma_rpm));
    let lags = observed.iter().filter_map(|o| o.lag);
    let stalls = stall_nm.iter().map(|t| (*t, TORQUE_RELATIVE * t));
    speeds.chain(lags).chain(stalls).unzip()
}

/// Most torque the contact transmits to a rotor at rest (N·m), of either flavour.
fn stall(parameters: &Parameters) -> f64 {
    parameters.friction * parameters.preload_n * parameters.contact_radius_m
}

/// Model speeds, then lags, then stall torques, in the order of [`targets`]. Runs alike are simulated once.
fn predictions(observed: &[Observed], stalls: usize, parameters: &Parameters, flavour: Flavour) -> DVector<f64> {
    let key = |o: &Observed| [o.duty, o.load_nm, o.pwm_hz, o.pwm_phase_s].map(f64::to_bits);
    let mut distinct: Vec<&Observed> = Vec::new();
    for o in observed {
        if !distinct.iter().any(|d| key(d) == key(o)) {
            distinct.push(o);
        }
    }
    let results: Vec<(f64, f64)> = distinct.par_iter().map(|o| steady(o, parameters, flavour)).collect();
    let of = |o: &Observed| distinct.iter().position(|d| key(d) == key(o)).map_or((0.0, 0.0), |i| results[i]);
    let speeds = observed.iter().map(|o| of(o).0);
    let lags = observed.iter().filter(|o| o.lag.is_some()).map(|o| of(o).1);
    let stalls = std::iter::repeat_n(stall(parameters), stalls);
    DVector::from_vec(speeds.chain(lags).chain(stalls).collect())
}

/// Steady speed (rpm) and start-up lag (s) of the model: it is symmetric, so every run turns clockwise here.
fn steady(o: &Observed, parameters: &Parameters, flavour: Flavour) -> (f64, f64) {
    let mut parameters = *parameters;
    parameters.load_nm += o.load_nm;
    let model = PlantModel::Motor { parameters, flavour, solver: Solver::Averaged };
    let mut program = Program::constant(o.duty, Direction::Cw, 3.0 * RUN_UP_S, 2.0 * RUN_UP_S);
    (program.pwm_hz, program.pwm_phase_s) = (o.pwm_hz, o.pwm_phase_s);
    // The same line through edges as for the data, so fine that it changes smoothly with the parameters.
    program.edges_per_rev = FINE_EDGES;
    let trace = simulate(&program, &model, &EffectSet::default(), History::default());
    let times: Vec<f64> = trace.edges.iter().map(|e| e.time_s).collect();
    let pitch = TAU / f64::from(FINE_EDGES);
    let first = times.partition_point(|t| *t < RUN_UP_S);
    match times.len().checked_sub(1).and_then(|last| line(&times, first, last, pitch)) {
        Some((speed, intercept)) => (speed * 60.0 / TAU, intercept - pitch / speed),
        None => (0.0, 0.0),
    }
}

/// The best force factor of a coarse scan, everything else as in the motor file.
fn start(
    observed: &[Observed],
    base: &Parameters,
    flavour: Flavour,
    data: &[f64],
    sigma: &[f64],
) -> Result<DVector<f64>, ForceFactorError> {
    let mut best = (f64::INFINITY, 0.0);
    let mut turns = false;
    for i in -12..=12 {
        let mut x = DVector::zeros(1 + RIVALS.len());
        x[0] = f64::from(i) * 0.15;
        let y = predictions(observed, 0, &with(base, &x), flavour);
        turns |= y.iter().take(observed.len()).any(|v| *v > 0.5);
        let n = observed.len();
        let cost: f64 = (0..n).map(|i| ((data[i] - y[i]) / sigma[i].max(0.02 * data[i].abs())).powi(2)).sum();
        if cost < best.0 {
            best = (cost, x[0]);
        }
    }
    if !turns {
        return Err(ForceFactorError::Stuck { largest: base.force_factor_n_v * 1.8f64.exp() });
    }
    let mut x = DVector::zeros(1 + RIVALS.len());
    x[0] = best.1;
    Ok(x)
}

fn slopes(x: &DVector<f64>, predict: &impl Fn(&DVector<f64>) -> DVector<f64>) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..x.len())
        .map(|j| {
            // The drive's frequency acts through a resonance a few per cent wide.
            let h = if j > 0 && RIVALS[j - 1] == "f" { 5e-4 } else { 1e-2 };
            let at = |h: f64| {
                let mut x = x.clone();
                x[j] += h;
                predict(&x)
            };
            (at(h) - at(-h)) / (2.0 * h)
        })
        .collect();
    DMatrix::from_columns(&columns)
}

fn penalty(x: &DVector<f64>, priors: &[f64]) -> f64 {
    x.iter().skip(1).zip(priors).map(|(x, s)| (x / s).powi(2)).sum()
}

/// Residual over scatter, at least 1.
fn excess(data: &[f64], y: &DVector<f64>, sigma: &[f64]) -> f64 {
    let chi2: f64 = data.iter().zip(y.iter()).zip(sigma).map(|((d, y), s)| ((d - y) / s).powi(2)).sum();
    (chi2 / data.len().saturating_sub(1).max(1) as f64).sqrt().max(1.0)
}

fn normal_equations(
    jacobian: &DMatrix<f64>,
    data: &[f64],
    y: &DVector<f64>,
    sigma: &[f64],
    x: &DVector<f64>,
    priors: &[f64],
    misfit: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let scaled = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |i, j| jacobian[(i, j)] / (sigma[i] * misfit));
    let residual = DVector::from_fn(data.len(), |i, _| (data[i] - y[i]) / (sigma[i] * misfit));
    let mut normal = scaled.tr_mul(&scaled);
    let mut gradient = scaled.tr_mul(&residual);
    for (j, s) in priors.iter().enumerate() {
        normal[(j + 1, j + 1)] += 1.0 / (s * s);
        gradient[j + 1] -= x[j + 1] / (s * s);
    }
    (normal, gradient)
}

#[expect(clippy::too_many_arguments, reason = "it only gathers what the fit found")]
fn report(
    measurement: &Measurement,
    motor: &Motor,
    flavour: Flavour,
    base: &Parameters,
    observed: &[Observed],
    stall_nm: &[f64],
    x: &DVector<f64>,
    y: &DVector<f64>,
    jacobian: &DMatrix<f64>,
    sigma: &[f64],
    priors: &[f64],
    covariance: &DMatrix<f64>,
    ends: [f64; 2],
    alone: f64,
    misfit: f64,
) -> Report {
    let eta = base.force_factor_n_v * x[0].exp();
    let around = |sd: f64| [eta * (-1.96 * sd).exp(), eta * (1.96 * sd).exp()];
    let sd = covariance[(0, 0)].sqrt();
    let dot = |a: usize, b: usize| {
        (0..jacobian.nrows()).map(|i| jacobian[(i, a)] * jacobian[(i, b)] / sigma[i].powi(2)).sum::<f64>()
    };
    let mut trades: Vec<Trade> = RIVALS
        .iter()
        .enumerate()
        .map(|(j, name)| {
            let posterior = covariance[(j + 1, j + 1)].sqrt();
            Trade {
                with: (*name).to_owned(),
                correlation: covariance[(0, j + 1)] / (sd * posterior),
                exchange: -dot(0, j + 1) / dot(0, 0),
                prior_relative: priors[j],
                posterior_relative: posterior,
                ratio: x[j + 1].exp(),
            }
        })
        .collect();
    // By how far what is not known of the parameter moves η.
    let reach = |t: &Trade| (t.exchange * t.prior_relative).abs();
    trades.sort_by(|a, b| reach(b).total_cmp(&reach(a)));
    let mut lag = observed.len();
    let runs: Vec<RunResult> = observed
        .iter()
        .enumerate()
        .map(|(i, o)| {
            let model_lag_s = o.lag.map(|_| {
                lag += 1;
                y[lag - 1]
            });
            RunResult {
                id: o.id.clone(),
                duty: o.duty,
                load_nm: o.load_nm,
                rpm: o.sign * o.rpm,
                model_rpm: o.sign * y[i],
                lag_s: o.lag.map(|l| l.0),
                model_lag_s,
            }
        })
        .collect();
    let mean = observed.iter().map(|o| o.rpm).sum::<f64>() / observed.len() as f64;
    let total: f64 = observed.iter().map(|o| (o.rpm - mean).powi(2)).sum();
    let left: f64 = observed.iter().zip(y.iter()).map(|(o, y)| (o.rpm - y).powi(2)).sum();
    let mut duties: Vec<f64> = observed.iter().map(|o| o.duty).collect();
    duties.sort_by(f64::total_cmp);
    duties.dedup();
    let mut notes = Vec::new();
    let named: Vec<String> = trades
        .iter()
        .filter(|t| reach(t) > 0.02 && t.posterior_relative > 0.5 * t.prior_relative)
        .map(|t| format!("{} ({:+.2} % of eta for 1 % of it)", t.with, t.exchange))
        .collect();
    if !named.is_empty() {
        notes.push(format!(
            "these data do not separate eta from {}: the interval is as wide as what is known of them",
            named.join(", ")
        ));
    }
    if misfit > 2.0 {
        notes.push(format!(
            "the model misses the data by {misfit:.1} times their scatter: the interval is widened, but a model error may shift \
             eta as well; `twum diagnose` looks for its cause"
        ));
    }
    if duties.len() < 3 {
        notes.push(format!("{} duty only: speeds at three or more say more than one", duties.len()));
    }
    if observed.iter().all(|o| o.lag.is_none()) {
        notes.push("no run begins at its start: start-up, which tells torque from speed, was not used".to_owned());
    }
    if observed.iter().all(|o| o.load_nm == 0.0) && stall_nm.is_empty() {
        notes.push(
            "no loaded run and no stall torque: `--loaded DUTY:NM:RPM` or `--torque-runs FILE` would bound the torque"
                .to_owned(),
        );
    }
    Report {
        schema: 1,
        source: measurement.folder.display().to_string(),
        motor: motor.name.clone(),
        flavour,
        eta_n_v: eta,
        ci95: ends.map(|x0| base.force_factor_n_v * x0.exp()),
        ci95_others_exact: around(alone),
        trades,
        runs,
        stall_nm: stall(&with(base, x)),
        stall_measured_nm: stall_nm.to_vec(),
        r2_speed: (duties.len() >= 3 && total > 0.0).then(|| 1.0 - left / total),
        misfit,
        notes,
    }
}
