use std::path::{Path, PathBuf};
use thiserror::Error;

/// What was wrong with a measurement folder, and where.
#[derive(Debug, Error)]
pub enum MeasurementError {
    /// A file or folder could not be read or written.
    #[error("{}: {reason}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's reason.
        reason: std::io::Error,
    },
    /// A folder could not be written.
    #[error(transparent)]
    Output(#[from] twum_files::output::OutputError),
    /// The content of a file is wrong at one place.
    #[error("{}:{line}:{column}: {message}", path.display())]
    At {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column in bytes, from 1.
        column: usize,
        /// What was wrong and what to do.
        message: String,
    },
    /// A file or folder as a whole is wrong.
    #[error("{}: {message}", path.display())]
    Whole {
        /// File or folder.
        path: PathBuf,
        /// What was wrong and what to do.
        message: String,
    },
}

impl MeasurementError {
    pub(super) fn io(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason }
    }

    pub(super) fn at(path: &Path, line: usize, column: usize, message: impl Into<String>) -> Self {
        Self::At { path: path.to_owned(), line, column, message: message.into() }
    }

    pub(super) fn whole(path: &Path, message: impl Into<String>) -> Self {
        Self::Whole { path: path.to_owned(), message: message.into() }
    }
}
