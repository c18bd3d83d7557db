//! `twum speed`.

use super::connect::{ALL_STREAMS, ConfigurationArgs, ConnectArgs, RecordArgs, duration_ms};
use super::output::spinner;
use anyhow::{Result, bail};
use std::process::ExitCode;
use twum_host::link::bench::{Action, Experiment};
use twum_shared::message::SpeedRun;
use twum_shared::{Direction, Duty};

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
    /// Fraction of the PWM period with the drive on, 0 to 1
    #[arg(long)]
    duty: f64,
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
    if !(0.0..=1.0).contains(&args.duty) {
        bail!("duty {} is outside 0 to 1: it is the fraction of the PWM period with the drive on", args.duty);
    }
    let duty = Duty::try_from((args.duty * f64::from(Duty::FULL.raw())).round() as u16)?;
    let direction = match args.direction {
        Way::Cw => Direction::Cw,
        Way::Ccw => Direction::Ccw,
    };
    let experiment = Experiment {
        configuration: None,
        capture: ALL_STREAMS,
        action: Action::Speed(SpeedRun { duty, direction, duration_ms: duration_ms(args.seconds)? }),
        recording: args.record.out.clone(),
        motor: args.configuration.motor()?,
    };
    let spinner = spinner();
    spinner.set_message("running");
    let outcome = args.connect.perform_with(&args.configuration, experiment, |_| {})?;
    spinner.finish_and_clear();
    args.record.conclude(&outcome)
}
