//! `twum model loop`.

use super::super::existing::ExistingArgs;
use super::super::output::stage;
use super::super::units;
use super::{Common, print_json};
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;
use twum_host::configuration::controller;
use twum_host::model::closed_loop::{Following, Hand, LoopProgram, Tick, following, run as run_loop, run_pushed};
use twum_host::model::guidance::Guidance;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant};
use twum_host::model::robust::Drawn;
use twum_host::model::study::Setup;
use twum_host::model::uncertainty::Band;
use twum_host::output::{self, Output};
use twum_host::report::figure::{Figure, Panel};
use twum_host::tune::margins::{Rig, holds};
use twum_shared::step::{Config, ConfigSpec};

/// Arguments of `twum model loop`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    common: Common,
    /// Controller: `thesis`, `default`, `gated`, `planned`, or a TOML file: its `[control]` as `twum config dump` writes it, or gains
    #[arg(long, default_value = "thesis")]
    control: String,
    /// Amplitude of the sine (counts)
    #[arg(long, default_value_t = 89)]
    amplitude: i32,
    /// Angular frequency of the sine (rad/s)
    #[arg(long, default_value_t = 1.257)]
    omega: f64,
    /// A hand pushes the rotor clockwise from a quarter of the run on: N·m:HZ, a sine, or N·m, a ramp up to that
    #[arg(long, value_name = "N·m[:HZ]", allow_hyphen_values = true)]
    hand: Option<String>,
    /// Count edges in the rotor's true sense, not the direction pin's: what no one-line encoder can do
    #[arg(long)]
    true_sense: bool,
    /// Write every control tick to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
}

#[derive(Serialize)]
struct LoopAnswer {
    #[serde(flatten)]
    following: Following,
    #[serde(skip_serializing_if = "Option::is_none")]
    guidance: Option<Guidance>,
    /// Speed at full drive that a controller with a model of its rotor believes in the end, either way.
    full_counts_s: [f64; 2],
    ticks: usize,
    wall_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertainty: Option<serde_json::Value>,
}

/// Where the figures lie for motors that the file leaves possible.
#[derive(Serialize)]
struct Bands {
    mse_deg2: Band,
    mean_abs_deg: Band,
    true_mse_deg2: Band,
    true_mean_abs_deg: Band,
}

impl Bands {
    fn of(program: &LoopProgram, motors: &[Setup]) -> Result<Self> {
        let one = |motor: &Setup| -> Result<Following> {
            let effects = &motor.effects;
            let mut plant = MotorPlant::new(motor.parameters, motor.flavour, motor.solver, effects, History::default());
            Ok(following(program, &run_loop(program, &mut plant, effects)?))
        };
        let found = motors.par_iter().map(one).collect::<Result<Vec<_>>>()?;
        let band = |f: &dyn Fn(&Following) -> f64| Band::of(found.iter().map(f).collect());
        Ok(Self {
            mse_deg2: band(&|f| f.mse_deg2),
            mean_abs_deg: band(&|f| f.mean_abs_deg),
            true_mse_deg2: band(&|f| f.true_mse_deg2),
            true_mean_abs_deg: band(&|f| f.true_mean_abs_deg),
        })
    }
}

pub fn run(args: Args) -> Result<()> {
    let Args { common, control, amplitude, omega, hand, true_sense, csv, existing } = args;
    let spec = controller(&control).context("--control")?;
    let common = Common { pwm_hz: common.pwm_hz.or(Some(f64::from(spec.pwm_hz()))), ..common };
    let setup = common.setup(1.0, 10.0)?;
    if let Some(path) = &csv {
        output::may_write(path, existing.into())?;
    }
    let hand = hand.map(|text| self::hand(&text, setup.seconds)).transpose()?;
    let reference = units::sine(amplitude, omega).context("--amplitude or --omega")?;
    let program = LoopProgram {
        config: Config::try_from(spec)?,
        reference,
        pwm_hz: setup.pwm_hz,
        edges_per_rev: Motor::load(&common.motor)?.edges_per_rev,
        encoder_phase_rad: 0.0,
        end_s: setup.seconds,
        true_sense,
    };
    let effects = setup.effects.clone();
    let motor = Drawn { flavour: setup.flavour, parameters: setup.parameters, effects: effects.clone() };
    let rig = Rig { motor, edges_per_rev: program.edges_per_rev, pwm_hz: Some(program.pwm_hz) };
    // Nothing is at stake here: this is where a loop that swings may be looked at.
    if ConfigSpec::named(&control).is_none()
        && let Err(swings) = holds(&rig, &spec)?
    {
        eprintln!("warning: --control {control}: {swings}");
    }
    let mut plant = MotorPlant::new(setup.parameters, setup.flavour, setup.solver, &effects, History::default());
    let began = std::time::Instant::now();
    let waiting = stage("simulating the closed loop");
    let trace = match &hand {
        Some(hand) => run_pushed(&program, &mut plant, &effects, |plant, time_s| plant.push(hand.at(time_s)))?,
        None => run_loop(&program, &mut plant, &effects)?,
    };
    waiting.finish_and_clear();
    let wall_s = began.elapsed().as_secs_f64();
    let following = following(&program, &trace);
    let guidance = hand.and_then(|hand| Guidance::of(&hand, &trace));
    let bands = common.possible(&setup)?.map(|motors| Bands::of(&program, &motors)).transpose()?;
    if common.json {
        let uncertainty = bands.as_ref().map(|bands| common.uncertainty.json(serde_json::json!(bands)));
        let full_counts_s = trace.last().map_or([0.0; 2], |tick| tick.full_counts_s);
        print_json(&LoopAnswer { following, guidance, full_counts_s, ticks: trace.len(), wall_s, uncertainty })?;
    } else {
        println!("counted  {:.3} deg2 MSE, {:.3} deg mean |error|", following.mse_deg2, following.mean_abs_deg);
        println!(
            "true     {:.3} deg2 MSE, {:.3} deg mean |error|",
            following.true_mse_deg2, following.true_mean_abs_deg
        );
        if let Some(bands) = &bands {
            let between = |b: Band| format!("{:.3} to {:.3}", b.ci95[0], b.ci95[1]);
            println!(
                "mean |error|: counted {} deg, true {} deg ({})",
                between(bands.mean_abs_deg),
                between(bands.true_mean_abs_deg),
                common.uncertainty.words()
            );
        }
        println!("the count ended {} counts off the true position", following.miscount);
        let believed = trace.last().map_or([0.0; 2], |tick| tick.full_counts_s);
        if believed != [0.0; 2] {
            let [cw, ccw] = believed;
            println!(
                "the controller ended believing in {cw:.0} counts/s clockwise at full drive, {ccw:.0} the other way"
            );
        }
        if let Some(guidance) = guidance {
            println!("{}", words(&guidance));
        }
    }
    if let Some(path) = csv {
        let mut out = Output::begin(&path, existing.into())?;
        write_csv(&mut out, &trace).with_context(|| format!("cannot write {}", path.display()))?;
        out.finish()?;
    }
    common.draw(|| Ok(loop_figure(&program, &trace, &setup)))
}

