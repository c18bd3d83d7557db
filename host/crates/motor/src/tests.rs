//! What holds across the parts of the model.

use super::averaged::Averaged;
use super::carrier::Carrier;
use super::contact::Contact;
use super::effects::{EffectSet, catalogue};
use super::modulation::Modulation;
use super::motor::{Motor, MotorError};
use super::motor_plant::{History, Solver};
use super::parameters::{Flavour, ParameterError, Parameters, SPECS};
use super::plant::{Direction, Drive};
use super::simulate::{PlantModel, Program, simulate};
use super::study::Setup;
use proptest::prelude::*;
use std::f64::consts::PI;

fn parameters(flavour: Flavour) -> Parameters {
    Motor::pcbmotor_30mm().parameters(flavour)
}

/// The anchor: RK4 at 0.1 µs, full drive, steady; an independent implementation gave these figures.
#[test]
fn thesis_flavour_meets_the_anchor() {
    let mut carrier = Carrier::new(parameters(Flavour::Thesis), Flavour::Thesis);
    carrier.run(0.06, Drive::ON, &Modulation::NONE);
    let state = carrier.state();
    assert!((carrier.amplitude_m() / 3.311e-8 - 1.0).abs() < 2e-4, "{}", carrier.amplitude_m());
    assert!((state[4] / 1.3676e-8 - 1.0).abs() < 2e-4, "{}", state[4]);
    assert!((state[7] / 3.6466 - 1.0).abs() < 2e-5, "{}", state[7]);
    assert_eq!(carrier.steps(), 600_000);
}

/// The corrected model neither makes nor loses energy: what flows in is stored, lost to damping and sliding, or leaves.
#[test]
fn physical_flavour_balances_its_power() {
    let p = Parameters { load_nm: 5e-3, ..parameters(Flavour::Physical) };
    let mut carrier = Carrier::new(p, Flavour::Physical);
    carrier.run(3e-4, Drive::ON, &Modulation::NONE);
    let h = 5e-8;
    let first = carrier.ledger(Drive::ON);
    let mut last = first;
    let (mut flow, mut input, mut shaft) = (0.0, 0.0, 0.0);
    for _ in 0..20_000 {
        carrier.run(h, Drive::ON, &Modulation::NONE);
        let now = carrier.ledger(Drive::ON);
        let net = |l: &super::carrier::Ledger| {
            l.input_w - l.stator_loss_w - l.vertical_loss_w - l.friction_loss_w - l.shaft_w
        };
        flow += 0.5 * h * (net(&last) + net(&now));
        input += 0.5 * h * (last.input_w + now.input_w);
        shaft += 0.5 * h * (last.shaft_w + now.shaft_w);
        assert!(now.friction_loss_w > -1e-9, "sliding gave energy: {now:?}");
        last = now;
    }
    let stored = last.stored_j - first.stored_j;
    assert!((stored - flow).abs() < 2e-4 * input, "stored {stored}, flowed {flow}, of {input} J");
    // And it is a motor: the shaft gets something, the wave pays for it.
    assert!(shaft > 1e-5 && shaft < 0.1 * input, "{shaft} of {input}");
}

/// The listing's stick condition has the rotor run past the surface that drags it: at half speed it puts out more than the
/// wave's tangential work puts in. (Not so with R0 in the place of R0².)
#[test]
fn the_listed_stick_condition_makes_energy() {
    let p = parameters(Flavour::Thesis);
    let c = Contact::new(&p);
    let amplitude = 3.3115e-8;
    let surface_m_s = c.surface * p.omega() * amplitude;
    let rotor_m_s = 0.5 * 3.6466 * p.contact_radius_m;
    // Friction limit times the crest's speed bounds what the wave can give.
    let limit_n = p.friction * p.preload_n;
    assert!(rotor_m_s > 30.0 * surface_m_s, "{rotor_m_s} against {surface_m_s} m/s");
    let share = super::contact::drive_share(0.5, 0.93, 0.93f64.cos());
    assert!(share * limit_n * rotor_m_s > 10.0 * limit_n * surface_m_s);
    // Dimensions: R0²·θ'/(h·k·Rr·W·ω) is a length; scaled by a length it must be a pure number.
    let stated = p.contact_radius_m.powi(2) * 3.65 / (surface_m_s);
    let meant = p.contact_radius_m * 3.65 / surface_m_s;
    assert!((stated / meant - p.contact_radius_m).abs() < 1e-12);
}

