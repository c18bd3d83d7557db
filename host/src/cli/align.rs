//! `twum align`.

use super::connect::ConnectArgs;
use super::output::{answer, stage};
use anyhow::Result;
use std::process::ExitCode;
use twum_host::link::bench::align;

/// Arguments of `twum align`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Leaves the driver board in hardware mode: any number of runs may follow, and only cycling its power ends \
                        it.\n\nExamples:\n  twum align --port /dev/ttyUSB0"
)]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum align`.
pub fn run(args: Args) -> Result<ExitCode> {
    let mut session = args.connect.session()?;
    let waiting = stage("aligning, some seconds");
    align(&mut session)?;
    waiting.finish_and_clear();
    let words = "aligned: the rotor stands at the beginning of an encoder pulse, and counts as zero";
    answer(args.json, &serde_json::json!({ "aligned": true }), words);
    Ok(ExitCode::SUCCESS)
}
