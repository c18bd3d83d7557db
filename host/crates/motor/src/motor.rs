//! Motor files: TOML, every parameter with its unit, meaning, source and, where known, uncertainty.
//!
//! ```toml
//! name = "pcbmotor-30mm"
//! title = "30 mm PCBMotor"
//! edges_per_rev = 400
//! lambda = 0.01432          # optional: the wavelength, which must be 2π·R0/n
//!
//! [parameters.Ms]           # all twenty of `parameters::SPECS`
//! value = 0.624
//! unit = "kg"               # must be the unit the model computes in
//! meaning = "Modal mass of one stator mode."
//! source = "thesis A.4"
//! uncertainty = 0.01        # optional, one standard deviation
//!
//! [physical.Ms]             # optional: where the physical flavour differs
//! value = 1.248e-3
//! # unit, meaning, source as above
//!
//! [measured.uoff]           # optional: where the measured flavour differs
//! value = 0.0144
//!
//! [effects.dead-zone]       # optional: effects of the catalogue that this motor has, and formulas ([`super::hypothesis`])
//! threshold_duty = 0.05
//! ```

use super::effects::{EffectError, EffectInfo, EffectSet, info};
use super::formula_file::{is_formula, shipped_effects};
use super::hypothesis::{DESCRIBED, Formula, Hypothesis};
use super::parameters::{Flavour, ParameterError, Parameters, SPECS};
use super::reader::{FileError, Reader, Table};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use thiserror::Error;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use twum_files::input;

/// The motors that come with the program.
pub const SHIPPED: [(&str, &str); 1] = [("pcbmotor-30mm", include_str!("../motors/pcbmotor-30mm.toml"))];

/// One parameter as a motor file states it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Entry {
    /// Value, in `unit`.
    pub value: f64,
    /// Unit.
    pub unit: String,
    /// What it is.
    pub meaning: String,
    /// Where the number comes from.
    pub source: String,
    /// One standard deviation, in `unit`, where known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<f64>,
}

/// A motor: its parameters in every flavour, and where each number comes from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Motor {
    /// Name, as a measurement folder refers to it.
    pub name: String,
    /// Name for people.
    pub title: String,
    /// Edges of the encoder's line a revolution.
    pub edges_per_rev: u32,
    /// Every parameter, by its name of section A.4.
    pub parameters: BTreeMap<String, Entry>,
    /// Those that differ in the physical flavour.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub physical: BTreeMap<String, Entry>,
    /// Those that differ in the measured flavour.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub measured: BTreeMap<String, Entry>,
    /// Effects it has.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub effects: BTreeMap<String, Listed>,
}

/// An effect as a motor file lists it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Listed {
    /// One of the [`super::effects::catalogue`], with its parameters by name.
    Known(BTreeMap<String, f64>),
    /// A formula: the user's own, or what was described without a cause.
    Formula(Formula),
}

/// What is wrong with a motor file; every message names the file, the key and the line.
#[derive(Debug, Error)]
pub enum MotorError {
    /// The file cannot be read.
    #[error("motor file {file}: {reason}; the shipped motors are {}", shipped())]
    Read {
        /// The file.
        file: String,
        /// Why.
        reason: std::io::Error,
    },
    /// A file of effects cannot be read.
    #[error("effects file {file}: {reason}")]
    ReadEffects {
        /// The file.
        file: String,
        /// Why.
        reason: std::io::Error,
    },
    /// A name that no shipped motor has.
    #[error("no motor `{name}` is shipped ({} are); name a file with a `/` in it, or ending in .toml", shipped())]
    NotShipped {
        /// The name.
        name: String,
    },
    /// What is in it will not do.
    #[error(transparent)]
    Content(#[from] FileError),
}

fn shipped() -> String {
    SHIPPED.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}

impl Reader<'_> {
    fn entry(&self, key: &str, unit: &str, value: &Spanned<DeValue<'_>>) -> Result<Entry, FileError> {
        let at = value.span().start;
        let Some(table) = value.get_ref().as_table() else {
            return Err(self.key(key, at, "must be a table with value, unit, meaning and source"));
        };
        self.known(&format!("{key}."), table, &["value", "unit", "meaning", "source", "uncertainty"])?;
        let need = |name: &str| table.get(name).ok_or_else(|| self.key(format!("{key}.{name}"), at, "is missing"));
        let entry = Entry {
            value: self.number(&format!("{key}.value"), need("value")?)?,
            unit: self.string(&format!("{key}.unit"), need("unit")?)?,
            meaning: self.string(&format!("{key}.meaning"), need("meaning")?)?,
            source: self.string(&format!("{key}.source"), need("source")?)?,
            uncertainty: match table.get("uncertainty") {
                Some(value) => Some(self.number(&format!("{key}.uncertainty"), value)?),
                None => None,
            },
        };
        if entry.unit != unit {
            return Err(self.key(
                format!("{key}.unit"),
                need("unit")?.span().start,
                format!("is `{}`: the model computes in `{unit}`; convert the value", entry.unit),
            ));
        }
        if entry.uncertainty.is_some_and(|u| u < 0.0) {
            return Err(self.key(format!("{key}.uncertainty"), at, "is negative"));
        }
        Ok(entry)
    }

