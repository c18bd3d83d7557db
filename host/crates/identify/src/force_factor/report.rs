//! What the fit found, told.

use super::model::{RIVALS, stall, with};
use super::observe::Observed;
use super::{Report, RunResult, Trade};
use nalgebra::DMatrix;
use twum_fit::least_squares::Point;
use twum_fit::quantile::NORMAL_95;
use twum_motor::motor::Motor;
use twum_motor::parameters::{Flavour, Parameters};
use twum_record::measurement::Measurement;

/// What went into the fit and came out of it.
pub(super) struct Fitted<'a> {
    /// Parameters of the motor file.
    pub base: Parameters,
    /// What the runs said.
    pub observed: &'a [Observed],
    /// Stall torques measured (N·m).
    pub stall_nm: &'a [f64],
    /// Scatter of the data.
    pub sigma: &'a [f64],
    /// Standard deviations of the rivals' logarithms before the data.
    pub priors: &'a [f64],
    /// The best point.
    pub best: &'a Point,
    /// Covariance there.
    pub covariance: &'a DMatrix<f64>,
}

/// By how far what is not known of the parameter moves η.
fn reach(trade: &Trade) -> f64 {
    (trade.exchange * trade.prior_relative).abs()
}

impl Fitted<'_> {
    /// The answer; `ends` are those of the interval of ln η over the motor file's, `alone` the standard deviation were every other
    /// parameter exact.
    pub(super) fn report(
        &self,
        measurement: &Measurement,
        motor: &Motor,
        flavour: Flavour,
        ends: [f64; 2],
        alone: f64,
    ) -> Report {
        let Self { base, observed, best, .. } = self;
        let eta = base.force_factor_n_v * best.x[0].exp();
        let around = |sd: f64| [eta * (-NORMAL_95 * sd).exp(), eta * (NORMAL_95 * sd).exp()];
        let mean = observed.iter().map(|o| o.rpm).sum::<f64>() / observed.len() as f64;
        let total: f64 = observed.iter().map(|o| (o.rpm - mean).powi(2)).sum();
        let left: f64 = observed.iter().zip(best.y.iter()).map(|(o, y)| (o.rpm - y).powi(2)).sum();
        let mut duties: Vec<f64> = observed.iter().map(|o| o.duty).collect();
        duties.sort_by(f64::total_cmp);
        duties.dedup();
        let trades = self.trades();
        let notes = self.notes(&trades, duties.len());
        Report {
            schema: 1,
            source: measurement.folder.display().to_string(),
            motor: motor.name.clone(),
            flavour,
            eta_n_v: eta,
            ci95: ends.map(|x0| base.force_factor_n_v * x0.exp()),
            ci95_others_exact: around(alone),
            trades,
            runs: self.runs(),
            stall_nm: stall(&with(base, &best.x)),
            stall_measured_nm: self.stall_nm.to_vec(),
            r2_speed: (duties.len() >= 3 && total > 0.0).then(|| 1.0 - left / total),
            misfit: best.misfit,
            notes,
        }
    }

    fn trades(&self) -> Vec<Trade> {
        let (jacobian, sigma) = (&self.best.jacobian, self.sigma);
        let sd = self.covariance[(0, 0)].sqrt();
        let dot = |a: usize, b: usize| {
            (0..jacobian.nrows()).map(|i| jacobian[(i, a)] * jacobian[(i, b)] / sigma[i].powi(2)).sum::<f64>()
        };
        let mut trades: Vec<Trade> = RIVALS
            .iter()
            .enumerate()
            .map(|(j, name)| {
                let posterior = self.covariance[(j + 1, j + 1)].sqrt();
                Trade {
                    with: (*name).to_owned(),
                    correlation: self.covariance[(0, j + 1)] / (sd * posterior),
                    exchange: -dot(0, j + 1) / dot(0, 0),
                    prior_relative: self.priors[j],
                    posterior_relative: posterior,
                    ratio: self.best.x[j + 1].exp(),
                }
            })
            .collect();
        trades.sort_by(|a, b| reach(b).total_cmp(&reach(a)));
        trades
    }

    fn runs(&self) -> Vec<RunResult> {
        let mut lag = self.observed.len();
        self.observed
            .iter()
            .enumerate()
            .map(|(i, o)| {
                let model_lag_s = o.lag.map(|_| {
                    lag += 1;
                    self.best.y[lag - 1]
                });
                RunResult {
                    id: o.id.clone(),
                    duty: o.duty,
                    load_nm: o.load_nm,
                    rpm: o.sign * o.rpm,
                    model_rpm: o.sign * self.best.y[i],
                    lag_s: o.lag.map(|l| l.0),
                    model_lag_s,
                }
            })
            .collect()
    }

    fn notes(&self, trades: &[Trade], duties: usize) -> Vec<String> {
        let mut notes = Vec::new();
        let named: Vec<String> = trades
            .iter()
            .filter(|t| reach(t) > 0.02 && t.posterior_relative > 0.5 * t.prior_relative)
            .map(|t| format!("{} ({:+.2} % of eta for 1 % of it)", t.with, t.exchange))
            .collect();
        if !named.is_empty() {
            notes.push(format!(
                "these data do not separate eta from {}: the interval is as wide as what is known of them",
                named.join(", ")
            ));
        }
        let misfit = self.best.misfit;
        if misfit > 2.0 {
            notes.push(format!(
                "the model misses the data by {misfit:.1} times their scatter: the interval is widened, but a model error may shift \
                 eta as well; `twum diagnose` looks for its cause"
            ));
        }
        if duties < 3 {
            notes.push(format!("{} duty only: speeds at three or more say more than one", duties));
        }
        if self.observed.iter().all(|o| o.lag.is_none()) {
            notes.push("no run begins at its start: start-up, which tells torque from speed, was not used".to_owned());
        }
        if self.observed.iter().all(|o| o.load_nm == 0.0) && self.stall_nm.is_empty() {
            notes.push(
                "no loaded run and no stall torque: `--loaded DUTY:NM:RPM` or `--torque-runs FILE` would bound the torque"
                    .to_owned(),
            );
        }
        notes
    }
}
