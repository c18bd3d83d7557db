//! Between the motor file and the rotor equation: where the search starts, and what it means for the motor.

use super::answer::Diagnosis;
use super::rotor::{P, Parameters as Rotor};
use crate::model::averaged::Averaged;
use crate::model::motor::Motor;
use crate::model::parameters::{Flavour, Parameters};
use crate::model::plant::Drive;
use std::fmt::Write as _;

/// Torques over inertia, and damping over inertia, of a motor: drive (rad/s²), braking with the wave gone (rad/s²),
/// viscous (1/s).
pub fn rates(p: &Parameters) -> [f64; 3] {
    let per_friction = p.preload_n * p.contact_radius_m / p.rotor_inertia_kg_m2;
    [p.friction * per_friction, p.off_friction * per_friction, p.rotational_damping_nms / p.rotor_inertia_kg_m2]
}

/// Steady speed of the averaged model under full drive in rad/s.
pub fn free_speed(p: Parameters, flavour: Flavour) -> f64 {
    let mut model = Averaged::new(p, flavour);
    let settle_s = if flavour == Flavour::Thesis { 0.5 } else { 0.1 };
    model.advance(settle_s, Drive::ON, &mut |_| {});
    model.speed_rad_s()
}

/// The motor whose own parameters are those of the refit: force factor, contact friction, viscous damping.
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
    put("u", friction);
    let off = rotor.get(P::OffDeceleration) * before.rotor_inertia_kg_m2 / (before.preload_n * before.contact_radius_m);
    if off > 0.0 {
        put("uoff", off.min(2.0));
    }
    put("Ctheta", rotor.get(P::Viscous) * before.rotor_inertia_kg_m2);
    let wanted = rotor.get(P::FreeSpeed);
    // The free speed rises with the force factor: a secant in its logarithm.
    let mut p =
        Parameters { friction, rotational_damping_nms: rotor.get(P::Viscous) * before.rotor_inertia_kg_m2, ..before };
    for _ in 0..12 {
        let speed = free_speed(p, flavour);
        if !(speed.is_finite() && speed > 0.0) || (speed / wanted - 1.0).abs() < 1e-4 {
            break;
        }
        p.force_factor_n_v *= (wanted / speed).clamp(0.5, 2.0);
    }
    put("eta", p.force_factor_n_v);
    out.name = format!("{}-diagnosed", motor.name);
    out
}

/// The text of a motor file for the refitted motor, with the accepted effects written above it.
///
/// # Errors
/// When the motor cannot be written as TOML.
pub fn file(motor: &Motor, flavour: Flavour, rotor: &Rotor, diagnosis: &Diagnosis) -> Result<String, toml::ser::Error> {
    let mut text =
        String::from("# Written by twum diagnose: the motor's own parameters, refitted together with these effects:\n");
    for e in diagnosis.effects.iter().filter(|e| e.status != "rejected") {
        let list: Vec<String> = e
            .parameters
            .iter()
            .map(|(n, p)| format!("{n} = {} {} [{}, {}]", p.value, p.unit, p.ci95[0], p.ci95[1]))
            .collect();
        let _ = writeln!(text, "#   {} ({}): {}", e.name, e.status, list.join("; "));
    }
    text.push_str(&refitted(motor, flavour, rotor).to_toml()?);
    Ok(text)
}
