//! Normal equations of linear least squares, and of runs that share some of their parameters.

use crate::noise::Noise;
use nalgebra::{DMatrix, DMatrixView, DVector, DVectorView};
use rayon::prelude::*;

/// What rows say of the coefficients `a` in `y ≈ X·a`.
#[derive(Debug, Clone)]
pub struct Normal {
    /// `XᵀX`.
    pub g: DMatrix<f64>,
    /// `Xᵀy`.
    pub b: DVector<f64>,
    /// `yᵀy`.
    pub yy: f64,
}

impl Normal {
    /// Of no rows.
    pub fn empty(columns: usize) -> Self {
        Self { g: DMatrix::zeros(columns, columns), b: DVector::zeros(columns), yy: 0.0 }
    }

    /// Of `y` and rows `x` that lie one after the other, each of `columns`.
    pub fn new(columns: usize, x: &[f64], y: &[f64]) -> Self {
        let mut all = Self::empty(columns);
        all.add(x, y);
        all
    }

    /// Adds rows.
    pub fn add(&mut self, x: &[f64], y: &[f64]) {
        // Rows that lie one after the other are columns of the transposed matrix.
        let x = DMatrixView::from_slice(x, self.b.len(), y.len());
        let y = DVectorView::from_slice(y, y.len());
        self.g += x * x.transpose();
        self.b += x * y;
        self.yy += y.norm_squared();
    }

    /// The same rows where `y` is less by `X·around`: coefficients that were counted from `around` are counted from nothing.
    pub fn whole(mut self, around: &DVector<f64>) -> Self {
        let shift = &self.g * around;
        self.yy += 2.0 * self.b.dot(around) + shift.dot(around);
        self.b += shift;
        self
    }

    /// With the coefficient of one column, the run's gain, left free as far as gains scatter.
    pub fn without_gain(mut self, column: usize, noise: Noise) -> Self {
        let gamma = noise.gamma(self.g[(column, column)]);
        let gain = self.g.column(column).clone_owned();
        let by = self.b[column];
        self.b -= &gain * (gamma * by);
        self.g -= &gain * gain.transpose() * gamma;
        self.yy -= gamma * by * by;
        self
    }

    /// Without the columns after the first ones, which are not fitted.
    pub fn first(self, columns: usize) -> Self {
        Self { g: self.g.resize(columns, columns, 0.0), b: self.b.resize_vertically(columns, 0.0), yy: self.yy }
    }

    /// How far the run's own coefficients, those after `common`, scatter in units of the noise, where each is known beforehand as well as
    /// `precision` says: the inverse of their block. No scatter where there is none.
    pub fn own_inverse(&self, common: usize, precision: &[f64]) -> DMatrix<f64> {
        let k = self.own(common);
        let mut block = self.g.view((common, common), (k, k)).clone_owned();
        for (i, p) in precision.iter().enumerate() {
            block[(i, i)] += p;
        }
        block.try_inverse().unwrap_or_else(|| DMatrix::zeros(k, k))
    }

    fn own(&self, common: usize) -> usize {
        self.b.len() - common
    }
}

/// What is known of a parameter beside the data, where the search stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pull {
    /// Slope of what a step costs, in units of the squared error.
    pub slope: f64,
    /// Its curvature.
    pub curvature: f64,
}

/// Solution of the normal equations of runs.
#[derive(Debug, Clone)]
pub struct Solution {
    /// The parameters that all runs share.
    pub common: DVector<f64>,
    /// Those of each run alone.
    pub own: Vec<DVector<f64>>,
}

/// Where a diagonal element is nothing, the parameter stays where it is.
const STAYS: f64 = 1e-9;

/// The step that equations `m`·x = `rhs` lead to, the diagonal made larger by a share of itself, `damping` (Marquardt, SIAM J. Appl. Math. 11 (1963)
/// 431). Nothing where there is no one solution.
pub fn damped(mut m: DMatrix<f64>, rhs: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    for i in 0..rhs.len() {
        m[(i, i)] += (damping + STAYS) * m[(i, i)].abs() + f64::MIN_POSITIVE;
    }
    if rhs.is_empty() { Some(rhs.clone()) } else { m.cholesky().map(|chol| chol.solve(rhs)) }
}

