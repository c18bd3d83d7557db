//! What a search works on: the runs, where it starts, what is free, and how runs are held out.

use super::baseline::{baseline_free, rated};
use super::effects::Effect;
use super::fit::{Free, PHASED_SCALE, Phased, columns_of, priors_at, refit};
use super::problem::{Model, Problem, RunDesign};
use super::rotor::{P, Parameters};
use super::stats::{Fold, Grams, PhasedFit};

/// One problem with everything that is the same in all rounds of its search.
#[derive(Clone)]
pub struct Case<'a> {
    /// The runs.
    pub problem: &'a Problem,
    /// The rotor that is believed in: the motor file's.
    pub home: Parameters,
    /// The library.
    pub effects: &'a [Effect],
    /// The baseline's own parameters.
    pub base_free: Vec<Free>,
    /// Runs with equal keys repeat each other.
    pub keys: &'a [String],
    /// How runs are held out.
    pub divisions: &'a [Fold],
    /// Seed of every random choice.
    pub seed: u64,
}

/// An effect in the model.
#[derive(Clone)]
pub struct Accepted {
    /// Index in the library.
    pub effect: usize,
    /// Its common parameters.
    pub free: Vec<Free>,
    /// Its phased coefficients.
    pub phased: Vec<Phased>,
}

/// Normal equations of a model.
pub struct Local {
    /// The equations.
    pub grams: Grams,
    /// Columns of the common parameters.
    pub set: Vec<usize>,
    /// Columns of the phased coefficients.
    pub pairs: Vec<[usize; 2]>,
}

impl Case<'_> {
    /// The same case for somebody who believes in `factor` times the friction.
    pub fn believing(&self, factor: f64) -> Self {
        let home = rated(&self.home, factor);
        let base_free = baseline_free(&home, &home, home.get(P::OffDeceleration) <= 0.0);
        Self { home, base_free, ..self.clone() }
    }

    /// `model` with the friction and the damping that are believed in.
    pub fn at_home(&self, model: &Model) -> Model {
        let mut out = model.clone();
        for rate in [P::OnAcceleration, P::OffDeceleration, P::Viscous] {
            out.parameters.set(rate, self.home.get(rate));
        }
        out
    }

    /// What is free near `model`: the baseline's own parameters and the accepted effects'.
    pub fn free(&self, model: &Model, accepted: &[Accepted]) -> Vec<Free> {
        let mut free = self.base_free.clone();
        free[0].scale = model.parameters.get(P::FreeSpeed);
        free.extend(accepted.iter().flat_map(|a| a.free.iter().copied()));
        free
    }

    /// The model refitted with the accepted effects in it.
    pub fn refit(&self, start: &Model, accepted: &[Accepted]) -> (Model, Vec<PhasedFit>) {
        let phased: Vec<Phased> = accepted.iter().flat_map(|a| a.phased.iter().copied()).collect();
        refit(self.problem, start.clone(), &self.free(start, accepted), &phased, 8)
    }

    /// Weighted residuals and derivatives of the accepted model, one a run.
    pub fn designs(&self, model: &Model, accepted: &[Accepted]) -> (Vec<RunDesign>, Vec<f64>, Vec<[usize; 2]>) {
        let mut columns = columns_of(&self.free(model, accepted));
        let mut scales = vec![1.0; columns.len()];
        let mut pairs = Vec::new();
        for p in accepted.iter().flat_map(|a| &a.phased) {
            let at = columns.len();
            pairs.push([at, at + 1]);
            columns.extend(p.columns());
            scales.extend([PHASED_SCALE; 2]);
        }
        (self.problem.design(model, &columns), scales, pairs)
    }

    /// Normal equations of the accepted model.
    pub fn local(&self, model: &Model, accepted: &[Accepted]) -> Local {
        let (designs, scales, pairs) = self.designs(model, accepted);
        let free = self.free(model, accepted);
        Local { grams: self.grams(&designs, &scales, &free, model), set: (0..free.len()).collect(), pairs }
    }

    /// Normal equations of designs around `model` whose first columns are what is `free`, with what is known of that.
    pub fn grams(&self, designs: &[RunDesign], scales: &[f64], free: &[Free], model: &Model) -> Grams {
        let grams = Grams::new(designs, 0, scales, Some(self.keys), self.divisions.to_vec());
        let misfit = grams.misfit_a_run();
        grams.with_prior(priors_at(free, model, misfit))
    }
}

/// The model with one effect absent.
pub fn strip(model: &Model, effect: &Accepted) -> Model {
    let mut m = model.clone();
    for f in &effect.free {
        if is_size(f.parameter) {
            m.parameters.set(f.parameter, 0.0);
        }
    }
    let zero = vec![[0.0; 2]; m.terms.len()];
    for p in &effect.phased {
        p.store(&mut m, &zero);
    }
    m
}

fn is_size(p: P) -> bool {
    !matches!(
        p,
        P::HeatTau | P::HeatCarry | P::SettleTau | P::SagTime | P::QuantSteps | P::StribeckSpeed | P::WearRevolutions
    )
}
