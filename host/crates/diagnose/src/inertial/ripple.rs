//! Torques that go with the angle: which orders of a turn stand out of what a plant leaves, and where in them each run begins.
//!
//! The angle is the measured one, or the sum of the measured speeds: the torque is then as any other input, known up to its size, and
//! does not drift away from the motor. Where the angles of the runs begin at unknown places, each run has a phase of its own.

use super::angle::{Course, KEPT, MOST_ORDERS, Ripple};
use super::data::{Data, DriveRun};
use super::fit::Plant;
use super::plant::{Motion, simulate, simulate_all};
use super::values::P;
use nalgebra::{Complex, DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Periods that the way between the ends of a run must have: over less than half of one a torque only rises or only falls with the angle, as
/// that of a spring does.
const LEAST_PERIODS: f64 = 0.5;
/// By how much more an order must take than any other: what goes with the input takes from many orders alike.
const STANDS_OUT: f64 = 1.5;
/// By how much the plant's lag is off where a torque over the angle is missing in it: a rotor that teeth hold now and then looks quicker
/// than it is, one that runs from tooth to tooth slower.
const LAGS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Rows of a run that are looked at: each order is held against all of them.
const LOOKED_AT: usize = 8000;
/// Phases within which the runs begin at one place: half a period would be chance.
const AGREE_RAD: f64 = 0.3;
/// Nats that an order must take beyond its costs before it is offered at all, as [`super::super::verdict`] names by.
const LEAST_NATS: f64 = 10.0;

/// Times that an angle is told anew: each leaves a tenth of what it was off.
const FOLLOWED: usize = 8;
/// Knots of a drift over a run.
const KNOTS: usize = 16;
/// Radians by which an angle is moved at once: beyond, a wave is no straight line.
const MOST_AHEAD: f64 = 0.7;

/// What a torque makes of the speeds that are compared, through the lag.
fn through_lag(run: &DriveRun, torque: impl Fn(usize) -> Complex<f64>, lag_s: f64) -> Vec<Complex<f64>> {
    let mut speed = Complex::ZERO;
    let mut at = Vec::with_capacity(run.time.len());
    at.push(speed);
    let (mut step, mut decay) = (f64::NAN, 0.0);
    for k in 0..run.time.len() - 1 {
        if run.time[k + 1] - run.time[k] != step {
            step = run.time[k + 1] - run.time[k];
            decay = (-step / lag_s).exp();
        }
        speed = speed * decay + torque(k) * (1.0 - decay);
        at.push(speed);
    }
    match &run.windows {
        None => at,
        Some(ends) => {
            let mean = |w: &[usize]| at[w[0]..w[1]].iter().sum::<Complex<f64>>() / (w[1] - w[0]) as f64;
            ends.windows(2).map(mean).collect()
        }
    }
}

/// What an order takes of the residuals of a run beside the plant's own gain: the squared error that both leave, that the gain alone
/// leaves, and the coefficients of its torque.
#[derive(Clone, Copy)]
struct Taken {
    left: f64,
    before: f64,
    torque: Complex<f64>,
}

/// Least squares of a run's residuals over an order, beside what the plant predicts and a constant.
fn taken(of: &Left, wave: &[Complex<f64>]) -> Taken {
    let Left { predicted, rest, .. } = of;
    let n = rest.len() as f64;
    let (mean_p, mean_r) = (predicted.iter().sum::<f64>() / n, rest.iter().sum::<f64>() / n);
    let mean_w = wave.iter().sum::<Complex<f64>>() / n;
    let (mut g, mut b, mut rr) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros(), 0.0);
    for ((p, r), w) in predicted.iter().zip(rest).zip(wave) {
        let (w, r) = (w - mean_w, r - mean_r);
        let row = Vector3::new(p - mean_p, w.re, w.im);
        g += row * row.transpose();
        b += row * r;
        rr += r * r;
    }
    (0..3).for_each(|j| g[(j, j)] += 1e-9 * g[(j, j)] + 1e-12);
    let solved = g.cholesky().map_or(Vector3::zeros(), |c| c.solve(&b));
    let before = (rr - b[0] * b[0] / g[(0, 0)]).max(0.0);
    Taken { left: (rr - b.dot(&solved)).clamp(0.0, before), before, torque: Complex::new(solved[1], solved[2]) }
}

/// The residuals of a run with what they are of.
struct Left {
    run: DriveRun,
    lag_s: f64,
    predicted: Vec<f64>,
    rest: Vec<f64>,
}

/// What a plant leaves with another lag.
fn left(data: &Data, plant: &Plant, lag_s: f64) -> Vec<Left> {
    let motions = simulate_all(data, &plant.values.with(P::LogLag, lag_s.ln()), &plant.starts);
    let one = |(run, mut m): (&DriveRun, Motion)| {
        let rows = 0..run.rpm.len().min(LOOKED_AT);
        m.rpm.truncate(rows.end);
        let rest = run.rpm.iter().zip(&m.rpm).map(|(y, p)| y - p).collect();
        Left { run: run.stretch(rows), lag_s, predicted: m.rpm, rest }
    };
    data.runs.iter().zip(motions).map(one).collect()
}

