//! Arguments of every command that runs the motor: controller, bench and limits.

use super::motor::MotorArgs;
use super::{defaults, units};
use anyhow::{Context, Result};
use std::path::PathBuf;
use twum_host::configuration::{choose, controller, overlay_only_limits, validate};
use twum_host::input;
use twum_host::tune::margins::refuse_unstable;
use twum_shared::encoder::CountSign;
use twum_shared::message::Configuration;
use twum_shared::safety::Limits;

/// How to run the motor. What is not given is as the user's own defaults have it, or else as the board is configured; a board
/// without a configuration gets the default.
#[derive(Debug, clap::Args)]
pub struct ConfigurationArgs {
    /// Controller: `thesis`, `default`, `gated`, `planned`, or a TOML file: its `[control]` as `twum config dump` writes it, or gains [default: your
    /// own, or the board's]
    #[arg(long)]
    control: Option<String>,
    /// Encoder edges a revolution [default: your own, or the board's]
    #[arg(long)]
    edges_per_rev: Option<u16>,
    /// PWM frequency, Hz [default: your own, or the board's]
    #[arg(long)]
    pwm_hz: Option<u16>,
    /// TOML file of limits, or a whole configuration whose `[limits]` are taken
    #[arg(long, value_name = "FILE", help_heading = "Limits for this run")]
    limits: Option<PathBuf>,
    /// Largest position error while tracking: counts, or such as 20deg
    #[arg(long, value_name = "ANGLE", help_heading = "Limits for this run")]
    max_following_error: Option<String>,
    /// Positions allowed, counts or such as -90deg:90deg: MIN:MAX, or one angle for both sides
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true, help_heading = "Limits for this run")]
    position_bound: Option<String>,
    /// How long a driven motor may go without an encoder edge, ms
    #[arg(long, value_name = "MS", help_heading = "Limits for this run")]
    stall: Option<u16>,
    /// Fastest motion allowed: counts/s, or such as 60rpm
    #[arg(long, value_name = "SPEED", help_heading = "Limits for this run")]
    overspeed: Option<String>,
    /// Silence of this computer that stops the motor, ms
    #[arg(long, value_name = "MS", help_heading = "Limits for this run")]
    timeout: Option<u16>,
    /// Which way the count moves while the direction pin is high [default: your own, or the board's]
    #[arg(long, value_enum)]
    count_sign: Option<Sign>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Sign {
    Positive,
    Reversed,
}

impl ConfigurationArgs {
    /// `base` with what the user's own defaults and the command line say.
    pub fn over(&self, base: Configuration) -> Result<Configuration> {
        let own = defaults::load()?;
        let mut configuration = base;
        if let Some(limits) = own.limits {
            configuration = overlay_only_limits(&configuration, &toml::to_string(&limits)?)
                .with_context(|| defaults::path().map_or_else(|_| String::new(), |path| path.display().to_string()))?;
        }
        if let Some(file) = &self.limits {
            let text = input::text(file, input::WRITTEN).with_context(|| file.display().to_string())?;
            configuration = overlay_only_limits(&configuration, &text).with_context(|| file.display().to_string())?;
        }
        if let Some(control) = self.control.as_ref().or(own.control.as_ref()) {
            choose(&mut configuration, controller(control)?);
        }
        configuration.edges_per_rev = self.edges_per_rev.or(own.edges_per_rev).unwrap_or(configuration.edges_per_rev);
        configuration.pwm_hz = self.pwm_hz.or(own.pwm_hz).unwrap_or(configuration.pwm_hz);
        configuration.count_sign = match self.count_sign {
            Some(Sign::Positive) => CountSign::Positive,
            Some(Sign::Reversed) => CountSign::Reversed,
            None => configuration.count_sign,
        };
        self.limit(&mut configuration.limits, configuration.edges_per_rev)?;
        validate(&configuration)?;
        Ok(configuration)
    }

    fn limit(&self, limits: &mut Limits, edges_per_rev: u16) -> Result<()> {
        if let Some(bound) = &self.position_bound {
            (limits.position_min, limits.position_max) =
                position_bound(bound, edges_per_rev).context("--position-bound")?;
        }
        if let Some(error) = &self.max_following_error {
            limits.following_error_counts =
                units::amount(units::counts(error, edges_per_rev)).context("--max-following-error")?;
        }
        if let Some(speed) = &self.overspeed {
            limits.overspeed_counts_s = units::amount(units::counts_s(speed, edges_per_rev)).context("--overspeed")?;
        }
        limits.stall_ms = self.stall.unwrap_or(limits.stall_ms);
        limits.command_timeout_ms = self.timeout.unwrap_or(limits.command_timeout_ms);
        Ok(())
    }
}

/// Whether a controller that is unstable in the model may be had all the same.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct UnstableArgs {
    /// Take a controller of one's own that is unstable in the model of the motor too
    #[arg(long)]
    allow_unstable: bool,
}

impl UnstableArgs {
    /// Refuses a configuration whose controller swings, or runs away, in every reading of the motor.
    pub fn refuse(self, configuration: &Configuration, motor: &MotorArgs) -> Result<()> {
        if self.allow_unstable {
            return Ok(());
        }
        refuse_unstable(configuration, &motor.readings()?).context("--allow-unstable takes it all the same")
    }
}

fn position_bound(text: &str, edges_per_rev: u16) -> Result<(i32, i32)> {
    let number = |word: &str| units::whole(units::counts(word, edges_per_rev));
    match text.split_once(':') {
        Some((min, max)) => Ok((number(min)?, number(max)?)),
        None => {
            let both = number(text)?;
            Ok((both.saturating_neg(), both))
        }
    }
}