/// Scaling length, mass and time together leaves the physical motion alone: the equations are dimensionally whole. The listing
/// fails this.
#[test]
fn units_do_not_matter_to_the_physical_flavour() {
    // New units: metre × a, kilogram × b, second × c. N = kg·m/s².
    let (a, b, c) = (3.0, 0.7, 1.9);
    let scaled = |p: &Parameters| {
        let n = b * a / (c * c);
        Parameters {
            frequency_hz: p.frequency_hz / c,
            force_factor_n_v: p.force_factor_n_v * n,
            modal_mass_kg: p.modal_mass_kg * b,
            modal_damping_ns_m: p.modal_damping_ns_m * n * c / a,
            modal_stiffness_n_m: p.modal_stiffness_n_m * n / a,
            contact_radius_m: p.contact_radius_m * a,
            contact_width_m: p.contact_width_m * a,
            half_thickness_m: p.half_thickness_m * a,
            rotor_mass_kg: p.rotor_mass_kg * b,
            rotor_inertia_kg_m2: p.rotor_inertia_kg_m2 * b * a * a,
            vertical_damping_ns_m: p.vertical_damping_ns_m * n * c / a,
            rotational_damping_nms: p.rotational_damping_nms * n * a * c,
            preload_n: p.preload_n * n,
            contact_stiffness_n_m2: p.contact_stiffness_n_m2 * n / (a * a),
            ..*p
        }
    };
    let turned = |p: Parameters, flavour, seconds: f64| {
        let mut model = Carrier::new(p, flavour).with_step(2e-7 * seconds / 4e-4);
        model.run(seconds, Drive::ON, &Modulation::NONE);
        model.state()[6]
    };
    let of = |flavour| {
        let p = parameters(flavour);
        (turned(p, flavour, 4e-4), turned(scaled(&p), flavour, 4e-4 * c))
    };
    // CREEP_RAD_S is a speed in per-second units, hence not quite exact.
    let (here, there) = of(Flavour::Physical);
    assert!((here / there - 1.0).abs() < 1e-5, "{here} and {there}");
    let (mut here, mut there) = (0.0, 0.0);
    for seconds in [0.01, 0.02] {
        let p = parameters(Flavour::Thesis);
        let run = |p: Parameters, s: f64| {
            let mut model = Carrier::new(p, Flavour::Thesis).with_step(4e-7 * s / seconds);
            model.run(s, Drive::ON, &Modulation::NONE);
            model.state()[7] * s
        };
        (here, there) = (run(p, seconds), run(scaled(&p), seconds * c));
    }
    assert!((here / there - 1.0).abs() > 0.5, "the listed flavour should depend on the units: {here} and {there}");
}

/// Classical Runge-Kutta: a step half as long, an error a sixteenth.
#[test]
fn the_carrier_converges_with_fourth_order() {
    let mut start = Carrier::new(parameters(Flavour::Thesis), Flavour::Thesis);
    start.run(0.01, Drive::ON, &Modulation::NONE);
    let at = |step_s: f64| {
        let mut model = start.clone().with_step(step_s);
        model.run(1.024e-4, Drive::ON, &Modulation::NONE);
        *model.state()
    };
    let reference = at(1e-8);
    let error = |step_s| {
        let state = at(step_s);
        ((state[0] - reference[0]).powi(2) + (state[1] - reference[1]).powi(2)).sqrt()
    };
    let errors = [8e-7, 4e-7, 2e-7].map(error);
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((3.5..5.2).contains(&order), "order {order} from {errors:?}");
    }
}

