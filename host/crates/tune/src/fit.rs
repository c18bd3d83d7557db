//! What short runs say of the motor, and how surely: its speed, the difference of its directions, its braking without a wave, and
//! the duty below which nothing moves. The rest of the motor file stays as it is.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;
use serde::ser::{SerializeStruct, Serializer};
use thiserror::Error;
use twum_fit::least_squares::{Point, Search};
use twum_identify::force_factor::observe::{Observed, RUN_UP_S, observe, scatter};
use twum_motor::actuator::Pwm;
use twum_motor::effects::{EffectError, EffectSet};
use twum_motor::motor::Motor;
use twum_motor::motor_plant::{History, MotorPlant, Solver};
use twum_motor::parameters::{Flavour, ParameterError, Parameters};
use twum_motor::plant::{Direction, Plant};
use twum_motor::robust::{Drawn, add_nuisance, stream};
use twum_motor::uncertainty::Band;
use twum_record::measurement::Measurement;

use super::plan::SECONDS;

/// Readings of the model that are tried: a rotor that brakes partly, and one that the drive's end clamps.
const FLAVOURS: [Flavour; 2] = [Flavour::Measured, Flavour::Physical];
/// A reading is kept beside the better one while its squared distance is less than this above: a likelihood ratio of 1 to 20.
const KEPT_WITHIN: f64 = 6.0;
/// What is known before the runs, as standard deviations: the difference of the directions (1), the logarithm of the braking
/// (a factor of 3), the duty that is lost (1).
const PRIORS: [f64; 3] = [0.15, 1.1, 0.02];
/// Steps of the finite differences: logarithm of the speed, and as [`PRIORS`].
const STEPS: [f64; 4] = [0.01, 0.01, 0.05, 0.004];
/// A draw is of a motor that agrees with the runs while its squared distance lies less than this above the best: 99 % of chi-square with
/// as many degrees as parameters.
const AGREES_WITHIN: f64 = 13.3;
/// Draws in which one has to agree; a reading whose draws do not is taken at its best.
const TRIES: usize = 60;
/// Where the search for the lost duty starts: inside its bounds, so that it has a slope both ways.
const LOST_DUTY: f64 = 0.015;
/// Motors with everything else that a bench may have, on which the scatter of a speed is seen.
const SCATTER_DRAWS: u64 = 24;
/// Motors drawn for the intervals.
const INTERVAL_DRAWS: u64 = 100;
/// A rotor with fewer turns a minute than this under full drive did not move: a tenth of the slowest that any command takes for turning.
const STANDS_RPM: f64 = 0.5;

/// Why nothing can be said of the motor.
#[derive(Debug, Error)]
pub enum FitError {
    /// No run to go by.
    #[error(
        "{0}: no run at constant duty with at least 0.8 s of drive; `twum tune --port PORT --out FOLDER` makes some"
    )]
    NoRuns(String),
    /// Nothing turned.
    #[error(
        "the motor did not move in any of the {0} runs: nothing can be designed for it. Is the supply on, the rotor pressed on, \
         the encoder lit?"
    )]
    Stands(usize),
    /// One direction is missing.
    #[error(
        "the motor moved {moved} only; {missing}. A controller drives both ways, and the two differ: make runs {other} too"
    )]
    OneDirection {
        /// The direction that is there.
        moved: &'static str,
        /// What is wrong with the other.
        missing: &'static str,
        /// The other.
        other: &'static str,
    },
    /// The model cannot be had at some parameters.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// Nor with some effects.
    #[error(transparent)]
    Effects(#[from] EffectError),
}

/// One run against the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedRun {
    /// Run.
    pub id: String,
    /// Duty.
    pub duty: f64,
    /// PWM frequency (Hz).
    pub pwm_hz: f64,
    /// Steady speed, counter-clockwise negative (rpm).
    pub rpm: f64,
    /// Its standard deviation, with what else a bench may have (rpm).
    pub sigma_rpm: f64,
    /// The fitted model's (rpm).
    pub model_rpm: f64,
}

/// One reading of the model, fitted.
#[derive(Debug, Clone)]
struct Fit {
    speeds: Speeds,
    point: Point,
    /// Root of the covariance.
    root: DMatrix<f64>,
    cost: f64,
}

