//! A parameter of the model that is free.

use super::design::Column;
use super::prior::Prior;
use super::rotor::{P, Parameters};

/// A common parameter that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub parameter: P,
    /// How large a change is plausible: the unit of its column. A positive number's is itself ([`Free::near`]).
    pub scale: f64,
    /// Admissible range.
    pub bounds: (f64, f64),
    /// What is known of it.
    pub prior: Prior,
}

impl Free {
    /// The same in steps that go with the number as it is now, where it is a positive one: one that has fallen to a fiftieth has no derivative over a
    /// fiftieth of what it was, and one that is fifty times as large gets nowhere in steps of that.
    pub fn near(self, now: &Parameters) -> Self {
        let scale = match self.prior {
            Prior::LogNormal { .. } => now.get(self.parameter).max(self.bounds.0),
            Prior::Flat | Prior::Normal { .. } => self.scale,
        };
        Self { scale, ..self }
    }
}

/// The free parameters as columns of a design.
pub fn columns_of(free: &[Free]) -> Vec<Column> {
    free.iter()
        .map(|f| Column::Scalar { parameter: f.parameter, scale: f.scale, step: f.scale * 0.02, shape: Vec::new() })
        .collect()
}
