//! The command line: one file a subcommand, no logic of its own.

mod align;
mod capture;
mod compare;
mod completions;
mod config;
mod configuration;
mod connect;
mod defaults;
mod demo;
mod diagnose;
mod driver;
mod existing;
pub mod exit;
mod experiment;
mod export;
mod flash;
mod flavour;
mod identify;
mod import;
mod info;
mod instruments;
mod live;
mod model;
mod motor;
mod neck;
mod output;
mod plot;
mod ports;
mod pulses;
mod reboot;
mod replay;
mod run;
mod series;
mod serve;
mod signals;
mod sim;
mod speed;
mod stop;
mod track;
mod tune;
mod uncertainty;
mod units;
mod velocity;

use anyhow::Result;
use clap::Parser;
use std::process::ExitCode;

/// Drive, capture, simulate and diagnose travelling-wave ultrasonic motors.
#[derive(Debug, Parser)]
#[command(name = "twum", version, about, after_help = format!("{}\n\n{}", existing::POLICY, exit::HELP))]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

/// What a newcomer does next: printed without a command.
const NEXT: &str = "\
Drive, capture, simulate and diagnose travelling-wave ultrasonic motors.

Without a board:
  twum demo                                          a motor with something wrong, and its cause, on one page
  twum track --port sim --out sine.mcap              a closed loop on the simulated 30 mm motor
  twum plot sine.mcap sine.svg

With a board:
  twum ports                                         where it is
  twum info --port /dev/ttyUSB0                      what it is
  twum experiment run --port /dev/ttyUSB0 --out first   a first experiment (the motor turns)
  twum diagnose first                                what the simulation gets wrong, and why

`twum help` lists every command, `twum COMMAND --help` has examples of each.
";

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Align the motor to the beginning of an encoder pulse
    Align(align::Args),
    /// Record what the board streams
    Capture(capture::Args),
    /// Hold a recording or measurement folder against the fixed-point model and the simulation
    Compare(compare::Args),
    /// Print a shell's completions
    Completions(completions::Args),
    /// Show, dump, load or compare the configuration a board keeps, and show your own defaults
    Config(config::Args),
    /// Drive a simulated motor end to end and write a report
    Demo(demo::Args),
    /// Show what the simulation gets wrong and name the cause
    Diagnose(diagnose::Args),
    /// Send text commands to the motor's driver board
    Driver(driver::Args),
    /// Plan the next runs, and make them
    Experiment(experiment::Args),
    /// Turn a recording into CSV, decoded MCAP or a measurement folder
    Export(export::Args),
    /// Put this version's firmware on a board
    Flash(flash::Args),
    /// Identify the stator's circuit, friction and the force factor
    Identify(identify::Args),
    /// Check a measurement folder and convert it
    Import(import::Args),
    /// Show what a board is
    Info(info::Args),
    /// Sweep a stator with bench instruments, or simulate them
    Instruments(instruments::Args),
    /// Watch a board in the terminal
    Live(live::Args),
    /// Print or write manual pages
    Man(completions::ManArgs),
    /// Run the motor model
    Model(model::Args),
    /// Simulate the neck manipulator
    Neck(neck::Args),
    /// Plot a recording or a measurement
    Plot(plot::Args),
    /// List serial ports
    Ports(ports::Args),
    /// Restart a board
    Reboot(reboot::Args),
    /// Check a recording bit for bit against the fixed-point step
    Replay(replay::Args),
    /// Serve the bench to browsers
    Serve(serve::Args),
    /// Serve a simulated board
    Sim(sim::Args),
    /// Run the motor at a constant duty
    Speed(speed::Args),
    /// Stop the motor and clear a latched fault
    Stop(stop::Args),
    /// Track a reference in closed loop
    Track(track::Args),
    /// Make controllers for the motor from a short run, and say what to expect of them
    Tune(tune::Args),
    /// Estimate position and speed from encoder edges
    Velocity(velocity::Args),
}

impl Cli {
    /// Runs the chosen subcommand; the exit code is the answer other programs read.
    pub fn run(self) -> Result<ExitCode> {
        let Some(command) = self.command else {
            print!("{NEXT}");
            return Ok(ExitCode::SUCCESS);
        };
        match command {
            Command::Align(args) => align::run(args),
            Command::Capture(args) => capture::run(args),
            Command::Completions(args) => completions::run(&args),
            Command::Man(args) => completions::man(&args),
            Command::Compare(args) => compare::run(args),
            Command::Config(args) => config::run(args),
            Command::Demo(args) => demo::run(args),
            Command::Diagnose(args) => diagnose::run(args),
            Command::Driver(args) => driver::run(args),
            Command::Experiment(args) => experiment::run(args),
            Command::Export(args) => export::run(args),
            Command::Flash(args) => flash::run(args),
            Command::Identify(args) => identify::run(args),
            Command::Import(args) => import::run(args),
            Command::Info(args) => info::run(args),
            Command::Instruments(args) => instruments::run(args),
            Command::Live(args) => live::run(args),
            Command::Model(args) => model::run(args),
            Command::Neck(args) => neck::run(args),
            Command::Plot(args) => plot::run(args),
            Command::Ports(args) => ports::run(args),
            Command::Reboot(args) => reboot::run(args),
            Command::Replay(args) => replay::run(args),
            Command::Serve(args) => serve::run(args),
            Command::Sim(args) => sim::run(args),
            Command::Speed(args) => speed::run(args),
            Command::Stop(args) => stop::run(args),
            Command::Track(args) => track::run(args),
            Command::Tune(args) => tune::run(&args),
            Command::Velocity(args) => velocity::run(args),
        }
    }
}
