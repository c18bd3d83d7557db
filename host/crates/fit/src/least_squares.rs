//! Gauss–Newton with priors, and intervals by profile likelihood.

use crate::descent::descend;
use crate::quantile::NORMAL_95;
use nalgebra::{DMatrix, DVector};

/// Steps at most: a search that is still moving then has lost its way.
const STEPS_AT_MOST: usize = 20;

/// Shares of a step that are tried: each four tenths of the one before.
const SHORTER: [f64; 5] = [1.0, 0.4, 0.4 * 0.4, 0.4 * 0.4 * 0.4, 0.4 * 0.4 * 0.4 * 0.4];

/// A point of the search.
#[derive(Debug, Clone)]
pub struct Point {
    /// The parameters.
    pub x: DVector<f64>,
    /// What the model makes of them.
    pub y: DVector<f64>,
    /// Its slopes, a column a parameter.
    pub jacobian: DMatrix<f64>,
    /// Factor by which the model misses the data beyond their scatter, at least 1.
    pub misfit: f64,
}

/// An end of an interval.
#[derive(Debug, Clone)]
pub struct End {
    /// The first parameter there.
    pub x0: f64,
    /// A better fit than the best one, if the way there met it.
    pub better: Option<DVector<f64>>,
}

/// A fit of parameters to data: the first is sought, the others stand beside it within what is known of them (a Gaussian around 0).
#[derive(Debug)]
pub struct Search<'a, P: Fn(&DVector<f64>) -> DVector<f64>> {
    /// What was measured.
    pub data: &'a [f64],
    /// Its scatter.
    pub sigma: &'a [f64],
    /// Standard deviations of the parameters after the first, before the data.
    pub priors: &'a [f64],
    /// Steps of the finite differences, one a parameter.
    pub steps: &'a [f64],
    /// The model.
    pub predict: &'a P,
}

