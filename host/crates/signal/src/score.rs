//! How far each estimator is off, on motions that are known.

use super::smoother::smooth;
use super::trial::{EDGES_PER_REV, Encoder, Motion, PERIOD_US, Trial};
use super::window::{Order, speed_rpm};
use super::{SignalError, thesis};

/// The estimators scored, in the order of [`Row::rmse_rpm`]; the fixed window is [`Table::window`].
pub const ESTIMATORS: [&str; 7] = [
    "thesis: local cubic",
    "thesis: Butterworth",
    "thesis: moving average",
    "thesis: median",
    "best fixed window",
    "smoother on bits",
    "smoother on edge times",
];
/// The position estimates scored, in the order of [`Row::rms_pitch`].
pub const POSITIONS: [&str; 4] =
    ["thesis: spline", "thesis: local cubic", "smoother on bits", "smoother on edge times"];
/// Samples left out at the start of motions that do not start at rest: the thesis's method is made for records that do,
/// and begins with an event of its own making.
const SKIPPED: usize = 100;
const WINDOWS: [usize; 17] = [5, 7, 9, 11, 13, 15, 17, 21, 25, 31, 41, 51, 61, 81, 101, 151, 201];

/// The scores of one motion, or overall.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Root of the mean square error of the speed, in rpm, over samples where every estimator has a value.
    pub rmse_rpm: [f64; ESTIMATORS.len()],
    /// Root of the mean square error of the position with the mean error (the unknown phase) taken off, in pitches.
    /// NaN for the thesis's method after a reversal, which it does not see.
    pub rms_pitch: [f64; POSITIONS.len()],
    /// Share of samples at which the truth lies within 1.96 standard deviations, of the smoother on bits and on times.
    pub coverage: [f64; 2],
}

/// Scores of every estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// One row a motion.
    pub rows: Vec<(Motion, Row)>,
    /// All motions alike: root of the mean square over the rows (positions: over those defined; coverage: mean).
    pub overall: Row,
    /// The one fixed window (samples, polynomial) with the least error overall.
    pub window: (usize, Order),
}

/// Scores every estimator on every motion, at `seeds` phases each. The thesis's method is given the sign of the direction
/// pin, which it does not read itself.
///
/// # Errors
/// A motion too short for an estimator.
pub fn score(motions: &[Motion], encoder: Encoder, seeds: u64) -> Result<Table, SignalError> {
    let windows: Vec<(usize, Order)> =
        [Order::Line, Order::Cubic].iter().flat_map(|order| WINDOWS.map(|window| (window, *order))).collect();
    let mut rows = Vec::new();
    let mut window_squares = Vec::new();
    for motion in motions {
        let mut squares = [Mean::default(); ESTIMATORS.len()];
        let mut of_windows = vec![Mean::default(); windows.len()];
        let mut positions = [Mean::default(); POSITIONS.len()];
        let mut inside = [Mean::default(); 2];
        for seed in 0..seeds {
            let run = Run::new(*motion, encoder, seed, &windows)?;
            for (mean, speed) in squares.iter_mut().zip(&run.speeds) {
                run.add_squares(mean, speed);
            }
            for (mean, speed) in of_windows.iter_mut().zip(&run.windows) {
                run.add_squares(mean, speed);
            }
            for (mean, error) in positions.iter_mut().zip(&run.position_errors) {
                mean.add(variance(error));
            }
            for (mean, share) in inside.iter_mut().zip(run.coverage) {
                mean.add(share);
            }
        }
        let row = Row {
            rmse_rpm: squares.map(|m| m.value().sqrt()),
            rms_pitch: positions.map(|m| m.value().sqrt()),
            coverage: inside.map(|m| m.value()),
        };
        rows.push((*motion, row));
        window_squares.push(of_windows);
    }
    let overall_of = |w: usize| window_squares.iter().map(|squares| squares[w].value()).sum::<f64>();
    let best = (0..windows.len()).min_by(|a, b| overall_of(*a).total_cmp(&overall_of(*b))).unwrap_or(0);
    for ((_, row), squares) in rows.iter_mut().zip(&window_squares) {
        row.rmse_rpm[4] = squares[best].value().sqrt();
    }
    let overall = overall(&rows);
    Ok(Table { rows, overall, window: windows[best] })
}

