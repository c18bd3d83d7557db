//! `twum model robust`.

use super::super::existing::ExistingArgs;
use super::super::output::{print_table, stage};
use super::super::units;
use anyhow::{Context, Result, bail};
use serde_json::json;
use std::path::PathBuf;
use twum_host::configuration::controller;
use twum_host::model::motor::Motor;
use twum_host::model::robust::{Candidate, Cell, Spread, Study, robust};
use twum_host::output::{self, Output};
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
    /// Amplitude of the sine (counts)
    #[arg(long, default_value_t = 89)]
    amplitude: i32,
    /// Angular frequency of the sine (rad/s)
    #[arg(long, default_value_t = 1.257)]
    omega: f64,
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
    units::sine(args.amplitude, args.omega).context("--amplitude or --omega")?;
    let motor = Motor::load(&args.motor)?;
    let candidates = args.control.iter().map(|name| candidate(name, args.pwm_hz)).collect::<Result<Vec<_>>>()?;
    if let Some(path) = &args.csv {
        output::may_write(path, args.existing.into())?;
    }
    let study = Study {
        motor: &motor,
        amplitude: args.amplitude,
        omega_rad_s: args.omega,
        seconds: args.seconds,
        draws: args.draws,
        seed: args.seed,
    };
    let waiting = stage("following the sine with every motor");
    let cells = robust(&study, &candidates)?;
    waiting.finish_and_clear();
    if args.json {
        println!("{}", json!({ "draws": args.draws, "seed": args.seed, "cells": cells }));
    } else {
        println!("mean |error| over {} draws of seed {}, median / 90 %", args.draws, args.seed);
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
    }
    if let Some(path) = &args.csv {
        let mut out = Output::begin(path, args.existing.into())?;
        write_csv(&mut out, &cells).with_context(|| format!("cannot write {}", path.display()))?;
        out.finish()?;
    }
    Ok(())
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

fn write_csv(out: &mut Output, cells: &[Cell]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record(["rotor", "controller", "draw", "true_deg", "counted_deg", "miscount", "ran_away"])?;
    for cell in cells {
        for (draw, outcome) in cell.outcomes.iter().enumerate() {
            writer.write_record([
                cell.rotor.to_owned(),
                cell.controller.clone(),
                draw.to_string(),
                format!("{:.5}", outcome.true_deg),
                format!("{:.5}", outcome.counted_deg),
                outcome.miscount.to_string(),
                outcome.ran_away.to_string(),
            ])?;
        }
    }
    writer.flush()?;
    Ok(())
}
