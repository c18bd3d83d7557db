//! Between the motor file and the rotor equation: where the search starts, and what it means for the motor.

use super::answer::Diagnosis;
use super::rotor::{P, Parameters as Rotor};
use crate::model::averaged::Averaged;
use crate::model::effects::info;
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

/// An effect as the motor model has it: its name there, and its parameters by name; or why the model cannot hold it.
type Carried = Result<(&'static str, Vec<(&'static str, f64)>), (String, &'static str)>;

/// What the accepted effects are in the motor model. The rotor equation of the search and the motor model do not share every
/// parameter: where they differ, the model's is chosen so that its steady speed under full drive changes as much as was found.
fn carried(motor: &Motor, flavour: Flavour, rotor: &Rotor, diagnosis: &Diagnosis) -> Vec<Carried> {
    let p = motor.parameters(flavour);
    let inertia = p.rotor_inertia_kg_m2;
    let drive = |factor: f64| Parameters { force_factor_n_v: p.force_factor_n_v * factor, ..p };
    let tuned = |shift_hz: f64| Parameters { frequency_hz: p.frequency_hz + shift_hz, ..p };
    let heavier = |factor: f64| Parameters { preload_n: p.preload_n * factor, ..p };
    // The value at which a motor changed by it turns `ratio` times as fast.
    let matched = |ratio: f64, low: f64, high: f64, changed: &dyn Fn(f64) -> Parameters| {
        let now = free_speed(p, flavour);
        bisect(low, high, &|x| free_speed(changed(x), flavour) / now - ratio)
    };
    let estimate = |effect: &str, parameter: &str| {
        diagnosis.effects.iter().find(|e| e.name == effect).and_then(|e| e.parameters.get(parameter)).map(|p| p.value)
    };
    const NOT_REACHED: &str = "no admissible size in the motor model does this to the speed";
    let accepted = diagnosis.effects.iter().filter(|e| e.status != "rejected");
    // Of effects that cannot be told apart only the first is in the model.
    let mut out = Vec::new();
    let mut stood_for: Vec<&str> = Vec::new();
    for e in accepted {
        if stood_for.contains(&e.name.as_str()) {
            out.push(Err((e.name.clone(), "cannot be told from the one above, which stands for it")));
            continue;
        }
        stood_for.extend(e.conflicts_with.iter().map(String::as_str));
        let of = |name| rotor.get(name);
        let or = |name: &'static str, value: Option<f64>, parameter: &'static str, rest: Vec<(&'static str, f64)>| {
            value.map(|v| (name, [vec![(parameter, v)], rest].concat())).ok_or_else(|| (name.to_owned(), NOT_REACHED))
        };
        out.push(match e.name.as_str() {
            "dead-zone" => Ok(("dead-zone", vec![("threshold_duty", of(P::DeadDuty))])),
            "start-delay" => Ok(("start-delay", vec![("delay_s", of(P::StartDelay))])),
            "duty-quantisation" => Ok(("duty-quantisation", vec![("step", 1.0 / of(P::QuantSteps))])),
            "high-duty-saturation" => Ok(("high-duty-saturation", vec![("inverse_us", of(P::Saturation))])),
            "unequal-edges" => Ok(("unequal-edges", vec![("offset", of(P::EdgeOffset))])),
            "clock-error" => Ok(("clock-error", vec![("error", of(P::ClockError))])),
            "backlash" => Ok(("backlash", vec![("gap_rad", of(P::Backlash))])),
            "reversal-miscount" => Ok(("reversal-miscount", vec![("counts", of(P::Miscount))])),
            "stribeck-friction" => Ok((
                "stribeck-friction",
                vec![("torque_nm", of(P::StribeckDeceleration) * inertia), ("speed_rad_s", of(P::StribeckSpeed))],
            )),
            "off-phase-braking" => Ok(("off-phase-braking", vec![("torque_nm", of(P::OffDeceleration) * inertia)])),
            "encoder-eccentricity" => or(
                "encoder-eccentricity",
                estimate("encoder-eccentricity", "eccentricity_rad"),
                "amplitude_rad",
                Vec::new(),
            ),
            "gravity-load" => or(
                "gravity-load",
                estimate("gravity-load", "gravity_torque_over_inertia").map(|a| a * inertia),
                "torque_nm",
                Vec::new(),
            ),
            "direction-asymmetry" => or(
                "direction-asymmetry",
                matched(1.0 + of(P::AsymSpeed), -0.5, 0.5, &|x| drive(1.0 + x)),
                "gain",
                Vec::new(),
            ),
            "supply-sag" => {
                or("supply-sag", matched(1.0 - of(P::Sag), 0.0, 0.6, &|x| drive(1.0 - x)), "sag", Vec::new())
            }
            "run-in-wear" => or(
                "run-in-wear",
                matched(1.0 + of(P::Wear), -0.5, 0.5, &|x| drive(1.0 + x)),
                "gain",
                vec![("revolutions", of(P::WearRevolutions).max(0.1))],
            ),
            "resonance-heating" => or(
                "resonance-heating",
                matched(1.0 - of(P::HeatLoss), 0.0, 2000.0, &|x| tuned(x)),
                "shift_hz",
                vec![("tau_s", of(P::HeatTau))],
            ),
            "frequency-settling" => or(
                "frequency-settling",
                matched(1.0 + of(P::SettleExcess), -2000.0, 0.0, &|x| tuned(x))
                    .or_else(|| matched(1.0 + of(P::SettleExcess), 0.0, 2000.0, &|x| tuned(x))),
                "detuning_hz",
                vec![("tau_s", of(P::SettleTau))],
            ),
            "preload-runout" => {
                let (once, twice) =
                    (estimate("preload-runout", "once_a_turn"), estimate("preload-runout", "twice_a_turn"));
                match once.filter(|once| twice.is_none_or(|twice| twice < *once)) {
                    Some(ripple) => or(
                        "preload-runout",
                        matched(1.0 - ripple, 0.0, 0.8, &|x| heavier(1.0 + x)),
                        "amplitude",
                        Vec::new(),
                    ),
                    None => Err((e.name.clone(), "the motor model has it once a turn, this motor twice")),
                }
            }
            "loop-delay" => or("loop-delay", estimate("loop-delay", "ticks"), "ticks", Vec::new()),
            "controller-mismatch" => Ok((
                "controller-mismatch",
                ["kp", "ki", "kd"]
                    .into_iter()
                    .zip(["kp_relative", "ki_relative", "kd_relative"])
                    .filter_map(|(to, from)| estimate("controller-mismatch", from).map(|v| (to, v)))
                    .collect(),
            )),
            _ => Err((e.name.clone(), "it belongs to these records, or the motor model has no number for it")),
        });
    }
    out
}

/// The root of a function between two values, if it changes sign between them.
fn bisect(low: f64, high: f64, f: &dyn Fn(f64) -> f64) -> Option<f64> {
    let (mut low, mut high) = (low, high);
    let (start, end) = (f(low), f(high));
    if start == 0.0 {
        return Some(low);
    }
    if start.is_nan() || end.is_nan() || start.signum() == end.signum() {
        return None;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if f(middle) * start > 0.0 { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
}

/// The text of a motor file for the refitted motor with the accepted effects; those the motor model cannot hold are named in
/// its head.
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
    let mut out = refitted(motor, flavour, rotor);
    for effect in carried(&out, flavour, rotor, diagnosis) {
        match effect {
            Ok((name, values)) => {
                // Within the catalogue's bounds: a fit may end a rounding error beyond them.
                let info = info(name).ok();
                let values = values.into_iter().map(|(n, v)| {
                    let bounds = info.and_then(|i| i.parameters.iter().find(|p| p.name == n));
                    (n.to_owned(), bounds.map_or(v, |b| v.clamp(b.lower, b.upper)))
                });
                out.effects.insert(name.to_owned(), values.collect());
            }
            Err((name, why)) => {
                let _ = writeln!(text, "# Not in this file: {name}; {why}.");
            }
        }
    }
    text.push_str(&out.to_toml()?);
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::finding::{Estimate, Finding, Status};

    fn found(name: &str, parameters: Vec<(&str, f64)>) -> Finding {
        Finding {
            name: name.into(),
            status: Status::Named,
            probability: Some(0.99),
            gain: 0.3,
            gain_interval: [0.2, 0.4],
            p_null: 0.002,
            parameters: parameters
                .into_iter()
                .map(|(n, v)| Estimate { name: n.into(), value: v, interval: [0.9 * v, 1.1 * v], unit: "1".into() })
                .collect(),
            conflicts: Vec::new(),
            next_experiment: String::new(),
            share: 0.0,
            note: String::new(),
        }
    }

    /// Fails if a saved model does not load where a motor file does, or if its motor does not show what was found.
    #[test]
    fn a_saved_model_loads_and_slows_as_found() {
        let motor = Motor::pcbmotor_30mm();
        let flavour = Flavour::Physical;
        let p = motor.parameters(flavour);
        let [drive, brake, viscous] = rates(&p);
        let mut rotor = Rotor::new(free_speed(p, flavour), drive, brake, viscous, 0.02);
        rotor.set(P::Sag, 0.2);
        rotor.set(P::DeadDuty, 0.07);
        let mut diagnosis = Diagnosis::impossible(Vec::new(), 1);
        diagnosis.effects = [
            found("supply-sag", vec![("speed_lost_at_full_duty", 0.2)]),
            found("dead-zone", vec![("threshold_duty", 0.07)]),
            found("dropped-samples", vec![]),
        ]
        .iter()
        .map(super::super::answer::effect_answer)
        .collect();
        let text = file(&motor, flavour, &rotor, &diagnosis).expect("it can be written");
        let saved = Motor::parse("saved.toml", &text).expect("a saved model is a motor file");
        assert!(text.contains("Not in this file: dropped-samples"), "{text}");
        let effects = saved.effects();
        assert_eq!(effects.dead_zone.map(|e| e.threshold_duty), Some(0.07));
        let sag = effects.supply_sag.expect("the sag is carried").sag;
        let weaker = saved.parameters(flavour);
        let weaker = Parameters { force_factor_n_v: weaker.force_factor_n_v * (1.0 - sag), ..weaker };
        let ratio = free_speed(weaker, flavour) / free_speed(saved.parameters(flavour), flavour);
        assert!((ratio - 0.8).abs() < 1e-3, "{ratio}");
    }
}
