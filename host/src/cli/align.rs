//! `twum align`.

use super::connect::ConnectArgs;
use super::output::spinner;
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
}

/// Runs `twum align`.
pub fn run(args: Args) -> Result<ExitCode> {
    let mut session = args.connect.session()?;
    let spinner = spinner();
    spinner.set_message("aligning");
    align(&mut session)?;
    spinner.finish_and_clear();
    println!("aligned: the rotor stands at the beginning of an encoder pulse, and counts as zero");
    Ok(ExitCode::SUCCESS)
}
