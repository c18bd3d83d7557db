//! How far a motor may be another before its controller swings.
//!
//! A loop is taken for stable where, after a step, the rotor stays at its place. Every loop here moves a little at rest: by a count
//! either way, which it cannot see, and by what is left of a pulse that was decided before. A loop that swings is driven for more than
//! half of a PWM period each way.
//!
//! More gain alone hardly makes these loops swing: the direction pin acts at once, also within a period, so that a rotor that comes past
//! its target is driven back the same tick. More delay does, and so does too much of the integral.

use fixed::types::{I16F48, I32F32};
use serde::Serialize;
use thiserror::Error;
use twum_motor::closed_loop::{LoopProgram, Tick, run};
use twum_motor::effects::EffectSet;
use twum_motor::motor::Motor;
use twum_motor::motor_plant::{History, MotorPlant, Solver};
use twum_motor::parameters::Flavour;
use twum_motor::robust::Drawn;
use twum_shared::message::Configuration;
use twum_shared::reference::Reference;
use twum_shared::step::{Config, ConfigError, ConfigSpec};

/// Step that is answered, as a share of a turn: 18°, more than any ripple, and done within half a second.
const STEP_TURNS: f64 = 0.05;
/// When the answer has to be over, and until when the rotor is watched (s).
const WATCHED_S: [f64; 2] = [1.5, 2.5];
/// Largest factor and delay (ms) that are looked for.
const MOST: [f64; 2] = [8.0, 100.0];
/// Halvings of an interval: a hundredth of what it began with.
const HALVINGS: usize = 6;

/// A motor on which controllers are tried.
#[derive(Debug, Clone)]
pub struct Rig {
    /// The motor.
    pub motor: Drawn,
    /// Edges of its encoder a revolution.
    pub edges_per_rev: u32,
    /// PWM frequency (Hz); none for the controller's own.
    pub pwm_hz: Option<f64>,
}

/// How much worse the loop may be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Margins {
    /// Factor by which the drive may do more for the same duty.
    pub gain: f64,
    /// Whether no factor up to that one makes it swing.
    pub gain_is_more: bool,
    /// Time by which the loop may act later (ms).
    pub delay_ms: f64,
    /// Whether no delay up to that one does.
    pub delay_is_more: bool,
}

/// Why a controller is not to be used on a motor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Swings {
    /// How far it swings about a target that rests (deg, from end to end).
    pub swing_deg: f64,
    /// What a loop that holds may swing (deg).
    pub held_deg: f64,
}

impl std::fmt::Display for Swings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "unstable in the model: about a target that rests the rotor swings by {:.1}°, and a loop that holds by {:.1}° at most",
            self.swing_deg, self.held_deg
        )
    }
}

impl Rig {
    /// A motor of a file.
    pub fn of(motor: &Motor, flavour: Flavour) -> Self {
        let drawn = Drawn { flavour, parameters: motor.parameters(flavour), effects: motor.effects() };
        Self { motor: drawn, edges_per_rev: motor.edges_per_rev, pwm_hz: None }
    }

    /// The answer to a step with the drive doing `gain` times as much, and the loop so many ticks late.
    fn answer(&self, spec: &ConfigSpec, gain: f64, late_ticks: f64) -> Result<Option<Swings>, ConfigError> {
        let edges = f64::from(self.edges_per_rev);
        let program = LoopProgram {
            config: Config::try_from(drives_more(spec, gain))?,
            reference: Reference::Step { position: (STEP_TURNS * edges).round() as i32, at_us: 0 },
            pwm_hz: self.pwm_hz.unwrap_or(f64::from(spec.pwm_hz())),
            edges_per_rev: self.edges_per_rev,
            encoder_phase_rad: 0.0,
            end_s: WATCHED_S[1],
            true_sense: false,
        };
        let mut parameters = self.motor.parameters;
        if spec.kp == I32F32::ZERO {
            parameters.half_thickness_m = (parameters.half_thickness_m * gain).min(0.1);
        }
        let mut effects: EffectSet = self.motor.effects.clone();
        let late = effects.loop_delay.map_or(0.0, |e| e.ticks) + late_ticks;
        // The bounds of the effect hold any delay that is looked for.
        let _ = effects.set("loop-delay", &[late.min(200.0)]);
        let mut plant = MotorPlant::new(parameters, self.motor.flavour, Solver::Averaged, &effects, History::default());
        let trace = run(&program, &mut plant, &effects)?;
        let swing_deg = swing_deg(&trace);
        let count_deg = 360.0 / edges;
        // Nothing is decided within a PWM period, nor between two pulses of a drive that makes one in so many ticks.
        let pulses_s = f64::from(spec.pulse_period_ticks) * f64::from(spec.period_us) * 1e-6;
        let held_deg = 2.0 * count_deg + 0.5 * self.full_deg_s(&trace) * pulses_s.max(1.0 / program.pwm_hz);
        Ok((swing_deg > held_deg).then_some(Swings { swing_deg, held_deg }))
    }

