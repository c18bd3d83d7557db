//! What a search looks at of a long record.
//!
//! Samples far closer than the lag carry the same; of what is then still long, stretches evenly over each run say what the whole says.
//! Only the search goes by them: what stands is refitted, weighed and judged on everything.

use super::data::{Data, DriveRun};

/// Rows that a search looks at: fifteen times as many as residuals count as independent.
const MOST_ROWS: usize = 3000;
/// Samples that a lag keeps.
const SAMPLES_A_LAG: f64 = 25.0;
/// Stretches of all runs.
const STRETCHES: usize = 24;

/// A record for the search; none if the whole is short enough. `lag_s` is the line's.
pub fn thinned(data: &Data, lag_s: f64) -> Option<Data> {
    if data.rows() <= MOST_ROWS {
        return None;
    }
    let period = data.runs.iter().map(|r| r.period_s).fold(0.0, f64::max);
    let wanted = data.rows().div_ceil(MOST_ROWS);
    let by = ((lag_s / (SAMPLES_A_LAG * period)) as usize).clamp(1, wanted);
    let merged: Vec<DriveRun> = data.runs.iter().map(|r| r.merged(by)).collect();
    let rows: usize = merged.iter().map(|r| r.rpm.len()).sum();
    if rows <= MOST_ROWS + MOST_ROWS / 4 {
        return Some(data.of(&merged));
    }
    let share = MOST_ROWS as f64 / rows as f64;
    let each = STRETCHES.div_ceil(merged.len());
    let stretches: Vec<DriveRun> = merged
        .iter()
        .flat_map(|run| {
            let n = run.rpm.len();
            (0..each).map(move |k| {
                let from = n * k / each;
                run.stretch(from..from + ((n as f64 / each as f64 * share) as usize).max(2))
            })
        })
        .collect();
    Some(data.of(&stretches))
}
