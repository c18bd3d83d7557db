//! A plant under the control step of the chip: encoder counts in, duty and direction out, every control period.
//!
//! The step is [`twum_shared::step::step`] itself, the PWM and the encoder those of open-loop runs. As on the board, the
//! direction of a count is read off the direction pin, so a rotor that still coasts the other way is counted wrongly; the
//! true angle is kept beside it.

use super::actuator::Pwm;
use super::effects::EffectSet;
use super::plant::{Direction, Plant};
use super::sensor::Encoder;
use crate::tracking::{self, Tracking};
use fixed::types::{I16F48, I32F32};
use std::f64::consts::PI;
use twum_shared::reference::Reference;
use twum_shared::step::{Config, ConfigError, ConfigSpec, Inputs, State, step};

/// Parts of a count that the step reckons with.
const FINE: f64 = (1 << 20) as f64;

/// A closed-loop run.
#[derive(Debug, Clone)]
pub struct LoopProgram {
    /// The controller.
    pub config: Config,
    /// What it is to follow.
    pub reference: Reference,
    /// PWM frequency (Hz).
    pub pwm_hz: f64,
    /// Edges of the encoder a revolution.
    pub edges_per_rev: u32,
    /// How far past an edge the encoder stands at the start (rad).
    pub encoder_phase_rad: f64,
    /// End of the run (s).
    pub end_s: f64,
    /// Whether counts take the rotor's true sense instead of the direction pin's: what no one-line encoder can do.
    pub true_sense: bool,
}

impl LoopProgram {
    /// The thesis's test (section 5.3): 89 counts at 1.257 rad/s under its controller, 50 Hz PWM, 10 s.
    ///
    /// # Errors
    /// Never: its configuration is valid.
    pub fn thesis(edges_per_rev: u32) -> Result<Self, ConfigError> {
        Ok(Self {
            config: Config::try_from(ConfigSpec::THESIS)?,
            reference: Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 },
            pwm_hz: 50.0,
            edges_per_rev,
            encoder_phase_rad: 0.0,
            end_s: 10.0,
            true_sense: false,
        })
    }
}

/// A hand on the rotor: a torque that changes with time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand {
    /// Largest torque, clockwise (N·m).
    pub torque_nm: f64,
    /// Frequency of a sine (Hz); zero for a ramp up to the largest.
    pub frequency_hz: f64,
    /// From when on (s).
    pub from_s: f64,
    /// When a ramp is at its end (s).
    pub until_s: f64,
}

impl Hand {
    /// The torque at a time, clockwise (N·m).
    pub fn at(&self, time_s: f64) -> f64 {
        let since_s = time_s - self.from_s;
        if since_s <= 0.0 {
            0.0
        } else if self.frequency_hz > 0.0 {
            self.torque_nm * (2.0 * PI * self.frequency_hz * since_s).sin()
        } else {
            self.torque_nm * (since_s / (self.until_s - self.from_s)).min(1.0)
        }
    }
}

/// One control tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// When (s).
    pub time_s: f64,
    /// Wanted position (counts).
    pub target: i32,
    /// Counted position (counts).
    pub position: i32,
    /// Control signal (duty steps, Q16.16).
    pub u: i32,
    /// Commanded fraction of the PWM period with the drive on.
    pub duty: f64,
    /// Commanded direction.
    pub direction: Direction,
    /// True angle of the rotor (rad).
    pub angle_rad: f64,
    /// Torque that a controller with a target that gives way believes to push the rotor clockwise (N·m); none where that is worth nothing.
    pub load_nm: Option<f64>,
    /// How far its target is off the path (counts).
    pub deviation: f64,
    /// Speed at full drive that a controller with a model of its rotor believes, clockwise and counter-clockwise (counts/s); zero without one.
    pub full_counts_s: [f64; 2],
}

/// How well the reference was followed.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Following {
    /// Mean square of target − counted position (deg²): what a bench can measure, and the thesis states.
    pub mse_deg2: f64,
    /// Mean of |target − counted position| (deg).
    pub mean_abs_deg: f64,
    /// Mean square of target − true angle (deg²).
    pub true_mse_deg2: f64,
    /// Mean of |target − true angle| (deg).
    pub true_mean_abs_deg: f64,
    /// Counts by which the counted position ended off the true one.
    pub miscount: i64,
}

/// Runs the loop.
///
/// # Errors
/// When the effect `controller-mismatch` makes a controller that cannot run.
pub fn run(program: &LoopProgram, plant: &mut impl Plant, effects: &EffectSet) -> Result<Vec<Tick>, ConfigError> {
    run_pushed(program, plant, effects, |_, _| ())
}

