//! `twum instruments`.

use super::output::answer;
use super::signals::on_signal;
use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{Read, Write, stderr, stdin};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;
use twum_host::identify::circuit::{Circuit, Mode};
use twum_host::instruments::generator::{Generator, Phases};
use twum_host::instruments::oscilloscope::{Family, Oscilloscope};
use twum_host::instruments::scpi::Scpi;
use twum_host::instruments::{simulate, sweep};

/// Whoever shows life on standard input is frozen after this: `twum serve` does so ten times as often.
const SILENCE: Duration = Duration::from_secs(1);

/// Arguments of `twum instruments`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Sweep a stator with a DG1022 generator and a DS1052E or DS1104Z oscilloscope
    Sweep(Sweep),
    /// Serve a simulated generator and oscilloscope with a stator between them, on loopback
    Simulate(Simulate),
    /// Switch a generator's outputs off
    Off {
        /// Generator: /dev/usbtmcN, host or host:port
        generator: String,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  twum instruments sweep stator.csv --generator /dev/usbtmc0 --scope /dev/usbtmc1
  twum instruments sweep stator.csv --generator /dev/usbtmc0 --scope 192.168.1.20 --from 40000 --to 48000 --step 5
  twum identify stator stator.csv --shunt 2000

Channel 1 of the scope sits before the shunt, channel 2 between shunt and stator. The same command again goes on with a
sweep that was stopped. Outputs go off on every way out, Ctrl-C included.")]
struct Sweep {
    /// Waveform file to write, or to go on with
    file: PathBuf,
    /// Generator: /dev/usbtmcN, host or host:port
    #[arg(long, env = "TWUM_GENERATOR")]
    generator: String,
    /// Oscilloscope: /dev/usbtmcN, host or host:port
    #[arg(long, env = "TWUM_SCOPE")]
    scope: String,
    /// First frequency (Hz)
    #[arg(long, default_value_t = 30_000.0)]
    from: f64,
    /// Last frequency (Hz)
    #[arg(long, default_value_t = 50_000.0)]
    to: f64,
    /// Step (Hz)
    #[arg(long, default_value_t = 10.0)]
    step: f64,
    /// Drive, peak to peak (V)
    #[arg(long, default_value_t = 6.0)]
    vpp: f64,
    /// Time for the stator to ring in after each step (ms): some Q/fs
    #[arg(long, default_value_t = 5)]
    settle_ms: u64,
    /// Leave the generator's second channel off
    #[arg(long)]
    single_phase: bool,
    /// End, outputs off, when standard input ends, or is silent for 1 s after it has said anything: for whoever starts this
    /// from a program or over ssh
    #[arg(long)]
    attended: bool,
    /// Say on stderr how far it is, a line each: `progress SHARE WHAT`
    #[arg(long)]
    progress: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  twum instruments simulate --generator-port 5555 --scope-port 5556
  twum instruments sweep stator.csv --generator 127.0.0.1:5555 --scope 127.0.0.1:5556")]
struct Simulate {
    /// Port of the generator (0 takes any)
    #[arg(long, default_value_t = 5555)]
    generator_port: u16,
    /// Port of the oscilloscope (0 takes any)
    #[arg(long, default_value_t = 5556)]
    scope_port: u16,
    /// Which oscilloscope to be
    #[arg(long, value_enum, default_value_t = Family::Ds1104z)]
    model: Family,
    /// Motional inductance (H); the defaults are the thesis's stator
    #[arg(long, default_value_t = simulate::INDUCTANCE_H)]
    inductance: f64,
    /// Motional capacitance (F)
    #[arg(long, default_value_t = simulate::CAPACITANCE_F)]
    capacitance: f64,
    /// Motional resistance (ohm)
    #[arg(long, default_value_t = simulate::RESISTANCE_OHM)]
    resistance: f64,
    /// Clamped capacitance (F)
    #[arg(long, default_value_t = simulate::CLAMPED_F)]
    clamped: f64,
    /// Dielectric loss (ohm)
    #[arg(long, default_value_t = simulate::LOSS_OHM)]
    loss: f64,
    /// Shunt (ohm)
    #[arg(long, default_value_t = 2000.0)]
    shunt: f64,
    /// Noise at each input (V)
    #[arg(long, default_value_t = 0.01)]
    noise: f64,
    /// Seed of noise and jitter
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum instruments`.
pub fn run(args: Args) -> Result<ExitCode> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    on_signal(move || flag.store(true, Ordering::Relaxed))?;
    match args.what {
        What::Sweep(args) => run_sweep(args, &stop),
        What::Simulate(args) => run_simulate(args, &stop),
        What::Off { generator, json } => {
            Generator::new(Scpi::open(&generator)?, Phases::Two)?;
            eprintln!("{generator}: both outputs are off");
            if json {
                println!("{}", serde_json::json!({ "generator": generator, "outputs_on": false }));
            }
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn run_sweep(args: Sweep, stop: &Arc<AtomicBool>) -> Result<ExitCode> {
    let plan = sweep::Plan {
        from_hz: args.from,
        to_hz: args.to,
        step_hz: args.step,
        vpp: args.vpp,
        settle: Duration::from_millis(args.settle_ms),
    };
    plan.frequencies()?;
    if args.attended {
        stop_when_input_ends(Arc::clone(stop));
    }
    let phases = if args.single_phase { Phases::One } else { Phases::Two };
    let generator = Generator::new(Scpi::open(&args.generator)?, phases)?;
    let mut scope = Oscilloscope::new(Scpi::open(&args.scope)?)?;
    let bar =
        ProgressBar::new(0).with_style(ProgressStyle::with_template("{bar:40} {pos}/{len} frequencies, {eta} left")?);
    let taken = sweep::run(&plan, &args.file, generator, &mut scope, stop, |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
        if args.progress {
            // Nobody may be there to read it any more; the outputs go off all the same.
            let _ = writeln!(stderr(), "progress {:.3} {done} of {total} frequencies", done as f64 / total as f64);
        }
    })?;
    bar.finish_and_clear();
    eprintln!("{}: {taken} frequencies taken, outputs off", args.file.display());
    if args.json {
        println!("{}", serde_json::json!({ "file": args.file, "taken": taken }));
    }
    Ok(ExitCode::SUCCESS)
}

/// Whoever holds the other end of standard input is gone when it ends, or asks for the end so. Who says something there is
/// frozen when it falls silent.
fn stop_when_input_ends(stop: Arc<AtomicBool>) {
    let (said, hears) = channel();
    std::thread::spawn(move || {
        // An input that cannot be read has ended.
        for _ in stdin().lock().bytes().map_while(Result::ok) {
            if said.send(()).is_err() {
                return;
            }
        }
    });
    std::thread::spawn(move || {
        if hears.recv().is_ok() {
            while hears.recv_timeout(SILENCE).is_ok() {}
        }
        stop.store(true, Ordering::Relaxed);
    });
}

fn run_simulate(args: Simulate, stop: &AtomicBool) -> Result<ExitCode> {
    for (name, value) in [
        ("--inductance", args.inductance),
        ("--capacitance", args.capacitance),
        ("--resistance", args.resistance),
        ("--clamped", args.clamped),
        ("--loss", args.loss),
        ("--shunt", args.shunt),
    ] {
        anyhow::ensure!(value.is_finite() && value > 0.0, "{name} must be positive, got {value}");
    }
    anyhow::ensure!(args.noise.is_finite() && args.noise >= 0.0, "--noise must not be negative, got {}", args.noise);
    let mode = Mode::from_elements(args.inductance, args.capacitance, args.resistance);
    let bench = simulate::Bench::start(simulate::Setup {
        circuit: Circuit::single(args.clamped, args.loss, mode),
        shunt_ohm: args.shunt,
        noise_v: args.noise,
        family: args.model,
        seed: args.seed,
        ports: (args.generator_port, args.scope_port),
    })
    .context("cannot listen on loopback: is the port taken?")?;
    let [generator, scope] = [bench.generator.to_string(), bench.scope.to_string()];
    let value = serde_json::json!({ "generator": generator, "scope": scope });
    answer(args.json, &value, &format!("--generator {generator} --scope {scope}"));
    eprintln!(
        "simulated bench: series resonance {:.1} Hz, Q {:.1}, shunt {} ohm; Ctrl-C ends it",
        mode.fs_hz, mode.q, args.shunt
    );
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok(ExitCode::SUCCESS)
}
