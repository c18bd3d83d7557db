//! `twum model`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum model`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum model`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum model` is not built yet")
}