/// The averaged model against the carrier over duties, flavours and parameters.
#[test]
fn the_averaged_model_follows_the_carrier() {
    let cases: [(Flavour, f64, &[&str]); 10] = [
        (Flavour::Thesis, 1.0, &[]),
        (Flavour::Thesis, 0.25, &[]),
        (Flavour::Thesis, 0.5, &["u=0.15", "Fext=2"]),
        (Flavour::Thesis, 0.75, &["eta=0.7", "Tload=3e-4"]),
        (Flavour::Measured, 0.125, &[]),
        (Flavour::Measured, 0.5, &["uoff=0.1", "Tload=2e-4"]),
        (Flavour::Physical, 1.0, &["eta=0.09"]),
        (Flavour::Physical, 0.125, &[]),
        (Flavour::Physical, 0.5, &["Fext=6", "u=0.2"]),
        (Flavour::Physical, 0.5, &["f=46000", "Tload=5e-3"]),
    ];
    for (flavour, duty, changes) in cases {
        let p = parameters(flavour).assign(changes).unwrap();
        let mut carrier = Carrier::new(p, flavour).with_step(2e-7);
        let mut averaged = Averaged::new(p, flavour);
        let mut at_start = (0.0, 0.0);
        let mut worst: f64 = 0.0;
        for period in 0..10 {
            if period == 5 {
                at_start = (carrier.state()[6], averaged.position_rad());
            }
            for (level, seconds) in [(0.0, 0.02 * (1.0 - duty)), (1.0, 0.02 * duty)] {
                let drive = Drive { level, duty, direction: Direction::Cw };
                carrier.run(seconds, drive, &Modulation::NONE);
                averaged.advance(averaged.time_s() + seconds, drive, &mut |_| ());
                worst = worst.max((carrier.state()[6] - averaged.position_rad()).abs());
            }
        }
        let rpm = 30.0 / PI / 0.1;
        let exact = (carrier.state()[6] - at_start.0) * rpm;
        let fast = (averaged.position_rad() - at_start.1) * rpm;
        let allowed = (0.005 * exact.abs()).max(0.05);
        assert!((fast - exact).abs() < allowed, "{flavour} {duty} {changes:?}: {fast} against {exact} rpm");
        assert!(worst < 0.02 * carrier.state()[6].abs(), "{flavour} {duty} {changes:?}: {worst} rad off");
    }
}

#[test]
fn stall_torque_is_the_stated_one_in_the_physical_flavour() {
    let setup = |flavour| Setup {
        parameters: parameters(flavour),
        flavour,
        solver: Solver::Averaged,
        effects: EffectSet::default(),
        duty: 1.0,
        pwm_hz: 50.0,
        seconds: 0.2,
    };
    assert!((setup(Flavour::Physical).stall_torque_nm() / 15e-3 - 1.0).abs() < 0.01);
    assert!((setup(Flavour::Thesis).stall_torque_nm() / 1.5e-3 - 1.0).abs() < 0.05);
    let speed = setup(Flavour::Physical).speed().unwrap();
    assert!((speed.speed_rpm - 35.0).abs() < 0.1, "{}", speed.speed_rpm);
    let pushed = Parameters { load_nm: 16e-3, ..parameters(Flavour::Physical) };
    let pushed = Setup { parameters: pushed, ..setup(Flavour::Physical) }.speed().unwrap();
    assert!(pushed.speed_rpm < -1.0, "a load beyond stall turns the rotor back: {}", pushed.speed_rpm);
}

#[test]
fn a_motor_file_survives_being_written_and_read() {
    let motor = Motor::pcbmotor_30mm();
    let again = Motor::parse("again.toml", &motor.to_toml().unwrap()).unwrap();
    assert_eq!(motor, again);
    assert_eq!(motor.parameters(Flavour::Thesis).wmin_m(), {
        // A.4's own line for Wmin, with k·x0_max = π/2.
        let p = motor.parameters(Flavour::Thesis);
        let x = 0.5 * PI;
        p.preload_n / (2.0 * p.radial_shape * p.contact_radius_m * p.contact_stiffness_n_m2 * (x.sin() - 0.0 * x))
    });
}

