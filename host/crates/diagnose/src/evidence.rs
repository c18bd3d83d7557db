//! How much the data speak for a set of effects: one marginal likelihood for all.
//!
//! The residuals of a run are its gain times the predicted speed, the effects' columns, terms with coefficients of the run's own (a
//! phase, a wander), and noise whose variance is unknown. Everything linear is integrated in closed form as *one* Gaussian: gains with a
//! covariance over duty, direction and order; common columns under their priors (Laplace's approximation around a refitted model);
//! a run's own coefficients under a power that all runs share.
//!
//! The likelihood is tempered: a model is right only up to differences of form, so that residuals count as a stated number of
//! independent ones, however many were recorded. Reference: Miller & Dunson, Robust Bayesian inference via coarsening, JASA 114
//! (2019) 1113; the power of a run's own coefficients by expectation–maximisation (Dempster, Laird & Rubin 1977).

use super::design::RunDesign;
use super::form_error::FORM_ERROR;
use super::gaussian::{Said, Together, join, log_det};
use super::level::{Level, Taus};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use twum_fit::normal::Normal;

/// How many independent residuals a data set counts as: two forms are told apart if this many would tell them apart.
const INDEPENDENT: f64 = 200.0;
/// The same for each run, where there are many: a run has a gain and up to six own coefficients to say something of.
const INDEPENDENT_A_RUN: f64 = 8.0;
/// Share of the speed below which no equation of the rotor is believed: the one of the search and the averaged model of the stator
/// differ by 0.1 to 0.2 % of it where nothing is hidden.
pub const MODEL_FLOOR: f64 = 0.005;
/// Rounds of expectation–maximisation of noise and powers.
const ROUNDS: usize = 6;
/// They end when none of these moves by more than this share of itself: near its greatest value the likelihood moves by the square of that.
const SETTLED: f64 = 0.003;

/// Normal equations of every run around one model.
pub struct Equations {
    /// One a run.
    pub runs: Vec<Normal>,
    /// How many independent residuals they count as.
    pub independent: f64,
}

impl Equations {
    /// Of `designs`; the coefficients that the model has of columns `own` in each run are added back, so that they are fitted whole.
    pub fn new(designs: &[RunDesign], own: std::ops::Range<usize>, values: &[Vec<f64>]) -> Self {
        let runs = designs
            .par_iter()
            .zip(values)
            .map(|(d, z)| {
                let around = DVector::from_fn(d.columns, |i, _| if own.contains(&i) { z[i - own.start] } else { 0.0 });
                Normal::new(d.columns, &d.x, &d.y).whole(&around)
            })
            .collect();
        let rows = designs.iter().map(|d| d.y.len() as f64).sum();
        Self { independent: independent(rows, designs.len()), runs }
    }

    /// What more `columns` would take of the squared error, in rpm²·s, beside those `with`, and what there is without them; each run has
    /// coefficients of its own for all. Both are by degrees of freedom of the residuals that lie `apart`: what chance takes counts for
    /// nothing.
    pub fn course(&self, with: &[usize], columns: std::ops::Range<usize>, apart: f64) -> [f64; 2] {
        let before: Vec<usize> = std::iter::once(0).chain(with.iter().copied()).collect();
        let after: Vec<usize> = before.iter().copied().chain(columns).collect();
        let [before, after] = [before, after].map(|columns| {
            let fits = self.runs.iter().map(|run| fitted(run, &columns));
            let (left, taken) = fits.fold((0.0, 0.0), |sum, fit| (sum.0 + fit.0, sum.1 + fit.1));
            left * apart / (apart - taken).max(0.25 * apart)
        });
        [before - after, before]
    }

    /// The speeds of each run, which are the first column, squared and summed: rpm²·s.
    pub fn squared_speeds(&self) -> Vec<f64> {
        self.runs.iter().map(|r| r.g[(0, 0)]).collect()
    }

    /// What is `left` of the squared error, with what is believed to be error of the forms and of any equation, in rpm²·s; so much was left `without`
    /// effects.
    fn error(&self, left: f64, without: f64) -> f64 {
        (1.0 - FORM_ERROR) * left + FORM_ERROR * without.max(left) + self.floor()
    }

    /// Squared error in rpm²·s that is none: what any equation misses of the speeds.
    pub fn floor(&self) -> f64 {
        MODEL_FLOOR * MODEL_FLOOR * self.squared_speeds().iter().sum::<f64>()
    }
}

