//! `twum replay`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum replay`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum replay`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum replay` is not built yet")
}
