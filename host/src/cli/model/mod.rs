//! `twum model`.

mod braking;
mod check;
mod closed_loop;
mod ordinary;
mod robust;
mod steady;

use super::flavour::FlavourArgs;
use super::uncertainty::UncertaintyArgs;
use anyhow::{Context, Result};
use clap::ValueEnum;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::Solver;
use twum_host::model::study::Setup;
use twum_host::output::{self, Existing};
use twum_host::report::figure::Figure;

/// Arguments of `twum model`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum model speed                                  full drive, physical flavour, averaged model
  twum model speed --solver carrier --seconds 0.4   the same at carrier resolution
  twum model speed --duty 0.5 --set u=0.12 --json
  twum model sweep --plot speed_duty.svg
  twum model torque --plot torque.png
  twum model loop --flavour measured --csv loop.csv --plot loop.svg     the thesis's closed loop
  twum model braking                                how much the rotor brakes with the drive off
  twum model robust --control thesis --control default    both on 200 motors that differ
  twum model speed --motor own/motor.toml --flavour measured --uncertainty     with the band the file leaves
  twum model check                                  the tables of docs/model.md, for this motor
  twum model sweep --motor mine.toml                speed against input of an ordinary motor, as twum diagnose --save-model wrote it

Parameters of --set are those of the thesis's section A.4: f, Vrms, Ms, Cs, Ks, eta, Rr, R0, b, n, h, Mr, Jr, Cz, Ctheta,
u, Fext, Tload, Cn; and uoff, the friction without a wave. docs/model.md has the equations and what they leave out.")]
pub struct Args {
    #[command(subcommand)]
    question: Question,
}

#[derive(Debug, clap::Subcommand)]
enum Question {
    /// Speed at one duty, over the last 20 % of a run
    Speed {
        #[command(flatten)]
        common: Common,
        /// Fraction of the PWM period with the drive on
        #[arg(long, default_value_t = 1.0)]
        duty: f64,
    },
    /// Speed against duty
    Sweep {
        #[command(flatten)]
        common: Common,
        /// Number of duties from 0 to 1
        #[arg(long, default_value_t = 33)]
        points: usize,
    },
    /// Speed against load torque, up to what the contact can transmit
    Torque {
        #[command(flatten)]
        common: Common,
        /// Fraction of the PWM period with the drive on
        #[arg(long, default_value_t = 1.0)]
        duty: f64,
        /// Number of loads
        #[arg(long, default_value_t = 21)]
        points: usize,
    },
    /// How far to trust the models: step size, averaged against carrier, start and stop, the closed loop piece by piece
    Check {
        /// A shipped motor, or a motor file
        #[arg(long, default_value = "pcbmotor-30mm")]
        motor: String,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// How much the rotor brakes with the drive off, from the thesis's figures of the real motor's closed loop
    Braking {
        /// A shipped motor, or a motor file
        #[arg(long, default_value = "pcbmotor-30mm")]
        motor: String,
        /// Print JSON
        #[arg(long)]
        json: bool,
        /// Draw to this file, .svg, .png or .html
        #[arg(long, value_name = "FILE")]
        plot: Option<PathBuf>,
    },
    /// Controllers on many motors that differ in what is not known: error of the median and of nine in ten
    Robust(robust::Args),
    /// The motor under the chip's control step, following a sine
    Loop(closed_loop::Args),
}

#[derive(Debug, clap::Args)]
struct Common {
    /// A shipped motor, or a motor file
    #[arg(long, default_value = "pcbmotor-30mm")]
    motor: String,
    /// Change a parameter; repeatable
    #[arg(long = "set", value_name = "NAME=VALUE")]
    set: Vec<String>,
    /// PWM frequency (Hz) [default: 50, and one period a tick for a loop whose drive is gated]
    #[arg(long)]
    pwm_hz: Option<f64>,
    /// Length of the run (s) [default: 1, and 10 for loop]
    #[arg(long)]
    seconds: Option<f64>,
    /// Which model
    #[arg(long, value_enum, default_value_t = SolverArg::Averaged)]
    solver: SolverArg,
    #[command(flatten)]
    flavour: FlavourArgs,
    #[command(flatten)]
    uncertainty: UncertaintyArgs,
    /// Effects beside the motor file's own: a file of [effects.NAME] tables, as in a motor file
    #[arg(long, value_name = "FILE")]
    effects: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Draw to this file, .svg, .png or .html
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum SolverArg {
    Averaged,
    Carrier,
}

impl Common {
    fn setup(&self, duty: f64, seconds: f64) -> Result<Setup> {
        let flavour = self.flavour.get();
        let solver = match self.solver {
            SolverArg::Averaged => Solver::Averaged,
            SolverArg::Carrier => Solver::Carrier,
        };
        let motor = Motor::load(&self.motor)?;
        let mut effects = motor.effects();
        if let Some(file) = &self.effects {
            effects.join(&Motor::effects_of_file(file)?);
        }
        let setup = Setup {
            parameters: motor.parameters(flavour).assign(&self.set).context("--set")?,
            effects,
            flavour,
            solver,
            duty,
            pwm_hz: self.pwm_hz.unwrap_or(50.0),
            seconds: self.seconds.unwrap_or(seconds),
        };
        setup.check()?;
        setup.check_load()?;
        if let Some(path) = &self.plot {
            output::may_write(path, Existing::Keep)?;
        }
        Ok(setup)
    }

    /// Motors that the file's uncertainties leave possible, where bands are asked for; what `--set` sets is exact.
    fn possible(&self, setup: &Setup) -> Result<Option<Vec<Setup>>> {
        let exact: Vec<String> =
            self.set.iter().filter_map(|set| Some(set.split_once('=')?.0.trim().to_owned())).collect();
        let motor = Motor::load(&self.motor)?;
        let motors = self.uncertainty.draws(&motor, setup.flavour, &setup.parameters, &exact)?;
        Ok(motors.map(|motors| motors.into_iter().map(|parameters| Setup { parameters, ..setup.clone() }).collect()))
    }

    fn draw(&self, figure: impl FnOnce() -> Result<Figure>) -> Result<()> {
        if let Some(path) = &self.plot {
            figure()?.write(path)?;
            eprintln!("wrote {}", path.display());
        }
        Ok(())
    }
}

/// Runs `twum model`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.question {
        Question::Speed { common, duty } => match common.ordinary()? {
            Some(model) => ordinary::speed(&common, &model, duty),
            None => steady::speed(&common, duty),
        },
        Question::Sweep { common, points } => match common.ordinary()? {
            Some(model) => ordinary::sweep(&common, &model, points),
            None => steady::sweep(&common, points),
        },
        Question::Torque { common, duty, points } => steady::torque(&common, duty, points),
        Question::Braking { motor, json, plot } => braking::run(&motor, json, plot),
        Question::Check { motor, json } => check::run(&motor, json),
        Question::Loop(args) => closed_loop::run(args),
        Question::Robust(args) => robust::run(args),
    }?;
    Ok(ExitCode::SUCCESS)
}

fn print_json(value: &impl Serialize) -> Result<()> {
    println!("{}", serde_json::to_string(value)?);
    Ok(())
}
