//! Numbers of an effect with their intervals: what the runs scatter, what is only believed, what the sampling bends.

use super::case::{Accepted, Case};
use super::effects::belongs_elsewhere;
use super::finding::Estimate;
use super::fit::{Phased, bias, columns_of, priors_at};
use super::problem::{Basis, Column, Model};
use super::rotor::P;
use super::stats::{Grams, PhasedFit, Prior};

/// Data sets made to see what the sampling does to an estimate.
const CALIBRATIONS: usize = 12;

/// How much of the free speed the rotor equation may miss in each of the first milliseconds after a switching (standard
/// deviation): the wave's build-up of a quarter of a millisecond and the softness of the contact are not in it.
pub const DISCREPANCY: f64 = 0.1;

/// A member of an answer with the model it was estimated in.
#[derive(Clone)]
pub struct Fitted {
    /// The effect itself.
    pub own: Accepted,
    /// What else is in the model.
    pub others: Vec<Accepted>,
    /// The model.
    pub model: Model,
}

impl Fitted {
    /// Everything that is in the model.
    pub fn all(&self) -> Vec<Accepted> {
        [self.others.clone(), vec![self.own.clone()]].concat()
    }
}

impl Case<'_> {
    /// Estimates of an effect that is in the model together with `accepted`, and whether they are admissible.
    pub fn estimate(
        &self,
        model: &Model,
        accepted: &[Accepted],
        own: &Accepted,
        phased_fits: &[PhasedFit],
    ) -> (Vec<Estimate>, bool) {
        let effect = &self.effects[own.effect];
        let mut out = Vec::new();
        let mut ok = !belongs_elsewhere(effect.name, &model.parameters);
        if own.phased.is_empty() {
            let free = self.free(model, accepted);
            let columns = [columns_of(&free), discrepancy()].concat();
            let scales = vec![1.0; columns.len()];
            let grams =
                Grams::new(&self.problem.design(model, &columns), 0, &scales, Some(self.keys), self.divisions.to_vec());
            let mut priors = priors_at(&free, model, grams.misfit_a_run());
            let precision = grams.variance / (DISCREPANCY * DISCREPANCY);
            priors.resize(columns.len(), Prior { precision, pull: 0.0, noise: grams.variance * precision });
            let set: Vec<usize> = (0..free.len()).collect();
            let (beta, cov) = grams.with_prior(priors).fit_all(&(0..columns.len()).collect::<Vec<_>>());
            let first = set.len() - own.free.len();
            let quantile =
                student_975(self.problem.runs.len().saturating_sub(set.len().min(self.problem.runs.len() - 1)).max(1));
            for reported in &effect.reported {
                let value_now = model.parameters.get(reported.parameter);
                let Some(k) = own.free.iter().position(|f| f.parameter == reported.parameter) else {
                    if !reported.size && reported.parameter == P::QuantSteps {
                        out.push(Estimate {
                            name: reported.name.to_owned(),
                            value: value_now,
                            interval: [value_now, value_now],
                            unit: reported.unit.to_owned(),
                        });
                    }
                    continue;
                };
                let scale = own.free[k].scale;
                let value = value_now + beta[first + k].clamp(-0.5, 0.5) * scale;
                let half = quantile * cov[(first + k, first + k)].max(0.0).sqrt() * scale;
                let interval = [value - half, value + half];
                if reported.size {
                    let excludes_absent = interval[0] > 0.0 || interval[1] < 0.0;
                    let admissible = interval[1] >= reported.bounds.0 && interval[0] <= reported.bounds.1 && {
                        // A size whose sign physics forbids is not admissible.
                        value >= reported.bounds.0 && value <= reported.bounds.1
                    };
                    ok &= excludes_absent && admissible;
                }
                out.push(Estimate {
                    name: reported.name.to_owned(),
                    value: value * reported.factor,
                    interval: [interval[0] * reported.factor, interval[1] * reported.factor],
                    unit: reported.unit.to_owned(),
                });
            }
        } else {
            let skip = phased_fits.len() - own.phased.len();
            let mut any = false;
            for (p, fit) in own.phased.iter().zip(&phased_fits[skip..]) {
                // A drive that turns back, or an encoder that does, is not this effect.
                let (name, unit, most) = match p {
                    Phased::Runout(0) => ("once_a_turn", "1", 1.0),
                    Phased::Runout(_) => ("twice_a_turn", "1", 1.0),
                    Phased::Eccentricity => ("eccentricity_rad", "rad", 0.8),
                    Phased::Gravity => ("gravity_torque_over_inertia", "rad/s^2", f64::INFINITY),
                };
                let half = 1.96 * fit.spread;
                any |= fit.amplitude > half;
                ok &= fit.amplitude < most;
                out.push(Estimate {
                    name: name.to_owned(),
                    value: fit.amplitude,
                    interval: [(fit.amplitude - half).max(0.0), fit.amplitude + half],
                    unit: unit.to_owned(),
                });
            }
            ok &= any;
        }
        (out, ok)
    }

    /// Estimates of an effect without what the sampling adds to them: the same fit, repeated on data that the fitted model made,
    /// shows how far it lies from what made them.
    pub fn calibrated(&self, fit: &Fitted, gain_spread: f64) -> Vec<Estimate> {
        let effect = &self.effects[fit.own.effect];
        let all = fit.all();
        let mut estimates = self.estimate(&fit.model, &all, &fit.own, &[]).0;
        let free = self.free(&fit.model, &all);
        if let Some(bias) = bias(self.problem, &fit.model, &free, gain_spread, CALIBRATIONS, self.seed) {
            for e in &mut estimates {
                let Some(reported) = effect.reported.iter().find(|r| r.name == e.name) else { continue };
                let Some(k) = free.iter().rposition(|f| f.parameter == reported.parameter) else { continue };
                let [shift, error] = bias[k].map(|b| b * reported.factor);
                let half = (0.5 * (e.interval[1] - e.interval[0])).hypot(1.96 * error);
                e.value -= shift;
                e.interval = [e.value - half, e.value + half];
            }
        }
        estimates
    }

    /// [`Self::calibrated`], as uncertain as the answers of those differ who believe in another of the possible frictions (factors on
    /// the motor file's).
    pub fn numbers(&self, fit: &Fitted, gain_spread: f64, possible: &[f64]) -> Vec<Estimate> {
        let mut estimates = self.calibrated(fit, gain_spread);
        for factor in possible {
            let other = self.believing(*factor);
            let model = other.refit(&other.at_home(&fit.model), &fit.all()).0;
            let there = other.calibrated(&Fitted { model, ..fit.clone() }, gain_spread);
            for (e, t) in estimates.iter_mut().zip(there) {
                e.interval = [e.interval[0].min(t.interval[0]), e.interval[1].max(t.interval[1])];
            }
        }
        estimates
    }
}

/// Columns of the free speed in each of the first milliseconds after each switching.
pub fn discrepancy() -> Vec<Column> {
    [true, false]
        .into_iter()
        .flat_map(|rise| (0..3).map(move |k| Column::Flexible(Basis::AfterSwitching(rise, k))))
        .collect()
}

/// 97.5 % quantile of Student's t.
fn student_975(degrees: usize) -> f64 {
    use statrs::distribution::{ContinuousCDF, StudentsT};
    StudentsT::new(0.0, 1.0, degrees as f64).map_or(1.96, |t| t.inverse_cdf(0.975))
}
