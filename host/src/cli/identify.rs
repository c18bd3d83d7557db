//! `twum identify`.

use super::diagnose::runs_of;
use super::existing::ExistingArgs;
use super::flavour::FlavourArgs;
use super::output::stage;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::diagnose::Options;
use twum_host::diagnose::inertial::{Compensation, MotorReport, diagnose_drives};
use twum_host::identify::{force_factor, friction, read, save, stator};
use twum_host::model::motor::Motor;
use twum_host::output;
use twum_host::record::load::load_runs;
use twum_host::report::identified::{figures, text};

/// Arguments of `twum identify`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// The stator's equivalent circuit, from impedance, admittance, waveforms or a Touchstone file
    Stator(Stator),
    /// Coulomb and static friction, from torque with, without and before sliding
    Friction(Friction),
    /// The electromechanical force factor, from speeds by the averaged model, and what it trades off against
    ForceFactor(ForceFactor),
    /// An ordinary motor: gain, lag, friction and what else is found, with intervals, and the feed-forward that cancels it
    Motor(OrdinaryMotor),
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  twum identify motor bench
  twum identify motor bench --compensation feed-forward.csv

The folder is a measurement folder with `motor = \"inertial\"` and runs of `format = \"drive\"` (docs/ordinary.md).
Exit code: 0 the numbers are of one motor, 1 the runs are not, 2 bad input.")]
struct OrdinaryMotor {
    /// Measurement folders
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Write the input of steady speeds here, as CSV (speed_rpm, input)
    #[arg(long, value_name = "FILE")]
    compensation: Option<PathBuf>,
    /// Write the input that cancels cogging over a turn to this CSV file
    #[arg(long, value_name = "FILE.csv")]
    cogging: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
    /// Seed of every random choice
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Where a result is written.
#[derive(Debug, clap::Args)]
struct Save {
    /// Write the result into this motor file, made from --motor if it is not there; its other values are kept
    #[arg(long, value_name = "FILE")]
    save: Option<PathBuf>,
    /// Motor to start from: a shipped name or a motor file
    #[arg(long, value_name = "NAME|FILE", default_value = "pcbmotor-30mm")]
    motor: String,
}

impl Save {
    fn write(&self, updates: impl FnOnce(&PathBuf, &str) -> Result<Vec<save::Update>, save::SaveError>) -> Result<()> {
        if let Some(path) = &self.save {
            let updates = updates(path, &self.motor)?;
            save::save(path, &self.motor, &updates)?;
            let names: Vec<&str> = updates.iter().map(|u| u.name).collect();
            eprintln!("{}: wrote {}", path.display(), names.join(", "));
        }
        Ok(())
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  twum identify force-factor bench-3
  twum identify force-factor bench-3 --loaded 1.0:0.004:24 --loaded 1.0:0.008:13 --save motor.toml
  twum identify force-factor bench-3 --torque-runs torque.csv

The folder is a measurement folder (measurement.toml). Its open-loop runs at constant duty give steady speeds and start-up
lags; a speed under a known load, or the torque that stalls the rotor at full drive (1.0:0.015:0), tells torque from speed.")]
struct ForceFactor {
    /// Measurement folder
    folder: PathBuf,
    /// A speed under load, DUTY:NEWTON_METRE:RPM; may be given several times
    #[arg(long, value_name = "DUTY:NM:RPM", value_parser = loaded)]
    loaded: Vec<force_factor::Loaded>,
    /// Speeds under load and stalls from a CSV file with the columns duty,load_nm,rpm (rpm 0: the torque that stalled it)
    #[arg(long, value_name = "FILE")]
    torque_runs: Option<PathBuf>,
    #[command(flatten)]
    flavour: FlavourArgs,
    #[command(flatten)]
    save: Save,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn loaded(text: &str) -> Result<force_factor::Loaded, String> {
    let numbers: Vec<f64> = text.split(':').filter_map(|n| n.parse().ok()).collect();
    match numbers[..] {
        [duty, load_nm, rpm] => Ok(force_factor::Loaded { duty, load_nm, rpm }),
        _ => Err(format!("`{text}` is not DUTY:NM:RPM, for example 1.0:0.005:22")),
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  twum identify friction bench/2024-12-13
  twum identify friction bench/2024-12-13 --json --plot friction.svg

The folder holds friction.toml (geometry) and the folders motor, no-motor and static with one file a trial,
<speed>_rpm_<trial>.csv (column torque_nm) or .xlsx (column B). docs/identify.md lists the keys.")]
struct Friction {
    /// Folder with friction.toml and the three data sets
    folder: PathBuf,
    /// Go on without missing trials
    #[arg(long)]
    allow_missing: bool,
    /// Write the coefficients over speed and the power spectrum here (.svg, .png or .html)
    #[arg(long, alias = "figure", value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    save: Save,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  twum identify stator sweep.csv --plot sweep.svg
  twum identify stator waveforms.csv --shunt 2000 --shunt-tolerance 0.01 --json
  twum identify stator analyser.s1p --eta 0.54 --eta-relative 0.1

CSV columns: frequency_hz,z_re,z_im  or  frequency_hz,g,b  or  frequency_hz,time_s,v1,v2;
a folder holds one file a frequency (time_s,v1,v2, the frequency in its name).
Exit code: 0 a resonance was found, 1 none was, 2 bad input.")]
struct Stator {
    /// CSV or .s1p file, or a folder of waveform files
    file: PathBuf,
    /// Shunt resistance for waveforms (ohm)
    #[arg(long, value_name = "OHM")]
    shunt: Option<f64>,
    /// Tolerance of the shunt as a share (0.01 for 1 %), taken as a uniform distribution
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    shunt_tolerance: f64,
    /// Where the shunt sits: before the stator (v2 across the stator) or at ground (v2 across the shunt)
    #[arg(long, value_enum, default_value_t)]
    shunt_side: read::Shunt,
    /// Capacitance of probe and cables across the stator to take off (pF)
    #[arg(long, value_name = "PF", default_value_t = 0.0)]
    stray_pf: f64,
    /// Force factor for the mechanical values (N/V)
    #[arg(long, value_name = "N/V", default_value_t = stator::THESIS_FORCE_FACTOR)]
    eta: f64,
    /// Its relative standard uncertainty (0 takes it as exact)
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    eta_relative: f64,
    /// Also fit resistance and inductance of the leads and the loss tangent
    #[arg(long)]
    parasitics: bool,
    /// Intervals by bootstrap with so many replicates instead of the covariance
    #[arg(long, value_name = "N", default_value_t = 0)]
    bootstrap: usize,
    /// Seed of the bootstrap
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write Nyquist and Bode plots here (.svg, .png or .html)
    #[arg(long, alias = "figure", value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    save: Save,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum identify`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.what {
        What::Stator(args) => run_stator(args),
        What::Friction(args) => run_friction(args),
        What::ForceFactor(args) => run_force_factor(args),
        What::Motor(args) => run_motor(&args),
    }
}

fn run_stator(args: Stator) -> Result<ExitCode> {
    for (name, share) in [("--shunt-tolerance", args.shunt_tolerance), ("--eta-relative", args.eta_relative)] {
        if !(0.0..1.0).contains(&share) {
            bail!("{name} is a share from 0 to below 1, got {share}");
        }
    }
    if !(args.eta.is_finite() && args.eta > 0.0) {
        bail!("--eta must be positive, got {}", args.eta);
    }
    if !(args.stray_pf.is_finite() && args.stray_pf >= 0.0) {
        bail!("--stray-pf must not be negative, got {}", args.stray_pf);
    }
    let options = read::ReadOptions { shunt_ohm: args.shunt, shunt: args.shunt_side, stray_f: args.stray_pf * 1e-12 };
    let sweep = read::read(&args.file, &options)?;
    let options = stator::Options {
        parasitics: args.parasitics,
        force_factor_n_v: args.eta,
        force_factor_relative: args.eta_relative,
        shunt_relative: args.shunt_tolerance / 3f64.sqrt(),
        bootstrap: args.bootstrap,
        seed: args.seed,
    };
    let waiting = stage("fitting the circuit");
    let found = stator::identify(&sweep, &options).with_context(|| {
        format!("{}: no circuit could be fitted: is this an admittance sweep of a stator?", args.file.display())
    })?;
    waiting.finish_and_clear();
    if let Some(path) = &args.plot {
        figures::stator(&sweep, &found).write(path)?;
    }
    if args.json {
        println!("{}", serde_json::to_string(&found.report)?);
    } else {
        print!("{}", text::stator(&found.report));
    }
    args.save.write(|path, base| save::stator(&found.report, path, base))?;
    Ok(if found.report.verdict == stator::Verdict::NoResonance { ExitCode::from(1) } else { ExitCode::SUCCESS })
}

fn run_friction(args: Friction) -> Result<ExitCode> {
    let waiting = stage("reading the trials");
    let found = friction::identify(&args.folder, args.allow_missing)?;
    waiting.finish_and_clear();
    if let Some(path) = &args.plot {
        figures::friction(&found).write(path)?;
    }
    if args.json {
        println!("{}", serde_json::to_string(&found.report)?);
    } else {
        print!("{}", text::friction(&found.report));
    }
    args.save.write(|_, _| Ok(save::friction(&found.report)))?;
    Ok(ExitCode::SUCCESS)
}

fn run_force_factor(args: ForceFactor) -> Result<ExitCode> {
    let (measurement, notes) = load_runs(&args.folder)?;
    for note in notes {
        eprintln!("note: {note}");
    }
    let motor = Motor::load(&args.save.motor)?;
    let mut torque = force_factor::TorqueRuns::default();
    for row in args.loaded {
        torque.add(row).map_err(|message| anyhow::anyhow!("--loaded: {message}"))?;
    }
    if let Some(path) = &args.torque_runs {
        torque.read(path)?;
    }
    let waiting = stage("fitting the model to every run");
    let report = force_factor::identify(&measurement, &torque, &motor, args.flavour.get())?;
    waiting.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print!("{}", text::force_factor(&report));
    }
    args.save.write(|_, _| Ok(save::force_factor(&report)))?;
    Ok(ExitCode::SUCCESS)
}

fn run_motor(args: &OrdinaryMotor) -> Result<ExitCode> {
    for path in args.compensation.iter().chain(&args.cogging) {
        output::may_write(path, args.existing.into())?;
    }
    let mut measurements = Vec::new();
    for folder in &args.folders {
        let (measurement, notes) = runs_of(folder)?;
        notes.iter().for_each(|note| eprintln!("note: {note}"));
        if measurement.motor != "inertial" {
            bail!(
                "{}: its motor is {}; `identify motor` is for `motor = \"inertial\"`",
                folder.display(),
                measurement.motor
            );
        }
        measurements.push(measurement);
    }
    let runs: Vec<_> = measurements.iter().flat_map(|m| &m.runs).collect();
    let waiting = stage("fitting the motor to every run");
    let options = Options { seed: args.seed, ..Options::default() };
    let (diagnosis, outcome) = diagnose_drives(&runs, &options, &|what, share| {
        waiting.set_message(format!("{what}, {:.0} %", 100.0 * share));
    });
    waiting.finish_and_clear();
    let Some(outcome) = outcome else { bail!("{}", diagnosis.notes.join("; ")) };
    let Some(report) = MotorReport::of(&outcome, &diagnosis) else {
        diagnosis.notes.iter().for_each(|note| eprintln!("note: {note}"));
        return Ok(ExitCode::from(1));
    };
    if let Some(path) = &args.compensation {
        let Some(compensation) = &report.compensation else {
            bail!("--compensation: the motor reaches one direction only in these runs")
        };
        output::write(path, compensation.csv(), args.existing.into())?;
        eprintln!("wrote {}", path.display());
    }
    if let Some(path) = &args.cogging {
        let Some(csv) = report.compensation.as_ref().and_then(Compensation::cogging_csv) else {
            bail!("--cogging: no torque over the angle was found")
        };
        output::write(path, csv, args.existing.into())?;
        eprintln!("wrote {}", path.display());
    }
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print!("{}", text::motor(&report));
    }
    Ok(ExitCode::SUCCESS)
}
