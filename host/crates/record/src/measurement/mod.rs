//! The measurement folder: `measurement.toml` and one text file a run.
//!
//! It is what `twum compare` and `twum diagnose` read, and what a person without this project's firmware can write by
//! hand. `docs/recording.md` describes every key and column.
//!
//! Loading trusts nothing: files named in `measurement.toml` must lie inside the folder, every number must be finite
//! and in its range, and sizes are bounded ([`MAX_LOADED_BYTES`], [`MAX_RUNS`], [`MAX_RECORD_S`]).

mod control;
mod error;
mod lines;
mod manifest;
mod packed;
mod table;
mod units;
mod write;

pub use control::ControlError;
pub use error::MeasurementError;
pub use manifest::{Files, below};

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the file that describes the folder.
pub const MANIFEST: &str = "measurement.toml";
/// Bound on the samples one folder may bring into memory, in bytes.
pub const MAX_LOADED_BYTES: usize = 1 << 30;
/// Bound on the runs of one folder.
pub const MAX_RUNS: usize = 10_000;
/// Bound on the length of one record, in seconds: whoever resamples a record needs a bound on the result.
pub const MAX_RECORD_S: f64 = 86_400.0;
/// Largest absolute time of a sample, in µs: beyond it an f64 no longer resolves a fraction of a µs.
pub const MAX_TIME_US: f64 = 1e15;
/// Encoder edges a revolution of the 30 mm PCBMotor (thesis, A.7), assumed where nothing counts edges.
pub const DEFAULT_EDGES_PER_REV: u32 = 400;
/// PWM frequency of the driver board's hardware mode in Hz (thesis, C.1).
pub const DEFAULT_PWM_HZ: f64 = 50.0;

/// A measurement folder, loaded.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Free name, for people.
    pub name: String,
    /// A shipped parameter set's name, or a path to a parameter file relative to the folder (see [`Self::motor_file`]); of a
    /// recording, the content of that file (see [`Self::motor_text`]).
    pub motor: String,
    /// Encoder edges (both directions of change counted) a revolution.
    pub edges_per_rev: u32,
    /// The runs, in the order of the file.
    pub runs: Vec<Run>,
    /// Where it was loaded from.
    pub folder: PathBuf,
}

/// One run of the motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Unique within the folder.
    pub id: String,
    /// Open loop or closed loop.
    pub kind: RunKind,
    /// The data file, relative to the folder.
    pub file: String,
    /// How the data file is written.
    pub format: Format,
    /// Fraction of the PWM period with drive on, 0..1.
    pub duty: Option<f64>,
    /// Commanded direction.
    pub direction: Option<Direction>,
    /// PWM frequency in Hz.
    pub pwm_hz: f64,
    /// Drive from t = 0 to here, then off, in seconds.
    pub drive_on_s: Option<f64>,
    /// Time from the start of a PWM period to t = 0, in seconds.
    pub pwm_phase_s: f64,
    /// Whether the encoder stood at the beginning of a pulse at t = 0. Otherwise its phase is unknown within one pitch.
    pub aligned: bool,
    /// Position of this run in the order in which the runs were made.
    pub order: Option<u32>,
    /// The controller of a closed-loop run.
    pub control: Option<ControlSpec>,
    /// The samples.
    pub data: RunData,
}

/// How the motor was driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RunKind {
    /// Open loop at constant duty (or, with [`Format::Drive`], at the recorded input).
    Speed,
    /// Closed loop on a reference.
    Track,
}

/// Sense of rotation. Clockwise is direction pin high and counts as positive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Clockwise, positive.
    Cw,
    /// Counterclockwise, negative.
    Ccw,
}

impl Direction {
    /// `1.0` for clockwise, `-1.0` for counterclockwise.
    pub fn sign(self) -> f64 {
        match self {
            Self::Cw => 1.0,
            Self::Ccw => -1.0,
        }
    }
}

/// How a data file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// `time_us,level` on a regular grid.
    Levels,
    /// `time_us,level`, one row a transition between a first and a last row.
    Edges,
    /// The thesis's text: one binary number of up to 32 digits a line, first sample first, leading zeros lost, 1 ms a
    /// digit (thesis, C.1).
    Packed,
    /// `time_us,rpm`.
    Velocity,
    /// `time_us,target,position,u,duty,direction`.
    Control,
    /// `time_us,input,position_rad` or `time_us,input,speed_rpm`, then any of [`Beside`]; `current` for `input` says that it is one.
    Drive,
}

