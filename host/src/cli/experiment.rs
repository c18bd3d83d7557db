//! `twum experiment`.

use super::connect::{ALL_STREAMS, ConfigurationArgs, ConnectArgs, duration_ms, own_configuration, restore};
use super::diagnose::{motor_of, runs_of};
use super::exit;
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use twum_host::diagnose::plan::{PlannedRun, first_experiment, next_runs};
use twum_host::diagnose::{Options, diagnose};
use twum_host::link::LinkError;
use twum_host::link::bench::{Action, Experiment, perform};
use twum_host::link::{Port, Session};
use twum_host::model::parameters::Flavour;
use twum_host::record::export::{EncoderSource, to_measurement};
use twum_host::record::measurement::Measurement;
use twum_host::record::recording::Recording;
use twum_shared::message::{Configuration, SpeedRun};
use twum_shared::{Direction, Duty};

/// Arguments of `twum experiment`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Say which runs to make next, as commands that can be pasted
    Plan(PlanArgs),
    /// Make them on a board, real or simulated, into a measurement folder
    Run(RunArgs),
}

#[derive(Debug, clap::Args)]
struct Wanted {
    /// Folders measured so far; without any, a first experiment is planned
    folders: Vec<PathBuf>,
    /// Duties of a first experiment
    #[arg(long, value_delimiter = ',', default_value = "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0")]
    duties: Vec<f64>,
    /// Repetitions of each duty and direction in a first experiment
    #[arg(long, default_value_t = 3)]
    trials: usize,
    /// Length of each run of a first experiment, s
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  twum experiment plan bench3\n  twum experiment plan --duties 0.25,0.5,1 --trials 2 --port /dev/ttyUSB0"
)]
struct PlanArgs {
    #[command(flatten)]
    wanted: Wanted,
    /// Port to put into the commands
    #[arg(long, default_value = "/dev/ttyUSB0")]
    port: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum experiment run bench3 --port /dev/ttyUSB0 --out bench3-more\n  \
                        twum experiment run --port sim --duties 0.3,0.6,1 --trials 2 --seconds 2 --out first")]
struct RunArgs {
    #[command(flatten)]
    wanted: Wanted,
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    configuration: ConfigurationArgs,
    /// New folder: recordings and the measurement made of them
    #[arg(long, short)]
    out: PathBuf,
}

/// Runs `twum experiment`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.what {
        What::Plan(args) => plan(&args),
        What::Run(args) => {
            let mut session = args.connect.session()?;
            let own = own_configuration(&mut session)?;
            let mut used = own;
            let result = make(&args, &mut session, own, &mut used);
            restore(&mut session, own, used);
            result
        }
    }
}

fn planned(wanted: &Wanted) -> Result<Vec<PlannedRun>> {
    duration_ms(wanted.seconds).context("--seconds")?;
    if let Some(duty) = wanted.duties.iter().find(|d| !(0.0..=1.0).contains(*d)) {
        bail!("--duties: {duty} is outside 0 to 1");
    }
    if wanted.folders.is_empty() {
        return Ok(first_experiment(&wanted.duties, wanted.trials, wanted.seconds, 50.0));
    }
    let mut measurements = Vec::new();
    for folder in &wanted.folders {
        measurements.push(runs_of(folder)?.0);
    }
    let motor = motor_of(&measurements[0], None)?.map(|m| m.parameters(Flavour::Physical));
    let (diagnosis, _) = diagnose(&measurements, &Options { quick: true, motor, ..Options::default() }, &|_, _| {})?;
    Ok(next_runs(&measurements, &diagnosis))
}

fn plan(args: &PlanArgs) -> Result<ExitCode> {
    let runs = planned(&args.wanted)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&runs)?);
        return Ok(ExitCode::SUCCESS);
    }
    if runs.is_empty() {
        eprintln!("nothing is open that another run would decide");
        return Ok(ExitCode::SUCCESS);
    }
    let total: f64 = runs.iter().map(|r| r.seconds + r.pause_s).sum();
    eprintln!(
        "{} runs, {:.0} s of drive and pauses; paste these, or let `twum experiment run` make them:",
        runs.len(),
        total
    );
    println!("mkdir -p next");
    let mut why = "";
    for (number, run) in runs.iter().enumerate() {
        if run.why != why {
            println!("# {}", run.why);
            why = &run.why;
        }
        println!("{}", run.command(number, &args.port, "next"));
    }
    Ok(ExitCode::SUCCESS)
}

