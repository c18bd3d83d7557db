//! The runs of an ordinary motor as they are compared: inputs relative to the largest, speeds of samples or of windows.

use super::angle::{Course, Ripple, WAVES};
use super::columns::{Columns, Recorded};
use twum_record::measurement::{DriveResponse, Run, RunData};

/// Fewest samples of which a run is made use of.
const LEAST_SAMPLES: usize = 40;
/// Share of the usual speed to which differences of positions are averaged: finer ones would be noise of the encoder.
const WINDOW_NOISE: f64 = 0.02;
/// Fewest windows a run is cut into.
const LEAST_WINDOWS: usize = 40;

/// One run.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveRun {
    /// Identifier.
    pub id: String,
    /// Times of the samples in s.
    pub time: Vec<f64>,
    /// The usual time between samples in s.
    pub period_s: f64,
    /// Input relative to the largest one of all runs, one entry a sample.
    pub input: Vec<f64>,
    /// What is compared, in rpm: the speed at each sample, or the mean speed of each window.
    pub rpm: Vec<f64>,
    /// Ends of the windows where positions were measured: samples `windows[k]` to `windows[k + 1]`.
    pub windows: Option<Vec<usize>>,
    /// Angle in revolutions at each sample, measured or summed up from the speed.
    pub turns: Vec<f64>,
    /// Cosine and sine of every order of [`Data::ripples`] over the interval after each sample, as `WAVES`; empty where there is none.
    pub ripple: Vec<[f64; WAVES]>,
    /// Load relative to the largest of all runs, and kelvins above the mean temperature of all, over the interval after each sample; empty
    /// where neither was measured.
    pub beside: Vec<[f64; 2]>,
}

impl DriveRun {
    /// The sample that stands for comparison `k`.
    pub fn sample(&self, k: usize) -> usize {
        self.windows.as_ref().map_or(k, |w| (w[k] + w[k + 1]) / 2)
    }

    /// The last sample whose input comparison `k` can show.
    pub fn last_sample(&self, k: usize) -> usize {
        self.windows.as_ref().map_or(k, |w| w[k + 1] - 1)
    }

    /// Every `by` samples as one: inputs and speeds averaged, positions taken as they are.
    pub fn merged(&self, by: usize) -> Self {
        if by == 1 {
            return self.clone();
        }
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let averaged = |v: &[f64]| v.chunks_exact(by).map(mean).collect::<Vec<f64>>();
        let every = |v: &[f64]| v.chunks_exact(by).map(|c| c[0]).collect::<Vec<f64>>();
        let (time, turns) = (every(&self.time), every(&self.turns));
        let windows = self.windows.as_ref().map(|_| windows(&time, &turns));
        let rpm = windows.as_ref().map_or_else(|| averaged(&self.rpm), |w| window_speeds(&time, &turns, w));
        Self {
            id: self.id.clone(),
            period_s: self.period_s * by as f64,
            input: averaged(&self.input),
            time,
            rpm,
            windows,
            turns,
            ripple: every_mean(&self.ripple, by),
            beside: every_mean(&self.beside, by),
        }
    }

    /// Some rows as a run.
    pub fn stretch(&self, rows: std::ops::Range<usize>) -> Self {
        let samples = match &self.windows {
            None => rows.clone(),
            Some(w) => w[rows.start]..w[rows.end] + 1,
        };
        let windows =
            self.windows.as_ref().map(|w| w[rows.start..=rows.end].iter().map(|k| k - samples.start).collect());
        Self {
            id: self.id.clone(),
            time: self.time[samples.clone()].to_vec(),
            period_s: self.period_s,
            input: self.input[samples.clone()].to_vec(),
            rpm: self.rpm[rows].to_vec(),
            windows,
            turns: self.turns[samples.clone()].to_vec(),
            ripple: self.ripple.get(samples.clone()).unwrap_or_default().to_vec(),
            beside: self.beside.get(samples).unwrap_or_default().to_vec(),
        }
    }

    /// Length in s.
    pub fn seconds(&self) -> f64 {
        self.time[self.time.len() - 1] - self.time[0]
    }
}

