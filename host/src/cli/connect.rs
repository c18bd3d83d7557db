//! Arguments every command that talks to a board shares.

use super::exit::Exit;
use super::output::say;
use anyhow::{Context, Result, bail};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use twum_host::link::bench::{Experiment, Outcome, perform};
use twum_host::link::{LinkError, Port, Received, SerialLink, Session, SimulatedLink};
use twum_host::model::motor::Motor;
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
    /// Motor on the bench, a shipped one or a motor file: its content is kept in the recording
    #[arg(long, value_name = "NAME|FILE", default_value = "pcbmotor-30mm")]
    motor: String,
}

impl ConfigurationArgs {
    /// The configuration the device gets.
    pub fn configuration(&self) -> Result<Configuration> {
        let control = ControlSpec::named(&self.control)?.config()?;
        let (edges_per_rev, pwm_hz) = (self.edges_per_rev, self.pwm_hz);
        Ok(Configuration { edges_per_rev, pwm_hz, ..Configuration::with_control(control) })
    }
}

impl ConfigurationArgs {
    /// What the recording keeps of the motor.
    pub fn motor(&self) -> Result<String> {
        Ok(Motor::kept(&self.motor)?)
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
    /// Prints how it went, and says it by the exit code too, whatever has become of the reader.
    pub fn conclude(&self, outcome: &Outcome) -> Result<ExitCode> {
        let told = say(&if self.json { self.as_json(outcome) } else { self.as_text(outcome) });
        let exit = match self.verdict(outcome) {
            (Exit::Done, _) => told.map(|()| Exit::Done).context("standard output")?,
            (exit, reason) => {
                if !reason.is_empty() {
                    eprintln!("error: {reason}");
                }
                exit
            }
        };
        Ok(exit.into())
    }

    /// The worst that happened, and how to tell it.
    fn verdict(&self, outcome: &Outcome) -> (Exit, String) {
        let tally = outcome.tally;
        match outcome.run.map(|run| run.end) {
            Some(RunEnd::Fault(fault)) => {
                (Exit::Fault, format!("the motor was stopped by {fault:?}: {fault}; `twum stop` clears it"))
            }
            Some(RunEnd::Stopped) if !outcome.interrupted => {
                (Exit::CutShort, "the run was stopped by somebody else before its time".to_owned())
            }
            _ if tally.restarts > 0 => (
                Exit::CutShort,
                format!(
                    "the board restarted {} times; the recording marks where, and has what came after",
                    tally.restarts
                ),
            ),
            _ if !tally.is_lossless() && !self.allow_loss => {
                (Exit::No, "frames were lost; the recording marks where (--allow-loss to accept)".to_owned())
            }
            _ if outcome.interrupted => (Exit::Interrupted, String::new()),
            _ => (Exit::Done, String::new()),
        }
    }

    fn as_json(&self, outcome: &Outcome) -> String {
        let fault = match outcome.run.map(|run| run.end) {
            Some(RunEnd::Fault(fault)) => Some(format!("{fault:?}")),
            _ => None,
        };
        let seconds = outcome.run.map(|run| run.end_us.saturating_sub(run.start_us) as f64 * 1e-6);
        let json = serde_json::json!({
            "interrupted": outcome.interrupted, "fault": fault, "run_s": seconds, "link": outcome.tally,
            "recorded_frames": outcome.recorded, "recording": self.out,
        });
        json.to_string()
    }

    fn as_text(&self, outcome: &Outcome) -> String {
        let tally = outcome.tally;
        let mut text = format!(
            "frames: {} received, {} lost, {} bad; longest gap {} frames; {} restarts, {} reconnects",
            tally.received, tally.lost, tally.bad, tally.longest_gap, tally.restarts, tally.reconnects
        );
        if tally.duplicates > 0 {
            text += &format!("; {} came again and were dropped", tally.duplicates);
        }
        if let Some(path) = &self.out {
            text += &format!("\nrecorded {} frames in {}", outcome.recorded, path.display());
        }
        text
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
