//! `twum demo`.

use super::output::{print_table, stage};
use anyhow::{Context, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::demo;
use twum_host::demo::hidden::Hide;

/// Arguments of `twum demo`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  twum demo\n  twum demo --hide dead-zone --seed 7\n  twum demo --out first-look --json"
)]
pub struct Args {
    /// Folder to make; the first free of `demo`, `demo-2`, ... when not given
    #[arg(long)]
    out: Option<PathBuf>,
    /// Effect to hide in the motor: its name, `random`, or `none`
    #[arg(long, value_name = "NAME", default_value = "random")]
    hide: Hide,
    /// Seed of what is hidden [default: another each time, printed]
    #[arg(long)]
    seed: Option<u64>,
    /// Print the controllers' table as JSON; what was hidden and found is in the folder's diagnosis.json
    #[arg(long)]
    json: bool,
}

/// Runs `twum demo`.
pub fn run(args: Args) -> Result<ExitCode> {
    let folder = args.out.unwrap_or_else(first_free);
    let waiting = stage("beginning");
    let seed = args.seed.unwrap_or_else(any_seed);
    let found = demo::run(&folder, &args.hide, seed, |what| waiting.set_message(what.to_owned()))
        .with_context(|| format!("the demo in {} did not finish", folder.display()))?;
    waiting.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found.controllers)?);
    } else {
        println!("{}\n", found.diagnosis.sentence);
        println!("hidden: {} (seed {seed})\n", found.diagnosis.hidden.as_deref().unwrap_or("nothing"));
        print_table(&demo::table_header(), &demo::table_rows(&found.controllers));
    }
    eprintln!("wrote {}: open {}", folder.display(), folder.join("report.html").display());
    let good = found.controllers.iter().all(|summary| summary.replay.is_exact() && summary.link.is_lossless());
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// A seed that is short enough to be typed again.
fn any_seed() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::from(now.subsec_micros())
}

fn first_free() -> PathBuf {
    let numbered = (2..).map(|number| PathBuf::from(format!("demo-{number}")));
    std::iter::once(PathBuf::from("demo")).chain(numbered).find(|path| !path.exists()).unwrap_or_default()
}
