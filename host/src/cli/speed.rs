//! `twum speed`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum speed`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum speed`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum speed` is not built yet")
}
