//! `twum neck`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum neck`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum neck`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum neck` is not built yet")
}