#[test]
fn a_bad_motor_file_is_refused_with_key_and_line() {
    let good = super::motor::SHIPPED[0].1;
    let line_of = |text: &str, needle: &str| text[..text.find(needle).unwrap()].lines().count() + 1;
    let refused = |text: &str, key: &str, line: Option<usize>| {
        let message = Motor::parse("m.toml", text).unwrap_err().to_string();
        assert!(message.contains(key) && message.contains("m.toml"), "{message}");
        if let Some(line) = line {
            assert!(message.contains(&format!("line {line}:")), "{message}, not line {line}");
        }
    };
    let broken = good.replace("value = 0.624", "value = -0.624");
    refused(&broken, "parameters.Ms", Some(line_of(&broken, "value = -0.624")));
    let broken = good.replace("lambda = 0.01432043", "lambda = 0.02");
    refused(&broken, "lambda", Some(line_of(&broken, "lambda = 0.02")));
    refused(&good.replace("[parameters.Cs]", "[parameters.Cq]"), "parameters.Cq", None);
    refused(&good.replace("unit = \"kg\"", "unit = \"g\""), "unit", None);
    let from = good.find("[parameters.Cz]").unwrap();
    let missing = format!("{}{}", &good[..from], &good[good.find("[parameters.Ctheta]").unwrap()..]);
    refused(&missing, "parameters.Cz", None);
    refused(&good.replace("value = 6.0", "value = 6.5"), "parameters.n", None);
    for edges in ["0", "400.5", "1000001"] {
        refused(&good.replace("edges_per_rev = 400", &format!("edges_per_rev = {edges}")), "edges_per_rev", None);
    }
    refused("name = ", "line 1", None);
    assert!(matches!(Motor::load("/no/such/motor.toml"), Err(MotorError::Read { .. })));
}

/// Fails if a motor that was fitted to a folder, whose encoder may have from one edge to a million, is refused when it is read again.
#[test]
fn the_encoder_of_any_folder_is_that_of_a_motor() {
    for edges_per_rev in [1, 1_000_000] {
        let text = Motor { edges_per_rev, ..Motor::pcbmotor_30mm() }.to_toml().unwrap();
        assert_eq!(Motor::parse("saved.toml", &text).unwrap().edges_per_rev, edges_per_rev);
    }
}

#[test]
fn absent_effects_change_nothing() {
    let p = parameters(Flavour::Physical);
    let model = PlantModel::Motor { parameters: p, flavour: Flavour::Physical, solver: Solver::Averaged };
    let program = Program::constant(0.5, Direction::Cw, 0.2, 0.25);
    let plain = simulate(&program, &model, &EffectSet::default(), History::default());
    for info in catalogue() {
        let mut effects = EffectSet::default();
        effects.set(info.name, &info.parameters.iter().map(|p| p.absent).collect::<Vec<_>>()).unwrap();
        let with = simulate(&program, &model, &effects, History::default());
        assert_eq!(with.edges.len(), plain.edges.len(), "{}", info.name);
        for (a, b) in with.edges.iter().zip(&plain.edges) {
            assert!((a.time_s - b.time_s).abs() < 1e-5, "{}: {} and {}", info.name, a.time_s, b.time_s);
        }
    }
}

#[test]
fn present_effects_show() {
    let p = parameters(Flavour::Physical);
    let model = PlantModel::Motor { parameters: p, flavour: Flavour::Physical, solver: Solver::Averaged };
    let program = Program::constant(0.5, Direction::Cw, 0.5, 0.6);
    let plain = simulate(&program, &model, &EffectSet::default(), History::default());
    for info in catalogue() {
        // Nothing reverses, nothing is controlled, and the 32nd part of a period is already the duty here. The rotor stops with
        // the wave, so what brakes or holds it afterwards has nothing left to do.
        let silent = ["reversal-miscount", "backlash", "duty-quantisation", "off-phase-braking", "presliding"];
        if silent.contains(&info.name) || info.seat == super::effects::Seat::Controller {
            continue;
        }
        let mut effects = EffectSet::default();
        let mut values: Vec<f64> = info.parameters.iter().map(|p| p.typical).collect();
        if info.name == "dropped-samples" {
            values[1] = 0.2;
        }
        effects.set(info.name, &values).unwrap();
        let with = simulate(&program, &model, &effects, History { warmth: 0.3, revolutions: 5.0 });
        let moved = with.edges.iter().zip(&plain.edges).any(|(a, b)| (a.time_s - b.time_s).abs() > 1e-5);
        assert!(moved, "{} left no trace", info.name);
    }
}

