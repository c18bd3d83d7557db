//! `twum model robust`.

use super::super::existing::ExistingArgs;
use super::super::output::{print_table, stage};
use super::super::units;
use super::closed_loop::hand;
use anyhow::{Context, Result, bail};
use serde_json::json;
use std::path::PathBuf;
use twum_host::configuration::controller;
use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;
use twum_host::model::robust::{Candidate, Cell, ROTORS, Spread, Study, Target, robust};
use twum_host::output::{self, Output};
use twum_host::report::figure::{Figure, Panel};
use twum_shared::step::Config;

/// Arguments of `twum model robust`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A shipped motor, or a motor file
    #[arg(long, default_value = "pcbmotor-30mm")]
    motor: String,
    /// Controller: `thesis`, `default`, `gated`, `planned`, or a TOML file as for `twum track`; repeatable. A PWM frequency of its own: NAME@HZ
    #[arg(long, default_values = ["thesis", "default"], value_name = "CONTROLLER")]
    control: Vec<String>,
    /// PWM frequency (Hz) [default: the controller's: 50, or one period a tick for a drive that is gated]
    #[arg(long)]
    pwm_hz: Option<u16>,
    /// Motors drawn, the same for every controller
    #[arg(long, default_value_t = 200)]
    draws: u64,
    /// Seed of the draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rotors, of clamped, braking and coasting
    #[arg(long, value_delimiter = ',', default_value = "clamped,braking,coasting")]
    rotor: Vec<String>,
    /// Amplitude of the sine (counts)
    #[arg(long, default_value_t = 89)]
    amplitude: i32,
    /// Angular frequency of the sine (rad/s)
    #[arg(long, default_value_t = 1.257)]
    omega: f64,
    /// Instead, several sines, one after the other: HZ:COUNTS,...
    #[arg(long, value_delimiter = ',', value_name = "HZ:COUNTS", conflicts_with_all = ["amplitude", "omega", "step", "ramp"])]
    sines: Vec<String>,
    /// Instead, a step of so many counts
    #[arg(long, value_name = "COUNTS", allow_hyphen_values = true, conflicts_with_all = ["amplitude", "omega", "ramp"])]
    step: Option<i32>,
    /// Instead, a ramp of so many counts/s
    #[arg(long, value_name = "COUNTS/S", allow_hyphen_values = true, conflicts_with_all = ["amplitude", "omega"])]
    ramp: Option<i32>,
    /// A load against positive rotation, as a share of the stall torque
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    load: f64,
    /// A hand pushes the rotor clockwise from a quarter of the run on: N·m:HZ, a sine, or N·m, a ramp up to that
    #[arg(long, value_name = "N·m[:HZ]", allow_hyphen_values = true)]
    hand: Option<String>,
    /// Draw the true error over the frequencies of --sines to this file, .svg, .png or .html
    #[arg(long, value_name = "FILE", requires = "sines")]
    plot: Option<PathBuf>,
    /// Length of a run (s)
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Write every draw to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
}

