//! What is said of a run.

use crate::link::LinkError;
use crate::link::bench::Outcome;
use twum_shared::message::RunEnd;

/// Whether a run came to its end, and how it went.
pub(super) fn words_of(outcome: &Outcome) -> (bool, String) {
    let end = outcome.cut().map_or_else(
        || "completed".to_owned(),
        |why| match why {
            LinkError::Interrupted => "stopped".to_owned(),
            other => other.to_string(),
        },
    );
    let tally = outcome.tally;
    let lost = if tally.is_lossless() {
        "none lost".to_owned()
    } else {
        format!(
            "{} LOST, {} bad, {} restarts, {} reconnects; the recording marks where",
            tally.lost, tally.bad, tally.restarts, tally.reconnects
        )
    };
    let ok = matches!(outcome.run.map(|run| run.end), Some(RunEnd::Completed)) && tally.is_lossless();
    (ok, format!("{end}; {} frames recorded, {lost}", outcome.recorded))
}
