//! The line of the PWM in the records: where it lies says how fast the recorder's clock ran.
//!
//! Reference: the periodogram of unevenly sampled data (Lomb, Astrophysics and Space Science 39 (1976) 447), here of the speed between
//! edges, with the power of all runs added up.

use super::observe::Observed;
use super::problem::Problem;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Largest relative error that is looked for: beyond a twentieth a recorder is not wrong but another.
pub const LARGEST: f64 = 0.05;
/// Points on the width of a line, which is the inverse of a record's length.
const POINTS_A_LINE: f64 = 6.0;
/// Most points of a scan: 20 s at 400 Hz.
const MOST_POINTS: usize = 5000;
/// Lines that are handed on.
const LINES: usize = 2;

/// Relative errors of the recorder's clock at which the PWM's line stands out, strongest first; empty where it is in its place, or
/// without pulsed runs.
pub fn clock_errors(problem: &Problem) -> Vec<f64> {
    let pulsed: Vec<&Observed> =
        problem.runs.iter().filter(|r| r.pitch > 0.0 && r.duty.is_some_and(|d| d > 0.0 && d < 1.0 - 1e-9)).collect();
    let longest = pulsed.iter().map(|r| r.pwm_hz * r.record_end.min(r.drive_end)).fold(0.0, f64::max);
    let points = ((2.0 * LARGEST * longest * POINTS_A_LINE) as usize).min(MOST_POINTS);
    if points < 3 {
        return Vec::new();
    }
    let step = 2.0 * LARGEST / (points - 1) as f64;
    let power = pulsed
        .par_iter()
        .map(|r| scan(r, points, step))
        .reduce(|| vec![0.0; points], |a, b| a.iter().zip(&b).map(|(x, y)| x + y).collect());
    let mut peaks: Vec<usize> =
        (1..points - 1).filter(|k| power[*k] >= power[k - 1] && power[*k] > power[k + 1]).collect();
    peaks.sort_by(|a, b| power[*b].total_cmp(&power[*a]));
    // A clock that runs fast by e sees the line at f/(1 + e).
    let errors = peaks.into_iter().take(LINES).map(|k| 1.0 / (1.0 - LARGEST + step * k as f64) - 1.0);
    errors.filter(|e| e.abs() > step).collect()
}

/// Power of a run's speed at `points` multiples of the PWM frequency from 1 − [`LARGEST`] in steps of `step`, as a share of the run's own.
fn scan(run: &Observed, points: usize, step: f64) -> Vec<f64> {
    let driven = |w: &&super::observe::Window| w.low == w.high && run.times[w.to] <= run.drive_end;
    let windows: Vec<_> = run.windows.iter().filter(driven).collect();
    let speed = |w: &super::observe::Window| w.low / run.duration(w).max(1e-6);
    let seconds: f64 = windows.iter().map(|w| run.duration(w)).sum();
    let mean = windows.iter().map(|w| w.low).sum::<f64>() / seconds.max(1e-9);
    let square: f64 = windows.iter().map(|w| (speed(w) - mean).powi(2) * run.duration(w)).sum();
    let mut sums = vec![[0.0_f64; 2]; points];
    for w in windows {
        let t = 0.5 * (run.times[w.from] + run.times[w.to]);
        let weight = (speed(w) - mean) * run.duration(w);
        let (mut s, mut c) = (TAU * run.pwm_hz * (1.0 - LARGEST) * t).sin_cos();
        let (ds, dc) = (TAU * run.pwm_hz * step * t).sin_cos();
        for sum in &mut sums {
            sum[0] += weight * c;
            sum[1] += weight * s;
            (c, s) = (c * dc - s * ds, s * dc + c * ds);
        }
    }
    sums.iter().map(|z| (z[0] * z[0] + z[1] * z[1]) / (square * seconds).max(1e-12)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rotor of 5 rad/s whose speed swings by half at 50 Hz, recorded for 4 s by a clock that is fast by `error`.
    fn recorded(error: f64) -> Problem {
        let mut run = Observed {
            drive_end: 4.0,
            pitch: TAU / 1000.0,
            time_spread: 2e-6,
            record_end: 4.0,
            ..Observed::unrecorded()
        };
        let (mut angle, mut edges) = (0.0, Vec::new());
        let dt = 1e-5;
        for k in 0..380_000 {
            let t = f64::from(k) * dt;
            let before = angle;
            angle += 5.0 * (1.0 + 0.5 * (TAU * 50.0 * t).sin()) * dt;
            if (angle / run.pitch).floor() > (before / run.pitch).floor() {
                edges.push((t * (1.0 + error), edges.len() % 2 == 0));
            }
        }
        run.put_edges(&edges, true, 0.0, 4.0);
        Problem::new(vec![run])
    }

    /// Fails if the scan is too coarse for a line of 4 s, or if its sign is turned.
    #[test]
    fn the_line_says_how_fast_the_clock_ran() {
        for error in [0.021, -0.037] {
            let found = clock_errors(&recorded(error));
            assert!(found.first().is_some_and(|e| (e - error).abs() < 1e-3), "{error}: {found:?}");
        }
        assert!(clock_errors(&recorded(0.0)).first().is_none_or(|e| e.abs() > 3e-3));
    }
}
