//! `twum plot`.

use super::output::stage;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::plot::{measurement_figure, recording_figure};
use twum_host::record::load::load_runs;

/// Arguments of `twum plot`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum plot sine.mcap sine.svg               position, error, speed and duty of a recording
  twum plot bench3 bench3.png                every run of a measurement folder
  twum plot bench3 d50.png --run d50-cw-0    every quantity of one run

Gaps in the data are gaps in the lines. The same file gives the same picture, byte for byte. No display is needed.")]
pub struct Args {
    /// Recording or measurement folder
    input: PathBuf,
    /// Picture to write: .svg, .png, or a page to zoom in, .html
    out: PathBuf,
    /// Run of a measurement folder
    #[arg(long)]
    run: Option<String>,
    /// Width and height in pixels, as 1000x1200
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    /// Print as JSON what was written and what is missing in it
    #[arg(long)]
    json: bool,
}

/// Runs `twum plot`.
pub fn run(args: Args) -> Result<ExitCode> {
    let waiting = stage("reading");
    let (mut figure, losses) = if args.input.is_dir() {
        (measurement_figure(&load_runs(&args.input)?.0, args.run.as_deref())?, Vec::new())
    } else {
        if args.run.is_some() {
            bail!("--run chooses a run of a measurement folder; {} is a recording", args.input.display());
        }
        let title = args.input.file_stem().map_or_else(Default::default, |stem| stem.to_string_lossy());
        recording_figure(&args.input, &title)?
    };
    for line in &losses {
        eprintln!("warning: {}: {line}", args.input.display());
    }
    waiting.finish_and_clear();
    if let Some(size) = &args.size {
        let (width, height) = size
            .split_once('x')
            .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)))
            .with_context(|| format!("--size {size}: give it as WIDTHxHEIGHT, such as 1000x1200"))?;
        figure = figure.size(width, height);
    }
    figure.write(&args.out)?;
    eprintln!("wrote {}", args.out.display());
    if args.json {
        println!("{}", serde_json::json!({ "wrote": args.out, "losses": losses }));
    }
    Ok(ExitCode::SUCCESS)
}
