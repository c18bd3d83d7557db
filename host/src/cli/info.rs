//! `twum info`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum info`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum info`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum info` is not built yet")
}
