//! `twum import`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum import`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum import`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum import` is not built yet")
}