/// What the runs say.
#[derive(Debug, Clone, Serialize)]
pub struct Identified {
    /// The reading that agrees best.
    pub flavour: Flavour,
    /// Readings that agree, the best first, with their share of the motors drawn.
    pub readings: Vec<(Flavour, f64)>,
    /// Speed at full drive, clockwise (rpm).
    #[serde(serialize_with = "as_value")]
    pub full_cw_rpm: Band,
    /// Counter-clockwise (rpm).
    #[serde(serialize_with = "as_value")]
    pub full_ccw_rpm: Band,
    /// Torque that brakes the rotor with the drive off (N·m).
    #[serde(serialize_with = "as_value")]
    pub braking_nm: Band,
    /// Duty below which nothing moves (1).
    #[serde(serialize_with = "as_value")]
    pub dead_zone: Band,
    /// Factor by which the model misses the speeds beyond their scatter; 1 is none.
    pub misfit: f64,
    /// Each run.
    pub runs: Vec<FittedRun>,
    /// Edges a revolution.
    pub edges_per_rev: u32,
    /// What a reader should know.
    pub notes: Vec<String>,
    #[serde(skip)]
    fits: Vec<Fit>,
}

/// A band as the JSON of `twum tune` has always had it: its median is `value`.
fn as_value<S: Serializer>(band: &Band, to: S) -> Result<S::Ok, S::Error> {
    let mut told = to.serialize_struct("Band", 2)?;
    told.serialize_field("value", &band.median)?;
    told.serialize_field("ci95", &band.ci95)?;
    told.end()
}

/// A speed to be had: duty, PWM frequency, sense.
type Asked = (f64, f64, f64);

/// Fits the motor to the runs at constant duty of a measurement.
///
/// # Errors
/// When there are none, or nothing moved, or one direction only; and when the motor file leaves the model's bounds.
pub fn identify(measurement: &Measurement, motor: &Motor, seed: u64) -> Result<Identified, FitError> {
    let mut observed: Vec<Observed> =
        measurement.runs.iter().filter_map(|run| observe(run, measurement.edges_per_rev)).collect();
    refuse(&observed, measurement)?;
    scatter(&mut observed);
    let asked: Vec<Asked> = observed.iter().map(|o| (o.duty, o.pwm_hz, o.sign)).collect();
    let mut fits = Vec::new();
    let mut runs = Vec::new();
    for flavour in FLAVOURS {
        let sigma = widened(&observed, &asked, motor, flavour, seed)?;
        let speeds = Speeds {
            flavour,
            base: motor.parameters(flavour),
            effects: motor.effects(),
            asked: asked.clone(),
            rpm: observed.iter().map(|o| o.rpm).collect(),
            sigma: sigma.clone(),
        };
        let fit = speeds.fitted();
        let told = observed.iter().zip(&sigma).zip(fit.point.y.iter()).map(|((o, sigma_rpm), model)| FittedRun {
            id: o.id.clone(),
            duty: o.duty,
            pwm_hz: o.pwm_hz,
            rpm: o.sign * o.rpm,
            sigma_rpm: *sigma_rpm,
            model_rpm: o.sign * model,
        });
        if fits.iter().all(|other: &Fit| fit.cost < other.cost) {
            runs = told.collect();
        }
        fits.push(fit);
    }
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let least = fits[0].cost;
    fits.retain(|fit| fit.cost - least < KEPT_WITHIN);
    let mut identified = Identified {
        flavour: fits[0].speeds.flavour,
        readings: shares(&fits),
        full_cw_rpm: Band::of(Vec::new()),
        full_ccw_rpm: Band::of(Vec::new()),
        braking_nm: Band::of(Vec::new()),
        dead_zone: Band::of(Vec::new()),
        misfit: fits[0].point.misfit,
        notes: notes(&fits[0], &observed),
        runs,
        edges_per_rev: measurement.edges_per_rev,
        fits,
    };
    identified.tell(seed)?;
    Ok(identified)
}

