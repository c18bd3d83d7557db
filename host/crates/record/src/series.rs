//! A planned series of runs in a folder: what was to be made, what has been, and what is left.
//!
//! `plan.json` holds the plan, `recordings/ID.mcap` one recording a run, `measurement/` what was made of them. A series that was
//! interrupted goes on with the runs that are not finished, in the plan's order.

use super::load::{CUT_SHORT, LoadError, load_runs};
use super::measurement::{Measurement, MeasurementError};
use super::recording::Recording;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use thiserror::Error;
use twum_files::input::{self, printable};
use twum_files::output::{self, Existing, OutputError};
use twum_shared::message::{RunEnd, SpeedRun};
use twum_shared::{Direction, Duty};

const RECORDINGS: &str = "recordings";
const PLAN: &str = "plan.json";

/// One run of a plan, as `plan.json` holds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeriesRun {
    /// Its name: that of its recording, and of the run in the measurement.
    pub id: String,
    /// Fraction of the PWM period with drive on.
    pub duty: f64,
    /// `cw` or `ccw`.
    pub direction: String,
    /// PWM frequency (Hz).
    pub pwm_hz: f64,
    /// Length of the drive (s).
    pub seconds: f64,
    /// Pause before it (s).
    pub pause_s: f64,
    /// What it decides.
    pub why: String,
}

/// What of a run no board can be told.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RunError {
    /// A duty that is no fraction.
    #[error("duty {0} is outside 0 to 1")]
    Duty(f64),
    /// A length that no run has.
    #[error("{0} s is outside 0.001 to 3600 s")]
    Seconds(f64),
    /// Neither way.
    #[error("direction `{0}` is neither `cw` nor `ccw`")]
    Direction(String),
    /// A pause that nobody waits for.
    #[error("a pause of {0} s is outside 0 to 3600 s")]
    Pause(f64),
    /// A frequency that the board does not make.
    #[error("pwm_hz {0} is outside 10 to 2000")]
    Pwm(f64),
    /// A name that is no file's.
    #[error("an id is one to 80 letters, digits and hyphens")]
    Id,
}

/// A length in s, between 1 ms and an hour, in ms.
///
/// # Errors
/// Outside of that.
pub fn duration_ms(seconds: f64) -> Result<u32, RunError> {
    if (0.001..=3600.0).contains(&seconds) {
        Ok((seconds * 1e3).round() as u32)
    } else {
        Err(RunError::Seconds(seconds))
    }
}

/// A run at a fraction of full duty for some seconds, as the board is told it.
///
/// # Errors
/// What the board cannot be told.
pub fn speed_run(duty: f64, direction: Direction, seconds: f64) -> Result<SpeedRun, RunError> {
    let raw = (duty * f64::from(Duty::FULL.raw())).round();
    let inside = (0.0..=1.0).contains(&duty).then_some(raw as u16).and_then(|raw| Duty::try_from(raw).ok());
    Ok(SpeedRun { duty: inside.ok_or(RunError::Duty(duty))?, direction, duration_ms: duration_ms(seconds)? })
}

impl SeriesRun {
    /// The run as the board is told it.
    ///
    /// # Errors
    /// What the board cannot be told.
    pub fn speed_run(&self) -> Result<SpeedRun, RunError> {
        let direction = match self.direction.as_str() {
            "cw" => Direction::Cw,
            "ccw" => Direction::Ccw,
            other => return Err(RunError::Direction(other.to_owned())),
        };
        speed_run(self.duty, direction, self.seconds)
    }

    /// Plans are written by hand too, and come from browsers.
    fn check(&self) -> Result<(), SeriesError> {
        let plain = self.id.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
        let wrong = if !plain || self.id.is_empty() || self.id.len() > 80 {
            Some(RunError::Id)
        } else if !(10.0..=2000.0).contains(&self.pwm_hz) {
            Some(RunError::Pwm(self.pwm_hz))
        } else if !(0.0..=3600.0).contains(&self.pause_s) {
            Some(RunError::Pause(self.pause_s))
        } else {
            self.speed_run().err()
        };
        wrong.map_or(Ok(()), |reason| Err(SeriesError::Run { id: printable(&self.id), reason }))
    }
}

