//! Controllers on motors of which not everything is known: the closed loop over many draws of what a bench may have.
//!
//! Each draw is one motor, the same for every controller, so that controllers are compared motor by motor. The loop is
//! [`super::closed_loop::run`]'s: the chip's own step, the PWM, the encoder and the model of every other command.

use super::closed_loop::{Hand, LoopProgram, Tick, following, run_pushed};
use super::effects::{EffectError, EffectSet};
use super::guidance::Guidance;
use super::motor::Motor;
use super::motor_plant::{History, MotorPlant, Solver};
use super::parameters::{Flavour, ParameterError, Parameters};
use super::sensor::Encoder;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::PI;
use thiserror::Error;
use twum_fit::quantile::quantiles;
use twum_shared::reference::Reference;
use twum_shared::safety::Limits;
use twum_shared::step::{Config, ConfigError};

/// How a rotor behaves with the drive off, by the flavour that has it so.
pub const ROTORS: [(&str, Flavour); 3] =
    [("clamped", Flavour::Physical), ("braking", Flavour::Measured), ("coasting", Flavour::Thesis)];

/// The speed is off by so much of itself, either way (1).
const SPEED: [f64; 2] = [0.15, 0.20];
/// Preload runout once a turn (1), at any angle.
const RUNOUT: [f64; 2] = [0.08, 0.16];
/// What the driver's frequency search leaves: up to the detuning that gives the real motor's start-up (docs/model.md), Hz and s.
const SETTLING: [[f64; 2]; 2] = [[-700.0, 0.0], [0.01, 0.05]];
/// Fall of the resonance once warm (Hz), and how soon (s).
const HEATING: [[f64; 2]; 2] = [[0.0, 200.0], [2.0, 20.0]];
/// How late the loop acts, µs.
const DELAY_US: [f64; 2] = [0.0, 1_500.0];
/// Duty below which nothing moves (1).
const DEAD_ZONE: [f64; 2] = [0.0, 0.03];
/// Half the difference of the two directions' drive (1).
const ASYMMETRY: [f64; 2] = [-0.1, 0.1];
/// Width of light over dark, in pitches: a tenth of what a disc may have, either way.
const UNEQUAL_EDGES: [f64; 2] = [-0.2, 0.2];
/// The disc is off centre (rad): up to 0.3°, a third of a count.
const ECCENTRICITY: [f64; 2] = [0.0, 0.005];

/// A controller under test.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// What it is called.
    pub name: String,
    /// The controller.
    pub config: Config,
    /// PWM frequency it is run with (Hz).
    pub pwm_hz: f64,
}

/// What is to be followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A sine.
    Sine {
        /// Its amplitude (counts).
        amplitude: i32,
        /// Its angular frequency (rad/s).
        omega_rad_s: f64,
    },
    /// Another place from the start on.
    Step(
        /// Where (counts).
        i32,
    ),
    /// A speed to the end.
    Ramp(
        /// The speed (counts/s).
        i32,
    ),
}

impl Target {
    fn reference(self) -> Reference {
        match self {
            Self::Sine { amplitude, omega_rad_s } => {
                Reference::Sine { amplitude, omega_urad_s: (omega_rad_s * 1e6).round() as u32 }
            }
            Self::Step(position) => Reference::Step { position, at_us: 0 },
            Self::Ramp(rate) => Reference::Ramp { rate, limit: FARTHEST_RAMP },
        }
    }

    /// Where the rotor should be, not cut to whole counts (counts).
    fn at(self, time_s: f64) -> f64 {
        match self {
            Self::Sine { amplitude, omega_rad_s } => f64::from(amplitude) * (omega_rad_s * time_s).sin(),
            Self::Step(position) => f64::from(position),
            Self::Ramp(rate) => f64::from(rate) * time_s,
        }
    }
}

/// Farther than any run goes (counts): what references may at most.
const FARTHEST_RAMP: u32 = 1 << 24;