    /// Fastest motion of an answer (deg/s), over a tenth of a second.
    fn full_deg_s(&self, trace: &[Tick]) -> f64 {
        let over = 200.min(trace.len().saturating_sub(1)).max(1);
        let fastest = trace.windows(over + 1).map(|w| (w[over].angle_rad - w[0].angle_rad).abs());
        let span_s = trace.get(over).map_or(0.1, |t| t.time_s - trace[0].time_s);
        fastest.fold(0.0, f64::max).to_degrees() / span_s
    }
}

/// A controller whose gains all do more; a gated drive has none, and there it is the motor that does.
fn drives_more(spec: &ConfigSpec, gain: f64) -> ConfigSpec {
    let more = |value: I32F32| I32F32::saturating_from_num(value.to_num::<f64>() * gain);
    ConfigSpec {
        kp: more(spec.kp),
        ki_tick: I16F48::saturating_from_num(spec.ki_tick.to_num::<f64>() * gain),
        kd_tick: more(spec.kd_tick),
        ..*spec
    }
}

/// How far the rotor moves while it is watched (deg).
fn swing_deg(trace: &[Tick]) -> f64 {
    let watched = trace.iter().filter(|t| t.time_s >= WATCHED_S[0]);
    let [low, high] =
        watched.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| [a.min(t.angle_rad), b.max(t.angle_rad)]);
    (high - low).max(0.0).to_degrees()
}

impl Margins {
    /// The margins of a controller on a motor, or that it has none.
    ///
    /// # Errors
    /// When the controller cannot run.
    pub fn of(rig: &Rig, spec: &ConfigSpec) -> Result<Result<Self, Swings>, ConfigError> {
        if let Some(swings) = rig.answer(spec, 1.0, 0.0)? {
            return Ok(Err(swings));
        }
        let tick_ms = f64::from(spec.period_us) * 1e-3;
        // Gains that leave the chip's numbers are beyond any margin.
        let gain = edge(1.0, MOST[0], |gain| Ok(rig.answer(spec, gain, 0.0).unwrap_or(None).is_none()))?;
        let delay =
            edge(0.0, MOST[1].min(200.0 * tick_ms), |ms| Ok(rig.answer(spec, 1.0, (ms / tick_ms).round())?.is_none()))?;
        Ok(Ok(Self { gain: gain.0, gain_is_more: gain.1, delay_ms: delay.0, delay_is_more: delay.1 }))
    }
}

/// Whether a controller holds its place on a motor.
///
/// # Errors
/// When the controller cannot run.
pub fn holds(rig: &Rig, spec: &ConfigSpec) -> Result<Result<(), Swings>, ConfigError> {
    Ok(rig.answer(spec, 1.0, 0.0)?.map_or(Ok(()), Err))
}

/// Why a board is not given a configuration.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Refused {
    /// The controller cannot run.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// It swings.
    #[error("[control]: {swings} ({motor})")]
    Unstable {
        /// The motor on which it does, in whatever reading of it.
        motor: String,
        /// By how much, in the first reading.
        swings: Swings,
    },
}

