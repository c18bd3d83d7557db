//! One step of a search: candidates and terms without physics around the present model, and the refit of a candidate.

use super::baseline::coasts;
use super::case::{Accepted, Case};
use super::effects::Shape;
use super::finding::Estimate;
use super::fit::{Free, PHASED_SCALE, Phased, columns_of, objective, penalty, refit};
use super::problem::{Basis, Column, Model};
use super::rotor::P;
use super::stats::{Grams, Group, HeldOut};

/// Normal equations around a model: of what is free in it, and of what could be added.
pub struct Around {
    /// Columns of what is free.
    pub base: Vec<usize>,
    /// The equations.
    pub grams: Grams,
}

/// A way of one effect to act, in the linear search.
pub struct Candidate {
    /// Index of the effect in the library.
    pub effect: usize,
    /// Index of the way among the effect's.
    pub shape: usize,
    /// Its columns.
    pub group: Group,
}

/// The candidates around a model.
pub struct Step {
    /// The equations.
    pub around: Around,
    /// What could be added.
    pub candidates: Vec<Candidate>,
}

/// Terms without physics around a model.
pub struct Flexible {
    /// The equations.
    pub around: Around,
    /// The terms, and where each lives.
    pub terms: Vec<(&'static str, Group)>,
}

/// A candidate refitted together with everything else.
pub struct Trial {
    /// The candidate.
    pub accepted: Accepted,
    /// The model with it.
    pub model: Model,
    /// Held-out errors without and with it.
    pub held: HeldOut,
    /// Its numbers.
    pub estimates: Vec<Estimate>,
    /// Whether the numbers are admissible.
    pub estimates_ok: bool,
    /// Share of null data sets in which some candidate does as well.
    pub p_null: f64,
}

/// Columns of a design, each once.
struct Columns {
    all: Vec<Column>,
    scales: Vec<f64>,
}

impl Columns {
    fn new(free: &[Free]) -> Self {
        Self { all: columns_of(free), scales: vec![1.0; free.len()] }
    }

    fn add(&mut self, column: Column, scale: f64) -> usize {
        self.all.iter().position(|c| *c == column).unwrap_or_else(|| {
            self.all.push(column);
            self.scales.push(scale);
            self.all.len() - 1
        })
    }
}

impl Case<'_> {
    fn around(&self, model: &Model, free: &[Free], columns: &Columns) -> Around {
        let designs = self.problem.design(model, &columns.all);
        Around { base: (0..free.len()).collect(), grams: self.grams(&designs, &columns.scales, free, model) }
    }

    /// What of the `usable` effects could be added to `model`, which has the accepted ones.
    pub fn step(&self, model: &Model, accepted: &[Accepted], usable: &[usize]) -> Step {
        let free = self.free(model, accepted);
        let mut columns = Columns::new(&free);
        let mut candidates = Vec::new();
        for &effect in usable.iter().filter(|e| accepted.iter().all(|a| a.effect != **e)) {
            for (shape, way) in self.effects[effect].shapes.iter().enumerate() {
                let scale = if way.phased { PHASED_SCALE } else { 1.0 };
                let group = group_of(way, way.columns.iter().map(|c| columns.add(c.clone(), scale)).collect());
                candidates.push(Candidate { effect, shape, group });
            }
        }
        Step { around: self.around(model, &free, &columns), candidates }
    }

