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
const MODEL_FLOOR: f64 = 0.005;
/// Rounds of expectation–maximisation of noise and powers.
const ROUNDS: usize = 6;

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

    /// The coefficients that all runs share and those of each kind: their columns in run `run`, where it has one, and standard deviations.
    fn shared(&self, run: usize) -> impl Iterator<Item = (Option<usize>, f64)> {
        let kind = self.kinds.get(run).copied();
        let of_kind = move |k| self.by_kind.iter().map(move |c| ((kind == Some(k)).then_some(c.0), c.1));
        self.common.iter().map(|c| (Some(c.0), c.1)).chain((0..self.kind_count()).flat_map(of_kind))
    }

    fn kind_count(&self) -> usize {
        self.kinds.iter().max().map_or(0, |k| k + 1)
    }

    /// How many coefficients runs share.
    fn shared_count(&self) -> usize {
        self.common.len() + self.kind_count() * self.by_kind.len()
    }
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
    /// Expected coefficient of each common column.
    pub common: Vec<f64>,
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

struct Reduced {
    g: DMatrix<f64>,
    b: DVector<f64>,
    yy: f64,
    log_det: f64,
    freedom: f64,
    own_quadratic: f64,
    power: Vec<f64>,
}

/// Integrates the own coefficients of a run, the one of index `at`.
fn reduce(run: &Normal, at: usize, q: &Question, powers: &[f64], variance: f64) -> Reduced {
    let (rest, scale): (Vec<Option<usize>>, Vec<f64>) = std::iter::once((Some(0), 1.0)).chain(q.shared(at)).unzip();
    let n = rest.len();
    let both = |i: usize, j: usize| rest[i].zip(rest[j]).map_or(0.0, |columns| run.g[columns]);
    let mut g = DMatrix::from_fn(n, n, |i, j| both(i, j) * scale[i] * scale[j] / variance);
    let mut b = DVector::from_fn(n, |i, _| rest[i].map_or(0.0, |c| run.b[c]) * scale[i] / variance);
    let k = q.own.len();
    let mut out = Reduced {
        yy: run.yy / variance,
        log_det: 0.0,
        freedom: 0.0,
        own_quadratic: 0.0,
        power: vec![0.0; powers.len()],
        g: DMatrix::zeros(0, 0),
        b: DVector::zeros(0),
    };
    if k > 0 {
        let sd: Vec<f64> = q.own.iter().map(|o| powers[o.1].sqrt()).collect();
        let m = DMatrix::from_fn(k, k, |i, j| {
            run.g[(q.own[i].0, q.own[j].0)] * sd[i] * sd[j] / variance + f64::from(u8::from(i == j))
        });
        let link = DMatrix::from_fn(k, n, |i, j| {
            rest[j].map_or(0.0, |c| run.g[(q.own[i].0, c)]) * sd[i] * scale[j] / variance
        });
        let r = DVector::from_fn(k, |i, _| run.b[q.own[i].0] * sd[i] / variance);
        if let Some(chol) = m.cholesky() {
            out.log_det = log_det(&chol);
            let z = chol.solve(&r);
            let inverse = chol.inverse();
            g -= link.tr_mul(&chol.solve(&link));
            b -= link.tr_mul(&z);
            out.yy -= r.dot(&z);
            for (i, o) in q.own.iter().enumerate() {
                out.power[o.1] += (z[i] * z[i] + inverse[(i, i)]) * sd[i] * sd[i];
                out.freedom += 1.0 - inverse[(i, i)];
            }
            out.own_quadratic = z.dot(&z);
        }
    }
    out.g = g;
    out.b = b;
    out
}

fn log_det(chol: &Cholesky<f64, Dyn>) -> f64 {
    2.0 * chol.l_dirty().diagonal().iter().map(|d| d.max(1e-300).ln()).sum::<f64>()
}

