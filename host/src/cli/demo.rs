//! `twum demo`.

use anyhow::{Result, bail};
use std::process::ExitCode;

/// Arguments of `twum demo`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs `twum demo`.
pub fn run(_args: Args) -> Result<ExitCode> {
    bail!("`twum demo` is not built yet")
}
