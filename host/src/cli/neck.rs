//! `twum neck`.

use super::connect::{INTERRUPTED, catch_interrupts};
use super::existing::ExistingArgs;
use super::flavour::FlavourArgs;
use super::output::{pieces, stage};
use super::uncertainty::UncertaintyArgs;
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::Solver;
use twum_host::model::uncertainty::Band;
use twum_host::neck::control::Controller;
use twum_host::neck::disturbance::Disturbance;
use twum_host::neck::exercise::Exercise;
use twum_host::neck::kinematics::{JOINTS, THESIS_LENGTH_M, Wrist};
use twum_host::neck::load::Head;
use twum_host::neck::motor::JointMotor;
use twum_host::neck::score::Score;
use twum_host::neck::session::{DEFAULT_EDGES_PER_REV, Session, Setup};
use twum_host::neck::study::Study;
use twum_host::neck::{foxglove, path};
use twum_host::output::{self, Output};
use twum_host::report::neck::report::Report;
use twum_host::report::neck::{page, picture};

/// Arguments of `twum neck`.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "\
Examples:
  twum neck                                          the thesis's three exercises, beside its Table 5.6
  twum neck --flavour thesis                         ... as the thesis had them: its model and its controller
  twum neck --exercise rotation --json
  twum neck --plot neck.png --report neck.html --mcap neck.mcap
  twum neck --disturbance-deg 8 --disturbance-hz 0.5 --disturbance-joints 2
  twum neck --exercise flexion-extension --head-kg 0.05 --head-centre 0.12
  twum neck --motor own/motor.toml --flavour measured --uncertainty
  twum neck exercises flexion-extension > mine.toml  a file to start one's own from
  twum neck --exercise mine.toml
  twum neck path --exercise mine.toml --json
  twum neck study --out study.csv                    1008 cases; `twum neck study --example` shows their file"
)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Print the joint paths of an exercise: angles, velocities, accelerations and end point
    Path(PathArgs),
    /// Simulate every combination of exercises, motors, disturbances and sensors, to CSV
    Study(StudyArgs),
    /// List the shipped exercises, or print the file of one
    Exercises {
        /// Exercise whose file to print
        name: Option<String>,
        /// Print the list as JSON
        #[arg(long, conflicts_with = "name")]
        json: bool,
    },
}

#[derive(Debug, clap::Args)]
struct RunArgs {
    /// Exercise: flexion-extension, lateral-flexion, rotation, all of them, or a file
    #[arg(long, default_value = "all", value_name = "NAME|FILE|all")]
    exercise: String,
    /// Motor at each joint: a shipped one or a file
    #[arg(long, default_value = "pcbmotor-30mm", value_name = "NAME|FILE")]
    motor: String,
    #[command(flatten)]
    flavour: FlavourArgs,
    /// Controller, tuned for 400 edges a revolution: `thesis`, `default`, `gated`, `planned`, or a TOML file as for `twum track`
    /// [default: `thesis` with the thesis flavour, `default` otherwise]
    #[arg(long, value_name = "NAME|FILE")]
    control: Option<String>,
    /// Motor model: the wave's envelope, or every one of its cycles (minutes an exercise)
    #[arg(long, value_enum, default_value_t = SolverArg::Averaged)]
    solver: SolverArg,
    /// Resolution of the sensor at each joint, edges a revolution
    #[arg(long, default_value_t = DEFAULT_EDGES_PER_REV)]
    edges_per_rev: u32,
    /// PWM frequency, Hz [default: the controller's: 50, or one period a tick for a drive that is gated]
    #[arg(long)]
    pwm_hz: Option<f64>,
    /// Amplitude of the disturbance, ° (0 for none; the thesis does not state its own)
    #[arg(long, default_value_t = 5.0)]
    disturbance_deg: f64,
    /// Frequency of the disturbance, Hz
    #[arg(long, default_value_t = 0.2)]
    disturbance_hz: f64,
    /// Phase of the disturbance at the start, °
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    disturbance_phase_deg: f64,
    /// Joints the disturbance moves
    #[arg(long, value_delimiter = ',', default_value = "1,2,3", value_parser = clap::value_parser!(u8).range(1..=3))]
    disturbance_joints: Vec<u8>,
    /// Mass the motors carry on the neck's axis, kg
    #[arg(long, default_value_t = 0.0)]
    head_kg: f64,
    /// Distance of that mass from the wrist's centre, m
    #[arg(long, default_value_t = 0.12)]
    head_centre: f64,
    /// Distance of the end point from the wrist's centre, m
    #[arg(long, default_value_t = THESIS_LENGTH_M)]
    neck_length: f64,
    #[command(flatten)]
    uncertainty: UncertaintyArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Draw trajectories and errors, as .svg, .png or .html
    #[arg(long = "plot", alias = "figure", value_name = "FILE")]
    figure: Option<PathBuf>,
    /// Write a page that plays the exercises in three dimensions, without a network
    #[arg(long = "report", alias = "page", value_name = "FILE.html")]
    page: Option<PathBuf>,
    /// Write an MCAP file with frame transforms, for Foxglove
    #[arg(long, value_name = "FILE.mcap")]
    mcap: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
}

