//! `twum sim`.

use super::connect::{INTERRUPTED, catch_interrupts};
use super::motor::MotorArgs;
use super::output::answer;
use anyhow::{Context, Result};
use std::process::ExitCode;
use twum_host::link::serve;
use twum_host::sim::{DriverHealth, Setup};

/// Arguments of `twum sim`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  twum sim --pty\n  twum sim --pty --effects hidden.toml     (a motor with something wrong)\n  twum track --port /dev/pts/3 --out sine.mcap     (in another terminal)"
)]
pub struct Args {
    /// Serve on a new pseudo-terminal, whose name is printed
    #[arg(long, required = true)]
    pty: bool,
    #[command(flatten)]
    motor: MotorArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// How well the driver board is
    #[arg(long, value_enum, default_value = "well")]
    driver: Driver,
    /// Where the rotor stands at the start, in encoder pitches from 0 to 2
    #[arg(long, default_value_t = 0.3)]
    start_pitch: f64,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Driver {
    /// Answers and moves the rotor
    Well,
    /// Never answers
    Silent,
    /// Answers with noise
    Garbage,
    /// Answers, but does not move the rotor
    Lame,
}

/// Runs `twum sim`.
pub fn run(args: Args) -> Result<ExitCode> {
    catch_interrupts()?;
    let driver = match args.driver {
        Driver::Well => DriverHealth::Well,
        Driver::Silent => DriverHealth::Silent,
        Driver::Garbage => DriverHealth::Garbage,
        Driver::Lame => DriverHealth::Lame,
    };
    let setup = Setup { driver, start_pitch: args.start_pitch, ..args.motor.simulated()? };
    let simulates = setup.simulates.clone();
    serve(setup, &INTERRUPTED, |name| {
        answer(args.json, &serde_json::json!({ "port": name, "simulates": simulates.to_string() }), name);
        eprintln!("serving a board in real time, {simulates}; Ctrl-C ends it");
    })
    .context("the pseudo-terminal failed")?;
    Ok(ExitCode::SUCCESS)
}
