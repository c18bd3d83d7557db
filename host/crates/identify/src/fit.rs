//! Weighted complex least squares of a circuit to a sweep, with intervals that hold when the weights are only roughly right.
//!
//! Each point's variance is noise plus a share proportional to |Y|². The noise comes from the measurement (sine fits) or
//! from third differences of the residual along frequency, which no smooth misfit reaches; the proportional share takes
//! up what the circuit cannot follow. So a sweep limited by noise is weighted by its noise, and one limited by the model is
//! weighted evenly in relative terms. The covariance is the sandwich estimator over points (real and imaginary part
//! together), with a Bartlett kernel when neighbouring residuals are correlated (Newey and West 1987).

use super::circuit::{Circuit, Layout};
use super::sweep::Sweep;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{Complex, DMatrix, DVector, Dyn, storage::Owned};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use twum_fit::quantile::student_95;

/// A fit this close (relative residual) knows |Y| better than the single points do.
const CLOSE: f64 = 0.1;
/// Residuals smaller than this share of |Y| count as none: a file's digits end somewhere.
const RELATIVE_FLOOR: f64 = 1e-6;

/// A fitted circuit.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Parameter layout.
    pub layout: Layout,
    /// Fitted parameters.
    pub parameters: DVector<f64>,
    /// Their covariance; `None` when the data do not determine all of them.
    pub covariance: Option<DMatrix<f64>>,
    /// Standard deviation of each component used as the weight of each point (S).
    pub sigma_s: Vec<f64>,
    /// Noise part of it (S).
    pub noise_s: Vec<f64>,
    /// Measured minus fitted admittance (S).
    pub residual_s: Vec<Complex<f64>>,
    /// √mean(|Y − Ŷ|²/|Y|²).
    pub residual_rel: f64,
    /// Are the residuals free of structure?
    pub residual_test: ResidualTest,
}

/// Ljung–Box test of the residuals along frequency.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ResidualTest {
    /// True when nothing beyond noise is left at the 1 % level.
    pub passed: bool,
    /// Probability of such a correlation in pure noise.
    pub p: f64,
    /// Correlation of neighbouring residuals.
    pub lag1: f64,
    /// Residual over the noise estimated from differences: 1 is noise alone.
    pub misfit_over_noise: f64,
}

impl Fit {
    /// The fitted circuit.
    pub fn circuit(&self) -> Circuit {
        self.layout.unpack(&self.parameters)
    }

    /// Degrees of freedom.
    pub fn freedom(&self) -> f64 {
        (2 * self.residual_s.len() - self.parameters.len()) as f64
    }

    /// Weighted sum of squared residuals, in units of the point variances.
    pub fn chi2(&self) -> f64 {
        weighted(&self.residual_s, &self.sigma_s)
    }

    /// Standard error of a function of the circuit, by first-order propagation.
    pub fn standard_error(&self, of: impl Fn(&Circuit) -> f64) -> Option<f64> {
        let covariance = self.covariance.as_ref()?;
        let gradient = DVector::from_fn(self.parameters.len(), |j, _| {
            let h = 1e-6;
            let at = |h: f64| {
                let mut p = self.parameters.clone();
                p[j] += h;
                of(&self.layout.unpack(&p))
            };
            (at(h) - at(-h)) / (2.0 * h)
        });
        let variance = gradient.dot(&(covariance * &gradient));
        (variance.is_finite() && variance >= 0.0).then(|| variance.sqrt())
    }

    /// 95 % interval of a positive quantity, on the logarithmic scale; `extra` is a further relative standard
    /// uncertainty that the sweep cannot see (shunt, force factor).
    pub fn interval(&self, extra: f64, of: impl Fn(&Circuit) -> f64) -> Option<[f64; 2]> {
        let value = of(&self.circuit());
        let se = self.standard_error(|c| of(c).ln())?.hypot(extra);
        let t = student_95(self.freedom());
        Some([value * (-t * se).exp(), value * (t * se).exp()])
    }
}

fn weighted(residual: &[Complex<f64>], sigma: &[f64]) -> f64 {
    residual.iter().zip(sigma).map(|(r, s)| r.norm_sqr() / (s * s)).sum()
}

struct Problem<'a> {
    layout: Layout,
    frequency_hz: &'a [f64],
    admittance_s: &'a [Complex<f64>],
    sigma_s: &'a [f64],
    parameters: DVector<f64>,
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.parameters.copy_from(x);
    }

    fn params(&self) -> DVector<f64> {
        self.parameters.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let circuit = self.layout.unpack(&self.parameters);
        let mut out = DVector::zeros(2 * self.frequency_hz.len());
        for (i, ((&f, y), s)) in self.frequency_hz.iter().zip(self.admittance_s).zip(self.sigma_s).enumerate() {
            let e = (circuit.admittance(f) - y) / *s;
            if !(e.re.is_finite() && e.im.is_finite()) {
                return None;
            }
            out[2 * i] = e.re;
            out[2 * i + 1] = e.im;
        }
        Some(out)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let jacobian = self.layout.jacobian(&self.layout.unpack(&self.parameters), self.frequency_hz, self.sigma_s);
        jacobian.iter().all(|x| x.is_finite()).then_some(jacobian)
    }
}

