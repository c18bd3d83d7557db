//! The trials of a friction folder: which files there are, and the torque in them.

use super::setup::{FrictionError, Setup};
use calamine::{Data, Reader};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a trial measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Set {
    /// Sliding, motor in place.
    Motor,
    /// The bench alone.
    NoMotor,
    /// Breaking away from rest, motor in place.
    Static,
}

impl Set {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Motor, Self::NoMotor, Self::Static];

    /// Folder names understood; the first is ours, the others the thesis's.
    fn folders(self) -> &'static [&'static str] {
        match self {
            Self::Motor => &["motor", "Kinetic/M", "M"],
            Self::NoMotor => &["no-motor", "Kinetic/NM", "NM"],
            Self::Static => &["static", "Static", "S"],
        }
    }
}

/// One trial's torque.
#[derive(Debug, Clone)]
pub struct Trial {
    /// File, for messages.
    pub path: PathBuf,
    /// Speed of the screw's motor (rpm).
    pub speed_rpm: u32,
    /// Number of the trial, from 1.
    pub number: usize,
    /// Torque with the configured sign (N·m), at the configured rate.
    pub torque_nm: Vec<f64>,
}

impl Trial {
    /// An error about this trial.
    pub fn error(&self, message: impl Into<String>) -> FrictionError {
        FrictionError::Trial { path: self.path.display().to_string(), message: message.into() }
    }
}

/// The trials of each set, by speed and number.
pub type Trials = BTreeMap<Set, Vec<Trial>>;

/// Reads every trial in `folder`.
///
/// # Errors
/// When a set or a trial is missing, or a file is not a column of finite numbers.
pub fn load(folder: &Path, setup: &Setup, allow_missing: bool) -> Result<Trials, FrictionError> {
    let mut files: BTreeMap<Set, BTreeMap<(u32, usize), PathBuf>> = BTreeMap::new();
    let mut roots: BTreeMap<Set, PathBuf> = BTreeMap::new();
    for set in Set::ALL {
        let root =
            set.folders().iter().map(|f| folder.join(f)).find(|f| f.is_dir()).ok_or_else(|| FrictionError::Setup {
                path: folder.display().to_string(),
                message: format!("no folder `{}` with its trials", set.folders()[0]),
            })?;
        files.insert(set, list(&root)?);
        roots.insert(set, root);
    }
    let speeds: Vec<u32> = setup.speeds_rpm.clone().unwrap_or_else(|| {
        let mut all: Vec<u32> = files.values().flatten().map(|((speed, _), _)| *speed).collect();
        all.sort_unstable();
        all.dedup();
        all
    });
    let count =
        setup.trials.unwrap_or_else(|| files.values().flatten().map(|((_, number), _)| *number).max().unwrap_or(0));
    let mut trials = Trials::new();
    let mut missing = Vec::new();
    for set in Set::ALL {
        let mut found = Vec::new();
        for &speed_rpm in &speeds {
            for number in 1..=count {
                match files[&set].get(&(speed_rpm, number)) {
                    Some(path) => {
                        found.push(Trial { path: path.clone(), speed_rpm, number, torque_nm: read(path, setup)? });
                    }
                    None => {
                        missing.push(roots[&set].join(format!("{speed_rpm}_rpm_{number}.csv")).display().to_string())
                    }
                }
            }
        }
        if found.is_empty() {
            return Err(FrictionError::Setup {
                path: roots[&set].display().to_string(),
                message: "no trial in it; name the files like `200_rpm_1.csv`".to_owned(),
            });
        }
        trials.insert(set, found);
    }
    if !missing.is_empty() && !allow_missing {
        return Err(FrictionError::Missing { missing: missing.join(", "), trials: count });
    }
    Ok(trials)
}

/// Files named `<speed>_rpm_<trial>.csv` or `.xlsx`.
fn list(root: &Path) -> Result<BTreeMap<(u32, usize), PathBuf>, FrictionError> {
    let io = |cause| FrictionError::Io { path: root.display().to_string(), cause };
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(root).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default().to_ascii_lowercase();
        if !matches!(extension.as_str(), "csv" | "xlsx") {
            continue;
        }
        let key =
            stem.split_once("_rpm_").and_then(|(speed, number)| Some((speed.parse().ok()?, number.parse().ok()?)));
        match key {
            Some((speed, number)) if speed > 0 && number > 0 => {
                if let Some(other) = files.insert((speed, number), path.clone()) {
                    return Err(FrictionError::Trial {
                        path: path.display().to_string(),
                        message: format!("the same trial as {}: keep one", other.display()),
                    });
                }
            }
            _ => {
                return Err(FrictionError::Trial {
                    path: path.display().to_string(),
                    message: "name trials by speed and number, like `200_rpm_1.csv`".to_owned(),
                });
            }
        }
    }
    Ok(files)
}

