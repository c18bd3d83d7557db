//! `twum model`.

use super::existing::ExistingArgs;
use super::flavour::FlavourArgs;
use super::output::{print_table, stage};
use super::robust;
use super::units;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::configuration::controller;
use twum_host::model::braking::{Braking, MEASURED, Point, SIMULATED, braking};
use twum_host::model::check::check;
use twum_host::model::closed_loop::{Following, LoopProgram, Tick, following, run as run_loop};
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant, Solver};
use twum_host::model::study::{Setup, Speed};
use twum_host::output::{self, Existing, Output};
use twum_host::report::figure::{Figure, Panel};
use twum_shared::step::Config;

/// Arguments of `twum model`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  twum model speed                                  full drive, physical flavour, averaged model
  twum model speed --solver carrier --seconds 0.4   the same at carrier resolution
  twum model speed --duty 0.5 --set u=0.12 --json
  twum model sweep --plot speed_duty.svg
  twum model torque --plot torque.png
  twum model loop --flavour measured --csv loop.csv --plot loop.svg     the thesis's closed loop
  twum model braking                                how much the rotor brakes with the drive off
  twum model robust --control thesis --control default    both on 200 motors that differ
  twum model check                                  the tables of docs/model.md, for this motor

Parameters of --set are those of the thesis's section A.4: f, Vrms, Ms, Cs, Ks, eta, Rr, R0, b, n, h, Mr, Jr, Cz, Ctheta,
u, Fext, Tload, Cn; and uoff, the friction without a wave. docs/model.md has the equations and what they leave out.")]
pub struct Args {
    #[command(subcommand)]
    question: Question,
}

#[derive(Debug, clap::Subcommand)]
enum Question {
    /// Speed at one duty, over the last 20 % of a run
    Speed {
        #[command(flatten)]
        common: Common,
        /// Fraction of the PWM period with the drive on
        #[arg(long, default_value_t = 1.0)]
        duty: f64,
    },
    /// Speed against duty
    Sweep {
        #[command(flatten)]
        common: Common,
        /// Number of duties from 0 to 1
        #[arg(long, default_value_t = 33)]
        points: usize,
    },
    /// Speed against load torque, up to what the contact can transmit
    Torque {
        #[command(flatten)]
        common: Common,
        /// Fraction of the PWM period with the drive on
        #[arg(long, default_value_t = 1.0)]
        duty: f64,
        /// Number of loads
        #[arg(long, default_value_t = 21)]
        points: usize,
    },
    /// How far to trust the models: step size, averaged against carrier, start and stop, the closed loop piece by piece
    Check {
        /// A shipped motor, or a motor file
        #[arg(long, default_value = "pcbmotor-30mm")]
        motor: String,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// How much the rotor brakes with the drive off, from the thesis's figures of the real motor's closed loop
    Braking {
        /// A shipped motor, or a motor file
        #[arg(long, default_value = "pcbmotor-30mm")]
        motor: String,
        /// Print JSON
        #[arg(long)]
        json: bool,
        /// Draw to this file, .svg, .png or .html
        #[arg(long, value_name = "FILE")]
        plot: Option<PathBuf>,
    },
    /// Controllers on many motors that differ in what is not known: error of the median and of nine in ten
    Robust(robust::Args),
    /// The motor under the chip's control step, following a sine
    Loop {
        #[command(flatten)]
        common: Common,
        /// Controller: `thesis`, `default`, or a TOML file: its `[control]` as `twum config dump` writes it, or gains
        #[arg(long, default_value = "thesis")]
        control: String,
        /// Amplitude of the sine (counts)
        #[arg(long, default_value_t = 89)]
        amplitude: i32,
        /// Angular frequency of the sine (rad/s)
        #[arg(long, default_value_t = 1.257)]
        omega: f64,
        /// Count edges in the rotor's true sense, not the direction pin's: what no one-line encoder can do
        #[arg(long)]
        true_sense: bool,
        /// Write every control tick to this file
        #[arg(long, value_name = "FILE")]
        csv: Option<PathBuf>,
        #[command(flatten)]
        existing: ExistingArgs,
    },
}

#[derive(Debug, clap::Args)]
struct Common {
    /// A shipped motor, or a motor file
    #[arg(long, default_value = "pcbmotor-30mm")]
    motor: String,
    /// Change a parameter; repeatable
    #[arg(long = "set", value_name = "NAME=VALUE")]
    set: Vec<String>,
    /// PWM frequency (Hz)
    #[arg(long, default_value_t = 50.0)]
    pwm_hz: f64,
    /// Length of the run (s) [default: 1, and 10 for loop]
    #[arg(long)]
    seconds: Option<f64>,
    /// Which model
    #[arg(long, value_enum, default_value_t = SolverArg::Averaged)]
    solver: SolverArg,
    #[command(flatten)]
    flavour: FlavourArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Draw to this file, .svg, .png or .html
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum SolverArg {
    Averaged,
    Carrier,
}

impl Common {
    fn setup(&self, duty: f64, seconds: f64) -> Result<Setup> {
        let flavour = self.flavour.get();
        let solver = match self.solver {
            SolverArg::Averaged => Solver::Averaged,
            SolverArg::Carrier => Solver::Carrier,
        };
        let motor = Motor::load(&self.motor)?;
        let setup = Setup {
            parameters: motor.parameters(flavour).assign(&self.set).context("--set")?,
            effects: motor.effects(),
            flavour,
            solver,
            duty,
            pwm_hz: self.pwm_hz,
            seconds: self.seconds.unwrap_or(seconds),
        };
        setup.check()?;
        setup.check_load()?;
        if let Some(path) = &self.plot {
            output::may_write(path, Existing::Keep)?;
        }
        Ok(setup)
    }