/// Share of the largest diagonal element below which a column says nothing in a run.
const NEGLIGIBLE: f64 = 1e-9;

/// Squared error of a run that is left, and coefficients that it took, with `columns` fitted freely.
fn fitted(run: &Normal, columns: &[usize]) -> (f64, f64) {
    let largest = columns.iter().map(|c| run.g[(*c, *c)]).fold(0.0, f64::max);
    let seen: Vec<usize> = columns.iter().copied().filter(|c| run.g[(*c, *c)] > NEGLIGIBLE * largest).collect();
    let n = seen.len();
    let ridge = NEGLIGIBLE * largest;
    let g = DMatrix::from_fn(n, n, |i, j| run.g[(seen[i], seen[j])] + if i == j { ridge } else { 0.0 });
    let b = DVector::from_fn(n, |i, _| run.b[seen[i]]);
    let explained = g.cholesky().map_or(0.0, |chol| b.dot(&chol.solve(&b)));
    ((run.yy - explained).max(0.0), n as f64)
}

/// How many independent residuals `rows` of `runs` count as; overlapping ones repeat each other.
pub fn independent(rows: f64, runs: usize) -> f64 {
    INDEPENDENT.max(INDEPENDENT_A_RUN * runs as f64).min(0.25 * rows).max(1.0)
}

/// What is asked of the equations: column 0 is the gain of the run.
#[derive(Debug, Clone, Default)]
pub struct Question {
    /// Common columns with the standard deviation of their coefficient.
    pub common: Vec<(usize, f64)>,
    /// The same of columns whose coefficient runs of one kind share.
    pub by_kind: Vec<(usize, f64)>,
    /// Of which kind each run is, counted from 0; empty if there are no such columns.
    pub kinds: Vec<usize>,
    /// Own columns; those of one group share their power.
    pub own: Vec<(usize, usize)>,
}

impl Question {
    /// The columns from the first own one to the last.
    pub fn own_range(&self) -> std::ops::Range<usize> {
        self.own.first().map_or(0, |o| o.0)..self.own.last().map_or(0, |o| o.0 + 1)
    }

    /// The coefficients that run `run` shares with others: which they are of all such ones, their columns and standard deviations.
    pub fn shared(&self, run: usize) -> impl Iterator<Item = (usize, usize, f64)> {
        let of_its_kind = self.kinds.get(run).map_or(0, |kind| self.common.len() + kind * self.by_kind.len());
        let common = self.common.iter().enumerate().map(|(k, c)| (k, c.0, c.1));
        common.chain(self.by_kind.iter().enumerate().map(move |(k, c)| (of_its_kind + k, c.0, c.1)))
    }

    /// The own coefficients of all runs beside the gains and the shared coefficients that are expected.
    fn expected_own(
        &self,
        reduced: &[Reduced],
        gains: &DVector<f64>,
        shared: &DVector<f64>,
        powers: &[f64],
    ) -> ExpectedOwn {
        let mut all = ExpectedOwn { from_none: 0.0, power: vec![0.0; powers.len()] };
        for (run, gain) in reduced.iter().zip(gains.iter()) {
            let Some(own) = &run.own else { continue };
            let z = own.expected(*gain, run.said.shared.iter().map(|s| shared[*s]));
            all.from_none += z.norm_squared();
            for (i, o) in self.own.iter().enumerate() {
                all.power[o.1] += (z[i] * z[i] + own.inverse[(i, i)]) * powers[o.1];
            }
        }
        all
    }

    /// How many coefficients runs share.
    fn shared_count(&self) -> usize {
        self.common.len() + self.kinds.iter().max().map_or(0, |kind| (kind + 1) * self.by_kind.len())
    }
}

/// The runs' own coefficients, all together.
struct ExpectedOwn {
    /// How far they are from none, squared and in units of their priors.
    from_none: f64,
    /// The squares of each group's, summed.
    power: Vec<f64>,
}

/// What was found by integrating.
#[derive(Debug, Clone)]
pub struct Weighed {
    /// Log marginal likelihood.
    pub log: f64,
    /// Squared error that is left, gains and all terms at their expected values, in rpm²·s.
    pub left: f64,
    /// Variance of a tempered residual.
    pub variance: f64,
    /// Spreads of the gains.
    pub taus: Taus,
    /// Log prior of each of these spreads.
    pub belief: Taus,
    /// Gain of each run.
    pub gains: Vec<f64>,
    /// Expected coefficients that runs share, the common ones first, in units of their standard deviations.
    pub shared: Vec<f64>,
    /// Power of each group.
    pub powers: Vec<f64>,
}

