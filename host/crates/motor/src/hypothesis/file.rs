//! An effect of the user's own as a file has it: read with the key and the line of what will not do, and written.

use super::{ActsOn, Hypothesis, Mine, NAME, Number, Role};
use crate::motor::{MotorError, Reader};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::sync::Arc;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

impl Hypothesis {
    /// The hypothesis in a file of one `[effects.mine]`; `file` is its name in messages.
    ///
    /// # Errors
    /// Names the key and the line of the first thing that will not do.
    pub fn parse(file: &str, text: &str) -> Result<Self, MotorError> {
        let reader = Reader { file, text };
        let root = reader.root()?;
        reader.known("", root.get_ref(), &["effects"])?;
        let effects = root.get_ref().get("effects").and_then(|e| e.get_ref().as_table());
        let Some(effects) = effects else {
            return Err(reader.key("effects", 0, "is missing: [effects.mine] is what is asked for"));
        };
        reader.known("effects.", effects, &[NAME])?;
        match effects.get(NAME) {
            Some(value) => Ok(reader.hypothesis(value)?.0),
            None => Err(reader.key("effects.mine", 0, "is missing")),
        }
    }
}

/// As a file has it.
impl Serialize for Mine {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(serde::Serialize)]
        struct Row {
            value: f64,
            #[serde(flatten)]
            role: Role,
            min: f64,
            max: f64,
        }
        let h = &self.hypothesis;
        let rows = h.numbers.iter().zip(&self.values);
        let numbers: std::collections::BTreeMap<&str, Row> =
            rows.map(|(n, v)| (n.name.as_str(), Row { value: *v, role: n.role, min: n.min, max: n.max })).collect();
        let mut map = serializer.serialize_map(None)?;
        if !h.says.is_empty() {
            map.serialize_entry("says", &h.says)?;
        }
        map.serialize_entry("acts_on", &h.acts_on)?;
        map.serialize_entry("change", &h.change)?;
        if h.acts_on == ActsOn::Speed {
            map.serialize_entry("voltage_per_speed", &self.voltage_per_speed)?;
        }
        map.serialize_entry("numbers", &numbers)?;
        map.end()
    }
}

impl Reader<'_> {
    /// A user's own effect with the values of its numbers, which a motor's file has to give.
    pub(crate) fn mine(&self, value: &Spanned<DeValue<'_>>) -> Result<Mine, MotorError> {
        let (hypothesis, values, voltage_per_speed) = self.hypothesis(value)?;
        let numbers = hypothesis.numbers.iter().zip(values);
        let values = numbers.map(|(n, v)| {
            v.ok_or_else(|| {
                let problem =
                    "is missing: without it this is a hypothesis, which `twum diagnose FOLDER --effect FILE` fits";
                self.key(format!("effects.mine.numbers.{}.value", n.name), value.span().start, problem)
            })
        });
        let values = values.collect::<Result<Vec<_>, _>>()?;
        Ok(Mine { hypothesis: Arc::new(hypothesis), values, voltage_per_speed })
    }

    /// The hypothesis, the values of its numbers where they are given, and the voltage for a change of the speed.
    fn hypothesis(&self, value: &Spanned<DeValue<'_>>) -> Result<(Hypothesis, Vec<Option<f64>>, f64), MotorError> {
        const KEY: &str = "effects.mine";
        let at = value.span().start;
        let Some(table) = value.get_ref().as_table() else { return Err(self.key(KEY, at, "must be a table")) };
        self.known("effects.mine.", table, &["says", "acts_on", "change", "voltage_per_speed", "numbers"])?;
        let text = |key: &str| table.get(key).map(|v| self.string(&format!("{KEY}.{key}"), v)).transpose();
        let need = |key: &str| text(key)?.ok_or_else(|| self.key(format!("{KEY}.{key}"), at, "is missing"));
        let acts_on = need("acts_on")?;
        let Some((_, acts_on)) = ActsOn::ALL.iter().find(|a| a.0 == acts_on) else {
            let known = ActsOn::ALL.map(|a| a.0).join(", ");
            return Err(self.key(
                format!("{KEY}.acts_on"),
                at,
                format!("is `{acts_on}`; an effect acts on one of {known}"),
            ));
        };
        let numbers = table.get("numbers").and_then(|n| n.get_ref().as_table());
        let numbers = numbers.ok_or_else(|| self.key(format!("{KEY}.numbers"), at, "must be a table of numbers"))?;
        let mut read = Vec::new();
        for (name, row) in numbers {
            read.push(self.number_of_formula(name.get_ref(), row)?);
        }
        read.sort_by_key(|(n, _)| !n.is_size());
        let (numbers, values) = read.into_iter().unzip();
        let voltage = table.get("voltage_per_speed").map(|v| self.number(&format!("{KEY}.voltage_per_speed"), v));
        let hypothesis = Hypothesis::new(&text("says")?.unwrap_or_default(), *acts_on, &need("change")?, numbers)
            .map_err(|problem| self.key(KEY, at, problem))?;
        Ok((hypothesis, values, voltage.transpose()?.unwrap_or(1.0)))
    }

    fn number_of_formula(&self, name: &str, row: &Spanned<DeValue<'_>>) -> Result<(Number, Option<f64>), MotorError> {
        let key = format!("effects.mine.numbers.{name}");
        let at = row.span().start;
        let Some(table): Option<&DeTable<'_>> = row.get_ref().as_table() else {
            return Err(self.key(key, at, "must be a table with min, max, and typical or start"));
        };
        self.known(&format!("{key}."), table, &["typical", "start", "min", "max", "value"])?;
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
        Ok((Number { name: name.to_owned(), role, min, max }, value))
    }
}