#[derive(Debug, clap::Args)]
struct PathArgs {
    /// Exercise: flexion-extension, lateral-flexion, rotation, or a file
    #[arg(long, value_name = "NAME|FILE")]
    exercise: String,
    /// Points a second
    #[arg(long, default_value_t = 100.0)]
    rate_hz: f64,
    /// Distance of the end point from the wrist's centre, m
    #[arg(long, default_value_t = THESIS_LENGTH_M)]
    neck_length: f64,
    /// Print JSON instead of CSV
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct StudyArgs {
    /// Study file [default: the 1008 cases of --example]
    file: Option<PathBuf>,
    /// CSV file [default: standard output]
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Print the cases as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    existing: ExistingArgs,
    /// Print the study file that is used when none is given
    #[arg(long)]
    example: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum SolverArg {
    Averaged,
    Carrier,
}

/// Runs `twum neck`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.command {
        None => simulate(args.run),
        Some(Command::Path(args)) => print_path(&args),
        Some(Command::Study(args)) => study(&args),
        Some(Command::Exercises { name, json }) => exercises(name, json),
    }
}

fn simulate(args: RunArgs) -> Result<ExitCode> {
    for path in args.figure.iter().chain(&args.page).chain(&args.mcap) {
        output::may_write(path, args.existing.into())?;
    }
    let exercises = match args.exercise.as_str() {
        "all" => Exercise::SHIPPED.iter().map(|name| Exercise::shipped(name)).collect::<Result<Vec<_>, _>>()?,
        name => vec![Exercise::load(name)?],
    };
    let setup = setup(&args)?;
    let waiting = stage("simulating");
    let sessions = setup.simulate_all(&exercises)?;
    waiting.finish_and_clear();
    let scores: Vec<Score> = sessions.iter().map(|session| Score::of(session, &setup)).collect();
    let report = Report::new(&setup, scores.clone());
    let bands = bands(&args, &setup, &exercises)?;
    if args.json {
        let mut told = serde_json::to_value(&report)?;
        if let Some(bands) = &bands {
            told["uncertainty"] = args.uncertainty.json(json!({ "mean_abs_error_m": bands }));
        }
        emit(format!("{}\n", serde_json::to_string_pretty(&told)?).as_bytes())?;
    } else {
        emit(report.text().as_bytes())?;
        for (exercise, band) in bands.iter().flatten() {
            let [low, high] = band.ci95;
            let words = args.uncertainty.words();
            emit(format!("{exercise}: mean end-point error {low:.6} to {high:.6} m ({words})\n").as_bytes())?;
        }
    }
    let all: Vec<&Session> = sessions.iter().collect();
    if let Some(file) = args.figure {
        picture::figure(&all).write(&file)?;
        eprintln!("wrote {}", file.display());
    }
    if let Some(file) = args.page {
        let played: Vec<_> = sessions.iter().zip(&scores).collect();
        let html = page::page("Neck range-of-motion exercises", &report.setup_line(), &played);
        output::write(&file, html, args.existing.into())?;
        eprintln!("wrote {}", file.display());
    }
    if let Some(file) = args.mcap {
        let mut to = Output::begin(&file, args.existing.into())?;
        foxglove::write(&all, &mut to).with_context(|| file.display().to_string())?;
        to.finish()?;
        eprintln!("wrote {}", file.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Where each exercise's mean end-point error lies for motors that the file leaves possible (m).
fn bands(args: &RunArgs, setup: &Setup, exercises: &[Exercise]) -> Result<Option<BTreeMap<String, Band>>> {
    let (flavour, solver) = (setup.motor.flavour(), setup.motor.solver());
    let motor = Motor::load(&args.motor)?;
    let Some(motors) = args.uncertainty.draws(&motor, flavour, setup.motor.parameters(), &[])? else {
        return Ok(None);
    };
    let bar = pieces("motors", motors.len());
    let mut errors: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for parameters in motors {
        let motor = JointMotor::new(motor.name.clone(), parameters, flavour, solver);
        let other = Setup { motor, ..setup.clone() };
        let sessions = other.simulate_all(exercises).context("with one of the motors that the file leaves possible")?;
        for score in sessions.iter().map(|session| Score::of(session, &other)) {
            errors.entry(score.exercise).or_default().push(score.mean_abs_error_m);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Some(errors.into_iter().map(|(exercise, values)| (exercise, Band::of(values))).collect()))
}

fn setup(args: &RunArgs) -> Result<Setup> {
    let flavour = args.flavour.get();
    let asked = args.control.as_deref().map(Controller::load).transpose().context("--control")?;
    let control = asked.unwrap_or_else(|| Controller::of(flavour));
    let solver = match args.solver {
        SolverArg::Averaged => Solver::Averaged,
        SolverArg::Carrier => Solver::Carrier,
    };
    let mut joints = [false; JOINTS];
    for joint in &args.disturbance_joints {
        joints[usize::from(*joint) - 1] = true;
    }
    Ok(Setup {
        motor: JointMotor::load(&args.motor, flavour, solver)?,
        edges_per_rev: args.edges_per_rev,
        pwm_hz: args.pwm_hz.unwrap_or(f64::from(control.spec.pwm_hz())),
        control,
        disturbance: Disturbance {
            amplitude_deg: args.disturbance_deg,
            frequency_hz: args.disturbance_hz,
            phase_deg: args.disturbance_phase_deg,
            joints,
        },
        head: Head { mass_kg: args.head_kg, centre_m: args.head_centre },
        wrist: Wrist { length_m: args.neck_length },
    })
}

fn print_path(args: &PathArgs) -> Result<ExitCode> {
    let exercise = Exercise::load(&args.exercise)?;
    if !(args.rate_hz > 0.0 && args.rate_hz <= 1e5) {
        bail!("--rate-hz {}: above 0 and up to 100000", args.rate_hz);
    }
    let points = path::table(&exercise, Wrist { length_m: args.neck_length }, args.rate_hz);
    if args.json {
        let json = json!({"exercise": exercise.name(), "points": points});
        emit(format!("{}\n", serde_json::to_string(&json)?).as_bytes())?;
    } else {
        let mut out = csv::Writer::from_writer(Vec::new());
        out.write_record([
            "time_s",
            "q1_deg",
            "q2_deg",
            "q3_deg",
            "qd1_deg_s",
            "qd2_deg_s",
            "qd3_deg_s",
            "qdd1_deg_s2",
            "qdd2_deg_s2",
            "qdd3_deg_s2",
            "x_m",
            "y_m",
            "z_m",
        ])?;
        for p in &points {
            out.serialize((p.time_s, p.angles_deg, p.velocities_deg_s, p.accelerations_deg_s2, p.end_point_m))?;
        }
        emit(&out.into_inner()?)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn study(args: &StudyArgs) -> Result<ExitCode> {
    if args.example {
        emit(Study::SHIPPED.as_bytes())?;
        return Ok(ExitCode::SUCCESS);
    }
    let study = match &args.file {
        Some(file) => Study::load(file)?,
        None => Study::shipped(),
    };
    let bar = ProgressBar::new(study.cases() as u64).with_style(bar_style());
    bar.set_message("cases");
    if let Some(file) = &args.out {
        output::may_write(file, args.existing.into())?;
    }
    catch_interrupts()?;
    let rows = study.run(&INTERRUPTED, |done| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let mut table = csv::Writer::from_writer(Vec::new());
    for row in &rows {
        table.serialize(row)?;
    }
    let table = table.into_inner()?;
    match &args.out {
        Some(file) => output::write(file, table, args.existing.into())?,
        None if args.json => {}
        None => emit(&table)?,
    }
    if args.json {
        emit(format!("{}\n", serde_json::to_string(&rows)?).as_bytes())?;
    }
    let refused = rows.iter().filter(|row| row.refused.is_some()).count();
    eprintln!("{} cases, {refused} of them refused", rows.len());
    if rows.len() < study.cases() {
        eprintln!("error: interrupted: {} of {} cases are in the table", rows.len(), study.cases());
        return Ok(ExitCode::from(130));
    }
    Ok(ExitCode::SUCCESS)
}

fn exercises(name: Option<String>, json: bool) -> Result<ExitCode> {
    if let Some(name) = name {
        let Some(file) = Exercise::shipped_file(&name) else {
            bail!("no exercise `{name}` is shipped: {}", Exercise::SHIPPED.join(", "));
        };
        emit(file.as_bytes())?;
        return Ok(ExitCode::SUCCESS);
    }
    if json {
        let mut list = Vec::new();
        for name in Exercise::SHIPPED {
            let exercise = Exercise::shipped(name)?;
            let (title, source) = (exercise.title(), exercise.source());
            list.push(json!({ "name": name, "title": title, "seconds": exercise.duration_s(), "source": source }));
        }
        emit(format!("{}\n", json!(list)).as_bytes())?;
        return Ok(ExitCode::SUCCESS);
    }
    for name in Exercise::SHIPPED {
        let exercise = Exercise::shipped(name)?;
        let line = format!("{name:<20} {} ({} s; {})\n", exercise.title(), exercise.duration_s(), exercise.source());
        emit(line.as_bytes())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints data; a reader that has seen enough (`| head`) is no error.
fn emit(data: &[u8]) -> Result<()> {
    match std::io::stdout().lock().write_all(data) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error).context("standard output"),
        _ => Ok(()),
    }
}

fn bar_style() -> ProgressStyle {
    ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").expect("the template is a constant")
}
