//! `twum velocity`.

use super::existing::ExistingArgs;
use super::output::{pieces, print_table, stage};
use anyhow::{Context, Result, bail};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use twum_host::output::{self, Output};
use twum_host::record::load::load_runs;
use twum_host::record::measurement::{Measurement, Run};
use twum_host::report::run::SpeedFigures;
use twum_host::report::speed::{Simulated, figure, overview};
use twum_host::signal::course::Drive;
use twum_host::signal::run::{Method, Motion, Options, motion, thesis_steps};
use twum_host::signal::score::score;
use twum_host::signal::thesis::Step;
use twum_host::signal::trial::{Encoder, Motion as Motions};
use twum_host::signal::window::Order;

/// Arguments of `twum velocity`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum velocity bench3                              mean speed, drift and ripple of every run
  twum velocity speed.mcap                          ... of the runs of a recording
  twum velocity bench3 --run d50-cw-0 --plot d50.svg --simulated-rpm 34.8
                                                    speed against time, angle and orders of a turn
  twum velocity bench3 --csv -                      position and speed at every sample, on stdout
  twum velocity bench3 --method thesis-butterworth  as the thesis estimated it (section A.7)
  twum velocity bench3 --csv steps.csv --method thesis-steps
                                                    every step of the thesis's method
  twum velocity --trials                            how far each method is off, on known motions

The methods are compared in docs/signals.md.")]
pub struct Args {
    /// Measurement folder (or its measurement.toml), or a recording
    #[arg(required_unless_present = "trials")]
    folder: Option<PathBuf>,
    /// Only the run with this id
    #[arg(long, value_name = "ID")]
    run: Option<String>,
    /// How speed is estimated
    #[arg(long, value_enum, default_value_t = MethodArg::Smoother)]
    method: MethodArg,
    /// Samples in the window of `--method window`
    #[arg(long, default_value_t = 61, value_name = "SAMPLES")]
    window: usize,
    /// Distance of the estimates in µs; by default that of the samples, or 1000
    #[arg(long, value_name = "US")]
    period_us: Option<f64>,
    /// Edges recorded with times are true within plus or minus this, in µs (500 for edges made from 1 kHz samples)
    #[arg(long, default_value_t = 2.0, value_name = "US")]
    edge_uncertainty_us: f64,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    /// Write position and speed at every sample to this file (- for stdout, instead of the summary)
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
    /// Draw the run to this file, .svg, .png or .html
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Draw a simulation's constant speed beside the run
    #[arg(long, value_name = "RPM", requires = "plot", allow_negative_numbers = true)]
    simulated_rpm: Option<f64>,
    /// Score every method on known motions and print the table
    #[arg(long, exclusive = true)]
    trials: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, clap::ValueEnum)]
enum MethodArg {
    /// Adapts to how fast the speed changes, with an uncertainty
    Smoother,
    /// The thesis's cubic over 21 samples
    ThesisRaw,
    /// ... after its Butterworth filter (6 Hz)
    ThesisButterworth,
    /// ... after its moving average over 101 samples
    ThesisAverage,
    /// ... after its median over 13 samples
    ThesisMedian,
    /// All of them, with --csv
    ThesisSteps,
    /// A cubic over one fixed window
    Window,
}

impl MethodArg {
    fn method(self, window: usize) -> Method {
        match self {
            Self::Smoother => Method::Smoother,
            Self::ThesisRaw | Self::ThesisSteps => Method::Thesis(Step::LocalCubic),
            Self::ThesisButterworth => Method::Thesis(Step::Butterworth),
            Self::ThesisAverage => Method::Thesis(Step::MovingAverage),
            Self::ThesisMedian => Method::Thesis(Step::Median),
            Self::Window => Method::Window(window, Order::Cubic),
        }
    }
}

/// Seeds of a motion in `--trials`.
const TRIAL_SEEDS: u64 = 6;

/// Runs `twum velocity`.
pub fn run(args: Args) -> Result<ExitCode> {
    if args.trials {
        let _waiting = stage("every method on every motion, twice");
        for (name, encoder) in [("An ideal encoder", Encoder::IDEAL), ("A rough encoder", Encoder::ROUGH)] {
            println!("# {name}\n\n{}", score(&Motions::all(), encoder, TRIAL_SEEDS)?);
        }
        return Ok(ExitCode::SUCCESS);
    }
    for path in args.plot.iter().chain(&args.csv).filter(|path| path.as_os_str() != "-") {
        output::may_write(path, args.existing.into())?;
    }
    let folder = args.folder.as_deref().expect("clap requires the folder without --trials");
    let (measurement, notes) = load_runs(folder)?;
    for note in notes {
        eprintln!("note: {note}");
    }
    let runs = chosen(&measurement, args.run.as_deref())?;
    let options = Options {
        method: args.method.method(args.window),
        edges_per_rev: measurement.edges_per_rev,
        period_us: args.period_us,
        edge_uncertainty_us: args.edge_uncertainty_us,
    };
    if args.method == MethodArg::ThesisSteps {
        let Some(csv) = &args.csv else { bail!("--method thesis-steps goes with --csv") };
        write_table(csv, args.existing, |out| write_steps(out, &runs, &options))?;
        return Ok(ExitCode::SUCCESS);
    }
    let bar = pieces("runs", runs.len());
    let motions = runs
        .iter()
        .map(|run| {
            bar.inc(1);
            motion(run, &options).with_context(|| format!("run {}", run.id))
        })
        .collect::<Result<Vec<_>>>()?;
    bar.finish_and_clear();
    if let Some(plot) = &args.plot {
        draw(plot, &measurement, &runs, &motions, args.simulated_rpm)?;
    }
    let summaries: Vec<SpeedFigures> =
        runs.iter().zip(&motions).map(|(run, motion)| SpeedFigures::of(run, motion)).collect();
    match &args.csv {
        Some(csv) => write_table(csv, args.existing, |out| write_motions(out, &runs, &motions))?,
        None if args.json => println!("{}", serde_json::to_string_pretty(&summaries)?),
        None => print_summaries(&summaries),
    }
    Ok(ExitCode::SUCCESS)
}

