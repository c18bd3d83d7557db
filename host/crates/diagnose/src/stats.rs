//! Statistics on whole runs: Gram matrices a run, hold-out, the null of the whole selection, bootstrap.
//!
//! Every fit here is linear in the neighbourhood of a refitted model, so one Gram matrix a run holds all that is needed:
//! leaving runs out is a subtraction, a null data set is a new right-hand side. That is what makes it possible to repeat
//! the whole selection, over all candidates, hundreds of times.

use super::problem::RunDesign;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use twum_fit::quantile::{INTERVAL_95, quantiles};

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
struct RunGram {
    /// XᵀX, row-major.
    g: Vec<f64>,
    /// Xᵀy.
    b: Vec<f64>,
    /// yᵀy.
    yy: f64,
    seconds: f64,
    /// Xᵀy of each block of the residual without its run gain.
    blocks: Vec<Vec<f64>>,
    /// Gain of the run over the model, relative.
    gain: f64,
    /// Weight of the rank-one correction for a random run gain.
    gamma: f64,
    rows: usize,
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
    columns: usize,
    gain_column: usize,
    runs: Vec<RunGram>,
    /// Variance of one weighted residual.
    pub variance: f64,
    /// Spread of the run gains (relative).
    pub gain_spread: f64,
    /// Prior precision of each column, in units of the column, times the residual variance.
    ridge: Vec<f64>,
    /// What else is known of the columns; none of those beyond the list.
    prior: Vec<Prior>,
    folds: Vec<Fold>,
}

/// One division of the runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fold {
    /// Runs that are fitted.
    pub train: Vec<usize>,
    /// Runs that are scored.
    pub test: Vec<usize>,
}

/// Held-out squared errors of each run: without and with the candidate.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeldOut {
    /// Weighted squared error a run (random run gain taken out): what decides.
    pub loss: Vec<[f64; 2]>,
    /// Plain squared error a run in rpm²·s: what is reported.
    pub plain: Vec<[f64; 2]>,
    /// Seconds a run.
    pub seconds: Vec<f64>,
}

impl HeldOut {
    /// These errors (the second of each pair) held against those of `with`: without and with what was added.
    pub fn against(&self, with: &Self) -> Self {
        let pair = |a: &[[f64; 2]], b: &[[f64; 2]]| a.iter().zip(b).map(|(a, b)| [a[1], b[1]]).collect();
        Self {
            loss: pair(&self.loss, &with.loss),
            plain: pair(&self.plain, &with.plain),
            seconds: self.seconds.clone(),
        }
    }

    /// Total improvement of the deciding error.
    pub fn improvement(&self) -> f64 {
        self.loss.iter().map(|l| l[0] - l[1]).sum()
    }

    /// 1 − RMSE with / RMSE without, on runs that were not fitted.
    pub fn gain(&self) -> f64 {
        gain_of(self.plain.iter())
    }

    fn tested(&self) -> Vec<usize> {
        (0..self.seconds.len()).filter(|i| self.seconds[*i] > 0.0).collect()
    }

    /// 95 % interval of the gain, resampling runs.
    pub fn gain_interval(&self, seed: u64) -> [f64; 2] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let tested = self.tested();
        let n = tested.len();
        let gains = (0..1000).map(|_| gain_of((0..n).map(|_| &self.plain[tested[rng.random_range(0..n)]]))).collect();
        quantiles(gains, INTERVAL_95)
    }

    /// Root mean square with (1) or without (0) the candidate, in rpm.
    pub fn rmse(&self, with: usize) -> f64 {
        let seconds: f64 = self.seconds.iter().sum();
        (self.plain.iter().map(|p| p[with]).sum::<f64>() / seconds.max(1e-12)).sqrt()
    }

    /// 95 % interval of how much larger `other`'s error is than this one's, resampling runs.
    pub fn lead_interval(&self, other: &HeldOut, seed: u64) -> [f64; 2] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let tested = self.tested();
        let n = tested.len();
        let leads = (0..1000)
            .map(|_| {
                (0..n)
                    .map(|_| {
                        let i = tested[rng.random_range(0..n)];
                        other.loss[i][1] - self.loss[i][1]
                    })
                    .sum()
            })
            .collect();
        quantiles(leads, INTERVAL_95)
    }
}

