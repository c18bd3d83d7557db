//! What the gains of whole runs scatter by: by chance, with the duty, the direction, both, and the order of the runs.

use super::form_error::FORM_ERROR;
use super::problem::Problem;
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Spreads of the gains: by chance, duty, direction, duty and direction, order.
pub type Taus = [f64; 5];

/// Which of them is that over the duty.
pub const DUTY: usize = 1;

/// Names of the spreads beyond chance.
pub const NAMES: [&str; 5] = ["run to run", "duty", "direction", "duty and direction", "order"];

/// What is believed of the spreads before the data: medians and log deviations. Repeated runs of such motors differ by about a per
/// cent; what a wrong equation does to the speed over duty and order is believed to be some thousandths. Of both directions the equations
/// are the same: 25 motors without an effect that ran both ways (generators B to E) did not differ by more than chance, 0.001 either way, and
/// what differs by 0.002, three deviations, is an asymmetry. Over the duty it was 0.015 at most in 48 motors without an effect (generators B,
/// C and D), two deviations; a sag or a saturation moves the speed by some hundredths.
const MEDIANS: Taus = [0.012, 0.006, 0.0015, 0.003, 0.003];
const LOG_SDS: Taus = [0.5, 0.45, 0.1, 0.35, 0.35];

/// Nats that a spread may cost against what is believed of it: beyond, something moves the gains that no effect of the set explains. 2.4
/// deviations; 0.015 over the duty, the most in 48 motors without an effect, costs 2.1.
pub const LARGEST_SPREAD: f64 = 3.0;

/// Which of them is that over the order.
const ORDER: usize = 4;

/// Or something that nobody knows comes and goes with the order, some per cent large: days, sessions, the weather. Effects of the library go one
/// way over the order; over duty and direction an unknown curve would be a form of theirs.
const UNKNOWN: (f64, f64) = (0.03, 0.7);

/// What that costs in nats: 3.3 deviations, and more than [`LARGEST_SPREAD`], so that the verdict believes it.
const UNKNOWN_COST: f64 = 5.5;

/// Standard deviation of the gain that all runs share: the free speed was refitted.
const COMMON: f64 = 0.1;

/// Runs over which what drifts with the order is forgotten.
const MEMORY_RUNS: f64 = 6.0;

/// Duty below which the switching, which the equation knows least, makes up most of a pulse.
const SHORT_PULSE_DUTY: f64 = 0.2;

/// Covariances of the gains of some runs.
pub struct Level {
    kernels: [DMatrix<f64>; 5],
    medians: Taus,
}

impl Level {
    /// Of the runs of a problem.
    pub fn new(problem: &Problem) -> Self {
        let runs = &problem.runs;
        let n = runs.len();
        let rank = problem.ranks();
        let same = |i: usize, j: usize| match (runs[i].duty, runs[j].duty) {
            (Some(a), Some(b)) => (a - b).abs() < 1e-6,
            _ => false,
        };
        let doubt = |i: usize| 1.0 + (SHORT_PULSE_DUTY / runs[i].duty.unwrap_or(1.0).max(0.05)).powi(2);
        let sign = |i: usize, j: usize| runs[i].direction * runs[j].direction;
        let kernels = [
            DMatrix::identity(n, n),
            DMatrix::from_fn(n, n, |i, j| if same(i, j) { doubt(i) * doubt(j) } else { 0.0 }),
            DMatrix::from_fn(n, n, sign),
            DMatrix::from_fn(n, n, |i, j| if same(i, j) { sign(i, j) } else { 0.0 }),
            DMatrix::from_fn(n, n, |i, j| (-(rank[i] - rank[j]).abs() / MEMORY_RUNS).exp()),
        ];
        Self { kernels, medians: MEDIANS }
    }