fn refuse(observed: &[Observed], measurement: &Measurement) -> Result<(), FitError> {
    if observed.is_empty() {
        return Err(FitError::NoRuns(measurement.folder.display().to_string()));
    }
    let moved = |sign: f64| observed.iter().any(|o| o.sign == sign && o.rpm > STANDS_RPM);
    let (moved, other, sign) = match (moved(1.0), moved(-1.0)) {
        (true, true) => return Ok(()),
        (false, false) => return Err(FitError::Stands(observed.len())),
        (true, false) => ("clockwise", "counter-clockwise", -1.0),
        (false, true) => ("counter-clockwise", "clockwise", 1.0),
    };
    let tried = observed.iter().any(|o| o.sign == sign);
    let missing = if tried { "in the runs the other way it stood" } else { "there are no runs the other way" };
    Err(FitError::OneDirection { moved, missing, other })
}

/// The motor and its effects at a point of the search.
fn at(base: &Parameters, effects: &EffectSet, x: &DVector<f64>) -> Result<(Parameters, EffectSet), FitError> {
    let mut parameters = *base;
    // The stator's surface, which carries the rotor, moves in proportion to its half thickness.
    parameters.half_thickness_m *= x[0].exp();
    parameters.off_friction = (parameters.off_friction * x[2].exp()).min(2.0);
    let mut effects = effects.clone();
    effects.set("direction-asymmetry", &[x[1].clamp(-0.5, 0.5), 0.0])?;
    effects.set("dead-zone", &[(LOST_DUTY + x[3]).clamp(0.0, 0.6)])?;
    Ok((parameters.check()?, effects))
}

/// Mean speed of the model between two times (rpm), without sign.
fn mean_rpm(motor: &Drawn, (duty, pwm_hz, sign): Asked, until_s: f64) -> f64 {
    let mut plant =
        MotorPlant::new(motor.parameters, motor.flavour, Solver::Averaged, &motor.effects, History::default());
    let mut pwm = Pwm::new(pwm_hz, 0.0, &motor.effects);
    pwm.begin(duty, if sign > 0.0 { Direction::Cw } else { Direction::Ccw });
    pwm.advance(&mut plant, RUN_UP_S, &mut |_| ());
    let from_rad = plant.position_rad();
    pwm.advance(&mut plant, until_s, &mut |_| ());
    sign * (plant.position_rad() - from_rad) / (until_s - RUN_UP_S) * 60.0 / std::f64::consts::TAU
}

/// The scatter of each speed, with what a bench may have besides and the runs do not tell.
fn widened(
    observed: &[Observed],
    asked: &[Asked],
    motor: &Motor,
    flavour: Flavour,
    seed: u64,
) -> Result<Vec<f64>, FitError> {
    let drawn = (0..SCATTER_DRAWS)
        .map(|index| {
            let mut effects = motor.effects();
            add_nuisance(&mut stream(seed, index), &mut effects)?;
            // These two are fitted.
            effects.remove("dead-zone");
            effects.remove("direction-asymmetry");
            Ok(Drawn { flavour, parameters: motor.parameters(flavour), effects })
        })
        .collect::<Result<Vec<_>, FitError>>()?;
    let mut known: Vec<(Asked, f64)> = Vec::new();
    for asked in asked {
        if known.iter().all(|(other, _)| other != asked) {
            let rpm: Vec<f64> = drawn.par_iter().map(|motor| mean_rpm(motor, *asked, SECONDS)).collect();
            let mean = rpm.iter().sum::<f64>() / rpm.len() as f64;
            let square = rpm.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (rpm.len() - 1) as f64;
            known.push((*asked, if mean > 0.0 { square.sqrt() / mean } else { 0.0 }));
        }
    }
    let relative = |asked: &Asked| known.iter().find(|(other, _)| other == asked).map_or(0.0, |(_, share)| *share);
    Ok(observed.iter().zip(asked).map(|(o, asked)| o.sigma_rpm.hypot(relative(asked) * o.rpm)).collect())
}

/// The speeds that were measured, and how a reading of the model makes them.
#[derive(Debug, Clone)]
struct Speeds {
    flavour: Flavour,
    base: Parameters,
    effects: EffectSet,
    asked: Vec<Asked>,
    rpm: Vec<f64>,
    sigma: Vec<f64>,
}

impl Speeds {
    fn at(&self, x: &DVector<f64>) -> Result<Drawn, FitError> {
        let (parameters, effects) = at(&self.base, &self.effects, x)?;
        Ok(Drawn { flavour: self.flavour, parameters, effects })
    }

