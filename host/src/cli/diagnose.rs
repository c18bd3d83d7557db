//! `twum diagnose`.

use super::existing::ExistingArgs;
use super::flavour::FlavourArgs;
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use twum_host::compare::simulation::mean_speeds_off;
use twum_host::diagnose::cache::{self, Kept};
use twum_host::diagnose::inertial::Model;
use twum_host::diagnose::{Details, Options, answer, diagnose, known_effects, saved};
use twum_host::input::{self, printable};
use twum_host::model::hypothesis::Hypothesis;
use twum_host::model::motor::{Motor, parse_hypotheses};
use twum_host::model::parameters::Flavour;
use twum_host::output;
use twum_host::record::load::load_runs;
use twum_host::record::measurement::Measurement;
use twum_host::report::diagnosis::page;

/// Arguments of `twum diagnose`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum diagnose bench3                       a page: what is wrong, the cause, how sure, what decides
  twum diagnose bench3 --json                the same for another program
  twum diagnose monday tuesday --report why.html
  twum diagnose bench3 --quick               a first look in seconds

The exit code is 0 if the question could be answered (whatever the answer), 2 if the folder could not be read.")]
pub struct Args {
    /// Measurement folders or recordings, diagnosed together
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Motor file, or the name of a shipped motor [default: the one the folder names]
    #[arg(long)]
    motor: Option<String>,
    /// Write the refitted motor with the effects found as a motor file; of an ordinary motor, as a file for `compare` and `model`
    #[arg(long, value_name = "EXTENDED.toml")]
    save_model: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
    #[command(flatten)]
    flavour: FlavourArgs,
    /// Take an effect out of the library (may be repeated): what would be said if it were not known?
    #[arg(long, value_name = "EFFECT")]
    without: Vec<String>,
    /// Search for effects of your own too: a file with formulas, `[effects.mine]` and by other names (may be repeated)
    #[arg(long, value_name = "MINE.toml")]
    effect: Vec<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Write a self-contained HTML report with the residual pictures
    #[arg(long, value_name = "OUT.html")]
    report: Option<PathBuf>,
    /// Seed of every random choice: the same seed gives the same answer
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Search again even if the same question was answered before
    #[arg(long)]
    no_cache: bool,
    /// A first look: fewer runs, shorter, a smaller null (the answer says what was left out)
    #[arg(long)]
    quick: bool,
    /// Say on stderr what it is doing, a line each: `progress SHARE WHAT`
    #[arg(long, hide = true)]
    progress: bool,
}

/// The runs of a measurement folder or a recording, and what was lost of them.
pub fn runs_of(folder: &Path) -> Result<(Measurement, Vec<String>)> {
    // What `twum experiment run` writes holds the measurement beside its recordings.
    let within = folder.join("measurement");
    load_runs(folder).with_context(|| {
        let hint = if within.is_dir() { format!(" (did you mean {}?)", within.display()) } else { String::new() };
        format!("reading {}{hint}", folder.display())
    })
}

/// The motor that is `given`, or that the measurement names; none for an ordinary one, which has no motor file.
pub fn motor_of(measurement: &Measurement, given: Option<&str>) -> Result<Option<Motor>> {
    if let (None, Some(text)) = (given, measurement.motor_text()) {
        return Ok(Some(Motor::parse("of the recording", text)?));
    }
    Ok(match (given, measurement.motor_file()) {
        (Some("inertial"), _) => None,
        (Some(name), _) => Some(Motor::load(name)?),
        (None, Some(_)) if measurement.folder.is_file() => bail!(
            "{}: names the motor file `{}` without its content, as recordings did before: give --motor FILE",
            measurement.folder.display(),
            printable(&measurement.motor)
        ),
        (None, Some(path)) => Some(Motor::load(&path.to_string_lossy())?),
        (None, None) if measurement.motor == "inertial" => None,
        (None, None) => Some(Motor::shipped(&measurement.motor)?),
    })
}

/// The effects in files of the user's own.
fn hypotheses(files: &[PathBuf]) -> Result<Vec<Arc<Hypothesis>>> {
    let mut all: Vec<Arc<Hypothesis>> = Vec::new();
    for path in files {
        let text =
            input::text(path, input::WRITTEN).with_context(|| format!("reading the effect {}", path.display()))?;
        for hypothesis in parse_hypotheses(&path.display().to_string(), &text)? {
            if all.iter().any(|h| h.name == hypothesis.name) {
                bail!(
                    "--effect {}: `effects.{}` is in another file too: give it a name of its own",
                    path.display(),
                    hypothesis.name
                );
            }
            all.push(Arc::new(hypothesis));
        }
    }
    Ok(all)
}

