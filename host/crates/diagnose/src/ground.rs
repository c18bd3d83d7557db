//! What sets of effects are weighed on: the runs, the library, and what is free in a model.

use super::baseline::baseline_free;
use super::design::Column;
use super::discrepancy::{Term, terms};
use super::evidence::{Question, independent};
use super::form_error::FormError;
use super::free::{Free, columns_of};
use super::level::{Level, Taus};
use super::library::{Coordinate, Effect};
use super::observe::Observed;
use super::problem::{Model, Problem};
use super::refit::{Covariance, objective, refit};
use super::rotor::Parameters;
use super::set::{Part, Set, phased_of};
use super::timing::{STEP_S, TIMING, TIMING_S, alike};
use twum_fit::noise::Noise;

/// What a search works on.
pub struct Ground<'a> {
    /// The runs.
    pub problem: &'a Problem,
    /// The motor file's rotor.
    pub home: Parameters,
    /// The library.
    pub effects: &'a [Effect],
    /// Indices of the effects that these runs can show.
    pub usable: Vec<usize>,
    /// What the gains of the runs scatter by.
    pub level: Level,
    /// How many independent residuals the runs count as.
    pub independent: f64,
    /// Terms without physics.
    pub terms: Vec<Term>,
    /// The squared error that counts as one of the forms, in rpm²·s.
    pub form_error: FormError,
}

/// What residuals scatter by, whichever runs they are of.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scatter {
    /// Variance of a residual.
    pub variance: f64,
    /// Spreads of the gains.
    pub taus: Taus,
}

impl<'a> Ground<'a> {
    /// Of some runs.
    pub fn new(problem: &'a Problem, home: Parameters, effects: &'a [Effect], usable: Vec<usize>) -> Self {
        let rows: usize = problem.runs.iter().map(|r| r.windows.len()).sum();
        let independent = independent(rows as f64, problem.runs.len());
        Self {
            level: Level::new(problem),
            terms: terms(problem),
            problem,
            home,
            effects,
            usable,
            independent,
            form_error: FormError::UNBOUNDED,
        }
    }

    /// Over what the library's effects act that show in a term's coordinate.
    pub fn coordinates(&self, lives_in: &str) -> &'static [Coordinate] {
        self.terms.iter().find(|t| t.lives_in == lives_in).map_or(&[], |t| t.coordinates)
    }

    /// What is free in a set: the baseline's own parameters and the effects'.
    pub fn free(&self, model: &Model, parts: &[Part]) -> Vec<Free> {
        let mut free = baseline_free(&model.parameters, &self.home, self.problem.closed());
        free.retain(|own| parts.iter().all(|p| p.free.iter().all(|f| f.parameter != own.parameter)));
        free.extend(parts.iter().flat_map(|p| &p.free).map(|f| f.near(&model.parameters)));
        free
    }

    /// Log prior of what is free.
    pub(super) fn log_prior(&self, model: &Model, parts: &[Part]) -> f64 {
        self.free(model, parts).iter().map(|f| f.prior.log_density(model.parameters.get(f.parameter))).sum()
    }

    /// Squared error in rpm²·s less what the priors are worth of it.
    pub(super) fn misfit(&self, model: &Model, parts: &[Part], scatter: Scatter) -> f64 {
        let left = objective(self.problem, model, &self.covariance(scatter));
        left - 2.0 * scatter.variance * self.log_prior(model, parts)
    }

    /// What residuals scatter by in a set.
    pub(super) fn scatter(&self, set: &Set) -> Scatter {
        Scatter { variance: set.weighed.variance, taus: set.weighed.taus }
    }

    /// The covariance that makes of these runs.
    pub(super) fn covariance(&self, Scatter { variance, taus }: Scatter) -> Covariance {
        Covariance { variance, gains: self.level.between(&taus) }
    }

    /// What residuals scatter by in a set where the gain of each run is its own.
    pub fn noise(&self, set: &Set) -> Noise {
        let [chance, duty, direction, both, order] = set.weighed.taus;
        let spread = [chance, duty, direction, both, order].iter().map(|t| t * t).sum::<f64>().sqrt();
        Noise { variance: set.weighed.variance, gain_spread: spread.clamp(3e-3, 0.1) }
    }

    /// The same were what is left that of the sampling alone, which every stretch that lies apart has anew.
    pub fn noise_of_sampling(&self, set: &Set) -> Noise {
        let apart: f64 = self.problem.runs.iter().map(Observed::apart).sum();
        Noise { variance: set.weighed.left / apart.max(1.0), ..self.noise(set) }
    }

    /// The model refitted with the effects in it.
    pub(super) fn refitted(&self, model: Model, parts: &[Part], scatter: Scatter, steps: usize) -> Model {
        let free = self.free(&model, parts);
        refit(self.problem, model, &free, &phased_of(parts), &self.covariance(scatter), steps)
    }

    /// Columns of a set: gain, other free parameters, phased pairs, the timing of pulses; and what is asked of them.
    pub(super) fn columns(&self, model: &Model, parts: &[Part]) -> (Vec<Column>, Question) {
        let free = self.free(model, parts);
        let mut columns = columns_of(&free);
        let common: Vec<(usize, f64)> = free
            .iter()
            .enumerate()
            .skip(1)
            .map(|(k, f)| (k, (f.prior.sd_near(model.parameters.get(f.parameter)) / f.scale).min(10.0)))
            .collect();
        let mut own = Vec::new();
        for (group, p) in parts.iter().flat_map(|p| &p.phased).enumerate() {
            for column in p.columns() {
                own.push((columns.len(), group));
                columns.push(column);
            }
        }
        let (mut by_kind, mut kinds) = (Vec::new(), Vec::new());
        if self.problem.pulsed() {
            by_kind.extend(TIMING.map(|parameter| match free.iter().position(|f| f.parameter == parameter) {
                Some(column) => (column, TIMING_S / free[column].scale),
                None => {
                    columns.push(Column::Scalar { parameter, scale: TIMING_S, step: STEP_S, shape: Vec::new() });
                    (columns.len() - 1, 1.0)
                }
            }));
            kinds.extend(alike(self.problem.runs.iter().map(|r| r.duty)));
        }
        (columns, Question { common, by_kind, kinds, own })
    }
}

#[cfg(test)]
mod tests {
    use super::super::prior::Prior;
    use super::super::rotor::P;
    use super::*;
    use crate::{Options, starting_rotor, trial};

    /// Fails if the evidence takes a shape's slope over what the shape was where it was first looked at: of a time of 0.2 s over one of a second.
    #[test]
    fn a_shape_is_weighed_in_steps_of_what_it_is() {
        let runs = trial::runs(&|_, _, _, _| 0.0);
        let rotor = starting_rotor(&runs, &Options::default());
        let problem = Problem::new(runs);
        let ground = Ground::new(&problem, rotor.clone(), &[], Vec::new());
        let prior = Prior::LogNormal { median: 1.0, log_sd: 1.0 };
        let tau = Free { parameter: P::HeatTau, scale: 1.0, bounds: (0.1, 10.0), prior };
        let parts = [Part { effect: 0, form: 0, free: vec![tau], phased: Vec::new() }];
        let free = ground.free(&problem.model(rotor.with(P::HeatTau, 0.2)), &parts);
        assert_eq!(free.last().map(|f| (f.parameter, f.scale)), Some((P::HeatTau, 0.2)));
    }
}