/// Runs `twum model robust`.
pub fn run(args: Args) -> Result<()> {
    if !(1..=100_000).contains(&args.draws) {
        bail!("--draws {} is outside 1 ..= 100000", args.draws);
    }
    if !(args.seconds > 0.0 && args.seconds <= 3_600.0) {
        bail!("--seconds {} is not above 0 and at most 3600", args.seconds);
    }
    if !(-0.95..=0.95).contains(&args.load) {
        bail!("--load {} is not within 0.95 of the stall torque either way", args.load);
    }
    let hand = args.hand.as_deref().map(|text| hand(text, args.seconds)).transpose()?;
    let targets = targets(&args)?;
    let rotors = args.rotor.iter().map(|name| rotor(name)).collect::<Result<Vec<_>>>()?;
    let motor = Motor::load(&args.motor)?;
    let candidates = args.control.iter().map(|name| candidate(name, args.pwm_hz)).collect::<Result<Vec<_>>>()?;
    for path in args.csv.iter().chain(&args.plot) {
        output::may_write(path, args.existing.into())?;
    }
    let waiting = stage("following with every motor");
    let mut found: Vec<(Target, Vec<Cell>)> = Vec::new();
    for target in targets {
        let (motor, load, seconds) = (&motor, args.load, args.seconds);
        let study = Study { motor, target, load, hand, seconds, draws: args.draws, seed: args.seed };
        found.push((target, robust(&study, &candidates, &rotors)?));
    }
    waiting.finish_and_clear();
    if args.json {
        let cells: Vec<_> =
            found.iter().flat_map(|(target, cells)| cells.iter().map(|cell| told(*target, cell))).collect();
        println!("{}", json!({ "draws": args.draws, "seed": args.seed, "load": args.load, "cells": cells }));
    } else {
        println!("mean |error| over {} draws of seed {}, median / 90 %", args.draws, args.seed);
        for (target, cells) in &found {
            if !args.sines.is_empty() {
                println!("{}", name(*target));
            }
            print_cells(cells);
        }
    }
    if let Some(path) = &args.csv {
        let mut out = Output::begin(path, args.existing.into())?;
        write_csv(&mut out, &found).with_context(|| format!("cannot write {}", path.display()))?;
        out.finish()?;
    }
    if let Some(path) = &args.plot {
        figure(&found, &rotors, &candidates).write(path)?;
        eprintln!("wrote {}", path.display());
    }
    Ok(())
}

fn targets(args: &Args) -> Result<Vec<Target>> {
    if let Some(counts) = args.step {
        return Ok(vec![Target::Step(counts)]);
    }
    if let Some(rate) = args.ramp {
        return Ok(vec![Target::Ramp(rate)]);
    }
    if args.sines.is_empty() {
        units::sine(args.amplitude, args.omega).context("--amplitude or --omega")?;
        return Ok(vec![Target::Sine { amplitude: args.amplitude, omega_rad_s: args.omega }]);
    }
    let sine = |text: &String| -> Result<Target> {
        let (hz, counts) = text.split_once(':').with_context(|| format!("--sines: `{text}` is not HZ:COUNTS"))?;
        let hz: f64 = hz.trim().parse().with_context(|| format!("--sines: `{hz}` is no frequency"))?;
        let amplitude = counts.trim().parse().with_context(|| format!("--sines: `{counts}` are no counts"))?;
        let omega_rad_s = std::f64::consts::TAU * hz;
        units::sine(amplitude, omega_rad_s).with_context(|| format!("--sines {text}"))?;
        Ok(Target::Sine { amplitude, omega_rad_s })
    };
    args.sines.iter().map(sine).collect()
}

fn rotor(name: &str) -> Result<(&'static str, Flavour)> {
    let known = ROTORS.into_iter().find(|(known, _)| *known == name);
    known.with_context(|| format!("--rotor: no rotor `{name}`; they are {}", ROTORS.map(|(name, _)| name).join(", ")))
}

fn name(target: Target) -> String {
    match target {
        Target::Sine { amplitude, omega_rad_s } => format!("{:.3} Hz, {amplitude} counts", hz(omega_rad_s)),
        Target::Step(counts) => format!("a step of {counts} counts"),
        Target::Ramp(rate) => format!("a ramp of {rate} counts/s"),
    }
}

fn hz(omega_rad_s: f64) -> f64 {
    omega_rad_s / std::f64::consts::TAU
}

/// A cell with what was followed.
fn told(target: Target, cell: &Cell) -> serde_json::Value {
    let mut told = json!(cell);
    told["target"] = name(target).into();
    told
}

