//! `twum reboot`.

use super::connect::ConnectArgs;
use super::output::answer;
use anyhow::{Result, bail};
use std::process::ExitCode;
use std::time::Duration;

/// A board answers again within this time of its restart: the boot loader's 0.4 s, and what `hello` itself waits.
const AWAY: Duration = Duration::from_millis(500);

/// Arguments of `twum reboot`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum reboot --port /dev/ttyUSB0")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum reboot`.
pub fn run(args: Args) -> Result<ExitCode> {
    let mut session = args.connect.session()?;
    session.hello()?;
    session.reboot()?;
    // What the board still says before it restarts is not its answer afterwards.
    let until = session.port().elapsed() + AWAY;
    loop {
        let left = until.saturating_sub(session.port().elapsed());
        if session.next(left)?.is_none() {
            break;
        }
    }
    let identity = session.hello()?;
    if session.tally().restarts == 0 {
        bail!("the board took the command and did not restart");
    }
    let [reset, mode] = [format!("{:?}", identity.reset), format!("{:?}", identity.mode)];
    let words = format!("restarted: {reset}; mode {mode}; alignment is lost, the kept configuration is not");
    answer(args.json, &serde_json::json!({ "restarted": true, "reset": reset, "mode": mode }), &words);
    Ok(ExitCode::SUCCESS)
}
