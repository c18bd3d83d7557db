//! The host's half: makes the inputs, runs the guest in QEMU, compares and prints.

use crate::binary;
use crate::exchange::{self, FRAMES, INPUTS, ROW_BYTES, ROWS, Row, SPEC_BYTES};
use crate::work::{self, Doubles};
use fixed::types::{I16F48, I32F32};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::{env, fs, io};
use twum_shared::frame::MAX_ENCODED;
use twum_shared::message::{BLOCK_SAMPLES, DeviceMessage};
use twum_shared::reference::Reference;
use twum_shared::stall::Stall;
use twum_shared::step::{Config, ConfigSpec, DriveLaw, GuideSpec, Inputs, Outputs, State};

const USAGE: &str = "usage: twum-cost instructions GUEST\n       twum-cost binary FIRMWARE\n\n\
    `instructions` runs GUEST, this program built for riscv32imc-unknown-none-elf, in qemu-system-riscv32 (Debian:\n\
    qemu-system-misc) and counts. `binary` reads a firmware built with --emit-relocs and -Z emit-stack-sizes.\n\
    firmware/check builds both and runs this.\n\
    Exit codes: 0 everything holds, 1 something does not, 2 it could not be measured.";

/// 0.3 % of a 500 µs period at 160 MHz, one instruction a cycle: for the step, and the judgement of the encoder that every tick makes
/// beside it.
const JUDGED_STEP_LIMIT: u32 = 250;
/// The same of a controller that does more than the thesis's arithmetic: 10 % of that period.
const LONGER_LIMIT: u32 = 8_000;
/// Random controllers that wait with a reversal: under the longer limit.
const WAITING: &str = "random, waiting";
/// A drive that is gated by a model of the rotor, and random ones: likewise.
const GATED: [&str; 4] = ["gated", "planned", "guided", "random, gated"];
/// A target that gives way by a count for 5 µN·m, within half a second.
const GUIDE: GuideSpec = GuideSpec {
    limit_counts: 60,
    stiffness_nnm: 5_000,
    damping_nnm_s: 2_500,
    dead_band_nnm: 40_000,
    braking_nnm: 197_000,
};
/// How many times more the doubles must cost.
const RATIO_LIMIT: f64 = 10.0;
/// Random controllers, and random ticks of each: more than a million steps.
const RANDOM: (usize, usize) = (1024, 1024);
/// 10 s.
const RECORDED_TICKS: usize = 20_000;

pub fn main() -> ExitCode {
    let arguments: Vec<_> = env::args_os().skip(1).collect();
    let held = match arguments.as_slice() {
        [command, path] if command == "instructions" => measure(Path::new(path)),
        [command, path] if command == "binary" => binary::inspect(Path::new(path)).map(|problems| {
            problems.iter().for_each(|problem| println!("  WRONG: {problem}"));
            problems.is_empty()
        }),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match held {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("twum-cost: {error}");
            ExitCode::from(2)
        }
    }
}

/// A controller and the inputs of its ticks.
struct Run {
    name: &'static str,
    config: Config,
    inputs: Vec<Inputs>,
    telemetry: bool,
}

fn measure(guest: &Path) -> io::Result<bool> {
    let mut runs = vec![
        recorded("thesis", ConfigSpec::THESIS),
        recorded("default", ConfigSpec::DEFAULT),
        recorded(GATED[0], ConfigSpec::GATED),
        recorded(GATED[1], ConfigSpec::PLANNED),
        recorded(GATED[2], ConfigSpec { guide: GUIDE, ..ConfigSpec::PLANNED }),
    ];
    let mut pcg = Pcg(1);
    runs.extend((0..RANDOM.0).map(|index| random(&mut pcg, index % 2 == 1)));
    runs.extend((0..RANDOM.0 / 2).map(|_| random_gated(&mut pcg)));

    let folder = Folder::new()?;
    fs::write(folder.file(INPUTS), inputs_file(&runs))?;
    let guest = guest.canonicalize().map_err(|e| io::Error::other(format!("{}: {e}", guest.display())))?;
    let status = Command::new("qemu-system-riscv32")
        .args(["-M", "virt", "-m", "32M", "-bios", "none", "-display", "none", "-serial", "none", "-monitor", "none"])
        .args(["-semihosting-config", "enable=on,target=native", "-icount", "shift=0", "-kernel"])
        .arg(guest)
        .current_dir(&folder.0)
        .status()
        .map_err(|e| io::Error::other(format!("qemu-system-riscv32 does not start: {e}")))?;
    if !status.success() {
        return Err(io::Error::other(format!("the guest ended with {status}")));
    }
    let (rows, frames) = (fs::read(folder.file(ROWS))?, fs::read(folder.file(FRAMES))?);
    report(&runs, &rows, &frames)
}