/// What is asked.
#[derive(Debug, Clone, Copy)]
pub struct Study<'a> {
    /// The motor that the draws vary.
    pub motor: &'a Motor,
    /// What is to be followed.
    pub target: Target,
    /// Load against positive rotation, as a share of the stall torque (1).
    pub load: f64,
    /// A hand that pushes the rotor.
    pub hand: Option<Hand>,
    /// Length of a run (s).
    pub seconds: f64,
    /// Motors drawn.
    pub draws: u64,
    /// Seed of the draws.
    pub seed: u64,
}

/// One motor of the draws.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// The reading of the model.
    pub flavour: Flavour,
    /// Its parameters.
    pub parameters: Parameters,
    /// Its effects.
    pub effects: EffectSet,
}

/// One loop of one draw.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Outcome {
    /// Mean of |target − counted position| (deg): what a bench can measure.
    pub counted_deg: f64,
    /// Mean of |sine − true angle| (deg), with the sine not cut to whole counts.
    pub true_deg: f64,
    /// Counts by which the count ended off the edges that the disc has passed.
    pub miscount: i64,
    /// Whether the count was ever farther off its target than the board's following-error limit lets it.
    pub ran_away: bool,
    /// How the controller felt the hand.
    #[serde(skip)]
    pub guidance: Option<Guidance>,
}

/// Median and 90 % of something over the draws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Nine draws of ten lie below.
    pub p90: f64,
}

/// One controller on one kind of rotor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cell {
    /// The rotor, one of [`ROTORS`].
    pub rotor: &'static str,
    /// The controller.
    pub controller: String,
    /// Mean true error (deg).
    pub true_deg: Spread,
    /// Mean counted error (deg).
    pub counted_deg: Spread,
    /// Counts lost, without sign.
    pub miscount: Spread,
    /// Draws in which the board would have stopped the motor for its following error.
    pub ran_away: usize,
    /// How the hand was felt: share of the time in which it was believed to be there, median and what nine in ten stay below.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub believed: Option<Spread>,
    /// How far off what was believed was, mean amount of each draw that believed any (N·m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hand_error_nm: Option<Spread>,
    /// Every draw, in order.
    #[serde(skip)]
    pub outcomes: Vec<Outcome>,
}

