//! Arguments every command that talks to a board shares.

use anyhow::{Context, Result, anyhow, bail};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use twum_host::link::bench::{Experiment, Outcome, perform};
use twum_host::link::{LinkError, Port, Received, SerialLink, Session, SimulatedLink};
use twum_host::record::measurement::ControlSpec;
use twum_host::sim::Setup;
use twum_shared::message::{CaptureMode, Configuration, RunEnd};

/// Which board, and how to reach it.
#[derive(Debug, clap::Args)]
pub struct ConnectArgs {
    /// Serial port or pseudo-terminal, or `sim` for a simulated board in memory
    #[arg(long, short, env = "TWUM_PORT")]
    port: String,
    /// Reset the board through RTS when the port is opened
    #[arg(long)]
    reset: bool,
}

/// Set by Ctrl-C; a second Ctrl-C ends the program at once.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Makes Ctrl-C set [`INTERRUPTED`].
pub fn catch_interrupts() -> Result<()> {
    ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })
    .context("cannot catch Ctrl-C")
}

impl ConnectArgs {
    fn open(&self) -> Result<Box<dyn Port>, LinkError> {
        if self.port == "sim" {
            return Ok(Box::new(SimulatedLink::new(Setup::default())));
        }
        Ok(Box::new(SerialLink::open(&self.port, self.reset)?))
    }

    /// Opens the port and a session that Ctrl-C interrupts.
    pub fn session(&self) -> Result<Session<Box<dyn Port>>> {
        catch_interrupts()?;
        let mut session = Session::new(self.open()?);
        session.interrupt_by(&INTERRUPTED);
        Ok(session)
    }

    /// Performs an experiment; a lost port is waited for and opened again.
    pub fn perform(&self, experiment: &Experiment, observe: impl FnMut(&Received)) -> Result<Outcome> {
        let mut session = self.session()?;
        let mut reopen = || self.open();
        Ok(perform(&mut session, experiment, Some(&mut reopen), observe)?)
    }
}

/// How to run the motor.
#[derive(Debug, clap::Args)]
pub struct ConfigurationArgs {
    /// Controller: `thesis`, `default`, or a TOML file of gains
    #[arg(long, default_value = "default")]
    control: String,
    /// Encoder edges a revolution
    #[arg(long, default_value_t = 400)]
    edges_per_rev: u16,
    /// PWM frequency, Hz
    #[arg(long, default_value_t = 50)]
    pwm_hz: u16,
    /// Motor parameter set, kept in the recording
    #[arg(long, default_value = "pcbmotor-30mm")]
    pub motor: String,
}

impl ConfigurationArgs {
    /// The configuration the device gets.
    pub fn configuration(&self) -> Result<Configuration> {
        let control = ControlSpec::named(&self.control)?.config()?;
        let (edges_per_rev, pwm_hz) = (self.edges_per_rev, self.pwm_hz);
        Ok(Configuration { edges_per_rev, pwm_hz, ..Configuration::with_control(control) })
    }
}

/// Where and what to record.
#[derive(Debug, clap::Args)]
pub struct RecordArgs {
    /// Recording to make (MCAP); never overwritten
    #[arg(long, short)]
    pub out: Option<std::path::PathBuf>,
    /// Succeed even if frames were lost
    #[arg(long)]
    allow_loss: bool,
    /// Print the outcome as JSON
    #[arg(long)]
    json: bool,
}

impl RecordArgs {
    /// Prints how it went; the exit code is 1 for a fault or an unforgiven loss.
    pub fn conclude(&self, outcome: &Outcome) -> Result<ExitCode> {
        let end = outcome.run.map(|run| run.end);
        let seconds = outcome.run.map(|run| run.end_us.saturating_sub(run.start_us) as f64 * 1e-6);
        let tally = outcome.tally;
        if self.json {
            let fault = match end {
                Some(RunEnd::Fault(fault)) => Some(format!("{fault:?}")),
                _ => None,
            };
            println!(
                "{}",
                serde_json::json!({
                    "interrupted": outcome.interrupted, "fault": fault, "run_s": seconds, "link": tally,
                    "recorded_frames": outcome.recorded, "recording": self.out,
                })
            );
        } else {
            println!(
                "frames: {} received, {} lost, {} bad; longest gap {} frames; {} restarts, {} reconnects",
                tally.received, tally.lost, tally.bad, tally.longest_gap, tally.restarts, tally.reconnects
            );
            if let Some(path) = &self.out {
                println!("recorded {} frames in {}", outcome.recorded, path.display());
            }
        }
        match end {
            Some(RunEnd::Fault(fault)) => {
                Err(anyhow!("the motor was stopped by {fault:?}: {fault}; `twum stop` clears it"))
            }
            _ if !tally.is_lossless() && !self.allow_loss => {
                eprintln!("error: frames were lost; the recording marks where (--allow-loss to accept)");
                Ok(ExitCode::from(1))
            }
            _ if outcome.interrupted => Ok(ExitCode::from(130)),
            _ => Ok(ExitCode::SUCCESS),
        }
    }
}

/// A duration in seconds, between 1 ms and an hour, as ms.
pub fn duration_ms(seconds: f64) -> Result<u32> {
    if (0.001..=3600.0).contains(&seconds) {
        Ok((seconds * 1e3).round() as u32)
    } else {
        bail!("{seconds} s is outside 0.001 to 3600 s")
    }
}

/// Every stream.
pub const ALL_STREAMS: CaptureMode = CaptureMode { bits: true, edges: true, control: true };