/// Makes the runs, on a board whose own configuration is `own`; `used` is what it was given last.
fn make(
    args: &RunArgs,
    session: &mut Session<Box<dyn Port>>,
    own: Configuration,
    used: &mut Configuration,
) -> Result<ExitCode> {
    let runs = planned(&args.wanted)?;
    if runs.is_empty() {
        eprintln!("nothing is open that another run would decide");
        return Ok(ExitCode::SUCCESS);
    }
    let motor = args.configuration.motor()?;
    if args.out.exists() {
        bail!("{} exists already: name a new folder", args.out.display());
    }
    let recordings = args.out.join("recordings");
    std::fs::create_dir_all(&recordings).with_context(|| format!("making {}", recordings.display()))?;
    let bar = ProgressBar::new(runs.len() as u64)
        .with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}").expect("the template is valid"));
    let mut whole: Option<Measurement> = None;
    let mut cut: Option<(String, LinkError)> = None;
    for (number, planned) in runs.iter().enumerate() {
        let id = planned.id(number);
        bar.set_message(id.clone());
        if let Err(error) = session.rest(Duration::from_secs_f64(planned.pause_s.max(0.0))) {
            cut = Some((id, error));
            break;
        }
        let path = recordings.join(format!("{id}.mcap"));
        let mut configuration = args.configuration.over(own)?;
        configuration.pwm_hz = planned.pwm_hz.round() as u16;
        *used = configuration;
        let experiment = Experiment {
            configuration: Some(configuration),
            capture: ALL_STREAMS,
            action: Action::Speed(SpeedRun {
                duty: Duty::try_from((planned.duty * f64::from(Duty::FULL.raw())).round() as u16)?,
                direction: if planned.direction == "cw" { Direction::Cw } else { Direction::Ccw },
                duration_ms: duration_ms(planned.seconds)?,
            }),
            recording: Some(path.clone()),
            motor: motor.clone(),
        };
        let outcome = perform(session, &experiment, None, |_| {}).with_context(|| format!("run {id}"))?;
        if let Some(error) = outcome.cut() {
            // No ordinary run: it goes by another name, and into no measurement.
            let marked = recordings.join(format!("{id}.cut-short.mcap"));
            twum_host::output::rename(&path, &marked)?;
            cut = Some((id, error));
            break;
        }
        let recording = Recording::load(&path)?;
        let (measurement, notes) = to_measurement(&recording, &id, EncoderSource::Edges)?;
        for note in notes {
            eprintln!("{id}: {note}");
        }
        let whole = whole.get_or_insert_with(|| Measurement {
            name: args.out.file_name().map_or_else(Default::default, |n| n.to_string_lossy().into_owned()),
            runs: Vec::new(),
            ..measurement.clone()
        });
        for (part, mut run) in measurement.runs.into_iter().enumerate() {
            run.id = if part == 0 { id.clone() } else { format!("{id}-{part}") };
            run.file = format!("{}.csv", run.id);
            run.order = Some(number as u32);
            whole.runs.push(run);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let verdict = match cut {
        Some((id, error)) => {
            let verdict = Err(anyhow::Error::from(error).context(format!("run {id}")));
            exit::decide(&verdict);
            let made = whole.as_ref().map_or(0, |whole| whole.runs.len());
            eprintln!("{made} of {} runs were made; {} keeps what was recorded", runs.len(), recordings.display());
            verdict.map(ExitCode::from)
        }
        None => Ok(ExitCode::SUCCESS),
    };
    if let Some(whole) = whole {
        let saved = whole.save(args.out.join("measurement"))?;
        println!("{}", saved.folder.display());
        eprintln!("{} runs; next: twum diagnose {}", saved.runs.len(), saved.folder.display());
    }
    verdict
}