fn gain_of<'a>(pairs: impl Iterator<Item = &'a [f64; 2]>) -> f64 {
    let (mut without, mut with) = (0.0, 0.0);
    for p in pairs {
        without += p[0];
        with += p[1];
    }
    if without > 0.0 { 1.0 - (with.max(0.0) / without).sqrt() } else { 0.0 }
}

/// Runs in groups that are held out together: every fold takes one run of each kind in turn, in a seeded order.
pub fn folds(keys: &[String], count: usize, seed: u64) -> Vec<Fold> {
    let n = keys.len();
    let count = count.min(n).max(1);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order.sort_by(|a, b| keys[*a].cmp(&keys[*b]));
    let mut folds = vec![Vec::new(); count];
    for (k, i) in order.into_iter().enumerate() {
        folds[k % count].push(i);
    }
    folds
        .into_iter()
        .map(|test| Fold {
            train: if count == 1 { test.clone() } else { (0..n).filter(|i| !test.contains(i)).collect() },
            test,
        })
        .collect()
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
        let mut runs: Vec<RunGram> = designs
            .par_iter()
            .map(|d| {
                let n = d.y.len();
                let mut g = vec![0.0; columns * columns];
                let mut b = vec![0.0; columns];
                let mut yy = 0.0;
                for k in 0..n {
                    let row = &d.x[k * columns..(k + 1) * columns];
                    yy += d.y[k] * d.y[k];
                    for i in 0..columns {
                        let xi = row[i];
                        if xi == 0.0 {
                            continue;
                        }
                        b[i] += xi * d.y[k];
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
                let mut blocks = Vec::with_capacity(n / block + 1);
                let mut k = 0;
                while k < n {
                    let end = (k + block).min(n);
                    let mut v = vec![0.0; columns];
                    for row in k..end {
                        let x = &d.x[row * columns..(row + 1) * columns];
                        let rest = d.y[row] - gain * x[gain_column];
                        for (target, xi) in v.iter_mut().zip(x) {
                            *target += xi * rest;
                        }
                    }
                    blocks.push(v);
                    k = end;
                }
                RunGram { g, b, yy, seconds: d.seconds, blocks, gain, gamma: 0.0, rows: n }
            })
            .collect();
        // Spread of the gain among repetitions of the same run; 1 % where nothing was repeated, none within one run.
        let (mut sum, mut degrees) = (0.0, 0.0);
        let replicated = replicates.unwrap_or_default();
        let mut keys: Vec<&String> = replicated.iter().collect();
        keys.sort();
        keys.dedup();
        for key in keys {
            let gains: Vec<f64> = (0..runs.len()).filter(|i| &replicated[*i] == key).map(|i| runs[i].gain).collect();
            if gains.len() > 1 {
                let mean = gains.iter().sum::<f64>() / gains.len() as f64;
                sum += gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>();
                degrees += gains.len() as f64 - 1.0;
            }
        }
        let gain_spread = if replicates.is_none() {
            0.0
        } else if degrees >= 3.0 {
            (sum / degrees).sqrt().clamp(1e-3, 0.1)
        } else {
            0.01
        };
        for run in &mut runs {
            let gg = run.g[gain_column * columns + gain_column];
            let t = gain_spread * gain_spread;
            run.gamma = t / (variance + t * gg);
        }
        let ridge = scales.iter().map(|s| variance / (s * s)).collect();
        Self { columns, gain_column, runs, variance, gain_spread, ridge, prior: Vec::new(), folds }
    }

    /// The divisions and the coefficients of `set` fitted in each.
    pub fn fold_fits(&self, set: &[usize]) -> Vec<(Fold, DVector<f64>)> {
        self.folds.iter().map(|f| (f.clone(), self.fit(&f.train, set))).collect()
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

    fn g(&self, run: usize, i: usize, j: usize) -> f64 {
        let r = &self.runs[run];
        let (c, k) = (self.columns, self.gain_column);
        r.g[i * c + j] - r.gamma * r.g[i * c + k] * r.g[k * c + j]
    }

    fn plain_g(&self, run: usize, i: usize, j: usize) -> f64 {
        self.runs[run].g[i * self.columns + j]
    }

    fn b(&self, run: usize, b: &[f64], i: usize) -> f64 {
        let r = &self.runs[run];
        b[i] - r.gamma * r.g[i * self.columns + self.gain_column] * b[self.gain_column]
    }

    fn matrix(&self, runs: &[usize], set: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(set.len(), set.len(), |i, j| runs.iter().map(|r| self.g(*r, set[i], set[j])).sum())
    }

    /// The same equations with what is known of the first columns.
    pub fn with_prior(mut self, prior: Vec<Prior>) -> Self {
        self.prior = prior;
        self
    }

    fn known(&self, column: usize) -> Prior {
        self.prior.get(column).copied().unwrap_or_default()
    }

    fn inverse(&self, runs: &[usize], set: &[usize]) -> DMatrix<f64> {
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

    fn plan(&self, base: &[usize], group: &Group) -> Plan {
        let set = match group {
            Group::Linear(extra) => [base, extra].concat(),
            Group::Phased(_) => base.to_vec(),
        };
        let folds = self
            .folds
            .iter()
            .map(|fold| FoldPlan {
                inverse: self.inverse(&fold.train, &set),
                test_g: self.matrix(&fold.test, &set),
                fold: fold.clone(),
            })
            .collect();
        let pairs = match group {
            Group::Linear(_) => Vec::new(),
            Group::Phased(pairs) => pairs
                .iter()
                .map(|pair| (0..self.runs.len()).map(|r| self.pair_plan(r, base, *pair)).collect())
                .collect(),
        };
        Plan { set, folds, pairs }
    }

    fn pair_plan(&self, r: usize, base: &[usize], [i, j]: [usize; 2]) -> PairPlan {
        let g = [self.g(r, i, i), self.g(r, i, j), self.g(r, j, j)];
        let link = base.iter().map(|c| [self.g(r, i, *c), self.g(r, j, *c)]).collect();
        let tiny = 1e-9 * (g[0] + g[2]) + 1e-300;
        let (a, d) = (g[0] + tiny, g[2] + tiny);
        let det = a * d - g[1] * g[1];
        let inverse = [d / det, -g[1] / det, a / det];
        PairPlan { columns: [i, j], g, link, inverse }
    }

    /// Improvement on held-out runs with right-hand sides `b` (one a run).
    fn improvement(&self, plan: &Plan, base: &Plan, b: &[Vec<f64>], pulled: bool) -> f64 {
        let mut total = 0.0;
        for (fold, base_fold) in plan.folds.iter().zip(&base.folds) {
            let rhs = |runs: &[usize], set: &[usize]| {
                DVector::from_fn(set.len(), |i, _| runs.iter().map(|r| b[*r][set[i]]).sum())
            };
            let pull =
                |set: &[usize]| DVector::from_fn(set.len(), |i, _| if pulled { self.known(set[i]).pull } else { 0.0 });
            let beta_base = &base_fold.inverse * (rhs(&base_fold.fold.train, &base.set) + pull(&base.set));
            if plan.pairs.is_empty() {
                let loss = |beta: &DVector<f64>, f: &FoldPlan, set: &[usize]| {
                    -2.0 * beta.dot(&rhs(&f.fold.test, set)) + (&f.test_g * beta).dot(beta)
                };
                let beta = &fold.inverse * (rhs(&fold.fold.train, &plan.set) + pull(&plan.set));
                total += loss(&beta_base, base_fold, &base.set) - loss(&beta, fold, &plan.set);
            } else {
                for pair in &plan.pairs {
                    let power = self.pair_power(pair, &beta_base, &fold.fold.train, b);
                    if power > 0.0 {
                        total += fold
                            .fold
                            .test
                            .iter()
                            .map(|r| self.pair_gain(&pair[*r], &beta_base, power, &b[*r]).0)
                            .sum::<f64>();
                    }
                }
            }
        }
        total
    }

    /// Mean square of a phased coefficient over runs, noise taken off.
    fn pair_power(&self, pair: &[PairPlan], beta: &DVector<f64>, runs: &[usize], b: &[Vec<f64>]) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for r in runs {
            let p = &pair[*r];
            let noise = self.variance * (p.inverse[0] + p.inverse[2]);
            if !(noise.is_finite() && noise > 0.0) {
                continue;
            }
            let c = p.solve(p.rest(beta, &b[*r]), 0.0);
            let w = 1.0 / (noise * noise);
            sum += w * (c[0] * c[0] + c[1] * c[1] - noise);
            weight += w;
        }
        if weight > 0.0 { sum / weight } else { 0.0 }
    }

    /// Expected improvement of one run when its phase is fitted with the amplitude known, and the coefficients.
    fn pair_gain(&self, p: &PairPlan, beta: &DVector<f64>, power: f64, b: &[f64]) -> (f64, [f64; 2]) {
        let rest = p.rest(beta, b);
        let prior = 2.0 * self.variance / power;
        let c = p.solve(rest, prior);
        let fit = 2.0 * (c[0] * rest[0] + c[1] * rest[1])
            - (p.g[0] * c[0] * c[0] + 2.0 * p.g[1] * c[0] * c[1] + p.g[2] * c[1] * c[1]);
        let det = (p.g[0] + prior) * (p.g[2] + prior) - p.g[1] * p.g[1];
        let freedom = ((p.g[2] + prior) * p.g[0] - 2.0 * p.g[1] * p.g[1] + (p.g[0] + prior) * p.g[2]) / det;
        (fit - 2.0 * self.variance * freedom, c)
    }

    fn observed_b(&self) -> Vec<Vec<f64>> {
        (0..self.runs.len()).map(|r| (0..self.columns).map(|i| self.b(r, &self.runs[r].b, i)).collect()).collect()
    }

    /// Improvements of all groups on the measured data, and the null's largest improvement in each repetition.
    ///
    /// A null data set keeps every residual but turns its sign: the gain of a run (one of `gains`, or its own where there are none) by
    /// one coin, what is left by a coin a block. What repeats from run to run or lasts longer than a block is lost, the noise
    /// stays as it is.
    pub fn screen(
        &self,
        base: &[usize],
        groups: &[Group],
        gains: &[f64],
        repetitions: usize,
        seed: u64,
    ) -> (Vec<f64>, Vec<f64>) {
        let base_plan = self.plan(base, &Group::Linear(Vec::new()));
        let plans: Vec<Plan> = groups.par_iter().map(|g| self.plan(base, g)).collect();
        let observed = self.observed_b();
        let improvements: Vec<f64> =
            plans.par_iter().map(|p| self.improvement(p, &base_plan, &observed, true)).collect();
        let null: Vec<f64> = (0..repetitions)
            .into_par_iter()
            .map(|k| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_add(1 + k as u64));
                let b = self.null_b(gains, &mut rng);
                plans.iter().map(|p| self.improvement(p, &base_plan, &b, false)).fold(0.0, f64::max)
            })
            .collect();
        (improvements, null)
    }

    fn null_b(&self, gains: &[f64], rng: &mut impl Rng) -> Vec<Vec<f64>> {
        let mut coin = || if rng.random::<bool>() { 1.0 } else { -1.0 };
        self.runs
            .iter()
            .enumerate()
            .map(|(r, run)| {
                let s = coin() * gains.get(r).copied().unwrap_or(run.gain);
                let mut b: Vec<f64> =
                    (0..self.columns).map(|i| s * run.g[i * self.columns + self.gain_column]).collect();
                for block in &run.blocks {
                    let s = coin();
                    for (target, v) in b.iter_mut().zip(block) {
                        *target += s * v;
                    }
                }
                (0..self.columns).map(|i| self.b(r, &b, i)).collect()
            })
            .collect()
    }

    /// Held-out errors of every run without (`base`) and with the group.
    pub fn hold_out(&self, base: &[usize], group: &Group) -> HeldOut {
        let base_plan = self.plan(base, &Group::Linear(Vec::new()));
        let plan = self.plan(base, group);
        let b = self.observed_b();
        let n = self.runs.len();
        let mut out = HeldOut { loss: vec![[0.0; 2]; n], plain: vec![[0.0; 2]; n], seconds: vec![0.0; n] };
        for (fold, base_fold) in plan.folds.iter().zip(&base_plan.folds) {
            let rhs = |runs: &[usize], set: &[usize]| {
                DVector::from_fn(set.len(), |i, _| runs.iter().map(|r| b[*r][set[i]]).sum())
            };
            let pull = |set: &[usize]| DVector::from_fn(set.len(), |i, _| self.known(set[i]).pull);
            let beta_base = &base_fold.inverse * (rhs(&base_fold.fold.train, &base_plan.set) + pull(&base_plan.set));
            let beta = &fold.inverse * (rhs(&fold.fold.train, &plan.set) + pull(&plan.set));
            let powers: Vec<f64> =
                plan.pairs.iter().map(|pair| self.pair_power(pair, &beta_base, &fold.fold.train, &b)).collect();
            for &r in &fold.fold.test {
                let run = &self.runs[r];
                out.seconds[r] = run.seconds;
                let k = self.gain_column;
                let yy = run.yy - run.gamma * run.b[k] * run.b[k];
                let quadratic = |beta: &[f64], set: &[usize], plain: bool| {
                    let mut v = if plain { run.yy } else { yy };
                    for (i, ci) in set.iter().enumerate() {
                        v -= 2.0 * beta[i] * if plain { run.b[*ci] } else { b[r][*ci] };
                        for (j, cj) in set.iter().enumerate() {
                            v +=
                                beta[i] * beta[j] * if plain { self.plain_g(r, *ci, *cj) } else { self.g(r, *ci, *cj) };
                        }
                    }
                    v
                };
                out.loss[r][0] = quadratic(beta_base.as_slice(), &base_plan.set, false);
                out.plain[r][0] = quadratic(beta_base.as_slice(), &base_plan.set, true);
                if plan.pairs.is_empty() {
                    out.loss[r][1] = quadratic(beta.as_slice(), &plan.set, false);
                    out.plain[r][1] = quadratic(beta.as_slice(), &plan.set, true);
                } else {
                    let mut set = base_plan.set.clone();
                    let mut coefficients = beta_base.as_slice().to_vec();
                    let mut optimism = 0.0;
                    for (pair, power) in plan.pairs.iter().zip(&powers) {
                        if *power > 0.0 {
                            let p = &pair[r];
                            let (gain, c) = self.pair_gain(p, &beta_base, *power, &b[r]);
                            let rest = p.rest(&beta_base, &b[r]);
                            let fit = 2.0 * (c[0] * rest[0] + c[1] * rest[1])
                                - (p.g[0] * c[0] * c[0] + 2.0 * p.g[1] * c[0] * c[1] + p.g[2] * c[1] * c[1]);
                            optimism += fit - gain;
                            set.extend(p.columns);
                            coefficients.extend(c);
                        }
                    }
                    out.loss[r][1] = quadratic(&coefficients, &set, false) + optimism;
                    out.plain[r][1] = quadratic(&coefficients, &set, true) + optimism;
                }
            }
        }
        out
    }

    /// Degrees of freedom each run spends on its phases when the amplitudes are known.
    pub fn phased_freedom(&self, pairs: &[[usize; 2]], amplitudes: &[f64]) -> Vec<f64> {
        (0..self.runs.len())
            .map(|r| {
                pairs
                    .iter()
                    .zip(amplitudes)
                    .filter(|(_, a)| **a > 0.0)
                    .map(|([i, j], a)| {
                        let (g0, g1, g2) = (self.g(r, *i, *i), self.g(r, *i, *j), self.g(r, *j, *j));
                        let prior = 2.0 * self.variance / (a * a);
                        let det = (g0 + prior) * (g2 + prior) - g1 * g1;
                        ((g2 + prior) * g0 - 2.0 * g1 * g1 + (g0 + prior) * g2) / det
                    })
                    .sum()
            })
            .collect()
    }
}