fn chosen<'a>(measurement: &'a Measurement, id: Option<&str>) -> Result<Vec<&'a Run>> {
    let runs: Vec<&Run> = measurement.runs.iter().filter(|run| id.is_none_or(|id| run.id == id)).collect();
    if runs.is_empty() {
        let ids: Vec<&str> = measurement.runs.iter().map(|run| run.id.as_str()).collect();
        bail!("{} has no run {}; it has: {}", measurement.folder.display(), id.unwrap_or_default(), ids.join(", "));
    }
    Ok(runs)
}

fn draw(path: &Path, measurement: &Measurement, runs: &[&Run], motions: &[Motion], rpm: Option<f64>) -> Result<()> {
    let picture = match (runs, motions) {
        ([run], [motion]) => {
            let ends = motion.time_us.first().zip(motion.time_us.last());
            let simulated = rpm.zip(ends).map(|(rpm, (from, to))| Simulated::constant(rpm, from * 1e-6, to * 1e-6));
            figure(&format!("{}, run {}", measurement.name, run.id), motion, Drive::of(run), simulated.as_ref())?
        }
        _ => {
            let named: Vec<(&Run, &Motion)> = runs.iter().copied().zip(motions).collect();
            overview(&measurement.name, &named, rpm)
        }
    };
    picture.write(path)?;
    Ok(())
}

fn print_summaries(summaries: &[SpeedFigures]) {
    let shown = |v: Option<f64>, decimals: usize| v.map_or("-".to_owned(), |v| format!("{v:.decimals$}"));
    let ms = |v: Option<f64>| shown(v.map(|v| v * 1e3), 0);
    let rows: Vec<Vec<String>> = summaries
        .iter()
        .map(|s| {
            let c = &s.course;
            vec![
                s.id.clone(),
                shown(s.duty, 2),
                format!("{:.2}", s.duration_s),
                s.edges.to_string(),
                shown(c.mean_rpm, 3),
                shown(s.speed_sd_rpm, 3),
                shown(s.drift_rpm_per_s, 3),
                shown(s.ripple_rpm.map(|a| a[0]), 2),
                shown(s.ripple_rpm.map(|a| a[1]), 2),
                ms(c.rise_s),
                shown(c.start_peak_rpm, 2),
                shown(c.overshoot.map(|v| 100.0 * v), 0),
                ms(c.stop_s),
                shown(c.coast_deg, 1),
            ]
        })
        .collect();
    let header = [
        "run",
        "duty",
        "time s",
        "edges",
        "mean rpm",
        "sd rpm",
        "rpm/s",
        "1/turn",
        "2/turn",
        "rise ms",
        "peak rpm",
        "over %",
        "stop ms",
        "coast \u{b0}",
    ];
    print_table(&header, &rows);
    eprintln!(
        "mean, sd, drift and ripple are of the driven part after its first 0.2 s; rise, peak and overshoot are of that start, \
         stop and coast of what follows the drive. sd is of the estimate at a moment, not of the mean: edges say little of \
         the speed between pulses."
    );
}

fn write_table(path: &Path, existing: ExistingArgs, fill: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    if path.as_os_str() == "-" {
        let mut out = std::io::BufWriter::new(std::io::stdout().lock());
        fill(&mut out)?;
        return Ok(out.flush()?);
    }
    let mut out = Output::begin(path, existing.into())?;
    fill(&mut out).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(out.finish()?)
}

fn write_motions(out: &mut dyn Write, runs: &[&Run], motions: &[Motion]) -> Result<()> {
    writeln!(out, "run,time_us,position_rad,rpm,rpm_sd")?;
    for (run, m) in runs.iter().zip(motions) {
        for i in 0..m.time_us.len() {
            let sd = m.speed_sd_rpm.as_ref().map_or(String::new(), |sd| format!("{:.6}", sd[i]));
            writeln!(out, "{},{:.3},{:.8},{:.6},{sd}", run.id, m.time_us[i], m.position_rad[i], m.speed_rpm[i])?;
        }
    }
    Ok(())
}

fn write_steps(out: &mut dyn Write, runs: &[&Run], options: &Options) -> Result<()> {
    writeln!(out, "run,time_us,spline_rad,position_rad,rpm_raw,rpm_butterworth,rpm_moving_average,rpm_median")?;
    for run in runs {
        let s = thesis_steps(run, options).with_context(|| format!("run {}", run.id))?;
        for i in 0..s.time_us.len() {
            writeln!(
                out,
                "{},{:.3},{:.8},{:.8},{:.6},{:.6},{:.6},{:.6}",
                run.id,
                s.time_us[i],
                s.spline_rad[i],
                s.fit.position_rad[i],
                s.fit.raw_rpm[i],
                s.butterworth_rpm[i],
                s.moving_average_rpm[i],
                s.median_rpm[i]
            )?;
        }
    }
    Ok(())
}