/// The gains of all runs and the common coefficients as one Gaussian: the gains with covariance C, what the runs say of them the diagonal D
/// and, with the common columns, H. It is worked out from M = 1 + √D·C·√D, for a decomposition of C itself costs as much again.
struct Joint {
    /// Log determinant of prior times precision.
    log_det: f64,
    /// What the expected values explain of the squared error, in units of the variance.
    explained: f64,
    /// Squared distance of the expected values from none, in units of their priors.
    from_none: f64,
    gains: DVector<f64>,
    common: DVector<f64>,
    of_gains: Cholesky<f64, Dyn>,
    of_common: Cholesky<f64, Dyn>,
    /// V·H and C⁻¹·V·H, V = (C⁻¹ + D)⁻¹ the covariance that the gains have with the data.
    links: [DMatrix<f64>; 2],
}

fn join(runs: &[Reduced], covariance: &DMatrix<f64>, commons: usize) -> Option<Joint> {
    let r = runs.len();
    let root: Vec<f64> = runs.iter().map(|run| run.g[(0, 0)].max(0.0).sqrt()).collect();
    let m = DMatrix::from_fn(r, r, |i, j| root[i] * covariance[(i, j)] * root[j] + f64::from(u8::from(i == j)));
    let of_gains = m.cholesky()?;
    let scaled = |mut x: DMatrix<f64>| {
        for (mut row, root) in x.row_iter_mut().zip(&root) {
            row *= *root;
        }
        x
    };
    // The first column is what the runs say of their gains, the others are H.
    let said = DMatrix::from_fn(r, 1 + commons, |i, j| if j == 0 { runs[i].b[0] } else { runs[i].g[(0, j)] });
    // C⁻¹·V = 1 − √D·M⁻¹·√D·C (Woodbury).
    let pulled = &said - scaled(of_gains.solve(&scaled(covariance * &said)));
    let spread = covariance * &pulled;
    let links = [&spread, &pulled].map(|x| x.columns(1, commons).clone_owned());
    let h = said.columns(1, commons);
    let mut a = DMatrix::identity(commons, commons) - h.tr_mul(&links[0]);
    let mut b = -h.tr_mul(&spread.column(0));
    for run in runs {
        a += run.g.view((1, 1), (commons, commons));
        b += run.b.rows(1, commons);
    }
    let of_common = a.cholesky()?;
    let common = of_common.solve(&b);
    let gains = spread.column(0) - &links[0] * &common;
    let from_none = gains.dot(&(pulled.column(0) - &links[1] * &common)) + common.dot(&common);
    Some(Joint {
        log_det: log_det(&of_gains) + log_det(&of_common),
        explained: said.column(0).dot(&spread.column(0)) + b.dot(&common),
        from_none,
        gains,
        common,
        of_gains,
        of_common,
        links,
    })
}

