//! What the models are worth, in numbers: convergence of the carrier model, the averaged model against it, and what the
//! closed loop owes to each piece of the model.

use super::averaged::Averaged;
use super::carrier::Carrier;
use super::closed_loop::{Following, LoopProgram, following, run};
use super::effects::{EffectSet, FrequencySettling, catalogue};
use super::modulation::Modulation;
use super::motor::Motor;
use super::motor_plant::{History, MotorPlant, Solver};
use super::parameters::{Flavour, Parameters};
use super::plant::Drive;
use super::study::Setup;
use rayon::prelude::*;
use serde::Serialize;
use twum_shared::step::ConfigError;

/// The carrier model at one step size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepSize {
    /// The reading of the model.
    pub flavour: Flavour,
    /// Step (s).
    pub step_s: f64,
    /// Error of the wave after 102.4 µs of running, against a step of 5 ns, over its amplitude.
    pub error: f64,
    /// log2 of the error of twice the step over this one.
    pub order: Option<f64>,
    /// Speed after 60 ms of full drive (rad/s).
    pub speed_rad_s: f64,
}

/// Steady speed of both models at one duty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DutyPoint {
    /// The reading of the model.
    pub flavour: Flavour,
    /// Duty.
    pub duty: f64,
    /// Of the carrier model (rpm).
    pub carrier_rpm: f64,
    /// Of the averaged model (rpm).
    pub averaged_rpm: f64,
}

/// The averaged model's run-up or stop against the carrier model's. Speeds are means over 0.1 ms, errors over the steady speed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Transient {
    /// The reading of the model.
    pub flavour: Flavour,
    /// Which motor, and whether it starts or stops.
    pub case: String,
    /// Root mean square of the speed's error over the 10 ms.
    pub rms: f64,
    /// Largest error of the speed.
    pub worst: f64,
    /// How far the averaged model is ahead in the end, at steady speed (µs).
    pub ahead_us: f64,
}

/// How well the thesis's closed-loop test goes with one piece in the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Piece {
    /// What is in the model.
    pub model: String,
    /// How the reference was followed.
    #[serde(flatten)]
    pub following: Following,
}

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Convergence of the carrier model.
    pub convergence: Vec<StepSize>,
    /// Steady speeds of both models.
    pub duties: Vec<DutyPoint>,
    /// Run-up and stop of both models.
    pub transients: Vec<Transient>,
    /// The closed loop, piece by piece.
    pub pieces: Vec<Piece>,
}

/// Runs every check on a motor.
///
/// # Errors
/// Never with the named controllers; those of a controller that cannot run.
pub fn check(motor: &Motor) -> Result<Check, ConfigError> {
    Ok(Check {
        convergence: Flavour::ALL.iter().flat_map(|&flavour| convergence(motor, flavour)).collect(),
        duties: Flavour::ALL.iter().flat_map(|&flavour| duties(motor, flavour)).collect(),
        transients: Flavour::ALL.iter().flat_map(|&flavour| transients(motor, flavour)).collect(),
        pieces: pieces(motor)?,
    })
}

/// The carrier model's error against its step size.
pub fn convergence(motor: &Motor, flavour: Flavour) -> Vec<StepSize> {
    let mut start = Carrier::new(motor.parameters(flavour), flavour);
    start.run(0.01, Drive::ON, &Modulation::NONE);
    let wave = |step_s: f64| {
        let mut model = start.clone().with_step(step_s);
        model.run(1.024e-4, Drive::ON, &Modulation::NONE);
        (model.state()[0], model.state()[1])
    };
    let exact = wave(5e-9);
    let mut rows: Vec<StepSize> = [1.6e-6, 0.8e-6, 0.4e-6, 0.2e-6, 0.1e-6, 0.05e-6]
        .into_par_iter()
        .map(|step_s| {
            let (w1, w2) = wave(step_s);
            let error = (w1 - exact.0).hypot(w2 - exact.1) / exact.0.hypot(exact.1);
            let mut steady = Carrier::new(motor.parameters(flavour), flavour).with_step(step_s);
            steady.run(0.06, Drive::ON, &Modulation::NONE);
            StepSize { flavour, step_s, error, order: None, speed_rad_s: steady.state()[7] }
        })
        .collect();
    for i in 1..rows.len() {
        rows[i].order = Some((rows[i - 1].error / rows[i].error).log2());
    }
    rows
}

/// Both models' steady speeds over the duty.
pub fn duties(motor: &Motor, flavour: Flavour) -> Vec<DutyPoint> {
    let of = |solver| Setup {
        parameters: motor.parameters(flavour),
        flavour,
        solver,
        effects: EffectSet::default(),
        duty: 1.0,
        pwm_hz: 50.0,
        seconds: 0.5,
    };
    let duties = [1.0, 2.0, 4.0, 8.0, 16.0, 24.0, 31.0, 32.0].map(|of_32: f64| of_32 / 32.0);
    let (carrier, averaged) = (of(Solver::Carrier).sweep(&duties), of(Solver::Averaged).sweep(&duties));
    carrier
        .into_iter()
        .flatten()
        .zip(averaged.into_iter().flatten())
        .map(|((duty, carrier), (_, averaged))| DutyPoint {
            flavour,
            duty,
            carrier_rpm: carrier.speed_rpm,
            averaged_rpm: averaged.speed_rpm,
        })
        .collect()
}

