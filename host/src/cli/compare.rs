//! `twum compare`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum compare`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum compare`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum compare` is not built yet")
}
