//! The numbers of a set of effects, and of the motor itself, with 95 % intervals.

use super::super::finding::Estimate;
use super::effects::{EFFECTS, over_angle, reported};
use super::fit::derivatives;
use super::held_out::squared_error;
use super::plant::P;
use super::sets::{Ground, Set};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;
use twum_fit::quantile::{NORMAL_95, student_95};

/// Pieces of a run whose errors count as independent of each other for the intervals.
const PIECES: usize = 12;

/// Numbers of a set with 95 % intervals: errors of pieces of the runs are independent, those of neighbouring samples are not.
pub fn estimates(ground: &Ground, set: &Set, numbers: &[P]) -> Vec<Estimate> {
    let spread = spreads(ground, set);
    let free = ground.free(&set.parts);
    let over = |p: &P| numbers.iter().filter_map(|n| over_angle(*n)).all(|(sin, _)| sin != *p);
    numbers
        .iter()
        .filter(|p| over(p))
        .flat_map(|p| {
            if let Some((sin, at)) = over_angle(*p) {
                return ripple(ground, set, [*p, sin], at, &spread);
            }
            let k = free.iter().position(|f| f.number == *p);
            let (value, sd) = (set.plant.values.get(*p), k.map_or(0.0, |k| spread[k]));
            let (low, high) = k.map_or((value, value), |k| free[k].bounds);
            let (name, unit) = reported(*p);
            vec![Estimate {
                name: name.to_owned(),
                value,
                interval: [(value - 1.96 * sd).max(low), (value + 1.96 * sd).min(high)],
                unit: unit.to_owned(),
            }]
        })
        .collect()
}

/// Height, order and phase (of the first run's angle) of a torque over the angle.
fn ripple(ground: &Ground, set: &Set, pair: [P; 2], at: usize, spread: &[f64]) -> Vec<Estimate> {
    let free = ground.free(&set.parts);
    let [c, s] = pair.map(|p| set.plant.values.get(p));
    let sd = pair.map(|p| free.iter().position(|f| f.number == p).map_or(0.0, |k| spread[k]));
    let height = c.hypot(s).max(1e-12);
    let across = (c * sd[0]).hypot(s * sd[1]) / height;
    let along = (s * sd[0]).hypot(c * sd[1]) / height;
    let known = &ground.data.ripples[at];
    let phase = (s.atan2(c) + known.phases[0]).rem_euclid(TAU);
    let name = reported(pair[0]).0;
    let one = |name: String, value: f64, sd: f64, unit: &str| Estimate {
        name,
        value,
        interval: [value - 1.96 * sd, value + 1.96 * sd],
        unit: unit.to_owned(),
    };
    vec![
        one(name.to_owned(), height, across, "1"),
        one(format!("{name}_order"), known.order as f64, 0.0, "1/turn"),
        one(format!("{name}_phase_rad"), phase, along / height, "rad"),
    ]
}

/// Standard deviations of what is free, so that 1.96 of them are the interval.
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
    // Few pieces say less of their scatter than many: of those, as many as there are numbers are used up.
    let pieces = (PIECES * data.runs.len()) as f64;
    let left = (pieces - n as f64).max(2.0);
    let few = (pieces / left).sqrt() * student_95(left) / NORMAL_95;
    let robust = &inverse * meat * &inverse * (few * few);
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