fn overall(rows: &[(Motion, Row)]) -> Row {
    let mean_square = |pick: &dyn Fn(&Row) -> f64| {
        let mut mean = Mean::default();
        rows.iter().map(|(_, row)| pick(row)).filter(|v| v.is_finite()).for_each(|v| mean.add(v * v));
        mean.value().sqrt()
    };
    Row {
        rmse_rpm: std::array::from_fn(|i| mean_square(&|row| row.rmse_rpm[i])),
        rms_pitch: std::array::from_fn(|i| mean_square(&|row| row.rms_pitch[i])),
        coverage: std::array::from_fn(|i| rows.iter().map(|(_, r)| r.coverage[i]).sum::<f64>() / rows.len() as f64),
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    fn value(self) -> f64 {
        self.sum / self.count
    }
}

fn variance(errors: &[f64]) -> f64 {
    let mut mean = Mean::default();
    errors.iter().for_each(|e| mean.add(*e));
    let mut square = Mean::default();
    errors.iter().for_each(|e| square.add((e - mean.value()).powi(2)));
    square.value()
}

/// Every estimate of one trial.
struct Run {
    truth_rpm: Vec<f64>,
    /// Samples scored.
    scored: Vec<usize>,
    /// In the order of [`ESTIMATORS`], the fixed window left out.
    speeds: [Vec<f64>; ESTIMATORS.len()],
    windows: Vec<Vec<f64>>,
    position_errors: [Vec<f64>; POSITIONS.len()],
    coverage: [f64; 2],
}

impl Run {
    fn new(motion: Motion, encoder: Encoder, seed: u64, windows: &[(usize, Order)]) -> Result<Self, SignalError> {
        let trial = Trial::before(encoder, motion, seed);
        let grid_us: Vec<f64> = (0..trial.samples()).map(|i| i as f64 * PERIOD_US).collect();
        let bits = smooth(&trial.sampled(), &grid_us)?;
        let times = smooth(&trial.timestamped(), &grid_us)?;
        let thesis = thesis::estimate(0.0, PERIOD_US, trial.levels(), EDGES_PER_REV)?;
        let windows = windows
            .iter()
            .map(|(window, order)| speed_rpm(&trial.sampled(), PERIOD_US, trial.samples(), *window, *order))
            .collect::<Result<Vec<_>, _>>()?;
        let first = if matches!(motion, Motion::StartUp { .. }) { 0 } else { SKIPPED };
        let scored: Vec<usize> =
            (first..thesis.fit.raw_rpm.len()).filter(|i| windows.iter().all(|w| w[*i].is_finite())).collect();
        let signed = |rpm: &[f64]| -> Vec<f64> {
            rpm.iter().zip(&thesis.time_us).map(|(v, t)| v * trial.directions().at(*t).sign()).collect()
        };
        let pitch_rad = std::f64::consts::TAU / f64::from(EDGES_PER_REV);
        let errors = |rad: &[f64]| -> Vec<f64> {
            scored.iter().map(|i| (rad[*i] - trial.position_rad()[*i]) / pitch_rad).collect()
        };
        let unseen = |rad: &[f64]| if matches!(motion, Motion::Reversal { .. }) { vec![f64::NAN] } else { errors(rad) };
        let inside = |s: &super::smoother::Smoothed| {
            let within = |i: &&usize| (s.speed_rpm[**i] - trial.speed_rpm()[**i]).abs() <= 1.96 * s.speed_sd_rpm[**i];
            scored.iter().filter(within).count() as f64 / scored.len() as f64
        };
        Ok(Self {
            coverage: [inside(&bits), inside(&times)],
            position_errors: [
                unseen(&thesis.spline_rad),
                unseen(&thesis.fit.position_rad),
                errors(&bits.position_rad),
                errors(&times.position_rad),
            ],
            speeds: [
                signed(&thesis.fit.raw_rpm),
                signed(&thesis.butterworth_rpm),
                signed(&thesis.moving_average_rpm),
                signed(&thesis.median_rpm),
                Vec::new(),
                bits.speed_rpm,
                times.speed_rpm,
            ],
            windows,
            scored,
            truth_rpm: trial.speed_rpm().to_vec(),
        })
    }

    fn add_squares(&self, mean: &mut Mean, speed_rpm: &[f64]) {
        if !speed_rpm.is_empty() {
            self.scored.iter().for_each(|i| mean.add((speed_rpm[*i] - self.truth_rpm[*i]).powi(2)));
        }
    }
}

impl std::fmt::Display for Table {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (window, order) = self.window;
        writeln!(f, "RMSE of the speed in rpm; the best fixed window is a {order:?} over {window} samples.\n")?;
        let named = || self.rows.iter().map(|(m, r)| (m.to_string(), r)).chain([("overall".to_owned(), &self.overall)]);
        write_table(
            f,
            &ESTIMATORS,
            named().map(|(name, row)| (name, row.rmse_rpm.map(|v| format!("{v:.3}")).to_vec())),
        )?;
        writeln!(
            f,
            "\nRMS error of the position in % of a pitch, mean taken off; share of truths in the smoother's 95 % band.\n"
        )?;
        let heads: Vec<&str> = POSITIONS.into_iter().chain(["band: bits", "band: edge times"]).collect();
        let cells = |row: &Row| {
            let percent = |v: f64| if v.is_nan() { "n/a".to_owned() } else { format!("{:.2}", 100.0 * v) };
            row.rms_pitch.map(percent).into_iter().chain(row.coverage.map(|c| format!("{:.0} %", 100.0 * c))).collect()
        };
        write_table(f, &heads, named().map(|(name, row)| (name, cells(row))))
    }
}

