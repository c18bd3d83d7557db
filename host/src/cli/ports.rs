//! `twum ports`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum ports`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum ports`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum ports` is not built yet")
}