fn report(runs: &[Run], rows: &[u8], frames: &[u8]) -> io::Result<bool> {
    let mut rows = rows.as_chunks::<ROW_BYTES>().0.iter().map(Row::from_bytes);
    let mut frames = FrameReader(frames);
    let (mut steps, mut doubles, mut judgements) = (Table::new(), Table::new(), Table::new());
    let (mut judged_steps, mut longer) = (Costs::default(), Costs::default());
    let (mut control_frames, mut different, mut compared) = (Costs::default(), 0u64, 0u64);
    for run in runs {
        let (mut step_costs, mut doubles_costs, mut stall_costs) =
            (Costs::default(), Costs::default(), Costs::default());
        for (expected, frame) in Expected::of(run) {
            let row = rows.next().ok_or_else(|| io::Error::other("the guest wrote too few rows"))?;
            compared += 1;
            different += u64::from(Row { step_cost: 0, doubles_cost: 0, stall_cost: 0, ..row } != expected);
            step_costs.add(u32::from(row.step_cost));
            doubles_costs.add(u32::from(row.doubles_cost));
            stall_costs.add(u32::from(row.stall_cost));
            let of = if is_longer(run.name) { &mut longer } else { &mut judged_steps };
            of.add(u32::from(row.step_cost) + u32::from(row.stall_cost));
            if let Some(frame) = frame {
                let (cost, bytes) = frames.next()?;
                different += u64::from(bytes != frame);
                control_frames.add(cost);
            }
        }
        merge(&mut steps, run.name, step_costs);
        merge(&mut doubles, run.name, doubles_costs);
        merge(&mut judgements, run.name, stall_costs);
    }
    let mut blocks = vec![("16 control samples", control_frames)];
    for (name, message) in [("48 edges", work::edges_block()), ("1024 bits", work::bits_block())] {
        let (cost, bytes) = frames.next()?;
        different += u64::from(bytes != encoded(0, &message));
        let mut costs = Costs::default();
        costs.add(cost);
        blocks.push((name, costs));
    }

    println!("| work | inputs | min | mean | max |\n|---|---|---:|---:|---:|");
    let tables = [
        ("fixed-point step", &steps),
        ("the same in doubles", &doubles),
        ("is it a stall", &judgements),
        ("frame of", &blocks),
    ];
    for (work, table) in tables {
        for (name, c) in table {
            println!("| {work} | {name} | {} | {:.1} | {} |", c.min, c.mean(), c.max);
        }
    }
    let short = steps.iter().filter(|(name, _)| !is_longer(name));
    let worst = short.map(|(_, c)| c.max).max().unwrap_or(u32::MAX);
    let ratio = doubles[0].1.mean() / steps[0].1.mean();
    println!("\n{compared} steps on RISC-V and on this machine: {different} differ.");
    println!("Doubles over fixed point, thesis inputs, mean: {ratio:.1} (at least {RATIO_LIMIT}).");
    let judged = judged_steps.max;
    println!(
        "Worst fixed-point step: {worst} instructions; with the judgement of the encoder: {judged} (at most {JUDGED_STEP_LIMIT})."
    );
    println!("Of controllers that wait or gate the drive: {} (at most {LONGER_LIMIT}).", longer.max);
    Ok(different == 0 && judged <= JUDGED_STEP_LIMIT && longer.max <= LONGER_LIMIT && ratio >= RATIO_LIMIT)
}

fn is_longer(name: &str) -> bool {
    name == WAITING || GATED.contains(&name)
}

/// What the guest must give: the rows of a run with the costs left out, and after each full block its frame.
struct Expected<'a> {
    run: &'a Run,
    tick: usize,
    state: State,
    doubles: Doubles,
    stall: Stall,
    position: i32,
    block_state: State,
    block: Vec<(Inputs, Outputs)>,
}

impl<'a> Expected<'a> {
    fn of(run: &'a Run) -> Self {
        let (state, doubles) = (State::REST, Doubles::default());
        let stall = work::judge(&run.config);
        Self { run, tick: 0, state, doubles, stall, position: 0, block_state: state, block: Vec::new() }
    }
}