fn print_cells(cells: &[Cell]) {
    let spread = |s: Spread, places: usize| format!("{:.places$} / {:.places$}", s.median, s.p90);
    let rows = cells.iter().map(|cell| {
        vec![
            cell.rotor.to_owned(),
            cell.controller.clone(),
            spread(cell.true_deg, 2),
            spread(cell.counted_deg, 2),
            spread(cell.miscount, 0),
            cell.ran_away.to_string(),
        ]
    });
    let header = ["rotor", "controller", "true (deg)", "counted (deg)", "counts lost", "ran away"];
    print_table(&header, &rows.collect::<Vec<_>>());
    for cell in cells {
        let Some(believed) = cell.believed else { continue };
        let off = cell.hand_error_nm.map_or_else(String::new, |off| {
            format!(", then off by {:.1} / {:.1} uN·m", 1e6 * off.median, 1e6 * off.p90)
        });
        let percent = Spread { median: 100.0 * believed.median, p90: 100.0 * believed.p90 };
        println!("{}, {}: the hand is believed {} % of the time{off}", cell.rotor, cell.controller, spread(percent, 0));
    }
}

/// True error over frequency: a panel a rotor, the median and up to what nine in ten stay below.
fn figure(found: &[(Target, Vec<Cell>)], rotors: &[(&'static str, Flavour)], candidates: &[Candidate]) -> Figure {
    let panel = |rotor: &str| {
        let panel = Panel::new("frequency of the sine (Hz)", "true error (deg)")
            .title(format!("{rotor} rotor"))
            .x_log()
            .y_log();
        candidates.iter().fold(panel, |panel, candidate| {
            let of = |f: &dyn Fn(&Cell) -> f64| -> Vec<(f64, f64)> {
                let cell = |cells: &[Cell]| {
                    cells.iter().find(|c| c.rotor == rotor && c.controller == candidate.name).map_or(f64::NAN, f)
                };
                let points = found.iter().filter_map(|(target, cells)| match target {
                    Target::Sine { omega_rad_s, .. } => Some((hz(*omega_rad_s), cell(cells))),
                    Target::Step(_) | Target::Ramp(_) => None,
                });
                points.collect()
            };
            panel
                .line(format!("{}, median", candidate.name), &of(&|c| c.true_deg.median))
                .dashed(format!("{}, 90 %", candidate.name), &of(&|c| c.true_deg.p90))
        })
    };
    let figure =
        Figure::new("Mean true error over the frequency of the sine").size(960, 80 + 360 * rotors.len() as u32);
    rotors.iter().fold(figure, |figure, (rotor, _)| figure.panel(panel(rotor)))
}

fn candidate(name: &str, pwm_hz: Option<u16>) -> Result<Candidate> {
    let (of, pwm_hz) = match name.rsplit_once('@') {
        Some((of, hz)) => (of, Some(hz.parse().with_context(|| format!("--control {name}: `{hz}` is no frequency"))?)),
        None => (name, pwm_hz),
    };
    let config = Config::try_from(controller(of).context("--control")?)?;
    let pwm_hz = pwm_hz.unwrap_or(config.spec().pwm_hz());
    if !(10..=2_000).contains(&pwm_hz) {
        bail!("--control {name}: a PWM frequency of {pwm_hz} Hz is outside 10 ..= 2000");
    }
    Ok(Candidate { name: name.to_owned(), config, pwm_hz: f64::from(pwm_hz) })
}

fn write_csv(out: &mut Output, found: &[(Target, Vec<Cell>)]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    let header = ["rotor", "controller", "draw", "true_deg", "counted_deg", "miscount", "ran_away", "target"];
    writer.write_record(header)?;
    for (target, cell) in found.iter().flat_map(|(target, cells)| cells.iter().map(move |cell| (target, cell))) {
        for (draw, outcome) in cell.outcomes.iter().enumerate() {
            writer.write_record([
                cell.rotor.to_owned(),
                cell.controller.clone(),
                draw.to_string(),
                format!("{:.5}", outcome.true_deg),
                format!("{:.5}", outcome.counted_deg),
                outcome.miscount.to_string(),
                outcome.ran_away.to_string(),
                name(*target),
            ])?;
        }
    }
    writer.flush()?;
    Ok(())
}
