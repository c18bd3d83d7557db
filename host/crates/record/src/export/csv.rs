use super::{ExportError, rows};
use crate::recording::Recording;
use serde::Serialize;
use std::io;
use std::io::Write;
use std::path::Path;
use twum_files::output::{NewFolder, OutputError};

/// Writes what a recording holds as tables into a new folder: `control.csv`, `edges.csv`, `bits.csv`, `status.csv`,
/// `runs.csv` and `events.csv`. Times are the board's clock in µs within its `session` (its starts, from 0).
///
/// # Errors
/// When the folder exists and is not empty, or writing fails.
pub fn write_csv(recording: &Recording, folder: &Path) -> Result<(), ExportError> {
    let mut folder = NewFolder::begin(folder)?;
    table(&mut folder, "control.csv", rows::control(recording))?;
    table(&mut folder, "edges.csv", rows::edges(recording))?;
    table(&mut folder, "bits.csv", rows::levels(recording))?;
    table(&mut folder, "status.csv", rows::status(recording))?;
    table(&mut folder, "runs.csv", rows::runs(recording))?;
    table(&mut folder, "events.csv", rows::events(recording))?;
    Ok(folder.finish()?)
}

/// Writes rows under a header of their fields' names, which stands there without a row too.
fn table<R: Serialize + Default>(
    folder: &mut NewFolder,
    name: &str,
    rows: impl Iterator<Item = R>,
) -> Result<(), OutputError> {
    let mut example = ::csv::Writer::from_writer(Vec::new());
    example.serialize(R::default()).expect("a row has fields that a table can hold");
    let example = example.into_inner().unwrap_or_default();
    let header = example.split_inclusive(|byte| *byte == b'\n').next().unwrap_or_default();
    folder.file(name, |out| {
        let write = || -> io::Result<()> {
            out.write_all(header)?;
            let mut table = ::csv::WriterBuilder::new().has_headers(false).from_writer(&mut *out);
            for row in rows {
                table.serialize(row)?;
            }
            table.flush()
        };
        write().map_err(|reason| out.failed(reason))
    })
}
