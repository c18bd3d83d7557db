//! The numbers of a set of effects, and of the motor itself, with 95 % intervals.

use super::super::finding::Estimate;
use super::effects::{EFFECTS, reported};
use super::fit::derivatives;
use super::held_out::squared_error;
use super::plant::P;
use super::sets::{Ground, Set};
use nalgebra::{DMatrix, DVector};

/// Pieces of a run whose errors count as independent of each other for the intervals.
const PIECES: usize = 12;

/// Numbers of a set with 95 % intervals: errors of pieces of the runs are independent, those of neighbouring samples are not.
pub fn estimates(ground: &Ground, set: &Set, numbers: &[P]) -> Vec<Estimate> {
    let spread = spreads(ground, set);
    let free = ground.free(&set.parts);
    numbers
        .iter()
        .map(|p| {
            let k = free.iter().position(|f| f.number == *p);
            let (value, sd) = (set.plant.values.get(*p), k.map_or(0.0, |k| spread[k]));
            let (low, high) = k.map_or((value, value), |k| free[k].bounds);
            let (name, unit) = reported(*p);
            Estimate {
                name: name.to_owned(),
                value,
                interval: [(value - 1.96 * sd).max(low), (value + 1.96 * sd).min(high)],
                unit: unit.to_owned(),
            }
        })
        .collect()
}

fn spreads(ground: &Ground, set: &Set) -> Vec<f64> {
    let data = ground.data;
    let free = ground.free(&set.parts);
    let n = free.len();
    let (now, columns) = derivatives(data, &set.plant, &free);
    let noise = ground.noise(&set.plant);
    let (mut g, mut meat) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
    for (i, run) in data.runs.iter().enumerate() {
        for rows in (0..run.rpm.len()).collect::<Vec<_>>().chunks(run.rpm.len().div_ceil(PIECES)) {
            let mut score = DVector::zeros(n);
            for k in rows {
                let row = DVector::from_fn(n, |c, _| columns[i][c][*k]);
                score += &row * (run.rpm[*k] - now[i].rpm[*k]);
                g += &row * row.transpose();
            }
            meat += &score * score.transpose();
        }
    }
    for (i, f) in free.iter().enumerate() {
        let precision = noise.variance / (f.sd * f.sd);
        g[(i, i)] += precision + 1e-12 * g[(i, i)];
        meat[(i, i)] += noise.variance * precision;
    }
    let white = squared_error(data, &set.plant) / data.rows() as f64;
    let Some(inverse) = g.try_inverse() else { return vec![f64::INFINITY; n] };
    let robust = &inverse * meat * &inverse;
    (0..n).map(|i| robust[(i, i)].max(white * inverse[(i, i)]).max(0.0).sqrt()).collect()
}

/// The motor's own numbers.
pub fn own_numbers(ground: &Ground, set: &Set) -> Vec<Estimate> {
    let mut numbers = vec![P::Gain, P::LogLag];
    numbers.extend(
        set.parts.iter().filter(|p| EFFECTS[p.effect].own).flat_map(|p| EFFECTS[p.effect].forms[p.form].numbers),
    );
    let mut own = estimates(ground, set, &numbers);
    for e in own.iter_mut().filter(|e| e.name == "log_lag") {
        *e = Estimate {
            name: "lag_s".to_owned(),
            value: e.value.exp(),
            interval: e.interval.map(f64::exp),
            unit: "s".to_owned(),
        };
    }
    own
}
