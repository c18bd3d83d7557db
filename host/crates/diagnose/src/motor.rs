//! Between the motor file and the rotor equation: where the search starts, and what a refit means for the motor.

use super::rotor::{P, Parameters as Rotor, RunInput, RunTerms, Schedule, simulate};
use twum_motor::actuator::Pwm;
use twum_motor::averaged::Averaged;
use twum_motor::effects::EffectSet;
use twum_motor::motor::Motor;
use twum_motor::motor_plant::{History, MotorPlant, Solver};
use twum_motor::parameters::{Flavour, Parameters};
use twum_motor::plant::{Direction, Drive, Plant};

/// Torques over inertia, and damping over inertia, of a motor: drive (rad/s²), braking with the wave gone (rad/s²),
/// viscous (1/s).
pub fn rates(p: &Parameters) -> [f64; 3] {
    let per_friction = p.preload_n * p.contact_radius_m / p.rotor_inertia_kg_m2;
    [p.friction * per_friction, p.off_friction * per_friction, p.rotational_damping_nms / p.rotor_inertia_kg_m2]
}

/// Time in s in which the stator's wave builds up and dies away: 2·Ms/Cs (thesis, A.4).
pub fn wave_time_s(p: &Parameters) -> f64 {
    2.0 * p.modal_mass_kg / p.modal_damping_ns_m
}

/// Steady speed of the averaged model under full drive in rad/s.
pub fn free_speed(p: Parameters, flavour: Flavour) -> f64 {
    let mut model = Averaged::new(p, flavour);
    let settle_s = if flavour == Flavour::Thesis { 0.5 } else { 0.1 };
    model.advance(settle_s, Drive::ON, &mut |_| {});
    model.speed_rad_s()
}

/// PWM (Hz) and duty at which the refitted motor turns as fast as the rotor equation: the thesis's, short enough that starting and
/// stopping make up much of it.
const PULSED_HZ: f64 = 50.0;
const PULSED_DUTY: f64 = 0.3;
/// From here on pulses repeat each other (s), and as long they are watched.
const PULSED_S: f64 = 0.2;

/// Mean speed of the motor model under pulses, in rad/s.
fn pulsed_speed(p: Parameters, flavour: Flavour) -> f64 {
    let none = EffectSet::default();
    let mut plant = MotorPlant::new(p, flavour, Solver::Averaged, &none, History::default());
    let mut pwm = Pwm::new(PULSED_HZ, 0.0, &none);
    pwm.begin(PULSED_DUTY, Direction::Cw);
    pwm.advance(&mut plant, PULSED_S, &mut |_| {});
    let before = plant.position_rad();
    pwm.advance(&mut plant, 2.0 * PULSED_S, &mut |_| {});
    (plant.position_rad() - before) / PULSED_S
}

/// The same of the rotor equation without its effects.
fn pulsed_speed_of(rotor: &Rotor) -> f64 {
    let [free, on, viscous, band] = [P::FreeSpeed, P::OnAcceleration, P::Viscous, P::SlipBand].map(|p| rotor.get(p));
    let bare = Rotor::new(free, on, rotor.off_deceleration(), viscous, band)
        .with(P::WaveTime, rotor.get(P::WaveTime))
        .with(P::Dying, rotor.get(P::Dying))
        .with(P::Lift, rotor.get(P::Lift))
        .with(P::Ahead, rotor.get(P::Ahead))
        .with(P::Detuning, rotor.get(P::Detuning));
    let schedule = Schedule::constant(PULSED_DUTY, 1.0, PULSED_HZ, 0.0, 2.0 * PULSED_S);
    let input = RunInput {
        schedule: &schedule,
        drive_end: 2.0 * PULSED_S,
        times: &[PULSED_S, 2.0 * PULSED_S],
        half_sample_s: 0.0,
        angles: &[0.0, 0.0],
        warmth: 0.0,
        revolutions: 0.0,
        formulas: &[],
    };
    let angle = simulate(&input, &bare, &RunTerms::default()).angle;
    (angle[1] - angle[0]) / PULSED_S
}

/// The motor whose own parameters are those of the refit: force factor, contact friction, viscous damping. The rotor equation and
/// the motor model do not start and stop quite alike; force factor and friction are such that both turn as fast, under full drive
/// and under pulses.
pub fn refitted(motor: &Motor, flavour: Flavour, rotor: &Rotor) -> Motor {
    let mut out = motor.clone();
    let before = motor.parameters(flavour);
    let mut put = |name: &str, value: f64| {
        let entry = match out.physical.get_mut(name) {
            Some(entry) if flavour == Flavour::Physical => Some(entry),
            _ => out.parameters.get_mut(name),
        };
        if let Some(entry) = entry {
            entry.value = value;
            entry.source = "refitted by twum diagnose".to_owned();
            entry.uncertainty = None;
        }
    };
    let friction =
        rotor.get(P::OnAcceleration) * before.rotor_inertia_kg_m2 / (before.preload_n * before.contact_radius_m);
    let off = rotor.off_deceleration() * before.rotor_inertia_kg_m2 / (before.preload_n * before.contact_radius_m);
    let off_friction = if off > 0.0 { off.min(2.0) } else { before.off_friction };
    if off > 0.0 {
        put("uoff", off_friction);
    }
    put("Ctheta", rotor.get(P::Viscous) * before.rotor_inertia_kg_m2);
    let rotational_damping_nms = rotor.get(P::Viscous) * before.rotor_inertia_kg_m2;
    let mut p = Parameters { friction, off_friction, rotational_damping_nms, ..before };
    let (wanted, wanted_pulsed) = (rotor.get(P::FreeSpeed), pulsed_speed_of(rotor));
    // Time that pulses lose to starting goes with the inverse of the friction.
    let lost = |pulsed: f64| PULSED_DUTY - pulsed / wanted;
    for _ in 0..6 {
        match_free_speed(&mut p, flavour, wanted);
        let ratio = lost(pulsed_speed(p, flavour)) / lost(wanted_pulsed);
        if !(ratio.is_finite() && ratio > 0.0) || (ratio - 1.0).abs() < 1e-3 {
            break;
        }
        p.friction = (p.friction * ratio.clamp(0.7, 1.4)).clamp(0.5 * friction, 2.0 * friction);
    }
    match_free_speed(&mut p, flavour, wanted);
    put("u", p.friction);
    put("eta", p.force_factor_n_v);
    out.name = format!("{}-diagnosed", motor.name);
    out
}

/// Sets the force factor so that the motor turns at `wanted` rad/s under full drive: a secant in its logarithm, with which the speed
/// rises.
fn match_free_speed(p: &mut Parameters, flavour: Flavour, wanted: f64) {
    for _ in 0..12 {
        let speed = free_speed(*p, flavour);
        if !(speed.is_finite() && speed > 0.0) || (speed / wanted - 1.0).abs() < 1e-4 {
            break;
        }
        p.force_factor_n_v *= (wanted / speed).clamp(0.5, 2.0);
    }
}
