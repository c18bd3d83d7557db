//! Terms of which every run has coefficients of its own: harmonics of the angle, each with a phase a run, and a wander over time.

use super::super::design::{Basis, Column};
use super::super::discrepancy::Term;
use super::super::finding::{Curve, Estimate};
use super::super::free::columns_of;
use super::super::ground::Ground;
use super::super::numbers::FORM;
use super::super::problem::Problem;
use super::super::set::Set;
use super::{Said, short};
use nalgebra::{DMatrix, DVector};
use twum_fit::quantile::{NORMAL_95, student_95};

/// Most orders that are told.
const MOST_ORDERS: usize = 3;
/// Standard deviation of a coefficient from which a run says nothing of it: effects are some per cent of the speed.
const SAYS_NOTHING: f64 = 0.3;
/// Smallest diagonal of the normal equations, as a share of the largest: of columns that a run does not show.
const NEGLIGIBLE: f64 = 1e-9;
/// Share of a square by which runs differ in it beyond sampling: a quarter of the amplitude, as pulses pass it on or not.
const BETWEEN_RUNS: f64 = 0.5;
/// Length of the mean of the runs' unit phases from which they are said to agree: within half a radian of each other.
const AGREE: f64 = 0.9;
/// Runs from which phases that agree do so by no chance: of four, once in a thousand.
const FEWEST_THAT_AGREE: usize = 4;

/// What one run has of a term.
struct Own {
    run: usize,
    coefficients: DVector<f64>,
    /// What its sampling makes of them.
    covariance: DMatrix<f64>,
}

/// The term in words and numbers.
pub fn own(ground: &Ground, set: &Set, term: &Term) -> Said {
    let fits = fitted(ground, set, term);
    if term.harmonic { harmonics(ground.problem, term, &fits) } else { wander(ground.problem, term, &fits) }
}

/// Coefficients of every run, beside the pairs of the set and, of harmonics, a gain and a free speed of the run's own.
fn fitted(ground: &Ground, set: &Set, term: &Term) -> Vec<Own> {
    let mut columns = Vec::new();
    if term.harmonic {
        // A wander has both: its hats add up to the speed, and beside a gain none of them would be sure.
        columns.extend(columns_of(&ground.free(&set.model, &set.parts)[..1]));
        columns.push(Column::Flexible(Basis::Time(0, 1)));
    }
    columns.extend(set.parts.iter().flat_map(|p| &p.phased).flat_map(|p| p.columns()));
    let from = columns.len();
    columns.extend(term.columns.iter().cloned());
    let designs = ground.problem.design(&set.model, &columns);
    let runs = ground.problem.runs.iter().zip(designs).enumerate();
    runs.filter_map(|(run, (observed, d))| {
        let x = DMatrix::from_row_slice(d.y.len(), d.columns, &d.x);
        let y = DVector::from_column_slice(&d.y);
        let mut g = x.tr_mul(&x);
        let ridge = NEGLIGIBLE * g.diagonal().max();
        (0..d.columns).for_each(|k| g[(k, k)] += ridge);
        let chol = g.cholesky()?;
        let all = chol.solve(&x.tr_mul(&y));
        let left = (&y - &x * &all).norm_squared();
        // Windows overlap: as many say something as lie apart.
        let freedom = (observed.apart() - d.columns as f64).max(1.0);
        let n = term.columns.len();
        let covariance = chol.inverse().view((from, from), (n, n)) * (left / freedom);
        Some(Own { run, coefficients: all.rows(from, n).into_owned(), covariance })
    })
    .collect()
}

/// A size that all runs have in common, and its 95 % interval: the root of the mean square beyond what sampling makes.
struct Size {
    value: f64,
    interval: [f64; 2],
}

