//! Records that cannot be what they say: asked about in words, before any name.
//!
//! The bounds are those of what turns: no ordinary motor is faster, and nobody samples one a hundred thousand times a second.

use super::data::{Data, DriveRun};
use super::fit::Plant;
use nalgebra::{DMatrix, DVector};

/// Largest speed in rpm that is believed: dental and turbocharger drives end below it.
const LARGEST_RPM: f64 = 300_000.0;
/// Shortest time between samples in s that is believed: currents are sampled faster, speeds of motors are not.
const SHORTEST_PERIOD_S: f64 = 20e-6;
/// Shortest lag in s that is believed: coreless motors of some grams, the quickest there are, take 1 ms.
const SHORTEST_LAG_S: f64 = 3e-4;
/// Longest lag in s that is not asked about: a spindle with a flywheel takes some seconds.
const LONGEST_LAG_S: f64 = 10.0;
/// Share of the largest input by which an input has to move.
const LEAST_MOVE: f64 = 1e-3;
/// Earlier samples by which one column foretells another.
const ECHOES: usize = 4;
/// Samples of a run that are looked at for that.
const LOOKED_AT: usize = 20_000;
/// Times the median by which a sample is missed that is a step from outside: six deviations of noise.
const OUTLIER: f64 = 9.0;
/// Log of the factor by which the variance of what is not foretold shrinks, from which one column is said to follow another.
const FOLLOWS: f64 = 0.05;
/// Independent samples that it takes to say so.
const LEAST_NATS: f64 = 20.0;
/// How much more the input follows the speed than the speed the input where the columns are swapped.
const SWAPPED: f64 = 20.0;

/// Why these records cannot be judged at all.
pub fn refused(data: &Data) -> Option<String> {
    if data.runs.is_empty() || data.usual_rpm < 1e-9 {
        return Some("no run shows motion: nothing can be said about the motor".to_owned());
    }
    let moves = |r: &DriveRun| {
        let (low, high) = r.input.iter().fold((f64::MAX, f64::MIN), |(a, b), u| (a.min(*u), b.max(*u)));
        high - low > LEAST_MOVE
    };
    let inputs = data.runs.iter().flat_map(|r| r.input.first());
    let (low, high) = inputs.fold((f64::MAX, f64::MIN), |(a, b), u| (a.min(*u), b.max(*u)));
    if !data.runs.iter().any(moves) && high - low < LEAST_MOVE {
        return Some(
            "the input never changes: what the motor makes of it cannot be seen. Record steps or a sweep over its range"
                .to_owned(),
        );
    }
    let largest = data.runs.iter().flat_map(|r| &r.rpm).fold(0.0f64, |a, v| a.max(v.abs()));
    if largest > LARGEST_RPM {
        return Some(format!(
            "the record says {largest:.0} rpm: no motor turns so fast. Is `speed_rpm` in rpm, `position_rad` in rad, `time_us` in µs?"
        ));
    }
    let period = data.runs.iter().map(|r| r.period_s).fold(f64::INFINITY, f64::min);
    if period < SHORTEST_PERIOD_S {
        return Some(format!(
            "a sample every {:.3} µs, {:.3} ms in all: is `time_us` in µs, or in ms or s? If it is in µs, keep every {:.0}th sample",
            1e6 * period,
            1e3 * data.runs.iter().map(DriveRun::seconds).fold(0.0, f64::max),
            (SHORTEST_PERIOD_S / period).ceil()
        ));
    }
    let (back, forth) = follows(data);
    (back > FOLLOWS && back > SWAPPED * forth).then(|| {
        "the input follows the speed, and the speed does not follow the input: are the columns swapped? Of a loop that is closed tightly \
         around the motor nothing more can be said either; record with the loop open"
            .to_owned()
    })
}

/// Why the line that was fitted cannot be of a motor. A lag within a sample is not seen, and may be any.
pub fn refused_line(data: &Data, line: &Plant) -> Option<String> {
    let lag = line.values.lag_s();
    let period = data.runs.iter().map(|r| r.period_s).fold(f64::INFINITY, f64::min);
    (lag < SHORTEST_LAG_S && lag > period).then(|| {
        format!(
            "the speed follows the input within {:.1} µs: no motor is so quick. Is `time_us` in µs, or in ms or s?",
            1e6 * lag
        )
    })
}

