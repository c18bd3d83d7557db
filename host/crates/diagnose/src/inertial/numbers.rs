//! The numbers of a set of effects, and of the motor itself, with 95 % intervals.

use super::super::finding::Estimate;
use super::effects::{EFFECTS, Free, over_angle, reported};
use super::fit::{derivatives, noise_of_runs};
use super::sets::{Ground, Set, memory};
use super::values::P;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;
use twum_fit::noise::Noise;
use twum_fit::quantile::{NORMAL_95, student_95};

/// Pieces of a run whose errors count as independent of each other for the intervals.
const PIECES: usize = 12;

/// Numbers of a set with 95 % intervals.
pub fn estimates(ground: &Ground, set: &Set, numbers: &[P]) -> Vec<Estimate> {
    let uncertain = Uncertainty::of(ground, set);
    let over = |p: &P| numbers.iter().filter_map(|n| over_angle(*n)).all(|(sin, _)| sin != *p);
    numbers
        .iter()
        .filter(|p| over(p))
        .flat_map(|p| {
            if let Some((sin, at)) = over_angle(*p) {
                return ripple(ground, set, [*p, sin], at, &uncertain);
            }
            let value = set.plant.values.get(*p);
            let free = uncertain.free.iter().find(|f| f.number == *p);
            let (low, high) = free.map_or((value, value), |f| f.bounds);
            let half = NORMAL_95 * uncertain.sd(&[(*p, 1.0)]);
            let (name, unit) = reported(*p);
            vec![Estimate {
                name: name.to_owned(),
                value,
                interval: [(value - half).max(low), (value + half).min(high)],
                unit: unit.to_owned(),
            }]
        })
        .collect()
}

/// Height, order and phase (of the first run's angle) of a torque over the angle.
fn ripple(ground: &Ground, set: &Set, [cos, sin]: [P; 2], at: usize, uncertain: &Uncertainty) -> Vec<Estimate> {
    let [c, s] = [cos, sin].map(|p| set.plant.values.get(p));
    let height = c.hypot(s).max(1e-12);
    let across = uncertain.sd(&[(cos, c / height), (sin, s / height)]);
    let along = uncertain.sd(&[(cos, -s / height), (sin, c / height)]);
    let known = &ground.data.ripples[at];
    let phase = (s.atan2(c) + known.phases[0]).rem_euclid(TAU);
    let name = reported(cos).0;
    let one = |name: String, value: f64, sd: f64, unit: &str| Estimate {
        name,
        value,
        interval: [value - NORMAL_95 * sd, value + NORMAL_95 * sd],
        unit: unit.to_owned(),
    };
    vec![
        one(name.to_owned(), height, across, "1"),
        one(format!("{name}_order"), known.order as f64, 0.0, "1/turn"),
        one(format!("{name}_phase_rad"), phase, along / height, "rad"),
    ]
}

/// What a run's own initial speed and gain take of a column: they are fitted beside what is common, the gain as far as it scatters.
struct OwnOfRun {
    start: DVector<f64>,
    predicted: DVector<f64>,
    /// What is taken along the prediction, for a length of one.
    taken: f64,
}

impl OwnOfRun {
    fn new(start: &[f64], predicted: &[f64], noise: Noise) -> Self {
        let start = DVector::from_column_slice(start);
        let start = &start / start.norm().max(1e-300);
        let predicted = DVector::from_column_slice(predicted);
        let predicted = &predicted - &start * start.dot(&predicted);
        let t = noise.gain_spread * noise.gain_spread;
        // The root of the inverse covariance of errors that have the gain's in them: squared, it is what the fit weighs by.
        let squares = predicted.norm_squared();
        let kept = noise.variance / (noise.variance + t * squares);
        Self { start, predicted, taken: (1.0 - kept.sqrt()) / squares.max(1e-300) }
    }

    fn without(&self, column: &[f64]) -> DVector<f64> {
        let column = DVector::from_column_slice(column);
        let column = &column - &self.start * self.start.dot(&column);
        &column - &self.predicted * (self.taken * self.predicted.dot(&column))
    }
}

/// How uncertain the numbers of a fit are: by errors that last as long as those of neighbouring samples say, and by errors that are
/// independent from piece to piece of a run only, whichever is more.
///
/// Reference: Liang and Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73 (1986) 13 (the second).
struct Uncertainty {
    free: Vec<Free>,
    /// One for each kind of error; none where the numbers cannot be told apart.
    covariances: Option<[DMatrix<f64>; 2]>,
}

impl Uncertainty {
    fn of(ground: &Ground, set: &Set) -> Self {
        let data = ground.data;
        let free = ground.free_of(&set.parts, &set.plant.values);
        let n = free.len();
        let (now, columns) = derivatives(data, &set.plant, &free);
        let noise = noise_of_runs(ground.noise_of_samples(&set.plant), data.runs.len());
        let (mut g, mut meat) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        let mut squares = 0.0;
        for (i, run) in data.runs.iter().enumerate() {
            let own = OwnOfRun::new(&columns[i][n], &now[i].rpm, noise);
            let rows = run.rpm.len();
            let rest: Vec<f64> = run.rpm.iter().zip(&now[i].rpm).map(|(y, p)| y - p).collect();
            let rest = own.without(&rest);
            squares += rest.norm_squared();
            let x = DMatrix::from_columns(&columns[i][..n].iter().map(|c| own.without(c)).collect::<Vec<_>>());
            g += x.tr_mul(&x);
            let length = rows.div_ceil(PIECES);
            for from in (0..rows).step_by(length) {
                let length = length.min(rows - from);
                let score = x.rows(from, length).tr_mul(&rest.rows(from, length));
                meat += &score * score.transpose();
            }
        }
        for (i, f) in free.iter().enumerate() {
            let precision = noise.variance / (f.sd * f.sd);
            g[(i, i)] += precision + 1e-12 * g[(i, i)];
            meat[(i, i)] += noise.variance * precision;
        }
        let Some(inverse) = g.try_inverse() else { return Self { free, covariances: None } };
        // What is fitted takes its share of the errors.
        let taken = n + 2 * data.runs.len();
        // What follows from sample to sample is counted once: a form that is a little off errs over stretches.
        let once = memory(data, &set.plant);
        let white = &inverse * (once * squares / (data.rows().saturating_sub(taken).max(1)) as f64);
        // Few pieces say less of their scatter than many: of those, as many as there are numbers are used up.
        let pieces = (PIECES * data.runs.len()) as f64;
        let left = (pieces - n as f64).max(2.0);
        let few = (pieces / left).sqrt() * student_95(left) / NORMAL_95;
        let pieces = &inverse * meat * &inverse * (few * few);
        Self { free, covariances: Some([white, pieces]) }
    }

    /// Standard deviation of a combination of numbers, so that 1.96 of them are the interval; 0 where none of them is fitted.
    fn sd(&self, combination: &[(P, f64)]) -> f64 {
        let weight = |p: P| combination.iter().filter(|c| c.0 == p).map(|c| c.1).sum::<f64>();
        let by = DVector::from_iterator(self.free.len(), self.free.iter().map(|f| weight(f.number)));
        let variance = |covariance: &DMatrix<f64>| by.dot(&(covariance * &by));
        let Some(covariances) = &self.covariances else { return f64::INFINITY };
        covariances.iter().map(variance).fold(0.0, f64::max).sqrt()
    }
}

/// The motor's own numbers.
pub fn own_numbers(ground: &Ground, set: &Set) -> Vec<Estimate> {
    let mut numbers = vec![P::Gain, P::LogLag];
    numbers.extend(ground.data.largest_load.map(|_| P::Load));
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
