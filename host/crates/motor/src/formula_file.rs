//! Effects that are formulas ([`crate::hypothesis`]) in a file: read with the key and the line of what will not do; and those that come with
//! the program.

use super::hypothesis::{ActsOn, DIMENSIONLESS, Formula, Hypothesis, Number, Role};
use super::reader::{FileError, Reader};
use std::sync::{Arc, LazyLock};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The files of the effects that come with the program and are formulas, a line each.
const SHIPPED: &[&str] = &[
    #[cfg(test)]
    include_str!("../effects/example.toml"),
];

/// The effects that come with the program and are formulas.
pub fn shipped_effects() -> &'static [Arc<Hypothesis>] {
    static READ: LazyLock<Vec<Arc<Hypothesis>>> = LazyLock::new(|| {
        let read = |text: &&str| Reader { file: "of an effect", text }.hypotheses(&|_, _, _| Ok(()));
        let all =
            SHIPPED.iter().map(read).collect::<Result<Vec<_>, _>>().expect("the shipped files are checked by a test");
        all.into_iter().flatten().map(Arc::new).collect()
    });
    &READ
}

/// Whether the table of an effect holds a formula.
pub(crate) fn is_formula(value: &Spanned<DeValue<'_>>) -> bool {
    value.get_ref().as_table().is_some_and(|table| table.contains_key("change"))
}

