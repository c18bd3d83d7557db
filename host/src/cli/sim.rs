//! `twum sim`.

use super::connect::{INTERRUPTED, catch_interrupts};
use anyhow::{Context, Result};
use std::process::ExitCode;
use twum_host::link::serve;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant, Solver};
use twum_host::model::parameters::Flavour;
use twum_host::sim::{DriverHealth, FirstOrderMotor, PlantMotor, Setup, SimulatedMotor};

/// Arguments of `twum sim`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  twum sim --pty\n  twum track --port /dev/pts/3 --out sine.mcap     (in another terminal)"
)]
pub struct Args {
    /// Serve on a new pseudo-terminal, whose name is printed
    #[arg(long, required = true)]
    pty: bool,
    /// Motor: `simple`, or a motor file's name or path, run with the averaged physical model
    #[arg(long, default_value = "simple")]
    motor: String,
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
    let motor: Box<dyn SimulatedMotor> = if args.motor == "simple" {
        Box::new(FirstOrderMotor::default())
    } else {
        let (motor, flavour) = (Motor::load(&args.motor)?, Flavour::Physical);
        let plant =
            MotorPlant::new(motor.parameters(flavour), flavour, Solver::Averaged, &motor.effects(), History::default());
        Box::new(PlantMotor::new(plant))
    };
    let setup = Setup { driver, motor, start_pitch: args.start_pitch, ..Setup::default() };
    serve(setup, &INTERRUPTED, |name| {
        println!("{name}");
        eprintln!("serving a simulated board in real time; Ctrl-C ends it");
    })
    .context("the pseudo-terminal failed")?;
    Ok(ExitCode::SUCCESS)
}
