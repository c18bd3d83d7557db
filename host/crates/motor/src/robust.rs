//! Controllers on motors of which not everything is known: the closed loop over many draws of what a bench may have.
//!
//! Each draw is one motor, the same for every controller, so that controllers are compared motor by motor. The loop is
//! [`super::closed_loop::run`]'s: the chip's own step, the PWM, the encoder and the model of every other command.

use super::closed_loop::{LoopProgram, Tick, following, run};
use super::effects::{EffectError, EffectSet};
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

/// What is asked.
#[derive(Debug, Clone, Copy)]
pub struct Study<'a> {
    /// The motor that the draws vary.
    pub motor: &'a Motor,
    /// Amplitude of the sine to follow (counts).
    pub amplitude: i32,
    /// Its angular frequency (rad/s).
    pub omega_rad_s: f64,
    /// Length of a run (s).
    pub seconds: f64,
    /// Motors drawn.
    pub draws: u64,
    /// Seed of the draws.
    pub seed: u64,
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

/// Every controller on every rotor, over the same draws.
///
/// # Errors
/// When a controller cannot run, or the motor varies beyond what the model describes.
pub fn robust(study: &Study, candidates: &[Candidate]) -> Result<Vec<Cell>, RobustError> {
    let mut cells = Vec::new();
    for (rotor, flavour) in ROTORS {
        let drawn: Vec<_> = (0..study.draws).map(|i| draw(study, flavour, i)).collect::<Result<_, _>>()?;
        for candidate in candidates {
            let outcomes = drawn
                .par_iter()
                .map(|(parameters, effects)| follow(study, candidate, flavour, *parameters, effects))
                .collect::<Result<Vec<_>, _>>()?;
            let of = |f: &dyn Fn(&Outcome) -> f64| Spread::of(outcomes.iter().map(f).collect());
            cells.push(Cell {
                rotor,
                controller: candidate.name.clone(),
                true_deg: of(&|o| o.true_deg),
                counted_deg: of(&|o| o.counted_deg),
                miscount: of(&|o| o.miscount.unsigned_abs() as f64),
                ran_away: outcomes.iter().filter(|o| o.ran_away).count(),
                outcomes,
            });
        }
    }
    Ok(cells)
}

/// The `index`th motor: the same whichever flavour and controller it is for.
fn draw(study: &Study, flavour: Flavour, index: u64) -> Result<(Parameters, EffectSet), RobustError> {
    let mut rng = ChaCha8Rng::seed_from_u64(study.seed);
    rng.set_stream(index);
    let mut within = |[low, high]: [f64; 2]| rng.random_range(low..=high);
    let angle = [-PI, PI];
    let speed = 1.0 + within(SPEED) * within([-1.0, 1.0]).signum();
    let mut parameters = study.motor.parameters(flavour);
    // The stator's surface, which carries the rotor, moves in proportion to its half thickness.
    parameters.set("h", parameters.half_thickness_m * speed)?;
    let mut effects = study.motor.effects();
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
    Ok((parameters, effects))
}

fn follow(
    study: &Study,
    candidate: &Candidate,
    flavour: Flavour,
    parameters: Parameters,
    effects: &EffectSet,
) -> Result<Outcome, RobustError> {
    let program = LoopProgram {
        config: candidate.config,
        reference: Reference::Sine {
            amplitude: study.amplitude,
            omega_urad_s: (study.omega_rad_s * 1e6).round() as u32,
        },
        pwm_hz: candidate.pwm_hz,
        edges_per_rev: study.motor.edges_per_rev,
        // Alignment leaves the rotor at an edge: wherever the disc shows one.
        encoder_phase_rad: effects.encoder_eccentricity.map_or(0.0, |e| 1e-9 - e.error_rad(0.0)),
        end_s: study.seconds,
        true_sense: false,
    };
    let mut plant = MotorPlant::new(parameters, flavour, Solver::Averaged, effects, History::default());
    let trace = run(&program, &mut plant, effects)?;
    let followed = following(&program, &trace);
    let count_deg = 360.0 / f64::from(program.edges_per_rev);
    let wanted = |t: &Tick| f64::from(study.amplitude) * (study.omega_rad_s * t.time_s).sin() * count_deg;
    let off: f64 = trace.iter().map(|t| (wanted(t) - t.angle_rad.to_degrees()).abs()).sum();
    let encoder = Encoder::new(program.edges_per_rev, program.encoder_phase_rad, effects);
    let miscount = trace.last().map_or(0, |t| i64::from(t.position) - encoder.interval_at(t.angle_rad));
    let limit = Limits::DEFAULT.following_error_counts;
    Ok(Outcome {
        counted_deg: followed.mean_abs_deg,
        true_deg: off / trace.len().max(1) as f64,
        miscount,
        ran_away: trace.iter().any(|t| t.target.abs_diff(t.position) > limit),
    })
}

impl Spread {
    fn of(values: Vec<f64>) -> Self {
        let [median, p90] = quantiles(values, [0.5, 0.9]);
        Self { median, p90 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::step::ConfigSpec;

    fn study(motor: &Motor, draws: u64) -> Study<'_> {
        Study { motor, amplitude: 89, omega_rad_s: 1.257, seconds: 1.0, draws, seed: 7 }
    }

    fn candidate(name: &str, spec: ConfigSpec) -> Candidate {
        Candidate { name: name.to_owned(), config: Config::try_from(spec).unwrap(), pwm_hz: 50.0 }
    }

    #[test]
    fn draws_are_the_same_for_every_controller_and_differ_from_one_another() {
        let motor = Motor::pcbmotor_30mm();
        let (a, b) = (candidate("a", ConfigSpec::DEFAULT), candidate("b", ConfigSpec::DEFAULT));
        let cells = robust(&study(&motor, 6), &[a, b]).unwrap();
        assert_eq!(cells.len(), 2 * ROTORS.len());
        for pair in cells.chunks(2) {
            assert_eq!(pair[0].outcomes, pair[1].outcomes);
            assert!(pair[0].outcomes.windows(2).all(|o| o[0] != o[1]));
        }
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
        for cell in robust(&whole, &[candidate("none", none)]).unwrap() {
            assert!((cell.true_deg.median - 89.0 * 0.9 * 2.0 / PI).abs() < 0.1, "{cell:?}");
            assert_eq!((cell.miscount.p90, cell.ran_away), (0.0, 0));
        }
    }
}
