//! One argument for bands, for every command that foretells from a motor file.

use anyhow::{Result, bail};
use serde_json::{Value, json};
use twum_host::model::motor::Motor;
use twum_host::model::parameters::{Flavour, Parameters};
use twum_host::model::uncertainty::draws;

/// How many motors are drawn unless a number is given: ten lie beyond the ends of a 95 % band.
const DRAWS: &str = "200";

/// Whether bands are asked for.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct UncertaintyArgs {
    /// Say in which band the answer lies, by so many motors (200) drawn from the uncertainties in the motor file
    #[arg(long, value_name = "DRAWS", num_args = 0..=1, default_missing_value = DRAWS)]
    uncertainty: Option<u64>,
    /// Seed of those draws
    #[arg(long, default_value_t = 1, requires = "uncertainty")]
    uncertainty_seed: u64,
}

impl UncertaintyArgs {
    /// Motors that the file leaves possible around `nominal`, where they are asked for.
    pub fn draws(
        &self,
        motor: &Motor,
        flavour: Flavour,
        nominal: &Parameters,
        exact: &[String],
    ) -> Result<Option<Vec<Parameters>>> {
        let Some(count) = self.uncertainty else { return Ok(None) };
        if !(20..=100_000).contains(&count) {
            bail!("--uncertainty {count} is outside 20 ..= 100000 draws");
        }
        Ok(Some(draws(motor, flavour, nominal, exact, count, self.uncertainty_seed)?))
    }

    /// What the JSON says of a band: how it was drawn, and `bands`.
    pub fn json(&self, bands: Value) -> Value {
        let mut told = json!({ "draws": self.uncertainty, "seed": self.uncertainty_seed });
        if let (Some(told), Value::Object(bands)) = (told.as_object_mut(), bands) {
            told.extend(bands);
        }
        told
    }

    /// How a line says it.
    pub fn words(&self) -> String {
        format!("95 % of {} motors of seed {}", self.uncertainty.unwrap_or(0), self.uncertainty_seed)
    }
}