    /// Of runs that differ by chance alone, by about `usual`; nothing is known of duty, direction or order.
    pub fn by_chance(runs: usize, usual: f64) -> Self {
        let none = || DMatrix::zeros(runs, runs);
        let mut medians = MEDIANS;
        medians[0] = usual;
        Self { kernels: [DMatrix::identity(runs, runs), none(), none(), none(), none()], medians }
    }

    /// The same where effects have moved the gains by `shift` (root mean square): of its square as much is form as of any error's.
    pub fn beside_a_shift(&self, shift: f64) -> Self {
        let mut medians = self.medians;
        medians[1] = medians[1].hypot(FORM_ERROR.sqrt() * shift.min(0.5));
        Self { kernels: self.kernels.clone(), medians }
    }

    /// Spreads that are believed before the data.
    pub fn believed(&self) -> Taus {
        self.medians
    }

    /// Covariance of the gains.
    pub fn covariance(&self, taus: &Taus) -> DMatrix<f64> {
        self.between(taus).add_scalar(COMMON * COMMON)
    }

    /// The same of what runs differ by, beside a free speed that is fitted.
    pub fn between(&self, taus: &Taus) -> DMatrix<f64> {
        let n = self.kernels[0].nrows();
        let mut c = DMatrix::zeros(n, n);
        for (kernel, tau) in self.kernels.iter().zip(taus) {
            c.zip_apply(kernel, |a, k| *a += k * tau * tau);
        }
        c
    }

    /// Share of what the gain of run `run` scatters by that is of spread `spread`.
    pub fn share(&self, taus: &Taus, spread: usize, run: usize) -> f64 {
        let of = |k: usize| taus[k] * taus[k] * self.kernels[k][(run, run)];
        of(spread) / (0..taus.len()).map(of).sum::<f64>().max(f64::MIN_POSITIVE)
    }

    /// Log prior of each spread.
    pub fn log_priors(&self, taus: &Taus) -> Taus {
        let normal = |tau: f64, median: f64, log_sd: f64| -0.5 * ((tau / median).ln() / log_sd).powi(2);
        std::array::from_fn(|k| {
            let believed = normal(taus[k], self.medians[k], LOG_SDS[k]);
            if k == ORDER { believed.max(normal(taus[k], UNKNOWN.0, UNKNOWN.1) - UNKNOWN_COST) } else { believed }
        })
    }

    /// Log prior of all spreads.
    pub fn log_prior(&self, taus: &Taus) -> f64 {
        self.log_priors(taus).iter().sum()
    }

    /// The spreads that make the gains likeliest, from `start`.
    pub fn best(&self, start: Taus, log_likelihood: &(dyn Fn(&DMatrix<f64>) -> f64 + Sync)) -> Taus {
        self.climb(start, log_likelihood).1
    }

    /// The same from several starts: a spread over duty, direction or order, and the one by chance, each look like the other until both
    /// are moved. What was taken for chance is tried as each of the others.
    pub fn best_of_all(&self, start: Taus, log_likelihood: &(dyn Fn(&DMatrix<f64>) -> f64 + Sync)) -> Taus {
        let first = self.climb(start, log_likelihood);
        let usual = 3.0 * self.medians[0];
        let mut sizes = vec![usual];
        sizes.extend((first.1[0] > usual).then_some(first.1[0]));
        let elsewhere = sizes.into_iter().flat_map(|size| {
            (1..5).map(move |k| {
                let mut taus = self.medians;
                taus[k] = size;
                taus
            })
        });
        let elsewhere: Vec<Taus> = elsewhere.collect();
        let found: Vec<(f64, Taus)> = elsewhere.into_par_iter().map(|s| self.climb(s, log_likelihood)).collect();
        found.into_iter().fold(first, |best, next| if next.0 > best.0 { next } else { best }).1
    }

