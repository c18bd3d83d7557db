//! `twum align`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum align`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum align`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum align` is not built yet")
}