/// The same with something done to the plant before each tick, by its time (s).
///
/// # Errors
/// As [`run`].
pub fn run_pushed<P: Plant>(
    program: &LoopProgram,
    plant: &mut P,
    effects: &EffectSet,
    mut before: impl FnMut(&mut P, f64),
) -> Result<Vec<Tick>, ConfigError> {
    let mut spec = *program.config.spec();
    if let Some(e) = effects.controller_mismatch {
        spec.kp = I32F32::saturating_from_num(spec.kp.to_num::<f64>() * (1.0 + e.kp));
        spec.ki_tick = I16F48::saturating_from_num(spec.ki_tick.to_num::<f64>() * (1.0 + e.ki));
        spec.kd_tick = I32F32::saturating_from_num(spec.kd_tick.to_num::<f64>() * (1.0 + e.kd));
    }
    let config = Config::try_from(spec)?;
    let period_us = u64::from(spec.period_us);
    let delay = effects.loop_delay.map_or(0, |e| e.ticks.round() as usize);
    let mut late = std::collections::VecDeque::from(vec![(0.0, Direction::Ccw); delay]);

    let mut encoder = Encoder::new(program.edges_per_rev, program.encoder_phase_rad, effects);
    let mut pwm = Pwm::new(program.pwm_hz, 0.0, effects);
    let mut state = State::REST;
    let mut position = 0;
    let mut edge_s = f64::NEG_INFINITY;
    let mut reversals = Reversals::default();
    let ticks = (program.end_s * 1e6 / period_us as f64).floor() as u64;
    let mut trace = Vec::with_capacity(ticks as usize);
    for tick in 0..ticks {
        let now_us = tick * period_us;
        before(plant, now_us as f64 * 1e-6);
        let target = program.reference.at(now_us);
        let inputs = Inputs {
            target: target.position,
            target_rate: target.rate,
            target_fraction: target.fraction,
            position,
            // A cast saturates.
            edge_age_us: (now_us as f64 - edge_s * 1e6) as u16,
        };
        let outputs = step(&config, &mut state, inputs);
        let duty = f64::from(outputs.on_steps) / f64::from(spec.duty_steps);
        late.push_back((duty, outputs.direction));
        let (applied, direction) = late.pop_front().unwrap_or((duty, outputs.direction));
        if tick == 0 {
            pwm.begin(applied, direction)
        } else {
            pwm.command(applied, direction)
        }
        trace.push(Tick {
            time_s: now_us as f64 * 1e-6,
            target: target.position,
            position,
            u: outputs.u,
            duty,
            direction: outputs.direction,
            angle_rad: plant.position_rad(),
            load_nm: state.load_nnm(&config).map(|torque| f64::from(torque) * 1e-9),
            deviation: f64::from(state.deviation) / FINE,
            full_counts_s: [state.rotor.full_cw, state.rotor.full_ccw]
                .map(|full| f64::from(full) / FINE / (period_us as f64 * 1e-6)),
        });
        let until_s = (now_us + period_us) as f64 * 1e-6;
        pwm.advance(plant, until_s, &mut |segment| {
            encoder.watch(segment, &mut |edge| {
                let sense = if program.true_sense { i32::from(edge.sense) } else { direction.sign() };
                edge_s = edge.time_s;
                position += sense + reversals.extra(sense, effects);
            });
        });
    }
    Ok(trace)
}

/// Counts that `reversal-miscount` adds.
#[derive(Debug, Default)]
struct Reversals {
    last: i32,
    owed: f64,
}

impl Reversals {
    fn extra(&mut self, sense: i32, effects: &EffectSet) -> i32 {
        let turned = self.last != 0 && self.last != sense;
        self.last = sense;
        let Some(e) = effects.reversal_miscount.filter(|_| turned) else { return 0 };
        self.owed += e.counts * f64::from(sense) + e.drift;
        let whole = self.owed.trunc();
        self.owed -= whole;
        whole as i32
    }
}

/// How well a run followed its reference.
pub fn following(program: &LoopProgram, trace: &[Tick]) -> Following {
    let count_deg = 360.0 / f64::from(program.edges_per_rev);
    let counted: Vec<tracking::Tick> = trace
        .iter()
        .map(|t| tracking::Tick {
            time_s: t.time_s,
            target: t.target.into(),
            position: t.position.into(),
            duty: t.duty,
        })
        .collect();
    let counted = Tracking::of(&counted, program.edges_per_rev);
    let truly = || trace.iter().map(|t| f64::from(t.target) * count_deg - t.angle_rad * 180.0 / PI);
    let n = trace.len().max(1) as f64;
    let miscount = trace.last().map_or(0, |tick| {
        let edges = (tick.angle_rad + program.encoder_phase_rad) * f64::from(program.edges_per_rev) / (2.0 * PI);
        i64::from(tick.position) - edges.floor() as i64
    });
    Following {
        mse_deg2: counted.as_ref().map_or(0.0, |c| c.mse_deg2),
        mean_abs_deg: counted.as_ref().map_or(0.0, |c| c.mean_abs_deg),
        true_mse_deg2: truly().map(|e| e * e).sum::<f64>() / n,
        true_mean_abs_deg: truly().map(f64::abs).sum::<f64>() / n,
        miscount,
    }
}
