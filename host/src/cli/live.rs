//! `twum live`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum live`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum live`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum live` is not built yet")
}
