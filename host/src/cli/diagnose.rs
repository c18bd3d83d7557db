//! `twum diagnose`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum diagnose`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum diagnose`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum diagnose` is not built yet")
}