/// Where integrating starts.
#[derive(Debug, Clone)]
pub struct Start {
    /// Variance of a tempered residual.
    pub variance: f64,
    /// Spreads of the gains.
    pub taus: Taus,
    /// Squared error without effects, in rpm²·s.
    pub without: f64,
    /// How the spreads are found.
    pub spreads: Spreads,
}

/// How the spreads of the gains are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spreads {
    /// They stay.
    Stay,
    /// From where they are.
    Near,
    /// From everywhere.
    Anywhere,
}

/// What a run says with its own coefficients integrated.
pub(super) struct Reduced {
    pub said: Said,
    yy: f64,
    log_det: f64,
    freedom: f64,
    own: Option<Own>,
}

/// The own coefficients of a run, in units of the square roots of their powers.
struct Own {
    precision: Cholesky<f64, Dyn>,
    inverse: DMatrix<f64>,
    /// How they hang together with the run's gain and the shared coefficients that it has.
    link: DMatrix<f64>,
    r: DVector<f64>,
}

impl Own {
    /// What they are expected to be beside a gain and shared coefficients.
    fn expected(&self, gain: f64, shared: impl Iterator<Item = f64>) -> DVector<f64> {
        let rest = DVector::from_iterator(self.link.ncols(), std::iter::once(gain).chain(shared));
        self.precision.solve(&(&self.r - &self.link * rest))
    }
}

/// Integrates the own coefficients of a run, the one of index `at`.
pub(super) fn reduce(run: &Normal, at: usize, q: &Question, powers: &[f64], variance: f64) -> Reduced {
    let columns: Vec<(usize, usize, f64)> = q.shared(at).collect();
    let rest: Vec<usize> = std::iter::once(0).chain(columns.iter().map(|c| c.1)).collect();
    let scale: Vec<f64> = std::iter::once(1.0).chain(columns.iter().map(|c| c.2)).collect();
    let n = rest.len();
    let said = Said {
        g: DMatrix::from_fn(n, n, |i, j| run.g[(rest[i], rest[j])] * scale[i] * scale[j] / variance),
        b: DVector::from_fn(n, |i, _| run.b[rest[i]] * scale[i] / variance),
        shared: columns.iter().map(|c| c.0).collect(),
    };
    let k = q.own.len();
    let mut out = Reduced { yy: run.yy / variance, log_det: 0.0, freedom: 0.0, own: None, said };
    if k > 0 {
        let sd: Vec<f64> = q.own.iter().map(|o| powers[o.1].sqrt()).collect();
        let m = DMatrix::from_fn(k, k, |i, j| {
            run.g[(q.own[i].0, q.own[j].0)] * sd[i] * sd[j] / variance + f64::from(u8::from(i == j))
        });
        let link = DMatrix::from_fn(k, n, |i, j| run.g[(q.own[i].0, rest[j])] * sd[i] * scale[j] / variance);
        let r = DVector::from_fn(k, |i, _| run.b[q.own[i].0] * sd[i] / variance);
        if let Some(precision) = m.cholesky() {
            out.log_det = log_det(&precision);
            let z = precision.solve(&r);
            let inverse = precision.inverse();
            out.said.g -= link.tr_mul(&precision.solve(&link));
            out.said.b -= link.tr_mul(&z);
            out.yy -= r.dot(&z);
            out.freedom = k as f64 - inverse.trace();
            out.own = Some(Own { precision, inverse, link, r });
        }
    }
    out
}

/// Standard deviation of coefficients that may be as large as they like: whole speeds.
const AS_LARGE_AS_IT_LIKES: f64 = 1.0;

/// What more terms could bring at most to a question that was weighed: here what they take of the squared error costs nothing. It takes one round,
/// where weighing takes up to six.
pub struct Promise<'a> {
    equations: &'a Equations,
    covariance: DMatrix<f64>,
    asked: &'a Question,
    now: &'a Weighed,
    /// Squared error without effects, in rpm²·s.
    without: f64,
    /// What the question leaves, in units of the variance; none where it has no solution.
    before: Option<f64>,
}

impl<'a> Promise<'a> {
    /// Beside the question `asked`, weighed as `now`.
    pub fn new(equations: &'a Equations, level: &Level, asked: &'a Question, now: &'a Weighed, without: f64) -> Self {
        let mut all = Self { equations, covariance: level.covariance(&now.taus), asked, now, without, before: None };
        all.before = all.quadratic(asked);
        all
    }

