//! Statistics on whole runs: Gram matrices a run, hold-out, the null of the whole selection, bootstrap.
//!
//! Every fit here is linear in the neighbourhood of a refitted model, so one Gram matrix a run holds all that is needed:
//! leaving runs out is a subtraction, a null data set is a new right-hand side. That is what makes it possible to repeat
//! the whole selection, over all candidates, hundreds of times.

mod grams;
mod screen;

pub use grams::{Grams, Group, Prior};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use twum_fit::quantile::{INTERVAL_95, quantiles};

/// One division of the runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fold {
    /// Runs that are fitted.
    pub train: Vec<usize>,
    /// Runs that are scored.
    pub test: Vec<usize>,
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
    /// These errors (the second of each pair) held against those of `with`: without and with what was added, of the runs that both score.
    pub fn against(&self, with: &Self) -> Self {
        let scored: Vec<bool> = self.seconds.iter().zip(&with.seconds).map(|(a, b)| *a > 0.0 && *b > 0.0).collect();
        let pair = |a: &[[f64; 2]], b: &[[f64; 2]]| {
            let pairs = a.iter().zip(b).zip(&scored);
            pairs.map(|((a, b), scored)| if *scored { [a[1], b[1]] } else { [0.0; 2] }).collect()
        };
        let seconds = self.seconds.iter().zip(&scored).map(|(seconds, scored)| if *scored { *seconds } else { 0.0 });
        Self { loss: pair(&self.loss, &with.loss), plain: pair(&self.plain, &with.plain), seconds: seconds.collect() }
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

/// Share of null repetitions that reach `value`, counting the data themselves.
pub fn p_value(value: f64, null: &[f64]) -> f64 {
    (1 + null.iter().filter(|n| **n >= value).count()) as f64 / (1 + null.len()) as f64
}
