//! `measurement.toml`.

use super::lines::{self, Budget};
use super::units::{PositionUnit, SpeedUnit, TimeUnit, Units};
use super::{
    ControlGains, ControlSpec, DEFAULT_EDGES_PER_REV, DEFAULT_PWM_HZ, Direction, Format, MANIFEST, MAX_RUNS,
    Measurement, MeasurementError, Run, RunKind, packed, table,
};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::io::BufRead;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use toml::Spanned;
use twum_files::input;

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Manifest {
    pub(super) name: String,
    pub(super) motor: Spanned<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) edges_per_rev: Option<Spanned<u32>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) time_unit: Option<TimeUnit>,
    /// Says what the inputs are in; they are taken as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) input_unit: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) position_unit: Option<PositionUnit>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) speed_unit: Option<SpeedUnit>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) counts_per_turn: Option<Spanned<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mm_per_turn: Option<Spanned<f64>>,
    #[serde(default)]
    pub(super) run: Vec<Entry>,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Entry {
    pub(super) id: Spanned<String>,
    pub(super) kind: RunKind,
    pub(super) file: Spanned<String>,
    pub(super) format: Format,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) duty: Option<Spanned<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) direction: Option<Direction>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) pwm_hz: Option<Spanned<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) drive_on_s: Option<Spanned<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) pwm_phase_s: Option<Spanned<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) aligned: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) order: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) control: Option<Spanned<toml::Value>>,
}

/// Whether a motor is named by a file rather than by a shipped set's name.
pub(super) fn names_a_file(motor: &str) -> bool {
    !motor.contains('\n') && (motor.contains(['/', '\\']) || motor.ends_with(".toml"))
}

/// What a measurement is read from: a folder, or anything else that holds texts by name.
pub trait Files {
    /// Where the file of this name, as `measurement.toml` gives it, is to be opened.
    ///
    /// # Errors
    /// Why there is no such file here.
    fn resolve(&self, name: &str) -> Result<PathBuf, String>;

    /// Opens what [`Files::resolve`] gave.
    ///
    /// # Errors
    /// When it cannot be read.
    fn open(&self, path: &Path) -> Result<Box<dyn BufRead>, MeasurementError>;
}

struct Folder<'a>(&'a Path);

impl Files for Folder<'_> {
    /// A file named in the folder's own text must not lead out of the folder, not even by a symbolic link.
    fn resolve(&self, name: &str) -> Result<PathBuf, String> {
        inside(self.0, name)
    }

    fn open(&self, path: &Path) -> Result<Box<dyn BufRead>, MeasurementError> {
        lines::open(path)
    }
}

pub(super) fn load(folder: &Path) -> Result<Measurement, MeasurementError> {
    read(folder, Text::read(folder)?, &Folder(folder))
}

pub(super) fn parse(folder: &Path, manifest: &str, files: &impl Files) -> Result<Measurement, MeasurementError> {
    read(folder, Text { path: folder.join(MANIFEST), text: manifest.to_owned() }, files)
}

fn read(folder: &Path, manifest: Text, files: &impl Files) -> Result<Measurement, MeasurementError> {
    let parsed: Manifest = toml::from_str(&manifest.text).map_err(|error| {
        let at = error.span().unwrap_or(0..0);
        manifest.error(at, error.message())
    })?;
    if parsed.run.is_empty() {
        return Err(manifest.error(0..0, "no [[run]]: a measurement holds at least one"));
    }
    if parsed.run.len() > MAX_RUNS {
        return Err(manifest.error(0..0, format!("{} runs: at most {MAX_RUNS} a folder", parsed.run.len())));
    }
    if names_a_file(parsed.motor.get_ref()) {
        files
            .resolve(parsed.motor.get_ref())
            .map_err(|what| manifest.error(parsed.motor.span(), format!("motor: {what}")))?;
    }
    let edges_per_rev = edges_per_rev(&parsed, &manifest)?;
    let units = units(&parsed, &manifest)?;
    let mut budget = Budget::new();
    let mut ids = HashSet::new();
    let mut runs = Vec::with_capacity(parsed.run.len());
    for entry in parsed.run {
        let id = entry.id.get_ref();
        if id.is_empty() || id.len() > 200 || id.chars().any(char::is_control) {
            return Err(manifest.error(entry.id.span(), "id: 1 to 200 printable characters"));
        }
        if !ids.insert(id.clone()) {
            return Err(manifest.error(entry.id.span(), format!("id `{id}` names two runs")));
        }
        runs.push(entry.load(files, &manifest, &units, &mut budget)?);
    }
    Ok(Measurement {
        name: parsed.name,
        motor: parsed.motor.into_inner(),
        edges_per_rev,
        runs,
        folder: folder.to_owned(),
    })
}

