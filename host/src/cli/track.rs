//! `twum track`.

use super::connect::{ALL_STREAMS, ConfigurationArgs, ConnectArgs, RecordArgs, duration_ms};
use super::output::spinner;
use anyhow::{Context, Result, anyhow};
use std::process::ExitCode;
use twum_host::link::bench::{Action, Experiment};
use twum_shared::message::TrackRun;
use twum_shared::reference::{Reference, WayPoint};

/// Arguments of `twum track`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum track --port /dev/ttyUSB0 --control thesis --out sine.mcap\n  \
                        twum track --port sim --path 100:3,100:5,0:3 --seconds 11")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    configuration: ConfigurationArgs,
    #[command(flatten)]
    record: RecordArgs,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// How long to track, s
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
}

/// What to track; the thesis's sine when nothing is given.
#[derive(Debug, clap::Args)]
#[group(multiple = false)]
struct ReferenceArgs {
    /// AMPLITUDE,OMEGA: a sine in counts and rad/s [default: 89,1.257]
    #[arg(long, allow_hyphen_values = true)]
    sine: Option<String>,
    /// COUNTS: a step at the start
    #[arg(long, allow_hyphen_values = true)]
    step: Option<i32>,
    /// RATE,LIMIT: a ramp in counts/s up to so many counts
    #[arg(long, allow_hyphen_values = true)]
    ramp: Option<String>,
    /// COUNTS:SECONDS,...: quintics through way points, each with the time to get there
    #[arg(long, allow_hyphen_values = true)]
    path: Option<String>,
}

impl ReferenceArgs {
    fn reference(&self) -> Result<Reference> {
        let reference = if let Some(position) = self.step {
            Reference::Step { position, at_us: 0 }
        } else if let Some(text) = &self.ramp {
            let (rate, limit) = pair(text, ',').context("--ramp is RATE,LIMIT")?;
            Reference::Ramp { rate: rate as i32, limit: limit as u32 }
        } else if let Some(text) = &self.path {
            let points: Vec<WayPoint> = text.split(',').map(way_point).collect::<Result<_>>()?;
            let way_points = heapless::Vec::from_slice(&points)
                .map_err(|_| anyhow!("--path has {} way points, at most 16 fit", points.len()))?;
            Reference::Path { start: 0, way_points }
        } else {
            let (amplitude, omega) =
                pair(self.sine.as_deref().unwrap_or("89,1.257"), ',').context("--sine is AMPLITUDE,OMEGA")?;
            Reference::Sine { amplitude: amplitude as i32, omega_urad_s: (omega * 1e6).round() as u32 }
        };
        reference.validate()?;
        Ok(reference)
    }
}

fn pair(text: &str, separator: char) -> Result<(f64, f64)> {
    let (first, second) = text.split_once(separator).with_context(|| format!("`{text}` has no `{separator}`"))?;
    let number = |word: &str| {
        let value: f64 = word.trim().parse().with_context(|| format!("`{word}` is not a number"))?;
        if value.is_finite() { Ok(value) } else { Err(anyhow!("`{word}` is not finite")) }
    };
    Ok((number(first)?, number(second)?))
}

fn way_point(text: &str) -> Result<WayPoint> {
    let (position, seconds) = pair(text, ':').context("a way point is COUNTS:SECONDS")?;
    if !(0.0..=4000.0).contains(&seconds) {
        return Err(anyhow!("way point `{text}`: {seconds} s is outside 0 to 4000 s"));
    }
    Ok(WayPoint { position: position as i32, duration_us: (seconds * 1e6).round() as u32 })
}

/// Runs `twum track`.
pub fn run(args: Args) -> Result<ExitCode> {
    let reference = args.reference.reference()?;
    let experiment = Experiment {
        configuration: None,
        capture: ALL_STREAMS,
        action: Action::Track(TrackRun { reference, duration_ms: duration_ms(args.seconds)? }),
        recording: args.record.out.clone(),
        motor: args.configuration.motor()?,
    };
    let spinner = spinner();
    spinner.set_message("tracking");
    let outcome = args.connect.perform_with(&args.configuration, experiment, |_| {})?;
    spinner.finish_and_clear();
    args.record.conclude(&outcome)
}