/// Both models' run-up and stop: the motor's own, and that of a motor whose rotor is a hundredth as heavy and follows the wave
/// at once, as the averaged model has it.
pub fn transients(motor: &Motor, flavour: Flavour) -> Vec<Transient> {
    let own = motor.parameters(flavour);
    // Mr·z̈ + Cz·ż + k·z: a tenth of the damping keeps the share of the critical one.
    let light = Parameters {
        rotor_mass_kg: 0.01 * own.rotor_mass_kg,
        vertical_damping_ns_m: 0.1 * own.vertical_damping_ns_m,
        ..own
    };
    [("", own, 1e-7), (", rotor of a hundredth of the mass", light, 2e-8)]
        .into_par_iter()
        .flat_map(|(name, parameters, step_s)| transient(name, parameters, flavour, step_s))
        .collect()
}

fn transient(name: &str, parameters: Parameters, flavour: Flavour, step_s: f64) -> [Transient; 2] {
    const WINDOW_S: f64 = 1e-4;
    const WINDOWS: usize = 100;
    let mut carrier = Carrier::new(parameters, flavour).with_step(step_s);
    let mut averaged = Averaged::new(parameters, flavour);
    let mut steady = Averaged::new(parameters, flavour);
    steady.advance(0.5, Drive::ON, &mut |_| ());
    let top = steady.speed_rad_s();
    [("start", Drive::ON), ("stop", Drive::OFF)].map(|(what, drive)| {
        let before = averaged.position_rad() - carrier.state()[6];
        let errors: Vec<f64> = (0..WINDOWS)
            .map(|_| {
                let from = (carrier.state()[6], averaged.position_rad());
                carrier.run(WINDOW_S, drive, &Modulation::NONE);
                averaged.advance(averaged.time_s() + WINDOW_S, drive, &mut |_| ());
                let turned = (carrier.state()[6] - from.0, averaged.position_rad() - from.1);
                (turned.1 - turned.0) / (WINDOW_S * top)
            })
            .collect();
        let after = averaged.position_rad() - carrier.state()[6];
        Transient {
            flavour,
            case: format!("{what}{name}"),
            rms: (errors.iter().map(|e| e * e).sum::<f64>() / WINDOWS as f64).sqrt(),
            worst: errors.iter().fold(0.0, |worst: f64, e| worst.max(e.abs())),
            ahead_us: (after - before) / top * 1e6,
        }
    })
}

/// The thesis's test (89 counts at 1.257 rad/s, its controller, 10 s) with one piece after another in the model.
///
/// # Errors
/// As [`run`].
pub fn pieces(motor: &Motor) -> Result<Vec<Piece>, ConfigError> {
    let thesis = motor.parameters(Flavour::Thesis);
    let physical = motor.parameters(Flavour::Physical);
    // A driver that restarts fast: 48 rpm at 16 ms in the measured start, settled by 0.09 s.
    let settling = EffectSet {
        frequency_settling: Some(FrequencySettling { detuning_hz: -700.0, tau_s: 0.03, on_time: 0.0 }),
        ..EffectSet::default()
    };
    let fast = Parameters { force_factor_n_v: 0.12, ..physical };
    let none = EffectSet::default;
    let mut cases = vec![
        ("thesis flavour, counts in the rotor's true sense".to_owned(), thesis, Flavour::Thesis, true, none()),
        ("thesis flavour".to_owned(), thesis, Flavour::Thesis, false, none()),
        ("measured flavour".to_owned(), motor.parameters(Flavour::Measured), Flavour::Measured, false, none()),
        ("physical flavour, counts in the rotor's true sense".to_owned(), physical, Flavour::Physical, true, none()),
        ("physical flavour".to_owned(), physical, Flavour::Physical, false, none()),
        ("physical flavour, eta 0.12 N/V (50 rpm)".to_owned(), fast, Flavour::Physical, false, none()),
        (
            "physical flavour, frequency-settling -700 Hz, 30 ms".to_owned(),
            physical,
            Flavour::Physical,
            false,
            settling,
        ),
    ];
    for info in catalogue() {
        let mut effects = EffectSet::default();
        let typical: Vec<f64> = info.parameters.iter().map(|p| p.typical).collect();
        if effects.set(info.name, &typical).is_ok() {
            let values: Vec<String> =
                info.parameters.iter().map(|p| format!("{} = {} {}", p.name, p.typical, p.unit)).collect();
            let name = format!("physical flavour, {} ({})", info.name, values.join(", "));
            cases.push((name, physical, Flavour::Physical, false, effects));
        }
    }
    cases
        .into_par_iter()
        .map(|(model, parameters, flavour, true_sense, effects)| {
            let program = LoopProgram { true_sense, ..LoopProgram::thesis(motor.edges_per_rev)? };
            let mut plant = MotorPlant::new(parameters, flavour, Solver::Averaged, &effects, History::default());
            let trace = run(&program, &mut plant, &effects)?;
            Ok(Piece { model, following: following(&program, &trace) })
        })
        .collect()
}
