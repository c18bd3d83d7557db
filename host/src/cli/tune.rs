//! `twum tune`.

use super::configuration::ConfigurationArgs;
use super::connect::ConnectArgs;
use super::diagnose::{motor_of, runs_of};
use super::existing::ExistingArgs;
use super::exit;
use super::motor::{DEFAULT_MOTOR, SIMPLE};
use super::output::{print_table, stage};
use super::series::Bench;
use super::units;
use anyhow::{Context, Result, bail};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use twum_host::configuration::control_toml;
use twum_host::model::motor::Motor;
use twum_host::model::robust::{Spread, Study, Target};
use twum_host::model::uncertainty::Band;
use twum_host::output;
use twum_host::record::measurement::Measurement;
use twum_host::record::series::Series;
use twum_host::tune::design::BANDWIDTH_RAD_S;
use twum_host::tune::fit::{Identified, identify};
use twum_host::tune::plan::{SECONDS, plan};
use twum_host::tune::predict::{Tuned, tune};
use twum_shared::message::Configuration;
use twum_shared::step::ConfigSpec;

/// Arguments of `twum tune`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum tune --port /dev/ttyUSB0 --out bench3 --save bench3-controllers    the motor turns: 8 runs of 2.5 s, both ways
  twum track --port /dev/ttyUSB0 --control bench3-controllers/default.toml
  twum tune bench3/measurement --save bench3-controllers                   from runs that are there
  twum tune --port sim --flavour measured --out first

The exit code is 0 where every controller holds, 1 where one is unstable in the model, 2 where nothing can be said of the motor.")]
pub struct Args {
    /// Measurement folder or recordings with runs at constant duty, both ways; without one, they are made on --port
    #[arg(conflicts_with = "out", required_unless_present = "out")]
    folder: Option<PathBuf>,
    /// New folder: the plan, the recordings, and the measurement made of them
    #[arg(long, short)]
    out: Option<PathBuf>,
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    configuration: ConfigurationArgs,
    /// Write a file of each controller for --control, and the motor as identified, into this folder
    #[arg(long, value_name = "FOLDER")]
    save: Option<PathBuf>,
    /// Write controllers that are unstable in the model too
    #[arg(long)]
    allow_unstable: bool,
    /// Crossover of the position loops that have gains (rad/s): the default controller's by default
    #[arg(long, value_name = "RAD/S", default_value_t = BANDWIDTH_RAD_S)]
    bandwidth: f64,
    /// Amplitude of the sine that errors are foretold for (counts)
    #[arg(long, default_value_t = 89)]
    amplitude: i32,
    /// Its angular frequency (rad/s)
    #[arg(long, default_value_t = 1.257)]
    omega: f64,
    /// Length of the run that errors are foretold for (s)
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Motors that agree with the runs, on which each controller is tried
    #[arg(long, default_value_t = 200)]
    draws: u64,
    /// Seed of the draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    existing: ExistingArgs,
}

/// Runs `twum tune`.
pub fn run(args: &Args) -> Result<ExitCode> {
    check(args)?;
    let folder = match (&args.folder, &args.out) {
        (Some(folder), _) => folder.clone(),
        (None, Some(out)) => measure(args, out)?,
        (None, None) => bail!("give a folder, or --port and --out"),
    };
    let (measurement, notes) = runs_of(&folder)?;
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    // The motor of tests has no file: it is fitted from the shipped one.
    let of_tests = (measurement.motor == SIMPLE).then_some(DEFAULT_MOTOR);
    let Some(motor) =
        motor_of(&measurement, args.connect.motor_args().named().filter(|name| *name != SIMPLE).or(of_tests))?
    else {
        bail!("{}: an ordinary motor is not driven by the board; `twum identify motor` is for it", folder.display())
    };
    let waiting = stage("fitting the motor to every run");
    let identified = identify(&measurement, &motor, args.seed)?;
    waiting.set_message(format!("trying every controller on {} motors that agree", args.draws));
    let study = Study {
        motor: &motor,
        target: Target::Sine { amplitude: args.amplitude, omega_rad_s: args.omega },
        load: 0.0,
        hand: None,
        seconds: args.seconds,
        draws: args.draws,
        seed: args.seed,
    };
    let tuned = tune(&identified, &study, args.bandwidth)?;
    waiting.finish_and_clear();
    let unstable = tuned.iter().any(|controller| controller.unstable.is_some());
    let verdict = Ok(u8::from(unstable));
    exit::decide(&verdict);
    let saved = args.save.as_deref().map(|to| save(args, to, &measurement, &motor, &identified, &tuned)).transpose()?;
    if args.json {
        let controllers: Vec<_> =
            tuned.iter().map(|t| json!({ "tuned": t, "control": control_toml(&t.spec) })).collect();
        println!(
            "{}",
            json!({
                "schema": 1, "folder": folder, "motor": identified, "controllers": controllers, "seed": args.seed,
                "draws": args.draws, "saved": saved,
            })
        );
    } else {
        tell(args, &identified, &tuned);
    }
    verdict.map(ExitCode::from)
}