    fn draw(&self, figure: impl FnOnce() -> Result<Figure>) -> Result<()> {
        if let Some(path) = &self.plot {
            figure()?.write(path)?;
            eprintln!("wrote {}", path.display());
        }
        Ok(())
    }
}

/// Runs `twum model`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.question {
        Question::Speed { common, duty } => speed(&common, duty),
        Question::Sweep { common, points } => sweep(&common, points),
        Question::Torque { common, duty, points } => torque(&common, duty, points),
        Question::Braking { motor, json, plot } => brake(&motor, json, plot),
        Question::Check { motor, json } => check_models(&motor, json),
        Question::Loop { common, control, amplitude, omega, true_sense, csv, existing } => {
            follow(&common, &control, amplitude, omega, true_sense, csv, existing)
        }
        Question::Robust(args) => robust::run(args),
    }?;
    Ok(ExitCode::SUCCESS)
}

fn print_json(value: &impl Serialize) -> Result<()> {
    println!("{}", serde_json::to_string(value)?);
    Ok(())
}

fn speed(common: &Common, duty: f64) -> Result<()> {
    let setup = common.setup(duty, 1.0)?;
    let waiting = stage("simulating");
    let speed = setup.speed()?;
    waiting.finish_and_clear();
    finite(&[(duty, speed)])?;
    if common.json {
        print_json(&speed)?;
    } else {
        println!(
            "speed           {:.4} rad/s = {:.3} rpm (mean over the last 20 %)",
            speed.speed_rad_s, speed.speed_rpm
        );
        println!("wave amplitude  {:.4e} m", speed.wave_amplitude_m);
        println!("rotor height    {:.4e} m", speed.rotor_height_m);
        let times = setup.seconds / speed.wall_s;
        println!("{} steps in {:.4} s, {:.3} times real time", speed.steps, speed.wall_s, times);
    }
    common.draw(|| {
        let line = setup.start_up()?;
        let title = format!("Start of the {} motor model, duty {duty}", setup.flavour);
        Ok(Figure::new(title).panel(Panel::new("time (s)", "speed (rpm)").line("speed", &line)))
    })
}

/// Refuses an answer that is no number.
fn finite(speeds: &[(f64, Speed)]) -> Result<()> {
    match speeds.iter().find(|(_, speed)| !speed.speed_rad_s.is_finite()) {
        Some((at, _)) => {
            bail!("the model gives no finite speed at {at}: these parameters are outside what it describes")
        }
        None => Ok(()),
    }
}

#[derive(Serialize)]
struct SweepPoint {
    duty: f64,
    #[serde(flatten)]
    speed: Speed,
}

