//! Which motor is on the bench, or which one to simulate.

use super::defaults;
use super::flavour::FlavourArgs;
use anyhow::{Result, bail};
use std::path::PathBuf;
use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;
use twum_host::sim::{Setup, Simulated};

pub const DEFAULT_MOTOR: &str = "pcbmotor-30mm";
/// A motor of one time constant, for tests of the link and the loop.
pub const SIMPLE: &str = "simple";

/// Which motor is there, or which one to simulate.
#[derive(Clone, Debug, clap::Args)]
pub struct MotorArgs {
    /// Motor on the bench, a shipped one or a motor file: its content is kept in the recording. With `--port sim` the one
    /// simulated [default: the one the board simulates, or pcbmotor-30mm]
    #[arg(long, value_name = "NAME|FILE")]
    motor: Option<String>,
    #[command(flatten)]
    flavour: FlavourArgs,
    /// Effects to hide in a simulated motor: a file of [effects.NAME] tables, as in a motor file
    #[arg(long, value_name = "FILE")]
    effects: Option<PathBuf>,
}

impl MotorArgs {
    /// The board to simulate.
    pub fn simulated(&self) -> Result<Setup> {
        let hidden = self.effects.as_deref().map(Motor::effects_of_file).transpose()?.unwrap_or_default();
        let name = self.asked()?.unwrap_or_else(|| DEFAULT_MOTOR.to_owned());
        if name == SIMPLE {
            if self.flavour.is_given() || self.effects.is_some() {
                bail!("the motor `{SIMPLE}` has neither flavours nor effects");
            }
            return Ok(Setup::simple());
        }
        Ok(Setup::hybrid(&Motor::load(&name)?, self.flavour.get(), &hidden)?)
    }

    /// Refuses what only a simulated motor can have.
    pub fn is_of_a_real_board(&self) -> Result<()> {
        if self.flavour.is_given() || self.effects.is_some() {
            bail!("--flavour and --effects are of a simulated motor: give them to `twum sim`, or with --port sim");
        }
        Ok(())
    }

    /// The motors to hold a controller against before it runs: the file's that is named, or the shipped one, in the reading that is named,
    /// or in both of a rotor that is braked. None for the motor of tests, which has no file.
    pub fn readings(&self) -> Result<Vec<(Motor, Flavour)>> {
        let name = self.asked()?.unwrap_or_else(|| DEFAULT_MOTOR.to_owned());
        if name == SIMPLE {
            return Ok(Vec::new());
        }
        let motor = Motor::load(&name)?;
        let flavours = match self.flavour.is_given() {
            true => vec![self.flavour.get()],
            false => vec![Flavour::Measured, Flavour::Physical],
        };
        Ok(flavours.into_iter().map(|flavour| (motor.clone(), flavour)).collect())
    }

    /// The motor of the command line alone.
    pub fn named(&self) -> Option<&str> {
        self.motor.as_deref()
    }

    /// The motor of the command line, or else of the user's own defaults.
    fn asked(&self) -> Result<Option<String>> {
        Ok(self.motor.clone().or(defaults::load()?.motor))
    }

    /// Refuses a board that simulates an encoder of another number of edges than it is configured with: every angle would be
    /// wrong by their ratio.
    pub fn has_edges(&self, chip: &str, edges_per_rev: u16) -> Result<()> {
        let Some(simulated) = Simulated::parse(chip).filter(|it| it.motor != SIMPLE) else { return Ok(()) };
        let motor = Motor::load(&self.asked()?.unwrap_or(simulated.motor))?;
        if motor.edges_per_rev != u32::from(edges_per_rev) {
            bail!(
                "the board simulates `{}`, whose encoder has {} edges a revolution, and is configured with {edges_per_rev}: \
                 give --edges-per-rev {}",
                motor.name,
                motor.edges_per_rev,
                motor.edges_per_rev
            );
        }
        Ok(())
    }

    /// What the recording keeps of the motor: the one asked for, which a simulated board must not contradict. `chip` is what
    /// the board says of itself.
    pub fn kept(&self, chip: &str) -> Result<String> {
        let simulated = Simulated::parse(chip);
        let Some(asked) = &self.asked()? else {
            let name = simulated.map_or_else(|| DEFAULT_MOTOR.to_owned(), |it| it.motor);
            if name != SIMPLE && Motor::shipped(&name).is_err() {
                bail!(
                    "the board simulates `{name}`, which is no shipped motor: give its file with --motor, for the recording"
                );
            }
            return Ok(name);
        };
        let name = if asked == SIMPLE { SIMPLE.to_owned() } else { Motor::load(asked)?.name };
        match simulated {
            Some(it) if it.motor != name => {
                bail!("--motor {asked}: the board simulates `{}`; leave --motor out, or name that one", it.motor)
            }
            None if name == SIMPLE => bail!("--motor {SIMPLE} is a simulated motor, and this board is a real one"),
            _ if name == SIMPLE => Ok(name),
            _ => Ok(Motor::kept(asked)?),
        }
    }
}
