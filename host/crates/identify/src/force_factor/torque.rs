//! Speeds under load and stalls, beside the runs of a folder.

use std::path::{Path, PathBuf};

/// A measured speed under a known load, beside the runs of a folder.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
pub struct Loaded {
    /// Duty, 0 to 1.
    pub duty: f64,
    /// Load against the motion (N·m).
    pub load_nm: f64,
    /// Speed (rpm).
    pub rpm: f64,
}

/// What a torque bench adds to the speed runs of a folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TorqueRuns {
    /// Speeds under load.
    pub loaded: Vec<Loaded>,
    /// Torques at which the rotor stalled at full drive (N·m).
    pub stall_nm: Vec<f64>,
}

/// Why a file of torque runs could not be read.
#[derive(Debug, thiserror::Error)]
pub enum TorqueError {
    /// It is no CSV, or could not be opened.
    #[error("{}: {cause}; expected the columns duty,load_nm,rpm", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: csv::Error,
    },
    /// A row cannot be.
    #[error("{}, line {line}: {message}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        message: String,
    },
}

/// Beyond what any motor of this kind does (mN m, and some tens of rpm) by three orders of magnitude, and by more than one: such a row
/// is a mistake, has no linearisation, and a model that turns so fast takes minutes.
const MAX_LOAD_NM: f64 = 10.0;
const MAX_RPM: f64 = 1_000.0;
/// A motor that a micronewton metre stops turns nothing: its friction alone is more.
const MIN_STALL_NM: f64 = 1e-6;

impl TorqueRuns {
    /// Adds the rows of a CSV file with the columns `duty`, `load_nm` and `rpm`; a row at full duty with `rpm` 0 is a stall.
    ///
    /// # Errors
    /// [`TorqueError`], with the line.
    pub fn read(&mut self, path: &Path) -> Result<(), TorqueError> {
        let csv_error = |cause| TorqueError::Csv { path: path.to_owned(), cause };
        let bytes =
            twum_files::input::bytes(path, twum_files::input::MEASURED).map_err(|cause| csv_error(cause.into()))?;
        let mut reader =
            csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(bytes.as_slice());
        let mut rows = reader.deserialize();
        while let Some(row) = rows.next() {
            let row: Loaded = row.map_err(csv_error)?;
            let line = rows.reader().position().line().saturating_sub(1);
            self.add(row).map_err(|message| TorqueError::Row { path: path.to_owned(), line, message })?;
        }
        Ok(())
    }

    /// Adds one speed under load, or a stall.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn add(&mut self, row: Loaded) -> Result<(), String> {
        let Loaded { duty, load_nm, rpm } = row;
        if !(duty > 0.0 && duty <= 1.0) {
            return Err(format!("duty {duty} is outside 0 to 1"));
        }
        if !(load_nm.abs() <= MAX_LOAD_NM && rpm.abs() <= MAX_RPM) {
            return Err(format!("load {load_nm} N m and {rpm} rpm must be within {MAX_LOAD_NM} N m and {MAX_RPM} rpm"));
        }
        if rpm > 0.0 {
            self.loaded.push(row);
        } else if rpm == 0.0 && duty == 1.0 && load_nm >= MIN_STALL_NM {
            self.stall_nm.push(load_nm);
        } else if rpm == 0.0 {
            return Err(format!(
                "a stall must be at duty 1 and a torque of {MIN_STALL_NM} N m or more, got duty {duty} and {load_nm} N m"
            ));
        } else {
            return Err(format!("{rpm} rpm: a load drives no motor backwards; take its sense as positive"));
        }
        Ok(())
    }
}
