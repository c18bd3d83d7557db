//! `twum velocity`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum velocity`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum velocity`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum velocity` is not built yet")
}
