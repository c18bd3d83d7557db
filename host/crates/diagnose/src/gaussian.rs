//! The gains of all runs and the coefficients that runs share, integrated as one Gaussian.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// What one run says, in units of the residuals' variance and of the priors' standard deviations.
pub(super) struct Said {
    /// Precision that the data give to the run's gain, which is the first, and to the shared coefficients that it has.
    pub g: DMatrix<f64>,
    /// The same times what they would be by these data alone.
    pub b: DVector<f64>,
    /// Which of all shared coefficients these are.
    pub shared: Vec<usize>,
}

impl Said {
    /// Of a gain alone, with this precision and that times what it would be.
    pub(super) fn of_a_gain(precision: f64, b: f64) -> Self {
        Self { g: DMatrix::from_element(1, 1, precision), b: DVector::from_element(1, b), shared: Vec::new() }
    }
}

/// What the runs say together, whatever the covariance of their gains: of the gains the diagonal D, of the gains and the shared coefficients H.
pub(super) struct Together {
    /// √D.
    root: Vec<f64>,
    /// The first column is what the runs say of their gains, the others are H.
    said: DMatrix<f64>,
    /// Precision of the shared coefficients, the priors' in it.
    g: DMatrix<f64>,
    b: DVector<f64>,
}

impl Together {
    /// Of runs that share coefficients, which their priors give this `precision`.
    pub(super) fn new<'a>(runs: impl ExactSizeIterator<Item = &'a Said>, precision: &[f64]) -> Self {
        let shared = precision.len();
        let mut all = Self {
            root: Vec::with_capacity(runs.len()),
            said: DMatrix::zeros(runs.len(), 1 + shared),
            g: DMatrix::from_diagonal(&DVector::from_column_slice(precision)),
            b: DVector::zeros(shared),
        };
        for (i, run) in runs.enumerate() {
            all.root.push(run.g[(0, 0)].max(0.0).sqrt());
            all.said[(i, 0)] = run.b[0];
            for (j, to) in run.shared.iter().enumerate() {
                all.said[(i, 1 + to)] = run.g[(0, 1 + j)];
                all.b[*to] += run.b[1 + j];
                for (k, from) in run.shared.iter().enumerate() {
                    all.g[(*to, *from)] += run.g[(1 + j, 1 + k)];
                }
            }
        }
        all
    }

    /// √D·`x`.
    fn scaled(&self, mut x: DMatrix<f64>) -> DMatrix<f64> {
        for (mut row, root) in x.row_iter_mut().zip(&self.root) {
            row *= *root;
        }
        x
    }
}

/// What the runs say of the shared coefficients with the gains, of covariance C, integrated. It is worked out from M = 1 + √D·C·√D = L·Lᵀ, for a
/// decomposition of C itself costs as much again: the gains have the covariance V = (C⁻¹ + D)⁻¹ = C − C·√D·M⁻¹·√D·C with the data (Woodbury).
pub(super) struct BesideGains<'a> {
    together: &'a Together,
    covariance: &'a DMatrix<f64>,
    /// Precision of the shared coefficients, the priors' in it.
    pub g: DMatrix<f64>,
    /// The same times what they would be.
    pub b: DVector<f64>,
    /// What the gains explain of the squared error where nothing is shared, in units of the variance.
    pub explained: f64,
    of_gains: Cholesky<f64, Dyn>,
    /// L⁻¹·√D·C times what the runs say.
    half: DMatrix<f64>,
}

/// Integrates gains of this covariance; none where it cannot be decomposed.
pub(super) fn beside_gains<'a>(together: &'a Together, covariance: &'a DMatrix<f64>) -> Option<BesideGains<'a>> {
    let Together { root, said, g, b } = together;
    let (r, shared) = (root.len(), b.len());
    let m = DMatrix::from_fn(r, r, |i, j| root[i] * covariance[(i, j)] * root[j] + f64::from(u8::from(i == j)));
    let of_gains = m.cholesky()?;
    let through_prior = covariance * said;
    let half = of_gains.l_dirty().solve_lower_triangular(&together.scaled(through_prior.clone()))?;
    // What the runs say of their gains and H, both sides of V.
    let around = said.transpose() * &through_prior - half.transpose() * &half;
    Some(BesideGains {
        together,
        covariance,
        g: g - around.view((1, 1), (shared, shared)),
        b: b - around.view((1, 0), (shared, 1)),
        explained: around[(0, 0)],
        of_gains,
        half,
    })
}

