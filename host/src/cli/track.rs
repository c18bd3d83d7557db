//! `twum track`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum track`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum track`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum track` is not built yet")
}