/// Refuses a configuration whose controller swings, or runs away, in every one of these readings of the motor; without a reading none.
/// What ships was tried.
///
/// # Errors
/// How far it swings, and on which motor.
pub fn refuse_unstable(configuration: &Configuration, readings: &[(Motor, Flavour)]) -> Result<(), Refused> {
    let spec = &configuration.control;
    if ConfigSpec::NAMED.iter().any(|(_, ships)| ships == spec) {
        return Ok(());
    }
    let mut refused = Ok(());
    for (motor, flavour) in readings {
        let edges_per_rev = u32::from(configuration.edges_per_rev);
        let rig = Rig { edges_per_rev, pwm_hz: Some(f64::from(configuration.pwm_hz)), ..Rig::of(motor, *flavour) };
        match holds(&rig, spec)? {
            Ok(()) => return Ok(()),
            Err(swings) => refused = refused.and(Err(Refused::Unstable { motor: motor.name.clone(), swings })),
        }
    }
    refused
}

/// The largest value up to `most` at which, and at all tried below it, something holds; and whether that is `most`.
fn edge(from: f64, most: f64, holds: impl Fn(f64) -> Result<bool, ConfigError>) -> Result<(f64, bool), ConfigError> {
    // From below: a loop may hold again far beyond where it first swung.
    const STEPS: u32 = 12;
    let mut inside = from;
    for step in 1..=STEPS {
        let at = from + (most - from) * f64::from(step * step) / f64::from(STEPS * STEPS);
        if !holds(at)? {
            let mut outside = at;
            for _ in 0..HALVINGS {
                let middle = 0.5 * (inside + outside);
                if holds(middle)? {
                    inside = middle;
                } else {
                    outside = middle;
                }
            }
            return Ok((inside, false));
        }
        inside = at;
    }
    Ok((most, true))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(flavour: Flavour) -> Rig {
        Rig::of(&Motor::pcbmotor_30mm(), flavour)
    }

    /// Fails when a controller that ships is taken for one that swings: it would be refused on every bench.
    #[test]
    fn the_named_controllers_hold() {
        for flavour in [Flavour::Physical, Flavour::Measured] {
            for (name, spec) in ConfigSpec::NAMED {
                assert_eq!(holds(&rig(flavour), &spec).unwrap(), Ok(()), "{name}, {flavour}");
            }
        }
    }

    /// The delay that a loop bears is its phase margin over its crossover (Åström and Murray, Feedback Systems, 10.3): here of 16.4 rad/s
    /// with a corner of the integral at 2.9 rad/s and a PWM period and a half of delay, 55 ms.
    #[test]
    fn the_delay_is_the_one_that_the_linear_loop_bears() {
        let crossover: f64 = 70.0 * 234.0 / 1_024.0;
        let lag = (0.1 * 2_000.0 / 70.0 / crossover).atan() + 0.03 * crossover;
        let linear_ms = 1e3 * (std::f64::consts::FRAC_PI_2 - lag) / crossover;
        let margins = Margins::of(&rig(Flavour::Physical), &ConfigSpec::DEFAULT).unwrap().unwrap();
        assert!((margins.delay_ms / linear_ms - 1.0).abs() < 0.3, "{margins:?}, linear {linear_ms} ms");
        assert!(margins.gain > 1.5, "{margins:?}");
    }

    /// Fails when an integral that is far too strong for its gain, or a sign that is wrong, passes.
    #[test]
    fn gains_that_swing_or_run_away_are_seen() {
        let of = |kp: &str, ki: &str| ConfigSpec {
            kp: kp.parse().unwrap(),
            ki_tick: ki.parse().unwrap(),
            integral_min: -800,
            integral_max: 800,
            ..ConfigSpec::DEFAULT
        };
        for spec in [of("20", "4"), of("-5", "0.1")] {
            for flavour in [Flavour::Physical, Flavour::Measured] {
                let found = holds(&rig(flavour), &spec).unwrap();
                assert!(found.is_err_and(|s| s.swing_deg > s.held_deg), "{spec:?}, {flavour}: {found:?}");
            }
        }
    }
}
