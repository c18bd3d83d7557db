//! Formulas read, refused and simulated.

use super::*;
use crate::effects::EffectSet;
use crate::motor::Motor;
use crate::motor_plant::{History, Solver};
use crate::parameters::Flavour;
use crate::plant::Direction;
use crate::simulate::{PlantModel, Program, simulate};
use proptest::prelude::*;

fn size(name: &str) -> Number {
    Number { name: name.to_owned(), role: Role::Typical(0.1), min: -0.5, max: 0.5 }
}

fn read(change: &str) -> Result<Hypothesis, String> {
    Hypothesis::new("", ActsOn::Speed, change, vec![size("a")])
}

#[test]
fn a_formula_is_what_it_says() {
    let tau = Number { name: "tau".into(), role: Role::Start(1.0), min: 0.1, max: 20.0 };
    // The number of the form is named first, and still stands behind the size.
    let h = Hypothesis::new("", ActsOn::Speed, "-a*duty*(1 - exp(-time_s/tau))", vec![tau, size("a")]).unwrap();
    let now = Now { duty: 0.5, time_s: 2.0, ..Now::default() };
    assert!((h.change(&[0.2, 4.0], &now) + 0.2 * 0.5 * (1.0 - (-0.5_f64).exp())).abs() < 1e-15);
    assert_eq!(h.hangs_on().collect::<Vec<_>>(), ["duty", "time_s"]);
    assert!(!h.is_steady() && h.is_there(&[0.2, 4.0]) && !h.is_there(&[0.0, 4.0]));
}

/// Fails if a sign is taken before a power, as the parser does of itself.
#[test]
fn signs_stand_before_powers_as_everybody_writes_them() {
    let now = Now { duty: 0.6, ..Now::default() };
    for (change, expected) in [
        ("a*exp(-duty^2)", (-0.36_f64).exp()),
        ("-a*exp(-(duty/0.3)^2)", -(-4.0_f64).exp()),
        ("- a*(duty - 2)^2", -1.96),
        ("a*1e-1*(-duty + 1)", 0.04),
    ] {
        let change_now = read(change).expect(change).change(&[1.0], &now);
        assert!((change_now - expected).abs() < 1e-12, "{change}: {change_now}, not {expected}");
    }
}

#[test]
fn what_is_no_effect_is_refused_in_words() {
    for (change, why) in [
        ("a*", "cannot be read"),
        ("a*volume", "`volume`"),
        ("duty", "does not hold"),
        ("a + 0.1", "must be 0"),
        ("a/duty", "no number"),
        ("a*exp(1000*speed_rad_s)", "no number"),
        ("a*-duty", "parentheses"),
    ] {
        let said = read(change).expect_err(change);
        assert!(said.contains(why), "{change}: {said}");
    }
    let long = format!("a*({})", ["1"; 400].join("+"));
    assert!(read(&long).unwrap_err().contains("characters"));
    let without_size = Number { role: Role::Start(0.1), min: 0.05, ..size("a") };
    assert!(Hypothesis::new("", ActsOn::Speed, "a", vec![without_size]).unwrap_err().contains("no size"));
    assert!(Hypothesis::new("", ActsOn::Duty, "a*time_s", vec![size("a")]).unwrap_err().contains("time_s"));
    assert!(Hypothesis::new("", ActsOn::Speed, "duty*a", vec![size("duty"), size("a")]).is_err());
}

#[test]
fn a_file_says_where_it_is_wrong() {
    let text = "[effects.mine]\nacts_on = \"speed\"\nchange = \"a\"\n[effects.mine.numbers]\na = { typical = 0.1, min = 0.2, max = 0.5 }\n";
    let said = Hypothesis::parse("mine.toml", text).unwrap_err().to_string();
    assert!(said.starts_with("motor file mine.toml, line 1: `effects.mine`") && said.contains("bounds"), "{said}");
    let text = text.replace("\"speed\"", "\"weather\"");
    assert!(Hypothesis::parse("mine.toml", &text).unwrap_err().to_string().contains("speed, torque, braking, duty"));
    assert!(Hypothesis::parse("mine.toml", "").is_err());
}

/// Fails if a motor that is written with an effect of one's own is not the one that is read, or does not do what the formula says.
#[test]
fn a_motor_with_ones_own_effect_is_written_read_and_turns() {
    let text = "[effects.mine]\nacts_on = \"duty\"\nchange = \"-a*duty\"\n[effects.mine.numbers]\na = { typical = 0.1, min = 0.0, max = 0.5, value = 0.5 }\n";
    let mut file = Motor::pcbmotor_30mm().to_toml().unwrap();
    file.push_str(text);
    let motor = Motor::parse("a.toml", &file).unwrap();
    assert_eq!(Motor::parse("b.toml", &motor.to_toml().unwrap()).unwrap(), motor);
    let flavour = Flavour::Physical;
    let model = PlantModel::Motor { parameters: motor.parameters(flavour), flavour, solver: Solver::Averaged };
    let turned = |duty, effects: &EffectSet| {
        simulate(&Program::constant(duty, Direction::Cw, 0.5, 0.5), &model, effects, History::default()).end_rad
    };
    let (half, own) = (turned(0.4, &EffectSet::default()), turned(0.8, &motor.effects()));
    assert!((own / half - 1.0).abs() < 1e-9, "{own} rad, at half the duty {half}");
    let without_value = file.replace(", value = 0.5", "");
    assert!(Motor::parse("a.toml", &without_value).unwrap_err().to_string().contains("hypothesis"));
}

/// Fails if a change of the speed does not reach the motor, or reaches it where its formula is 0.
#[test]
fn a_change_of_the_speed_slows_the_motor_where_the_formula_says() {
    let flavour = Flavour::Physical;
    let parameters = Motor::pcbmotor_30mm().parameters(flavour);
    let hypothesis = Arc::new(read("-a*exp(-((duty - 0.5)/0.05)^2)").unwrap());
    let mine = Mine { hypothesis, values: vec![0.3], voltage_per_speed: 1.0 };
    let hidden = EffectSet { mine: Some(mine), ..EffectSet::default() };
    let model = PlantModel::Motor { parameters, flavour, solver: Solver::Averaged };
    let turned = |duty, effects: &EffectSet| {
        simulate(&Program::constant(duty, Direction::Cw, 0.5, 0.5), &model, effects, History::default()).end_rad
    };
    let ratio = |duty| turned(duty, &hidden) / turned(duty, &EffectSet::default());
    assert!((ratio(0.8) - 1.0).abs() < 1e-6 && ratio(0.5) < 0.8, "{} {}", ratio(0.8), ratio(0.5));
}

proptest! {
    #[test]
    fn no_text_panics(text in "[a-z0-9_+*/^(){}. \\-]{0,60}", other in "\\PC{0,40}") {
        let _ = read(&text);
        let _ = read(&other);
        let _ = read(&format!("a*({text})"));
    }
}