impl Iterator for Expected<'_> {
    type Item = (Row, Option<Vec<u8>>);

    fn next(&mut self) -> Option<Self::Item> {
        let seen = *self.run.inputs.get(self.tick)?;
        self.tick += 1;
        if self.block.is_empty() {
            self.block_state = self.state;
        }
        let decided = work::fixed_point(&self.run.config, &mut self.state, seen);
        let (pwm, clockwise) = self.doubles.tick(seen.target, seen.position);
        let edges = seen.position.wrapping_sub(self.position).unsigned_abs();
        self.position = seen.position;
        let stalled = work::stalled(&mut self.stall, decided.duty(&self.run.config), edges);
        let row = Row {
            u: decided.u,
            integral: self.state.integral,
            previous_error: self.state.previous_error,
            place: self.state.rotor.place,
            on_steps: decided.on_steps,
            directions: u8::from(decided.direction.pin_high()) | u8::from(clockwise) << 1,
            doubles_pwm: pwm as u8,
            step_cost: 0,
            doubles_cost: 0,
            stalled: u16::from(stalled),
            stall_cost: 0,
        };
        self.block.push((seen, decided));
        let mut frame = None;
        if self.block.len() == BLOCK_SAMPLES {
            let first = self.tick - BLOCK_SAMPLES;
            let message = || work::control_block(first as u64, self.block_state, &self.block);
            frame = self.run.telemetry.then(|| encoded(first as u32, &message()));
            self.block.clear();
        }
        Some((row, frame))
    }
}

fn encoded(sequence: u32, message: &DeviceMessage) -> Vec<u8> {
    work::encode(sequence, message, &mut [0; MAX_ENCODED]).to_vec()
}

struct FrameReader<'a>(&'a [u8]);

impl<'a> FrameReader<'a> {
    fn next(&mut self) -> io::Result<(u32, &'a [u8])> {
        let short = || io::Error::other("the guest wrote too few frames");
        let (head, rest) = self.0.split_first_chunk::<8>().ok_or_else(short)?;
        let cost = u32::from_le_bytes([head[0], head[1], head[2], head[3]]);
        let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        let (frame, rest) = rest.split_at_checked(length).ok_or_else(short)?;
        self.0 = rest;
        Ok((cost, frame))
    }
}

/// Instructions of many calls.
#[derive(Clone, Copy)]
struct Costs {
    calls: u64,
    sum: u64,
    min: u32,
    max: u32,
}

impl Default for Costs {
    fn default() -> Self {
        Self { calls: 0, sum: 0, min: u32::MAX, max: 0 }
    }
}

impl Costs {
    fn add(&mut self, cost: u32) {
        (self.calls, self.sum) = (self.calls + 1, self.sum + u64::from(cost));
        (self.min, self.max) = (self.min.min(cost), self.max.max(cost));
    }

    fn mean(&self) -> f64 {
        self.sum as f64 / self.calls as f64
    }
}

/// Costs by the name of their inputs, in the order they came.
type Table<'a> = Vec<(&'a str, Costs)>;

fn merge<'a>(table: &mut Table<'a>, name: &'a str, more: Costs) {
    match table.iter_mut().find(|(known, _)| *known == name) {
        Some((_, costs)) => {
            (costs.calls, costs.sum) = (costs.calls + more.calls, costs.sum + more.sum);
            (costs.min, costs.max) = (costs.min.min(more.min), costs.max.max(more.max));
        }
        None => table.push((name, more)),
    }
}

fn inputs_file(runs: &[Run]) -> Vec<u8> {
    let mut file = Vec::new();
    for run in runs {
        let mut spec = [0u8; SPEC_BYTES];
        let length = postcard::to_slice(run.config.spec(), &mut spec[1..]).expect("a controller takes 80 bytes").len();
        spec[0] = length as u8;
        file.extend(spec);
        file.extend((run.inputs.len() as u32).to_le_bytes());
        file.extend(u32::from(run.telemetry).to_le_bytes());
        file.extend(run.inputs.iter().flat_map(exchange::tick_to_bytes));
    }
    file.extend([0u8; SPEC_BYTES]);
    file
}

/// What a controller sees while it tracks the thesis's sine with a motor that follows its duty at once, at 35 rpm in full.
fn recorded(name: &'static str, spec: ConfigSpec) -> Run {
    let config = Config::try_from(spec).expect("a named controller is valid");
    let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
    let (mut state, mut position) = (State::REST, 0.0);
    let inputs = (0..RECORDED_TICKS).map(|tick| {
        let target = reference.at(tick as u64 * 500);
        let seen = Inputs {
            target: target.position,
            target_rate: target.rate,
            target_fraction: target.fraction,
            position: position as i32,
            edge_age_us: 137,
        };
        let decided = work::fixed_point(&config, &mut state, seen);
        let on = f64::from(decided.on_steps) / f64::from(config.spec().duty_steps);
        position += f64::from(decided.direction.sign()) * on * 400.0 * 35.0 / 60.0 * 500e-6;
        seen
    });
    Run { name, inputs: inputs.collect(), config, telemetry: true }
}

