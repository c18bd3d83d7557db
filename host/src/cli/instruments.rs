//! `twum instruments`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum instruments`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum instruments`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum instruments` is not built yet")
}