impl Joint {
    /// How many numbers the data fix: one for each gain and column that the priors say nothing of beside them.
    fn freedom(&self) -> f64 {
        let dimension = (self.gains.len() + self.common.len()) as f64;
        let through_common = self.of_common.solve(&self.links[0].tr_mul(&self.links[1])).trace();
        dimension - self.of_gains.inverse().trace() - self.of_common.inverse().trace() - through_common
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
    for round in 0..ROUNDS {
        let reduced: Vec<Reduced> =
            equations.runs.iter().enumerate().map(|(i, r)| reduce(r, i, q, &powers, variance)).collect();
        if start.spreads != Spreads::Stay && (round == 1 || round + 1 == ROUNDS) {
            let likely = |c: &DMatrix<f64>| {
                join(&reduced, c, q.shared_count()).map_or(f64::NEG_INFINITY, |j| 0.5 * (j.explained - j.log_det))
            };
            let anywhere = start.spreads == Spreads::Anywhere && round == 1;
            taus = if anywhere { level.best_of_all(taus, &likely) } else { level.best(taus, &likely) };
        }
        let joint = join(&reduced, &level.covariance(&taus), q.shared_count())?;
        // What gains and common columns take hardly changes from round to round.
        let taken = *common_freedom.get_or_insert_with(|| joint.freedom());
        let freedom = reduced.iter().map(|r| r.freedom).sum::<f64>() + taken;
        let quadratic = reduced.iter().map(|r| r.yy).sum::<f64>() - joint.explained;
        let prior = joint.from_none + reduced.iter().map(|r| r.own_quadratic).sum::<f64>();
        let left = (quadratic - prior).max(0.0) * variance;
        let log = -0.5 * independent * variance.ln()
            - 0.5 * quadratic
            - 0.5 * (joint.log_det + reduced.iter().map(|r| r.log_det).sum::<f64>())
            + level.log_prior(&taus);
        let commons = q.common.iter().zip(joint.common.iter()).map(|(c, x)| c.1 * x).collect();
        found = Some(Weighed {
            log,
            left,
            variance,
            taus,
            belief: level.log_priors(&taus),
            gains: joint.gains.as_slice().to_vec(),
            common: commons,
            powers: powers.clone(),
        });
        for (k, p) in powers.iter_mut().enumerate() {
            let sum: f64 = reduced.iter().map(|r| r.power[k]).sum();
            *p = (sum / (sizes[k] * reduced.len() as f64)).max(1e-9);
        }
        let error = (1.0 - FORM_ERROR) * left + FORM_ERROR * start.without.max(left) + equations.floor();
        let next = error / (independent - freedom).max(0.25 * independent);
        let next = next.max(1e-12);
        if round + 1 < ROUNDS {
            variance = next;
        }
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

    /// Fails if what is worked out without a decomposition of the covariance is not what the whole precision says.
    #[test]
    fn gains_and_common_columns_are_one_gaussian() {
        let (r, commons) = (4, 2);
        let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut any =
            |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| dice.random_range(-1.0..1.0));
        let runs: Vec<Reduced> = (0..r)
            .map(|_| {
                let x = any(9, 1 + commons) * 3.0;
                let (g, b) = (x.tr_mul(&x), any(1 + commons, 1).column(0).into_owned());
                let power = Vec::new();
                Reduced { g, b, yy: 1.0, log_det: 0.0, freedom: 0.0, own_quadratic: 0.0, power }
            })
            .collect();
        let root = any(r, r) * 0.3;
        let covariance = &root * root.transpose();
        let joint = join(&runs, &covariance, commons).expect("it can be solved");

        let n = r + commons;
        let mut precision = DMatrix::zeros(n, n);
        let mut b = DVector::zeros(n);
        for (i, run) in runs.iter().enumerate() {
            // The run's gain and the common coefficients among all of them.
            let at: Vec<usize> = std::iter::once(i).chain(r..n).collect();
            for (j, to) in at.iter().enumerate() {
                b[*to] += run.b[j];
                for (k, from) in at.iter().enumerate() {
                    precision[(*to, *from)] += run.g[(j, k)];
                }
            }
        }
        let mut prior = DMatrix::identity(n, n);
        prior.view_mut((0, 0), (r, r)).copy_from(&covariance);
        let prior = prior.try_inverse().expect("it has full rank");
        let posterior = (&prior + &precision).try_inverse().expect("it has full rank");
        let expected = &posterior * &b;
        let relative = &posterior * &prior;
        let found = [joint.log_det, joint.explained, joint.from_none, joint.freedom()];
        let direct = [
            -relative.determinant().ln(),
            b.dot(&expected),
            expected.dot(&(&prior * &expected)),
            n as f64 - relative.trace(),
        ];
        for (a, b) in found.into_iter().zip(direct) {
            assert!((a - b).abs() < 1e-6 * b.abs(), "{found:?} {direct:?}");
        }
        for (a, b) in joint.gains.iter().chain(joint.common.iter()).zip(expected.iter()) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
