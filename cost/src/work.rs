//! What is measured. Both halves call these, so that they do the same work.

use twum_shared::encoder::Edge;
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{
    BITS_WORDS, BLOCK_EDGES, BLOCK_SAMPLES, BitsBlock, Configuration, ControlBlock, ControlSample,
};
use twum_shared::message::{DeviceMessage, EdgesBlock};
use twum_shared::stall::Stall;
use twum_shared::step::{self, Config, Inputs, Outputs, State};
use twum_shared::{Direction, Duty};

/// The fixed-point step, inlined as it is in the control interrupt.
#[inline(always)]
pub fn fixed_point(config: &Config, state: &mut State, inputs: Inputs) -> Outputs {
    step::step(config, state, inputs)
}

/// The judge of the encoder, by the default limits.
pub fn judge(config: &Config) -> Stall {
    Stall::new(&Configuration::with_control(*config.spec()))
}

/// The judgement of a tick, inlined as it is in the control interrupt.
#[inline(always)]
pub fn stalled(stall: &mut Stall, duty: Duty, edges: u32) -> bool {
    stall.check(duty, edges)
}

/// The position controller's arithmetic as the Arduino has it (thesis C.2, `compute`), in doubles, from its formulas.
#[derive(Clone, Copy, Debug, Default)]
pub struct Doubles {
    previous_error: f64,
    integral: f64,
}

impl Doubles {
    /// One tick: the PWM value, 0..=31 high, and whether the drive is clockwise.
    #[inline(always)]
    pub fn tick(&mut self, target: i32, position: i32) -> (i32, bool) {
        // The chip's code divides by its period each time, and so does this: it is a variable there.
        let period_s = core::hint::black_box(500.0 / 1_000_000.0);
        let error = f64::from(target.wrapping_sub(position));
        let rate = (error - self.previous_error) / period_s;
        self.integral = (self.integral + error * period_s).clamp(0.0, 31.0);
        let u = core::hint::black_box(1.3) * error
            + core::hint::black_box(0.0015) * self.integral
            + core::hint::black_box(0.000_04) * rate;
        self.previous_error = error;
        ((31.0 - u.abs()).max(0.0) as i32, u > 0.0)
    }
}

/// Encodes one telemetry block.
#[inline(never)]
pub fn encode<'a>(sequence: u32, message: &DeviceMessage, out: &'a mut [u8; MAX_ENCODED]) -> &'a [u8] {
    let header = Header { sequence, time_us: 3_600_000_000 + u64::from(sequence) };
    // A block that did not fit would give no bytes, which the host sees.
    frame::encode(header, message, out).unwrap_or(&[])
}

/// A block of control samples, built from what the ticks saw and decided.
pub fn control_block(first_tick: u64, state: State, ticks: &[(Inputs, Outputs)]) -> DeviceMessage {
    let sample = |&(inputs, outputs): &(Inputs, Outputs)| ControlSample::new(inputs, outputs, 3, 7);
    DeviceMessage::Control(ControlBlock {
        first_tick,
        first_us: 500 * first_tick,
        state,
        samples: ticks.iter().take(BLOCK_SAMPLES).map(sample).collect(),
    })
}

/// A full block of edges, 4 ms apart.
pub fn edges_block() -> DeviceMessage {
    let edge = |n: u32| Edge { time_us: 4_000_000 + 4_321 * n, level: n & 1 == 0, direction: Direction::Cw };
    DeviceMessage::Edges(EdgesBlock { first_edge: 1000, edges: (0..BLOCK_EDGES as u32).map(edge).collect() })
}

/// A full block of bits.
pub fn bits_block() -> DeviceMessage {
    let word = |n: u32| 0xf0f0_3c3c_u32.rotate_left(n);
    DeviceMessage::Bits(BitsBlock {
        first_sample: 32_000,
        first_us: 32_000_000,
        samples: 32 * BITS_WORDS as u16,
        words: (0..BITS_WORDS as u32).map(word).collect(),
    })
}