fn sweep(common: &Common, points: usize) -> Result<()> {
    if !(2..=10_000).contains(&points) {
        bail!("--points {points} is outside 2 ..= 10000");
    }
    let setup = common.setup(1.0, 1.0)?;
    let duties: Vec<f64> = (0..points).map(|i| i as f64 / (points - 1) as f64).collect();
    let waiting = stage("simulating every duty");
    let speeds = setup.sweep(&duties)?;
    waiting.finish_and_clear();
    finite(&speeds)?;
    if common.json {
        print_json(&speeds.iter().map(|&(duty, speed)| SweepPoint { duty, speed }).collect::<Vec<_>>())?;
    } else {
        let rows: Vec<_> = speeds
            .iter()
            .map(|(duty, s)| vec![format!("{duty:.4}"), format!("{:.4}", s.speed_rad_s), format!("{:.3}", s.speed_rpm)])
            .collect();
        print_table(&["duty", "rad/s", "rpm"], &rows);
    }
    common.draw(|| {
        let line: Vec<_> = speeds.iter().map(|(duty, s)| (*duty, s.speed_rpm)).collect();
        let title = format!("Speed against duty, {} flavour, {} Hz PWM", setup.flavour, setup.pwm_hz);
        Ok(Figure::new(title).panel(Panel::new("duty", "speed (rpm)").line("model", &line)))
    })
}

#[derive(Serialize)]
struct TorquePoint {
    load_nm: f64,
    #[serde(flatten)]
    speed: Speed,
}

fn torque(common: &Common, duty: f64, points: usize) -> Result<()> {
    if !(2..=10_000).contains(&points) {
        bail!("--points {points} is outside 2 ..= 10000");
    }
    let setup = common.setup(duty, 1.0)?;
    // Just short of the stall torque: beyond it the rotor runs away backwards.
    let stall = setup.stall_torque_nm();
    let loads: Vec<f64> = (0..points).map(|i| 0.995 * stall * i as f64 / (points - 1) as f64).collect();
    let waiting = stage("simulating every load");
    let speeds = setup.under_loads(&loads)?;
    waiting.finish_and_clear();
    finite(&speeds)?;
    if common.json {
        print_json(&speeds.iter().map(|&(load_nm, speed)| TorquePoint { load_nm, speed }).collect::<Vec<_>>())?;
    } else {
        let rows: Vec<_> = speeds
            .iter()
            .map(|(load, s)| {
                vec![format!("{:.4}", load * 1e3), format!("{:.4}", s.speed_rad_s), format!("{:.3}", s.speed_rpm)]
            })
            .collect();
        print_table(&["mN·m", "rad/s", "rpm"], &rows);
        eprintln!("the contact transmits at most {:.3} mN·m", stall * 1e3);
    }
    common.draw(|| {
        let line: Vec<_> = speeds.iter().map(|(load, s)| (s.speed_rpm, load * 1e3)).collect();
        let title = format!("Torque against speed, {} flavour, duty {duty}", setup.flavour);
        let fastest = line.iter().fold(0.0, |top: f64, point| top.max(point.0));
        let panel = Panel::new("speed (rpm)", "torque (mN·m)").x_range(0.0, 1.05 * fastest.max(1e-3));
        Ok(Figure::new(title).panel(panel.line("model", &line)))
    })
}

fn brake(motor: &str, json: bool, plot: Option<PathBuf>) -> Result<()> {
    let motor = Motor::load(motor)?;
    let waiting = stage("simulating the closed loop at every torque");
    let found = braking(&motor)?;
    waiting.finish_and_clear();
    if json {
        print_json(&found)?;
    } else {
        let rows = found.points.iter().map(|p| {
            vec![
                format!("{:.2}", p.torque_nm * 1e4),
                format!("{:.3}", p.mse_deg2),
                format!("{:.3}", p.mean_abs_deg),
                p.r2_listed.map_or("-".to_owned(), |r2| format!("{r2:.3}")),
            ]
        });
        print_table(&["1e-4 N·m", "MSE (deg2)", "mean (deg)", "R2 of listed speeds"], &rows.collect::<Vec<_>>());
        for asked in &found.asked {
            let range = |[low, high]: [f64; 2]| format!("{:.3}e-4 to {:.3}e-4 N·m", low * 1e4, high * 1e4);
            let answer = asked.range_nm.map_or("no torque gives it".to_owned(), range);
            println!("{} = {}: {answer}", asked.figure, asked.measured);
        }
        if let (Some(t), Some([low, high]), Some(u)) = (found.torque_nm, found.interval_nm, found.off_friction) {
            println!(
                "both figures of the loop: {:.3}e-4 N·m, {:.3}e-4 to {:.3}e-4 (uoff = {u:.4})",
                t * 1e4,
                low * 1e4,
                high * 1e4
            );
        }
    }
    if let Some(path) = plot {
        braking_figure(&found).write(&path).with_context(|| format!("cannot draw {}", path.display()))?;
        eprintln!("wrote {}", path.display());
    }
    Ok(())
}

