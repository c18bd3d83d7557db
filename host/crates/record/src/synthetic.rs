//! Recordings for tests and examples, made frame by frame: what a board would have sent, with losses where a test wants
//! them. Everything here panics where a file cannot be written.

use super::store::{Metadata, Sender, Writer};
use std::path::Path;
use twum_shared::Direction;
use twum_shared::encoder::Edge;
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{
    BLOCK_SAMPLES, BitsBlock, Configuration, ControlBlock, ControlSample, DeviceMessage, EdgesBlock, HostMessage,
};
use twum_shared::step::{Config, ConfigSpec, Inputs, State, step};

/// A recording that is written frame by frame.
#[derive(Debug)]
pub struct Line {
    writer: Writer,
    sequence: u32,
    /// Device time of the next frame.
    pub now_us: u64,
}

impl Line {
    /// A recording of a simulated board at `path`.
    pub fn new(path: &Path) -> Self {
        Self { writer: Writer::create(path, &Metadata::simulated()).unwrap(), sequence: 0, now_us: 0 }
    }

    /// Frames arrive 300 µs after they were sent.
    pub fn device(&mut self, message: DeviceMessage) {
        let bytes = self.encode(&message);
        self.writer.frame(Sender::Device, (self.now_us + 300) * 1000, &bytes).unwrap();
    }

    /// A frame that the board sent and the line lost.
    pub fn lost(&mut self, message: DeviceMessage) {
        self.encode(&message);
    }

    /// A frame with a byte flipped.
    pub fn broken(&mut self, message: DeviceMessage) {
        let mut bytes = self.encode(&message);
        bytes[3] ^= 0x40;
        self.writer.frame(Sender::Device, (self.now_us + 300) * 1000, &bytes).unwrap();
    }

    /// A frame of the host.
    pub fn host(&mut self, message: HostMessage) {
        let mut out = [0; MAX_ENCODED];
        let bytes = frame::encode(Header { sequence: 1, time_us: 0 }, &message, &mut out).unwrap();
        self.writer.frame(Sender::Host, self.now_us * 1000, bytes).unwrap();
    }

    /// The board starts anew: clock and sequence with it.
    pub fn restart(&mut self) {
        (self.sequence, self.now_us) = (0, 0);
    }

    /// Ends the recording.
    pub fn finish(self) {
        self.writer.finish().unwrap();
    }

    fn encode(&mut self, message: &DeviceMessage) -> Vec<u8> {
        let mut out = [0; MAX_ENCODED];
        let header = Header { sequence: self.sequence, time_us: self.now_us };
        self.sequence += 1;
        frame::encode(header, message, &mut out).unwrap().to_vec()
    }
}

/// Blocks of control ticks from a run that starts at `start_us`: a rotor that follows the drive a count at a time.
pub fn control_blocks(spec: ConfigSpec, start_us: u64, blocks: u64) -> Vec<ControlBlock> {
    let config = Config::try_from(spec).unwrap();
    let (mut state, mut position) = (State::REST, 0);
    (0..blocks)
        .map(|block| {
            let first_tick = block * BLOCK_SAMPLES as u64;
            let first_us = start_us + first_tick * u64::from(spec.period_us);
            let mut message = ControlBlock { first_tick, first_us, state, samples: Default::default() };
            for tick in first_tick..first_tick + BLOCK_SAMPLES as u64 {
                let phase = 0.002 * tick as f64;
                let inputs = Inputs {
                    target: (60.0 * phase.sin()) as i32,
                    target_rate: (240.0 * phase.cos()) as i32,
                    position,
                    ..Inputs::default()
                };
                let out = step(&config, &mut state, inputs);
                if out.on_steps > 1 && tick % 3 == 0 {
                    position += out.direction.sign();
                }
                message.samples.push(ControlSample::new(inputs, out, 2, 7)).unwrap();
            }
            message
        })
        .collect()
}

/// What a board says of its configuration.
pub fn configured(spec: ConfigSpec) -> DeviceMessage {
    DeviceMessage::Configured(Configuration::with_control(spec))
}

/// Levels of a rotor that passes an edge every 7 ms.
pub fn bits_block(first_sample: u64, first_us: u64, words: usize) -> BitsBlock {
    let level = |sample: u64| (sample / 7) % 2 == 1;
    let word = |index: usize| {
        (0..32).fold(0, |word, bit| (word << 1) | u32::from(level(first_sample + 32 * index as u64 + bit)))
    };
    BitsBlock { first_sample, first_us, samples: 32 * words as u16, words: (0..words).map(word).collect() }
}

/// Edges every 7 ms from `first_us` on.
pub fn edges_block(first_edge: u64, first_us: u64, count: u64) -> EdgesBlock {
    let edge = |index: u64| Edge {
        time_us: (first_us + 7000 * index) as u32,
        level: (first_edge + index).is_multiple_of(2),
        direction: Direction::Cw,
    };
    EdgesBlock { first_edge, edges: (0..count).map(edge).collect() }
}