fn edges_per_rev(parsed: &Manifest, manifest: &Text) -> Result<u32, MeasurementError> {
    match &parsed.edges_per_rev {
        Some(edges) if (1..=1_000_000).contains(edges.get_ref()) => Ok(*edges.get_ref()),
        Some(edges) => Err(manifest.error(edges.span(), "edges_per_rev: 1 to 1000000")),
        None if parsed.motor.get_ref() != "pcbmotor-30mm" && parsed.run.iter().any(|run| run.format.counts_edges()) => {
            Err(manifest.error(
                parsed.motor.span(),
                "edges_per_rev is missing: say how many encoder edges (both rising and falling) a revolution has",
            ))
        }
        None => Ok(DEFAULT_EDGES_PER_REV),
    }
}

fn units(parsed: &Manifest, manifest: &Text) -> Result<Units, MeasurementError> {
    let above_0 = |value: &Option<Spanned<f64>>, key: &str| match value {
        Some(value) if !(value.get_ref().is_finite() && *value.get_ref() > 0.0) => {
            Err(manifest.error(value.span(), format!("{key} {} is not above 0", value.get_ref())))
        }
        value => Ok(value.as_ref().map(|value| *value.get_ref())),
    };
    Ok(Units {
        time: parsed.time_unit,
        position: parsed.position_unit,
        speed: parsed.speed_unit,
        counts_per_turn: above_0(&parsed.counts_per_turn, "counts_per_turn")?,
        mm_per_turn: above_0(&parsed.mm_per_turn, "mm_per_turn")?,
    })
}

impl Entry {
    fn load(
        self,
        files: &impl Files,
        manifest: &Text,
        units: &Units,
        budget: &mut Budget,
    ) -> Result<Run, MeasurementError> {
        let path = files
            .resolve(self.file.get_ref())
            .map_err(|what| manifest.error(self.file.span(), format!("file: {what}")))?;
        let bounded = |value: &Option<Spanned<f64>>, key: &str, range: Range<f64>, unit: &str| match value {
            Some(value) if !range.contains(value.get_ref()) => Err(manifest.error(
                value.span(),
                format!(
                    "{key} {} is out of range: from {} to below {} {unit}",
                    value.get_ref(),
                    range.start,
                    range.end
                ),
            )),
            value => Ok(value.as_ref().map(|value| *value.get_ref())),
        };
        let duty = match &self.duty {
            Some(duty) if !(0.0..=1.0).contains(duty.get_ref()) => {
                return Err(manifest.error(
                    duty.span(),
                    format!("duty {} is not a fraction of the PWM period with drive on, 0..1", duty.get_ref()),
                ));
            }
            Some(duty) => Some(*duty.get_ref()),
            None if self.format == Format::Packed => packed::duty_from_name(self.file.get_ref()).map(|(duty, _)| duty),
            None => None,
        };
        Ok(Run {
            kind: self.kind,
            format: self.format,
            duty,
            direction: self.direction,
            pwm_hz: bounded(&self.pwm_hz, "pwm_hz", 1e-3..1e6, "Hz")?.unwrap_or(DEFAULT_PWM_HZ),
            drive_on_s: bounded(&self.drive_on_s, "drive_on_s", 0.0..1e6, "s")?,
            pwm_phase_s: bounded(&self.pwm_phase_s, "pwm_phase_s", -1e3..1e3, "s")?.unwrap_or(0.0),
            aligned: self.aligned.unwrap_or(false),
            order: self.order,
            control: self.control.as_ref().map(|control| control_spec(control, manifest)).transpose()?,
            data: table::read(files.open(&path)?, &path, self.format, units, budget)?,
            id: self.id.into_inner(),
            file: self.file.into_inner(),
        })
    }
}