/// All runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    /// The runs.
    pub runs: Vec<DriveRun>,
    /// The largest input, in the record's unit.
    pub largest_input: f64,
    /// Usual speed: root mean square of all, in rpm.
    pub usual_rpm: f64,
    /// Whether the speeds of these runs have no sign although their inputs have.
    pub unsigned: bool,
    /// Orders of a turn in which a torque may go with the angle.
    pub ripples: Vec<Ripple>,
    /// The largest load, in the record's unit; none where it was not measured in every run.
    pub largest_load: Option<f64>,
    /// The mean temperature in °C, and by how many kelvins it changes; none where it was not measured in every run.
    pub temperature: Option<(f64, f64)>,
    /// Whether the record says what a controller was asked for.
    pub controlled: bool,
}

impl Data {
    /// Reads the runs of format `drive`; what is left out is said.
    pub fn read(runs: &[&Run]) -> (Self, Vec<String>) {
        let mut out = Vec::new();
        let mut columns = Vec::new();
        let mut notes = Vec::new();
        for run in runs {
            match read(run) {
                Some(Ok((run, beside))) => {
                    out.push(run);
                    columns.push(beside);
                }
                Some(Err(note)) => notes.push(note),
                None => {}
            }
        }
        let largest_input = out.iter().flat_map(|r| &r.input).fold(0.0f64, |a, b| a.max(b.abs()));
        if largest_input > 0.0 {
            out.iter_mut().flat_map(|r| &mut r.input).for_each(|u| *u /= largest_input);
        }
        let (sum, count) =
            out.iter().flat_map(|r| &r.rpm).fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
        let reaches = |side: f64| out.iter().any(|r| r.input.iter().any(|v| v * side > 0.1));
        let unsigned = reaches(1.0) && reaches(-1.0) && out.iter().all(|r| r.rpm.iter().all(|v| *v >= 0.0));
        let usual_rpm = f64::sqrt(sum / f64::max(count, 1.0));
        let (beside, said) = Columns::of(&columns);
        notes.extend(said);
        for (k, run) in out.iter_mut().enumerate() {
            run.beside = beside.courses(k);
        }
        let data = Self {
            runs: out,
            largest_input,
            usual_rpm,
            unsigned,
            ripples: Vec::new(),
            largest_load: beside.largest_load,
            temperature: beside.temperature,
            controlled: beside.controlled,
        };
        (data, notes)
    }

    /// Other runs in the same scale.
    pub fn of(&self, runs: &[DriveRun]) -> Self {
        Self {
            runs: runs.to_vec(),
            largest_input: self.largest_input,
            usual_rpm: self.usual_rpm,
            unsigned: self.unsigned,
            ripples: self.ripples.clone(),
            largest_load: self.largest_load,
            temperature: self.temperature,
            controlled: self.controlled,
        }
    }

    /// The same with orders of a torque over the angle, as a speed feels it through a lag; `rpm` are the speeds at the samples of every run,
    /// where they are known.
    pub fn with_ripples(&self, ripples: Vec<Ripple>, lag_s: f64, rpm: Option<&[Vec<f64>]>) -> Self {
        let run = |(i, run): (usize, &DriveRun)| {
            let rpm = rpm.map(|rpm| rpm[i].as_slice());
            let course = Course { time_s: &run.time, turns: &run.turns, rpm, lag_s };
            DriveRun { ripple: course.ripple(i, &ripples), ..run.clone() }
        };
        Self { runs: self.runs.iter().enumerate().map(run).collect(), ripples, ..self.clone() }
    }

    /// Whether every run's input goes from one end of its range to the other and no more: its time then says nothing that it does not.
    pub fn passes_once(&self) -> bool {
        self.runs.iter().all(|run| {
            let (low, high) = run.input.iter().fold((f64::MAX, f64::MIN), |(a, b), u| (a.min(*u), b.max(*u)));
            let way: f64 = run.input.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
            way < 1.5 * (high - low)
        })
    }

    /// How often the motor starts, stops or turns round.
    pub fn starts(&self) -> usize {
        let mut count = 0;
        for run in &self.runs {
            let largest = run.rpm.iter().fold(0.0f64, |a, v| a.max(v.abs()));
            let mut sense = f64::NAN;
            for v in &run.rpm {
                let now = if v.abs() < 0.02 * largest { 0.0 } else { v.signum() };
                // Between a rest and a motion there is room for noise.
                if now != 0.0 && v.abs() < 0.1 * largest {
                    continue;
                }
                count += usize::from(!sense.is_nan() && now != sense);
                sense = now;
            }
        }
        count
    }

