//! The chip's controller once more, over the ticks of a record.

use super::measurement::ControlRow;
use twum_shared::step::{Config, ConfigError, ConfigSpec, Inputs, State, step};

impl ControlRow {
    /// What the controller saw in this tick. The target's rate (counts/s) is not in the row.
    pub fn inputs(&self, target_rate: i32) -> Inputs {
        let (target, position) = (self.target.round() as i32, self.position.round() as i32);
        Inputs { target, target_rate, position, ..Inputs::default() }
    }
}

/// The control signal (duty steps) of a controller that starts at rest with the first of these ticks.
///
/// # Errors
/// A controller that is not valid.
pub fn recomputed(spec: ConfigSpec, ticks: impl Iterator<Item = Inputs>) -> Result<Vec<f64>, ConfigError> {
    let config = Config::try_from(spec)?;
    let mut state = State::REST;
    Ok(ticks.map(|inputs| f64::from(step(&config, &mut state, inputs).u) / 65_536.0).collect())
}