    /// By steps along one spread at a time that become finer.
    fn climb(&self, start: Taus, log_likelihood: &(dyn Fn(&DMatrix<f64>) -> f64 + Sync)) -> (f64, Taus) {
        let value = |t: &Taus| log_likelihood(&self.covariance(t)) + self.log_prior(t);
        let mut best = (value(&start), start);
        for factor in [2.5_f64, 1.6, 1.25] {
            for k in 0..5 {
                for f in [factor, 1.0 / factor] {
                    let before = best.0;
                    loop {
                        let mut trial = best.1;
                        trial[k] = (trial[k] * f).clamp(1e-5, 1.0);
                        let v = value(&trial);
                        if v <= best.0 + 1e-3 {
                            break;
                        }
                        best = (v, trial);
                    }
                    // The other way lies what was there before.
                    if best.0 > before {
                        break;
                    }
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::Observed;
    use nalgebra::DVector;
    use rand::{RngExt, SeedableRng};

    /// So many runs at one duty and in one direction, one after the other.
    fn runs(count: u32) -> Level {
        made(&vec![(0.5, 1.0); count as usize])
    }

    /// Runs of these duties and directions, one after the other.
    fn made(ways: &[(f64, f64)]) -> Level {
        let run = |(order, (duty, direction)): (u32, &(f64, f64))| Observed {
            duty: Some(*duty),
            direction: *direction,
            order: Some(order),
            ..Observed::unrecorded()
        };
        Level::new(&Problem::new((0..).zip(ways).map(run).collect()))
    }

    /// How likely gains are that have this covariance.
    fn likely(gains: &[f64], c: &DMatrix<f64>) -> f64 {
        let gains = DVector::from_column_slice(gains);
        let c = c.clone().cholesky().expect("it is a covariance");
        let log_det: f64 = c.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        -0.5 * gains.dot(&c.solve(&gains)) - log_det
    }

    /// The spreads that gains make likeliest.
    fn spreads(level: &Level, gains: &[f64]) -> Taus {
        level.best_of_all(level.believed(), &|c| likely(gains, c))
    }

    /// One and a half per cent either way, among runs that differ by less than one, is no usual spread. Fails if a spread over the direction may be
    /// what it wants to be, or is believed to be three thousandths: such an asymmetry led by six nats, less than it costs.
    #[test]
    fn what_the_directions_differ_by_is_an_asymmetry() {
        let directions: Vec<f64> = (0..40).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let ways: Vec<(f64, f64)> = (0..40).map(|k| (0.1 * f64::from(1 + k / 4), directions[k as usize])).collect();
        let level = made(&ways);
        let chance = |k: usize| 0.008 * (1.7 * k as f64).sin();
        let value = |asymmetry: f64| {
            let gains: Vec<f64> = (0..40).map(|k| asymmetry * directions[k] + chance(k)).collect();
            let taus = spreads(&level, &gains);
            likely(&gains, &level.covariance(&taus)) + level.log_prior(&taus)
        };
        assert!(value(0.0) - value(0.015) > 13.0, "{}", value(0.0) - value(0.015));
        assert!(value(0.0) - value(0.004) < 3.0, "a usual spread: {}", value(0.0) - value(0.004));
    }

    /// Fails if three sessions of which the middle one is another count as chance, or if chance counts as sessions.
    #[test]
    fn what_comes_and_goes_with_the_order_is_no_chance() {
        let level = runs(30);
        let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut gains = |session: f64, chance: f64| -> Vec<f64> {
            let middle = |k: &usize| (10..20).contains(k);
            (0..30).map(|k| session * f64::from(u8::from(middle(&k))) + chance * dice.random_range(-1.0..1.0)).collect()
        };
        let sessions = spreads(&level, &gains(0.08, 0.01));
        assert!(level.log_priors(&sessions)[ORDER] < -LARGEST_SPREAD, "{sessions:?}");
        let large = spreads(&level, &gains(0.5, 0.01));
        assert!(large[0] < 0.03 && large[ORDER] > 0.1, "taken for chance: {large:?}");
        let chance = spreads(&level, &gains(0.0, 0.04));
        assert!(level.log_priors(&chance)[ORDER] > -2.0, "{chance:?}");
    }
}
