//! A planned series of runs in a folder, made one after the other: what `twum experiment run` makes, with the same files.

use super::board::{Board, Doing, Ended};
use crate::link::bench::{Action, Outcome};
use crate::link::{self, LinkError};
use crate::record::series::{RunError, Series, SeriesError, SeriesRun};
use std::path::PathBuf;
use std::time::Duration;
use twum_shared::message::Configuration;

/// A series to make, or to go on with.
#[derive(Debug)]
pub struct Task {
    /// Its folder's name.
    pub name: String,
    /// Its plan and files.
    pub series: Series,
}

/// Makes one run: with what configuration, what, recorded where, after what pause.
pub type Record<'a> = &'a mut dyn FnMut(Configuration, Action, PathBuf, Duration) -> Result<Outcome, Failed>;

/// Makes the runs that are not made yet, by `record`, which is told configuration, run, recording and the pause before it.
pub fn make(task: &Task, board: &Board, own: Configuration, record: Record<'_>) -> Ended {
    let result = make_all(task, board, own, record);
    // However it ended, what was made to its end becomes a measurement.
    let measured = task.series.measure();
    let made = measured.as_ref().ok().and_then(|(saved, _)| saved.as_ref()).map_or(0, |saved| saved.runs.len());
    let planned = task.series.runs().len();
    let mut words = format!("experiment {}: {made} of {planned} runs made", task.name);
    if let Err(why) = &result {
        words += &format!("; ended: {why}. Resume it to go on");
    }
    match measured {
        Ok((_, notes)) => notes.into_iter().for_each(|note| board.say(note)),
        Err(error) => words += &format!("; no measurement was made of them: {error}"),
    }
    Ended { recording: None, ok: result.is_ok() && made == planned, words }
}

fn make_all(task: &Task, board: &Board, own: Configuration, record: Record<'_>) -> Result<(), String> {
    let runs = task.series.runs();
    let length = |runs: &[SeriesRun]| runs.iter().map(|run| run.seconds + run.pause_s).sum::<f64>();
    let begins = |index: usize, run: &SeriesRun| {
        let (number, planned, done, total) = (index + 1, runs.len(), length(&runs[..index]), length(runs));
        board.doing(Some(Doing {
            what: format!(
                "experiment {}: run {number} of {planned}, {}; {done:.0} s of {total:.0} s",
                task.name, run.id
            ),
            recording: Some(format!("{}/recordings/{}", task.name, run.id)),
            seconds: Some(run.seconds + run.pause_s),
            elapsed_s: 0.0,
        }));
    };
    let made = link::series::make_all(&task.series, begins, |run, action| {
        let used = Configuration { pwm_hz: run.pwm_hz.round() as u16, ..own };
        record(used, action, task.series.recording(run), Duration::from_secs_f64(run.pause_s))
    });
    made.map_err(|(id, failed)| match failed {
        Failed::Link(LinkError::Interrupted) => format!("stopped in run {id}"),
        failed => format!("run {id}: {failed}"),
    })
}

/// Why a run was not made.
#[derive(Debug)]
pub enum Failed {
    /// The link's reason.
    Link(LinkError),
    /// Another reason, in a sentence: board and motor do not go together, or the plan and its files.
    Other(String),
}

impl From<LinkError> for Failed {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

impl From<SeriesError> for Failed {
    fn from(error: SeriesError) -> Self {
        Self::Other(error.to_string())
    }
}

impl From<RunError> for Failed {
    fn from(error: RunError) -> Self {
        Self::Other(error.to_string())
    }
}

impl std::fmt::Display for Failed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Link(error) => error.fmt(f),
            Self::Other(words) => f.write_str(words),
        }
    }
}
