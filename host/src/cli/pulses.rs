//! `twum experiment pulses`.

use super::diagnose::runs_of;
use super::output::print_table;
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::pulses::judge;

/// Arguments of `twum experiment pulses`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  twum experiment run --pulses --port /dev/ttyUSB0 --out pulses\n  twum experiment pulses pulses"
)]
pub struct Args {
    /// Folder of runs with pulses of different lengths
    folder: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum experiment pulses`.
pub fn run(args: &Args) -> Result<ExitCode> {
    let found = judge(&runs_of(&args.folder)?.0)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found)?);
        return Ok(ExitCode::SUCCESS);
    }
    let rows: Vec<Vec<String>> = found
        .pulses
        .iter()
        .chain(&found.one_by_one)
        .map(|pulse| {
            let said = if pulse.followed { "yes" } else { "no" };
            vec![
                format!("{}", pulse.pulse_ms),
                format!("{}", pulse.every_ms),
                format!("{:.0}", pulse.edges_s),
                format!("{:.2}", pulse.share),
                said.to_owned(),
            ]
        })
        .collect();
    print_table(&["pulse (ms)", "every (ms)", "edges/s", "of the longest", "followed"], &rows);
    println!("a gated drive needs shortest_pulse_ticks = {} or more here", found.shortest_pulse_ticks);
    if let Some(ticks) = found.shortest_planned_ticks {
        println!("a planned one, with a pulse every 20 ms, needs {ticks} or more");
    }
    Ok(ExitCode::SUCCESS)
}
