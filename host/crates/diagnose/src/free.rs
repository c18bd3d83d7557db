//! A parameter of the model that is free.

use super::design::Column;
use super::prior::Prior;
use super::rotor::P;

/// A common parameter that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub parameter: P,
    /// How large a change is plausible: the unit of its column.
    pub scale: f64,
    /// Admissible range.
    pub bounds: (f64, f64),
    /// What is known of it.
    pub prior: Prior,
}

/// The free parameters as columns of a design.
pub fn columns_of(free: &[Free]) -> Vec<Column> {
    free.iter()
        .map(|f| Column::Scalar { parameter: f.parameter, scale: f.scale, step: f.scale * 0.02, shape: Vec::new() })
        .collect()
}