impl Format {
    /// The word used in `measurement.toml`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Levels => "levels",
            Self::Edges => "edges",
            Self::Packed => "packed",
            Self::Velocity => "velocity",
            Self::Control => "control",
            Self::Drive => "drive",
        }
    }

    fn counts_edges(self) -> bool {
        matches!(self, Self::Levels | Self::Edges | Self::Packed | Self::Control)
    }
}

/// The controller of a closed-loop run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ControlSpec {
    /// What the thesis's Arduino code did (thesis, C.2).
    Thesis,
    /// This project's default controller.
    Default,
    /// Another gain set.
    Table(ControlGains),
}

/// A PID gain set in encoder counts and duty steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlGains {
    /// Duty steps per count.
    pub kp: f64,
    /// Duty steps per count·s.
    pub ki: f64,
    /// Duty steps per count/s.
    pub kd: f64,
    /// Control period in µs.
    pub period_us: f64,
    /// Number of duty steps in a PWM period.
    pub duty_steps: u32,
    /// Lower clamp of the integral, in count·s.
    pub integral_min: f64,
    /// Upper clamp of the integral, in count·s.
    pub integral_max: f64,
}

/// The samples of one run. Times are in µs from the run's start, strictly increasing.
#[derive(Debug, Clone, PartialEq)]
pub enum RunData {
    /// The encoder line sampled on a regular grid: sample `i` was taken at `start_us + i * period_us`.
    Levels {
        /// Time of the first sample.
        start_us: f64,
        /// Sampling period.
        period_us: f64,
        /// Encoder line, one entry a sample.
        levels: Vec<bool>,
    },
    /// The encoder line's transitions with their times.
    Edges {
        /// Level before the first edge.
        initial: bool,
        /// Start of the record.
        start_us: f64,
        /// The transitions; levels alternate.
        edges: Vec<LevelEdge>,
        /// End of the record.
        end_us: f64,
    },
    /// Speed estimated elsewhere.
    Velocity {
        /// Sample times.
        time_us: Vec<f64>,
        /// Speed in revolutions a minute, signed.
        rpm: Vec<f64>,
    },
    /// Samples of the control loop.
    Control(Vec<ControlRow>),
    /// Input and output of an ordinary motor.
    Drive {
        /// Sample times.
        time_us: Vec<f64>,
        /// The known input, in the unit of the motor's parameter set.
        input: Vec<f64>,
        /// What was measured, one entry a sample.
        response: DriveResponse,
        /// What was recorded beside them, one entry a sample each.
        beside: BTreeMap<Beside, Vec<f64>>,
    },
}

/// One transition of the encoder line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelEdge {
    /// Time of the transition in µs.
    pub time_us: f64,
    /// Level after the transition.
    pub level: bool,
}

/// One sample of the control loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlRow {
    /// Time of the tick in µs.
    pub time_us: f64,
    /// Reference in encoder counts.
    pub target: f64,
    /// Position in encoder counts.
    pub position: f64,
    /// Controller output in signed duty steps.
    pub u: f64,
    /// Fraction of the PWM period with drive on, 0..1.
    pub duty: f64,
    /// Direction pin.
    pub direction: Direction,
}

/// The measured quantity of a [`Format::Drive`] run.
#[derive(Debug, Clone, PartialEq)]
pub enum DriveResponse {
    /// Angle in radians.
    PositionRad(Vec<f64>),
    /// Speed in revolutions a minute.
    SpeedRpm(Vec<f64>),
}

/// A column that may stand beside those that every [`Format::Drive`] run has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Beside {
    /// Torque or force of a load, in any unit; positive brakes motion that is counted positive under a positive input.
    Load,
    /// What a controller was asked for, in the unit of what is measured.
    Reference,
    /// Current, in any unit.
    Current,
    /// Temperature in °C.
    Temperature,
}

impl Beside {
    /// All, in the order in which they are written.
    pub const ALL: [Self; 4] = [Self::Load, Self::Reference, Self::Current, Self::Temperature];

    /// The column's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Load => "load",
            Self::Reference => "reference",
            Self::Current => "current",
            Self::Temperature => "temperature",
        }
    }
}

impl Measurement {
    /// Loads a measurement folder and every data file it names.
    ///
    /// # Errors
    /// Names the file, line and column of the first thing that is wrong; see the module's documentation for the bounds.
    pub fn load(folder: impl AsRef<Path>) -> Result<Self, MeasurementError> {
        manifest::load(folder.as_ref())
    }