    /// The model's speeds. A point outside of its bounds is as far from every speed as a motor that stands.
    fn predicted(&self, x: &DVector<f64>) -> DVector<f64> {
        let Ok(motor) = self.at(x) else { return DVector::zeros(self.asked.len()) };
        let mut distinct = self.asked.clone();
        distinct.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        distinct.dedup();
        let rpm: Vec<f64> = distinct.par_iter().map(|asked| mean_rpm(&motor, *asked, 2.0 * RUN_UP_S)).collect();
        let of = |asked: &Asked| distinct.iter().position(|other| other == asked).map_or(0.0, |i| rpm[i]);
        DVector::from_iterator(self.asked.len(), self.asked.iter().map(of))
    }

    /// Whether a motor turns as the real one did: each speed within three standard deviations.
    fn may_be(&self, motor: &Drawn) -> bool {
        let near = |((asked, rpm), sigma): ((&Asked, &f64), &f64)| {
            (mean_rpm(motor, *asked, 2.0 * RUN_UP_S) - rpm).abs() < 3.0 * sigma
        };
        self.asked.iter().zip(&self.rpm).zip(&self.sigma).all(near)
    }

    /// Squared distance from the runs and from what was known before.
    fn cost(&self, x: &DVector<f64>, y: &DVector<f64>) -> f64 {
        let off: f64 = self.rpm.iter().zip(y.iter()).zip(&self.sigma).map(|((d, y), s)| ((d - y) / s).powi(2)).sum();
        let away: f64 = x.iter().skip(1).zip(PRIORS).map(|(x, s)| (x / s).powi(2)).sum();
        off + away
    }

    fn fitted(self) -> Fit {
        let predict = |x: &DVector<f64>| self.predicted(x);
        let mut start = DVector::zeros(STEPS.len());
        // The speed alone first: a search from half the speed would end in another valley.
        let ratio = self.rpm.iter().sum::<f64>() / predict(&start).iter().sum::<f64>().max(1e-9);
        start[0] = ratio.clamp(0.05, 20.0).ln();
        let search = Search { data: &self.rpm, sigma: &self.sigma, priors: &PRIORS, steps: &STEPS, predict: &predict };
        let point = search.settle(start, false, None);
        let (normal, _) = search.normal_equations(&point);
        let size = STEPS.len();
        let covariance = normal.try_inverse().unwrap_or_else(|| DMatrix::identity(size, size));
        let root = covariance.cholesky().map_or_else(|| DMatrix::zeros(size, size), |c| c.l());
        let cost = self.cost(&point.x, &point.y);
        Fit { speeds: self, point, root, cost }
    }
}

impl Fit {
    /// A motor that agrees with the runs: a draw of the covariance, where the model bends too much to follow it drawn again.
    fn agreeing(&self, rng: &mut ChaCha8Rng) -> Result<Drawn, FitError> {
        let within = AGREES_WITHIN * self.point.misfit.powi(2);
        for _ in 0..TRIES {
            let normal = DVector::from_fn(STEPS.len(), |_, _| StandardNormal.sample(rng));
            let x = &self.point.x + &self.root * normal;
            if self.speeds.cost(&x, &self.speeds.predicted(&x)) - self.cost < within
                && let Ok(motor) = self.speeds.at(&x)
            {
                return Ok(motor);
            }
        }
        self.speeds.at(&self.point.x)
    }
}

/// Likelihoods of the readings that were kept.
fn shares(fits: &[Fit]) -> Vec<(Flavour, f64)> {
    let weight = |fit: &Fit| (-0.5 * (fit.cost - fits[0].cost)).exp();
    let all: f64 = fits.iter().map(weight).sum();
    fits.iter().map(|fit| (fit.speeds.flavour, weight(fit) / all)).collect()
}

fn notes(best: &Fit, observed: &[Observed]) -> Vec<String> {
    let mut notes = Vec::new();
    let mut duties: Vec<(f64, f64)> = observed.iter().map(|o| (o.duty, o.pwm_hz)).collect();
    duties.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    duties.dedup();
    if duties.len() < 3 {
        notes.push(format!(
            "the runs are of {} duty and PWM frequency: braking and dead zone are as the motor file has them, no surer",
            if duties.len() == 1 { "one".to_owned() } else { format!("{} kinds of", duties.len()) }
        ));
    }
    if best.point.misfit > 2.0 {
        notes.push(format!(
            "the model misses the speeds by {:.1} times their scatter: the intervals are widened; `twum diagnose` looks for the cause",
            best.point.misfit
        ));
    }
    notes
}