/// The data with the orders that stand out of what a plant leaves; none where none does.
pub fn aligned(data: &Data, plant: &Plant, independent: f64) -> Option<Data> {
    let mut looks: Vec<Vec<Left>> =
        LAGS.into_par_iter().map(|by| left(data, plant, by * plant.values.lag_s())).collect();
    let mut ripples: Vec<Ripple> = Vec::new();
    let mut lag_s = plant.values.lag_s();
    while ripples.len() < KEPT {
        let orders: Vec<usize> = (1..=MOST_ORDERS).filter(|n| ripples.iter().all(|r| r.order != *n)).collect();
        let Some(found) = strongest(&looks, &orders) else { break };
        let ripple = Ripple { order: found.order, phases: phases(&found.runs) };
        let nats = -0.5 * independent * (1.0 - found.share.min(0.999_999)).ln();
        if found.share < STANDS_OUT * found.other || nats < LEAST_NATS + ripple.cost() {
            break;
        }
        if ripples.is_empty() {
            lag_s = found.lag_s;
        }
        looks.par_iter_mut().flatten().for_each(|l| {
            let [wave, _] = seen(&l.run, ripple.order, l.lag_s);
            let torque = taken(l, &wave).torque;
            l.rest.iter_mut().zip(wave).for_each(|(r, w)| *r -= (torque.conj() * w).re);
        });
        ripples.push(ripple);
    }
    (!ripples.is_empty()).then(|| data.with_ripples(ripples, lag_s, None))
}

/// The data with the angle told anew by a plant with a torque over it, which `refit` fits to what is then told.
pub fn followed(data: &Data, plant: &Plant, refit: impl Fn(&Data, Plant) -> Plant) -> Data {
    let (mut data, mut plant) = reordered(data, plant);
    for _ in 0..FOLLOWED {
        data = told(&data, &plant);
        plant = refit(&data, plant);
    }
    data
}

/// The data and the plant with another order, where one that the way does not tell from it leaves less through the lag that is now known.
fn reordered(data: &Data, plant: &Plant) -> (Data, Plant) {
    let pairs = [[P::CoggingCos, P::CoggingSin], [P::RippleCos, P::RippleSin], [P::Cogging2Cos, P::Cogging2Sin]];
    let bare = pairs.iter().flatten().fold(plant.values, |v, p| v.with(*p, 0.0));
    let left = left(data, &Plant { values: bare, ..plant.clone() }, bare.lag_s());
    let way = left.iter().map(|l| span(&l.run)).fold(1e-3, f64::max);
    let (now, near) = (data.ripples[0].order, (1.0 / way).ceil() as usize);
    let taken = |n: &usize| data.ripples[1..].iter().any(|r| r.order == *n);
    let orders = now.saturating_sub(near).max(1)..=(now + near).min(MOST_ORDERS);
    let orders: Vec<usize> = orders.filter(|n| !taken(n)).collect();
    let Some(found) = strongest(&[left], &orders).filter(|f| f.order != now) else {
        return (data.clone(), plant.clone());
    };
    let mut ripples = data.ripples.clone();
    ripples[0] = Ripple { order: found.order, phases: phases(&found.runs) };
    let mut values = plant.values;
    for [cos, sin] in &pairs[..2] {
        values.set(*cos, values.get(*cos).hypot(values.get(*sin)));
        values.set(*sin, 0.0);
    }
    (data.with_ripples(ripples, bare.lag_s(), None), Plant { values, ..plant.clone() })
}

/// The angle by what a plant makes of the runs: between the samples by the plant's speeds; and where it is the sum of measured speeds, whose
/// noise drifts away from the motor, by where in the order the torque is seen to be.
fn told(data: &Data, plant: &Plant) -> Data {
    let lag_s = plant.values.lag_s();
    let motions = simulate_all(data, &plant.values, &plant.starts);
    let (mut runs, mut speeds) = (data.runs.clone(), Vec::new());
    for (i, run) in runs.iter_mut().enumerate() {
        if run.windows.is_none() && !data.unsigned {
            for (turns, by) in run.turns.iter_mut().zip(drift(data, plant, i, &motions[i].rpm)) {
                *turns += by;
            }
        }
        let sampled = DriveRun { windows: None, ..run.clone() };
        speeds.push(simulate(&sampled, &plant.values, plant.starts[i], false).rpm);
    }
    Data { runs, ..data.clone() }.with_ripples(data.ripples.clone(), lag_s, Some(&speeds))
}

