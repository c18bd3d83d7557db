//! `twum experiment`.

use super::configuration::ConfigurationArgs;
use super::connect::ConnectArgs;
use super::diagnose::{motor_of, runs_of};
use super::output::{answer, stage};
use super::series::Bench;
use super::{exit, units};
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::diagnose::inertial::{InputRun, next_inputs};
use twum_host::diagnose::plan::{PlannedRun, first_experiment, next_runs};
use twum_host::diagnose::{Details, Options, diagnose};
use twum_host::model::parameters::Flavour;
use twum_host::pulses;
use twum_host::record::series::{Series, SeriesError, SeriesRun, duration_ms};

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
    Run(Box<RunArgs>),
    /// Say which pulses of the drive are followed, from the runs of `experiment run --pulses`
    Pulses(super::pulses::Args),
}

/// A first experiment: every tenth of the duty, thrice, long enough for three turns at full drive.
const DUTIES: &str = "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0";
const TRIALS: usize = 3;
const SECONDS: f64 = 5.0;

#[derive(Debug, clap::Args)]
struct Wanted {
    /// Folders measured so far; without any, a first experiment is planned
    folders: Vec<PathBuf>,
    /// Duties of a first experiment
    #[arg(long, value_delimiter = ',', default_value = DUTIES)]
    duties: Vec<String>,
    /// Repetitions of each duty and direction in a first experiment
    #[arg(long, default_value_t = TRIALS)]
    trials: usize,
    /// Length of each run of a first experiment, s
    #[arg(long, default_value_t = SECONDS)]
    seconds: f64,
    /// Instead, ask how short a pulse of the drive is followed: pulses of 10, 2, 1 and 0.5 ms at half duty, and of 4, 2 and 1 ms
    /// every 20 ms, both ways
    #[arg(long, conflicts_with_all = ["folders", "duties", "trials", "seconds"])]
    pulses: bool,
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
    /// New folder: the plan, the recordings, and the measurement made of them
    #[arg(long, short)]
    out: PathBuf,
    /// Go on with the folder's own plan, with the runs that are not finished
    #[arg(long)]
    resume: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum experiment`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.what {
        What::Plan(args) => plan(&args),
        What::Run(args) => make(&args),
        What::Pulses(args) => super::pulses::run(&args),
    }
}

/// What to do next: runs of the board, or inputs of a motor that another drive moves.
enum Plan {
    Board(Vec<PlannedRun>),
    Inputs(Vec<InputRun>),
}

fn planned(wanted: &Wanted) -> Result<Plan> {
    if wanted.pulses {
        return Ok(Plan::Board(pulses::plan()));
    }
    duration_ms(wanted.seconds).context("--seconds")?;
    let duties = wanted.duties.iter().map(|d| units::duty(d)).collect::<Result<Vec<_>>>().context("--duties")?;
    if wanted.folders.is_empty() {
        return Ok(Plan::Board(first_experiment(&duties, wanted.trials, wanted.seconds, 50.0)));
    }
    let mut measurements = Vec::new();
    for folder in &wanted.folders {
        measurements.push(runs_of(folder)?.0);
    }
    let motor = motor_of(&measurements[0], None)?.map(|m| m.parameters(Flavour::Physical));
    let options = Options { quick: true, motor, ..Options::default() };
    let waiting = stage("what is open");
    let (diagnosis, details) = diagnose(&measurements, &options, &|what, share| {
        waiting.set_message(format!("what is open: {what}, {:.0} %", 100.0 * share));
    })?;
    waiting.finish_and_clear();
    Ok(match details {
        Some(Details::Inertial(outcome)) => Plan::Inputs(next_inputs(&outcome, diagnosis.replicated)),
        _ if measurements.iter().any(|m| m.motor == "inertial") => {
            bail!("nothing can be planned for these runs: {}", diagnosis.notes.join("; "))
        }
        _ => Plan::Board(next_runs(&measurements, &diagnosis)),
    })
}

/// The runs of the board: another drive has to be given its inputs by who owns it.
fn board_runs(wanted: &Wanted) -> Result<Vec<PlannedRun>> {
    match planned(wanted)? {
        Plan::Board(runs) => Ok(runs),
        Plan::Inputs(_) => {
            bail!("an ordinary motor is not driven by the board: `twum experiment plan` says which inputs to give it")
        }
    }
}

/// Says which inputs to give to a motor that another drive moves.
fn plan_inputs(runs: &[InputRun], json: bool) -> Result<ExitCode> {
    if json {
        println!("{}", serde_json::to_string_pretty(runs)?);
    } else if runs.is_empty() {
        eprintln!("nothing is open that another run would decide");
    } else {
        eprintln!("{} inputs to give to the motor's own drive:", runs.len());
        runs.iter().for_each(|run| println!("{}", run.text()));
    }
    Ok(ExitCode::SUCCESS)
}

fn plan(args: &PlanArgs) -> Result<ExitCode> {
    let runs = match planned(&args.wanted)? {
        Plan::Board(runs) => runs,
        Plan::Inputs(runs) => return plan_inputs(&runs, args.json),
    };
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

/// The plan as the folder keeps it.
fn series_of(runs: &[PlannedRun]) -> Vec<SeriesRun> {
    runs.iter().enumerate().map(|(number, run)| run.in_series(number)).collect()
}

impl Wanted {
    /// Whether a plan is asked for; none is when all is left as it is by default.
    fn is_default(&self) -> bool {
        !self.pulses
            && self.folders.is_empty()
            && self.duties.join(",") == DUTIES
            && self.trials == TRIALS
            && self.seconds == SECONDS
    }
}

/// The series to begin, or to go on with; nothing when nothing is open.
enum Task {
    Begin(Vec<SeriesRun>),
    Resume(Series),
}

fn task(args: &RunArgs) -> Result<Option<Task>> {
    if args.resume {
        let asked = if args.wanted.is_default() { None } else { Some(series_of(&board_runs(&args.wanted)?)) };
        return Ok(Some(Task::Resume(Series::resume(&args.out, asked.as_deref())?)));
    }
    if args.out.exists() {
        return Err(SeriesError::Exists(args.out.clone()).into());
    }
    let runs = series_of(&board_runs(&args.wanted)?);
    Ok((!runs.is_empty()).then_some(Task::Begin(runs)))
}

fn make(args: &RunArgs) -> Result<ExitCode> {
    // What is wrong with the arguments is said before the port is opened, and a refused command leaves no folder.
    let Some(task) = task(args)? else {
        eprintln!("nothing is open that another run would decide");
        return Ok(ExitCode::SUCCESS);
    };
    let bench =
        Bench { connect: &args.connect, configuration: &args.configuration, limited: |configuration| configuration };
    let (series, result) = bench.make(|| match task {
        Task::Begin(runs) => Ok(Series::begin(&args.out, runs)?),
        Task::Resume(series) => Ok(series),
    })?;
    let verdict = result.map(|()| 0);
    exit::decide(&verdict);
    conclude(args, &series, verdict)
}

/// However the series ended, what was made to its end becomes a measurement.
fn conclude(args: &RunArgs, series: &Series, verdict: Result<u8>) -> Result<ExitCode> {
    let measured = series.measure();
    let made = measured.as_ref().ok().and_then(|(saved, _)| saved.as_ref()).map_or(0, |saved| saved.runs.len());
    if verdict.is_err() {
        eprintln!(
            "{made} of {} runs were made; {} keeps what was recorded, and `twum experiment run --resume --out {}` goes on",
            series.runs().len(),
            series.recordings().display(),
            args.out.display()
        );
    }
    match measured {
        Ok((saved, notes)) => {
            notes.iter().for_each(|note| eprintln!("{note}"));
            if let Some(saved) = saved {
                let value = serde_json::json!({
                    "folder": saved.folder,
                    "runs": saved.runs.iter().map(|run| &run.id).collect::<Vec<_>>(),
                    "planned": series.runs().len(),
                });
                answer(args.json, &value, &saved.folder.display().to_string());
                eprintln!("{made} of {} runs; next: twum diagnose {}", series.runs().len(), args.out.display());
            }
        }
        // Why the runs ended is what there is to say first.
        Err(error) if verdict.is_err() => eprintln!("no measurement was made of them: {error}"),
        Err(error) => return Err(error.into()),
    }
    verdict.map(ExitCode::from)
}
