//! `twum compare`.

use super::diagnose::motor_of;
use super::flavour::FlavourArgs;
use super::output::stage;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::compare::closed_loop::{self, ClosedLoop};
use twum_host::compare::ordinary::{self, Ordinary};
use twum_host::compare::simulation::{Comparison, compare};
use twum_host::diagnose::inertial::Model;
use twum_host::output::{self, Existing};
use twum_host::record::load::load_runs;
use twum_host::record::measurement::{Format, Measurement, RunKind};
use twum_host::report::comparison::page;
use twum_host::report::figure::Figure;

/// Arguments of `twum compare`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Open-loop runs are held against the simulated motor: mean speeds against duty, speed, angle, start and stop of every run.
Closed-loop runs are taken apart, before anything is fitted:
  controller  the control signal recomputed from target and position by the fixed-point controller; the first tick that
              differs is named, and what kind of difference it is
  actuator    recorded duty and direction against those the recorded control signal asks for
  plant       the simulated motor under the recorded duty and direction against the recorded position
  sensor      the encoder's counts against the direction pin
Runs of an ordinary motor (`motor = \"inertial\"`) are held against a saved one, `--motor FILE`, as `twum diagnose --save-model
FILE` writes it: its speeds under the recorded inputs, each run from an initial speed of its own.
A recording is checked bit for bit by `twum replay`.

Examples:
  twum compare bench3
  twum compare bench3 --flavour thesis --plot compare.svg
  twum compare bench3 --run d50-cw-0 --plot d50.png
  twum compare sine.mcap --report sine.html
  twum compare bench3 --json
  twum compare gear-motor --motor mine.toml     an ordinary motor against what was found in other runs
  twum compare bench3 --max-rmse-rpm 1.5        exit code 1 when the speeds differ by more

Exit code 0: compared. 1: a controller differs, or the speeds by more than allowed. 2: nothing to compare.")]
pub struct Args {
    /// Measurement folder (or its measurement.toml), or a recording
    folder: PathBuf,
    /// Only the run with this id
    #[arg(long, value_name = "ID")]
    run: Option<String>,
    /// Motor parameter set or file, instead of the measurement's own
    #[arg(long, value_name = "MOTOR")]
    motor: Option<String>,
    #[command(flatten)]
    flavour: FlavourArgs,
    /// Allow this much RMSE of the speed
    #[arg(long, value_name = "RPM")]
    max_rmse_rpm: Option<f64>,
    /// Draw measured and simulated speeds, or positions of a closed loop, to this file, .svg, .png or .html
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Write numbers and pictures to this file, a self-contained HTML page
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Everything found, for JSON.
#[derive(Debug, Serialize)]
struct Found {
    simulation: Option<Comparison>,
    closed_loops: Vec<ClosedLoop>,
    /// Runs of an ordinary motor.
    #[serde(skip_serializing_if = "Option::is_none")]
    ordinary: Option<Ordinary>,
}

/// Runs `twum compare`.
pub fn run(args: Args) -> Result<ExitCode> {
    for path in args.plot.iter().chain(&args.report) {
        output::may_write(path, Existing::Keep)?;
    }
    let (mut measurement, notes) = load_runs(&args.folder)?;
    for note in notes {
        eprintln!("note: {note}");
    }
    if let Some(id) = &args.run {
        let ids: Vec<String> = measurement.runs.iter().map(|run| run.id.clone()).collect();
        measurement.runs.retain(|run| run.id == *id);
        if measurement.runs.is_empty() {
            bail!("{} has no run {id}; it has: {}", args.folder.display(), ids.join(", "));
        }
    }
    let waiting = stage(format!("simulating {} runs", measurement.runs.len()));
    let found = compared(&args, &measurement)?;
    waiting.finish_and_clear();
    if found.simulation.is_none() && found.closed_loops.is_empty() && found.ordinary.is_none() {
        bail!(
            "{}: nothing to compare: it takes an open-loop run with a duty, or a closed-loop run of control ticks",
            args.folder.display()
        );
    }
    if let Some(path) = &args.plot {
        figure(&found, &measurement.name)?.write(path)?;
    }
    if let Some(path) = &args.report {
        let page = match &found.ordinary {
            Some(ordinary) => ordinary.page(&measurement.name),
            None => page(&measurement.name, found.simulation.as_ref(), &found.closed_loops)?,
        };
        page.write(path)?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        print(&found);
    }
    let differs = |run: &ClosedLoop| run.controller.as_ref().is_some_and(|check| check.mismatched > 0);
    let rmse =
        found.simulation.as_ref().map(|c| c.rmse_speed_rpm).or(found.ordinary.as_ref().map(|o| o.rmse_speed_rpm));
    let too_far = rmse.zip(args.max_rmse_rpm).is_some_and(|(rmse, most)| rmse > most);
    Ok(if found.closed_loops.iter().any(differs) || too_far { ExitCode::from(1) } else { ExitCode::SUCCESS })
}

fn compared(args: &Args, measurement: &Measurement) -> Result<Found> {
    if measurement.runs.iter().any(|run| run.format == Format::Drive) {
        let Some(path) = args.motor.as_deref() else {
            bail!(
                "{0}: an ordinary motor is held against a saved one: twum diagnose {0} --save-model mine.toml, then --motor mine.toml",
                args.folder.display()
            )
        };
        let ordinary = ordinary::compare(&Model::load(path)?, measurement)?;
        return Ok(Found { simulation: None, closed_loops: Vec::new(), ordinary: Some(ordinary) });
    }
    let motor = motor_of(measurement, args.motor.as_deref())?
        .context("an ordinary motor's runs are of format `drive`; there are none here")?;
    let flavour = args.flavour.get();
    let is_open_loop = |run: &&twum_host::record::measurement::Run| run.kind == RunKind::Speed && run.duty.is_some();
    let simulation = match measurement.runs.iter().find(is_open_loop) {
        Some(_) => Some(compare(measurement, &motor, flavour)?),
        None => None,
    };
    let closed_loops = measurement
        .runs
        .iter()
        .filter(|run| run.kind == RunKind::Track)
        .map(|run| closed_loop::compare(run, measurement.edges_per_rev, &motor, flavour))
        .collect::<Result<Vec<_>, _>>()
        .with_context(|| measurement.folder.display().to_string())?;
    Ok(Found { simulation, closed_loops, ordinary: None })
}

/// The open-loop runs where there are some, otherwise the closed loops.
fn figure(found: &Found, name: &str) -> Result<Figure> {
    if let Some(ordinary) = &found.ordinary {
        return Ok(ordinary.figure(name));
    }
    if let Some(comparison) = &found.simulation {
        return Ok(comparison.figure(name)?);
    }
    let panels = found.closed_loops.iter().flat_map(ClosedLoop::panels);
    Ok(panels.fold(Figure::new(name), Figure::panel))
}

fn print(found: &Found) {
    if let Some(ordinary) = &found.ordinary {
        print!("{ordinary}");
    }
    if let Some(comparison) = &found.simulation {
        println!("Open loop, against the simulation\n{comparison}");
    }
    for run in &found.closed_loops {
        println!("Closed loop, run {}\n{run}", run.run);
    }
}