impl Size {
    /// Of squares with what sampling makes of each. A run weighs by how surely it shows its own: a slow one hardly sees an order.
    fn of(squares: &[[f64; 2]]) -> Self {
        let beyond: Vec<f64> = squares.iter().map(|s| s[0] - s[1]).collect();
        let mean_of = |weights: &[f64]| {
            let sum: f64 = weights.iter().zip(&beyond).map(|(w, b)| w * b).sum();
            sum / weights.iter().sum::<f64>().max(f64::MIN_POSITIVE)
        };
        // A square of mean m over a noise v in both coefficients together scatters by √(2·v·m + v²); and runs differ.
        let weights_at = |mean: f64| -> Vec<f64> {
            let variance = |v: f64| 2.0 * v * mean + v * v + (BETWEEN_RUNS * mean).powi(2);
            squares.iter().map(|s| 1.0 / variance(s[1]).max(1e-20)).collect()
        };
        let mut weights = weights_at(0.0);
        for _ in 0..4 {
            weights = weights_at(mean_of(&weights).max(0.0));
        }
        let mean = mean_of(&weights);
        let [total, squared] = weights.iter().fold([0.0; 2], |sum, w| [sum[0] + w, sum[1] + w * w]);
        // As many runs of equal weight say as much.
        let runs = total * total / squared.max(f64::MIN_POSITIVE);
        let half = if squares.len() > 1 {
            let scatter: f64 = weights.iter().zip(&beyond).map(|(w, b)| (w * (b - mean)).powi(2)).sum();
            student_95(runs - 1.0) * (scatter * runs / (runs - 1.0).max(0.5)).sqrt() / total
        } else {
            let noise = squares.first().map_or(0.0, |s| s[1]);
            NORMAL_95 * (2.0 * noise * mean.max(0.0) + noise * noise).sqrt()
        };
        let root = |square: f64| square.max(0.0).sqrt();
        let value = root(mean);
        // What is wrong with the form makes no size out of nothing.
        let widened = |end: f64| (end - value).hypot(NORMAL_95 * FORM * value);
        let [low, high] = [root(mean - half), root(mean + half)].map(widened);
        Self { value, interval: [if mean > half { (value - low).max(1e-6) } else { 0.0 }, value + high] }
    }

    fn estimate(&self, name: String) -> Estimate {
        Estimate { name, value: self.value, interval: self.interval, unit: "1".to_owned() }
    }
}

/// The sizes that are none by no chance, three at most; the largest one where all could be none. In their order.
fn strongest(mut sizes: Vec<(usize, Size)>) -> Vec<(usize, Size)> {
    sizes.sort_by(|a, b| b.1.value.total_cmp(&a.1.value));
    let sure = |s: &(usize, Size)| s.1.interval[0] > 0.0;
    if sizes.iter().any(sure) {
        sizes.retain(sure);
        sizes.truncate(MOST_ORDERS);
    } else {
        sizes.truncate(1);
    }
    sizes.sort_by_key(|s| s.0);
    sizes
}

/// Orders of a turn in words and numbers.
fn harmonics(problem: &Problem, term: &Term, fits: &[Own]) -> Said {
    let order = |k: usize| match term.columns[2 * k] {
        Column::Flexible(Basis::Angle(rate, _) | Basis::Cycle(rate, _)) => rate,
        _ => 0.0,
    };
    let over_time = matches!(term.columns.first(), Some(Column::Flexible(Basis::Cycle(..))));
    let shown = |k: usize| -> Vec<&Own> {
        let noise = |f: &Own| f.covariance[(2 * k, 2 * k)].max(f.covariance[(2 * k + 1, 2 * k + 1)]);
        fits.iter().filter(|f| noise(f).sqrt() < SAYS_NOTHING).collect()
    };
    let size = |k: usize| {
        let square = |f: &&Own| {
            let at = [2 * k, 2 * k + 1];
            at.map(|i| [f.coefficients[i].powi(2), f.covariance[(i, i)]])
                .iter()
                .fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]])
        };
        Size::of(&shown(k).iter().map(square).collect::<Vec<_>>())
    };
    let sizes = strongest((0..term.columns.len() / 2).map(|k| (k, size(k))).collect());
    // The run that turned farthest stands for all, as its phases do in the saved model.
    let farthest = |a: &&&Own, b: &&&Own| {
        let turned = |f: &Own| problem.runs[f.run].revolutions().abs();
        turned(a).total_cmp(&turned(b))
    };
    let phase = |k: usize| {
        let runs = shown(k);
        runs.iter().max_by(farthest).map_or(0.0, |f| f.coefficients[2 * k + 1].atan2(f.coefficients[2 * k]))
    };
    let agree = sizes.iter().all(|(k, _)| in_phase(&shown(*k), *k));
    let variable = if over_time { "·2πt" } else { "θ" };
    let sum: Vec<String> =
        sizes.iter().map(|(k, _)| format!("a{0}·cos({0}{variable} − φ{0})", short(order(*k)))).collect();
    let waves = sizes.iter().map(|(k, s)| [order(*k), s.value, phase(*k)]).collect();
    let phases = if agree { "the same φ in all runs" } else { "a φ of its own in every run" };
    Said {
        equation: format!("speed·(1 + {}), {phases}", sum.join(" + ")),
        parameters: sizes.iter().map(|(k, s)| s.estimate(format!("a{}", short(order(*k))))).collect(),
        curve: if over_time { Curve::Cycle(waves) } else { Curve::Angle(waves) },
    }
}

/// Whether all runs have the same phase since their beginning, which they do only where they begin at the same angle.
fn in_phase(runs: &[&Own], k: usize) -> bool {
    let sum = runs.iter().fold([0.0; 3], |sum, f| {
        let [a, b] = [f.coefficients[2 * k], f.coefficients[2 * k + 1]];
        [sum[0] + a, sum[1] + b, sum[2] + a.hypot(b)]
    });
    runs.len() >= FEWEST_THAT_AGREE && sum[0].hypot(sum[1]) > AGREE * sum[2]
}