fn braking_figure(found: &Braking) -> Figure {
    let line = |f: &dyn Fn(&Point) -> f64| found.points.iter().map(|p| (p.torque_nm * 1e4, f(p))).collect::<Vec<_>>();
    let last = found.points.last().map_or(0.0, |p| p.torque_nm * 1e4);
    let level = |value: f64| [(0.0, value), (last, value)];
    let x = "torque without a wave (1e-4 N·m)";
    let panel = |k: usize, label: &str, f: &dyn Fn(&Point) -> f64| {
        Panel::new(x, label)
            .line("model", &line(f))
            .dashed("real motor (thesis)", &level(MEASURED[k]))
            .dashed("the thesis's simulation", &level(SIMULATED[k]))
    };
    Figure::new("The thesis's closed-loop test against the rotor's braking with the drive off")
        .size(1000, 760)
        .panel(panel(0, "mean square error (deg²)", &|p| p.mse_deg2))
        .panel(panel(1, "mean error (deg)", &|p| p.mean_abs_deg))
}

fn check_models(motor: &str, json: bool) -> Result<()> {
    let motor = Motor::load(motor)?;
    let waiting = stage("holding the models against each other");
    let found = check(&motor)?;
    waiting.finish_and_clear();
    if json {
        return print_json(&found);
    }
    println!("Carrier model: error of the wave after 102.4 us against a step of 5 ns, speed after 60 ms of full drive");
    let rows = found.convergence.iter().map(|r| {
        vec![
            r.flavour.to_string(),
            format!("{:.2}", r.step_s * 1e6),
            format!("{:.1e}", r.error),
            r.order.map_or(String::new(), |o| format!("{o:.2}")),
            format!("{:.5}", r.speed_rad_s),
        ]
    });
    print_table(&["flavour", "step (us)", "error", "order", "rad/s"], &rows.collect::<Vec<_>>());
    println!("\nCarrier against averaged model: steady speed");
    let rows = found.duties.iter().map(|r| {
        let off = r.averaged_rpm - r.carrier_rpm;
        vec![
            r.flavour.to_string(),
            format!("{:.0}/32", r.duty * 32.0),
            format!("{:.3}", r.carrier_rpm),
            format!("{:.3}", r.averaged_rpm),
            format!("{off:+.3}"),
            format!("{:+.2} %", 100.0 * off / r.carrier_rpm),
        ]
    });
    print_table(&["flavour", "duty", "carrier (rpm)", "averaged (rpm)", "off by (rpm)", ""], &rows.collect::<Vec<_>>());
    println!("\nThe first 10 ms of a start and of a stop: error of the averaged model's speed over the steady speed");
    let rows = found.transients.iter().map(|r| {
        vec![
            r.flavour.to_string(),
            r.case.clone(),
            format!("{:.2} %", 100.0 * r.rms),
            format!("{:.2} %", 100.0 * r.worst),
            format!("{:+.1}", r.ahead_us),
        ]
    });
    print_table(&["flavour", "case", "rms", "worst 0.1 ms", "ahead by (us)"], &rows.collect::<Vec<_>>());
    println!(
        "\nThe thesis's closed-loop test; its simulation: 2.566 deg2, 1.452 deg; its real motor: 14.199 deg2, 3.125 deg"
    );
    let rows = found.pieces.iter().map(|r| {
        vec![
            format!("{:.3}", r.following.mse_deg2),
            format!("{:.3}", r.following.mean_abs_deg),
            format!("{:.3}", r.following.true_mean_abs_deg),
            r.model.clone(),
        ]
    });
    print_table(&["MSE (deg2)", "mean (deg)", "true mean (deg)", "model"], &rows.collect::<Vec<_>>());
    Ok(())
}