    fn quadratic(&self, q: &Question) -> Option<f64> {
        let groups = q.own.iter().map(|o| o.1 + 1).max().unwrap_or(0);
        let mut powers = self.now.powers.clone();
        powers.resize(groups, AS_LARGE_AS_IT_LIKES * AS_LARGE_AS_IT_LIKES);
        let runs = self.equations.runs.iter().enumerate();
        let reduced: Vec<Reduced> = runs.map(|(i, run)| reduce(run, i, q, &powers, self.now.variance)).collect();
        let together = Together::new(reduced.iter().map(|r| &r.said), &vec![1.0; q.shared_count()]);
        join(&together, &self.covariance).map(|joint| reduced.iter().map(|r| r.yy).sum::<f64>() - joint.explained)
    }

    /// By how much the log evidence could rise at most, were it asked with the terms that `more` has besides.
    pub fn of(&self, more: &Question) -> f64 {
        let Self { equations, now, .. } = self;
        let mut wide = more.clone();
        wide.common[self.asked.common.len()..].iter_mut().for_each(|c| c.1 = AS_LARGE_AS_IT_LIKES);
        let (Some(before), Some(after)) = (self.before, self.quadratic(&wide)) else { return f64::INFINITY };
        let left = (now.left - (before - after) * now.variance).max(0.0);
        let shrunk = equations.error(left, self.without) / equations.error(now.left, self.without);
        // With the variance the quadratic form rises, and what is left is a part of it.
        let after = after.max(left / (now.variance * shrunk));
        0.5 * (before - after) - 0.5 * equations.independent * shrunk.ln()
    }
}

