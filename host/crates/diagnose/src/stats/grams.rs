//! Normal equations of every run, and fits of all of them.

use super::super::design::RunDesign;
use super::Fold;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use twum_fit::noise::Noise;

/// Windows in one block of the null's sign flips: longer than the memory of the sampling noise (two windows), shorter
/// than any effect.
const BLOCK: usize = 12;

/// Columns that make up one candidate.
#[derive(Debug, Clone, PartialEq)]
pub enum Group {
    /// Common coefficients.
    Linear(Vec<usize>),
    /// Pairs of cosine and sine columns: common amplitude, another phase in every run.
    Phased(Vec<[usize; 2]>),
}

/// One run's normal equations.
#[derive(Debug, Clone)]
pub(super) struct RunGram {
    /// XᵀX, row-major.
    pub(super) g: Vec<f64>,
    /// Xᵀy.
    pub(super) b: Vec<f64>,
    /// yᵀy.
    pub(super) yy: f64,
    pub(super) seconds: f64,
    /// Xᵀy of each block of the residual without its run gain.
    pub(super) blocks: Vec<Vec<f64>>,
    /// Gain of the run over the model, relative.
    pub(super) gain: f64,
    /// Weight of the rank-one correction for a random run gain.
    pub(super) gamma: f64,
    pub(super) rows: usize,
}

/// What is known of a column's coefficient before the data.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Prior {
    /// Precision, in the weight of the squared residuals.
    pub precision: f64,
    /// Gradient towards what is known.
    pub pull: f64,
    /// How uncertain that gradient is (variance).
    pub noise: f64,
}

/// Normal equations of all runs.
#[derive(Debug, Clone)]
pub struct Grams {
    pub(super) columns: usize,
    pub(super) gain_column: usize,
    pub(super) runs: Vec<RunGram>,
    /// Variance of one weighted residual.
    pub variance: f64,
    /// Spread of the run gains (relative).
    pub gain_spread: f64,
    /// Prior precision of each column, in units of the column, times the residual variance.
    pub(super) ridge: Vec<f64>,
    /// What else is known of the columns; none of those beyond the list.
    pub(super) prior: Vec<Prior>,
    pub(super) folds: Vec<Fold>,
}

impl RunGram {
    fn of(design: &RunDesign, columns: usize, gain_column: usize, block: usize) -> Self {
        let n = design.y.len();
        let row = |k: usize| &design.x[k * columns..(k + 1) * columns];
        let mut g = vec![0.0; columns * columns];
        let mut b = vec![0.0; columns];
        for k in 0..n {
            let row = row(k);
            for i in 0..columns {
                let xi = row[i];
                if xi == 0.0 {
                    continue;
                }
                b[i] += xi * design.y[k];
                let target = &mut g[i * columns..(i + 1) * columns];
                for j in i..columns {
                    target[j] += xi * row[j];
                }
            }
        }
        for i in 0..columns {
            for j in 0..i {
                g[i * columns + j] = g[j * columns + i];
            }
        }
        let gg = g[gain_column * columns + gain_column];
        let gain = if gg > 0.0 { b[gain_column] / gg } else { 0.0 };
        let of_block = |start: usize| {
            let mut v = vec![0.0; columns];
            for k in start..(start + block).min(n) {
                let rest = design.y[k] - gain * row(k)[gain_column];
                for (target, xi) in v.iter_mut().zip(row(k)) {
                    *target += xi * rest;
                }
            }
            v
        };
        let blocks = (0..n).step_by(block).map(of_block).collect();
        let yy = design.y.iter().map(|y| y * y).sum();
        Self { g, b, yy, seconds: design.seconds, blocks, gain, gamma: 0.0, rows: n }
    }
}

/// Spread of the gain among runs of the same key, which repeat each other; 1 % where nothing was repeated.
fn spread_of_gains(runs: &[RunGram], replicates: &[String]) -> f64 {
    let (mut sum, mut degrees) = (0.0, 0.0);
    let mut keys: Vec<&String> = replicates.iter().collect();
    keys.sort();
    keys.dedup();
    for key in keys {
        let gains: Vec<f64> = (0..runs.len()).filter(|i| &replicates[*i] == key).map(|i| runs[i].gain).collect();
        if gains.len() > 1 {
            let mean = gains.iter().sum::<f64>() / gains.len() as f64;
            sum += gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>();
            degrees += gains.len() as f64 - 1.0;
        }
    }
    if degrees >= 3.0 { (sum / degrees).sqrt().clamp(1e-3, 0.1) } else { 0.01 }
}

impl Grams {
    /// Normal equations of `designs`. `gain_column` is the relative speed of the run; `scales[c]` is how large a
    /// coefficient of column `c` may plausibly be; `replicates[i]` says which runs repeat each other.
    pub fn new(
        designs: &[RunDesign],
        gain_column: usize,
        scales: &[f64],
        replicates: Option<&[String]>,
        folds: Vec<Fold>,
    ) -> Self {
        Self::with_blocks(designs, gain_column, scales, replicates, folds, BLOCK)
    }

    /// [`Self::new`] with another block of the null's sign flips, for residuals with a longer memory.
    pub fn with_blocks(
        designs: &[RunDesign],
        gain_column: usize,
        scales: &[f64],
        replicates: Option<&[String]>,
        folds: Vec<Fold>,
        block: usize,
    ) -> Self {
        let columns = scales.len();
        let rows: usize = designs.iter().map(|d| d.y.len()).sum();
        let total: f64 = designs.iter().flat_map(|d| d.y.iter()).map(|y| y * y).sum();
        let variance = (total / rows.max(1) as f64).max(1e-12);
        let runs: Vec<RunGram> =
            designs.par_iter().map(|design| RunGram::of(design, columns, gain_column, block)).collect();
        // None within one run.
        let gain_spread = replicates.map_or(0.0, |keys| spread_of_gains(&runs, keys));
        let ridge = scales.iter().map(|s| variance / (s * s)).collect();
        let all = Self { columns, gain_column, runs, variance, gain_spread, ridge, prior: Vec::new(), folds };
        all.beside_sampling()
    }

