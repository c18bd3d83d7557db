//! Decoded forms of a recording. None of them is ever an edit of it, and none overwrites a file.

mod csv;
mod folder;
mod mcap;
mod rows;

pub use csv::write_csv;
pub use folder::{EncoderSource, to_measurement};
pub(super) use mcap::LOG_SCHEMA;
pub use mcap::write_mcap;

use super::measurement::MeasurementError;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a recording cannot be exported.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The system refused.
    #[error("{}: {reason}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's reason.
        reason: io::Error,
    },
    /// The target is there already.
    #[error("{}: exists; nothing is overwritten, choose another name", .0.display())]
    Exists(PathBuf),
    /// The recording holds no run that could be exported.
    #[error("no run in the recording: a measurement folder is made of runs; use `--to csv` or `--to mcap`")]
    NoRun,
    /// The folder could not be written.
    #[error(transparent)]
    Measurement(#[from] MeasurementError),
    /// The MCAP file could not be written.
    #[error("{}: {reason}", path.display())]
    Mcap {
        /// File.
        path: PathBuf,
        /// The container's reason.
        reason: ::mcap::McapError,
    },
}

fn create_new(path: &Path) -> Result<BufWriter<File>, ExportError> {
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    file.map(BufWriter::new).map_err(|reason| match reason.kind() {
        io::ErrorKind::AlreadyExists => ExportError::Exists(path.to_owned()),
        _ => ExportError::Io { path: path.to_owned(), reason },
    })
}

#[cfg(test)]
mod tests;
