//! `twum export`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum export`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum export`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum export` is not built yet")
}
