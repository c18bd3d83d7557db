//! What the control interrupt captures for the host: the encoder level at 1 kHz, and its own ticks.

use super::Control;
use crate::output::OutputStage;
use crate::queues::{TickRecord, WordRecord};
use crate::shared::Event;
use twum_shared::bits::BitPacker;
use twum_shared::message::{BLOCK_SAMPLES, CaptureMode, ControlSample};
use twum_shared::step::{Inputs, Outputs, State};

/// 1 kHz: the bit capture takes a sample when this much time has passed since the one before.
const BIT_PERIOD_US: u64 = 1_000;
/// What a tick saw, the controller's state before it, and what it decided.
pub(super) type Step = (Inputs, State, Outputs);
/// Shortest period at which every tick fits the link: a tick takes 22 bytes, 26 with its share of a block's head, of the 92 160
/// a second of 921 600 baud, a fifth of which is left to the other streams.
const SHORTEST_WHOLE_US: u32 = 353;
const THINNED: &str = "the link cannot carry every control tick at this period: whole blocks of 16 are left out";

/// One block of so many is sent.
const fn blocks_that_fit(period_us: u32) -> u32 {
    if period_us == 0 { 1 } else { SHORTEST_WHOLE_US.div_ceil(period_us) }
}

/// Whether a tick's block is one of those. A run is shorter than 2^32 ticks, and 32 bits divide in one instruction.
const fn is_carried(tick: u64, every_block: u32) -> bool {
    (tick as u32 / BLOCK_SAMPLES as u32).is_multiple_of(every_block)
}

/// A timed bit capture.
#[derive(Debug, Default)]
struct Bits {
    packer: BitPacker,
    samples: u64,
    word_us: u64,
    next_us: u64,
}

/// The streams that are captured.
#[derive(Debug)]
pub(super) struct Capture {
    mode: CaptureMode,
    bits: Bits,
    /// Of so many blocks of ticks, one is captured.
    every_block: u32,
}

impl Default for Capture {
    fn default() -> Self {
        Self { mode: CaptureMode::default(), bits: Bits::default(), every_block: 1 }
    }
}

impl<S: OutputStage> Control<'_, S> {
    /// Queues a tick for the host, if its block is one of those that the link carries.
    pub(super) fn capture_tick(&mut self, tick: u64, due_us: u64, late_us: u64, (inputs, state, outputs): Step) {
        let Capture { mode, every_block, .. } = self.capture;
        if !mode.control || (every_block > 1 && !is_carried(tick, every_block)) {
            return;
        }
        let late_us = late_us.min(u64::from(u16::MAX)) as u16;
        let sample = ControlSample::new(inputs, outputs, late_us, self.timing.previous_duration_us);
        let record = TickRecord { tick, due_us, state, sample };
        let lost = self.queues.ticks.push(record).is_err();
        if lost {
            self.shared.lose_tick();
        }
        self.lost.count(lost);
    }

    pub(super) fn set_capture(&mut self, mode: CaptureMode, now_us: u64) {
        if mode.bits && !self.capture.mode.bits {
            self.capture.bits = Bits { next_us: now_us, ..Bits::default() };
        }
        if self.capture.mode.bits && !mode.bits {
            self.flush_bits();
        }
        self.shared.encoder.set_streaming(mode.edges);
        self.capture.mode = mode;
        if let Some(configured) = &self.configured {
            self.shared.tell(Event::Configured(configured.message));
            let period_us = configured.message.control.period_us;
            self.capture.every_block = if mode.control { blocks_that_fit(period_us) } else { 1 };
            if self.capture.every_block > 1 {
                self.shared.log(THINNED);
            }
        }
    }

    pub(super) fn capture_bit(&mut self, due_us: u64, level: bool) {
        let Capture { mode, bits, .. } = &mut self.capture;
        if !mode.bits || due_us < bits.next_us {
            return;
        }
        if bits.samples.is_multiple_of(32) {
            bits.word_us = due_us;
        }
        bits.next_us += BIT_PERIOD_US;
        bits.samples += 1;
        if let Some(word) = bits.packer.push(level) {
            self.send_word(word, 32);
        }
    }

    fn flush_bits(&mut self) {
        if let Some((word, samples)) = self.capture.bits.packer.flush() {
            self.send_word(word, samples);
        }
    }

    fn send_word(&mut self, word: u32, samples: u8) {
        let first_sample = self.capture.bits.samples - u64::from(samples);
        let record = WordRecord { first_sample, first_us: self.capture.bits.word_us, samples, word };
        let lost = self.queues.words.push(record).is_err();
        if lost {
            self.shared.lose_word();
        }
        self.lost.count(lost);
    }
}
