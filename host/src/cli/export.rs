//! `twum export`.

use super::existing::ExistingArgs;
use super::output::stage;
use anyhow::{Context, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::model::motor::Motor;
use twum_host::record::export::{EncoderSource, to_measurement, write_csv, write_mcap};
use twum_host::record::recording::Recording;

/// Arguments of `twum export`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum export run.mcap --to csv tables       control.csv, edges.csv, bits.csv, ... in a new folder
  twum export run.mcap --to mcap signals.mcap
                                             decoded signals with schemas, for Foxglove or PlotJuggler
  twum export run.mcap --to folder bench3    a measurement folder for `twum compare` and `twum diagnose`

The recording itself is never changed, and folders are never overwritten.")]
pub struct Args {
    /// Recording made by `twum capture`, `twum speed` or `twum track`
    recording: PathBuf,
    /// What to make of it
    #[arg(long, value_enum)]
    to: Target,
    /// New folder (csv, folder) or file (mcap)
    out: PathBuf,
    /// Encoder data of open-loop runs in a measurement folder, where both were captured
    #[arg(long, value_enum, default_value = "edges")]
    encoder: Encoder,
    /// Motor of a measurement folder, instead of the one the recording holds
    #[arg(long, value_name = "NAME|FILE")]
    motor: Option<String>,
    #[command(flatten)]
    existing: ExistingArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Target {
    Csv,
    Mcap,
    Folder,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Encoder {
    Edges,
    Bits,
}

/// Runs `twum export`.
pub fn run(args: Args) -> Result<ExitCode> {
    let motor = args.motor.as_deref().map(Motor::kept).transpose()?;
    let waiting = stage("reading and writing");
    let mut recording = Recording::load(&args.recording)?;
    if let Some(motor) = motor {
        recording.metadata.motor = motor;
    }
    for line in recording.losses() {
        eprintln!("warning: {}: {line}", args.recording.display());
    }
    let done = match args.to {
        Target::Csv => write_csv(&recording, &args.out).map(|()| Vec::new()),
        Target::Mcap => write_mcap(&recording, &args.out, args.existing.into()).map(|()| Vec::new()),
        Target::Folder => {
            let name = args.recording.file_stem().map_or_else(Default::default, |stem| stem.to_string_lossy());
            let source = match args.encoder {
                Encoder::Edges => EncoderSource::Edges,
                Encoder::Bits => EncoderSource::Bits,
            };
            to_measurement(&recording, &name, source).and_then(|(measurement, notes)| {
                measurement.save(&args.out)?;
                Ok(notes)
            })
        }
    };
    waiting.finish_and_clear();
    let notes = done.with_context(|| format!("cannot export {}", args.recording.display()))?;
    for note in &notes {
        eprintln!("note: {note}");
    }
    eprintln!("wrote {}", args.out.display());
    if args.json {
        println!("{}", serde_json::json!({ "wrote": args.out, "losses": recording.losses(), "notes": notes }));
    }
    Ok(ExitCode::SUCCESS)
}