impl BesideGains<'_> {
    /// C⁻¹·V times what the runs say, combined by `weights`.
    fn pulled(&self, weights: &DMatrix<f64>) -> DMatrix<f64> {
        let mut back = &self.half * weights;
        self.of_gains.l_dirty().tr_solve_lower_triangular_mut(&mut back);
        &self.together.said * weights - self.together.scaled(back)
    }

    /// Expected gains beside these shared coefficients, and how far gains and coefficients are from none, squared and in units of their priors.
    pub fn gains(&self, shared: &DVector<f64>) -> (DVector<f64>, f64) {
        let beside = shared.map(|c| -c).insert_row(0, 1.0);
        let pulled = self.pulled(&DMatrix::from_column_slice(beside.len(), 1, beside.as_slice()));
        let gains = (self.covariance * &pulled).column(0).into_owned();
        let from_none = gains.dot(&pulled.column(0)) + shared.dot(shared);
        (gains, from_none)
    }
}

/// The gains of all runs and the shared coefficients as one Gaussian.
pub(super) struct Joint<'a> {
    beside: BesideGains<'a>,
    /// Log determinant of prior times precision.
    pub log_det: f64,
    /// What the expected values explain of the squared error, in units of the variance.
    pub explained: f64,
    /// Expected shared coefficients.
    pub common: DVector<f64>,
    of_common: Cholesky<f64, Dyn>,
}

/// Of a covariance of the gains; none where it cannot be decomposed.
pub(super) fn join<'a>(together: &'a Together, covariance: &'a DMatrix<f64>) -> Option<Joint<'a>> {
    let beside = beside_gains(together, covariance)?;
    let of_common = beside.g.clone().cholesky()?;
    let common = of_common.solve(&beside.b);
    Some(Joint {
        log_det: log_det(&beside.of_gains) + log_det(&of_common),
        explained: beside.explained + beside.b.dot(&common),
        common,
        of_common,
        beside,
    })
}

impl Joint<'_> {
    /// Expected gains, and how far gains and shared coefficients are from none, squared and in units of their priors.
    pub fn gains(&self) -> (DVector<f64>, f64) {
        self.beside.gains(&self.common)
    }

    /// How many numbers the data fix: one for each gain and column that the priors say nothing of beside them.
    pub fn freedom(&self) -> f64 {
        let BesideGains { together, covariance, of_gains, .. } = &self.beside;
        let (runs, shared) = (together.root.len(), self.common.len());
        let of_h = DMatrix::from_fn(1 + shared, shared, |i, j| f64::from(u8::from(i == j + 1)));
        let pulled = self.beside.pulled(&of_h);
        let spread = *covariance * &pulled;
        let through_common = self.of_common.solve(&spread.tr_mul(&pulled)).trace();
        (runs + shared) as f64 - of_gains.inverse().trace() - self.of_common.inverse().trace() - through_common
    }
}

/// Log determinant of what was decomposed.
pub(super) fn log_det(chol: &Cholesky<f64, Dyn>) -> f64 {
    2.0 * chol.l_dirty().diagonal().iter().map(|d| d.max(1e-300).ln()).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Fails if runs take what others share, or if what is worked out without a decomposition of the covariance is not what the whole precision says.
    #[test]
    fn gains_and_shared_coefficients_are_one_gaussian() {
        let (r, shared) = (4, 3);
        let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut any =
            |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| dice.random_range(-1.0..1.0));
        // One coefficient of all runs, and one of every second run.
        let runs: Vec<Said> = (0..r)
            .map(|run| {
                let x = any(9, 3) * 3.0;
                let (g, b) = (x.tr_mul(&x), any(3, 1).column(0).into_owned());
                Said { g, b, shared: vec![0, 1 + run % 2] }
            })
            .collect();
        let root = any(r, r) * 0.3;
        let covariance = &root * root.transpose();
        let together = Together::new(runs.iter(), &vec![1.0; shared]);
        let joint = join(&together, &covariance).expect("it can be solved");
        let (gains, from_none) = joint.gains();

        let n = r + shared;
        let mut precision = DMatrix::zeros(n, n);
        let mut b = DVector::zeros(n);
        for (i, run) in runs.iter().enumerate() {
            // The run's gain and its coefficients among all of them.
            let at: Vec<usize> = std::iter::once(i).chain(run.shared.iter().map(|k| r + k)).collect();
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
        let found = [joint.log_det, joint.explained, from_none, joint.freedom()];
        let direct = [
            -relative.determinant().ln(),
            b.dot(&expected),
            expected.dot(&(&prior * &expected)),
            n as f64 - relative.trace(),
        ];
        for (a, b) in found.into_iter().zip(direct) {
            assert!((a - b).abs() < 1e-6 * b.abs(), "{found:?} {direct:?}");
        }
        for (a, b) in gains.iter().chain(joint.common.iter()).zip(expected.iter()) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
