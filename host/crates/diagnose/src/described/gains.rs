//! What whole runs differ by: over the duty, the direction, both, or the order, given the gains that they have.

use super::super::finding::{Curve, Described, Estimate};
use super::super::ground::Ground;
use super::super::level::{Level, NAMES, Taus};
use super::super::problem::Problem;
use super::super::set::Set;
use super::short;
use nalgebra::{DMatrix, DVector};
use twum_fit::quantile::NORMAL_95;

/// Most numbers that are told of one spread: a curve of more is read in a picture.
const MOST_NUMBERS: usize = 8;

/// One spread of the gains, with how large it is (root mean square over the runs).
pub fn spread(ground: &Ground, set: &Set, k: usize) -> (f64, Described) {
    let parts = Parts::new(ground, set, k);
    let size = (parts.mean.norm_squared() / parts.mean.len().max(1) as f64).sqrt();
    let at = |run: usize, sign: f64| (sign * parts.mean[run], parts.covariance[(run, run)].max(0.0).sqrt());
    let estimate = |name: String, (value, sd): (f64, f64)| {
        let half = NORMAL_95 * sd;
        Estimate { name, value, interval: [value - half, value + half], unit: "1".to_owned() }
    };
    let problem = ground.problem;
    let duties = by(problem, |run| problem.runs[run].duty);
    let curve = |sign: &dyn Fn(usize) -> f64| -> Vec<[f64; 2]> {
        duties.iter().map(|(duty, run)| [*duty, at(*run, sign(*run)).0]).collect()
    };
    let (equation, parameters, curve) = match NAMES[k] {
        "duty" => {
            let one = |(duty, run): &(f64, usize)| estimate(format!("at_duty_{}", short(*duty)), at(*run, 1.0));
            let told = thinned(&duties).iter().map(one).collect();
            ("speed·(1 + g(duty)), the same in every run of a duty", told, Curve::Duty(curve(&|_| 1.0)))
        }
        "direction" => {
            let sides = by(problem, |run| Some(problem.runs[run].direction));
            let one =
                |(sign, run): &(f64, usize)| estimate(if *sign > 0.0 { "cw" } else { "ccw" }.to_owned(), at(*run, 1.0));
            let cw = sides.first().map_or(0.0, |(sign, run)| sign * at(*run, 1.0).0);
            ("speed·(1 + g) cw, speed·(1 − g) ccw", sides.iter().rev().map(one).collect(), Curve::Direction(cw))
        }
        "duty and direction" => {
            let sign = |run: usize| problem.runs[run].direction;
            let one =
                |(duty, run): &(f64, usize)| estimate(format!("cw_at_duty_{}", short(*duty)), at(*run, sign(*run)));
            let told = thinned(&duties).iter().map(one).collect();
            ("speed·(1 + g(duty)) cw, speed·(1 − g(duty)) ccw", told, Curve::DutyAndDirection(curve(&sign)))
        }
        "order" => {
            let ranks = problem.ranks();
            let places = by(problem, |run| Some(ranks[run]));
            let one = |(rank, run): &(f64, usize)| estimate(format!("run_{}", rank + 1.0), at(*run, 1.0));
            let told = thinned(&places).iter().map(one).collect();
            (
                "speed·(1 + g(order)), order the place of the run in the series, g forgotten over six runs",
                told,
                Curve::Elsewhere,
            )
        }
        _ => {
            // Of a normal scatter, by its degrees of freedom.
            let freedom = (parts.mean.len().max(2) - 1) as f64;
            let told = vec![estimate("scatter".to_owned(), (size, size / (2.0 * freedom).sqrt()))];
            ("speed·(1 + g), another g in every run", told, Curve::Elsewhere)
        }
    };
    let coordinate = NAMES[k].to_owned();
    (size, Described { coordinate, equation: equation.to_owned(), parameters, gain: parts.gain, curve })
}

/// What one spread has of the gains.
struct Parts {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Share of the root mean square of the gains that it foretells of runs left out.
    gain: f64,
}

