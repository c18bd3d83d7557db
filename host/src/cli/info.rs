//! `twum info`.

use super::connect::{ConnectArgs, Reached};
use anyhow::Result;
use std::process::ExitCode;
use twum_host::input::printable;
use twum_host::link::relay;
use twum_shared::frame::PROTOCOL_VERSION;

/// Arguments of `twum info`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum info --port /dev/ttyUSB0 --json")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum info`.
pub fn run(args: Args) -> Result<ExitCode> {
    let identity = match args.connect.session_or(relay::hello_through)? {
        Reached::Port(mut session) => session.hello()?,
        Reached::Through(identity) => identity,
    };
    let rows = [
        ("protocol", PROTOCOL_VERSION.to_string()),
        ("firmware", printable(&identity.firmware)),
        ("chip", printable(&identity.chip)),
        ("reset", format!("{:?}", identity.reset)),
        ("mode", format!("{:?}", identity.mode)),
        ("fault", identity.fault.map_or("none".to_owned(), |fault| format!("{fault:?}"))),
    ];
    if args.json {
        // What is not there is null.
        let value = |(key, value): (&'static str, String)| {
            (key, Some(value).filter(|_| key != "fault" || identity.fault.is_some()))
        };
        println!("{}", serde_json::json!(std::collections::BTreeMap::from(rows.map(value))));
    } else {
        rows.iter().for_each(|(key, value)| println!("{key:<10}{value}"));
    }
    Ok(ExitCode::SUCCESS)
}
