//! `twum track`.

use super::configuration::{ConfigurationArgs, UnstableArgs};
use super::connect::{ConnectArgs, RecordArgs};
use super::units;
use anyhow::{Context, Result, anyhow};
use std::process::ExitCode;
use twum_host::link::bench::Action;
use twum_host::record::series::duration_ms;
use twum_shared::message::{Configuration, TrackRun};
use twum_shared::reference::{Reference, WayPoint};
use twum_shared::step::ConfigSpec;

/// Arguments of `twum track`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum track --port /dev/ttyUSB0 --control thesis --out sine.mcap\n  \
                        twum track --port sim --path 90deg:3,90deg:5,0:3 --seconds 11")]
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
    #[command(flatten)]
    unstable: UnstableArgs,
}

/// What to track; the thesis's sine when nothing is given.
#[derive(Debug, clap::Args)]
#[group(multiple = false)]
struct ReferenceArgs {
    /// AMPLITUDE,OMEGA: a sine, of an angle (counts, or such as 80deg or 0.2turn) and rad/s [default: 89,1.257]
    #[arg(long, allow_hyphen_values = true)]
    sine: Option<String>,
    /// ANGLE: a step at the start
    #[arg(long, allow_hyphen_values = true)]
    step: Option<String>,
    /// SPEED,ANGLE: a ramp in counts/s (or such as 10rpm or 60deg/s) up to an angle
    #[arg(long, allow_hyphen_values = true)]
    ramp: Option<String>,
    /// ANGLE:SECONDS,...: quintics through way points, each with the time to get there
    #[arg(long, allow_hyphen_values = true)]
    path: Option<String>,
}

impl ReferenceArgs {
    fn reference(&self, edges: u16) -> Result<Reference> {
        let counts = |text: &str| units::whole(units::counts(text, edges));
        let reference = if let Some(text) = &self.step {
            Reference::Step { position: counts(text).context("--step")?, at_us: 0 }
        } else if let Some(text) = &self.ramp {
            let (rate, limit) = pair(text, ',').context("--ramp is SPEED,ANGLE")?;
            let rate = units::whole(units::counts_s(rate, edges)).context("--ramp")?;
            let limit = counts(limit).context("--ramp")?;
            Reference::Ramp { rate, limit: u32::try_from(limit).context("--ramp: the angle is an amount")? }
        } else if let Some(text) = &self.path {
            let points: Vec<WayPoint> = text.split(',').map(|text| way_point(text, edges)).collect::<Result<_>>()?;
            let way_points = heapless::Vec::from_slice(&points)
                .map_err(|_| anyhow!("--path has {} way points, at most 16 fit", points.len()))?;
            Reference::Path { start: 0, way_points }
        } else {
            let (amplitude, omega) =
                pair(self.sine.as_deref().unwrap_or("89,1.257"), ',').context("--sine is AMPLITUDE,OMEGA")?;
            let omega: f64 = omega.trim().parse().with_context(|| format!("--sine: `{omega}` is not a number"))?;
            units::sine(counts(amplitude).context("--sine")?, omega).context("--sine")?
        };
        reference.validate()?;
        Ok(reference)
    }
}

fn pair(text: &str, separator: char) -> Result<(&str, &str)> {
    text.split_once(separator).with_context(|| format!("`{text}` has no `{separator}`"))
}

fn way_point(text: &str, edges: u16) -> Result<WayPoint> {
    let (position, seconds) = pair(text, ':').context("a way point is ANGLE:SECONDS")?;
    let position = units::whole(units::counts(position, edges)).with_context(|| format!("way point `{text}`"))?;
    let seconds: f64 =
        seconds.trim().parse().with_context(|| format!("way point `{text}`: `{seconds}` is not a number"))?;
    if !(0.0..=4000.0).contains(&seconds) {
        return Err(anyhow!("way point `{text}`: {seconds} s is outside 0 to 4000 s"));
    }
    Ok(WayPoint { position, duration_us: (seconds * 1e6).round() as u32 })
}

/// Runs `twum track`.
pub fn run(args: Args) -> Result<ExitCode> {
    let duration_ms = duration_ms(args.seconds)?;
    // Before the board is touched: what it holds itself was looked at when it was loaded.
    let asked = args.configuration.over(Configuration::with_control(ConfigSpec::DEFAULT))?;
    args.unstable.refuse(&asked, args.connect.motor_args())?;
    super::run::make(&args.connect, &args.configuration, &args.record, |configuration| {
        let reference = args.reference.reference(configuration.edges_per_rev)?;
        Ok(Action::Track(TrackRun { reference, duration_ms }))
    })
}