    /// How much inputs change within a time: half the mean square of their change over that of their spread; 1 where nothing of one foretells the next.
    pub fn shaken(&self, time_s: f64) -> f64 {
        let (mut changes, mut spread) = (0.0, 1e-300);
        for run in &self.runs {
            let n = run.input.len();
            let lag = ((time_s / run.period_s).round() as usize).clamp(1, n - 1);
            let mean = run.input.iter().sum::<f64>() / n as f64;
            changes += run.input.windows(lag + 1).map(|w| (w[lag] - w[0]).powi(2)).sum::<f64>();
            spread += run.input.iter().map(|u| (u - mean).powi(2)).sum::<f64>();
        }
        0.5 * changes / spread
    }

    /// How many speeds are compared.
    pub fn rows(&self) -> usize {
        self.runs.iter().map(|r| r.rpm.len()).sum()
    }
}

fn read(run: &Run) -> Option<Result<(DriveRun, &Recorded), String>> {
    let RunData::Drive { time_us, input, response, beside } = &run.data else { return None };
    if input.len() < LEAST_SAMPLES {
        return Some(Err(format!("run {}: {} samples, too few; left out", run.id, input.len())));
    }
    let time: Vec<f64> = time_us.iter().map(|t| t * 1e-6).collect();
    let (rpm, windows, turns) = match response {
        DriveResponse::SpeedRpm(rpm) => {
            let mut turns = vec![0.0; rpm.len()];
            for k in 1..rpm.len() {
                turns[k] = turns[k - 1] + 0.5 * (rpm[k] + rpm[k - 1]) * (time[k] - time[k - 1]) / 60.0;
            }
            (rpm.clone(), None, turns)
        }
        DriveResponse::PositionRad(rad) => {
            let turns: Vec<f64> = rad.iter().map(|p| p / std::f64::consts::TAU).collect();
            let windows = windows(&time, &turns);
            let rpm = window_speeds(&time, &turns, &windows);
            (rpm, Some(windows), turns)
        }
    };
    let period_s = period(&time);
    let run = DriveRun {
        id: run.id.clone(),
        time,
        period_s,
        input: input.clone(),
        rpm,
        windows,
        turns,
        ripple: Vec::new(),
        beside: Vec::new(),
    };
    Some(Ok((run, beside)))
}

/// The means of so many rows each.
fn every_mean<const N: usize>(rows: &[[f64; N]], by: usize) -> Vec<[f64; N]> {
    let mean = |c: &[[f64; N]]| std::array::from_fn(|j| c.iter().map(|r| r[j]).sum::<f64>() / c.len() as f64);
    rows.chunks_exact(by).map(mean).collect()
}

/// Mean speeds of windows in rpm.
fn window_speeds(time: &[f64], turns: &[f64], windows: &[usize]) -> Vec<f64> {
    let speed = |w: &[usize]| (turns[w[1]] - turns[w[0]]) / (time[w[1]] - time[w[0]]) * 60.0;
    windows.windows(2).map(speed).collect()
}

/// The median step.
fn period(time: &[f64]) -> f64 {
    let mut steps: Vec<f64> = time.windows(2).map(|t| t[1] - t[0]).collect();
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Windows over which differences of positions are taken: as short as the encoder's noise lets them be.
fn windows(time: &[f64], turns: &[f64]) -> Vec<usize> {
    let n = turns.len();
    let usual = ((turns[n - 1] - turns[0]).abs().max(path(turns)) / (time[n - 1] - time[0])).max(1e-12);
    let mut length = 1;
    while n / (2 * length) >= LEAST_WINDOWS {
        let ends: Vec<usize> = (0..n).step_by(length).collect();
        let speeds: Vec<f64> =
            ends.windows(2).map(|w| (turns[w[1]] - turns[w[0]]) / (time[w[1]] - time[w[0]])).collect();
        let (sum, count) = speeds.windows(3).fold((0.0, 0.0), |(sum, count), v| {
            let d = v[0] - 2.0 * v[1] + v[2];
            // Errors of the ends come twice, with either sign: 20 of them squared in a second difference of speeds, 2 in a speed.
            (sum + d * d / 10.0, count + 1.0)
        });
        if (sum / f64::max(count, 1.0)).sqrt() < WINDOW_NOISE * usual {
            break;
        }
        length *= 2;
    }
    (0..n).step_by(length).collect()
}

fn path(turns: &[f64]) -> f64 {
    // Steps of some samples, so that jitter of an encoder at rest is no way travelled.
    let step = (turns.len() / 100).max(1);
    turns.iter().step_by(step).zip(turns.iter().skip(step).step_by(step)).map(|(a, b)| (b - a).abs()).sum()
}
