//! Decoded forms of a recording. None of them is ever an edit of it, and none overwrites a file.

mod csv;
mod folder;
mod mcap;
mod rows;

pub use csv::write_csv;
pub use folder::{EncoderSource, to_measurement};
pub use mcap::{LOG_SCHEMA, write_mcap};

use super::measurement::MeasurementError;
use std::path::PathBuf;
use thiserror::Error;
use twum_files::output::OutputError;

/// Why a recording cannot be exported.
#[derive(Debug, Error)]
pub enum ExportError {
    /// A file or folder could not be written.
    #[error(transparent)]
    Output(#[from] OutputError),
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

#[cfg(test)]
mod tests;