impl Parts {
    /// All gains are one Gaussian, of which the spread is a part. What the runs leave open of their gains is small against what these
    /// differ by, and is left out.
    fn new(ground: &Ground, set: &Set, k: usize) -> Self {
        let level = &ground.level;
        let gains = DVector::from_column_slice(&set.weighed.gains);
        let taus = likeliest(level, &gains, set.weighed.taus, k);
        let [mut only, mut others] = [[0.0; 5], taus];
        (only[k], others[k]) = (taus[k], 0.0);
        let part = level.covariance(&only) - level.covariance(&[0.0; 5]);
        let all = level.covariance(&taus);
        let Some(chol) = all.clone().cholesky() else {
            return Self { mean: 0.0 * &gains, covariance: part, gain: 0.0 };
        };
        let missed = [&level.covariance(&others), &all].map(|covariance| left_out(covariance, &gains));
        Self {
            mean: &part * chol.solve(&gains),
            covariance: &part - &part * chol.solve(&part),
            gain: if missed[0] > 0.0 { 1.0 - missed[1] / missed[0] } else { 0.0 },
        }
    }
}

/// Standard deviations at which a spread and the chance beside it are tried, from a thousandth to a quarter of the speed.
const TRIED: i32 = 24;

/// The spreads with the one of the place and the one by chance at their likeliest. That something lives there is settled: the belief that
/// nothing does, under which the gains were weighed, would only make it look smaller than it is.
fn likeliest(level: &Level, gains: &DVector<f64>, taus: Taus, k: usize) -> Taus {
    let sizes = || (0..TRIED).map(|step| 1e-3 * 250_f64.powf(f64::from(step) / f64::from(TRIED - 1)));
    let tried = sizes().flat_map(|tau| sizes().map(move |chance| (tau, chance))).filter_map(|(tau, chance)| {
        let mut taus = taus;
        (taus[0], taus[k]) = (chance, if k == 0 { chance } else { tau });
        let chol = level.covariance(&taus).cholesky()?;
        let log_det: f64 = chol.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        let belief = if k == 0 { 0.0 } else { level.log_priors(&taus)[0] };
        Some((belief - 0.5 * gains.dot(&chol.solve(gains)) - log_det, taus))
    });
    tried.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(taus, |best| best.1)
}

/// Root mean square by which each gain is missed by what the others say of it. Rasmussen & Williams, Gaussian Processes for Machine Learning
/// (2006), eq. 5.12.
fn left_out(covariance: &DMatrix<f64>, gains: &DVector<f64>) -> f64 {
    let Some(chol) = covariance.clone().cholesky() else { return 0.0 };
    let (inverse, weighted) = (chol.inverse(), chol.solve(gains));
    let squares = (0..gains.len()).map(|i| (weighted[i] / inverse[(i, i)]).powi(2));
    (squares.sum::<f64>() / gains.len().max(1) as f64).sqrt()
}

/// The values that something has in the runs, in rising order, each with a run that has it.
fn by(problem: &Problem, of: impl Fn(usize) -> Option<f64>) -> Vec<(f64, usize)> {
    let mut all: Vec<(f64, usize)> = (0..problem.runs.len()).filter_map(|run| Some((of(run)?, run))).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.dedup_by(|a, b| (a.0 - b.0).abs() < 1e-6);
    all
}

/// Evenly some of many.
fn thinned<T: Copy>(all: &[T]) -> Vec<T> {
    if all.len() <= MOST_NUMBERS {
        return all.to_vec();
    }
    (0..MOST_NUMBERS).map(|k| all[k * (all.len() - 1) / (MOST_NUMBERS - 1)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if runs left out are foretold by themselves: by two that are told apart by nothing, each is missed by what they differ by.
    #[test]
    fn a_gain_is_foretold_by_the_others() {
        let covariance = DMatrix::from_row_slice(2, 2, &[1.01, 1.0, 1.0, 1.01]);
        let missed = left_out(&covariance, &DVector::from_vec(vec![0.3, 0.1]));
        // By 0.3 − 0.1·1/1.01 and 0.1 − 0.3·1/1.01.
        let expected = (((0.3 - 0.1 / 1.01_f64).powi(2) + (0.1 - 0.3 / 1.01_f64).powi(2)) / 2.0).sqrt();
        assert!((missed - expected).abs() < 1e-12, "{missed} {expected}");
    }

    /// Fails if the first or the last of many is left out, or one comes twice.
    #[test]
    fn of_many_numbers_some_are_told() {
        let all: Vec<usize> = (0..30).collect();
        let told = thinned(&all);
        assert_eq!((told.len(), told[0], told[7]), (MOST_NUMBERS, 0, 29));
        assert!(told.windows(2).all(|w| w[0] < w[1]));
    }
}
