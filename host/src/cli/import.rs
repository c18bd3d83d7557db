//! `twum import`.

use super::output::print_table;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::record::check::{FolderCheck, RunCheck, check};
use twum_host::record::convert::{to_edges, to_levels};
use twum_host::record::load::measurement_folder;
use twum_host::record::measurement::{Direction, MANIFEST, Measurement, RunData};

/// Arguments of `twum import`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum import bench3                        check every file and print what is in it
  twum import bench3 --json                 the same for another program
  twum import june21 --direction cw         the thesis's own Duty_05_0.txt files, without measurement.toml
  twum import june21 --direction cw --to june21-folder --as edges
                                            ... rewritten as a measurement folder of edges

An error names file, line and column, and the exit code is 2.")]
pub struct Args {
    /// Measurement folder
    folder: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Read `Duty_<d>_<n>.txt` files where there is no measurement.toml; they do not say in which direction the motor turned
    #[arg(long, value_enum)]
    direction: Option<DirectionArg>,
    /// Write the measurement into this new folder
    #[arg(long, value_name = "FOLDER")]
    to: Option<PathBuf>,
    /// Convert encoder data between sampled levels and edges on the way (`packed` becomes levels by itself)
    #[arg(long = "as", value_enum, requires = "to", value_name = "FORMAT")]
    convert: Option<Encoder>,
    /// Sampling period of `--as levels` in µs
    #[arg(long, default_value_t = 1000.0, value_name = "US")]
    period_us: f64,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum DirectionArg {
    Cw,
    Ccw,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Encoder {
    Levels,
    Edges,
}

/// Runs `twum import`.
pub fn run(args: Args) -> Result<ExitCode> {
    if !(args.period_us >= 1.0 && args.period_us <= 1e6) {
        bail!("--period-us {}: 1 to 1000000", args.period_us);
    }
    let mut measurement = match args.direction {
        Some(direction) if !args.folder.join(MANIFEST).exists() => {
            let direction = match direction {
                DirectionArg::Cw => Direction::Cw,
                DirectionArg::Ccw => Direction::Ccw,
            };
            Measurement::load_thesis_texts(&args.folder, direction)?
        }
        Some(_) => bail!(
            "{} has a {MANIFEST}, which says the direction of each run: leave --direction out",
            args.folder.display()
        ),
        None => Measurement::load(measurement_folder(&args.folder)?).with_context(|| {
            format!(
                "cannot import {} (for Duty_*.txt files without {MANIFEST}, give --direction)",
                args.folder.display()
            )
        })?,
    };
    let checked = check(&measurement);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&checked)?);
    } else {
        print(&checked);
    }
    if let Some(to) = args.to {
        if let Some(target) = args.convert {
            let convert = |data| match target {
                Encoder::Edges => Ok(to_edges(data)),
                Encoder::Levels => to_levels(data, args.period_us),
            };
            for run in &mut measurement.runs {
                let data = std::mem::replace(&mut run.data, RunData::Control(Vec::new()));
                run.data = convert(data).with_context(|| format!("run {}", run.id))?;
            }
        }
        measurement.save(&to)?;
        eprintln!("wrote {}", to.display());
    }
    Ok(ExitCode::SUCCESS)
}

fn print(checked: &FolderCheck) {
    println!("{}: motor {}, {} edges a revolution", checked.name, checked.motor, checked.edges_per_rev);
    let row = |run: &RunCheck| {
        vec![
            run.id.clone(),
            format!("{:?}", run.kind).to_lowercase(),
            run.format.name().to_owned(),
            run.duty.map_or("-".to_owned(), |duty| format!("{duty:.4}")),
            run.direction.map_or("-".to_owned(), |direction| format!("{direction:?}").to_lowercase()),
            run.samples.to_string(),
            run.edges.map_or("-".to_owned(), |edges| edges.to_string()),
            format!("{:.3}", run.duration_s),
        ]
    };
    let header = ["run", "kind", "format", "duty", "dir", "samples", "edges", "duration s"];
    print_table(&header, &checked.runs.iter().map(row).collect::<Vec<_>>());
    for run in &checked.runs {
        for note in &run.notes {
            println!("{}: {note}", run.id);
        }
    }
}
