//! `twum experiment`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum experiment`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum experiment`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum experiment` is not built yet")
}
