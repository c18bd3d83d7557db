//! Arguments every command that talks to a board shares.

use super::exit;
use super::signals::on_signal;
use anyhow::{Result, bail};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use twum_host::link::bench::{Experiment, Outcome, perform};
use twum_host::link::{LinkError, Port, Received, SerialLink, Session, SimulatedLink, is_motor_held};
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

/// Set by Ctrl-C, a termination or a closed window; a second one ends the program at once, unless the motor is still being
/// stopped.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// The motor is stopped within this time of the first signal, or cannot be.
const STOPPING: Duration = Duration::from_secs(5);

/// Makes Ctrl-C set [`INTERRUPTED`].
pub fn catch_interrupts() -> Result<()> {
    let mut first = None;
    on_signal(move || {
        let since = first.get_or_insert_with(Instant::now).elapsed();
        if INTERRUPTED.swap(true, Ordering::Relaxed) && (!is_motor_held() || since > STOPPING) {
            std::process::exit(exit::INTERRUPTED.into());
        }
    })
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
    /// The exit code: of a fault, of somebody else's stop, of an interruption, of an unforgiven loss.
    fn verdict(&self, outcome: &Outcome) -> Result<u8> {
        match outcome.run.map(|run| run.end) {
            Some(RunEnd::Fault(fault)) => Err(LinkError::Fault(fault).into()),
            _ if outcome.interrupted => Ok(exit::INTERRUPTED),
            Some(RunEnd::Stopped) => Err(LinkError::StoppedByOther.into()),
            _ => Ok(u8::from(!outcome.tally.is_lossless() && !self.allow_loss)),
        }
    }

    /// Prints how it went.
    pub fn conclude(&self, outcome: &Outcome) -> Result<ExitCode> {
        let verdict = self.verdict(outcome);
        exit::decide(&verdict);
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
        if matches!(verdict, Ok(1)) {
            eprintln!("error: frames were lost; the recording marks where (--allow-loss to accept)");
        }
        verdict.map(ExitCode::from)
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
