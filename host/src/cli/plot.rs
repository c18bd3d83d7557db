//! `twum plot`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum plot`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum plot`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum plot` is not built yet")
}
