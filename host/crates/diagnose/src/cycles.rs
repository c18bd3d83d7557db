//! Terms that return at a rate of their own, read off what the motor leaves: so many times a turn, though no whole number of them (a bearing's
//! cage, a pattern that slips), or so many times a second.

use super::design::{Basis, RunDesign};
use super::discrepancy::{Term, flexible};
use super::observe::{Observed, Window};
use super::problem::{Model, Problem};
use super::rotor::Parameters;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Whole numbers of a turn that come beside, as terms of their own (`discrepancy.rs`): up to as many times a turn a rate is looked for.
const WHOLE: usize = 8;
/// Cycles in the longest run from which something returns rather than drifts.
const FEWEST_CYCLES: f64 = 2.0;
/// Steps of the rate in what one cycle more in the longest run makes of it: at the nearest one the ends of that run are an eighth of a cycle
/// off, and nine tenths of the amplitude are seen.
const STEPS_A_CYCLE: f64 = 2.0;
/// Rates on either side of the best step, up to half way to the next, that are tried in the end.
const FINER: i32 = 4;
/// Most rates that are tried, the slowest first: it leaves the fastest out of runs of more than 100 s at 10 Hz, or of 125 turns.
const MOST_RATES: usize = 2000;
/// Share of the PWM frequency up to which cycles are looked for: what comes every fourth period has a term of its own.
const MOST_OF_THE_PWM: f64 = 0.2;
/// Share of the largest diagonal element of the equations that is added to each, for columns that a run does not show.
const RIDGE: f64 = 1e-9;
/// Share of their squares below which what is left of cosine and sine beside the rest is taken for none.
const APART: f64 = 1e-6;

/// The term at the rate of the angle and the one at that of the time which take the most of what a motor leaves of one run of each kind.
pub fn cycles(problem: &Problem, motor: &Parameters) -> Vec<Term> {
    if problem.closed() {
        // A reference has a rate of its own.
        return Vec::new();
    }
    let problem = &problem.one_of_each();
    let left = left_over(problem, &problem.model(motor.clone()));
    let turns = problem.most_turns();
    let longest_s = problem.runs.iter().map(|r| r.drive_end).fold(0.0, f64::max);
    let pwm_hz = problem.runs.iter().map(|r| r.pwm_hz).fold(f64::INFINITY, f64::min);
    let whole = |order: &f64| order.round() >= 1.0 && (order - order.round()).abs() < 0.5 / turns;
    let orders: Vec<f64> = rates(turns, WHOLE as f64).into_iter().filter(|order| !whole(order)).collect();
    let hertz = rates(longest_s, MOST_OF_THE_PWM * pwm_hz);
    let phases = |of: &dyn Fn(&Observed, &Window) -> f64| -> Vec<Vec<f64>> {
        problem.runs.iter().map(|run| run.windows.iter().map(|w| of(run, w)).collect()).collect()
    };
    let angles = phases(&|run, w| w.middle(&run.angles));
    let turned = phases(&|run, w| TAU * w.middle(&run.times));
    let term = |lives_in: &'static str, basis: fn(f64, u8) -> Basis, rates: &[f64], step: f64, phases: &[Vec<f64>]| {
        best(&left, rates, step, phases).map(|rate| Term {
            among: rates.len(),
            ..Term::harmonic(lives_in, [0, 1].map(|quarter| basis(rate, quarter)).to_vec(), &[])
        })
    };
    let angle = term("angle, no whole number of times a turn", Basis::Angle, &orders, step(turns), &angles);
    let time = term("time, so many cycles a second", Basis::Cycle, &hertz, step(longest_s), &turned);
    angle.into_iter().chain(time).collect()
}

/// What rates differ by that the longest run, of so many turns or seconds, tells apart.
fn step(longest: f64) -> f64 {
    1.0 / (STEPS_A_CYCLE * longest.max(1e-9))
}

/// Such rates, up to the `most`.
fn rates(longest: f64, most: f64) -> Vec<f64> {
    let from = FEWEST_CYCLES * STEPS_A_CYCLE;
    (0..).map(|k| (from + f64::from(k)) * step(longest)).take_while(|rate| *rate <= most).take(MOST_RATES).collect()
}

/// What the model leaves of one run beside a trend of its own and whole numbers of a turn.
struct Left {
    residual: DVector<f64>,
    /// What a relative change of the speed makes of each window.
    speed: DVector<f64>,
    /// What was fitted beside, orthonormal: windows × columns.
    beside: DMatrix<f64>,
}