impl<P: Fn(&DVector<f64>) -> DVector<f64>> Search<'_, P> {
    /// Squared distance from data and priors, the data's scatter widened by `misfit`.
    fn cost(&self, x: &DVector<f64>, y: &DVector<f64>, misfit: f64) -> f64 {
        let from_data: f64 =
            self.data.iter().zip(y.iter()).zip(self.sigma).map(|((d, y), s)| ((d - y) / (s * misfit)).powi(2)).sum();
        from_data + penalty(x, self.priors)
    }

    /// The normal matrix and the gradient at a point.
    pub fn normal_equations(&self, at: &Point) -> (DMatrix<f64>, DVector<f64>) {
        normal_equations(&at.jacobian, self.data, &at.y, self.sigma, &at.x, self.priors, at.misfit)
    }

    /// Gauss–Newton with the priors as further residuals; a step that does not help is shortened. `held` keeps the first parameter where it
    /// is, `misfit` is estimated on the way unless given.
    pub fn settle(&self, x: DVector<f64>, held: bool, misfit: Option<f64>) -> Point {
        let y = (self.predict)(&x);
        let around = |x: &DVector<f64>, y: &DVector<f64>| Point {
            misfit: misfit.unwrap_or_else(|| excess(self.data, y, self.sigma)),
            x: x.clone(),
            y: y.clone(),
            jacobian: self.slopes(x),
        };
        let mut last = None;
        let linearise = |(x, y): &(DVector<f64>, DVector<f64>)| {
            let at = around(x, y);
            let (mut normal, mut gradient) = self.normal_equations(&at);
            if held {
                normal.row_mut(0).fill(0.0);
                normal.column_mut(0).fill(0.0);
                (normal[(0, 0)], gradient[0]) = (1.0, 0.0);
            }
            let full = normal.cholesky().map(|c| c.solve(&gradient).map(|d| d.clamp(-0.5, 0.5)));
            let misfit = at.misfit;
            last = Some(at);
            ((full, misfit), self.cost(x, y, misfit))
        };
        let attempt =
            |(x, _): &(DVector<f64>, DVector<f64>), (full, misfit): &(Option<DVector<f64>>, f64), factor: f64| {
                let x = x + full.as_ref()? * factor;
                let y = (self.predict)(&x);
                let cost = self.cost(&x, &y, *misfit);
                Some(((x, y), cost))
            };
        let (x, y) =
            descend((x, y), STEPS_AT_MOST, &SHORTER, linearise, attempt, |before, after| before - after < 1e-3);
        // Where the last step gained next to nothing, the slopes before it are those after it.
        let last = last.unwrap_or_else(|| around(&x, &y));
        Point { x, y, ..last }
    }

    fn slopes(&self, x: &DVector<f64>) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> = (0..x.len())
            .map(|j| {
                let h = self.steps[j];
                let at = |h: f64| {
                    let mut x = x.clone();
                    x[j] += h;
                    (self.predict)(&x)
                };
                (at(h) - at(-h)) / (2.0 * h)
            })
            .collect();
        DMatrix::from_columns(&columns)
    }

    /// An end of the 95 % interval by profile likelihood (Venzon and Moolgavkar, Applied Statistics 37, 1988): where the best
    /// fit with the first parameter held costs 1.96² more than the best of all. The model bends too much for the covariance to say.
    pub fn end(&self, best: &Point, sense: f64) -> End {
        let (normal, _) = self.normal_equations(best);
        let covariance = normal.try_inverse().unwrap_or_else(|| DMatrix::identity(best.x.len(), best.x.len()));
        let along = covariance.column(0) / covariance[(0, 0)];
        let least = self.cost(&best.x, &best.y, best.misfit);
        let (mut inside, mut outside) = ((0.0, 0.0), None);
        let mut nearest = best.x.clone();
        let mut away = (NORMAL_95 * covariance[(0, 0)].sqrt()).clamp(1e-4, 1.0);
        for _ in 0..10 {
            // From the nearest point already settled, along the valley the best fit lies in.
            let shift = best.x[0] + sense * away - nearest[0];
            let there = self.settle(&nearest + &along * shift, true, Some(best.misfit));
            let more = self.cost(&there.x, &there.y, best.misfit) - least;
            if more < -0.05 {
                return End { x0: there.x[0], better: Some(there.x) };
            }
            let distance = more.max(0.0).sqrt();
            if (distance - NORMAL_95).abs() < 0.02 {
                inside = (away, distance);
                break;
            }
            if distance < NORMAL_95 {
                (inside, nearest) = ((away, distance), there.x);
            } else {
                outside = Some((away, distance));
            }
            away = match outside {
                None => away * (NORMAL_95 / distance.max(0.5)).clamp(1.1, 2.0),
                // Close to the straight line through both, and never stuck at either.
                Some((far, more)) => {
                    let share = (NORMAL_95 - inside.1) / (more - inside.1);
                    inside.0 + (far - inside.0) * share.clamp(0.15, 0.85)
                }
            };
            if away > 3.0 {
                break;
            }
        }
        End { x0: best.x[0] + sense * inside.0.max(if outside.is_none() { away.min(3.0) } else { 0.0 }), better: None }
    }
}

fn penalty(x: &DVector<f64>, priors: &[f64]) -> f64 {
    x.iter().skip(1).zip(priors).map(|(x, s)| (x / s).powi(2)).sum()
}

/// Residual over scatter, at least 1.
fn excess(data: &[f64], y: &DVector<f64>, sigma: &[f64]) -> f64 {
    let chi2: f64 = data.iter().zip(y.iter()).zip(sigma).map(|((d, y), s)| ((d - y) / s).powi(2)).sum();
    (chi2 / data.len().saturating_sub(1).max(1) as f64).sqrt().max(1.0)
}

fn normal_equations(
    jacobian: &DMatrix<f64>,
    data: &[f64],
    y: &DVector<f64>,
    sigma: &[f64],
    x: &DVector<f64>,
    priors: &[f64],
    misfit: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let scaled = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |i, j| jacobian[(i, j)] / (sigma[i] * misfit));
    let residual = DVector::from_fn(data.len(), |i, _| (data[i] - y[i]) / (sigma[i] * misfit));
    let mut normal = scaled.tr_mul(&scaled);
    let mut gradient = scaled.tr_mul(&residual);
    for (j, s) in priors.iter().enumerate() {
        normal[(j + 1, j + 1)] += 1.0 / (s * s);
        gradient[j + 1] -= x[j + 1] / (s * s);
    }
    (normal, gradient)
}
