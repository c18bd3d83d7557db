//! A rhythm of the angle has one amplitude; only its phase is each run's own.
//!
//! The coefficients of a run's own are integrated under a power that all runs share (`evidence`), which lets every run have an amplitude of
//! its own: what happens in some of the runs alone, at the lowest duty or before the motor was run in, passes for a rhythm that the others
//! happen not to have. This weighs what that gave away.

use super::evidence::{Question, Weighed};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use std::f64::consts::TAU;
use twum_fit::normal::Normal;

/// How much two amplitudes that are tried one after the other differ; and runs do, by what a form gets wrong: the same runout slows a rotor
/// more at a low duty than at a high one.
const STEP: f64 = 1.3;
/// Amplitudes that are tried, in such steps from the one that the power says: a fifth to three times of it.
const STEPS: std::ops::RangeInclusive<i32> = -6..=4;
/// Phases that are summed over: a phase that a run tells to 0.1 rad, the best there are, is met by more than one.
const PHASES: usize = 100;

/// Log of how much likelier `runs` are if each group of a cosine and a sine in `q` has one amplitude in all of them, than they were weighed
/// with amplitudes of their own: sums of posterior over prior on rings of one radius.
pub fn of_one_amplitude(runs: &[Normal], q: &Question, weighed: &Weighed) -> f64 {
    if weighed.powers.is_empty() {
        // Nothing goes with the angle, or the set could not be weighed.
        return 0.0;
    }
    let mut groups: Vec<Vec<f64>> = vec![vec![0.0; STEPS.count()]; weighed.powers.len()];
    for (i, run) in runs.iter().enumerate() {
        let Some(posterior) = Posterior::of(run, i, q, weighed) else { continue };
        for (group, sums) in groups.iter_mut().enumerate() {
            let at: Vec<usize> = (0..q.own.len()).filter(|i| q.own[*i].1 == group).collect();
            let on_rings = posterior.on_rings([at[0], at[1]], weighed.powers[group]);
            sums.iter_mut().zip(on_rings).for_each(|(sum, log)| *sum += log);
        }
    }
    groups.iter().map(|sums| sums.iter().copied().fold(f64::NEG_INFINITY, f64::max)).sum()
}

/// What one run says of its own coefficients.
struct Posterior {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Posterior {
    /// Of the run of index `at`, beside what it shares with others and a gain that scatters about the expected one as the runs' gains do: of less than
    /// a turn, a cosine takes what is a gain.
    fn of(run: &Normal, at: usize, q: &Question, weighed: &Weighed) -> Option<Self> {
        let gain: f64 = weighed.taus.iter().map(|t| t * t).sum();
        let columns: Vec<usize> = std::iter::once(0).chain(q.own.iter().map(|o| o.0)).collect();
        let priors: Vec<f64> = std::iter::once(gain).chain(q.own.iter().map(|o| weighed.powers[o.1])).collect();
        let n = columns.len();
        let said = DMatrix::from_fn(n, n, |i, j| {
            run.g[(columns[i], columns[j])] / weighed.variance + if i == j { 1.0 / priors[i] } else { 0.0 }
        });
        let beside = |column: usize| {
            let shared = q.shared(at).map(|(which, of, sd)| run.g[(column, of)] * sd * weighed.shared[which]);
            run.b[column] - run.g[(column, 0)] * weighed.gains[at] - shared.sum::<f64>()
        };
        let by = DVector::from_fn(n, |i, _| beside(columns[i]) / weighed.variance);
        let solved = said.cholesky()?;
        Some(Self {
            mean: solved.solve(&by).rows(1, n - 1).into(),
            covariance: solved.inverse().view((1, 1), (n - 1, n - 1)).into(),
        })
    }

    /// Log of posterior over prior of the pair `at`, whose prior has `power`, on rings of each amplitude.
    fn on_rings(&self, at: [usize; 2], power: f64) -> Vec<f64> {
        let mean = Vector2::from_fn(|i, _| self.mean[at[i]]);
        let covariance = Matrix2::from_fn(|i, j| self.covariance[(at[i], at[j])]);
        let Some(inverse) = covariance.try_inverse() else { return vec![0.0; STEPS.count()] };
        let height = (power / covariance.determinant().sqrt()).ln();
        let rings: Vec<f64> = STEPS
            .map(|step| {
                let amplitude = (2.0 * power).sqrt() * STEP.powi(step);
                let sum: f64 = (0..PHASES)
                    .map(|k| {
                        let (sin, cos) = (k as f64 * TAU / PHASES as f64).sin_cos();
                        let off = Vector2::new(cos, sin) * amplitude - mean;
                        (0.5 * amplitude * amplitude / power - 0.5 * off.dot(&(inverse * off))).exp()
                    })
                    .sum();
                sum / PHASES as f64
            })
            .collect();
        let last = rings.len() - 1;
        (0..=last)
            .map(|k| 0.5 * rings[k] + 0.25 * (rings[k.saturating_sub(1)] + rings[last.min(k + 1)]))
            .map(|ring| height + ring.max(f64::MIN_POSITIVE).ln())
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs of 100 equal rows that turn once, with a cosine and a sine of these amplitudes, weighed with these powers.
    fn likelier(amplitudes: &[f64], powers: Vec<f64>) -> f64 {
        let run = |(k, amplitude): (usize, &f64)| {
            let phase = 2.4 * k as f64;
            let rows = (0..100).map(|i| (f64::from(i) * TAU / 100.0).sin_cos());
            let x: Vec<f64> = rows.clone().flat_map(|(sin, cos)| [1.0, cos, sin]).collect();
            let y: Vec<f64> = rows.map(|(sin, cos)| amplitude * (cos * phase.cos() + sin * phase.sin())).collect();
            Normal::new(3, &x, &y)
        };
        let runs: Vec<Normal> = amplitudes.iter().enumerate().map(run).collect();
        let q = Question { own: vec![(1, 0), (2, 0)], ..Question::default() };
        let weighed = Weighed {
            log: 0.0,
            left: 0.0,
            variance: 1.0,
            taus: [0.01; 5],
            belief: [0.0; 5],
            gains: vec![0.0; runs.len()],
            shared: Vec::new(),
            powers,
        };
        of_one_amplitude(&runs, &q, &weighed)
    }

    /// Twenty runs of one power. Fails if runs that have none of a rhythm do not speak against it, or if those that have the same do not speak
    /// for it: what was different before the motor was run in was NAMED a runout.
    #[test]
    fn a_rhythm_is_in_all_runs() {
        let mut some = [0.0; 20];
        some[..5].fill(2.0);
        let [all, some] = [[1.0; 20], some].map(|amplitudes| likelier(&amplitudes, vec![0.5]));
        assert!(all > 10.0 && some < -20.0, "{all}, {some}");
    }

    /// Fails if a form that is a little off in some runs counts as another cause.
    #[test]
    fn amplitudes_may_differ_a_little() {
        let some: Vec<f64> = (0..20).map(|k| if k % 2 == 0 { 0.8 } else { 1.2 }).collect();
        let some = likelier(&some, vec![0.5]);
        assert!(some > 0.0, "{some}");
    }

    /// Fails if a set that could not be weighed is a panic.
    #[test]
    fn what_was_not_weighed_is_as_likely() {
        assert_eq!(likelier(&[1.0; 3], Vec::new()), 0.0);
    }
}