/// The same of all runs.
fn left_over(problem: &Problem, model: &Model) -> Vec<Left> {
    // Two hats that add up to the speed.
    let trend = [0, 1].map(|k| Basis::Time(k, 2));
    let whole = (1..=WHOLE).flat_map(|order| [0, 1].map(|quarter| Basis::Angle(order as f64, quarter)));
    let designs = problem.design(model, &flexible(trend.into_iter().chain(whole).collect()));
    let of = |d: &RunDesign| {
        let x = DMatrix::from_row_slice(d.y.len(), d.columns, &d.x);
        let speed = x.column(0) + x.column(1);
        Left::new(DVector::from_column_slice(&d.y), speed, &x)
    };
    designs.par_iter().map(of).collect()
}

/// The rate that takes the most squared error, of some that lie a `step` apart and what is between; `phases` are those of each window at a rate
/// of one.
fn best(left: &[Left], rates: &[f64], step: f64, phases: &[Vec<f64>]) -> Option<f64> {
    let taken = |rate: f64| left.iter().zip(phases).map(|(l, phases)| l.taken(rate, phases)).sum::<f64>();
    let most = |rates: &[f64]| {
        let all: Vec<(f64, f64)> = rates.par_iter().map(|rate| (taken(*rate), *rate)).collect();
        all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map(|best| best.1)
    };
    let coarse = most(rates)?;
    let finer: Vec<f64> = (-FINER..=FINER).map(|k| coarse + 0.5 * step * f64::from(k) / f64::from(FINER)).collect();
    most(&finer)
}

impl Left {
    fn new(residual: DVector<f64>, speed: DVector<f64>, columns: &DMatrix<f64>) -> Self {
        let mut g = columns.tr_mul(columns);
        let ridge = RIDGE * g.diagonal().max();
        (0..g.nrows()).for_each(|k| g[(k, k)] += ridge);
        let orthonormal = g.cholesky().and_then(|chol| chol.l().solve_lower_triangular(&columns.transpose()));
        let beside = orthonormal.map_or_else(|| DMatrix::zeros(residual.len(), 0), |rows| rows.transpose());
        let residual = &residual - &beside * beside.tr_mul(&residual);
        Self { residual, speed, beside }
    }

    /// Squared error that a cosine and a sine take besides, each with a coefficient of its own.
    fn taken(&self, rate: f64, phases: &[f64]) -> f64 {
        let (mut cosine, mut sine) = (self.speed.clone(), self.speed.clone());
        for (k, phase) in phases.iter().enumerate() {
            let (s, c) = (rate * phase).sin_cos();
            cosine[k] *= c;
            sine[k] *= s;
        }
        let [beside_c, beside_s] = [&cosine, &sine].map(|column| self.beside.tr_mul(column));
        let raw = [cosine.norm_squared(), sine.norm_squared()];
        let cc = raw[0] - beside_c.norm_squared();
        let ss = raw[1] - beside_s.norm_squared();
        let cs = cosine.dot(&sine) - beside_c.dot(&beside_s);
        let (cy, sy) = (cosine.dot(&self.residual), sine.dot(&self.residual));
        let determinant = cc * ss - cs * cs;
        if determinant <= APART * raw[0] * raw[1] {
            return 0.0;
        }
        (ss * cy * cy - 2.0 * cs * cy * sy + cc * sy * sy) / determinant
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if a rate is missed for another one, or if runs that differ in their phase hide it.
    #[test]
    fn the_rate_is_found_though_every_run_has_its_own_phase() {
        let angle = |k: usize| 0.07 * k as f64;
        let run = |phase: f64| {
            let residual = DVector::from_fn(500, |k, _| (2.37 * angle(k) - phase).cos() + 0.5 * (7.0 * k as f64).sin());
            Left::new(residual, DVector::from_element(500, 10.0), &DMatrix::from_element(500, 1, 10.0))
        };
        let left = [run(0.0), run(2.0), run(4.0)];
        let phases = vec![(0..500).map(angle).collect::<Vec<f64>>(); 3];
        let rate = best(&left, &rates(35.0 / TAU, 8.0), step(35.0 / TAU), &phases).expect("there are rates");
        assert!((rate - 2.37).abs() < 0.05, "{rate}");
    }

    /// Fails if a rate that a whole number nearly takes, of so short a run, is put where that one takes less.
    #[test]
    fn a_rate_is_not_moved_by_what_is_fitted_beside() {
        let angle = |k: usize| 0.025 * k as f64;
        let whole = DMatrix::from_fn(500, 3, |k, j| [1.0, (4.0 * angle(k)).cos(), (4.0 * angle(k)).sin()][j]);
        let residual = DVector::from_fn(500, |k, _| (4.15 * angle(k) - 1.0).cos());
        let left = [Left::new(residual, DVector::from_element(500, 1.0), &whole)];
        let phases = [(0..500).map(angle).collect::<Vec<f64>>()];
        let rate = best(&left, &rates(12.5 / TAU, 8.0), step(12.5 / TAU), &phases).expect("there are rates");
        assert!((rate - 4.15).abs() < 0.1, "{rate}");
    }
}
