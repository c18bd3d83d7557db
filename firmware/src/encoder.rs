//! The encoder: an atomic count that the pin's interrupt moves and the control interrupt reads.

use crate::queues::{EdgeRecord, EncoderEnd};
use crate::shared::Shared;
use portable_atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering};
use twum_shared::Direction;
use twum_shared::encoder::{CountSign, Edge};

/// The count and what it depends on.
#[derive(Debug, Default)]
pub struct Encoder {
    count: AtomicI32,
    edges: AtomicU32,
    reversed: AtomicBool,
    unsigned: AtomicBool,
    streaming: AtomicBool,
}

impl Encoder {
    pub(crate) const fn new() -> Self {
        Self {
            count: AtomicI32::new(0),
            edges: AtomicU32::new(0),
            reversed: AtomicBool::new(false),
            unsigned: AtomicBool::new(true),
            streaming: AtomicBool::new(false),
        }
    }

    /// Position, counts. Wraps at 2^31.
    pub fn count(&self) -> i32 {
        self.count.load(Ordering::Relaxed)
    }

    /// Edges since boot. Wraps at 2^32.
    pub fn edges(&self) -> u32 {
        self.edges.load(Ordering::Relaxed)
    }

    pub(crate) fn zero(&self) {
        self.count.store(0, Ordering::Relaxed);
    }

    pub(crate) fn set_sign(&self, sign: CountSign) {
        self.reversed.store(sign == CountSign::Reversed, Ordering::Relaxed);
    }

    /// In the driver's text mode the direction pin is a UART line, so edges count without sign.
    pub(crate) fn set_unsigned(&self, unsigned: bool) {
        self.unsigned.store(unsigned, Ordering::Relaxed);
    }

    pub(crate) fn set_streaming(&self, streaming: bool) {
        self.streaming.store(streaming, Ordering::Relaxed);
    }

    fn increment(&self, direction: Direction) -> i32 {
        if self.unsigned.load(Ordering::Relaxed) {
            return 1;
        }
        let sign = if self.reversed.load(Ordering::Relaxed) { CountSign::Reversed } else { CountSign::Positive };
        sign.increment(direction)
    }
}

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
        let encoder = &self.shared.encoder;
        encoder.count.fetch_add(encoder.increment(direction), Ordering::Relaxed);
        encoder.edges.fetch_add(1, Ordering::Relaxed);
        if !encoder.streaming.load(Ordering::Relaxed) {
            return;
        }
        let record = EdgeRecord { index: self.streamed, edge: Edge { time_us, level, direction } };
        self.streamed = self.streamed.wrapping_add(1);
        if self.queue.edges.push(record).is_err() {
            self.shared.lose_edge();
        }
    }
}
