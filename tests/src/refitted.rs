//! How strong what is hidden is: against the residual that a refit of the motor's own parameters leaves.

use crate::experiment::{DataSet, SAMPLE_S, Sealed};
use crate::hidden::Hidden;
use crate::motor::{ContactTable, Motor, rpm};
use crate::trace::{History, PITCH, Run, Trace};
use rayon::prelude::*;

impl Sealed {
    /// Scales the first of `hidden` until its strength is `rho`. Returns the achieved strength.
    ///
    /// The strength is read from every other run: sizes below 0.02 or above the effect's largest are not used.
    pub fn scale_to(&self, hidden: &mut Hidden, rho: f64) -> f64 {
        let part = self.part();
        let mut refitted = (part.motor.clone(), part.nuisance.latency_s);
        let noise = part.floor_from(&[], &mut refitted);
        let (mut low, mut high) = (0.01, hidden.largest());
        hidden.size = hidden.size.min(high);
        let mut achieved = 0.0;
        for _ in 0..7 {
            let total = part.floor_from(std::slice::from_ref(hidden), &mut refitted);
            achieved = (total * total - noise * noise).max(1e-6).sqrt() / noise;
            if (achieved / rho - 1.0).abs() < 0.05
                || (achieved < rho && hidden.size >= 0.999 * high && high == hidden.largest())
            {
                break;
            }
            if achieved < rho {
                low = hidden.size;
            } else {
                high = hidden.size;
            }
            let guess = hidden.size * (rho / achieved).clamp(0.3, 3.0);
            hidden.size = if guess > low && guess < high { guess } else { (low * high).sqrt() };
            if high < 1.02 * low {
                break;
            }
        }
        achieved
    }

    /// A third of the experiment, for reading strengths.
    fn part(&self) -> Self {
        let mut part = self.clone();
        let kept = (self.order.len() / 3).max(6).min(self.order.len());
        // Every kind of run once: the order is random, the first of each kind will do.
        let mut seen = Vec::new();
        part.order.retain(|run| {
            let new = !seen.contains(run);
            seen.push(*run);
            new
        });
        part.order.truncate(kept.max(part.design.duties.len() * 2));
        part
    }

    /// RMS of the speed residual in rpm after a refit of the motor's own parameters.
    pub fn floor(&self, hidden: &[Hidden]) -> f64 {
        self.floor_from(hidden, &mut (self.motor.clone(), self.nuisance.latency_s))
    }

    /// [`Self::floor`], starting the refit from a motor and a latency and leaving them refitted.
    fn floor_from(&self, hidden: &[Hidden], start: &mut (Motor, f64)) -> f64 {
        let data = self.make(hidden);
        // The refit does not touch the contact's shape, so one table serves all of it.
        let table = ContactTable::new(&self.motor);
        let (mut motor, mut latency) = start.clone();
        let seconds: f64 = data.runs.iter().map(|r| r.levels.len() as f64 * SAMPLE_S).sum();
        let mut base = self.residual(&data, &motor, &table, latency);
        let square = |r: &[f64]| r.iter().map(|v| v * v).sum::<f64>();
        let mut best = square(&base);
        for _ in 0..5 {
            let mut columns = Vec::new();
            for k in 0..5 {
                let (m, l, h) = nudged(&motor, latency, k);
                let moved = self.residual(&data, &m, &table, l);
                columns.push(moved.iter().zip(&base).map(|(a, b)| (a - b) / h).collect::<Vec<f64>>());
            }
            let before = best;
            // Levenberg's damping, from nearly none to a short step downhill.
            for damping in [1e-4, 1e-2, 0.3, 5.0] {
                let step = least_squares(&columns, &base, damping);
                let mut m = motor.clone();
                m.crest_speed *= 1.0 - step[0].clamp(-0.3, 0.3);
                m.contact *= 1.0 - step[1].clamp(-0.5, 0.5);
                m.off_friction *= 1.0 - step[2].clamp(-0.5, 0.5);
                m.viscous = (m.viscous * (1.0 - step[3].clamp(-3.0, 0.95))).max(1e-3);
                let l = latency - step[4].clamp(-1e-3, 1e-3);
                let trial = self.residual(&data, &m, &table, l);
                if square(&trial) < best {
                    best = square(&trial);
                    (motor, latency, base) = (m, l, trial);
                    break;
                }
            }
            if before - best < 1e-3 * before {
                break;
            }
        }
        *start = (motor, latency);
        (best / seconds).sqrt()
    }

    /// Speed residuals of every edge interval against the motor alone, weighted by the root of their duration.
    fn residual(&self, data: &DataSet, motor: &Motor, table: &ContactTable, latency: f64) -> Vec<f64> {
        let parts: Vec<Vec<f64>> = data
            .runs
            .par_iter()
            .map(|run| {
                let bare = Run {
                    duty: run.duty,
                    sign: run.sign,
                    pwm_hz: run.pwm_hz,
                    seconds: run.seconds,
                    zero_angle: 0.0,
                    gain: 1.0,
                    history: History::default(),
                };
                let mut trace = Trace::new(motor, table, bare, &[], 0);
                let mut out = Vec::new();
                let mut last: Option<(f64, f64)> = None;
                for n in 1..run.levels.len() {
                    if run.levels[n] != run.levels[n - 1] {
                        let t = (n as f64 - 0.5) * SAMPLE_S;
                        let angle = trace.angle_at(t - latency);
                        if let Some((t0, a0)) = last {
                            let dt = t - t0;
                            out.push(rpm(run.sign * PITCH - (angle - a0)) / dt * dt.sqrt());
                        }
                        last = Some((t, angle));
                    }
                }
                out
            })
            .collect();
        parts.concat()
    }
}

fn nudged(motor: &Motor, latency: f64, k: usize) -> (Motor, f64, f64) {
    let mut m = motor.clone();
    let h = 0.01;
    match k {
        0 => m.crest_speed *= 1.0 + h,
        1 => m.contact *= 1.0 + 5.0 * h,
        2 => m.off_friction *= 1.0 + 5.0 * h,
        3 => m.viscous *= 1.0 + 20.0 * h,
        _ => return (m, latency + 1e-4, 1e-4),
    }
    (
        m,
        latency,
        match k {
            0 => h,
            3 => 20.0 * h,
            _ => 5.0 * h,
        },
    )
}

/// Coefficients of `columns` that best explain `y` (normal equations, Gaussian elimination).
fn least_squares(columns: &[Vec<f64>], y: &[f64], damping: f64) -> Vec<f64> {
    let n = columns.len();
    let mut a = vec![vec![0.0; n + 1]; n];
    for i in 0..n {
        for j in 0..n {
            a[i][j] = columns[i].iter().zip(&columns[j]).map(|(p, q)| p * q).sum();
        }
        a[i][n] = columns[i].iter().zip(y).map(|(p, q)| p * q).sum();
        a[i][i] *= 1.0 + damping;
        a[i][i] += 1e-12;
    }
    for i in 0..n {
        let (above, below) = a.split_at_mut(i + 1);
        let pivot = &above[i];
        for row in below {
            let f = row[i] / pivot[i];
            for (value, p) in row.iter_mut().zip(pivot).skip(i) {
                *value -= f * p;
            }
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let s: f64 = (i + 1..n).map(|j| a[i][j] * x[j]).sum();
        x[i] = (a[i][n] - s) / a[i][i];
    }
    x
}