impl Identified {
    /// A motor that agrees with the runs.
    fn agreeing(&self, rng: &mut ChaCha8Rng) -> Result<(&Speeds, Drawn), FitError> {
        let mut share = rng.random_range(0.0..1.0);
        let chosen = self.readings.iter().position(|(_, weight)| {
            share -= weight;
            share < 0.0
        });
        let fit = &self.fits[chosen.unwrap_or(0)];
        Ok((&fit.speeds, fit.agreeing(rng)?))
    }

    /// The `index`th motor that agrees with the runs, with what else a bench may have.
    ///
    /// # Errors
    /// When the model cannot be had there.
    pub fn draw(&self, seed: u64, index: u64) -> Result<Drawn, FitError> {
        let mut rng = stream(seed, index);
        let mut tries = 1..=TRIES;
        loop {
            let (speeds, mut motor) = self.agreeing(&mut rng)?;
            let (dead_zone, asymmetry) = (motor.effects.dead_zone, motor.effects.direction_asymmetry);
            add_nuisance(&mut rng, &mut motor.effects)?;
            (motor.effects.dead_zone, motor.effects.direction_asymmetry) = (dead_zone, asymmetry);
            // What a bench may have besides must not make another motor of it: one that stands where the real one turned, say.
            if tries.next().is_none() || speeds.may_be(&motor) {
                return Ok(motor);
            }
        }
    }

    /// The motor that agrees best.
    ///
    /// # Errors
    /// When the model cannot be had there.
    pub fn best(&self) -> Result<Drawn, FitError> {
        self.fits[0].speeds.at(&self.fits[0].point.x)
    }

    /// The motor file as identified, in the reading that agrees best. What the runs say of the others lies in the speed: only what
    /// was fitted keeps an uncertainty.
    pub fn motor(&self, from: &Motor, source: &str) -> Motor {
        let fit = &self.fits[0];
        let mut motor = from.clone();
        let entries = [&mut motor.parameters, &mut motor.physical, &mut motor.measured];
        entries.into_iter().flat_map(|table| table.values_mut()).for_each(|entry| entry.uncertainty = None);
        motor.title = format!("{} (identified in the reading `{}`)", motor.title, fit.speeds.flavour);
        let sd = |k: usize| fit.root.row(k).norm();
        let mut put = |name: &str, k: usize| {
            let own = match fit.speeds.flavour {
                Flavour::Thesis => None,
                Flavour::Physical => motor.physical.get_mut(name),
                Flavour::Measured => motor.measured.get_mut(name),
            };
            if let Some(entry) = own.or_else(|| motor.parameters.get_mut(name)) {
                entry.value *= fit.point.x[k].exp();
                entry.uncertainty = Some(entry.value * sd(k));
                source.clone_into(&mut entry.source);
            }
        };
        put("h", 0);
        put("uoff", 2);
        let best = [
            ("direction-asymmetry", "gain", fit.point.x[1]),
            ("dead-zone", "threshold_duty", LOST_DUTY + fit.point.x[3]),
        ];
        for (effect, parameter, value) in best {
            let value = value.clamp(if parameter == "gain" { -0.5 } else { 0.0 }, 0.5);
            motor.put_effect(effect, parameter, value);
        }
        motor
    }

    /// Intervals, from motors that agree.
    fn tell(&mut self, seed: u64) -> Result<(), FitError> {
        let motors = (0..INTERVAL_DRAWS)
            .map(|index| Ok(self.agreeing(&mut stream(seed, index))?.1))
            .collect::<Result<Vec<_>, FitError>>()?;
        let full = |sign: f64| -> Vec<f64> {
            motors.par_iter().map(|motor| mean_rpm(motor, (1.0, 50.0, sign), 2.0 * RUN_UP_S)).collect()
        };
        self.full_cw_rpm = Band::of(full(1.0));
        self.full_ccw_rpm = Band::of(full(-1.0));
        self.braking_nm =
            Band::of(motors.iter().map(|motor| motor.parameters.off_friction_nm(motor.flavour)).collect());
        let dead = |motor: &Drawn| motor.effects.dead_zone.map_or(0.0, |e| e.threshold_duty);
        self.dead_zone = Band::of(motors.iter().map(dead).collect());
        Ok(())
    }
}
