//! The encoder's count: atomic, moved by the pin's interrupt and read by the control interrupt.

use portable_atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering};
use twum_shared::Direction;
use twum_shared::encoder::CountSign;

/// The count and what it depends on.
#[derive(Debug, Default)]
pub struct Encoder {
    count: AtomicI32,
    edges: AtomicU32,
    edge_us: AtomicU32,
    reversed: AtomicBool,
    unsigned: AtomicBool,
    streaming: AtomicBool,
}

impl Encoder {
    pub(crate) const fn new() -> Self {
        Self {
            count: AtomicI32::new(0),
            edges: AtomicU32::new(0),
            edge_us: AtomicU32::new(0),
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

    /// How long before `now_us` the last edge came, µs; at its limit for one that is older. Read after the count: an edge that
    /// comes between the two is then one of the next tick, with its own time.
    pub(crate) fn edge_age_us(&self, now_us: u64) -> u16 {
        let age_us = (now_us as u32).wrapping_sub(self.edge_us.load(Ordering::Relaxed)) as i32;
        if age_us < 0 { 0 } else { age_us.min(i32::from(u16::MAX)) as u16 }
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

    /// Counts an edge at `time_us` (the device clock's low 32 bits); whether edges are streamed.
    #[inline]
    pub(crate) fn pass(&self, direction: Direction, time_us: u32) -> bool {
        self.edge_us.store(time_us, Ordering::Relaxed);
        self.count.fetch_add(self.increment(direction), Ordering::Relaxed);
        self.edges.fetch_add(1, Ordering::Relaxed);
        self.streaming.load(Ordering::Relaxed)
    }

    fn increment(&self, direction: Direction) -> i32 {
        if self.unsigned.load(Ordering::Relaxed) {
            return 1;
        }
        let sign = if self.reversed.load(Ordering::Relaxed) { CountSign::Reversed } else { CountSign::Positive };
        sign.increment(direction)
    }
}