/// What is wrong with the arguments, before anything moves.
fn check(args: &Args) -> Result<()> {
    if !(10..=100_000).contains(&args.draws) {
        bail!("--draws {} is outside 10 ..= 100000", args.draws);
    }
    if !(args.seconds > 0.0 && args.seconds <= 3_600.0) {
        bail!("--seconds {} is not above 0 and at most 3600", args.seconds);
    }
    if !(0.1..=200.0).contains(&args.bandwidth) {
        bail!("--bandwidth {} is outside 0.1 ..= 200 rad/s", args.bandwidth);
    }
    units::sine(args.amplitude, args.omega).context("--amplitude or --omega")?;
    // A folder that is not there yet has no files to keep.
    let there = args.save.iter().filter(|to| to.exists());
    let names = || ConfigSpec::NAMED.map(|(name, _)| name).into_iter().chain([MOTOR]);
    let files: Vec<PathBuf> = there.flat_map(|to| names().map(|name| file_of(to, name))).collect();
    files.into_iter().try_for_each(|path| Ok(output::may_write(&path, args.existing.into())?))
}

/// What `--save` calls the motor, beside the controllers by their names.
const MOTOR: &str = "motor";

/// The file that `--save` writes of something.
fn file_of(to: &Path, name: &str) -> PathBuf {
    to.join(format!("{name}.toml"))
}

/// Makes the plan's runs; where the measurement is.
fn measure(args: &Args, out: &Path) -> Result<PathBuf> {
    if out.exists() {
        bail!("{}: exists already; name a new folder, or tune from {0}/measurement", out.display());
    }
    let runs = plan();
    let drive_s: f64 = runs.iter().map(|run| run.seconds).sum();
    eprintln!("{} runs, {drive_s:.0} s of drive, both ways in turn; the motor turns", runs.len());
    let bench = Bench { connect: &args.connect, configuration: &args.configuration, limited };
    let (series, result) = bench.make(|| Ok(Series::begin(out, runs)?))?;
    if let Err(error) = result {
        let resume = format!("twum experiment run --resume --out {}", out.display());
        return Err(error.context(format!("the motor was not identified; `{resume}` goes on with its runs")));
    }
    let (saved, notes) = series.measure()?;
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    Ok(saved.context("no run was made to its end")?.folder)
}

/// No run takes the motor farther than its overspeed limit does in the run's time: the board holds it to that.
fn limited(mut configuration: Configuration) -> Configuration {
    let farthest = (f64::from(configuration.limits.overspeed_counts_s) * SECONDS).ceil() as i32;
    configuration.limits.position_min = configuration.limits.position_min.max(-farthest);
    configuration.limits.position_max = configuration.limits.position_max.min(farthest);
    configuration
}