/// Integrates everything that is linear.
pub fn weigh(equations: &Equations, level: &Level, q: &Question, start: &Start) -> Option<Weighed> {
    let groups = q.own.iter().map(|o| o.1 + 1).max().unwrap_or(0);
    let sizes: Vec<f64> = (0..groups).map(|k| q.own.iter().filter(|o| o.1 == k).count() as f64).collect();
    let mut powers = vec![0.01; groups];
    let mut variance = start.variance;
    let independent = equations.independent;
    let mut taus = start.taus;
    let mut found = None;
    let mut common_freedom = None;
    let mut last = false;
    for round in 0..ROUNDS {
        last |= round + 1 == ROUNDS;
        let reduced: Vec<Reduced> =
            equations.runs.iter().enumerate().map(|(i, r)| reduce(r, i, q, &powers, variance)).collect();
        let together = Together::new(reduced.iter().map(|r| &r.said), &vec![1.0; q.shared_count()]);
        if start.spreads != Spreads::Stay && (round == 1 || last) {
            let likely =
                |c: &DMatrix<f64>| join(&together, c).map_or(f64::NEG_INFINITY, |j| 0.5 * (j.explained - j.log_det));
            let anywhere = start.spreads == Spreads::Anywhere && round == 1;
            taus = if anywhere { level.best_of_all(taus, &likely) } else { level.best(taus, &likely) };
        }
        let covariance = level.covariance(&taus);
        let joint = join(&together, &covariance)?;
        let (gains, from_none) = joint.gains();
        // What gains and common columns take hardly changes from round to round.
        let taken = *common_freedom.get_or_insert_with(|| joint.freedom());
        let freedom = reduced.iter().map(|r| r.freedom).sum::<f64>() + taken;
        let quadratic = reduced.iter().map(|r| r.yy).sum::<f64>() - joint.explained;
        let own = q.expected_own(&reduced, &gains, &joint.common, &powers);
        let prior = from_none + own.from_none;
        let left = (quadratic - prior).max(0.0) * variance;
        let log = -0.5 * independent * variance.ln()
            - 0.5 * quadratic
            - 0.5 * (joint.log_det + reduced.iter().map(|r| r.log_det).sum::<f64>())
            + level.log_prior(&taus);
        found = Some(Weighed {
            log,
            left,
            variance,
            taus,
            belief: level.log_priors(&taus),
            gains: gains.as_slice().to_vec(),
            shared: joint.common.as_slice().to_vec(),
            powers: powers.clone(),
        });
        if last {
            break;
        }
        let error = equations.error(left, start.without);
        let next = (error / (independent - freedom).max(0.25 * independent)).max(1e-12);
        let mut moved = (next / variance).ln().abs();
        variance = next;
        for (k, p) in powers.iter_mut().enumerate() {
            let next = (own.power[k] / (sizes[k] * reduced.len() as f64)).max(1e-9);
            moved = moved.max((next / *p).ln().abs());
            *p = next;
        }
        last = moved < SETTLED && round > 0;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Four runs whose speed, a line over time, is `per run` times 1 + `slope`·t off, with noise.
    fn equations(gain: f64, slope: f64) -> Equations {
        let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let designs: Vec<RunDesign> = (0..4)
            .map(|run| {
                let sign = if run % 2 == 0 { 1.0 } else { -1.0 };
                let t: Vec<f64> = (0..200).map(|k| f64::from(k) / 200.0).collect();
                let x = t.iter().flat_map(|t| [10.0, 10.0 * t, 10.0 * t * t]).collect();
                let y = t.iter().map(|t| sign * 10.0 * (gain + slope * t) + dice.random_range(-1.0..1.0)).collect();
                RunDesign { columns: 3, x, y, weight: vec![1.0; 200], seconds: 200.0 }
            })
            .collect();
        Equations::new(&designs, 0..0, &vec![Vec::new(); 4])
    }

    /// Every second run errs the other way. Fails if runs of one kind do not share a coefficient, or if those of others have it too.
    #[test]
    fn a_kind_takes_what_its_runs_have_in_common() {
        let level = Level::by_chance(4, 0.01);
        let left = |kinds: [usize; 4]| {
            let q = Question { by_kind: vec![(1, 1.0)], kinds: kinds.to_vec(), ..Default::default() };
            let start = Start { variance: 1.0, taus: level.believed(), without: 0.0, spreads: Spreads::Stay };
            weigh(&equations(0.0, 0.3), &level, &q, &start).expect("it can be solved").left
        };
        assert!(left([0, 1, 0, 1]) < 0.5 * left([0, 0, 1, 1]));
    }

    /// Every second run is 5 % faster, the others as much slower. Fails if a course of the runs' own, which looks much like that, takes what is a gain.
    #[test]
    fn what_is_a_gain_is_no_course_of_the_runs_own() {
        let level = Level::by_chance(4, 0.05);
        let start = Start { variance: 1.0, taus: level.believed(), without: 0.0, spreads: Spreads::Stay };
        let q = Question { own: vec![(1, 0)], ..Question::default() };
        let power =
            |gain, slope| weigh(&equations(gain, slope), &level, &q, &start).expect("it can be solved").powers[0];
        assert!(power(0.05, 0.0) < 0.1 * power(0.0, 0.05), "{} {}", power(0.05, 0.0), power(0.0, 0.05));
    }

    /// Fails if more is promised to chance than a term costs (10 nats), or less to a slope than it brings, shared or each run's own: it would be left
    /// out unweighed.
    #[test]
    fn what_is_promised_is_no_less_than_what_comes() {
        let level = Level::by_chance(4, 0.01);
        for (slope, own) in [(0.0, false), (0.0, true), (0.1, false), (0.3, false), (0.3, true)] {
            let equations = equations(0.0, slope);
            let start = Start { variance: 1.0, taus: level.believed(), without: 0.0, spreads: Spreads::Stay };
            let q = Question::default();
            let more = match own {
                true => Question { own: vec![(1, 0)], ..q.clone() },
                false => Question { common: vec![(1, 0.1)], ..q.clone() },
            };
            let [now, with] = [&q, &more].map(|q| weigh(&equations, &level, q, &start).expect("it can be solved"));
            let promised = Promise::new(&equations, &level, &q, &now, 0.0).of(&more);
            assert!(promised >= with.log - now.log, "{slope} {own}: {promised} for {}", with.log - now.log);
            assert!(slope > 0.0 || promised < 10.0, "chance: {promised}");
        }
    }

    /// Fails if a gain that differs between runs counts as a course of theirs, if chance does, or if a course is missed.
    #[test]
    fn a_course_is_neither_a_gain_nor_chance() {
        let share = |e: &Equations| {
            let [taken, before] = e.course(&[], 1..3, 800.0);
            taken / before
        };
        assert!(share(&equations(0.0, 0.0)).abs() < 0.01);
        assert!(share(&equations(0.5, 0.0)).abs() < 0.01);
        assert!(share(&equations(0.5, 0.3)) > 0.5);
    }
}