/// A random valid controller on a random walk, with jumps anywhere.
fn random(pcg: &mut Pcg, waits: bool) -> Run {
    let config = loop {
        let shift = 22 + pcg.next() % 24;
        let spec = ConfigSpec {
            kp: I32F32::from_bits(pcg.wide() >> shift),
            ki_tick: I16F48::from_bits(pcg.wide() >> (6 + pcg.next() % 40)),
            kd_tick: I32F32::from_bits(pcg.wide() >> shift),
            feed_forward: I32F32::from_bits(pcg.wide() >> shift),
            integral_min: -((pcg.next() >> (1 + pcg.next() % 31)) as i32),
            integral_max: (pcg.next() >> (1 + pcg.next() % 31)) as i32,
            period_us: 500,
            duty_steps: (2 + pcg.next() % 32_767) as u16,
            law: if pcg.coin() { DriveLaw::ActiveLowTruncated } else { DriveLaw::OnTimeRounded },
            dead_band_counts: if pcg.coin() { 0 } else { (pcg.next() % 8) as u16 },
            conditional_integration: pcg.coin(),
            reversal_rest_ticks: if waits { (1 + pcg.next() % 8) as u16 } else { 0 },
            reversal_limit_ticks: 8 + (pcg.next() % 8) as u16,
            ..ConfigSpec::DEFAULT
        };
        if let Ok(config) = Config::try_from(spec) {
            break config;
        }
    };
    let name = if waits { WAITING } else { "random" };
    Run { name, inputs: walks(pcg), config, telemetry: false }
}

/// A random valid model of a rotor, likewise.
fn random_gated(pcg: &mut Pcg) -> Run {
    let config = loop {
        let spec = ConfigSpec {
            full_speed_counts_s: (pcg.next() % 16_000) as u16,
            braking_counts_s2: pcg.next() >> (pcg.next() % 24),
            delay_ticks: (pcg.next() % 9) as u8,
            shortest_pulse_ticks: (1 + pcg.next() % 8) as u8,
            pulse_period_ticks: (1 + pcg.next() % 2 * (pcg.next() % 40)) as u8,
            ..ConfigSpec::GATED
        };
        // Where there is one pulse a period, the target may give way.
        let gives_way = spec.pulse_period_ticks > 1 && pcg.coin();
        let spec = ConfigSpec { guide: if gives_way { GUIDE } else { GuideSpec::OFF }, ..spec };
        if let Ok(config) = Config::try_from(spec) {
            break config;
        }
    };
    Run { name: GATED[3], inputs: walks(pcg), config, telemetry: false }
}

fn walks(pcg: &mut Pcg) -> Vec<Inputs> {
    let mut seen = Inputs::default();
    let inputs = (0..RANDOM.1).map(|_| {
        let walk = |pcg: &mut Pcg, value: i32| match pcg.next() % 64 {
            0 => pcg.next() as i32,
            1 => 0,
            _ => value.wrapping_add((pcg.next() % 9) as i32 - 4),
        };
        seen = Inputs {
            target: walk(pcg, seen.target),
            target_rate: walk(pcg, seen.target_rate),
            position: walk(pcg, seen.position),
            target_fraction: pcg.next() as i8,
            edge_age_us: pcg.next() as u16,
        };
        seen
    });
    inputs.collect()
}

/// O'Neill's PCG-XSH-RR 64/32: the same inputs everywhere.
struct Pcg(u64);

impl Pcg {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let shifted = (((self.0 >> 18) ^ self.0) >> 27) as u32;
        shifted.rotate_right((self.0 >> 59) as u32)
    }

    fn coin(&mut self) -> bool {
        self.next() & 1 == 0
    }

    fn wide(&mut self) -> i64 {
        i64::from(self.next()) << 32 | i64::from(self.next())
    }
}

/// A folder for the exchange, gone at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> io::Result<Self> {
        let path = env::temp_dir().join(format!("twum-cost-{}", std::process::id()));
        fs::create_dir(&path)?;
        Ok(Self(path))
    }

    fn file(&self, name: &std::ffi::CStr) -> PathBuf {
        self.0.join(name.to_str().expect("the names are ASCII"))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What a temporary folder leaves behind harms nobody.
        let _ = fs::remove_dir_all(&self.0);
    }
}