/// A hand of the command line, in a run so long (s).
pub fn hand(text: &str, seconds: f64) -> Result<Hand> {
    let (torque, hz) = text.split_once(':').unwrap_or((text, "0"));
    let number = |word: &str| -> Result<f64> {
        let value: f64 = word.trim().parse().with_context(|| format!("--hand {text}: `{word}` is not a number"))?;
        // Any torque that a hand has, and any frequency.
        if !(-10.0..=100.0).contains(&value) {
            bail!("--hand {text}: {value} is outside -10 ..= 100");
        }
        Ok(value)
    };
    let (torque_nm, frequency_hz) = (number(torque)?, number(hz)?);
    if frequency_hz < 0.0 {
        bail!("--hand {text}: a frequency is not negative");
    }
    Ok(Hand { torque_nm, frequency_hz, from_s: 0.25 * seconds, until_s: seconds })
}

fn words(g: &Guidance) -> String {
    if g.believed == 0.0 {
        return format!("hand     {:.1} uN·m in the mean; never believed to be there", 1e6 * g.mean_abs_hand_nm);
    }
    format!(
        "hand     {:.1} uN·m in the mean; believed {:.0} % of the time, then {:.1} uN·m off in the mean, {:+.1} on the whole; \
         the target left its path by up to {:.1} counts",
        1e6 * g.mean_abs_hand_nm,
        100.0 * g.believed,
        1e6 * g.mean_abs_error_nm,
        1e6 * g.mean_error_nm,
        g.farthest_counts
    )
}

/// The `control` format of a measurement folder.
fn write_csv(out: &mut Output, trace: &[Tick]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record(["time_us", "target", "position", "u", "duty", "direction"])?;
    for tick in trace {
        writer.write_record([
            format!("{:.0}", tick.time_s * 1e6),
            tick.target.to_string(),
            tick.position.to_string(),
            format!("{:.5}", f64::from(tick.u) / 65536.0),
            format!("{:.6}", tick.duty),
            tick.direction.sign().to_string(),
        ])?;
    }
    writer.flush()?;
    Ok(())
}

fn loop_figure(program: &LoopProgram, trace: &[Tick], setup: &Setup) -> Figure {
    let count_deg = 360.0 / f64::from(program.edges_per_rev);
    let thin: Vec<&Tick> = trace.iter().step_by((trace.len() / 4000).max(1)).collect();
    let of = |f: &dyn Fn(&Tick) -> f64| thin.iter().map(|tick| (tick.time_s, f(tick))).collect::<Vec<_>>();
    let target = of(&|t| f64::from(t.target) * count_deg);
    let truth = of(&|t| t.angle_rad.to_degrees());
    let error = of(&|t| f64::from(t.target) * count_deg - t.angle_rad.to_degrees());
    let duty = of(&|t| t.duty * f64::from(t.direction.sign()));
    Figure::new(format!("Position control of the {} motor model", setup.flavour))
        .size(1000, 1000)
        .panel(Panel::new("time (s)", "angle (deg)").line("target", &target).line("rotor", &truth))
        .panel(Panel::new("time (s)", "error (deg)").line("target - rotor", &error))
        .panel(Panel::new("time (s)", "signed duty").line("duty", &duty))
}
