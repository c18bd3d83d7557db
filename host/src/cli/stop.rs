//! `twum stop`.

use super::connect::{ConnectArgs, Reached};
use anyhow::Result;
use std::process::ExitCode;
use twum_host::link::relay;

/// Arguments of `twum stop`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum stop --port /dev/ttyUSB0")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs `twum stop`.
pub fn run(args: Args) -> Result<ExitCode> {
    let mut session = match args.connect.session_or(relay::stop_through)? {
        Reached::Port(session) => session,
        Reached::Through(()) => {
            println!("stopped, through the program that holds the port; the board acknowledged it");
            return Ok(ExitCode::SUCCESS);
        }
    };
    // Off first; which fault it was is asked before it is cleared.
    session.halt()?;
    let fault = session.hello()?.fault;
    session.stop()?;
    match fault {
        Some(fault) => println!("stopped; cleared {fault:?}: {fault}"),
        None => println!("stopped"),
    }
    Ok(ExitCode::SUCCESS)
}
