//! `twum sim`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum sim`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum sim`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum sim` is not built yet")
}
