//! `twum driver`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum driver`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum driver`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum driver` is not built yet")
}