    fn motor(&self, root: &Table<'_>) -> Result<Motor, FileError> {
        let table = root.get_ref();
        self.known(
            "",
            table,
            &["name", "title", "edges_per_rev", "lambda", "parameters", "physical", "measured", "effects"],
        )?;
        let need = |name: &str| table.get(name).ok_or_else(|| self.key(name, 0, "is missing"));
        let edges = need("edges_per_rev")?;
        let count = self.number("edges_per_rev", edges)?;
        if count.fract() != 0.0 || !(1.0..=1e6).contains(&count) {
            return Err(self.key("edges_per_rev", edges.span().start, "must be a whole number from 1 to 1000000"));
        }
        let values = need("parameters")?;
        let Some(listed) = values.get_ref().as_table() else {
            return Err(self.key("parameters", values.span().start, "must be a table of parameters"));
        };
        let names: Vec<&str> = SPECS.iter().map(|spec| spec.name).collect();
        self.known("parameters.", listed, &names)?;
        let mut parameters = BTreeMap::new();
        for spec in &SPECS {
            let key = format!("parameters.{}", spec.name);
            let value = listed.get(spec.name).ok_or_else(|| self.key(&*key, values.span().start, "is missing"))?;
            parameters.insert(spec.name.to_owned(), self.entry(&key, spec.unit, value)?);
        }
        let motor = Motor {
            name: self.string("name", need("name")?)?,
            title: self.string("title", need("title")?)?,
            edges_per_rev: count as u32,
            parameters,
            physical: self.departures(table, "physical")?,
            measured: self.departures(table, "measured")?,
            effects: self.effects(table)?,
        };
        for (flavour, prefix) in
            [(Flavour::Thesis, "parameters"), (Flavour::Physical, "physical"), (Flavour::Measured, "measured")]
        {
            motor.parameters(flavour).check().map_err(|error| {
                let name = match &error {
                    ParameterError::OutOfBounds { name, .. } => name,
                    ParameterError::NotWhole { .. } => "n",
                    ParameterError::FarFromResonance { .. } => "f",
                    ParameterError::Overdamped { .. } => "Cs",
                    // Not about a value in the file.
                    ParameterError::Unknown { .. } | ParameterError::NotAnAssignment { .. } => "",
                };
                let own = table.get(prefix).and_then(|t| t.get_ref().as_table()?.get(name));
                let (prefix, at) = match own {
                    Some(value) => (prefix, value.span().start),
                    None => ("parameters", listed.get(name).map_or(0, |value| value.span().start)),
                };
                let at = self.value_offset(at);
                self.key(format!("{prefix}.{name}"), at, format!("will not do: {error}"))
            })?;
        }
        if let Some(value) = table.get("lambda") {
            let stated = self.number("lambda", value)?;
            let computed = motor.parameters(Flavour::Thesis).wavelength_m();
            if (stated / computed - 1.0).abs() > 1e-3 {
                let problem =
                    format!("is {stated} m, but 2π·R0/n of this file is {computed:.6} m; one of the three is wrong");
                return Err(self.key("lambda", value.span().start, problem));
            }
        }
        Ok(motor)
    }

    /// The parameters of a flavour that differ from those listed.
    fn departures(&self, root: &DeTable<'_>, flavour: &str) -> Result<BTreeMap<String, Entry>, FileError> {
        let Some(value) = root.get(flavour) else { return Ok(BTreeMap::new()) };
        let table =
            value.get_ref().as_table().ok_or_else(|| self.key(flavour, value.span().start, "must be a table"))?;
        self.known(&format!("{flavour}."), table, &SPECS.map(|spec| spec.name))?;
        let stated = SPECS.iter().filter_map(|spec| Some((spec, table.get(spec.name)?)));
        stated
            .map(|(spec, value)| {
                Ok((spec.name.to_owned(), self.entry(&format!("{flavour}.{}", spec.name), spec.unit, value)?))
            })
            .collect()
    }