impl Reader<'_> {
    /// The hypotheses of a file of nothing but them; `admissible` says whether the name of one, its key and where it stands, will do.
    pub(crate) fn hypotheses(
        &self,
        admissible: &dyn Fn(&str, usize, &str) -> Result<(), FileError>,
    ) -> Result<Vec<Hypothesis>, FileError> {
        let root = self.root()?;
        self.known("", root.get_ref(), &["effects"])?;
        let effects = root.get_ref().get("effects").and_then(|e| e.get_ref().as_table());
        let mut hypotheses = Vec::new();
        for (name, value) in effects.into_iter().flatten() {
            let key = format!("effects.{}", name.get_ref());
            admissible(&key, name.span().start, name.get_ref())?;
            hypotheses.push(self.hypothesis(&key, name.get_ref(), value)?.0);
        }
        if hypotheses.is_empty() {
            return Err(self.key(
                "effects",
                0,
                "is missing: [effects.mine], or another name, with a formula is what is asked for",
            ));
        }
        Ok(hypotheses)
    }

    /// The formula of the effect `name` under `key` with the values of its numbers, which a motor's file has to give.
    pub(crate) fn formula(&self, key: &str, name: &str, value: &Spanned<DeValue<'_>>) -> Result<Formula, FileError> {
        let (hypothesis, values, voltage_per_speed) = self.hypothesis(key, name, value)?;
        let numbers = hypothesis.numbers.iter().zip(values);
        let values = numbers.map(|(n, v)| {
            v.ok_or_else(|| {
                let problem =
                    "is missing: without it this is a hypothesis, which `twum diagnose FOLDER --effect FILE` fits";
                self.key(format!("{key}.numbers.{}.value", n.name), value.span().start, problem)
            })
        });
        let values = values.collect::<Result<Vec<_>, _>>()?;
        Ok(Formula { hypothesis: Arc::new(hypothesis), values, voltage_per_speed })
    }

    /// The hypothesis, the values of its numbers where they are given, and the voltage for a change of the speed.
    fn hypothesis(
        &self,
        key: &str,
        name: &str,
        value: &Spanned<DeValue<'_>>,
    ) -> Result<(Hypothesis, Vec<Option<f64>>, f64), FileError> {
        let at = value.span().start;
        let Some(table) = value.get_ref().as_table() else { return Err(self.key(key, at, "must be a table")) };
        self.known(&format!("{key}."), table, &["says", "acts_on", "change", "voltage_per_speed", "numbers"])?;
        let text = |of: &str| table.get(of).map(|v| self.string(&format!("{key}.{of}"), v)).transpose();
        let need = |of: &str| text(of)?.ok_or_else(|| self.key(format!("{key}.{of}"), at, "is missing"));
        let acts_on = need("acts_on")?;
        let Some((_, acts_on)) = ActsOn::ALL.iter().find(|a| a.0 == acts_on) else {
            let known = ActsOn::ALL.map(|a| a.0).join(", ");
            return Err(self.key(
                format!("{key}.acts_on"),
                at,
                format!("is `{acts_on}`; an effect acts on one of {known}"),
            ));
        };
        let numbers = table.get("numbers").and_then(|n| n.get_ref().as_table());
        let numbers = numbers.ok_or_else(|| self.key(format!("{key}.numbers"), at, "must be a table of numbers"))?;
        let mut read = Vec::new();
        for (name, row) in numbers {
            read.push(self.number_of_formula(key, name.get_ref(), row)?);
        }
        read.sort_by_key(|(n, _)| !n.is_size());
        let (numbers, values) = read.into_iter().unzip();
        let voltage = table.get("voltage_per_speed").map(|v| self.number(&format!("{key}.voltage_per_speed"), v));
        let says = text("says")?.unwrap_or_default();
        let hypothesis = Hypothesis::new(name, &says, *acts_on, &need("change")?, numbers)
            .map_err(|problem| self.key(key, at, problem))?;
        Ok((hypothesis, values, voltage.transpose()?.unwrap_or(1.0)))
    }

    fn number_of_formula(
        &self,
        key: &str,
        name: &str,
        row: &Spanned<DeValue<'_>>,
    ) -> Result<(Number, Option<f64>), FileError> {
        let key = format!("{key}.numbers.{name}");
        let at = row.span().start;
        let Some(table): Option<&DeTable<'_>> = row.get_ref().as_table() else {
            return Err(self.key(key, at, "must be a table with min, max, and typical or start"));
        };
        self.known(&format!("{key}."), table, &["typical", "start", "min", "max", "value", "unit"])?;
        let optional = |of: &str| table.get(of).map(|v| self.number(&format!("{key}.{of}"), v)).transpose();
        let need = |of: &str| optional(of)?.ok_or_else(|| self.key(format!("{key}.{of}"), at, "is missing"));
        let role = match (optional("typical")?, optional("start")?) {
            (Some(typical), None) => Role::Typical(typical),
            (None, Some(start)) => Role::Start(start),
            _ => {
                return Err(self.key(
                    key,
                    at,
                    "needs one of `typical`, if it makes the size, and `start`, if it makes the form",
                ));
            }
        };
        let (min, max, value) = (need("min")?, need("max")?, optional("value")?);
        if value.is_some_and(|v| !(min..=max).contains(&v)) {
            return Err(self.key(format!("{key}.value"), at, "is outside its bounds"));
        }
        let unit = table.get("unit").map(|v| self.string(&format!("{key}.unit"), v)).transpose()?;
        let unit = unit.unwrap_or_else(|| DIMENSIONLESS.to_owned());
        Ok((Number { name: name.to_owned(), unit, role, min, max }, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actuator::Command;
    use crate::effects::EffectSet;
    use crate::motor::{Motor, parse_hypotheses};
    use crate::motor_plant::{History, Solver};
    use crate::parameters::Flavour;
    use crate::plant::Direction;
    use crate::simulate::{PlantModel, Program, simulate};

    #[test]
    fn a_file_says_where_it_is_wrong() {
        let text = "[effects.mine]\nacts_on = \"speed\"\nchange = \"a\"\n[effects.mine.numbers]\na = { typical = 0.1, min = 0.2, max = 0.5 }\n";
        let said = parse_hypotheses("mine.toml", text).unwrap_err().to_string();
        assert!(said.starts_with("motor file mine.toml, line 1: `effects.mine`") && said.contains("bounds"), "{said}");
        let text = text.replace("\"speed\"", "\"weather\"");
        assert!(parse_hypotheses("mine.toml", &text).unwrap_err().to_string().contains("speed, torque, braking, duty"));
        assert!(parse_hypotheses("mine.toml", "").is_err());
    }

    /// Fails if the names of several effects, or which of them were taken already, are lost.
    #[test]
    fn a_file_has_effects_under_their_own_names() {
        let of = |name: &str| {
            format!(
                "[effects.{name}]\nacts_on = \"speed\"\nchange = \"a\"\n[effects.{name}.numbers]\n\
                 a = {{ typical = 0.1, min = -0.5, max = 0.5, unit = \"m\" }}\n"
            )
        };
        let read = parse_hypotheses("two.toml", &(of("one") + &of("the-other"))).unwrap();
        assert_eq!(read.iter().map(|h| h.name.as_str()).collect::<Vec<_>>(), ["one", "the-other"]);
        assert_eq!(read[0].numbers[0].unit, "m");
        let refused = |name: &str| parse_hypotheses("one.toml", &of(name)).unwrap_err().to_string();
        assert!(refused("dead-zone").contains("`effects.dead-zone` is the name of an effect of the library"));
        assert!(refused("described").contains("without a cause"));
        assert!(refused("Mine").contains("small letters"));
        let motor = Motor::pcbmotor_30mm().to_toml().unwrap() + &of("dead-zone");
        assert!(Motor::parse("a.toml", &motor).unwrap_err().to_string().contains("no formula"));
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

    /// Fails if what was described takes the place of one's own effect, is lost when it is written, or does nothing beside it.
    #[test]
    fn what_was_described_acts_beside_ones_own_effect() {
        let own = |name: &str, acts_on: &str| {
            format!(
                "[effects.{name}]\nacts_on = \"{acts_on}\"\nchange = \"-a*duty\"\n[effects.{name}.numbers]\n\
                 a = {{ typical = 0.1, min = 0.0, max = 0.5, value = 0.3 }}\n"
            )
        };
        let text = Motor::pcbmotor_30mm().to_toml().unwrap() + &own("mine", "duty") + &own("described", "speed");
        let motor = Motor::parse("a.toml", &text).unwrap();
        assert_eq!(Motor::parse("b.toml", &motor.to_toml().unwrap()).unwrap(), motor);
        let (flavour, all) = (Flavour::Physical, motor.effects());
        let model = PlantModel::Motor { parameters: motor.parameters(flavour), flavour, solver: Solver::Averaged };
        let turned = |effects: &EffectSet| {
            simulate(&Program::constant(0.8, Direction::Cw, 0.5, 0.5), &model, effects, History::default()).end_rad
        };
        let [mine, described] = ["described", "mine"].map(|name| {
            let mut without = all.clone();
            without.remove(name);
            without
        });
        let [none, mine, described, both] = [&EffectSet::default(), &mine, &described, &all].map(turned);
        assert!(mine < 0.8 * none && described < 0.9 * none, "{none} {mine} {described}");
        assert!(both < 0.9 * mine && both < 0.9 * described, "{mine} {described} {both}");
        let wrong = text.replace("acts_on = \"speed\"", "acts_on = \"weather\"");
        assert!(Motor::parse("a.toml", &wrong).unwrap_err().to_string().contains("`effects.described.acts_on`"));
    }

    /// Fails if a change of the speed does not reach the motor, or reaches it where its formula is 0.
    #[test]
    fn a_change_of_the_speed_slows_the_motor_where_the_formula_says() {
        let flavour = Flavour::Physical;
        let parameters = Motor::pcbmotor_30mm().parameters(flavour);
        let size = Number { name: "a".to_owned(), unit: "1".to_owned(), role: Role::Typical(0.1), min: -0.5, max: 0.5 };
        let change = "-a*exp(-((duty - 0.5)/0.05)^2)";
        let hypothesis = Arc::new(Hypothesis::new("mine", "", ActsOn::Speed, change, vec![size]).unwrap());
        let mut hidden = EffectSet::default();
        hidden.put(Formula { hypothesis, values: vec![0.3], voltage_per_speed: 1.0 });
        let model = PlantModel::Motor { parameters, flavour, solver: Solver::Averaged };
        let turned = |duty, effects: &EffectSet| {
            simulate(&Program::constant(duty, Direction::Cw, 0.5, 0.5), &model, effects, History::default()).end_rad
        };
        let ratio = |duty| turned(duty, &hidden) / turned(duty, &EffectSet::default());
        assert!((ratio(0.8) - 1.0).abs() < 1e-6 && ratio(0.5) < 0.8, "{} {}", ratio(0.8), ratio(0.5));
    }
    /// Fails if a motor that stays on between runs counts the angle from elsewhere than where the drive began.
    #[test]
    fn the_angle_of_a_formula_begins_with_the_drive() {
        let flavour = Flavour::Physical;
        let parameters = Motor::pcbmotor_30mm().parameters(flavour);
        let size = Number { name: "a".to_owned(), unit: "1".to_owned(), role: Role::Typical(0.1), min: 0.0, max: 0.5 };
        let hypothesis = Hypothesis::new("mine", "", ActsOn::Speed, "-a*exp(-abs(turned_rad))", vec![size]).unwrap();
        let mut effects = EffectSet::default();
        effects.put(Formula { hypothesis: Arc::new(hypothesis), values: vec![0.5], voltage_per_speed: 1.0 });
        let model = PlantModel::Motor { parameters, flavour, solver: Solver::Averaged };
        let once = Program::constant(1.0, Direction::Cw, 0.3, 2.0);
        let again = once.commands.iter().map(|c| Command { time_s: c.time_s + 2.0, ..*c });
        let twice =
            Program { commands: once.commands.iter().copied().chain(again).collect(), end_s: 4.0, ..once.clone() };
        let turned = |program| simulate(program, &model, &effects, History::default()).end_rad;
        let (first, both) = (turned(&once), turned(&twice));
        assert!((both / first - 2.0).abs() < 0.01, "{first} rad, and with a second run {both}");
    }
}