struct FoldPlan {
    fold: Fold,
    inverse: DMatrix<f64>,
    test_g: DMatrix<f64>,
}

struct Plan {
    set: Vec<usize>,
    folds: Vec<FoldPlan>,
    pairs: Vec<Vec<PairPlan>>,
}

struct PairPlan {
    columns: [usize; 2],
    g: [f64; 3],
    link: Vec<[f64; 2]>,
    inverse: [f64; 3],
}

impl PairPlan {
    fn rest(&self, beta: &DVector<f64>, b: &[f64]) -> [f64; 2] {
        let mut rest = [b[self.columns[0]], b[self.columns[1]]];
        for (l, v) in self.link.iter().zip(beta.iter()) {
            rest[0] -= l[0] * v;
            rest[1] -= l[1] * v;
        }
        rest
    }

    fn solve(&self, rest: [f64; 2], prior: f64) -> [f64; 2] {
        let tiny = 1e-9 * (self.g[0] + self.g[2]) + 1e-300;
        let (a, d) = (self.g[0] + prior + tiny, self.g[2] + prior + tiny);
        let det = a * d - self.g[1] * self.g[1];
        [(d * rest[0] - self.g[1] * rest[1]) / det, (a * rest[1] - self.g[1] * rest[0]) / det]
    }
}

/// Share of null repetitions that reach `value`, counting the data themselves.
pub fn p_value(value: f64, null: &[f64]) -> f64 {
    (1 + null.iter().filter(|n| **n >= value).count()) as f64 / (1 + null.len()) as f64
}
