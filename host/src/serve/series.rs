//! A planned series of runs in a folder, made one after the other: what `twum experiment run` makes, with the same files.

use super::board::{Board, Doing, Ended};
use crate::link::LinkError;
use crate::link::bench::{Action, Outcome};
use crate::record::series::Series;
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

/// Makes the runs that are not made yet, by `record`, which is told configuration, run, recording and the pause before it.
pub fn make(
    task: &Task,
    board: &Board,
    own: Configuration,
    record: &mut dyn FnMut(Configuration, Action, PathBuf, Duration) -> Result<Outcome, Failed>,
) -> Ended {
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

fn make_all(
    task: &Task,
    board: &Board,
    own: Configuration,
    record: &mut dyn FnMut(Configuration, Action, PathBuf, Duration) -> Result<Outcome, Failed>,
) -> Result<(), String> {
    let runs = task.series.runs();
    let total: f64 = runs.iter().map(|run| run.seconds + run.pause_s).sum();
    for (index, run) in runs.iter().enumerate() {
        let done: f64 = runs[..index].iter().map(|run| run.seconds + run.pause_s).sum();
        board.doing(Some(Doing {
            what: format!(
                "experiment {}: run {} of {}, {}; {:.0} s of {:.0} s",
                task.name,
                index + 1,
                runs.len(),
                run.id,
                done,
                total
            ),
            recording: Some(format!("{}/recordings/{}", task.name, run.id)),
            seconds: Some(run.seconds + run.pause_s),
            elapsed_s: 0.0,
        }));
        if task.series.is_made(run).map_err(|error| error.to_string())? {
            continue;
        }
        let pause = Duration::from_secs_f64(run.pause_s);
        let used = Configuration { pwm_hz: run.pwm_hz.round() as u16, ..own };
        let outcome = record(
            used,
            Action::Speed(run.speed_run().map_err(|error| error.to_string())?),
            task.series.recording(run),
            pause,
        )
        .map_err(|failed| format!("run {}: {failed}", run.id))?;
        if let Some(error) = outcome.cut() {
            // No ordinary run: it goes by another name, and into no measurement.
            task.series.set_aside(run).map_err(|error| error.to_string())?;
            return Err(match error {
                LinkError::Interrupted => format!("stopped in run {}", run.id),
                error => format!("run {}: {error}", run.id),
            });
        }
    }
    Ok(())
}

/// Why a run was not made.
#[derive(Debug)]
pub enum Failed {
    /// The link's reason.
    Link(LinkError),
    /// Board and motor do not go together.
    Motor(String),
}

impl From<LinkError> for Failed {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

impl std::fmt::Display for Failed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Link(error) => error.fmt(f),
            Self::Motor(words) => f.write_str(words),
        }
    }
}
