//! What the model makes of η and its rivals.

use super::ForceFactorError;
use super::observe::{Observed, RUN_UP_S, line};
use nalgebra::DVector;
use rayon::prelude::*;
use std::f64::consts::TAU;
use twum_motor::effects::EffectSet;
use twum_motor::motor::Motor;
use twum_motor::motor_plant::{History, Solver};
use twum_motor::parameters::{Flavour, Parameters};
use twum_motor::plant::Direction;
use twum_motor::simulate::{PlantModel, Program, simulate};

/// What may trade with the force factor, by its name in the motor file. `stator` is a common factor on Ms, Cs and Ks: the
/// admittance fixes their ratios, and only together with η their size.
pub(super) const RIVALS: [&str; 9] = ["stator", "Vrms", "f", "Rr", "Fext", "u", "uoff", "Ctheta", "Cn"];
/// Relative standard uncertainty where a motor file gives none; the drive's frequency is known far better.
const DEFAULT_PRIOR: f64 = 0.1;
const DEFAULT_PRIOR_F: f64 = 0.002;
/// Edges a revolution of the simulated encoder.
const FINE_EDGES: u32 = 20_000;
/// Relative standard uncertainty of a speed under load and of a stall torque.
pub(super) const TORQUE_RELATIVE: f64 = 0.02;

/// Parameters with η and its rivals scaled by exp(x).
pub(super) fn with(base: &Parameters, x: &DVector<f64>) -> Parameters {
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

pub(super) fn prior(motor: &Motor, flavour: Flavour, name: &str) -> f64 {
    let key = if name == "stator" { "Ms" } else { name };
    let entry = motor.entry(flavour, key);
    let stated = entry.and_then(|e| Some((e.uncertainty? / e.value).abs())).filter(|r| r.is_finite() && *r > 0.0);
    // Beyond a factor of e either way a logarithm's prior says nothing any more.
    stated.unwrap_or(if name == "f" { DEFAULT_PRIOR_F } else { DEFAULT_PRIOR }).min(1.0)
}

pub(super) fn targets(observed: &[Observed], stall_nm: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let speeds = observed.iter().map(|o| (o.rpm, o.sigma_rpm));
    let lags = observed.iter().filter_map(|o| o.lag);
    let stalls = stall_nm.iter().map(|t| (*t, TORQUE_RELATIVE * t));
    speeds.chain(lags).chain(stalls).unzip()
}

/// Most torque the contact transmits to a rotor at rest (N·m), of either flavour.
pub(super) fn stall(parameters: &Parameters) -> f64 {
    parameters.friction * parameters.preload_n * parameters.contact_radius_m
}

/// Model speeds, then lags, then stall torques, in the order of [`targets`]. Runs alike are simulated once.
pub(super) fn predictions(
    observed: &[Observed],
    stalls: usize,
    parameters: &Parameters,
    flavour: Flavour,
) -> DVector<f64> {
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
pub(super) fn start(
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

/// Steps of the finite differences: η, then its rivals. The drive's frequency acts through a resonance a few per cent wide.
pub(super) fn steps() -> Vec<f64> {
    std::iter::once(1e-2).chain(RIVALS.iter().map(|name| if *name == "f" { 5e-4 } else { 1e-2 })).collect()
}