fn read(path: &Path, setup: &Setup) -> Result<Vec<f64>, FrictionError> {
    let bad = |message: String| FrictionError::Trial { path: path.display().to_string(), message };
    let excel = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xlsx"));
    let values = if excel { read_xlsx(path) } else { read_csv(path, setup) }.map_err(bad)?;
    let least = 4.0 * setup.sample_hz;
    if (values.len() as f64) < least {
        return Err(bad(format!("{} samples; a trial needs at least {least} (4 s)", values.len())));
    }
    Ok(values.into_iter().map(|v| v * setup.torque_sign).collect())
}

/// CSV: a column `torque_nm` (with or without `time_s`), comments with `#`; a bare column of numbers is taken as torque.
fn read_csv(path: &Path, setup: &Setup) -> Result<Vec<f64>, String> {
    let text = twum_files::input::text(path, twum_files::input::MEASURED).map_err(|e| e.to_string())?;
    let mut column: Option<usize> = None;
    let mut time: Option<usize> = None;
    let mut values = Vec::new();
    let mut times: Vec<f64> = Vec::new();
    for (index, raw) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let content = raw.trim();
        if content.is_empty() || content.starts_with('#') {
            continue;
        }
        let cells: Vec<&str> = content.split([',', ';', '\t']).map(str::trim).collect();
        let Some(column) = column else {
            if let Some(found) = cells.iter().position(|c| c.eq_ignore_ascii_case("torque_nm")) {
                column = Some(found);
                time = cells.iter().position(|c| c.eq_ignore_ascii_case("time_s"));
                continue;
            }
            if cells.len() == 1
                && let Ok(value) = cells[0].parse::<f64>()
            {
                column = Some(0);
                values.push(value);
                continue;
            }
            return Err(format!("line {}: expected a header with `torque_nm`, found `{content}`", index + 1));
        };
        let number = |at: usize, name: &str| {
            cells
                .get(at)
                .and_then(|c| c.parse::<f64>().ok())
                .filter(|v| v.is_finite())
                .ok_or_else(|| format!("line {}: column `{name}` is not a finite number: `{content}`", index + 1))
        };
        values.push(number(column, "torque_nm")?);
        if let Some(time) = time {
            times.push(number(time, "time_s")?);
        }
    }
    if let (Some(first), Some(last)) = (times.first(), times.last())
        && times.len() > 1
    {
        let rate = (times.len() - 1) as f64 / (last - first);
        if !(0.99..1.01).contains(&(rate / setup.sample_hz)) {
            return Err(format!("`time_s` says {rate:.1} Hz, friction.toml says sample_hz = {}", setup.sample_hz));
        }
    }
    Ok(values)
}

/// XLSX as the thesis had it: column B of the first sheet, headings above the first number skipped.
fn read_xlsx(path: &Path) -> Result<Vec<f64>, String> {
    let bytes = twum_files::input::bytes(path, twum_files::input::MEASURED).map_err(|e| e.to_string())?;
    let mut book = calamine::Xlsx::new(std::io::Cursor::new(bytes)).map_err(|e| e.to_string())?;
    let sheet =
        book.worksheet_range_at(0).ok_or_else(|| "the workbook has no sheet".to_owned())?.map_err(|e| e.to_string())?;
    let mut values = Vec::new();
    let last = sheet.end().map_or(0, |e| e.0);
    for row in sheet.start().map_or(0, |s| s.0)..=last {
        match sheet.get_value((row, 1)) {
            Some(Data::Float(v)) => values.push(*v),
            Some(Data::Int(v)) => values.push(*v as f64),
            None | Some(Data::Empty) if row == last || values.is_empty() => {}
            Some(Data::String(_)) if values.is_empty() => {}
            other => return Err(format!("cell B{} is not a number: {other:?}", row + 1)),
        }
    }
    if values.is_empty() { Err("column B holds no number".to_owned()) } else { Ok(values) }
}