    /// Terms without physics that could be added to `model`.
    pub fn flexible(&self, model: &Model, accepted: &[Accepted]) -> Flexible {
        let free = self.free(model, accepted);
        let mut columns = Columns::new(&free);
        let mut flexible = Vec::new();
        let mut linear = |name: &'static str, bases: Vec<Basis>| {
            let k: Vec<usize> = bases.into_iter().map(|b| columns.add(Column::Flexible(b), 0.3)).collect();
            flexible.push((name, Group::Linear(k)));
        };
        linear("time", (0..6).map(|j| Basis::Time(j, 6)).collect());
        let duties = self.problem.duties();
        if duties >= 3 {
            let n = duties.min(6);
            linear("duty", (0..n).map(|j| Basis::Duty(j, n)).collect());
        }
        if self.problem.runs.iter().any(|r| r.direction > 0.0) && self.problem.runs.iter().any(|r| r.direction < 0.0) {
            linear("direction", vec![Basis::Direction]);
            if duties >= 3 {
                linear("duty and direction", (0..3).map(|j| Basis::DutyDirection(j, 3)).collect());
            }
        }
        if self.problem.ordered() && self.problem.runs.len() >= 6 {
            linear("order", (0..5).map(|j| Basis::Order(j, 5)).collect());
        }
        if self.problem.runs.iter().any(|r| r.duty.is_some_and(|d| d < 1.0)) {
            linear("PWM phase", (0..8).map(|j| Basis::Phase(j, 8)).collect());
        }
        if self.problem.runs.iter().any(|r| r.level.iter().any(|l| *l != 0)) {
            linear("encoder slots", vec![Basis::Slot]);
        }
        if self.problem.runs.iter().any(|r| r.duty.is_some_and(|d| d < 1.0)) {
            let k = (0..6).map(|j| columns.add(Column::Lag(j, 6), 1.0)).collect();
            flexible.push(("timing against the PWM", Group::Linear(k)));
        }
        if self.problem.runs.iter().any(|r| r.revolutions() > 0.6) {
            for (name, from) in [("angle", 0), ("angle, three and more times a turn", 2)] {
                let pairs = (from..from + if from == 0 { 2 } else { 6 })
                    .map(|h| [2 * h, 2 * h + 1].map(|j| columns.add(Column::Flexible(Basis::Angle(j)), PHASED_SCALE)))
                    .collect();
                flexible.push((name, Group::Phased(pairs)));
            }
        }
        Flexible { around: self.around(model, &free, &columns), terms: flexible }
    }

    /// A candidate of `step`, refitted without linearising.
    pub fn trial(&self, step: &Step, chosen: &Candidate, model: &Model, accepted: &[Accepted]) -> Trial {
        let effect = &self.effects[chosen.effect];
        let shape = &effect.shapes[chosen.shape];
        let mut start = model.clone();
        let mut own = Accepted { effect: chosen.effect, free: Vec::new(), phased: Vec::new() };
        match &chosen.group {
            Group::Linear(columns) => {
                let all: Vec<usize> = (0..self.problem.runs.len()).collect();
                let set = [step.around.base.clone(), columns.clone()].concat();
                let beta = step.around.grams.fit(&all, &set);
                for (q, v) in &shape.pinned {
                    start.parameters.set(*q, *v);
                }
                for (k, column) in shape.columns.iter().enumerate() {
                    if let Column::Scalar { parameter, scale, .. } = column {
                        let bounds = effect
                            .reported
                            .iter()
                            .find(|r| r.parameter == *parameter)
                            .map_or((f64::NEG_INFINITY, f64::INFINITY), |r| r.bounds);
                        let value = beta[step.around.base.len() + k].clamp(-3.0, 3.0) * scale;
                        start.parameters.set(*parameter, value.clamp(bounds.0.min(0.0), bounds.1));
                        let scale = if *parameter == P::ClockError { 1e-3 } else { *scale };
                        own.free.push(Free {
                            parameter: *parameter,
                            scale,
                            bounds: (bounds.0.min(0.0), bounds.1),
                            prior: None,
                        });
                    }
                }
                for (q, v) in &shape.pinned {
                    let integer = *q == P::QuantSteps;
                    let free_carry = *q != P::HeatCarry || (self.problem.ordered() && *v > 0.0);
                    if !integer && free_carry {
                        let bounds = effect
                            .reported
                            .iter()
                            .find(|r| r.parameter == *q)
                            .map_or((0.0, f64::INFINITY), |r| r.bounds);
                        own.free.push(Free { parameter: *q, scale: (0.5 * v).max(1e-3), bounds, prior: None });
                    }
                }
            }
            Group::Phased(_) => {
                own.phased = shape
                    .columns
                    .chunks_exact(2)
                    .map(|c| match c[0] {
                        Column::Runout(h) => Phased::Runout(h / 2),
                        Column::Eccentricity(_) => Phased::Eccentricity,
                        _ => Phased::Gravity,
                    })
                    .collect();
            }
        }
        let mut all = accepted.to_vec();
        all.push(own.clone());
        if own.phased.is_empty() {
            start = self.best_start(step, model, start, chosen, &all);
        }
        let (fitted, phased_fits) = self.refit(&start, &all);
        let held = self.held_out(&fitted, &all, Some((step.around.grams.variance, step.around.grams.gain_spread)));
        let (estimates, estimates_ok) = self.estimate(&fitted, &all, &own, &phased_fits);
        Trial { accepted: own, model: fitted, held, estimates, estimates_ok, p_null: 1.0 }
    }

    /// The linear estimate may lie in another valley than the optimum: a few sizes are tried for two iterations each.
    fn best_start(&self, step: &Step, model: &Model, linear: Model, chosen: &Candidate, all: &[Accepted]) -> Model {
        let effect = &self.effects[chosen.effect];
        let shape = &effect.shapes[chosen.shape];
        let Some(Column::Scalar { parameter, scale, .. }) = shape.columns.first() else { return linear };
        let bounds = effect.reported.iter().find(|r| r.parameter == *parameter).map_or((-1.0, 1.0), |r| r.bounds);
        let sense = if bounds.0 < 0.0 { linear.parameters.get(*parameter).signum() } else { 1.0 };
        let free = self.free(model, all);
        let mut best: Option<(f64, Model)> = None;
        let mut starts = vec![linear.clone()];
        for size in [0.3, 1.0] {
            let mut s = linear.clone();
            let sense = if *parameter == P::ClockError { 1.0 } else { sense };
            s.parameters.set(*parameter, (sense * size * scale).clamp(bounds.0.min(0.0), bounds.1));
            starts.push(s);
        }
        // The baseline's refit may have taken part of the effect into its own rates: each start is tried with the motor's as well.
        if !coasts(model) {
            for k in 0..starts.len() {
                starts.push(self.at_home(&starts[k]));
            }
        }
        for start in starts {
            let (fitted, _) = refit(self.problem, start, &free, &[], 4);
            let misfit = objective(self.problem, &fitted, step.around.grams.variance, step.around.grams.gain_spread);
            let value = misfit + penalty(&free, &fitted, misfit / self.problem.runs.len() as f64);
            if best.as_ref().is_none_or(|b| value < b.0) {
                best = Some((value, fitted));
            }
        }
        best.map_or(linear, |b| b.1)
    }
}

fn group_of(shape: &Shape, columns: Vec<usize>) -> Group {
    if shape.phased {
        Group::Phased(columns.chunks_exact(2).map(|c| [c[0], c[1]]).collect())
    } else {
        Group::Linear(columns)
    }
}
