//! Arguments every command that talks to a board shares.

use super::configuration::ConfigurationArgs;
use super::motor::MotorArgs;
use super::signals::on_signal;
use super::{defaults, exit};
use anyhow::{Context, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use twum_host::configuration::difference;
use twum_host::link::bench::{Action, Experiment, Outcome, perform};
use twum_host::link::relay;
use twum_host::link::{LinkError, Port, Received, SerialLink, Session, SimulatedLink, is_motor_held};
use twum_host::report::run::RunFigures;
use twum_shared::message::{CaptureMode, Configuration, RunEnd};
use twum_shared::step::ConfigSpec;

/// Which board, and how to reach it.
#[derive(Debug, clap::Args)]
pub struct ConnectArgs {
    /// Serial port or pseudo-terminal, or `sim` for a simulated board in memory [default: that of `twum config path`]
    #[arg(long, short, env = "TWUM_PORT")]
    port: Option<String>,
    /// Reset the board through RTS when the port is opened
    #[arg(long)]
    reset: bool,
    #[command(flatten)]
    motor: MotorArgs,
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

/// How a board was reached.
pub enum Reached<T> {
    /// Over its port.
    Port(Box<Session<Box<dyn Port>>>),
    /// Through the program that holds the port: its answer.
    Through(T),
}

impl ConnectArgs {
    /// The port's name.
    pub fn port(&self) -> Result<String> {
        let known = self.port.clone().or(defaults::load()?.port);
        known.context(
            "no port: give --port, set TWUM_PORT, or set it in the file of `twum config path` (`sim` needs no board)",
        )
    }

    /// Whether the port was given on the command line, or at least is not the environment's.
    pub fn is_explicit(&self) -> bool {
        self.port.is_some() && std::env::var("TWUM_PORT").ok() != self.port
    }

    fn open(&self, reach: impl Fn(&str) -> Result<Box<dyn Port>, LinkError>) -> Result<Box<dyn Port>> {
        let port = self.port()?;
        if port == "sim" {
            return Ok(Box::new(SimulatedLink::new(self.motor.simulated()?)));
        }
        self.motor.is_of_a_real_board()?;
        Ok(reach(&port)?)
    }

    /// Which motor is there, or which one to simulate.
    pub fn motor_args(&self) -> &MotorArgs {
        &self.motor
    }

    /// Opens a serial port, through which other programs of this user reach the board too, and borrow it where it is lent.
    pub fn serial(&self, port: &str, lender: Option<relay::Lender>) -> Result<Box<dyn Port>, LinkError> {
        Ok(Box::new(relay::Relay::new(SerialLink::open(port, self.reset)?, port, lender)))
    }

    /// Opens a serial port, or borrows the board of the program of this user that holds it.
    fn serial_or_borrowed(&self, port: &str) -> Result<Box<dyn Port>, LinkError> {
        let (named, reason) = match self.serial(port, None) {
            Err(LinkError::Open { port, reason }) if !self.reset => (port, reason),
            other => return other,
        };
        let what = std::env::args().nth(1).unwrap_or_default();
        match relay::borrow(port, &format!("twum {what}")) {
            Ok(board) => Ok(Box::new(board)),
            Err(relay::RelayError::Nobody) => Err(LinkError::Open { port: named, reason }),
            Err(error) => Err(LinkError::Open { port: named, reason: format!("{reason}; {error}") }),
        }
    }

    fn session_over(&self, port: Box<dyn Port>) -> Result<Session<Box<dyn Port>>> {
        catch_interrupts()?;
        let mut session = Session::new(port);
        session.interrupt_by(&INTERRUPTED);
        Ok(session)
    }

    /// Opens the port, or borrows the board, and a session that Ctrl-C interrupts.
    pub fn session(&self) -> Result<Session<Box<dyn Port>>> {
        self.session_over(self.open(|port| self.serial_or_borrowed(port))?)
    }

    /// Opens the port, or asks `through` the program of this user that holds it.
    pub fn session_or<T>(&self, through: impl Fn(&str) -> Result<T, relay::RelayError>) -> Result<Reached<T>> {
        let cannot_open = match self.open(|port| self.serial(port, None)) {
            Ok(port) => return Ok(Reached::Port(Box::new(self.session_over(port)?))),
            Err(error) => error,
        };
        match through(&self.port()?) {
            Ok(answer) => Ok(Reached::Through(answer)),
            Err(relay::RelayError::Nobody) => Err(cannot_open),
            Err(error) => Err(cannot_open.context(error.to_string())),
        }
    }

    /// Asks the board who it is; what recordings of it keep of its motor. `used` is the configuration of what is to be run.
    pub fn motor(&self, session: &mut Session<Box<dyn Port>>, used: Option<&Configuration>) -> Result<String> {
        let chip = session.hello()?.chip;
        let kept = self.motor.kept(&chip)?;
        if let Some(used) = used {
            self.motor.has_edges(&chip, used.edges_per_rev)?;
        }
        Ok(kept)
    }

    /// Performs an experiment; a lost port is waited for and opened again. The recording keeps the board's motor.
    pub fn perform(&self, mut experiment: Experiment, observe: impl FnMut(&Received)) -> Result<Outcome> {
        let mut session = self.session()?;
        experiment.motor = self.motor(&mut session, None)?;
        self.conduct(&mut session, &experiment, observe)
    }

    /// Performs what `action` makes of the configuration: what the board is configured with and `configuration` changes.
    /// Afterwards the board has its own configuration again.
    pub fn perform_with(
        &self,
        configuration: &ConfigurationArgs,
        action: impl Fn(&Configuration) -> Result<Action>,
        recording: Option<PathBuf>,
        observe: impl FnMut(&Received),
    ) -> Result<Outcome> {
        // What is wrong with the arguments is said before the port is opened.
        action(&configuration.over(Configuration::with_control(ConfigSpec::DEFAULT))?)?;
        let mut session = self.session()?;
        let own = own_configuration(&mut session)?;
        let used = configuration.over(own)?;
        let experiment = Experiment {
            configuration: Some(used),
            capture: ALL_STREAMS,
            action: action(&used)?,
            recording,
            motor: self.motor(&mut session, Some(&used))?,
        };
        let outcome = self.conduct(&mut session, &experiment, observe);
        restore(&mut session, own, used);
        outcome
    }

    fn conduct(
        &self,
        session: &mut Session<Box<dyn Port>>,
        experiment: &Experiment,
        observe: impl FnMut(&Received),
    ) -> Result<Outcome> {
        let port = self.port()?;
        let mut reopen = || self.serial_or_borrowed(&port);
        Ok(perform(session, experiment, Some(&mut reopen), observe)?)
    }
}

/// What the board is configured with; the default where it has nothing.
pub fn own_configuration<P: Port>(session: &mut Session<P>) -> Result<Configuration> {
    session.hello()?;
    Ok(session.configuration()?.unwrap_or(Configuration::with_control(ConfigSpec::DEFAULT)))
}

/// Gives the board its own configuration back after runs with another: what loosened a limit for one run must not for the
/// next.
pub fn restore<P: Port>(session: &mut Session<P>, own: Configuration, used: Configuration) {
    static NEVER: AtomicBool = AtomicBool::new(false);
    if own == used {
        return;
    }
    // Ctrl-C ended the run, not this.
    session.interrupt_by(&NEVER);
    if let Err(error) = session.configure(own) {
        let keys: Vec<String> = difference(&own, &used).into_iter().map(|(key, _, _)| key).collect();
        eprintln!(
            "warning: the board keeps this run's {}: {error}; `twum config load` puts them right",
            keys.join(", ")
        );
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
    pub json: bool,
}

impl RecordArgs {
    /// The exit code: of a fault, of somebody else's stop, of an interruption, of an unforgiven loss.
    fn verdict(&self, outcome: &Outcome) -> Result<u8> {
        match outcome.run.map(|run| run.end) {
            Some(RunEnd::Fault(fault)) => Err(LinkError::Fault(fault).into()),
            _ if outcome.interrupted => Ok(exit::INTERRUPTED),
            Some(RunEnd::Stopped) => Err(LinkError::StoppedByOther.into()),
            _ if outcome.tally.restarts > 0 => Err(LinkError::Restarted.into()),
            _ => Ok(u8::from(!outcome.tally.is_lossless() && !self.allow_loss)),
        }
    }

    /// Prints how it went, and as JSON what the driver board replied, if it was asked.
    pub fn conclude(
        &self,
        outcome: &Outcome,
        motor: Option<&RunFigures>,
        replies: Option<&[String]>,
    ) -> Result<ExitCode> {
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
                    "recorded_frames": outcome.recorded, "recording": self.out, "motor": motor, "replies": replies,
                })
            );
        } else {
            if let Some(motor) = motor {
                print!("{motor}");
            }
            println!(
                "frames: {} received, {} lost, {} bad; longest gap {} frames; {} restarts, {} reconnects",
                tally.received, tally.lost, tally.bad, tally.longest_gap, tally.restarts, tally.reconnects
            );
            if let Some(path) = &self.out {
                println!("recorded {} frames in {}", outcome.recorded, path.display());
            }
        }
        for warning in motor.map(RunFigures::warnings).into_iter().flatten() {
            eprintln!("warning: {warning}");
        }
        if matches!(verdict, Ok(1)) {
            eprintln!("error: frames were lost; the recording marks where (--allow-loss to accept)");
        }
        verdict.map(ExitCode::from)
    }
}

/// Every stream.
pub const ALL_STREAMS: CaptureMode = CaptureMode { bits: true, edges: true, control: true };
