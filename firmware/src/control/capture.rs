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
/// Shortest period at which every tick fits the link: a tick takes 18 bytes, 20 with its share of a block's head, of the 92 160
/// a second of 921 600 baud, a fifth of which is left to the other streams.
const SHORTEST_WHOLE_US: u32 = 272;
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
pub(super) struct Bits {
    packer: BitPacker,
    samples: u64,
    word_us: u64,
    next_us: u64,
}

impl<S: OutputStage> Control<'_, S> {
    /// Queues a tick for the host, if its block is one of those that the link carries.
    pub(super) fn capture_tick(&mut self, tick: u64, due_us: u64, late_us: u64, (inputs, state, outputs): Step) {
        if !self.capture.control || (self.every_block > 1 && !is_carried(tick, self.every_block)) {
            return;
        }
        let record = TickRecord { tick, due_us, state, sample: self.sample(inputs, outputs, late_us) };
        let lost = self.queues.ticks.push(record).is_err();
        if lost {
            self.shared.lose_tick();
        }
        self.count_loss(lost);
    }

    fn sample(&self, inputs: Inputs, outputs: Outputs, late_us: u64) -> ControlSample {
        ControlSample {
            target: inputs.target,
            target_rate: inputs.target_rate,
            position: inputs.position,
            u: outputs.u,
            on_steps: outputs.on_steps,
            direction: outputs.direction,
            late_us: late_us.min(u64::from(u16::MAX)) as u16,
            duration_us: self.previous_duration_us,
        }
    }

    fn count_loss(&mut self, lost: bool) {
        if lost {
            self.lost_in_a_row = self.lost_in_a_row.saturating_add(1);
        } else {
            self.lost_in_a_row = 0;
        }
    }

    pub(super) fn set_capture(&mut self, mode: CaptureMode, now_us: u64) {
        if mode.bits && !self.capture.bits {
            self.bits = Bits { next_us: now_us, ..Bits::default() };
        }
        if self.capture.bits && !mode.bits {
            self.flush_bits();
        }
        self.shared.encoder.set_streaming(mode.edges);
        self.capture = mode;
        if let Some(configured) = &self.configured {
            self.shared.tell(Event::Configured(configured.message));
            self.every_block = if mode.control { blocks_that_fit(configured.message.control.period_us) } else { 1 };
            if self.every_block > 1 {
                self.shared.log(THINNED);
            }
        }
    }

    pub(super) fn capture_bit(&mut self, due_us: u64, level: bool) {
        if !self.capture.bits || due_us < self.bits.next_us {
            return;
        }
        if self.bits.samples.is_multiple_of(32) {
            self.bits.word_us = due_us;
        }
        self.bits.next_us += BIT_PERIOD_US;
        self.bits.samples += 1;
        if let Some(word) = self.bits.packer.push(level) {
            self.send_word(word, 32);
        }
    }

    fn flush_bits(&mut self) {
        if let Some((word, samples)) = self.bits.packer.flush() {
            self.send_word(word, samples);
        }
    }

    fn send_word(&mut self, word: u32, samples: u8) {
        let first_sample = self.bits.samples - u64::from(samples);
        let record = WordRecord { first_sample, first_us: self.bits.word_us, samples, word };
        let lost = self.queues.words.push(record).is_err();
        if lost {
            self.shared.lose_word();
        }
        self.count_loss(lost);
    }
}