/// Blended periods against every period integrated in full: a duty so high that the rotor never stops integrates, so the same
/// effect is forced through the long way by a harmless presliding, which cannot be blended.
#[test]
fn blending_is_as_good_as_integrating() {
    let p = parameters(Flavour::Physical);
    let model = PlantModel::Motor { parameters: p, flavour: Flavour::Physical, solver: Solver::Averaged };
    let program = Program::constant(0.4, Direction::Cw, 2.0, 2.1);
    let cases: [(&str, &[f64]); 5] = [
        ("resonance-heating", &[200.0, 1.0]),
        ("frequency-settling", &[-400.0, 0.05]),
        ("preload-runout", &[0.15, 1.0]),
        ("run-in-wear", &[0.03, 0.5]),
        ("gravity-load", &[2e-3, 0.5]),
    ];
    for (name, values) in cases {
        let mut effects = EffectSet::default();
        effects.set(name, values).unwrap();
        let blended = simulate(&program, &model, &effects, History::default());
        effects.set("presliding", &[0.0, 1e-3]).unwrap();
        let integrated = simulate(&program, &model, &effects, History::default());
        let (a, b) = (blended.end_rad, integrated.end_rad);
        assert!((a / b - 1.0).abs() < 1e-3, "{name}: {a} and {b} rad");
    }
}

/// Fails if the friction that has run in, or is warm, is another one than that under drive and without it, or if the drive's strength runs in by
/// its size.
#[test]
fn what_has_run_in_or_is_warm_is_a_motor_of_that_friction_and_strength() {
    let p = parameters(Flavour::Physical);
    let model = PlantModel::Motor { parameters: p, flavour: Flavour::Physical, solver: Solver::Averaged };
    let program = Program::constant(0.4, Direction::Cw, 0.5, 0.6);
    let end_rad = |effect: Option<(&str, &[f64])>| {
        let mut effects = EffectSet::default();
        effect.map(|(name, values)| effects.set(name, values)).transpose().unwrap();
        simulate(&program, &model, &effects, History { revolutions: 1e4, warmth: 1.0 }).end_rad
    };
    let run_in = end_rad(Some(("run-in-wear", &[0.0, 10.0, -0.1, -0.4])));
    let other_motor = end_rad(Some(("direction-asymmetry", &[-0.1, -0.4])));
    assert!((run_in / other_motor - 1.0).abs() < 1e-9, "{run_in} and {other_motor} rad");
    assert!((run_in / end_rad(Some(("run-in-wear", &[0.0, 10.0, -0.1]))) - 1.0).abs() > 1e-4);
    assert!((run_in / end_rad(None) - 1.0).abs() > 1e-2);
    // In half a second of an hour it cools by less than what is compared.
    let warm = end_rad(Some(("resonance-heating", &[0.0, 3600.0, 1.0, -0.4])));
    let looser = end_rad(Some(("direction-asymmetry", &[0.0, -0.4])));
    assert!((warm / looser - 1.0).abs() < 1e-4, "{warm} and {looser} rad");
    assert!((warm / end_rad(None) - 1.0).abs() > 1e-3);
}

