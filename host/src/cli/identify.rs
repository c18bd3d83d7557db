//! `twum identify`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum identify`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum identify`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum identify` is not built yet")
}
