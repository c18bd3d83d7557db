//! `twum demo`.

use super::output::{print_table, spinner};
use anyhow::{Context, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::demo;

/// Arguments of `twum demo`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum demo\n  twum demo --out first-look --json")]
pub struct Args {
    /// Folder to make; the first free of `demo`, `demo-2`, ... when not given
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum demo`.
pub fn run(args: Args) -> Result<ExitCode> {
    let folder = args.out.unwrap_or_else(first_free);
    let spinner = spinner();
    let summaries = demo::run(&folder, |what| spinner.set_message(what.to_owned()))
        .with_context(|| format!("the demo in {} did not finish", folder.display()))?;
    spinner.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&summaries)?);
    } else {
        print_table(&demo::table_header(), &demo::table_rows(&summaries));
    }
    eprintln!("wrote {}: open {}", folder.display(), folder.join("report.html").display());
    let good = summaries.iter().all(|summary| summary.replay.is_exact() && summary.link.is_lossless());
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn first_free() -> PathBuf {
    let numbered = (2..).map(|number| PathBuf::from(format!("demo-{number}")));
    std::iter::once(PathBuf::from("demo")).chain(numbered).find(|path| !path.exists()).unwrap_or_default()
}