#[derive(Serialize)]
struct LoopAnswer {
    #[serde(flatten)]
    following: Following,
    ticks: usize,
    wall_s: f64,
}

fn follow(
    common: &Common,
    control: &str,
    amplitude: i32,
    omega: f64,
    true_sense: bool,
    csv: Option<PathBuf>,
    existing: ExistingArgs,
) -> Result<()> {
    let setup = common.setup(1.0, 10.0)?;
    if let Some(path) = &csv {
        output::may_write(path, existing.into())?;
    }
    let spec = controller(control).context("--control")?;
    let reference = units::sine(amplitude, omega).context("--amplitude or --omega")?;
    let program = LoopProgram {
        config: Config::try_from(spec)?,
        reference,
        pwm_hz: setup.pwm_hz,
        edges_per_rev: Motor::load(&common.motor)?.edges_per_rev,
        encoder_phase_rad: 0.0,
        end_s: setup.seconds,
        true_sense,
    };
    let effects = setup.effects;
    let mut plant = MotorPlant::new(setup.parameters, setup.flavour, setup.solver, &effects, History::default());
    let began = std::time::Instant::now();
    let waiting = stage("simulating the closed loop");
    let trace = run_loop(&program, &mut plant, &effects)?;
    waiting.finish_and_clear();
    let following = following(&program, &trace);
    if common.json {
        print_json(&LoopAnswer { following, ticks: trace.len(), wall_s: began.elapsed().as_secs_f64() })?;
    } else {
        println!("counted  {:.3} deg2 MSE, {:.3} deg mean |error|", following.mse_deg2, following.mean_abs_deg);
        println!(
            "true     {:.3} deg2 MSE, {:.3} deg mean |error|",
            following.true_mse_deg2, following.true_mean_abs_deg
        );
        println!("the count ended {} counts off the true position", following.miscount);
    }
    if let Some(path) = csv {
        let mut out = Output::begin(&path, existing.into())?;
        write_csv(&mut out, &trace).with_context(|| format!("cannot write {}", path.display()))?;
        out.finish()?;
    }
    common.draw(|| Ok(loop_figure(&program, &trace, &setup)))
}

/// The `control` format of a measurement folder.
fn write_csv(out: &mut Output, trace: &[Tick]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record(["time_us", "target", "position", "u", "duty", "direction"])?;
    for tick in trace {
        writer.write_record([
            format!("{:.0}", tick.time_s * 1e6),
            tick.target.to_string(),
            tick.position.to_string(),
            format!("{:.5}", f64::from(tick.u) / 65536.0),
            format!("{:.6}", tick.duty),
            tick.direction.sign().to_string(),
        ])?;
    }
    writer.flush()?;
    Ok(())
}

fn loop_figure(program: &LoopProgram, trace: &[Tick], setup: &Setup) -> Figure {
    let count_deg = 360.0 / f64::from(program.edges_per_rev);
    let thin: Vec<&Tick> = trace.iter().step_by((trace.len() / 4000).max(1)).collect();
    let of = |f: &dyn Fn(&Tick) -> f64| thin.iter().map(|tick| (tick.time_s, f(tick))).collect::<Vec<_>>();
    let target = of(&|t| f64::from(t.target) * count_deg);
    let truth = of(&|t| t.angle_rad.to_degrees());
    let error = of(&|t| f64::from(t.target) * count_deg - t.angle_rad.to_degrees());
    let duty = of(&|t| t.duty * f64::from(t.direction.sign()));
    Figure::new(format!("Position control of the {} motor model", setup.flavour))
        .size(1000, 1000)
        .panel(Panel::new("time (s)", "angle (deg)").line("target", &target).line("rotor", &truth))
        .panel(Panel::new("time (s)", "error (deg)").line("target - rotor", &error))
        .panel(Panel::new("time (s)", "signed duty").line("duty", &duty))
}
