//! Runs from wherever they are: a measurement folder or a recording.

use super::export::{EncoderSource, ExportError, to_measurement};
use super::measurement::{MANIFEST, Measurement, MeasurementError};
use super::recording::Recording;
use super::store::StoreError;
use std::path::Path;

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
}

/// Reads a measurement folder (or its `measurement.toml`), or the runs of a recording, with timestamped edges where there are
/// some. The notes say what was lost or left out of a recording.
///
/// # Errors
/// As [`Measurement::load`], [`Recording::load`] and [`to_measurement`].
pub fn load_runs(path: &Path) -> Result<(Measurement, Vec<String>), LoadError> {
    if path.file_name().is_some_and(|name| name == MANIFEST) {
        let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        return Ok((Measurement::load(folder)?, Vec::new()));
    }
    if !path.is_file() {
        return Ok((Measurement::load(path)?, Vec::new()));
    }
    let recording = Recording::load(path)?;
    let name = path.file_stem().map_or_else(Default::default, |stem| stem.to_string_lossy());
    let (mut measurement, left_out) = to_measurement(&recording, &name, EncoderSource::Edges)
        .map_err(|reason| LoadError::NoRun { path: path.display().to_string(), reason })?;
    measurement.folder = path.to_owned();
    Ok((measurement, recording.losses().into_iter().chain(left_out).collect()))
}