/// A course over time of each run's own: how large it is, and of a single run how it goes.
fn wander(problem: &Problem, term: &Term, fits: &[Own]) -> Said {
    let n = term.columns.len();
    let longest_s = problem.runs.iter().map(|r| r.drive_end).fold(0.0, f64::max);
    let times: Vec<f64> = (0..n).map(|k| longest_s * k as f64 / (n - 1).max(1) as f64).collect();
    let courses: Vec<(Vec<f64>, [f64; 2])> = fits.iter().map(|f| about_its_mean(f, n)).collect();
    let size = Size::of(&courses.iter().map(|c| c.1).collect::<Vec<_>>());
    let step = short(times.get(1).copied().unwrap_or(0.0));
    let curve = match courses.as_slice() {
        [(course, _)] => Curve::Time(times.iter().zip(course).map(|(t, c)| [*t, *c]).collect()),
        _ => Curve::Elsewhere,
    };
    let whose = if courses.len() == 1 { "" } else { ", another c in every run" };
    Said {
        equation: format!("speed·(1 + Σ c_k·hat_k(t)), knots every {step} s{whose}"),
        parameters: vec![size.estimate("root_mean_square".to_owned())],
        curve,
    }
}

/// The knots of a run's course less its mean over time, and its mean square with what sampling makes of that. Between knots it is linear:
/// at the knots themselves a course that bends is told too large.
fn about_its_mean(f: &Own, n: usize) -> (Vec<f64>, [f64; 2]) {
    let (c, v) = (&f.coefficients, &f.covariance);
    let seen = |k: usize| v[(k, k)].sqrt() < SAYS_NOTHING;
    let pieces: Vec<usize> = (1..n).filter(|k| seen(k - 1) && seen(*k)).collect();
    let over = |of: &dyn Fn(usize, usize) -> f64| {
        pieces.iter().map(|k| of(k - 1, *k)).sum::<f64>() / pieces.len().max(1) as f64
    };
    let mean = over(&|a, b| 0.5 * (c[a] + c[b]));
    let course: Vec<f64> = (0..n).map(|k| if seen(k) { c[k] - mean } else { 0.0 }).collect();
    let product = |a: usize, b: usize| course[a] * course[a] + course[a] * course[b] + course[b] * course[b];
    let square = over(&|a, b| product(a, b) / 3.0);
    let noise = over(&|a, b| (v[(a, a)] + v[(a, b)] + v[(b, b)]) / 3.0);
    (course, [square, noise])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if an order that could be none is told beside one that could not, or if none is told where all could be.
    #[test]
    fn what_could_be_none_is_told_alone_or_not_at_all() {
        let size = |k: usize, value: f64, low: f64| (k, Size { value, interval: [low, 2.0 * value] });
        let told = |sizes: Vec<(usize, Size)>| strongest(sizes).iter().map(|s| s.0).collect::<Vec<_>>();
        let large = size(0, 0.05, 0.0);
        assert_eq!(told(vec![large, size(1, 0.01, 0.008), size(2, 0.02, 0.0), size(3, 0.03, 0.02)]), [1, 3]);
        assert_eq!(told(vec![size(0, 0.01, 0.0), size(1, 0.02, 0.0)]), [1]);
        let five = (0..5).map(|k| size(k, 0.01 * (k + 1) as f64, 0.001)).collect();
        assert_eq!(told(five), [2, 3, 4]);
    }

    /// Fails if an amplitude holds what sampling makes of it, or an interval without a scatter between runs is not that of sampling.
    #[test]
    fn a_size_is_what_lies_beyond_the_sampling() {
        let size = Size::of(&[[0.0017, 0.0001]; 4]);
        assert!((size.value - 0.04).abs() < 1e-12, "{}", size.value);
        let none = Size::of(&[[0.0002, 0.0001], [0.0000, 0.0001], [0.0001, 0.0001]]);
        assert_eq!((none.value, none.interval[0]), (0.0, 0.0));
        // One that sees nothing of it takes nothing away.
        let [sure, unsure] = [[0.0017, 0.0001], [0.0201, 0.02]];
        let mixed = Size::of(&[sure, unsure, sure, sure, unsure, sure]);
        assert!((mixed.value - 0.04).abs() < 0.001 && mixed.interval[0] > 0.03, "{} {:?}", mixed.value, mixed.interval);
        let [one, sharper] = [1e-4, 1e-6].map(|noise| Size::of(&[[0.0016 + noise, noise]]));
        assert!(one.interval[1] - one.interval[0] > 3.0 * (sharper.interval[1] - sharper.interval[0]));
    }
}
