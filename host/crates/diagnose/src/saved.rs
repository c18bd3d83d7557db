//! What was found, as a motor file: the refitted motor with the accepted effects in the motor model's own terms.

use super::answer::Diagnosis;
use super::library::library;
use super::motor::{free_speed, refitted};
use super::problem::{Model, Problem};
use super::refit::coefficients;
use super::rotor::{HARMONICS, P, Parameters as Rotor, placed, warm_up};
use super::{formula, rhythm};
use std::fmt::Write as _;
use std::sync::Arc;
use twum_motor::effects::info;
use twum_motor::hypothesis::{ActsOn, DESCRIBED, Formula, Hypothesis};
use twum_motor::motor::{Listed, Motor};
use twum_motor::parameters::{Flavour, Parameters};

/// An effect as the motor model has it: its parameters by name; or why the model cannot hold it.
type Carried = Result<Vec<(&'static str, f64)>, &'static str>;

const NOT_REACHED: &str = "no admissible size in the motor model does this to the speed";

/// Shares of the whole warmth, wear, decay or turn at which the motor model's speed is held against the rotor equation's.
const SHARES: usize = 12;
/// Places at which a root is looked for: as many as a range has steps that show in the speed.
const PLACES: u32 = 20;

/// Relative change of the speed over which the motor model's voltage is held against it: the size that effects have.
const SMALL_CHANGE: f64 = 0.1;

/// From the rotor equation, which speaks of speed, to the motor model, which speaks of voltage, tuning and preload.
struct Conversion {
    parameters: Parameters,
    flavour: Flavour,
    free_speed: f64,
}

impl Conversion {
    fn new(motor: &Motor, flavour: Flavour) -> Self {
        let parameters = motor.parameters(flavour);
        Self { parameters, flavour, free_speed: free_speed(parameters, flavour) }
    }

    /// The size of a change of the motor whose speed over `shares` of it is nearest to `slope` times the share (least squares):
    /// the speed of the model need not be linear in what changes.
    fn sized(
        &self,
        slope: f64,
        shares: &[f64],
        range: (f64, f64),
        changed: &dyn Fn(&mut Parameters, f64),
    ) -> Option<f64> {
        let excess = |size: f64| -> f64 {
            let one = |share: &f64| {
                let mut p = self.parameters;
                changed(&mut p, size * share);
                share * (free_speed(p, self.flavour) / self.free_speed - 1.0 - slope * share)
            };
            shares.iter().map(one).sum()
        };
        // The speed need not rise or fall all the way: the root nearest to no change is the one.
        let from = if range.0.abs() < range.1.abs() { range.0 } else { range.1 };
        let to = range.0 + range.1 - from;
        let places: Vec<f64> = (0..=PLACES).map(|k| from + (to - from) * f64::from(k) / f64::from(PLACES)).collect();
        places.windows(2).find_map(|w| bisect(w[0], w[1], &excess))
    }

    /// The relative change of the supply's voltage that changes the speed by `slope`.
    fn voltage(&self, slope: f64, shares: &[f64]) -> Option<f64> {
        if slope == 0.0 {
            return Some(0.0);
        }
        let side = |range| self.sized(slope, shares, range, &|p, x| p.force_factor_n_v *= (1.0 + x).max(1e-3));
        if slope < 0.0 { side((-0.6, 0.0)) } else { side((0.0, 0.6)) }
    }

    /// The relative change of the voltage for one of the speed, of the size that effects have.
    fn voltage_per_speed(&self) -> Option<f64> {
        self.voltage(-SMALL_CHANGE, &up_to(1.0)).map(|v| v / -SMALL_CHANGE)
    }

    /// The change of the drive frequency over the resonance in Hz that changes the speed by `slope`.
    fn tuning_hz(&self, slope: f64, shares: &[f64]) -> Option<f64> {
        let side = |range| self.sized(slope, shares, range, &|p, x| p.frequency_hz += x);
        let (below, above) = ((-2000.0, 0.0), (0.0, 2000.0));
        // Nearer to the resonance is faster, and the drive is above it.
        let [first, second] = if slope > 0.0 { [below, above] } else { [above, below] };
        side(first).or_else(|| side(second))
    }
}

/// Evenly over 0 to `most`.
fn up_to(most: f64) -> Vec<f64> {
    (1..=SHARES).map(|k| most * k as f64 / SHARES as f64).collect()
}

/// What is left of a decay, evenly in time over three of its times.
fn decay() -> Vec<f64> {
    (0..=SHARES).map(|k| (-3.0 * k as f64 / SHARES as f64).exp()).collect()
}

/// Revolutions before the last run ended, and the greatest warmth in the runs.
fn reached(problem: &Problem, p: &Rotor) -> (f64, f64) {
    let revolutions = problem.runs.iter().map(|r| r.revolutions().abs()).sum();
    let (mut kept, mut warmest) = (0.0, 0.0_f64);
    for run in &problem.runs {
        let duty = run.duty.unwrap_or_else(|| run.schedule.drive_time() / run.drive_end.max(1e-9));
        let end = warm_up(kept, duty, run.drive_end, p.get(P::HeatTau));
        warmest = warmest.max(end);
        kept = p.get(P::HeatCarry) * end;
    }
    (revolutions, warmest.max(0.05))
}

/// Whether an effect of the library was fitted in a model: of effects that cannot be told apart, some are.
fn is_in(name: &str, extended: &Model) -> bool {
    let effects = library(&[], &[]);
    effects.iter().filter(|e| e.name == name).flat_map(|e| &e.forms).any(|form| {
        form.sizes.iter().any(|s| extended.parameters.get(s.parameter) != 0.0)
            || coefficients(extended, &form.phased).iter().flatten().any(|c| *c != 0.0)
    })
}

/// What an accepted effect is in the motor model: what was fitted, copied, or through a [`Conversion`].
fn carried(name: &str, convert: &Conversion, extended: &Model, problem: &Problem, diagnosis: &Diagnosis) -> Carried {
    let rotor = &extended.parameters;
    let inertia = convert.parameters.rotor_inertia_kg_m2;
    let of = |p| rotor.get(p);
    let driven_torque_nm = of(P::OnAcceleration) * inertia;
    let estimate = |parameter: &str| {
        diagnosis.effects.iter().find(|e| e.name == name).and_then(|e| e.parameters.get(parameter)).map(|p| p.value)
    };
    let (revolutions, warmth) = reached(problem, rotor);
    Ok(match name {
        "dead-zone" => {
            vec![("threshold_duty", of(P::DeadDuty)), ("gate_duty", of(P::GateDuty)), ("gate_width", of(P::GateWidth))]
        }
        "start-delay" => vec![("delay_s", of(P::StartDelay)), ("rest_s", of(P::DelayRest))],
        "duty-quantisation" => vec![("step", 1.0 / of(P::QuantSteps)), ("down", of(P::QuantDown))],
        "high-duty-saturation" => {
            let losses: Vec<f64> = up_to(1.0).iter().map(|u| u.powf(of(P::BendPower))).collect();
            vec![
                ("inverse_us", of(P::Saturation)),
                ("bend", of(P::Bend)),
                ("voltage_loss", -convert.voltage(-of(P::BendLoss), &losses).ok_or(NOT_REACHED)?),
                ("bend_power", of(P::BendPower)),
                ("flat_top", of(P::FlatTop)),
            ]
        }
        "contact-stiffening" => {
            vec![("slip_band_excess", of(P::SlipExtra)), ("slip_exponent", of(P::SlipExponent))]
        }
        // High slots are narrower where the edge that begins them is late.
        "unequal-edges" => vec![("offset", -of(P::EdgeOffset))],
        "clock-error" => {
            vec![("error", of(P::ClockError)), ("drift_per_s", of(P::ClockDrift)), ("drift_tau_s", of(P::ClockTau))]
        }
        "backlash" => vec![("gap_rad", of(P::Backlash))],
        "reversal-miscount" => vec![("counts", of(P::Miscount)), ("drift", of(P::MiscountDrift))],
        "stribeck-friction" => {
            vec![("torque_nm", of(P::Stribeck) * driven_torque_nm), ("speed_rad_s", of(P::StribeckSpeed))]
        }
        "direction-asymmetry" => vec![
            ("gain", convert.voltage(of(P::AsymSpeed), &[1.0, -1.0]).ok_or(NOT_REACHED)?),
            ("friction", of(P::AsymFriction)),
            ("braking", of(P::AsymBrake)),
        ],
        "supply-sag" if of(P::Sag) == 0.0 => {
            return Err("a loss over the duty alone is written as high-duty-saturation");
        }
        "supply-sag" => {
            vec![("sag", -convert.voltage(-of(P::Sag), &up_to(1.0)).ok_or(NOT_REACHED)?), ("tau_s", of(P::SagTime))]
        }
        "run-in-wear" => {
            let logarithms = up_to((1.0 + revolutions / of(P::WearRevolutions).max(1e-6)).ln());
            let run_in = up_to(-(-revolutions / of(P::WearRevolutions).max(1e-6)).exp_m1());
            vec![
                ("gain", convert.voltage(of(P::Wear), &logarithms).ok_or(NOT_REACHED)?),
                ("gain_run_in", convert.voltage(of(P::WearRunIn), &run_in).ok_or(NOT_REACHED)?),
                ("friction_run_in", of(P::WearFriction)),
                ("revolutions", of(P::WearRevolutions)),
            ]
        }
        "resonance-heating" => vec![
            ("shift_hz", convert.tuning_hz(-of(P::HeatLoss), &up_to(warmth)).ok_or(NOT_REACHED)?),
            ("tau_s", of(P::HeatTau)),
            ("kept", of(P::HeatCarry)),
            ("friction", of(P::HeatFriction)),
        ],
        "frequency-settling" => vec![
            ("detuning_hz", convert.tuning_hz(of(P::SettleExcess), &decay()).ok_or(NOT_REACHED)?),
            ("tau_s", of(P::SettleTau)),
            ("on_time", of(P::SettleOnTime)),
        ],
        "preload-runout" => runout(convert, extended, problem)?,
        "encoder-eccentricity" => wheel(extended, problem),
        "gravity-load" => {
            let torque = estimate("gravity_torque_over_inertia").ok_or(NOT_REACHED)? * inertia;
            let [a, b] = extended.terms[rhythm::longest(problem)].gravity;
            // An acceleration a·cos + b·sin is a load −J·A·sin(θ + φ).
            vec![("torque_nm", torque), ("phase_rad", (-a).atan2(-b))]
        }
        "loop-delay" => vec![("ticks", estimate("ticks").ok_or(NOT_REACHED)?)],
        "controller-mismatch" => ["kp", "ki", "kd"]
            .into_iter()
            .zip(["kp_relative", "ki_relative", "kd_relative"])
            .filter_map(|(to, from)| estimate(from).map(|v| (to, v)))
            .collect(),
        "off-phase-braking" => return Err("it is the motor's own uoff, refitted here"),
        _ => return Err("it belongs to these records, or the motor model has no number for it"),
    })
}

/// Amplitudes that all runs share (root mean square of those that tell them apart, or of all) and phases of one; those of size 0 are left out.
fn harmonics(
    runs: &[&[f64]],
    problem: &Problem,
    names: [[&'static str; 2]; HARMONICS],
    phase: &dyn Fn(f64, f64) -> f64,
) -> Vec<(&'static str, f64)> {
    let (of, shown, mut out) = (rhythm::longest(problem), rhythm::shown_by(problem), Vec::new());
    for (k, [amplitude, angle]) in names.into_iter().enumerate() {
        let square: f64 = shown.iter().map(|r| runs[*r][2 * k].powi(2) + runs[*r][2 * k + 1].powi(2)).sum();
        if square > 0.0 {
            out.push((amplitude, (square / shown.len() as f64).sqrt()));
            out.push((angle, phase(runs[of][2 * k], runs[of][2 * k + 1])));
        }
    }
    out
}

/// An eccentric wheel as it was fitted: a·cos + b·sin = A·sin(kθ − φ).
fn wheel(extended: &Model, problem: &Problem) -> Vec<(&'static str, f64)> {
    let names = [
        ["amplitude_rad", "phase_rad"],
        ["amplitude_2_rad", "phase_2_rad"],
        ["amplitude_3_rad", "phase_3_rad"],
        ["amplitude_4_rad", "phase_4_rad"],
    ];
    let runs: Vec<&[f64]> = extended.terms.iter().map(|t| t.eccentricity.as_slice()).collect();
    harmonics(&runs, problem, names, &|a, b| (-a).atan2(b))
}

/// A runout as it was fitted: relative changes of speed, torque and braking, so the model's preload stays as it is.
fn runout(convert: &Conversion, extended: &Model, problem: &Problem) -> Carried {
    let names = [
        ["amplitude", "phase_rad"],
        ["amplitude_2", "phase_2_rad"],
        ["amplitude_3", "phase_3_rad"],
        ["amplitude_4", "phase_4_rad"],
    ];
    let runs: Vec<&[f64]> = extended.terms.iter().map(|t| t.runout.as_slice()).collect();
    let mut values = harmonics(&runs, problem, names, &|a, b| b.atan2(a));
    let most: f64 = values.iter().filter(|v| v.0.starts_with("amplitude")).map(|v| v.1).fold(0.0, f64::max);
    let speed = extended.parameters.get(P::RunoutSpeed);
    // A change of `most` on either side, and half of it.
    let voltage = if speed > 0.0 && most > 0.0 {
        let sides = [-most, -0.5 * most, 0.5 * most, most];
        convert.sized(speed, &sides, (0.0, 5.0), &|p, x| p.force_factor_n_v *= (1.0 + x).max(1e-3))
    } else {
        Some(0.0)
    };
    values.extend([
        ("on_preload", 0.0),
        ("on_voltage", voltage.ok_or(NOT_REACHED)?),
        ("on_friction", extended.parameters.get(P::RunoutTorque)),
        ("on_braking", extended.parameters.get(P::RunoutBrake)),
    ]);
    Ok(values)
}

/// An effect that is a formula, with what was fitted. Of a change of the speed the model's voltage is changed, as far as gives it.
fn formula_fitted(
    hypothesis: &Arc<Hypothesis>,
    places: &[P],
    convert: &Conversion,
    extended: &Model,
) -> Result<Formula, &'static str> {
    let values = &extended.parameters.of_formula(places)[..hypothesis.numbers.len()];
    if !hypothesis.is_there(values) {
        return Err("it cannot be told from another one here, which was fitted in its place");
    }
    let voltage_per_speed =
        if hypothesis.acts_on == ActsOn::Speed { convert.voltage_per_speed().ok_or(NOT_REACHED)? } else { 1.0 };
    Ok(Formula { hypothesis: hypothesis.clone(), values: values.to_vec(), voltage_per_speed })
}

/// What was described, marked as no cause, in place of what a former diagnosis described; where it cannot be said, why, in the file's head.
fn describe(out: &mut Motor, convert: &Conversion, diagnosis: &Diagnosis, head: &mut String) {
    out.effects.remove(DESCRIBED);
    for term in &diagnosis.described {
        let _ = writeln!(head, "#   no cause, over {}: {}", term.coordinate, term.equation);
    }
    let (effect, left) = match convert.voltage_per_speed() {
        Some(voltage_per_speed) => formula::effect(&diagnosis.described, voltage_per_speed),
        None => (None, diagnosis.described.iter().map(|t| (t.coordinate.as_str(), NOT_REACHED)).collect()),
    };
    if let Some(effect) = effect {
        out.effects.insert(DESCRIBED.to_owned(), Listed::Formula(effect));
    }
    for (coordinate, why) in left {
        let _ = writeln!(head, "# Not in this file: what was described over {coordinate}; {why}.");
    }
}

/// The root of a function between two values, if it changes sign between them.
fn bisect(low: f64, high: f64, f: &dyn Fn(f64) -> f64) -> Option<f64> {
    let (mut low, mut high) = (low, high);
    let (start, end) = (f(low), f(high));
    if start == 0.0 {
        return Some(low);
    }
    if end == 0.0 {
        return Some(high);
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
pub fn file(
    motor: &Motor,
    flavour: Flavour,
    extended: &Model,
    problem: &Problem,
    diagnosis: &Diagnosis,
) -> Result<String, toml::ser::Error> {
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
    let mut out = refitted(motor, flavour, &extended.parameters);
    out.edges_per_rev = problem.edges_per_rev().unwrap_or(out.edges_per_rev);
    let convert = Conversion::new(&out, flavour);
    for e in diagnosis.effects.iter().filter(|e| e.status != "rejected") {
        if let Some((hypothesis, places)) = placed(&problem.formulas).find(|(h, _)| h.name == e.name) {
            match formula_fitted(hypothesis, places, &convert, extended) {
                Ok(formula) => drop(out.effects.insert(e.name.clone(), Listed::Formula(formula))),
                Err(why) => drop(writeln!(text, "# Not in this file: {}; {why}.", e.name)),
            }
            continue;
        }
        let carried = if e.status == "ambiguous" && !is_in(&e.name, extended) {
            Err("it cannot be told from another one here, which was fitted in its place")
        } else {
            carried(&e.name, &convert, extended, problem, diagnosis)
        };
        match carried {
            Ok(values) => {
                // Within the catalogue's bounds: a fit may end a rounding error beyond them.
                let info = info(&e.name).ok();
                let values = values.into_iter().map(|(n, v)| {
                    let bounds = info.and_then(|i| i.parameters.iter().find(|p| p.name == n));
                    (n.to_owned(), bounds.map_or(v, |b| v.clamp(b.lower, b.upper)))
                });
                out.effects.insert(e.name.clone(), Listed::Known(values.collect()));
            }
            Err(why) => {
                let _ = writeln!(text, "# Not in this file: {}; {why}.", e.name);
            }
        }
    }
    describe(&mut out, &convert, diagnosis, &mut text);
    text.push_str(&out.to_toml()?);
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answer::DescribedAnswer;
    use crate::finding::{Curve, Estimate, Finding, Status};
    use crate::motor::rates;
    use crate::observe::Observed;
    use std::collections::BTreeMap;
    use std::f64::consts::TAU;
    use twum_motor::effects::SupplySag;
    use twum_motor::motor_plant::{History, Solver};
    use twum_motor::plant::Direction;
    use twum_motor::simulate::{PlantModel, Program, simulate};

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

    /// Fails if a saved model does not load where a motor file does, if its motor does not show what was found, or if it keeps the listed encoder.
    #[test]
    fn a_saved_model_loads_and_slows_as_found() {
        let motor = Motor::pcbmotor_30mm();
        let flavour = Flavour::Physical;
        let p = motor.parameters(flavour);
        let [drive, brake, viscous] = rates(&p);
        let mut rotor = Rotor::new(free_speed(p, flavour), drive, brake, viscous, 0.02);
        rotor.set(P::Sag, 0.2);
        rotor.set(P::SagTime, 0.03);
        rotor.set(P::DeadDuty, 0.07);
        let mut diagnosis = Diagnosis::impossible(Vec::new(), 1);
        diagnosis.effects = [
            found("supply-sag", vec![("speed_lost_at_full_duty", 0.2)]),
            found("dead-zone", vec![("threshold_duty", 0.07)]),
            found("dropped-samples", vec![]),
        ]
        .iter()
        .map(|f| super::super::answer::effect_answer(f, None))
        .collect();
        let problem = Problem::new(vec![Observed { pitch: TAU / 308.0, ..Observed::unrecorded() }]);
        let text = file(&motor, flavour, &problem.model(rotor), &problem, &diagnosis).expect("it can be written");
        let saved = Motor::parse("saved.toml", &text).expect("a saved model is a motor file");
        assert!(text.contains("Not in this file: dropped-samples"), "{text}");
        assert_eq!(saved.edges_per_rev, 308, "its encoder is that of the data");
        let effects = saved.effects();
        assert_eq!(effects.dead_zone.map(|e| e.threshold_duty), Some(0.07));
        let SupplySag { sag, tau_s } = effects.supply_sag.expect("the sag is carried");
        assert_eq!(tau_s, 0.03);
        let weaker = saved.parameters(flavour);
        let weaker = Parameters { force_factor_n_v: weaker.force_factor_n_v * (1.0 - sag), ..weaker };
        let ratio = free_speed(weaker, flavour) / free_speed(saved.parameters(flavour), flavour);
        // The best line through the model's curve is not on it everywhere.
        assert!((ratio - 0.8).abs() < 0.02, "{ratio}");
    }

    fn no_cause(coordinate: &str, curve: Curve) -> DescribedAnswer {
        DescribedAnswer {
            coordinate: coordinate.into(),
            equation: "speed·(1 + c)".into(),
            parameters: BTreeMap::new(),
            gain_heldout: 0.1,
            curve,
        }
    }

    /// Fails if the motor of a saved model does not show what was described, if it shows what an earlier diagnosis described, or if the file
    /// does not say that none of it is a cause.
    #[test]
    fn what_was_described_is_simulated_and_named_no_cause() {
        let flavour = Flavour::Physical;
        let bare = Motor::pcbmotor_30mm();
        let p = bare.parameters(flavour);
        let [drive, brake, viscous] = rates(&p);
        let problem = Problem::new(Vec::new());
        let model = problem.model(Rotor::new(free_speed(p, flavour), drive, brake, viscous, 0.02));
        let saved = |motor: &Motor, described: Vec<DescribedAnswer>| {
            let diagnosis = Diagnosis { described, ..Diagnosis::impossible(Vec::new(), 1) };
            let text = file(motor, flavour, &model, &problem, &diagnosis).expect("it can be written");
            (Motor::parse("saved.toml", &text).expect("a saved model is a motor file"), text)
        };
        let curve = Curve::DutyAndDirection(vec![[0.5, 0.0], [1.0, -0.08]]);
        let (described, text) =
            saved(&bare, vec![no_cause("PWM phase", Curve::Elsewhere), no_cause("duty and direction", curve)]);
        assert!(text.contains("says = \"no cause: "), "{text}");
        assert!(text.contains("# Not in this file: what was described over PWM phase"), "{text}");
        let (none, _) = saved(&described, Vec::new());
        let turned = |motor: &Motor, duty: f64, direction: Direction| {
            let parameters = motor.parameters(flavour);
            let model = PlantModel::Motor { parameters, flavour, solver: Solver::Averaged };
            simulate(&Program::constant(duty, direction, 0.6, 0.6), &model, &motor.effects(), History::default())
                .end_rad
        };
        let ratio = |duty, direction| turned(&described, duty, direction) / turned(&none, duty, direction);
        for (duty, direction, expected) in [
            (1.0, Direction::Cw, 0.92),
            (1.0, Direction::Ccw, 1.08),
            (0.75, Direction::Cw, 0.96),
            (0.5, Direction::Cw, 1.0),
            (0.2, Direction::Cw, 1.0),
        ] {
            // The voltage is converted for a tenth less of the speed, which is not linear in it.
            let found = ratio(duty, direction);
            assert!((found - expected).abs() < 0.012, "{duty} {direction:?}: {found}, not {expected}");
        }
    }
}