    /// Reads a measurement whose `measurement.toml` is `manifest` and whose data files are `files`; `folder` is its place
    /// in messages.
    ///
    /// # Errors
    /// As [`Measurement::load`].
    pub fn parse(folder: &Path, manifest: &str, files: &impl Files) -> Result<Self, MeasurementError> {
        manifest::parse(folder, manifest, files)
    }

    /// Loads a folder of the thesis's own text files, `Duty_<d>_<n>.txt`, without a `measurement.toml`.
    ///
    /// The duty in those names is the fraction of the PWM period in which the *active-low* pin is high, the decimal
    /// point removed (thesis, A.7 and C.1); [`Run::duty`] is the fraction with drive on. The files do not say in which
    /// direction the motor turned: `direction` says it for all of them. The drive was on for 5 s (thesis, C.1).
    ///
    /// # Errors
    /// When the folder holds no such file, and as [`Measurement::load`].
    pub fn load_thesis_texts(folder: impl AsRef<Path>, direction: Direction) -> Result<Self, MeasurementError> {
        packed::load_folder(folder.as_ref(), direction)
    }

    /// Writes the measurement into a new folder and returns it as it would load from there. `packed` runs become
    /// `levels`; a motor file inside the folder is copied.
    ///
    /// # Errors
    /// When the folder exists and is not empty (nothing is ever overwritten), when a run breaks a rule of the format,
    /// or when writing fails.
    pub fn save(&self, folder: impl AsRef<Path>) -> Result<Self, MeasurementError> {
        write::save(self, folder.as_ref())
    }

    /// The content of a motor file, when [`Self::motor`] is that: a recording keeps the file, not its name.
    pub fn motor_text(&self) -> Option<&str> {
        self.motor.contains('\n').then_some(&*self.motor)
    }

    /// The motor parameter file, when [`Self::motor`] is a path; `None` when it is the name of a shipped set.
    pub fn motor_file(&self) -> Option<PathBuf> {
        manifest::names_a_file(&self.motor).then(|| self.folder.join(&self.motor))
    }
}

impl Run {
    /// A run of which nothing but its samples is known; the other fields take the format's defaults.
    pub fn new(id: impl Into<String>, kind: RunKind, data: RunData) -> Self {
        Self {
            id: id.into(),
            kind,
            file: String::new(),
            format: data.format(),
            duty: None,
            direction: None,
            pwm_hz: DEFAULT_PWM_HZ,
            drive_on_s: None,
            pwm_phase_s: 0.0,
            aligned: false,
            order: None,
            control: None,
            data,
        }
    }

    /// Whether a `packed` record ended because its last words were equal (the rule of the thesis's capture, C.1), not
    /// because the run was over: what came later is then unknown, not standstill.
    pub fn stopped_by_equal_words(&self) -> bool {
        self.format == Format::Packed
            && matches!(&self.data, RunData::Levels { levels, .. } if packed::stopped_by_equal_words(levels))
    }

    /// First and last time of the record in µs.
    pub fn span_us(&self) -> (f64, f64) {
        let ends = |times: &[f64]| match (times.first(), times.last()) {
            (Some(first), Some(last)) => (*first, *last),
            _ => (0.0, 0.0),
        };
        match &self.data {
            RunData::Levels { start_us, period_us, levels } => {
                (*start_us, start_us + period_us * levels.len().saturating_sub(1) as f64)
            }
            RunData::Edges { start_us, end_us, .. } => (*start_us, *end_us),
            RunData::Velocity { time_us, .. } | RunData::Drive { time_us, .. } => ends(time_us),
            RunData::Control(rows) => match (rows.first(), rows.last()) {
                (Some(first), Some(last)) => (first.time_us, last.time_us),
                _ => (0.0, 0.0),
            },
        }
    }
}

impl RunData {
    /// The format these samples are written in.
    pub fn format(&self) -> Format {
        match self {
            Self::Levels { .. } => Format::Levels,
            Self::Edges { .. } => Format::Edges,
            Self::Velocity { .. } => Format::Velocity,
            Self::Control(_) => Format::Control,
            Self::Drive { .. } => Format::Drive,
        }
    }

    /// Number of samples (for edges, of transitions).
    pub fn len(&self) -> usize {
        match self {
            Self::Levels { levels, .. } => levels.len(),
            Self::Edges { edges, .. } => edges.len(),
            Self::Velocity { time_us, .. } | Self::Drive { time_us, .. } => time_us.len(),
            Self::Control(rows) => rows.len(),
        }
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests;
