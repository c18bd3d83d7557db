//! `twum capture`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum capture`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum capture`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum capture` is not built yet")
}
