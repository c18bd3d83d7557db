//! `twum serve`.

use super::connect::ConnectArgs;
use super::exit;
use super::motor::MotorArgs;
use super::output::answer;
use super::signals::on_signal;
use anyhow::{Context, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};
use twum_host::link::relay::Lender;
use twum_host::link::{LinkError, Port, is_motor_held, serve};
use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;
use twum_host::serve::Server;
use twum_host::serve::owner::Bench;
use twum_host::serve::sweeping::Instruments;
use twum_shared::message::Configuration;

/// The motor is stopped within this time of the first Ctrl-C, or cannot be.
const STOPPING: Duration = Duration::from_secs(5);

/// Arguments of `twum serve`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum serve --port sim                              everything there is, on a simulated motor
  twum serve --port /dev/ttyUSB0 --folder bench3     http://127.0.0.1:8080, on this machine only
  twum serve --port /dev/ttyUSB0 --listen 0.0.0.0:8080    for others too, who need the address with the token that is printed

One page holds the motor, the others watch; anybody stops it, with the button, Escape or the space bar. A page that holds the
motor and is gone for longer than the command timeout stops it. `twum stop`, `live` and `info` of another terminal work beside it
at any time; `twum track` and every other command that needs the board while no page holds the motor.")]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    /// Address and port to serve at; beyond this machine only with the token that is printed then
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    listen: String,
    /// Folder of the runs: read, and recorded into; made if need be
    #[arg(long, default_value = "runs")]
    folder: PathBuf,
    /// Generator that sweeps a stator from the page: /dev/usbtmcN, host or host:port; the page may name another
    #[arg(long, env = "TWUM_GENERATOR")]
    generator: Option<String>,
    /// Oscilloscope of such sweeps
    #[arg(long, env = "TWUM_SCOPE")]
    scope: Option<String>,
    /// Print the address as JSON
    #[arg(long)]
    json: bool,
}

/// The board of the command line.
struct OwnBench {
    connect: ConnectArgs,
    port: String,
    readings: Vec<(Motor, Flavour)>,
}

impl Bench for OwnBench {
    fn open(&mut self, lender: Lender) -> Result<Box<dyn Port>, LinkError> {
        self.connect.serial(&self.port, Some(lender))
    }

    fn motor(&self, chip: &str, used: &Configuration) -> Result<String, String> {
        let motor: &MotorArgs = self.connect.motor_args();
        let kept = motor.kept(chip).and_then(|kept| motor.has_edges(chip, used.edges_per_rev).map(|()| kept));
        kept.map_err(|error| format!("{error:#}"))
    }

    fn readings(&self) -> Vec<(Motor, Flavour)> {
        self.readings.clone()
    }
}

/// Runs `twum serve`.
pub fn run(args: Args) -> Result<ExitCode> {
    let asked = args.connect.port()?;
    let is_simulated = asked == "sim";
    let port = if is_simulated {
        simulated(args.connect.motor_args())?
    } else {
        args.connect.motor_args().is_of_a_real_board()?;
        asked
    };
    let readings = args.connect.motor_args().readings()?;
    let bench = OwnBench { connect: args.connect, port: port.clone(), readings };
    let instruments = Instruments { generator: args.generator, scope: args.scope, is_simulated };
    let server = Server::new(&args.listen, &args.folder, &port, Box::new(bench), instruments)?;
    let ending = server.ending();
    let mut first = None;
    on_signal(move || {
        let again = first.is_some();
        let since = first.get_or_insert_with(Instant::now).elapsed();
        ending.end();
        if again && (!is_motor_held() || since > STOPPING) {
            std::process::exit(exit::INTERRUPTED.into());
        }
    })?;
    let url = server.url();
    answer(args.json, &serde_json::json!({ "url": url, "port": port, "folder": args.folder }), &url);
    eprintln!(
        "the board is on {port}; runs are recorded in {}; Ctrl-C stops the motor and ends",
        args.folder.display()
    );
    server.serve()?;
    Ok(ExitCode::SUCCESS)
}

/// Serves a board in real time on a pseudo-terminal of this program; gives the terminal's name.
fn simulated(motor: &MotorArgs) -> Result<String> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    // A board lives on its own thread; what is wrong with the arguments is said here.
    motor.simulated()?;
    let (motor, (told, name)) = (motor.clone(), channel());
    std::thread::Builder::new()
        .name("simulated board".to_owned())
        .spawn(move || {
            let ended =
                motor.simulated().and_then(|setup| Ok(serve(setup, &NEVER, |name| _ = told.send(name.to_owned()))?));
            if let Err(error) = ended {
                eprintln!("error: the simulated board ended: {error:#}");
            }
        })
        .context("no thread for the simulated board")?;
    name.recv().context("the simulated board did not start")
}
