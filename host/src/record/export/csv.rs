use super::{ExportError, create_new, rows};
use crate::record::recording::Recording;
use serde::Serialize;
use std::fs;
use std::io::Write;
use std::path::Path;

/// Writes what a recording holds as tables into a new folder: `control.csv`, `edges.csv`, `bits.csv`, `status.csv`,
/// `runs.csv` and `events.csv`. Times are the board's clock in µs within its `session` (its starts, from 0).
///
/// # Errors
/// When the folder exists and is not empty, or writing fails.
pub fn write_csv(recording: &Recording, folder: &Path) -> Result<(), ExportError> {
    let io_error = |reason| ExportError::Io { path: folder.to_owned(), reason };
    fs::create_dir_all(folder).map_err(io_error)?;
    if fs::read_dir(folder).map_err(io_error)?.next().is_some() {
        return Err(ExportError::Exists(folder.to_owned()));
    }
    table(folder, "control.csv", rows::control(recording))?;
    table(folder, "edges.csv", rows::edges(recording))?;
    table(folder, "bits.csv", rows::levels(recording))?;
    table(folder, "status.csv", rows::status(recording))?;
    table(folder, "runs.csv", rows::runs(recording))?;
    table(folder, "events.csv", rows::events(recording))
}

/// Writes rows under a header of their fields' names, which stands there without a row too.
fn table<R: Serialize + Default>(folder: &Path, name: &str, rows: impl Iterator<Item = R>) -> Result<(), ExportError> {
    let path = folder.join(name);
    let failed = |reason: ::csv::Error| ExportError::Io { path: path.clone(), reason: reason.into() };
    let mut example = ::csv::Writer::from_writer(Vec::new());
    example.serialize(R::default()).map_err(failed)?;
    let example = example.into_inner().unwrap_or_default();
    let header = example.split_inclusive(|byte| *byte == b'\n').next().unwrap_or_default();
    let mut file = create_new(&path)?;
    file.write_all(header).map_err(|reason| ExportError::Io { path: path.clone(), reason })?;
    let mut out = ::csv::WriterBuilder::new().has_headers(false).from_writer(file);
    for row in rows {
        out.serialize(row).map_err(failed)?;
    }
    let mut file =
        out.into_inner().map_err(|reason| ExportError::Io { path: path.clone(), reason: reason.into_error() })?;
    file.flush().map_err(|reason| ExportError::Io { path, reason })
}