    /// The effects listed; a parameter that is not given keeps the catalogue's absent value.
    fn effects(&self, root: &DeTable<'_>) -> Result<BTreeMap<String, Listed>, FileError> {
        let mut out = BTreeMap::new();
        let Some(value) = root.get("effects") else { return Ok(out) };
        let Some(listed) = value.get_ref().as_table() else {
            return Err(self.key("effects", value.span().start, "must be a table of effects"));
        };
        for (name, value) in listed {
            let key = format!("effects.{}", name.get_ref());
            let at = name.span().start;
            if is_formula(value) {
                self.own_name(&key, at, name.get_ref())?;
                out.insert(name.get_ref().to_string(), Listed::Formula(self.formula(&key, name.get_ref(), value)?));
                continue;
            }
            let info = info(name.get_ref()).map_err(|error| self.key(&*key, at, format!("will not do: {error}")))?;
            let Some(table) = value.get_ref().as_table() else {
                return Err(self.key(key, at, "must be a table of the effect's parameters"));
            };
            let known: Vec<&str> = info.parameters.iter().map(|p| p.name).collect();
            self.known(&format!("{key}."), table, &known)?;
            let mut values = BTreeMap::new();
            for (parameter, value) in table {
                let key = format!("{key}.{}", parameter.get_ref());
                values.insert(parameter.get_ref().to_string(), self.number(&key, value)?);
            }
            place(&mut EffectSet::default(), info, &values)
                .map_err(|error| self.key(&*key, at, format!("will not do: {error}")))?;
            out.insert(info.name.to_owned(), Listed::Known(values));
        }
        Ok(out)
    }

    /// Refuses the name of an effect of the catalogue that is no formula.
    fn own_name(&self, key: &str, at: usize, name: &str) -> Result<(), FileError> {
        if info(name).is_ok() && shipped_effects().iter().all(|h| h.name != name) {
            return Err(self.key(
                key,
                at,
                "is the name of an effect of the library, which is no formula: take another",
            ));
        }
        Ok(())
    }

    /// The line of `value = ` inside the table at `offset`, when it is written as its own table.
    fn value_offset(&self, offset: usize) -> usize {
        let rest = self.text.get(offset..).unwrap_or("");
        rest.find("value").map_or(offset, |at| offset + at)
    }
}

fn place(set: &mut EffectSet, info: &EffectInfo, values: &BTreeMap<String, f64>) -> Result<(), EffectError> {
    let values: Vec<f64> = info.parameters.iter().map(|p| values.get(p.name).copied().unwrap_or(p.absent)).collect();
    set.set(info.name, &values)
}

fn effect_set(listed: &BTreeMap<String, Listed>) -> EffectSet {
    let mut set = EffectSet::default();
    for (name, listed) in listed {
        match listed {
            // Both were checked when the file was read; what was put there since and will not do is left out.
            Listed::Known(values) => {
                if let Ok(info) = info(name) {
                    let _ = place(&mut set, info, values);
                }
            }
            Listed::Formula(formula) => set.put(formula.clone()),
        }
    }
    set
}

/// The hypotheses in a file of `[effects.NAME]` tables, a formula each; `file` is its name in messages.
///
/// # Errors
/// Names the key and the line of the first thing that will not do.
pub fn parse_hypotheses(file: &str, text: &str) -> Result<Vec<Hypothesis>, MotorError> {
    let reader = Reader { file, text };
    let admissible = |key: &str, at: usize, name: &str| match name {
        DESCRIBED => {
            Err(reader.key(key, at, "is the name of what a diagnosis describes without a cause: take another"))
        }
        _ => reader.own_name(key, at, name),
    };
    Ok(reader.hypotheses(&admissible)?)
}