/// Why there is no answer.
#[derive(Debug, Error)]
pub enum RobustError {
    /// The controller cannot run.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A drawn motor is outside what the model describes.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// A drawn effect is.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

/// Every controller on rotors of [`ROTORS`], over the same draws.
///
/// # Errors
/// When a controller cannot run, or the motor varies beyond what the model describes.
pub fn robust(
    study: &Study,
    candidates: &[Candidate],
    rotors: &[(&'static str, Flavour)],
) -> Result<Vec<Cell>, RobustError> {
    let mut cells = Vec::new();
    for &(rotor, flavour) in rotors {
        let drawn: Vec<_> = (0..study.draws).map(|i| draw(study, flavour, i)).collect::<Result<_, _>>()?;
        for candidate in candidates {
            cells.push(cell(study, candidate, rotor, &drawn)?);
        }
    }
    Ok(cells)
}

/// One controller on every motor of a list, on all cores.
///
/// # Errors
/// When the controller cannot run.
pub fn cell(study: &Study, candidate: &Candidate, rotor: &'static str, drawn: &[Drawn]) -> Result<Cell, RobustError> {
    let outcomes =
        drawn.par_iter().map(|motor| follow(study, candidate, motor)).collect::<Result<Vec<_>, RobustError>>()?;
    let of = |f: &dyn Fn(&Outcome) -> f64| Spread::of(outcomes.iter().map(f).collect());
    let felt: Vec<Guidance> = outcomes.iter().filter_map(|outcome| outcome.guidance).collect();
    let some = |values: Vec<f64>| (!values.is_empty()).then(|| Spread::of(values));
    let believing = felt.iter().filter(|felt| felt.believed > 0.0);
    Ok(Cell {
        rotor,
        controller: candidate.name.clone(),
        true_deg: of(&|o| o.true_deg),
        counted_deg: of(&|o| o.counted_deg),
        miscount: of(&|o| o.miscount.unsigned_abs() as f64),
        ran_away: outcomes.iter().filter(|o| o.ran_away).count(),
        hand_error_nm: some(believing.map(|felt| felt.mean_abs_error_nm).collect()),
        believed: some(felt.iter().map(|felt| felt.believed).collect()),
        outcomes,
    })
}

/// The `index`th motor: the same whichever flavour and controller it is for.
fn draw(study: &Study, flavour: Flavour, index: u64) -> Result<Drawn, RobustError> {
    let mut rng = stream(study.seed, index);
    let speed = 1.0 + rng.random_range(SPEED[0]..=SPEED[1]) * rng.random_range(-1.0..=1.0f64).signum();
    let mut parameters = study.motor.parameters(flavour);
    // The stator's surface, which carries the rotor, moves in proportion to its half thickness.
    parameters.set("h", parameters.half_thickness_m * speed)?;
    let mut effects = study.motor.effects();
    add_nuisance(&mut rng, &mut effects)?;
    Ok(Drawn { flavour, parameters, effects })
}

/// The chance of the `index`th draw of a seed.
pub fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

/// What a bench may have besides a motor's own parameters: one draw of each effect above.
///
/// # Errors
/// Never: the ranges lie within the effects' bounds.
pub fn add_nuisance(rng: &mut ChaCha8Rng, effects: &mut EffectSet) -> Result<(), EffectError> {
    let mut within = |[low, high]: [f64; 2]| rng.random_range(low..=high);
    let angle = [-PI, PI];
    let drawn: [(&str, &[f64]); 8] = [
        ("preload-runout", &[within(RUNOUT), within(angle)]),
        ("frequency-settling", &SETTLING.map(&mut within)),
        ("resonance-heating", &HEATING.map(&mut within)),
        // The loop acts late by whole ticks of 500 µs.
        ("loop-delay", &[(within(DELAY_US) / 500.0).round()]),
        ("dead-zone", &[within(DEAD_ZONE)]),
        ("direction-asymmetry", &[within(ASYMMETRY), 0.0]),
        ("unequal-edges", &[within(UNEQUAL_EDGES)]),
        ("encoder-eccentricity", &[within(ECCENTRICITY), within(angle)]),
    ];
    for (name, values) in drawn {
        effects.set(name, values)?;
    }
    Ok(())
}

/// One controller on one motor.
///
/// # Errors
/// When the controller cannot run.
pub fn follow(study: &Study, candidate: &Candidate, motor: &Drawn) -> Result<Outcome, RobustError> {
    let Drawn { flavour, parameters, effects } = motor;
    let program = LoopProgram {
        config: candidate.config,
        reference: study.target.reference(),
        pwm_hz: candidate.pwm_hz,
        edges_per_rev: study.motor.edges_per_rev,
        // Alignment leaves the rotor at an edge: wherever the disc shows one.
        encoder_phase_rad: effects.encoder_eccentricity.map_or(0.0, |e| 1e-9 - e.error_rad(0.0)),
        end_s: study.seconds,
        true_sense: false,
    };
    let stall_nm = parameters.friction * parameters.preload_n * parameters.contact_radius_m;
    let loaded = Parameters { load_nm: parameters.load_nm + study.load * stall_nm, ..*parameters };
    let mut plant = MotorPlant::new(loaded, *flavour, Solver::Averaged, effects, History::default());
    let push = |plant: &mut MotorPlant, time_s| study.hand.iter().for_each(|hand| plant.push(hand.at(time_s)));
    let trace = run_pushed(&program, &mut plant, effects, push)?;
    let followed = following(&program, &trace);
    let count_deg = 360.0 / f64::from(program.edges_per_rev);
    let wanted = |t: &Tick| study.target.at(t.time_s) * count_deg;
    let off: f64 = trace.iter().map(|t| (wanted(t) - t.angle_rad.to_degrees()).abs()).sum();
    let encoder = Encoder::new(program.edges_per_rev, program.encoder_phase_rad, effects);
    let miscount = trace.last().map_or(0, |t| i64::from(t.position) - encoder.interval_at(t.angle_rad));
    let limit = Limits::DEFAULT.following_error_counts;
    Ok(Outcome {
        counted_deg: followed.mean_abs_deg,
        true_deg: off / trace.len().max(1) as f64,
        miscount,
        ran_away: trace.iter().any(|t| t.target.abs_diff(t.position) > limit),
        guidance: study.hand.and_then(|hand| Guidance::of(&hand, &trace)),
    })
}

impl Spread {
    /// Of a sample.
    pub fn of(values: Vec<f64>) -> Self {
        let [median, p90] = quantiles(values, [0.5, 0.9]);
        Self { median, p90 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::step::ConfigSpec;

    fn study(motor: &Motor, draws: u64) -> Study<'_> {
        Study {
            motor,
            target: Target::Sine { amplitude: 89, omega_rad_s: 1.257 },
            load: 0.0,
            hand: None,
            seconds: 1.0,
            draws,
            seed: 7,
        }
    }

    fn candidate(name: &str, spec: ConfigSpec) -> Candidate {
        Candidate { name: name.to_owned(), config: Config::try_from(spec).unwrap(), pwm_hz: 50.0 }
    }

    #[test]
    fn draws_are_the_same_for_every_controller_and_differ_from_one_another() {
        let motor = Motor::pcbmotor_30mm();
        let (a, b) = (candidate("a", ConfigSpec::DEFAULT), candidate("b", ConfigSpec::DEFAULT));
        let cells = robust(&study(&motor, 6), &[a, b], &ROTORS).unwrap();
        assert_eq!(cells.len(), 2 * ROTORS.len());
        for pair in cells.chunks(2) {
            assert_eq!(pair[0].outcomes, pair[1].outcomes);
            assert!(pair[0].outcomes.windows(2).all(|o| o[0] != o[1]));
        }
    }

    /// A step and a ramp are followed from the first tick on, and a load that the clamped rotor holds without drive changes little.
    #[test]
    fn steps_ramps_and_loads_are_asked_too() {
        let motor = Motor::pcbmotor_30mm();
        let asked = |target: Target, load: f64| {
            let study = Study { target, load, seconds: 3.0, ..study(&motor, 2) };
            robust(&study, &[candidate("default", ConfigSpec::DEFAULT)], &ROTORS[..1]).unwrap()[0].true_deg.median
        };
        // 20 counts at 234 a second are 0.09 s of 3 s, 9° in the mean of that time.
        assert!((0.1..1.2).contains(&asked(Target::Step(20), 0.0)));
        let ramp = asked(Target::Ramp(100), 0.0);
        assert!((0.1..2.0).contains(&ramp), "{ramp}");
        let loaded = asked(Target::Ramp(100), 0.5);
        assert!(loaded > ramp && loaded < 6.0, "{loaded} after {ramp}");
    }

    /// A controller that does nothing is as far off as the sine goes: 2/π of 80.1°, and the board would have stopped none.
    #[test]
    fn a_controller_without_gains_is_off_by_the_sine_itself() {
        let motor = Motor::pcbmotor_30mm();
        let none = ConfigSpec {
            kp: Default::default(),
            ki_tick: Default::default(),
            feed_forward: Default::default(),
            ..ConfigSpec::DEFAULT
        };
        let whole = Study { seconds: 2.0 * PI / 1.257, draws: 2, ..study(&motor, 2) };
        for cell in robust(&whole, &[candidate("none", none)], &ROTORS).unwrap() {
            assert!((cell.true_deg.median - 89.0 * 0.9 * 2.0 / PI).abs() < 0.1, "{cell:?}");
            assert_eq!((cell.miscount.p90, cell.ran_away), (0.0, 0));
        }
    }
}