/// A Markdown table.
fn write_table(
    f: &mut std::fmt::Formatter<'_>,
    heads: &[&str],
    rows: impl Iterator<Item = (String, Vec<String>)>,
) -> std::fmt::Result {
    writeln!(f, "| motion | {} |", heads.join(" | "))?;
    writeln!(f, "|---|{}", "---:|".repeat(heads.len()))?;
    for (name, cells) in rows {
        writeln!(f, "| {name} | {} |", cells.join(" | "))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The full table takes 6 phases of 16 motions; these are enough to see an estimator break.
    #[test]
    fn the_smoother_keeps_its_distance() {
        let motions = [
            Motion::Steady { rpm: 5.07 },
            Motion::Steady { rpm: 45.4 },
            Motion::StartUp { rpm: 35.0 },
            Motion::Ripple { rpm: 35.0 },
            Motion::Reversal { rpm: 35.0 },
        ];
        for encoder in [Encoder::IDEAL, Encoder::ROUGH] {
            let table = score(&motions, encoder, 2).unwrap();
            for (motion, row) in &table.rows {
                assert!(row.rmse_rpm[5] <= row.rmse_rpm[4], "{motion}: bits behind the best fixed window: {row:?}");
                assert!(row.rmse_rpm[6] <= row.rmse_rpm[5], "{motion}: edge times behind bits: {row:?}");
            }
            let [raw, butterworth, .., bits, times] = table.overall.rmse_rpm;
            assert!(bits <= 0.8 * raw.min(butterworth), "{:?}", table.overall);
            assert!(times <= raw.min(butterworth) / 3.0, "{:?}", table.overall);
        }
    }
}
