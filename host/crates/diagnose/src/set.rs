//! A set of effects: what is in it, the model with them, and what it weighs.

use super::evidence::Weighed;
use super::free::Free;
use super::level::Taus;
use super::library::Phased;
use super::problem::Model;
use super::refit::put_coefficients;
use super::rotor::{P, Parameters};
use super::verdict::{Course, Visited};

/// One effect in a set.
#[derive(Debug, Clone)]
pub struct Part {
    /// Index in the library.
    pub effect: usize,
    /// Index among the effect's forms.
    pub form: usize,
    /// Its common parameters.
    pub free: Vec<Free>,
    /// Its phased pairs.
    pub phased: Vec<Phased>,
}

impl Part {
    /// Whether this parameter is one of its own.
    pub fn changes(&self, parameter: P) -> bool {
        self.free.iter().any(|f| f.parameter == parameter)
    }
}

/// The phased pairs of all parts, one after the other.
pub fn phased_of(parts: &[Part]) -> Vec<Phased> {
    parts.iter().flat_map(|p| p.phased.iter().copied()).collect()
}

/// A set of effects, refitted and weighed.
#[derive(Debug, Clone)]
pub struct Set {
    /// The effects.
    pub parts: Vec<Part>,
    /// The model with them.
    pub model: Model,
    /// Log evidence with costs and priors.
    pub score: f64,
    /// What was found by integrating.
    pub weighed: Weighed,
    /// Terms without physics that the data ask for beside them, strongest first, with the squared error that is then left.
    pub terms: Vec<(&'static str, f64)>,
    /// What courses of each run's own over time or angle would take, the strongest first.
    pub courses: Vec<Course>,
    /// Squared error in rpm²·s that the effects remove by moving the gains of the runs, which have taken it up without them.
    pub by_gains: f64,
    /// Squared error in rpm²·s that the gains take up, by what they scatter with.
    pub scattered: Taus,
    /// Whether others were looked for from it.
    pub expanded: bool,
}

impl Set {
    /// Indices of its effects, sorted.
    pub fn key(&self) -> Vec<usize> {
        key(&self.parts)
    }

    /// Whether all of its effects are among another set's.
    pub fn is_within(&self, other: &Self) -> bool {
        self.parts.iter().all(|p| other.parts.iter().any(|o| o.effect == p.effect))
    }

    /// Whether it has fewer effects of the other set's and does no worse: one of those does nothing there.
    pub fn is_worth_no_less_than(&self, other: &Self) -> bool {
        self.parts.len() < other.parts.len() && self.score >= other.score && self.is_within(other)
    }

    /// What the verdict has to know of it.
    pub fn visited(&self) -> Visited {
        Visited {
            key: self.key(),
            score: self.score,
            left: self.weighed.left,
            taus: self.weighed.taus,
            belief: self.weighed.belief,
            terms: self.terms.clone(),
            courses: self.courses.clone(),
            by_gains: self.by_gains,
            scattered: self.scattered,
        }
    }
}

/// Indices of the effects, sorted.
pub fn key(parts: &[Part]) -> Vec<usize> {
    let mut k: Vec<usize> = parts.iter().map(|p| p.effect).collect();
    k.sort_unstable();
    k
}

/// The model without an effect.
pub fn strip(model: &Model, part: &Part) -> Model {
    let mut m = model.clone();
    let absent = Parameters::new(1.0, 1.0, 1.0, 0.0, 0.0);
    for f in &part.free {
        m.parameters.set(f.parameter, absent.get(f.parameter));
    }
    for shape in [P::RunoutSpeed, P::RunoutTorque, P::RunoutBrake] {
        if part.phased.iter().any(|p| matches!(p, Phased::Runout(_))) {
            m.parameters.set(shape, absent.get(shape));
        }
    }
    let zero = vec![vec![0.0; 2 * part.phased.len()]; m.terms.len()];
    put_coefficients(&mut m, &part.phased, &zero);
    m
}