    /// The same equations with the gains of the runs taken out beside noise like this: that of the likelihood which their model was fitted under.
    /// Beside the sampling's alone, what a form gets wrong within runs counts as often as it was sampled, and outweighs the runs' mean speeds.
    pub fn beside(mut self, noise: Noise) -> Self {
        let squared_speed = self.gain_column * self.columns + self.gain_column;
        for run in &mut self.runs {
            run.gamma = noise.gamma(run.g[squared_speed]);
        }
        self
    }

    /// The same with the gains taken out as far as runs that repeat each other say, beside the noise of sampling: the error that is held against chance.
    pub fn beside_sampling(self) -> Self {
        let noise = Noise { variance: self.variance, gain_spread: self.gain_spread };
        self.beside(noise)
    }

    /// The divisions, and what the runs fitted in each would change of a model that was fitted to all: coefficients of `set`.
    pub fn fold_fits(&self, set: &[usize]) -> Vec<(Fold, DVector<f64>)> {
        let drift = self.drift(set);
        self.folds.iter().map(|f| (f.clone(), self.fit(&f.train, set) - &drift)).collect()
    }

    /// What these equations would change, with all runs, of a model that was fitted to all runs under beliefs in gains and priors that are not
    /// quite these. It is no division's doing, and may lie beyond where anything is linear.
    pub(super) fn drift(&self, set: &[usize]) -> DVector<f64> {
        let all: Vec<usize> = (0..self.runs.len()).collect();
        self.fit(&all, set)
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Effective number of rows.
    pub fn rows(&self) -> usize {
        self.runs.iter().map(|r| r.rows).sum()
    }

    /// Mean squared residual in rpm².
    pub fn mean_square(&self) -> f64 {
        let s: f64 = self.runs.iter().map(|r| r.seconds).sum();
        self.runs.iter().map(|r| r.yy).sum::<f64>() / s.max(1e-12)
    }

    pub(super) fn g(&self, run: usize, i: usize, j: usize) -> f64 {
        let r = &self.runs[run];
        let (c, k) = (self.columns, self.gain_column);
        r.g[i * c + j] - r.gamma * r.g[i * c + k] * r.g[k * c + j]
    }

    pub(super) fn plain_g(&self, run: usize, i: usize, j: usize) -> f64 {
        self.runs[run].g[i * self.columns + j]
    }

    pub(super) fn b(&self, run: usize, b: &[f64], i: usize) -> f64 {
        let r = &self.runs[run];
        b[i] - r.gamma * r.g[i * self.columns + self.gain_column] * b[self.gain_column]
    }

    pub(super) fn matrix(&self, runs: &[usize], set: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(set.len(), set.len(), |i, j| runs.iter().map(|r| self.g(*r, set[i], set[j])).sum())
    }

    /// The same equations with what is known of the first columns.
    pub fn with_prior(mut self, prior: Vec<Prior>) -> Self {
        self.prior = prior;
        self
    }

    pub(super) fn known(&self, column: usize) -> Prior {
        self.prior.get(column).copied().unwrap_or_default()
    }

    pub(super) fn inverse(&self, runs: &[usize], set: &[usize]) -> DMatrix<f64> {
        let mut m = self.matrix(runs, set);
        for i in 0..set.len() {
            m[(i, i)] += self.ridge[set[i]] + self.known(set[i]).precision + 1e-12 * m[(i, i)].abs() + 1e-300;
        }
        m.try_inverse().unwrap_or_else(|| DMatrix::zeros(set.len(), set.len()))
    }

    /// Coefficients of `set` fitted on `runs`.
    pub fn fit(&self, runs: &[usize], set: &[usize]) -> DVector<f64> {
        let b = DVector::from_fn(set.len(), |i, _| {
            runs.iter().map(|r| self.b(*r, &self.runs[*r].b, set[i])).sum::<f64>() + self.known(set[i]).pull
        });
        self.inverse(runs, set) * b
    }

    /// Coefficients of `set` on all runs with their cluster-robust covariance (runs are the clusters).
    pub fn fit_all(&self, set: &[usize]) -> (DVector<f64>, DMatrix<f64>) {
        let all: Vec<usize> = (0..self.runs.len()).collect();
        let beta = self.fit(&all, set);
        let inverse = self.inverse(&all, set);
        let mut meat = DMatrix::zeros(set.len(), set.len());
        for r in 0..self.runs.len() {
            let score = DVector::from_fn(set.len(), |i, _| {
                self.b(r, &self.runs[r].b, set[i])
                    - set.iter().enumerate().map(|(j, c)| self.g(r, set[i], *c) * beta[j]).sum::<f64>()
            });
            meat += &score * score.transpose();
        }
        let n = self.runs.len() as f64;
        let correction = if n > 1.0 { n / (n - 1.0) } else { 1.0 };
        // What the priors leave open is as unknown as what the runs scatter.
        let believed =
            DMatrix::from_fn(set.len(), set.len(), |i, j| if i == j { self.known(set[i]).noise } else { 0.0 });
        let cov = &inverse * (meat * correction + believed) * &inverse;
        (beta, cov)
    }

    /// Covariance of `set` if only sampling noise acts: what a single run can offer.
    pub fn covariance(&self, set: &[usize]) -> DMatrix<f64> {
        let all: Vec<usize> = (0..self.runs.len()).collect();
        self.inverse(&all, set) * self.variance
    }
}
