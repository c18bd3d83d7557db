//! Arguments every command that talks to a board shares.

use super::config;
use super::exit;
use super::signals::on_signal;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use twum_host::link::bench::{Experiment, Outcome, perform};
use twum_host::link::{LinkError, Port, Received, SerialLink, Session, SimulatedLink, is_motor_held};
use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;
use twum_host::record::measurement::ControlSpec;
use twum_host::report::run::RunFigures;
use twum_host::sim::{Setup, Simulated};
use twum_shared::message::{CaptureMode, Configuration, RunEnd};

/// Which board, and how to reach it.
#[derive(Debug, clap::Args)]
pub struct ConnectArgs {
    /// Serial port or pseudo-terminal, or `sim` for a simulated board in memory [default: that of `twum config`]
    #[arg(long, short, env = "TWUM_PORT")]
    port: Option<String>,
    /// Reset the board through RTS when the port is opened
    #[arg(long)]
    reset: bool,
    #[command(flatten)]
    motor: MotorArgs,
}

/// Which motor is there, or which one to simulate.
#[derive(Debug, clap::Args)]
pub struct MotorArgs {
    /// Motor: a shipped one or a motor file; kept in the recording. With `--port sim` the one simulated
    /// [default: the one the board simulates, or pcbmotor-30mm]
    #[arg(long, value_name = "NAME|FILE")]
    motor: Option<String>,
    /// Flavour of a simulated motor [default: measured]
    #[arg(long, value_enum)]
    flavour: Option<Flavour>,
    /// Effects to hide in a simulated motor: a file of [effects.NAME] tables, as in a motor file
    #[arg(long, value_name = "FILE")]
    effects: Option<PathBuf>,
}

impl MotorArgs {
    /// The board to simulate.
    pub fn simulated(&self) -> Result<Setup> {
        let hidden = self.effects.as_deref().map(Motor::effects_of_file).transpose()?.unwrap_or_default();
        let name = self.asked()?.unwrap_or_else(|| DEFAULT_MOTOR.to_owned());
        if name == SIMPLE {
            if self.flavour.is_some() || self.effects.is_some() {
                bail!("the motor `{SIMPLE}` has neither flavours nor effects");
            }
            return Ok(Setup::simple());
        }
        Ok(Setup::hybrid(&Motor::load(&name)?, self.flavour.unwrap_or_default(), &hidden)?)
    }

    /// The motor of the command line, or else of the user's own defaults.
    fn asked(&self) -> Result<Option<String>> {
        Ok(self.motor.clone().or(config::load()?.motor))
    }

    /// The motor that goes into the recording: the one asked for, which a simulated board must not contradict.
    fn recorded(&self, chip: &str) -> Result<String> {
        let simulated = Simulated::parse(chip);
        let Some(asked) = &self.asked()? else {
            return Ok(simulated.map_or_else(|| DEFAULT_MOTOR.to_owned(), |it| it.motor));
        };
        let name = if asked == SIMPLE { SIMPLE.to_owned() } else { Motor::load(asked)?.name };
        match simulated {
            Some(it) if it.motor != name => {
                bail!("--motor {asked}: the board simulates `{}`; leave --motor out, or name that one", it.motor)
            }
            None if name == SIMPLE => bail!("--motor {SIMPLE} is a simulated motor, and this board is a real one"),
            _ => Ok(asked.clone()),
        }
    }
}

const DEFAULT_MOTOR: &str = "pcbmotor-30mm";
/// A motor of one time constant, for tests of the link and the loop.
const SIMPLE: &str = "simple";

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
    fn open(&self) -> Result<Box<dyn Port>> {
        let port = self.port()?;
        if port == "sim" {
            return Ok(Box::new(SimulatedLink::new(self.motor.simulated()?)));
        }
        if self.motor.flavour.is_some() || self.motor.effects.is_some() {
            bail!("--flavour and --effects are of a simulated motor: give them to `twum sim`, or with --port sim");
        }
        Ok(Box::new(SerialLink::open(&port, self.reset)?))
    }

    fn port(&self) -> Result<String> {
        let known = self.port.clone().or(config::load()?.port);
        known.context(
            "no port: give --port, set TWUM_PORT, or set it in the file of `twum config path` (`sim` needs no board)",
        )
    }

    /// Whether the port was given on the command line, or at least is not the environment's.
    pub fn is_explicit(&self) -> bool {
        self.port.is_some() && std::env::var("TWUM_PORT").ok() != self.port
    }

    /// Opens the port and a session that Ctrl-C interrupts.
    pub fn session(&self) -> Result<Session<Box<dyn Port>>> {
        catch_interrupts()?;
        let mut session = Session::new(self.open()?);
        session.interrupt_by(&INTERRUPTED);
        Ok(session)
    }

    /// Asks the board who it is; the motor that recordings of it name.
    pub fn motor(&self, session: &mut Session<Box<dyn Port>>) -> Result<String> {
        self.motor.recorded(&session.hello()?.chip)
    }

    /// Performs an experiment; a lost port is waited for and opened again. The recording names the motor of the board.
    pub fn perform(&self, mut experiment: Experiment, observe: impl FnMut(&Received)) -> Result<Outcome> {
        let mut session = self.session()?;
        experiment.motor = self.motor(&mut session)?;
        let port = self.port()?;
        let mut reopen = || SerialLink::open(&port, self.reset).map(|port| Box::new(port) as Box<dyn Port>);
        Ok(perform(&mut session, &experiment, Some(&mut reopen), observe)?)
    }
}

/// How to run the motor.
#[derive(Debug, clap::Args)]
pub struct ConfigurationArgs {
    /// Controller: `thesis`, `default`, or a TOML file of gains [default: default]
    #[arg(long)]
    control: Option<String>,
    /// Encoder edges a revolution [default: 400]
    #[arg(long)]
    edges_per_rev: Option<u16>,
    /// PWM frequency, Hz [default: 50]
    #[arg(long)]
    pwm_hz: Option<u16>,
}

impl ConfigurationArgs {
    /// Encoder edges a revolution.
    pub fn edges_per_rev(&self) -> Result<u16> {
        Ok(self.edges_per_rev.or(config::load()?.edges_per_rev).unwrap_or(400))
    }

    /// The configuration the device gets.
    pub fn configuration(&self) -> Result<Configuration> {
        let own = config::load()?;
        let named = self.control.as_ref().or(own.control.as_ref());
        let control = ControlSpec::named(named.map_or("default", |name| name))?.config()?;
        let edges_per_rev = self.edges_per_rev()?;
        let pwm_hz = self.pwm_hz.or(own.pwm_hz).unwrap_or(50);
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
    pub fn conclude(&self, outcome: &Outcome, motor: Option<&RunFigures>) -> Result<ExitCode> {
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
                    "recorded_frames": outcome.recorded, "recording": self.out, "motor": motor,
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