/// Why a series cannot be begun, gone on with or ended.
#[derive(Debug, Error)]
pub enum SeriesError {
    /// The folder is there.
    #[error("{}: exists already; name a new folder, or go on with it by --resume", .0.display())]
    Exists(PathBuf),
    /// Nothing to go on with.
    #[error("{}: no series to go on with: it has no plan.json", .0.display())]
    NoPlan(PathBuf),
    /// Another plan was asked for than the folder's.
    #[error("{}: holds another plan than the one asked for; leave the plan's options out, or name a new folder", .0.display())]
    AnotherPlan(PathBuf),
    /// The plan cannot be read.
    #[error("{}: {reason}", path.display())]
    Plan {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: serde_json::Error,
    },
    /// A run of the plan cannot be made.
    #[error("run `{id}`: {reason}")]
    Run {
        /// The run.
        id: String,
        /// What is wrong with it.
        reason: RunError,
    },
    /// The folder cannot be made.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// A file cannot be written or renamed.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The recordings cannot be read.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The measurement cannot be written.
    #[error(transparent)]
    Measurement(#[from] MeasurementError),
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> SeriesError {
    move |reason| SeriesError::Io { path: path.to_owned(), reason }
}

/// A series in its folder.
#[derive(Debug)]
pub struct Series {
    folder: PathBuf,
    runs: Vec<SeriesRun>,
}

impl Series {
    /// Begins a series in a new folder.
    ///
    /// # Errors
    /// When a run cannot be made, or the folder exists or cannot be made.
    pub fn begin(folder: &Path, runs: Vec<SeriesRun>) -> Result<Self, SeriesError> {
        runs.iter().try_for_each(SeriesRun::check)?;
        if folder.exists() {
            return Err(SeriesError::Exists(folder.to_owned()));
        }
        let recordings = folder.join(RECORDINGS);
        std::fs::create_dir_all(&recordings).map_err(io(&recordings))?;
        let path = folder.join(PLAN);
        let plan =
            serde_json::to_vec_pretty(&runs).map_err(|reason| SeriesError::Plan { path: path.clone(), reason })?;
        output::write(&path, plan, Existing::Keep)?;
        Ok(Self { folder: folder.to_owned(), runs })
    }

    /// Goes on with the series of a folder; `asked` is the plan asked for, if one was.
    ///
    /// # Errors
    /// When there is none, or another than the one asked for, or a run cannot be made.
    pub fn resume(folder: &Path, asked: Option<&[SeriesRun]>) -> Result<Self, SeriesError> {
        let path = folder.join(PLAN);
        let text = input::bytes(&path, input::WRITTEN).map_err(|_| SeriesError::NoPlan(folder.to_owned()))?;
        let runs: Vec<SeriesRun> =
            serde_json::from_slice(&text).map_err(|reason| SeriesError::Plan { path, reason })?;
        runs.iter().try_for_each(SeriesRun::check)?;
        // The last digit of a number may not survive being written.
        let same = |a: &SeriesRun, b: &SeriesRun| {
            let close = |x: f64, y: f64| (x - y).abs() <= 1e-9;
            let numbers = |run: &SeriesRun| [run.duty, run.seconds, run.pause_s, run.pwm_hz];
            let numbers = numbers(a).into_iter().zip(numbers(b));
            a.id == b.id && a.direction == b.direction && numbers.into_iter().all(|(x, y)| close(x, y))
        };
        if asked.is_some_and(|asked| asked.len() != runs.len() || !asked.iter().zip(&runs).all(|(a, b)| same(a, b))) {
            return Err(SeriesError::AnotherPlan(folder.to_owned()));
        }
        Ok(Self { folder: folder.to_owned(), runs })
    }

    /// The plan, in its order.
    pub fn runs(&self) -> &[SeriesRun] {
        &self.runs
    }

    /// Where the runs are recorded.
    pub fn recordings(&self) -> PathBuf {
        self.folder.join(RECORDINGS)
    }

    /// Where a run is recorded.
    pub fn recording(&self, run: &SeriesRun) -> PathBuf {
        self.recordings().join(format!("{}.mcap", run.id))
    }

    /// Whether a run was made to its end. What there is of one that was not is set aside under another name.
    ///
    /// # Errors
    /// When it cannot be set aside.
    pub fn is_made(&self, run: &SeriesRun) -> Result<bool, SeriesError> {
        let path = self.recording(run);
        if !path.exists() {
            return Ok(false);
        }
        let ended = Recording::load(&path).ok().and_then(|recording| recording.runs.first()?.end);
        if ended.is_some_and(|(end, _)| end == RunEnd::Completed) {
            return Ok(true);
        }
        self.set_aside(run)?;
        Ok(false)
    }

    /// Gives the recording of a run that was cut short another name, `ID.cut-short.mcap` or the next that is free.
    ///
    /// # Errors
    /// When it cannot be renamed.
    pub fn set_aside(&self, run: &SeriesRun) -> Result<(), SeriesError> {
        let path = self.recording(run);
        let numbered = (2..).map(|n| path.with_extension(format!("{CUT_SHORT}-{n}.mcap")));
        let first = path.with_extension(format!("{CUT_SHORT}.mcap"));
        let free = std::iter::once(first).chain(numbered).find(|aside| !aside.exists());
        free.map_or(Ok(()), |aside| Ok(output::rename(&path, &aside)?))
    }

    /// Makes the measurement of what was recorded to its end so far; one made of less is put beside the recordings. The notes
    /// say what the recordings lost. None without a run.
    ///
    /// # Errors
    /// When recordings cannot be read or the measurement cannot be written.
    pub fn measure(&self) -> Result<(Option<Measurement>, Vec<String>), SeriesError> {
        let any = self.runs.iter().map(|run| self.is_made(run)).collect::<Result<Vec<_>, _>>()?.contains(&true);
        if !any {
            return Ok((None, Vec::new()));
        }
        let (mut whole, notes) = load_runs(&self.recordings())?;
        whole.name = self.folder.file_name().map_or_else(Default::default, |n| n.to_string_lossy().into_owned());
        for run in &mut whole.runs {
            run.file = format!("{}.csv", run.id);
            let planned = self.runs.iter().position(|planned| planned.id == run.id);
            run.order = planned.and_then(|n| u32::try_from(n).ok());
        }
        let folder = self.folder.join("measurement");
        if folder.exists() {
            // Somebody may have written into it.
            let mut numbered = (1..).map(|n| self.recordings().join(format!("earlier-measurement-{n}")));
            if let Some(earlier) = numbered.find(|earlier| !earlier.exists()) {
                output::rename(&folder, &earlier)?;
            }
        }
        Ok((Some(whole.save(&folder)?), notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Vec<SeriesRun> {
        (0..3)
            .map(|n| SeriesRun {
                id: format!("{n:03}-d030-cw-50hz"),
                duty: 0.1 * 3.0,
                direction: "cw".to_owned(),
                pwm_hz: 50.0,
                seconds: 2.0,
                pause_s: 0.0,
                why: "first experiment".to_owned(),
            })
            .collect()
    }

    /// Fails when a plan that a person or a browser wrote moves the motor in a way that it does not say, or writes elsewhere.
    #[test]
    fn a_run_that_cannot_be_made_is_refused_before_the_first() {
        let good = SeriesRun {
            id: "00-cw".to_owned(),
            duty: 0.5,
            direction: "cw".to_owned(),
            pwm_hz: 50.0,
            seconds: 1.0,
            pause_s: 0.0,
            why: String::new(),
        };
        let place = tempfile::tempdir().unwrap();
        let refused = |run: SeriesRun| {
            let folder = place.path().join("new");
            let begun = Series::begin(&folder, vec![good.clone(), run.clone()]).unwrap_err().to_string();
            assert!(!folder.exists(), "a refused series leaves no folder");
            // The same of a plan that is there.
            std::fs::create_dir(&folder).unwrap();
            std::fs::write(folder.join(PLAN), serde_json::to_vec(&[run]).unwrap()).unwrap();
            assert_eq!(Series::resume(&folder, None).unwrap_err().to_string(), begun);
            std::fs::remove_dir_all(&folder).unwrap();
            begun
        };
        let up = refused(SeriesRun { direction: "up".to_owned(), ..good.clone() });
        assert_eq!(up, "run `00-cw`: direction `up` is neither `cw` nor `ccw`");
        assert!(refused(SeriesRun { id: "../a".to_owned(), ..good.clone() }).contains("letters, digits and hyphens"));
        assert!(refused(SeriesRun { duty: 1.5, ..good.clone() }).contains("duty 1.5"));
        assert!(refused(SeriesRun { seconds: 1e9, ..good.clone() }).contains("3600"));
        assert!(refused(SeriesRun { pwm_hz: 1e5, ..good.clone() }).contains("pwm_hz"));
        assert!(refused(SeriesRun { pause_s: -1.0, ..good.clone() }).contains("pause"));
    }

    #[test]
    fn a_series_is_gone_on_with_only_under_its_own_plan() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("first");
        assert!(matches!(Series::resume(&folder, None), Err(SeriesError::NoPlan(_))));
        Series::begin(&folder, plan()).unwrap();
        assert!(matches!(Series::begin(&folder, plan()), Err(SeriesError::Exists(_))));
        assert_eq!(Series::resume(&folder, Some(&plan())).unwrap().runs().len(), 3);
        assert_eq!(Series::resume(&folder, None).unwrap().runs()[2].id, plan()[2].id);
        let other = [&plan()[..2], &[SeriesRun { duty: 0.4, ..plan()[2].clone() }]].concat();
        assert!(matches!(Series::resume(&folder, Some(&other)), Err(SeriesError::AnotherPlan(_))));
    }

    #[test]
    fn what_is_no_whole_run_is_set_aside_and_made_again() {
        let dir = tempfile::tempdir().unwrap();
        let series = Series::begin(&dir.path().join("first"), plan()).unwrap();
        let run = &series.runs()[0];
        assert!(!series.is_made(run).unwrap());
        std::fs::write(series.recording(run), b"cut off").unwrap();
        assert!(!series.is_made(run).unwrap());
        assert!(!series.recording(run).exists() && series.recording(run).with_extension("cut-short.mcap").exists());
        assert_eq!(series.measure().unwrap().0, None);
    }
}
