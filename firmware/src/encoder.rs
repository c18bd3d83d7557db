//! What the encoder pin's interrupt does.

use crate::queues::{EdgeRecord, EncoderEnd};
use crate::shared::Shared;
use twum_shared::Direction;
use twum_shared::encoder::Edge;

/// The body of the encoder pin's interrupt.
pub struct EncoderInterrupt<'a> {
    shared: &'a Shared,
    queue: EncoderEnd<'a>,
    streamed: u32,
}

impl<'a> EncoderInterrupt<'a> {
    /// Joins the interrupt to what it moves.
    pub const fn new(shared: &'a Shared, queue: EncoderEnd<'a>) -> Self {
        Self { shared, queue, streamed: 0 }
    }

    /// One edge: the level after it, the direction pin, and the device clock's low 32 bits in µs. Bounded, and the whole
    /// of the interrupt's work.
    #[inline]
    pub fn edge(&mut self, level: bool, direction: Direction, time_us: u32) {
        if !self.shared.encoder.pass(direction, time_us) {
            return;
        }
        let record = EdgeRecord { index: self.streamed, edge: Edge { time_us, level, direction } };
        self.streamed = self.streamed.wrapping_add(1);
        if self.queue.edges.push(record).is_err() {
            self.shared.lose_edge();
        }
    }
}
