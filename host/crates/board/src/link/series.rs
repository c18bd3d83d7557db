//! A planned series of runs, made one after the other.

use super::LinkError;
use super::bench::{Action, Outcome};
use twum_record::series::{RunError, Series, SeriesError, SeriesRun};

/// Makes the runs that are not made yet by `record`, which makes its pause too; `begins` is told of every run and its place. A
/// run that was cut short goes by another name, and into no measurement.
///
/// # Errors
/// The first run that was not made to its end, by its name, and why; the runs after it are not made.
pub fn make_all<E: From<LinkError> + From<SeriesError> + From<RunError>>(
    series: &Series,
    mut begins: impl FnMut(usize, &SeriesRun),
    mut record: impl FnMut(&SeriesRun, Action) -> Result<Outcome, E>,
) -> Result<(), (String, E)> {
    let mut make = |run: &SeriesRun| -> Result<(), E> {
        if series.is_made(run)? {
            return Ok(());
        }
        let outcome = record(run, Action::Speed(run.speed_run()?))?;
        match outcome.cut() {
            None => Ok(()),
            Some(error) => {
                series.set_aside(run)?;
                Err(error.into())
            }
        }
    };
    for (index, run) in series.runs().iter().enumerate() {
        begins(index, run);
        make(run).map_err(|error| (run.id.clone(), error))?;
    }
    Ok(())
}
