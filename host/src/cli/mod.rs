//! The command line: one file a subcommand, no logic of its own.

mod align;
mod capture;
mod compare;
mod connect;
mod demo;
mod diagnose;
mod driver;
pub mod exit;
mod experiment;
mod export;
mod identify;
mod import;
mod info;
mod instruments;
mod live;
mod model;
mod neck;
mod output;
mod plot;
mod ports;
mod replay;
mod signals;
mod sim;
mod speed;
mod stop;
mod track;
mod velocity;

use anyhow::Result;
use clap::Parser;
use std::process::ExitCode;

/// Drive, capture, simulate and diagnose travelling-wave ultrasonic motors.
#[derive(Debug, Parser)]
#[command(name = "twum", version, about, after_help = exit::HELP)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Align the motor to the beginning of an encoder pulse
    Align(align::Args),
    /// Record what the board streams
    Capture(capture::Args),
    /// Hold a recording or measurement folder against the fixed-point model and the simulation
    Compare(compare::Args),
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
    /// Run the motor model
    Model(model::Args),
    /// Simulate the neck manipulator
    Neck(neck::Args),
    /// Plot a recording or a measurement
    Plot(plot::Args),
    /// List serial ports
    Ports(ports::Args),
    /// Check a recording bit for bit against the fixed-point step
    Replay(replay::Args),
    /// Serve a simulated board
    Sim(sim::Args),
    /// Run the motor at a constant duty
    Speed(speed::Args),
    /// Stop the motor and clear a latched fault
    Stop(stop::Args),
    /// Track a reference in closed loop
    Track(track::Args),
    /// Estimate position and speed from encoder edges
    Velocity(velocity::Args),
}

impl Cli {
    /// Runs the chosen subcommand; the exit code is the answer other programs read.
    pub fn run(self) -> Result<ExitCode> {
        match self.command {
            Command::Align(args) => align::run(args),
            Command::Capture(args) => capture::run(args),
            Command::Compare(args) => compare::run(args),
            Command::Demo(args) => demo::run(args),
            Command::Diagnose(args) => diagnose::run(args),
            Command::Driver(args) => driver::run(args),
            Command::Experiment(args) => experiment::run(args),
            Command::Export(args) => export::run(args),
            Command::Identify(args) => identify::run(args),
            Command::Import(args) => import::run(args),
            Command::Info(args) => info::run(args),
            Command::Instruments(args) => instruments::run(args),
            Command::Live(args) => live::run(args),
            Command::Model(args) => model::run(args),
            Command::Neck(args) => neck::run(args),
            Command::Plot(args) => plot::run(args),
            Command::Ports(args) => ports::run(args),
            Command::Replay(args) => replay::run(args),
            Command::Sim(args) => sim::run(args),
            Command::Speed(args) => speed::run(args),
            Command::Stop(args) => stop::run(args),
            Command::Track(args) => track::run(args),
            Command::Velocity(args) => velocity::run(args),
        }
    }
}
