//! `twum driver`.

use super::connect::{ALL_STREAMS, ConnectArgs, RecordArgs};
use anyhow::{Context, Result};
use std::io::Write;
use std::process::ExitCode;
use twum_host::input::printable;
use twum_host::link::bench::{Action, Experiment};
use twum_shared::message::DeviceMessage;

/// Arguments of `twum driver`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Works only while the driver board is in its text mode: before alignment, or after its power was cycled. Motion is \
                        passed on in pieces of 20 microsteps: Ctrl-C and `twum stop` end it within one, and a minute ends it in any \
                        case.\n\n\
                        Examples:\n  twum driver --port /dev/ttyUSB0 ap\n  twum driver --port sim 'u100,ap' --out step.mcap"
)]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    record: RecordArgs,
    /// Commands for the driver board, joined by commas
    line: String,
}

/// Runs `twum driver`.
pub fn run(args: Args) -> Result<ExitCode> {
    twum_shared::driver::parse(&args.line)
        .with_context(|| format!("`{}` is not a line of driver commands", args.line))?;
    let line = heapless::String::try_from(args.line.as_str()).ok().context("the line is longer than 64 characters")?;
    let experiment = Experiment {
        configuration: None,
        capture: ALL_STREAMS,
        action: Action::Driver(line),
        recording: args.record.out.clone(),
        motor: String::new(),
    };
    let mut replies = Vec::new();
    let outcome = args.connect.perform(experiment, |received| {
        if let DeviceMessage::DriverReply(bytes) = &received.message {
            let reply = String::from_utf8_lossy(bytes);
            let lines: Vec<String> = reply.split('\n').map(|line| printable(line.trim_end_matches('\r'))).collect();
            if !args.record.json {
                // A closed stdout ends the printing, not the capture.
                let _ = std::io::stdout().write_all(lines.join("\n").as_bytes());
            }
            replies.extend(lines.into_iter().filter(|line| !line.is_empty()));
        }
    })?;
    args.record.conclude(&outcome, None, Some(&replies))
}
