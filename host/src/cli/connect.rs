//! Arguments every command that talks to a board shares.

use super::exit;
use super::signals::on_signal;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use twum_host::configuration::{difference, overlay_only_limits, validate};
use twum_host::input;
use twum_host::link::bench::{Experiment, Outcome, perform};
use twum_host::link::relay;
use twum_host::link::{LinkError, Port, Received, SerialLink, Session, SimulatedLink, is_motor_held};
use twum_host::model::motor::Motor;
use twum_host::record::measurement::ControlSpec;
use twum_host::sim::Setup;
use twum_shared::encoder::CountSign;
use twum_shared::message::{CaptureMode, Configuration, RunEnd};
use twum_shared::step::ConfigSpec;

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

/// How a board was reached.
pub enum Reached<T> {
    /// Over its port.
    Port(Box<Session<Box<dyn Port>>>),
    /// Through the program that holds the port: its answer.
    Through(T),
}

impl ConnectArgs {
    /// The port's name.
    pub fn port(&self) -> &str {
        &self.port
    }

    fn open(&self) -> Result<Box<dyn Port>, LinkError> {
        if self.port == "sim" {
            return Ok(Box::new(SimulatedLink::new(Setup::default())));
        }
        Ok(Box::new(relay::Relay::new(SerialLink::open(&self.port, self.reset)?, &self.port)))
    }

    /// Opens the port and a session that Ctrl-C interrupts.
    pub fn session(&self) -> Result<Session<Box<dyn Port>>> {
        catch_interrupts()?;
        let mut session = Session::new(self.open()?);
        session.interrupt_by(&INTERRUPTED);
        Ok(session)
    }

    /// Opens the port, or asks `through` the program of this user that holds it.
    pub fn session_or<T>(&self, through: impl Fn(&str) -> Result<T, relay::RelayError>) -> Result<Reached<T>> {
        let cannot_open = match self.session() {
            Ok(session) => return Ok(Reached::Port(Box::new(session))),
            Err(error) => error,
        };
        match through(&self.port) {
            Ok(answer) => Ok(Reached::Through(answer)),
            Err(relay::RelayError::Nobody) => Err(cannot_open),
            Err(error) => Err(cannot_open.context(error.to_string())),
        }
    }

    /// Performs an experiment; a lost port is waited for and opened again.
    pub fn perform(&self, experiment: &Experiment, observe: impl FnMut(&Received)) -> Result<Outcome> {
        let mut session = self.session()?;
        let mut reopen = || self.open();
        Ok(perform(&mut session, experiment, Some(&mut reopen), observe)?)
    }

    /// Performs an experiment with what the board is configured with and `configuration` changes. Afterwards the board has its own configuration again.
    pub fn perform_with(
        &self,
        configuration: &ConfigurationArgs,
        mut experiment: Experiment,
        observe: impl FnMut(&Received),
    ) -> Result<Outcome> {
        // What is wrong with the arguments is said before the port is opened.
        configuration.over(Configuration::with_control(ConfigSpec::DEFAULT))?;
        let mut session = self.session()?;
        let own = own_configuration(&mut session)?;
        experiment.configuration = Some(configuration.over(own)?);
        let mut reopen = || self.open();
        let outcome = perform(&mut session, &experiment, Some(&mut reopen), observe);
        restore(&mut session, own, experiment.configuration.unwrap_or(own));
        Ok(outcome?)
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

/// How to run the motor. What is not given is as the board is configured; a board without a configuration gets the default.
#[derive(Debug, clap::Args)]
pub struct ConfigurationArgs {
    /// Controller: `thesis`, `default`, or a TOML file of gains [default: the board's]
    #[arg(long)]
    control: Option<String>,
    /// Encoder edges a revolution [default: the board's]
    #[arg(long)]
    edges_per_rev: Option<u16>,
    /// PWM frequency, Hz [default: the board's]
    #[arg(long)]
    pwm_hz: Option<u16>,
    /// TOML file of limits, or a whole configuration whose `[limits]` are taken
    #[arg(long, value_name = "FILE", help_heading = "Limits for this run")]
    limits: Option<PathBuf>,
    /// Largest position error while tracking, counts
    #[arg(long, value_name = "COUNTS", help_heading = "Limits for this run")]
    max_following_error: Option<u32>,
    /// Positions allowed, counts: MIN:MAX, or one number for both sides
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true, help_heading = "Limits for this run")]
    position_bound: Option<String>,
    /// How long a driven motor may go without an encoder edge, ms
    #[arg(long, value_name = "MS", help_heading = "Limits for this run")]
    stall: Option<u16>,
    /// Fastest motion allowed, counts/s
    #[arg(long, value_name = "COUNTS/S", help_heading = "Limits for this run")]
    overspeed: Option<u32>,
    /// Silence of this computer that stops the motor, ms
    #[arg(long, value_name = "MS", help_heading = "Limits for this run")]
    timeout: Option<u16>,
    /// Which way the count moves while the direction pin is high [default: the board's]
    #[arg(long, value_enum)]
    count_sign: Option<Sign>,
    /// Motor on the bench, a shipped one or a motor file: its content is kept in the recording
    #[arg(long, value_name = "NAME|FILE", default_value = "pcbmotor-30mm")]
    motor: String,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Sign {
    Positive,
    Reversed,
}

impl ConfigurationArgs {
    /// What the recording keeps of the motor.
    pub fn motor(&self) -> Result<String> {
        Ok(Motor::kept(&self.motor)?)
    }

    /// `base` with what was given.
    pub fn over(&self, base: Configuration) -> Result<Configuration> {
        let mut configuration = base;
        if let Some(file) = &self.limits {
            let text = input::text(file, input::WRITTEN).with_context(|| file.display().to_string())?;
            configuration = overlay_only_limits(&configuration, &text).with_context(|| file.display().to_string())?;
        }
        if let Some(control) = &self.control {
            configuration.control = ControlSpec::named(control)?.config()?;
        }
        if let Some(bound) = &self.position_bound {
            (configuration.limits.position_min, configuration.limits.position_max) = position_bound(bound)?;
        }
        let limits = &mut configuration.limits;
        limits.following_error_counts = self.max_following_error.unwrap_or(limits.following_error_counts);
        limits.stall_ms = self.stall.unwrap_or(limits.stall_ms);
        limits.overspeed_counts_s = self.overspeed.unwrap_or(limits.overspeed_counts_s);
        limits.command_timeout_ms = self.timeout.unwrap_or(limits.command_timeout_ms);
        configuration.edges_per_rev = self.edges_per_rev.unwrap_or(configuration.edges_per_rev);
        configuration.pwm_hz = self.pwm_hz.unwrap_or(configuration.pwm_hz);
        configuration.count_sign = match self.count_sign {
            Some(Sign::Positive) => CountSign::Positive,
            Some(Sign::Reversed) => CountSign::Reversed,
            None => configuration.count_sign,
        };
        validate(&configuration)?;
        Ok(configuration)
    }
}

fn position_bound(text: &str) -> Result<(i32, i32)> {
    let number =
        |word: &str| word.trim().parse::<i32>().with_context(|| format!("--position-bound: `{word}` is no count"));
    match text.split_once(':') {
        Some((min, max)) => Ok((number(min)?, number(max)?)),
        None => {
            let both = number(text)?;
            Ok((both.saturating_neg(), both))
        }
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
            _ if outcome.tally.restarts > 0 => Err(LinkError::Restarted.into()),
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