#[test]
fn a_resting_contact_springs_under_a_load() {
    let p = parameters(Flavour::Physical).assign(&["Tload=5e-3"]).unwrap();
    let model = PlantModel::Motor { parameters: p, flavour: Flavour::Physical, solver: Solver::Averaged };
    let program = Program::constant(0.0, Direction::Cw, 0.1, 0.2);
    let mut effects = EffectSet::default();
    let rigid = simulate(&program, &model, &effects, History::default()).end_rad;
    effects.set("presliding", &[0.1, 0.05]).unwrap();
    let bent = simulate(&program, &model, &effects, History::default()).end_rad;
    // LuGre, loaded slowly: z' = v·(1 − z/z_limit), so x = −z_limit·ln(1 − load/limit).
    let limit = p.off_friction * p.preload_n * p.contact_radius_m;
    let expected = 0.1 * limit * (1.0 - 5e-3 / limit).ln();
    assert!(rigid.abs() < 1e-12 && (bent / expected - 1.0).abs() < 0.02, "{rigid}, {bent} for {expected}");
}

fn any_parameters() -> impl Strategy<Value = Parameters> {
    let each: Vec<_> = SPECS
        .iter()
        .map(|spec| {
            if spec.lower > 0.0 {
                (spec.lower.ln()..=spec.upper.ln()).prop_map(f64::exp).boxed()
            } else {
                (spec.lower..=spec.upper).boxed()
            }
        })
        .collect();
    each.prop_map(|mut values| {
        values[9] = values[9].round();
        // Near enough to resonance, and a wave worth the name, for check() to let it in.
        values[4] = (2.0 * PI * values[0]).powi(2) * values[2] * 1.1;
        values[3] = values[3].min(0.4 * (values[4] * values[2]).sqrt());
        Parameters::from_array(values.try_into().expect("SPECS has 20 entries"))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Inside the bounds nothing panics and nothing hangs; outside them there is an error that names the parameter.
    #[test]
    fn no_parameters_inside_the_bounds_make_it_panic(p in any_parameters(), thesis: bool, duty in 0.0..=1.0) {
        let flavour = if thesis { Flavour::Thesis } else { Flavour::Physical };
        match p.check() {
            Ok(p) => {
                let setup = Setup { parameters: p, flavour, solver: Solver::Averaged, effects: EffectSet::default(), duty, pwm_hz: 500.0, seconds: 4e-3 };
                setup.speed().unwrap();
                Setup { solver: Solver::Carrier, seconds: 4e-5, ..setup }.speed().unwrap();
            }
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn effects_inside_their_bounds_never_panic(which in 0..catalogue().len(), at in proptest::collection::vec(0.0..=1.0, 12)) {
        let info = &catalogue()[which];
        let values: Vec<f64> =
            info.parameters.iter().zip(at).map(|(p, t): (_, f64)| p.lower + t * (p.upper - p.lower)).collect();
        let mut effects = EffectSet::default();
        effects.set(info.name, &values).unwrap();
        let model = PlantModel::Motor {
            parameters: parameters(Flavour::Physical),
            flavour: Flavour::Physical,
            solver: Solver::Averaged,
        };
        let trace = simulate(&Program::constant(0.5, Direction::Cw, 0.05, 0.06), &model, &effects, History::default());
        prop_assert!(trace.end_rad.is_finite());
        prop_assert!(trace.edges.windows(2).all(|pair| pair[0].time_s <= pair[1].time_s));
    }
}

#[test]
fn parameters_are_set_by_the_names_of_the_listing() {
    let p = parameters(Flavour::Thesis);
    assert_eq!(p.assign(&["Ks=5e10", " Ms = 0.63 "]).unwrap().modal_stiffness_n_m, 5e10);
    assert!(matches!(p.assign(&["ks=5e10"]), Err(ParameterError::Unknown { .. })));
    assert!(matches!(p.assign(&["Ms=-1"]), Err(ParameterError::OutOfBounds { name: "Ms", .. })));
    assert!(matches!(p.assign(&["Ms"]), Err(ParameterError::NotAnAssignment { .. })));
    assert!(matches!(p.assign(&["f=200000"]), Err(ParameterError::FarFromResonance { .. })));
    assert!(matches!(p.assign(&["u=NaN"]), Err(ParameterError::OutOfBounds { name: "u", .. })));
    for (i, spec) in SPECS.iter().enumerate() {
        assert_eq!(p.get(spec.name).unwrap(), p.to_array()[i]);
    }
}