/// Runs `twum diagnose`.
pub fn run(args: Args) -> Result<ExitCode> {
    for path in args.save_model.iter().chain(&args.report) {
        output::may_write(path, args.existing.into())?;
    }
    let mut measurements = Vec::new();
    let mut lost = Vec::new();
    for folder in &args.folders {
        let (measurement, losses) = runs_of(folder)?;
        measurements.push(measurement);
        lost.extend(losses);
    }
    let flavour = args.flavour.get();
    let motor_file = motor_of(&measurements[0], args.motor.as_deref())?;
    let bar = ProgressBar::new(100).with_style(
        ProgressStyle::with_template("{bar:30} {msg}, {elapsed}; {eta} left").expect("the template is valid"),
    );
    let options = Options {
        seed: args.seed,
        quick: args.quick,
        coasting: flavour == Flavour::Thesis,
        motor: motor_file.as_ref().map(|m| m.parameters(flavour)),
        without: args.without.clone(),
        formulas: hypotheses(&args.effect)?,
    };
    for name in &args.without {
        if !known_effects().contains(name) {
            bail!("--without {name}: no effect of this name; the names are {}", known_effects().join(", "));
        }
    }
    // Reports and models need what the answer was drawn from.
    let fresh = args.no_cache || args.report.is_some() || args.save_model.is_some();
    let place = cache::default_folder().and_then(|folder| cache::Place::new(&folder, &measurements, &options));
    if let Some(kept) = place.as_ref().filter(|_| !fresh).and_then(cache::Place::read) {
        bar.finish_and_clear();
        eprintln!("answered before; --no-cache searches again");
        print!("{}", if args.json { kept.json } else { kept.text });
        return Ok(ExitCode::SUCCESS);
    }
    let (mut diagnosis, details) = diagnose(&measurements, &options, &|what, share| {
        if args.progress {
            eprintln!("progress {share:.3} {what}");
        }
        bar.set_message(what.to_owned());
        bar.set_position((share * 100.0) as u64);
    })?;
    bar.finish_and_clear();
    diagnosis.notes.extend(lost);
    if let Some(path) = &args.report {
        let title: Vec<&str> = measurements.iter().map(|m| m.name.as_str()).collect();
        let page = page(&title.join(", "), &diagnosis, details.as_ref());
        page.write(path)?;
        eprintln!("wrote {}", path.display());
    }
    let kept = Kept { json: serde_json::to_string_pretty(&diagnosis)? + "\n", text: answer::text(&diagnosis) };
    if let Some(error) = place.and_then(|place| place.write(&kept).err()) {
        eprintln!("the answer could not be kept for a second look: {error}");
    }
    print!("{}", if args.json { kept.json } else { kept.text });
    if let Some(path) = &args.save_model {
        let text = match (&motor_file, &details) {
            (Some(motor_file), Some(Details::Runs { problem, outcome })) => {
                let text = saved::file(motor_file, flavour, &outcome.extended, problem, &diagnosis)?;
                match repeats(&measurements, &text, flavour) {
                    Some(how_well) => {
                        eprintln!("{how_well}");
                        format!("# {how_well}\n{text}")
                    }
                    None => text,
                }
            }
            (_, Some(Details::Inertial(outcome))) => Model::of(&measurements[0].name, outcome)
                .context("--save-model: the runs are not of one motor; diagnose those that are")?
                .file(&diagnosis)?,
            _ => bail!("--save-model needs runs that could be used and, of a TWUM, a motor file"),
        };
        output::write(path, text, args.existing.into())?;
        eprintln!("wrote {}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// How well a saved model repeats the runs that it was fitted to: the motor model lacks what only the search's rotor has.
fn repeats(measurements: &[Measurement], saved: &str, flavour: Flavour) -> Option<String> {
    let motor = Motor::parse("saved.toml", saved).ok()?;
    let [off, speed] = mean_speeds_off(measurements, &motor, flavour)?;
    Some(format!(
        "the saved model's mean speeds are {off:.2} rpm off those measured, of {speed:.1} rpm (root mean squares); what the motor model has no number for, as the height from which the wave carries, is not in it"
    ))
}