/// Writes the controllers that hold, or all, and the motor; their paths.
fn save(
    args: &Args,
    to: &Path,
    measurement: &Measurement,
    motor: &Motor,
    identified: &Identified,
    tuned: &[Tuned],
) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(to).with_context(|| to.display().to_string())?;
    let source = format!(
        "twum tune {} of {} ({} runs), seed {}",
        env!("CARGO_PKG_VERSION"),
        measurement.folder.display(),
        identified.runs.len(),
        args.seed
    );
    let mut written = Vec::new();
    for controller in tuned {
        let path = file_of(to, &controller.name);
        if let Some(swings) = controller.unstable.filter(|_| !args.allow_unstable) {
            eprintln!("{}: not written: {swings} (--allow-unstable writes it)", path.display());
            continue;
        }
        let text = format!("{}{}", provenance(args, &source, identified, controller), control_toml(&controller.spec));
        output::write(&path, text, args.existing.into())?;
        written.push(path);
    }
    let path = file_of(to, MOTOR);
    output::write(&path, identified.motor(motor, &source).to_toml()?, args.existing.into())?;
    written.push(path);
    written.iter().for_each(|path| eprintln!("wrote {}", path.display()));
    Ok(written)
}

/// Where a controller's file comes from, and what was foretold of it: comments, so that every reader of controllers takes it.
fn provenance(args: &Args, source: &str, identified: &Identified, controller: &Tuned) -> String {
    let margins = controller.unstable.map_or_else(|| margins(controller).join(", "), |swings| swings.to_string());
    let lines = [
        format!("`{}` for one motor: {source}", controller.name),
        format!("full drive: cw {} rpm, ccw {} rpm", ci(identified.full_cw_rpm, 2), ci(identified.full_ccw_rpm, 2)),
        format!("braking: {} mN·m; reading of the model: {}", ci(scaled(identified.braking_nm), 3), identified.flavour),
        format!(
            "foretold for {} counts at {} rad/s over {} s, median and 90 % of {} motors: counted {}°, true {}°",
            args.amplitude,
            args.omega,
            args.seconds,
            args.draws,
            spread(controller.counted_deg),
            spread(controller.true_deg)
        ),
        format!("margins: {margins}"),
    ];
    lines.iter().map(|line| format!("# {line}\n")).collect()
}

fn ci(e: Band, places: usize) -> String {
    format!("{:.places$} [{:.places$}, {:.places$}]", e.median, e.ci95[0], e.ci95[1])
}

fn scaled(e: Band) -> Band {
    Band { median: 1e3 * e.median, ci95: e.ci95.map(|v| 1e3 * v) }
}

fn spread(s: Spread) -> String {
    format!("{:.2} / {:.2}", s.median, s.p90)
}

/// Margins in gain and delay.
fn margins(controller: &Tuned) -> [String; 2] {
    let more = |more: bool| if more { "> " } else { "" };
    controller.margins.map_or(["none".to_owned(), "none".to_owned()], |m| {
        [
            format!("gain {}{:.1}", more(m.gain_is_more), m.gain),
            format!("delay {}{:.0} ms", more(m.delay_is_more), m.delay_ms),
        ]
    })
}

fn tell(args: &Args, identified: &Identified, tuned: &[Tuned]) {
    let reading = |(flavour, share): &(_, f64)| format!("{flavour} {:.0} %", 100.0 * share);
    let readings: Vec<String> = identified.readings.iter().map(reading).collect();
    println!("full drive    cw {} rpm, ccw {} rpm", ci(identified.full_cw_rpm, 2), ci(identified.full_ccw_rpm, 2));
    println!("braking       {} mN·m with the drive off", ci(scaled(identified.braking_nm), 3));
    println!("dead zone     {} of the duty", ci(identified.dead_zone, 3));
    println!("read as       {}; misfit {:.1}", readings.join(", "), identified.misfit);
    identified.notes.iter().for_each(|note| println!("note: {note}"));
    println!("mean |error| on {} motors that agree, median / 90 %", args.draws);
    let rows = tuned.iter().map(|t| {
        let [gain, delay] = margins(t);
        vec![
            t.name.clone(),
            spread(t.counted_deg),
            spread(t.true_deg),
            format!("{:.0} / {:.0}", t.miscount.median, t.miscount.p90),
            t.ran_away.to_string(),
            gain.trim_start_matches("gain ").to_owned(),
            delay.trim_start_matches("delay ").to_owned(),
        ]
    });
    let header =
        ["controller", "counted (deg)", "true (deg)", "counts lost", "ran away", "margin in gain", "margin in delay"];
    print_table(&header, &rows.collect::<Vec<_>>());
    for t in tuned {
        if let Some(swings) = t.unstable {
            println!("{}: {swings}", t.name);
        }
    }
}
