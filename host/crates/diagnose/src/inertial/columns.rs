//! Columns that were recorded beside input and motion: what is made use of, and what is said not to be.

use std::collections::BTreeMap;
use twum_record::measurement::Beside;

/// What was recorded beside a run, a value a sample each.
pub type Recorded = BTreeMap<Beside, Vec<f64>>;

/// The columns of every run.
pub struct Columns<'a> {
    runs: &'a [&'a Recorded],
    /// The largest load, in the record's unit; none where it is not there in every run, or always the same.
    pub largest_load: Option<f64>,
    /// The mean temperature in °C and by how many kelvins it changes; none where it is not there in every run.
    pub temperature: Option<(f64, f64)>,
    /// Whether a controller was asked for something.
    pub controlled: bool,
}

impl<'a> Columns<'a> {
    /// Of runs; what is not used is said.
    pub fn of(runs: &'a [&'a Recorded]) -> (Self, Vec<String>) {
        let (mut columns, mut notes) =
            (Self { runs, largest_load: None, temperature: None, controlled: false }, Vec::new());
        for column in Beside::ALL {
            let there = runs.iter().filter(|r| r.contains_key(&column)).count();
            if there == 0 {
                continue;
            }
            if matches!(column, Beside::Load | Beside::Temperature) && there < runs.len() {
                notes.push(format!(
                    "the column `{}` is in {there} of {} runs: not used. What is unknown in one run is unknown in what all have in common",
                    column.name(),
                    runs.len()
                ));
                continue;
            }
            let (low, high) = columns.values(column).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
            match column {
                Beside::Load if low == high => {
                    notes.push("the column `load` never changes: not used, a steady load is the effect load-bias".to_owned());
                }
                Beside::Load => columns.largest_load = Some(low.abs().max(high.abs())),
                Beside::Temperature => {
                    let mean = columns.values(column).sum::<f64>() / columns.values(column).count() as f64;
                    columns.temperature = Some((mean, high - low));
                }
                Beside::Current => notes.push(
                    "the column `current` is not used: of a drive whose input is the current, call the column `current` instead of `input`"
                        .to_owned(),
                ),
                Beside::Reference => columns.controlled = true,
            }
        }
        (columns, notes)
    }

    fn values(&self, column: Beside) -> impl Iterator<Item = f64> {
        self.runs.iter().filter_map(move |r| r.get(&column)).flatten().copied()
    }

    /// Load and warmth of run `k` over the interval after each sample, as [`super::data::DriveRun::beside`]; empty where neither is used.
    pub fn courses(&self, k: usize) -> Vec<[f64; 2]> {
        let column = |of: Beside, used: bool| self.runs[k].get(&of).filter(|_| used);
        let load = column(Beside::Load, self.largest_load.is_some());
        let temperature = column(Beside::Temperature, self.temperature.is_some());
        let rows = load.or(temperature).map_or(0, Vec::len);
        // Between two samples the mean of both; after the last one there is nothing.
        let mean = |v: &Vec<f64>, k: usize| 0.5 * (v[k] + v[(k + 1).min(rows - 1)]);
        let one = |k: usize| {
            [
                load.zip(self.largest_load).map_or(0.0, |(v, largest)| mean(v, k) / largest),
                temperature.zip(self.temperature).map_or(0.0, |(v, (middle, _))| mean(v, k) - middle),
            ]
        };
        (0..rows).map(one).collect()
    }
}