/// What is asked about a lag that few motors have.
pub fn slow(lag_s: f64) -> Option<String> {
    (lag_s > LONGEST_LAG_S).then(|| {
        format!(
            "a lag of {lag_s:.0} s is long for a motor: is `time_us` in µs? The times below are by the record's own"
        )
    })
}

/// What a record of a closed loop hides; nothing of one that is open.
pub fn loop_hides(data: &Data) -> Option<String> {
    const HIDES: &str = "It is taken as input and motion; noise of the speed is then in the input too, and what the loop evens out is not seen. \
                         Runs with the loop open would decide";
    if follows(data).0 > FOLLOWS {
        return Some(format!("the input follows the speed: this looks like a closed loop. {HIDES}"));
    }
    data.controlled.then(|| format!("the column `reference` says that a controller made the input. {HIDES}"))
}

/// By how much each column foretells the other beyond what that foretells itself, as log factors of variances: the speed the input, and the
/// input the speed. Reference: Granger, Investigating causal relations by econometric models, Econometrica 37 (1969) 424.
pub fn follows(data: &Data) -> (f64, f64) {
    let (mut back, mut forth) = (Shares::default(), Shares::default());
    for run in &data.runs {
        let n = run.rpm.len().min(LOOKED_AT);
        // An input that the speed of a window has seen is that window's: seen in the next, it would be foretold.
        let input: Vec<f64> = (0..n).map(|k| run.input[run.last_sample(k)]).collect();
        let speed: Vec<f64> = run.rpm[..n].iter().map(|v| v / data.usual_rpm).collect();
        back.add(&speed, &input);
        forth.add(&input, &speed);
    }
    (back.gain(), forth.gain())
}

/// Squared errors of a column foretold by itself, and by another beside it.
#[derive(Default)]
struct Shares {
    alone: f64,
    together: f64,
    rows: f64,
}

impl Shares {
    fn add(&mut self, cause: &[f64], effect: &[f64]) {
        let rows: Vec<usize> = (ECHOES + 1..effect.len()).collect();
        if rows.len() < 8 * ECHOES {
            return;
        }
        // Levels and differences: neighbours alone are nearly the same column.
        let echoes = |of: &[f64], k: usize, j: usize| if j == 0 { of[k - 1] } else { of[k - j] - of[k - j - 1] };
        let design = |with: usize| {
            DMatrix::from_fn(rows.len(), 1 + with * ECHOES, |i, c| match c {
                0 => 1.0,
                c if c <= ECHOES => echoes(effect, rows[i], c - 1),
                c => echoes(cause, rows[i], c - 1 - ECHOES),
            })
        };
        let y = DVector::from_fn(rows.len(), |i, _| effect[rows[i]] - effect[rows[i] - 1]);
        // Steps of a target come from outside; what is foretold is told by the samples between them.
        let usual = usual_rows(&design(2), &y);
        let of = |x: DMatrix<f64>| left(&x.select_rows(&usual), &y.select_rows(&usual));
        self.alone += of(design(1));
        self.together += of(design(2));
        self.rows += usual.len() as f64;
    }

    fn gain(&self) -> f64 {
        // Below a millionth of the range, squared, it is rounding that is foretold.
        let floor = 1e-12 * self.rows;
        let gain = ((self.alone + floor) / (self.together + floor)).ln();
        if gain * self.rows > LEAST_NATS { gain } else { 0.0 }
    }
}

/// Rows that a fit misses by no more than some times the median.
fn usual_rows(x: &DMatrix<f64>, y: &DVector<f64>) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..y.len()).collect();
    for _ in 0..3 {
        let (some, of) = (x.select_rows(&rows), y.select_rows(&rows));
        let Some(b) = solved(&some, &of) else { break };
        let missed = (y - x * b).abs();
        let mut sorted: Vec<f64> = missed.iter().copied().collect();
        let middle = sorted.len() / 2;
        let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        rows = (0..y.len()).filter(|k| missed[*k] <= OUTLIER * median + 1e-9).collect();
    }
    rows
}

fn left(x: &DMatrix<f64>, y: &DVector<f64>) -> f64 {
    solved(x, y).map_or(y.norm_squared(), |b| (y - x * b).norm_squared())
}

fn solved(x: &DMatrix<f64>, y: &DVector<f64>) -> Option<DVector<f64>> {
    let mut g = x.tr_mul(x);
    let b = x.tr_mul(y);
    for i in 0..g.nrows() {
        g[(i, i)] *= 1.0 + 1e-9;
        g[(i, i)] += 1e-12;
    }
    g.cholesky().map(|c| c.solve(&b))
}
