//! `twum compare`.

use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::compare::controller::{ControllerCheck, Kind, check};
use twum_host::compare::simulation::{Comparison, compare};
use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;
use twum_host::record::measurement::{Measurement, RunKind};

/// Arguments of `twum compare`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Closed-loop runs are held against the fixed-point controller, tick by tick: the first tick that differs is named, and what
kind of difference it is. Open-loop runs are held against the simulated motor: mean speeds against duty, speed, angle, start
and stop of every run. A recording is checked bit for bit by `twum replay`.

Examples:
  twum compare bench3
  twum compare bench3 --flavour thesis --plot compare.svg
  twum compare bench3 --json
  twum compare bench3 --max-rmse-rpm 1.5        exit code 1 when the speeds differ by more

Exit code 0: compared. 1: a controller differs, or the speeds by more than allowed. 2: nothing to compare.")]
pub struct Args {
    /// Measurement folder
    folder: PathBuf,
    /// Motor parameter set or file, instead of the measurement's own
    #[arg(long, value_name = "MOTOR")]
    motor: Option<String>,
    /// Which reading of the motor model is simulated
    #[arg(long, value_enum, default_value_t = FlavourArg::Physical)]
    flavour: FlavourArg,
    /// Allow this much RMSE of the speed
    #[arg(long, value_name = "RPM")]
    max_rmse_rpm: Option<f64>,
    /// Draw measured and simulated speeds to this file, .svg or .png
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum FlavourArg {
    /// Formula for formula as the thesis lists it
    Thesis,
    /// What the listing gets wrong put right
    Physical,
}

/// Everything found, for JSON.
#[derive(Debug, Serialize)]
struct Found {
    simulation: Option<Comparison>,
    controllers: Vec<Controller>,
}

#[derive(Debug, Serialize)]
struct Controller {
    run: String,
    #[serde(flatten)]
    check: ControllerCheck,
}

/// Runs `twum compare`.
pub fn run(args: Args) -> Result<ExitCode> {
    let measurement = Measurement::load(&args.folder)?;
    let found = Found { simulation: simulated(&args, &measurement)?, controllers: controllers(&measurement)? };
    if found.simulation.is_none() && found.controllers.is_empty() {
        bail!(
            "{}: nothing to compare: it takes an open-loop run with a duty, or a closed-loop run with its control",
            args.folder.display()
        );
    }
    if let Some(path) = &args.plot {
        let Some(comparison) = &found.simulation else { bail!("--plot: no open-loop run with a duty to draw") };
        comparison.figure(&measurement.name).write(path)?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        print(&found);
    }
    let differs = found.controllers.iter().any(|c| c.check.mismatched > 0);
    let too_far = match (&found.simulation, args.max_rmse_rpm) {
        (Some(comparison), Some(most)) => comparison.rmse_speed_rpm > most,
        _ => false,
    };
    Ok(if differs || too_far { ExitCode::from(1) } else { ExitCode::SUCCESS })
}

fn simulated(args: &Args, measurement: &Measurement) -> Result<Option<Comparison>> {
    let open_loop = |run: &&twum_host::record::measurement::Run| run.kind == RunKind::Speed && run.duty.is_some();
    if measurement.runs.iter().find(open_loop).is_none() {
        return Ok(None);
    }
    let motor = match (&args.motor, measurement.motor_file()) {
        (Some(named), _) => Motor::load(named)?,
        (None, Some(file)) => Motor::load(&file.to_string_lossy())?,
        (None, None) => Motor::load(&measurement.motor)?,
    };
    let flavour = match args.flavour {
        FlavourArg::Thesis => Flavour::Thesis,
        FlavourArg::Physical => Flavour::Physical,
    };
    Ok(Some(compare(measurement, &motor, flavour)?))
}

fn controllers(measurement: &Measurement) -> Result<Vec<Controller>> {
    let mut checks = Vec::new();
    for run in measurement.runs.iter().filter(|run| run.kind == RunKind::Track) {
        let check = check(run).with_context(|| measurement.folder.display().to_string())?;
        checks.push(Controller { run: run.id.clone(), check });
    }
    Ok(checks)
}

fn print(found: &Found) {
    if let Some(comparison) = &found.simulation {
        println!("Open loop, against the simulation\n{comparison}");
    }
    for Controller { run, check } in &found.controllers {
        println!("Closed loop, run {run}: {} ticks recomputed, {} differ", check.ticks, check.mismatched);
        if let Some(first) = &check.first {
            println!(
                "  first at row {} ({:.0} us): u is {:.4}, the controller gives {:.4} duty steps",
                first.row, first.time_us, first.recorded_u, first.expected_u
            );
        }
        if let Some(kind) = &check.kind {
            println!("  likely: {}", in_words(kind));
        }
        let p = &check.parity;
        println!(
            "  controller {:.4} duty steps RMS; duty {:.5} RMS; wrong direction {:.2} %; counts against direction {:.2} %; \
             largest step {:.0} counts",
            p.controller_rms_steps,
            p.actuator_duty_rms,
            100.0 * p.actuator_wrong_direction,
            100.0 * p.sensor_against_direction,
            p.sensor_largest_jump
        );
    }
}

fn in_words(kind: &Kind) -> String {
    match kind {
        Kind::Gain { kp, ki, kd } => {
            let named = [("kp", kp), ("ki", ki), ("kd", kd)];
            let found: Vec<String> =
                named.iter().filter_map(|(name, value)| value.map(|value| format!("{name} = {value:.6}"))).collect();
            format!("other gains: {}", found.join(", "))
        }
        Kind::ClampSignal { limit } => format!("the control signal is cut off at ±{limit} duty steps"),
        Kind::ClampIntegral { min, max } => format!("the integral is kept between {min} and {max} count·s"),
        Kind::Delay { ticks } => format!("the control signal comes {ticks} ticks late"),
        Kind::LostSample { time_us, shown_by_time } => {
            let shown = if *shown_by_time { "the times show the hole" } else { "the times do not show it" };
            format!("a sample lost or changed before {time_us:.0} us ({shown})")
        }
        Kind::Unknown => "neither gain, clamp, delay nor lost samples".to_owned(),
    }
}
