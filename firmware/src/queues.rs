//! The queues between the interrupts, which produce capture data, and the transmit task, which sends them.

use crate::mailbox::Mailbox;
use twum_shared::encoder::Edge;
use twum_shared::message::ControlSample;
use twum_shared::step::State;

/// One control tick on its way to the host.
#[derive(Clone, Copy, Debug)]
pub struct TickRecord {
    /// Index since the run started.
    pub tick: u64,
    /// Device time at which the tick was due, µs.
    pub due_us: u64,
    /// The controller's state before the tick.
    pub state: State,
    /// What the tick saw and decided.
    pub sample: ControlSample,
}

/// A word of 1 kHz samples on its way to the host.
#[derive(Clone, Copy, Debug)]
pub struct WordRecord {
    /// Index of its first sample since the stream was switched on.
    pub first_sample: u64,
    /// Device time of its first sample, µs.
    pub first_us: u64,
    /// Samples in it, at the top.
    pub samples: u8,
    /// The samples, the oldest in the most significant bit.
    pub word: u32,
}

/// An edge on its way to the host.
#[derive(Clone, Copy, Debug)]
pub struct EdgeRecord {
    /// Index among the edges streamed since boot, those that found the queue full included (the low 32 bits).
    pub index: u32,
    /// The edge.
    pub edge: Edge,
}

/// 128 ms of ticks.
const TICKS: usize = 256;
/// 1 s of words.
const WORDS: usize = 32;
/// 0.4 s of edges at twice the motor's top speed.
const EDGES: usize = 256;

/// Every queue; a board keeps one in static memory and splits it once.
#[derive(Default)]
pub struct Queues {
    ticks: Mailbox<TickRecord, TICKS>,
    words: Mailbox<WordRecord, WORDS>,
    edges: Mailbox<EdgeRecord, EDGES>,
}

/// The control interrupt's ends.
pub struct ControlEnds<'a> {
    pub(crate) ticks: &'a Mailbox<TickRecord, TICKS>,
    pub(crate) words: &'a Mailbox<WordRecord, WORDS>,
}

/// The encoder interrupt's end.
pub struct EncoderEnd<'a> {
    pub(crate) edges: &'a Mailbox<EdgeRecord, EDGES>,
}

/// The transmit task's ends.
pub struct TransmitEnds<'a> {
    pub(crate) ticks: &'a Mailbox<TickRecord, TICKS>,
    pub(crate) words: &'a Mailbox<WordRecord, WORDS>,
    pub(crate) edges: &'a Mailbox<EdgeRecord, EDGES>,
}

impl Queues {
    /// Empty queues.
    pub const fn new() -> Self {
        Self { ticks: Mailbox::new(), words: Mailbox::new(), edges: Mailbox::new() }
    }

    /// The ends: for the control interrupt, the encoder interrupt and the transmit task.
    pub fn split(&mut self) -> (ControlEnds<'_>, EncoderEnd<'_>, TransmitEnds<'_>) {
        let Self { ticks, words, edges } = self;
        (ControlEnds { ticks, words }, EncoderEnd { edges }, TransmitEnds { ticks, words, edges })
    }
}
