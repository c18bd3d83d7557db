//! Runs from wherever they are: a measurement folder or a recording.

use super::export::{EncoderSource, ExportError, to_measurement};
use super::measurement::{MANIFEST, Measurement, MeasurementError};
use super::recording::Recording;
use super::store::StoreError;
use std::path::{Path, PathBuf};

/// Part of the name of a recording whose run was cut short: no run of a folder.
pub const CUT_SHORT: &str = "cut-short";

/// Why no runs could be read.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The measurement folder is not in order.
    #[error(transparent)]
    Measurement(#[from] MeasurementError),
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] StoreError),
    /// The recording holds no run.
    #[error("{path}: {reason}")]
    NoRun {
        /// The recording.
        path: String,
        /// Why.
        reason: ExportError,
    },
    /// Nothing is there.
    #[error("{path}: no such file or folder")]
    Missing {
        /// As it was given.
        path: String,
    },
    /// Several measurements below a folder.
    #[error("{path} holds several measurements, name one: {folders}")]
    Several {
        /// The folder.
        path: String,
        /// Those below.
        folders: String,
    },
    /// Recordings that do not belong together.
    #[error("{path}: its motor or encoder is not that of the recordings before it in the folder: name one recording")]
    Mixed {
        /// The recording.
        path: String,
    },
}

/// Reads a measurement folder (or its `measurement.toml`), or the runs of a recording, with timestamped edges where there are
/// some; or of a folder of either, such as `twum experiment run` makes. The notes say what was lost or left out of a recording.
///
/// # Errors
/// As [`Measurement::load`], [`Recording::load`] and [`to_measurement`]; when a folder holds several measurements.
pub fn load_runs(path: &Path) -> Result<(Measurement, Vec<String>), LoadError> {
    if !path.exists() {
        return Err(LoadError::Missing { path: path.display().to_string() });
    }
    if path.is_file() && path.file_name().is_none_or(|name| name != MANIFEST) {
        return recorded(path);
    }
    let folder = measurement_folder(path)?;
    if !folder.join(MANIFEST).exists() {
        let recordings = recordings_in(&folder);
        if !recordings.is_empty() {
            return all_recorded(&folder, &recordings);
        }
    }
    Ok((Measurement::load(folder)?, Vec::new()))
}

/// The folder that holds the `measurement.toml` meant by a path: itself, its parent when the path is the file, or the one folder
/// below that has one. A path without any is given back.
///
/// # Errors
/// [`LoadError::Several`] when more than one folder below has one.
pub fn measurement_folder(path: &Path) -> Result<PathBuf, LoadError> {
    if path.file_name().is_some_and(|name| name == MANIFEST) {
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        return Ok(parent.unwrap_or(Path::new(".")).to_owned());
    }
    if path.join(MANIFEST).exists() {
        return Ok(path.to_owned());
    }
    let below: Vec<PathBuf> = entries(path).into_iter().filter(|entry| entry.join(MANIFEST).exists()).collect();
    match below.as_slice() {
        [] => Ok(path.to_owned()),
        [one] => Ok(one.clone()),
        several => Err(LoadError::Several {
            path: path.display().to_string(),
            folders: several.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", "),
        }),
    }
}

/// What a folder holds, by name; nothing of one that cannot be read, which loading it then says.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let read = std::fs::read_dir(folder).into_iter().flatten();
    let mut entries: Vec<PathBuf> = read.filter_map(|entry| Some(entry.ok()?.path())).collect();
    entries.sort();
    entries
}

fn recordings_in(folder: &Path) -> Vec<PathBuf> {
    let is_recording = |path: &PathBuf| {
        let cut_short = path.file_stem().is_some_and(|stem| stem.to_string_lossy().contains(CUT_SHORT));
        path.extension().is_some_and(|e| e == "mcap") && !cut_short && path.is_file()
    };
    let here: Vec<PathBuf> = entries(folder).into_iter().filter(is_recording).collect();
    if here.is_empty() { entries(&folder.join("recordings")).into_iter().filter(is_recording).collect() } else { here }
}

fn recorded(path: &Path) -> Result<(Measurement, Vec<String>), LoadError> {
    let recording = Recording::load(path)?;
    let name = path.file_stem().map_or_else(Default::default, |stem| stem.to_string_lossy());
    let (mut measurement, left_out) = to_measurement(&recording, &name, EncoderSource::Edges)
        .map_err(|reason| LoadError::NoRun { path: path.display().to_string(), reason })?;
    measurement.folder = path.to_owned();
    Ok((measurement, recording.losses().into_iter().chain(left_out).collect()))
}

/// The runs of all recordings of a folder, in the order of their names, which is that of `twum experiment run`.
fn all_recorded(folder: &Path, recordings: &[PathBuf]) -> Result<(Measurement, Vec<String>), LoadError> {
    let (mut whole, mut notes): (Option<Measurement>, Vec<String>) = (None, Vec::new());
    for (order, path) in recordings.iter().enumerate() {
        let name = path.file_stem().map_or_else(Default::default, |stem| stem.to_string_lossy().into_owned());
        let (measurement, said) = match recorded(path) {
            // A recording beside runs may hold none, such as of an alignment.
            Err(error @ LoadError::NoRun { .. }) => {
                notes.push(error.to_string());
                continue;
            }
            other => other?,
        };
        notes.extend(said.into_iter().map(|note| format!("{name}: {note}")));
        let whole = whole.get_or_insert_with(|| Measurement {
            name: folder.file_name().map_or_else(Default::default, |n| n.to_string_lossy().into_owned()),
            runs: Vec::new(),
            folder: folder.to_owned(),
            ..measurement.clone()
        });
        if measurement.motor != whole.motor || measurement.edges_per_rev != whole.edges_per_rev {
            return Err(LoadError::Mixed { path: path.display().to_string() });
        }
        for (part, mut run) in measurement.runs.into_iter().enumerate() {
            run.id = if part == 0 { name.clone() } else { format!("{name}-{part}") };
            run.order = u32::try_from(order).ok();
            whole.runs.push(run);
        }
    }
    match whole {
        Some(whole) => Ok((whole, notes)),
        None => Ok((Measurement::load(folder)?, notes)),
    }
}