/// Solves the equations of all `runs`: the first columns are common to them and each is held by its `pulls`, the others are of a run alone
/// and known with `precision`. The runs' own are eliminated (their Schur complement), and what is left is [`damped`]. Nothing where there is no one
/// solution.
pub fn solve(runs: &[Normal], pulls: &[Pull], precision: &[f64], damping: f64) -> Option<Solution> {
    let c = pulls.len();
    let inverses: Vec<DMatrix<f64>> = runs.par_iter().map(|r| r.own_inverse(c, precision)).collect();
    let mut m = DMatrix::zeros(c, c);
    let mut rhs = DVector::zeros(c);
    for (run, inverse) in runs.iter().zip(&inverses) {
        let k = run.own(c);
        let link = run.g.view((c, 0), (k, c));
        m += run.g.view((0, 0), (c, c)) - link.transpose() * inverse * link;
        rhs += run.b.rows(0, c) - link.transpose() * (inverse * run.b.rows(c, k));
    }
    for (i, pull) in pulls.iter().enumerate() {
        m[(i, i)] += pull.curvature;
        rhs[i] -= pull.slope;
    }
    let common = damped(m, &rhs, damping)?;
    let own = runs
        .iter()
        .zip(&inverses)
        .map(|(run, inverse)| {
            let k = run.own(c);
            inverse * (run.b.rows(c, k) - run.g.view((c, 0), (k, c)) * &common)
        })
        .collect();
    Some(Solution { common, own })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two runs over one slope, each with an offset of its own: y = 2·t + (1 or −3).
    fn runs() -> Vec<Normal> {
        [1.0, -3.0]
            .into_iter()
            .map(|offset| {
                let t: Vec<f64> = (0..20).map(|k| 0.1 * f64::from(k)).collect();
                let x: Vec<f64> = t.iter().flat_map(|t| [*t, 1.0]).collect();
                let y: Vec<f64> = t.iter().map(|t| 2.0 * t + offset).collect();
                Normal::new(2, &x, &y)
            })
            .collect()
    }

    /// Fails if the runs' own coefficients are not eliminated, or are put back wrongly.
    #[test]
    fn what_is_common_and_what_is_a_runs_own_are_told_apart() {
        let free = [Pull { slope: 0.0, curvature: 0.0 }];
        let found = solve(&runs(), &free, &[0.0], 0.0).expect("one solution");
        assert!((found.common[0] - 2.0).abs() < 1e-6, "{found:?}");
        assert!((found.own[0][0] - 1.0).abs() < 1e-6 && (found.own[1][0] + 3.0).abs() < 1e-6, "{found:?}");
    }

    /// Fails if a prior of a common or an own coefficient counts for nothing, or damping does not shorten the step.
    #[test]
    fn what_is_known_holds_and_damping_shortens() {
        let held = |slope, curvature, precision, damping| {
            let found = solve(&runs(), &[Pull { slope, curvature }], &[precision], damping).expect("one solution");
            (found.common[0], found.own[1][0])
        };
        assert!(held(0.0, 1e9, 0.0, 0.0).0.abs() < 1e-6, "a step that costs much is not made");
        assert!((held(-1e9, 1e9, 0.0, 0.0).0 - 1.0).abs() < 1e-6, "where the prior pulls to");
        assert!(held(0.0, 0.0, 1e9, 0.0).1.abs() < 1e-6, "an offset that is known is none");
        assert!((held(0.0, 0.0, 0.0, 1.0).0 - 1.0).abs() < 1e-6, "half the step with a diagonal twice as large");
    }

    /// Fails if rows that are added in two parts count otherwise than at once, or a shift of the coefficients is not one of the data.
    #[test]
    fn rows_add_up_and_coefficients_are_counted_from_anywhere() {
        let x = [1.0, 0.5, 1.0, -2.0, 1.0, 0.25];
        let y = [3.0, -1.0, 0.5];
        let whole = Normal::new(2, &x, &y);
        let mut parts = Normal::new(2, &x[..2], &y[..1]);
        parts.add(&x[2..], &y[1..]);
        assert!((&whole.g - &parts.g).norm() < 1e-12 && (&whole.b - &parts.b).norm() < 1e-12);
        let around = DVector::from_vec(vec![0.7, -0.3]);
        let less: Vec<f64> = x.chunks(2).zip(&y).map(|(x, y)| y - x[0] * around[0] - x[1] * around[1]).collect();
        let back = Normal::new(2, &x, &less).whole(&around);
        assert!((&whole.b - &back.b).norm() < 1e-12 && (whole.yy - back.yy).abs() < 1e-12);
    }

    /// Fails if a gain that scatters without bound leaves anything that a gain could take, or one that does not scatter takes anything.
    #[test]
    fn a_gain_is_taken_out_as_far_as_it_scatters() {
        let x = [1.0, 2.0, 3.0];
        let y = [2.0, 4.0, 6.5];
        let left = |gain_spread| Normal::new(1, &x, &y).without_gain(0, Noise { gain_spread, ..Noise::PLAIN }).yy;
        // Least squares of y = a·x by hand: 62.25 − 29.5²/14.
        assert!((left(1e6) - (62.25 - 29.5 * 29.5 / 14.0)).abs() < 1e-6);
        assert_eq!(left(0.0), 62.25);
        assert!((left(0.1) - Noise { variance: 1.0, gain_spread: 0.1 }.squared_error(62.25, 14.0, 29.5)).abs() < 1e-12);
    }
}