/// By how many turns the motor is ahead of its summed speeds at every sample: a course over knots, as far as noise lets the sum drift.
fn drift(data: &Data, plant: &Plant, at: usize, predicted: &[f64]) -> Vec<f64> {
    let (run, v, ripple) = (&data.runs[at], &plant.values, &data.ripples[0]);
    let n = run.rpm.len();
    let rest = DVector::from_iterator(n, run.rpm.iter().zip(predicted).map(|(y, p)| y - p));
    let variance = (rest.norm_squared() / n as f64).max(1e-12);
    let hat = |k: usize, j: usize| (1.0 - (k as f64 * (KNOTS - 1) as f64 / (n - 1) as f64 - j as f64).abs()).max(0.0);
    let columns = (0..KNOTS).map(|j| {
        let ahead = |k: usize| {
            let [re, im] = [run.ripple[k][0], run.ripple[k][1]];
            let steady = v.get(P::CoggingSin) * re - v.get(P::CoggingCos) * im;
            let driven = v.get(P::RippleSin) * re - v.get(P::RippleCos) * im;
            Complex::from((steady + driven * v.actuated(run.input[k])) * v.get(P::Gain) * hat(k, j))
        };
        DVector::from_iterator(n, through_lag(run, ahead, v.lag_s()).into_iter().map(|w| w.re))
    });
    let x = DMatrix::from_columns(&columns.collect::<Vec<_>>());
    let mut g = x.tr_mul(&x) / variance;
    // From knot to knot the sum of so many errors wanders by the root of their number.
    let radians = TAU * ripple.order as f64 / 60.0 * run.period_s;
    let step = (radians * radians * variance * n as f64 / (KNOTS - 1) as f64).max(1e-12);
    for j in 1..KNOTS {
        for (a, b, sign) in [(j, j, 1.0), (j - 1, j - 1, 1.0), (j, j - 1, -1.0), (j - 1, j, -1.0)] {
            g[(a, b)] += sign / step;
        }
    }
    g[(0, 0)] += 1.0 / (AGREE_RAD * AGREE_RAD);
    let ahead = g.cholesky().map_or(DVector::zeros(KNOTS), |c| c.solve(&(x.tr_mul(&rest) / variance)));
    let ahead = ahead.map(|a| a.clamp(-MOST_AHEAD, MOST_AHEAD) / (TAU * ripple.order as f64));
    (0..n).map(|k| (0..KNOTS).map(|j| ahead[j] * hat(k, j)).sum()).collect()
}

/// What an order of torque makes of the compared speeds, steady and going with the input.
fn seen(run: &DriveRun, order: usize, lag_s: f64) -> [Vec<Complex<f64>>; 2] {
    let wave = Course { time_s: &run.time, turns: &run.turns, rpm: None, lag_s }.waves(order);
    [through_lag(run, |k| wave[k], lag_s), through_lag(run, |k| wave[k] * run.input[k], lag_s)]
}

/// An order with what it takes.
struct Found {
    order: usize,
    lag_s: f64,
    /// Share of the squared error that it takes, and that the next best takes.
    share: f64,
    other: f64,
    runs: Vec<Taken>,
}

/// The order that leaves least, through the lag that suits it.
fn strongest(looks: &[Vec<Left>], orders: &[usize]) -> Option<Found> {
    let sum = |runs: &[Taken], of: fn(&Taken) -> f64| runs.iter().map(of).sum::<f64>();
    let way = looks[0].iter().map(|l| span(&l.run)).fold(0.0, f64::max);
    let of = |left: &[Left], order: usize| -> [Vec<Taken>; 2] {
        let both = left.iter().map(|l| seen(&l.run, order, l.lag_s).map(|wave| taken(l, &wave)));
        let (steady, driven) = both.map(|[steady, driven]| (steady, driven)).unzip();
        [steady, driven]
    };
    let mut found: Vec<(usize, f64, Vec<Taken>)> = orders
        .par_iter()
        .filter(|order| **order as f64 * way >= LEAST_PERIODS)
        .flat_map_iter(|order| looks.iter().map(|left| (*order, left[0].lag_s, of(left, *order))))
        .flat_map_iter(|(order, lag_s, ways)| ways.into_iter().map(move |runs| (order, lag_s, runs)))
        .collect();
    found.sort_by(|a, b| sum(&a.2, |t| t.left).total_cmp(&sum(&b.2, |t| t.left)));
    // Of what the line itself would leave with its lag refitted.
    let total = found.iter().map(|f| sum(&f.2, |t| t.before)).reduce(f64::min)?;
    let share = |runs: &[Taken]| 1.0 - sum(runs, |t| t.left) / total.max(1e-300);
    let (order, lag_s, runs) = found.first()?.clone();
    // Orders that the way does not tell from it are it; so are its multiples.
    let near = (1.0 / way).ceil() as usize;
    let other = found.iter().find(|f| f.0.abs_diff(order) > near && f.0 % order != 0).map_or(0.0, |f| share(&f.2));
    Some(Found { order, lag_s, share: share(&runs), other: other.max(0.0), runs })
}

/// One phase for all runs where their angles begin at one place, as those of an encoder that keeps its zero; else each its own.
fn phases(runs: &[Taken]) -> Vec<f64> {
    let together: Complex<f64> = runs.iter().map(|t| t.torque * (t.before - t.left)).sum();
    let agree = runs.iter().all(|t| (t.torque * together.conj()).arg().abs() < AGREE_RAD);
    runs.iter().map(|t| if agree { together.arg() } else { t.torque.arg() }).collect()
}

/// The way between the ends of what a run went through, in turns.
pub fn span(run: &DriveRun) -> f64 {
    let (low, high) = run.turns.iter().fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(*t), b.max(*t)));
    high - low
}