/// Minimises the weighted residual from `start`, the weights held.
pub fn minimise(
    layout: Layout,
    frequency_hz: &[f64],
    admittance_s: &[Complex<f64>],
    sigma_s: &[f64],
    start: &Circuit,
) -> Option<Circuit> {
    let problem = Problem { layout, frequency_hz, admittance_s, sigma_s, parameters: layout.pack(start) };
    let (problem, report) =
        LevenbergMarquardt::new().with_ftol(1e-10).with_xtol(1e-9).with_patience(10).minimize(problem);
    report.objective_function.is_finite().then(|| layout.unpack(&problem.parameters))
}

/// Variance of the noise in each component of the admittance (S²), from third differences of the residual: the sum of
/// non-negative multiples of 1, |Y|² and |Y|⁴ (noise in the admittance, in proportion, in the impedance).
fn noise_from_differences(admittance: &[Complex<f64>], residual: &[Complex<f64>]) -> Vec<f64> {
    let scale = admittance.iter().map(|y| y.norm_sqr()).sum::<f64>() / admittance.len() as f64;
    let rows: Vec<([f64; 3], f64)> = (0..residual.len().saturating_sub(3))
        .map(|i| {
            let d = residual[i] - residual[i + 1] * 3.0 + residual[i + 2] * 3.0 - residual[i + 3];
            let weights = [1.0, 9.0, 9.0, 1.0];
            let mean = |power: i32| {
                (0..4).map(|k| weights[k] * (admittance[i + k].norm_sqr() / scale).powi(power)).sum::<f64>() / 20.0
            };
            ([1.0, mean(1), mean(2)], d.norm_sqr() / 40.0)
        })
        .collect();
    let value = |c: &[f64; 3], x: &[f64; 3]| c[0] * x[0] + c[1] * x[1] + c[2] * x[2];
    let start = rows.iter().map(|r| r.1).sum::<f64>() / rows.len().max(1) as f64;
    let mut best = [start, 0.0, 0.0];
    for _ in 0..3 {
        // A squared Gaussian's spread is in proportion to its mean: weight by the last estimate.
        let current = best;
        let mut lowest = f64::INFINITY;
        for subset in 1..8_usize {
            let columns: Vec<usize> = (0..3).filter(|j| subset & (1 << j) != 0).collect();
            let k = columns.len();
            let mut normal = DMatrix::<f64>::zeros(k, k);
            let mut right = DVector::<f64>::zeros(k);
            for (x, v) in &rows {
                let w = 1.0 / value(&current, x).max(f64::MIN_POSITIVE).powi(2);
                for a in 0..k {
                    right[a] += w * x[columns[a]] * v;
                    for b in 0..k {
                        normal[(a, b)] += w * x[columns[a]] * x[columns[b]];
                    }
                }
            }
            let Some(solution) = normal.cholesky().map(|c| c.solve(&right)) else { continue };
            if solution.iter().any(|&c| c < 0.0 || !c.is_finite()) {
                continue;
            }
            let mut candidate = [0.0; 3];
            columns.iter().zip(solution.iter()).for_each(|(&j, &c)| candidate[j] = c);
            let cost = rows
                .iter()
                .map(|(x, v)| {
                    let m = value(&candidate, x);
                    ((v - m) / value(&current, x).max(f64::MIN_POSITIVE)).powi(2)
                })
                .sum::<f64>();
            if cost < lowest {
                lowest = cost;
                best = candidate;
            }
        }
    }
    admittance
        .iter()
        .map(|y| {
            let x = y.norm_sqr() / scale;
            value(&best, &[1.0, x, x * x])
        })
        .collect()
}

/// Point standard deviations: (total, noise part), for an admittance of the given size.
fn point_sigma(
    sweep: &Sweep,
    admittance: &[Complex<f64>],
    residual: &[Complex<f64>],
    parameters: usize,
) -> (Vec<f64>, Vec<f64>) {
    let known: Option<Vec<f64>> = sweep.points.iter().map(|p| p.sigma_s.map(|s| s * s)).collect();
    let noise: Vec<f64> = known
        .unwrap_or_else(|| noise_from_differences(admittance, residual))
        .iter()
        .zip(admittance)
        .map(|(v, y)| v.max(y.norm_sqr() * RELATIVE_FLOOR * RELATIVE_FLOOR))
        .collect();
    let freedom = (2 * residual.len()).saturating_sub(parameters).max(1) as f64;
    let chi2 = |share: f64| {
        residual
            .iter()
            .zip(&noise)
            .zip(admittance)
            .map(|((r, v), y)| r.norm_sqr() / (v + share * y.norm_sqr()))
            .sum::<f64>()
    };
    let mut share = 0.0;
    if chi2(0.0) > freedom {
        let (mut low, mut high) = (1e-16_f64, 1e4_f64);
        for _ in 0..60 {
            let middle = (low * high).sqrt();
            if chi2(middle) > freedom { low = middle } else { high = middle }
        }
        share = high;
    }
    let total = noise.iter().zip(admittance).map(|(v, y)| (v + share * y.norm_sqr()).sqrt()).collect();
    (total, noise.iter().map(|v| v.sqrt()).collect())
}

