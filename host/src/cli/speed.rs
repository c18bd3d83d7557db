//! `twum speed`.

use super::configuration::ConfigurationArgs;
use super::connect::{ConnectArgs, RecordArgs};
use super::units;
use anyhow::{Context, Result};
use std::process::ExitCode;
use twum_host::link::bench::Action;
use twum_host::record::series::speed_run;
use twum_shared::Direction;

/// Arguments of `twum speed`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum speed --port /dev/ttyUSB0 --duty 0.5 --seconds 5 --out d50.mcap\n  \
                        twum speed --port sim --duty 1 --direction ccw --seconds 2")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    configuration: ConfigurationArgs,
    #[command(flatten)]
    record: RecordArgs,
    /// Fraction of the PWM period with the drive on: 0 to 1, or such as 50%
    #[arg(long, allow_hyphen_values = true)]
    duty: String,
    /// Direction of rotation
    #[arg(long, value_enum, default_value = "cw")]
    direction: Way,
    /// How long the drive is on, s
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Way {
    Cw,
    Ccw,
}

/// Runs `twum speed`.
pub fn run(args: Args) -> Result<ExitCode> {
    let duty = units::duty(&args.duty).context("--duty")?;
    let direction = match args.direction {
        Way::Cw => Direction::Cw,
        Way::Ccw => Direction::Ccw,
    };
    let run = speed_run(duty, direction, args.seconds)?;
    super::run::make(&args.connect, &args.configuration, &args.record, |_| Ok(Action::Speed(run)))
}