impl Motor {
    /// Reads a motor file's text; `file` is its name in messages.
    ///
    /// # Errors
    /// Names the key and the line of the first thing that will not do.
    pub fn parse(file: &str, text: &str) -> Result<Self, MotorError> {
        let reader = Reader { file, text };
        let root = reader.root()?;
        match root.get_ref().get("plant") {
            Some(plant) => {
                let problem = "makes this the file of an ordinary motor, which `twum compare`, `twum model speed` and `twum model sweep` \
                               take; what drives the board's firmware takes a TWUM";
                Err(reader.key("plant", plant.span().start, problem).into())
            }
            None => Ok(reader.motor(&root)?),
        }
    }

    /// A shipped motor by its name, and nothing else: a name in somebody's data must not open a file.
    ///
    /// # Errors
    /// [`MotorError::NotShipped`] for any other name.
    pub fn shipped(name: &str) -> Result<Self, MotorError> {
        match SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
            Some((name, text)) => Self::parse(name, text),
            None => Err(MotorError::NotShipped { name: name.into() }),
        }
    }

    /// A shipped motor by its name, or a motor file by its path.
    ///
    /// # Errors
    /// When there is neither, or the file will not do.
    pub fn load(name_or_path: &str) -> Result<Self, MotorError> {
        if SHIPPED.iter().any(|(name, _)| *name == name_or_path) {
            return Self::shipped(name_or_path);
        }
        let text = input::text(Path::new(name_or_path), input::WRITTEN)
            .map_err(|reason| MotorError::Read { file: name_or_path.into(), reason })?;
        Self::parse(name_or_path, &text)
    }

    /// The effects that a file of `[effects.NAME]` tables lists, written as in a motor file.
    ///
    /// # Errors
    /// Names the key and the line of the first thing that will not do.
    pub fn effects_of_file(path: &Path) -> Result<EffectSet, MotorError> {
        let file = path.display().to_string();
        let text = input::text(path, input::WRITTEN)
            .map_err(|reason| MotorError::ReadEffects { file: file.clone(), reason })?;
        let reader = Reader { file: &file, text: &text };
        let root = reader.root()?;
        reader.known("", root.get_ref(), &["effects"])?;
        let listed = reader.effects(root.get_ref())?;
        Ok(effect_set(&listed))
    }

    /// What a recording keeps of a motor: the name of a shipped one, or the content of a motor file, which may be changed or
    /// gone when the recording is read.
    ///
    /// # Errors
    /// As [`Motor::load`].
    pub fn kept(name_or_path: &str) -> Result<String, MotorError> {
        if SHIPPED.iter().any(|(name, _)| *name == name_or_path) {
            return Ok(name_or_path.to_owned());
        }
        let motor = Self::load(name_or_path)?;
        let text = input::text(Path::new(name_or_path), input::WRITTEN)
            .map_err(|reason| MotorError::Read { file: name_or_path.into(), reason })?;
        // A name has no line end, the content of a file always one.
        debug_assert!(!motor.name.contains('\n'));
        Ok(format!("{}\n", text.trim_end()))
    }

    /// The 30 mm PCBMotor.
    pub fn pcbmotor_30mm() -> Self {
        Self::shipped("pcbmotor-30mm").expect("the shipped file is checked by a test")
    }

    /// The parameters in a flavour.
    pub fn parameters(&self, flavour: Flavour) -> Parameters {
        let mut values = [0.0; 20];
        for (value, spec) in values.iter_mut().zip(&SPECS) {
            *value = self.entry(flavour, spec.name).unwrap_or(&self.parameters[spec.name]).value;
        }
        Parameters::from_array(values)
    }

    /// Sets a number of an effect of the catalogue, which is listed if it was not.
    pub fn put_effect(&mut self, effect: &str, parameter: &str, value: f64) {
        let listed = self.effects.entry(effect.to_owned()).or_insert_with(|| Listed::Known(BTreeMap::new()));
        if let Listed::Known(values) = listed {
            values.insert(parameter.to_owned(), value);
        }
    }

    /// The effects the file lists.
    pub fn effects(&self) -> EffectSet {
        effect_set(&self.effects)
    }

    /// What the file says of a parameter in a flavour; none for a name that is not in [`SPECS`].
    pub fn entry(&self, flavour: Flavour, name: &str) -> Option<&Entry> {
        let own = match flavour {
            Flavour::Thesis => None,
            Flavour::Physical => self.physical.get(name),
            Flavour::Measured => self.measured.get(name),
        };
        own.or_else(|| self.parameters.get(name))
    }

    /// The file that says the same, comments aside.
    ///
    /// # Errors
    /// Never for a motor that was parsed.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}