/// Autocorrelation of the weighted residuals along frequency at lags 1 to `lags`.
fn autocorrelation(residual: &[Complex<f64>], sigma: &[f64], lags: usize) -> Vec<f64> {
    let z: Vec<Complex<f64>> = residual.iter().zip(sigma).map(|(r, s)| r / *s).collect();
    let power: f64 = z.iter().map(|z| z.norm_sqr()).sum();
    (1..=lags)
        .map(|lag| z.iter().zip(&z[lag.min(z.len())..]).map(|(a, b)| (a * b.conj()).re).sum::<f64>() / power)
        .collect()
}

fn residual_test(residual: &[Complex<f64>], sigma: &[f64], noise: &[f64]) -> ResidualTest {
    let n = 2.0 * residual.len() as f64;
    let lags = 10.min(residual.len() / 4).max(1);
    let rho = autocorrelation(residual, sigma, lags);
    let statistic: f64 =
        rho.iter().enumerate().map(|(k, r)| n * (n + 2.0) * r * r / (n - 2.0 * (k as f64 + 1.0))).sum();
    let p = ChiSquared::new(lags as f64).map_or(f64::NAN, |d| 1.0 - d.cdf(statistic));
    let misfit_over_noise = (weighted(residual, noise) / n).sqrt();
    // Residuals far below the noise are the digits' end, whatever their pattern.
    ResidualTest { passed: p > 0.01 || misfit_over_noise < 0.1, p, lag1: rho[0], misfit_over_noise }
}

fn sandwich(
    jacobian: &DMatrix<f64>,
    residual: &[Complex<f64>],
    sigma: &[f64],
    test: &ResidualTest,
) -> Option<DMatrix<f64>> {
    let (n, p) = (residual.len(), jacobian.ncols());
    let bread = jacobian.tr_mul(jacobian).cholesky()?.inverse();
    let scores: Vec<DVector<f64>> = (0..n)
        .map(|i| {
            let e = residual[i] / sigma[i];
            jacobian.row(2 * i).transpose() * e.re + jacobian.row(2 * i + 1).transpose() * e.im
        })
        .collect();
    // Correlated residuals: a kernel reaching past the lag where the correlation has died out.
    let reach = if test.passed {
        0
    } else {
        let longest = (n / 4).max(1);
        let rho = autocorrelation(residual, sigma, longest);
        (2 * (1 + rho.iter().position(|r| *r < 0.1).unwrap_or(longest))).min(longest)
    };
    let mut meat = DMatrix::zeros(p, p);
    for (i, g) in scores.iter().enumerate() {
        meat.ger(1.0, g, g, 1.0);
        for lag in 1..=reach.min(n - 1 - i) {
            let w = 1.0 - lag as f64 / (reach + 1) as f64;
            let h = &scores[i + lag];
            meat.ger(w, g, h, 1.0);
            meat.ger(w, h, g, 1.0);
        }
    }
    let small_sample = 2.0 * n as f64 / (2.0 * n as f64 - p as f64);
    Some(&bread * meat * &bread * small_sample)
}

/// Fits a circuit to a sweep from a starting circuit, weights and covariance included. `None` when it does not converge.
pub fn fit(sweep: &Sweep, layout: Layout, start: &Circuit) -> Option<Fit> {
    let f = sweep.frequencies();
    let y = sweep.admittances();
    let residual = |c: &Circuit| -> Vec<Complex<f64>> { f.iter().zip(&y).map(|(&f, y)| y - c.admittance(f)).collect() };
    let relative: Vec<f64> = y.iter().map(|y| y.norm()).collect();
    let mut circuit = minimise(layout, &f, &y, &relative, start)?;
    let parameters = layout.pack(&circuit).len();
    let mut sigma = relative.clone();
    let mut noise = relative.clone();
    for _ in 0..3 {
        let left = residual(&circuit);
        // A point whose noise made |Y| small would otherwise weigh more: all of Y would come out smaller by twice the noise's
        // variance.
        let close = (weighted(&left, &relative) / f.len() as f64).sqrt() < CLOSE;
        let size: Vec<Complex<f64>> =
            if close { f.iter().map(|&f| circuit.admittance(f)).collect() } else { y.clone() };
        (sigma, noise) = point_sigma(sweep, &size, &left, parameters);
        circuit = minimise(layout, &f, &y, &sigma, &circuit)?;
    }
    let residual_s = residual(&circuit);
    let n = f.len() as f64;
    let residual_rel = (weighted(&residual_s, &relative) / n).sqrt();
    let test = residual_test(&residual_s, &sigma, &noise);
    let covariance = sandwich(&layout.jacobian(&circuit, &f, &sigma), &residual_s, &sigma, &test);
    Some(Fit {
        layout,
        parameters: layout.pack(&circuit),
        covariance,
        sigma_s: sigma,
        noise_s: noise,
        residual_s,
        residual_rel,
        residual_test: test,
    })
}