fn control_spec(control: &Spanned<toml::Value>, manifest: &Text) -> Result<ControlSpec, MeasurementError> {
    let wrong = |what: String| manifest.error(control.span(), format!("control: {what}"));
    match control.get_ref() {
        toml::Value::String(name) if name == "thesis" => Ok(ControlSpec::Thesis),
        toml::Value::String(name) if name == "default" => Ok(ControlSpec::Default),
        toml::Value::Table(_) => {
            let gains: ControlGains = control
                .get_ref()
                .clone()
                .try_into()
                .map_err(|error: toml::de::Error| wrong(error.message().to_owned()))?;
            gains.validate().map_err(wrong)?;
            Ok(ControlSpec::Table(gains))
        }
        _ => Err(wrong("\"thesis\", \"default\" or a table of gains".to_owned())),
    }
}

impl ControlGains {
    pub(super) fn validate(&self) -> Result<(), String> {
        let Self { kp, ki, kd, period_us, duty_steps, integral_min, integral_max } = *self;
        if [kp, ki, kd, integral_min, integral_max].iter().any(|value| !value.is_finite()) {
            return Err("gains and clamps must be finite".to_owned());
        }
        if !(1.0..=1e6).contains(&period_us) {
            return Err(format!("period_us {period_us} is out of range: 1 to 1000000"));
        }
        if !(1..=65_536).contains(&duty_steps) {
            return Err(format!("duty_steps {duty_steps} is out of range: 1 to 65536"));
        }
        if integral_min > integral_max {
            return Err(format!("integral_min {integral_min} exceeds integral_max {integral_max}"));
        }
        Ok(())
    }
}

/// The path a name of `measurement.toml` stands for, if it is one below the folder.
///
/// # Errors
/// For an absolute path, one with `..` or `\\`, and none at all.
pub fn below(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let relative = Path::new(name);
    let plain = relative.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if name.is_empty() || !plain || name.contains(['\\', '\0']) {
        return Err(format!("`{}` must be a path below the folder, with `/` and without `..`", name.escape_debug()));
    }
    Ok(folder.join(relative))
}

/// As [`below`], and it must not lead out of the folder by a symbolic link either.
pub(super) fn inside(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let path = below(folder, name)?;
    let resolve = |path: &Path| path.canonicalize().map_err(|source| format!("{}: {source}", path.display()));
    let (root, target) = (resolve(folder)?, resolve(&path)?);
    if !target.starts_with(&root) {
        return Err(format!("`{name}` is a link out of the folder"));
    }
    Ok(path)
}

/// The text of `measurement.toml`, to turn positions into lines and columns.
struct Text {
    path: PathBuf,
    text: String,
}

impl Text {
    fn read(folder: &Path) -> Result<Self, MeasurementError> {
        let path = folder.join(MANIFEST);
        let bytes = input::bytes(&path, input::WRITTEN).map_err(|source| MeasurementError::io(&path, source))?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let (line, column) = line_column(error.as_bytes(), error.utf8_error().valid_up_to());
            MeasurementError::at(&path, line, column, "not UTF-8 text")
        })?;
        Ok(Self { path, text })
    }

    fn error(&self, span: Range<usize>, message: impl Into<String>) -> MeasurementError {
        let (line, column) = line_column(self.text.as_bytes(), span.start);
        MeasurementError::at(&self.path, line, column, message)
    }
}

fn line_column(text: &[u8], offset: usize) -> (usize, usize) {
    let before = &text[..offset.min(text.len())];
    let line_start = before.iter().rposition(|byte| *byte == b'\n').map_or(0, |newline| newline + 1);
    (1 + before.iter().filter(|byte| **byte == b'\n').count(), 1 + before.len() - line_start)
}
