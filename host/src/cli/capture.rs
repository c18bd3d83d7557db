//! `twum capture`.

use super::connect::{ConnectArgs, RecordArgs};
use super::output::stage;
use anyhow::{Context, Result};
use std::process::ExitCode;
use std::time::Duration;
use twum_host::link::bench::{Action, Experiment};
use twum_host::record::series::duration_ms;
use twum_shared::message::CaptureMode;

/// Arguments of `twum capture`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Records what the board streams, without moving the motor. Ctrl-C ends it cleanly; an unplugged cable is \
                        waited for.\n\nExamples:\n  twum capture --port /dev/ttyUSB0 --out hand-turned.mcap --seconds 30"
)]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    record: RecordArgs,
    /// How long, s
    #[arg(long, default_value_t = 3600.0)]
    seconds: f64,
    /// Streams to capture
    #[arg(long, value_enum, value_delimiter = ',', num_args = 1.., default_values_t = [Stream::Bits, Stream::Edges, Stream::Control])]
    streams: Vec<Stream>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Stream {
    /// The encoder level at 1 kHz
    Bits,
    /// Every encoder edge with its time
    Edges,
    /// Every control tick
    Control,
}

/// Runs `twum capture`.
pub fn run(args: Args) -> Result<ExitCode> {
    let has = |stream| args.streams.contains(&stream);
    let experiment = Experiment {
        configuration: None,
        capture: CaptureMode { bits: has(Stream::Bits), edges: has(Stream::Edges), control: has(Stream::Control) },
        action: Action::Watch(Duration::from_millis(duration_ms(args.seconds)?.into())),
        recording: Some(args.record.out.clone().context("say where to record with --out FILE")?),
        motor: String::new(),
    };
    let waiting = stage(format!("0 frames of {} s", args.seconds));
    let mut frames = 0u64;
    let outcome = args.connect.perform(experiment, |_| {
        frames += 1;
        if frames.is_multiple_of(10) {
            waiting.set_message(format!("{frames} frames of {} s", args.seconds));
        }
    })?;
    waiting.finish_and_clear();
    args.record.conclude(&outcome, None, None)
}
