//! What is known of an effect by its name: where it lives, and its parameters with their units and bounds.

use super::hypothesis::{ActsOn, Hypothesis, Number, Role};
use serde::Serialize;

/// Where an effect lives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Seat {
    /// The motor itself.
    Plant,
    /// Between the commanded duty and the supply.
    Actuator,
    /// The encoder and the clock that times it.
    Sensor,
    /// The control step.
    Controller,
}

/// How a parameter behaves, for whoever fits it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A number on a line.
    Linear,
    /// A positive scale (time constant, speed): fit its logarithm. Means nothing while the effect's size is absent.
    Scale,
    /// An angle: fit it together with the size as (size·cos, size·sin). Means nothing while the size is absent.
    Angle,
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EffectParameter {
    /// Name, as in the answer of `twum diagnose`.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Smallest admissible value.
    pub lower: f64,
    /// Largest admissible value.
    pub upper: f64,
    /// The value at which the effect is not there. A parameter of kind other than `Linear` has no such value: its
    /// `absent` is only where to start.
    pub absent: f64,
    /// A size at which the effect is plain to see in the 30 mm motor: a scale for steps of a search.
    pub typical: f64,
    /// How it behaves.
    pub kind: Kind,
}

/// One effect of the catalogue.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EffectInfo {
    /// Name, as in the answer of `twum diagnose`.
    pub name: &'static str,
    /// Where it lives.
    pub seat: Seat,
    /// Its parameters, the size first.
    pub parameters: &'static [EffectParameter],
}

impl EffectInfo {
    /// The entry of an effect that is a formula.
    pub(crate) fn of_formula(hypothesis: &'static Hypothesis) -> Self {
        let of = |n: &'static Number| {
            let (absent, typical, kind) = match n.role {
                Role::Typical(typical) => (0.0, typical, Kind::Linear),
                Role::Start(start) => (start, start, Kind::Scale),
            };
            EffectParameter { name: &n.name, unit: &n.unit, lower: n.min, upper: n.max, absent, typical, kind }
        };
        let parameters: Vec<EffectParameter> = hypothesis.numbers.iter().map(of).collect();
        let seat = if hypothesis.acts_on == ActsOn::Duty { Seat::Actuator } else { Seat::Plant };
        // Once a program, as long as it runs: like an entry of the list.
        EffectInfo { name: &hypothesis.name, seat, parameters: parameters.leak() }
    }
}
