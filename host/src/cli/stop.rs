//! `twum stop`.

use super::connect::{ConnectArgs, Reached};
use super::output::answer;
use anyhow::Result;
use serde_json::json;
use std::process::ExitCode;
use twum_host::link::relay;

/// Arguments of `twum stop`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum stop --port /dev/ttyUSB0")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum stop`.
pub fn run(args: Args) -> Result<ExitCode> {
    let mut session = match args.connect.session_or(relay::stop_through)? {
        Reached::Port(session) => session,
        Reached::Through(()) => {
            let words = "stopped, through the program that holds the port; the board acknowledged it";
            answer(args.json, &json!({ "stopped": true, "through": "holder", "cleared": null }), words);
            return Ok(ExitCode::SUCCESS);
        }
    };
    // Off first; which fault it was is asked before it is cleared.
    session.halt()?;
    let fault = session.hello()?.fault;
    session.stop()?;
    let words = fault.map_or("stopped".to_owned(), |fault| format!("stopped; cleared {fault:?}: {fault}"));
    let cleared = fault.map(|fault| format!("{fault:?}"));
    answer(args.json, &json!({ "stopped": true, "through": "port", "cleared": cleared }), &words);
    Ok(ExitCode::SUCCESS)
}
