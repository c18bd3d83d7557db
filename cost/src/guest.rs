//! The bare-metal half: QEMU's `virt` machine, files by semihosting.

use crate::exchange::{self, FRAMES, INPUTS, ROW_BYTES, ROWS, Row, SPEC_BYTES, TICK_BYTES};
use crate::work::{self, Doubles};
use core::hint::black_box;
use semihosting::fs::File;
use semihosting::io::{self, Read, Write};
use twum_shared::frame::MAX_ENCODED;
use twum_shared::message::{BLOCK_SAMPLES, DeviceMessage};
use twum_shared::stall::Stall;
use twum_shared::step::{Config, ConfigSpec, Inputs, Outputs, State};

/// The machine's semihosting calls are slow: ticks are read and rows written this many at a time.
const BATCH: usize = 16 * BLOCK_SAMPLES;

#[riscv_rt::entry]
fn main() -> ! {
    match run() {
        Ok(()) => semihosting::process::exit(0),
        Err(error) => {
            semihosting::eprintln!("cost: {error:?}");
            semihosting::process::exit(1)
        }
    }
}

fn run() -> io::Result<()> {
    assert_eq!(
        count(thousand_instructions).1,
        1000,
        "instructions are not counted one by one; start QEMU with -icount"
    );
    let mut files = Files { inputs: File::open(INPUTS)?, rows: File::create(ROWS)?, frames: File::create(FRAMES)? };
    let mut spec = [0u8; SPEC_BYTES];
    loop {
        files.inputs.read_exact(&mut spec)?;
        let length = usize::from(spec[0]);
        if length == 0 {
            break;
        }
        let spec: ConfigSpec = postcard::from_bytes(&spec[1..=length]).expect("the host wrote a controller");
        let config = Config::try_from(spec).expect("the host sends valid controllers");
        let (ticks, telemetry) = (files.number()?, files.number()? != 0);
        files.work(&config, ticks as usize, telemetry)?;
    }
    files.encode(0, &work::edges_block())?;
    files.encode(0, &work::bits_block())
}

struct Files {
    inputs: File,
    rows: File,
    frames: File,
}

impl Files {
    fn number(&mut self) -> io::Result<u32> {
        let mut bytes = [0u8; 4];
        self.inputs.read_exact(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn work(&mut self, config: &Config, ticks: usize, telemetry: bool) -> io::Result<()> {
        let mut loops =
            Loops { state: State::REST, doubles: Doubles::default(), stall: work::judge(config), position: 0 };
        let mut block: heapless::Vec<(Inputs, Outputs), BLOCK_SAMPLES> = heapless::Vec::new();
        let mut block_state = loops.state;
        let mut tick = 0;
        while tick < ticks {
            let batch = BATCH.min(ticks - tick);
            let (mut inputs, mut rows) = ([[0u8; TICK_BYTES]; BATCH], [[0u8; ROW_BYTES]; BATCH]);
            self.inputs.read_exact(inputs[..batch].as_flattened_mut())?;
            for (seen, row) in inputs[..batch].iter().zip(&mut rows) {
                let seen = exchange::tick_from_bytes(seen);
                if block.is_empty() {
                    block_state = loops.state;
                }
                let (decided, became) = one(config, &mut loops, seen);
                *row = became.to_bytes();
                tick += 1;
                if telemetry && block.push((seen, decided)).is_ok() && block.is_full() {
                    let first = tick - BLOCK_SAMPLES;
                    self.encode(first as u32, &work::control_block(first as u64, block_state, &block))?;
                    block.clear();
                }
            }
            self.rows.write_all(rows[..batch].as_flattened())?;
        }
        Ok(())
    }

    fn encode(&mut self, sequence: u32, message: &DeviceMessage) -> io::Result<()> {
        let mut out = [0u8; MAX_ENCODED];
        let (frame, cost) = count(|| work::encode(sequence, black_box(message), &mut out));
        self.frames.write_all(&cost.to_le_bytes())?;
        self.frames.write_all(&(frame.len() as u32).to_le_bytes())?;
        self.frames.write_all(frame)
    }
}

/// What the ticks of a run carry on.
struct Loops {
    state: State,
    doubles: Doubles,
    stall: Stall,
    position: i32,
}

fn one(config: &Config, loops: &mut Loops, seen: Inputs) -> (Outputs, Row) {
    let Loops { state, doubles, stall, position } = loops;
    let (decided, step_cost) = count(|| work::fixed_point(black_box(config), black_box(&mut *state), black_box(seen)));
    let edges = seen.position.wrapping_sub(*position).unsigned_abs();
    *position = seen.position;
    let duty = decided.duty(config);
    let (stalled, stall_cost) = count(|| work::stalled(black_box(&mut *stall), black_box(duty), black_box(edges)));
    let ((pwm, clockwise), doubles_cost) =
        count(|| black_box(&mut *doubles).tick(black_box(seen.target), black_box(seen.position)));
    let row = Row {
        u: decided.u,
        integral: state.integral,
        previous_error: state.previous_error,
        place: state.rotor.place,
        on_steps: decided.on_steps,
        directions: u8::from(decided.direction.pin_high()) | u8::from(clockwise) << 1,
        doubles_pwm: pwm as u8,
        step_cost: step_cost as u16,
        doubles_cost: doubles_cost as u16,
        stalled: u16::from(stalled),
        stall_cost: stall_cost as u16,
    };
    (decided, row)
}

/// Runs `work` and counts its instructions; the counting itself, measured on nothing, is taken off.
fn count<R>(work: impl FnOnce() -> R) -> (R, u32) {
    let empty = {
        let before = retired();
        retired().wrapping_sub(before)
    };
    let before = retired();
    // The black box keeps the result's last instructions on this side of the counter.
    let result = black_box(work());
    let after = retired();
    (result, after.wrapping_sub(before).wrapping_sub(empty))
}

#[inline(always)]
fn retired() -> u32 {
    let count: u32;
    // SAFETY: reads a counter. Without `nomem`, memory accesses stay on their side of it.
    unsafe { core::arch::asm!("csrr {}, minstret", out(reg) count) };
    count
}

fn thousand_instructions() {
    // SAFETY: does nothing.
    unsafe { core::arch::asm!(".rept 1000", "nop", ".endr") };
}
