//! One flavour argument for every command.

use twum_host::model::parameters::Flavour;

/// Which reading of the motor model is meant.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct FlavourArgs {
    /// Reading of the motor model [default: physical]
    #[arg(long, value_enum)]
    flavour: Option<Flavour>,
}

impl FlavourArgs {
    /// The one asked for, or the default.
    pub fn get(self) -> Flavour {
        self.flavour.unwrap_or_default()
    }

    /// Whether one was asked for.
    pub fn is_given(self) -> bool {
        self.flavour.is_some()
    }
}
