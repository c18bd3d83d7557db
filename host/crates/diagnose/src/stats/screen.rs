//! What a group of columns improves on runs that were not fitted, and what chance would improve.

use super::grams::{Grams, Group};
use super::{Fold, HeldOut};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

impl Grams {
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
        self.hold_out_beyond(&DVector::zeros(base.len()), base, group)
    }

    /// The same where residuals are those of a model whose own parameters, the columns `base`, were fitted to all runs: what the equations of all
    /// runs would change of it is taken off.
    pub fn hold_out_around_a_fit(&self, base: &[usize], group: &Group) -> HeldOut {
        self.hold_out_beyond(&self.drift(base), base, group)
    }

    fn hold_out_beyond(&self, drift: &DVector<f64>, base: &[usize], group: &Group) -> HeldOut {
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
            let mut beta_base =
                &base_fold.inverse * (rhs(&base_fold.fold.train, &base_plan.set) + pull(&base_plan.set));
            let mut beta = &fold.inverse * (rhs(&fold.fold.train, &plan.set) + pull(&plan.set));
            beta_base -= drift;
            let mut own = beta.rows_mut(0, base.len());
            own -= drift;
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

#[cfg(test)]
mod tests {
    use super::super::super::design::RunDesign;
    use super::super::folds;
    use super::*;
    use twum_fit::noise::Noise;

    /// Four runs of which each is half of its speed off, all alike: a model that was believed to be better than these equations say.
    fn alike() -> Grams {
        let speeds = [3.0, 5.0, 2.0, 4.0];
        let design = || RunDesign {
            columns: 1,
            x: speeds.to_vec(),
            y: speeds.map(|v| 0.5 * v).to_vec(),
            weight: vec![1.0; 4],
            seconds: 4.0,
        };
        let designs: Vec<RunDesign> = (0..4).map(|_| design()).collect();
        let keys: Vec<String> = (0..4).map(|_| "alike".to_owned()).collect();
        Grams::new(&designs, 0, &[30.0], None, folds(&keys, 4, 1))
    }

    /// Fails if what all runs would change of a model counts as what was fitted to some of them, or if nothing is fitted where there is no
    /// model: a saturation that was there lost 174 % on runs held out.
    #[test]
    fn what_all_runs_would_change_of_a_model_is_no_divisions() {
        let error = |held: HeldOut| held.plain.iter().map(|p| p[1]).sum::<f64>();
        let left = 4.0 * 0.25 * 54.0;
        assert!((error(alike().hold_out_around_a_fit(&[0], &Group::Linear(Vec::new()))) - left).abs() < 0.01 * left);
        assert!(error(alike().hold_out(&[0], &Group::Linear(Vec::new()))) < 0.01 * left);
        assert!(alike().fold_fits(&[0]).iter().all(|(_, changed)| changed[0].abs() < 1e-3));
    }

    /// Runs of three speeds, twice each, whose speed a form gets wrong within every run alike. A column takes that, and with it a tenth of the slowest
    /// runs' speed. Fails if what was fitted to some of the runs is all for the form, because it was sampled often.
    #[test]
    fn a_form_within_runs_does_not_outweigh_their_speeds() {
        let rows = 200;
        let course = |k: usize| (std::f64::consts::TAU * 5.0 * k as f64 / rows as f64).sin();
        let design = |r: usize| {
            let speed = [5.0, 10.0, 20.0][r / 2];
            RunDesign {
                columns: 2,
                x: (0..rows).flat_map(|k| [speed, 1.0 + course(k)]).collect(),
                y: (0..rows)
                    .map(|k| 0.5 * course(k) + if r.is_multiple_of(2) { 0.01 } else { -0.01 } * speed)
                    .collect(),
                weight: vec![1.0; rows],
                seconds: rows as f64,
            }
        };
        let designs: Vec<RunDesign> = (0..6).map(design).collect();
        let keys: Vec<String> = (0..6).map(|r| format!("{}", r / 2)).collect();
        let grams = Grams::new(&designs, 0, &[30.0; 2], Some(&keys), folds(&keys, 2, 1));
        let error =
            |grams: &Grams| grams.hold_out(&[0, 1], &Group::Linear(Vec::new())).plain.iter().map(|p| p[1]).sum::<f64>();
        let before: f64 = grams.runs.iter().map(|r| r.yy).sum();
        assert!(error(&grams) > 1.1 * before, "{} of {before}", error(&grams));
        let tempered = error(&grams.beside(Noise { variance: 10.0, gain_spread: 0.01 }));
        assert!(tempered < 0.8 * before, "{tempered} of {before}");
    }
}
