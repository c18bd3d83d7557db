//! The lock-free queues between the interrupts, which produce capture data, and the transmit task, which sends them.

use heapless::spsc::{Consumer, Producer, Queue};
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

/// 128 ms of ticks.
const TICKS: usize = 256;
/// 1 s of words.
const WORDS: usize = 32;
/// 0.4 s of edges at twice the motor's top speed.
const EDGES: usize = 256;

pub(crate) type EdgeProducer<'a> = Producer<'a, Edge>;

/// Every queue; a board keeps one in static memory and splits it once.
#[derive(Debug, Default)]
pub struct Queues {
    ticks: Queue<TickRecord, TICKS>,
    words: Queue<WordRecord, WORDS>,
    edges: Queue<Edge, EDGES>,
}

/// The control interrupt's ends.
pub struct ControlEnds<'a> {
    pub(crate) ticks: Producer<'a, TickRecord>,
    pub(crate) words: Producer<'a, WordRecord>,
}

/// The transmit task's ends.
pub struct TransmitEnds<'a> {
    pub(crate) ticks: Consumer<'a, TickRecord>,
    pub(crate) words: Consumer<'a, WordRecord>,
    pub(crate) edges: Consumer<'a, Edge>,
}

impl Queues {
    /// Empty queues.
    pub const fn new() -> Self {
        Self { ticks: Queue::new(), words: Queue::new(), edges: Queue::new() }
    }

    /// The ends: for the control interrupt, the encoder interrupt and the transmit task.
    pub fn split(&mut self) -> (ControlEnds<'_>, EdgeProducer<'_>, TransmitEnds<'_>) {
        let (ticks_in, ticks) = self.ticks.split();
        let (words_in, words) = self.words.split();
        let (edges_in, edges) = self.edges.split();
        (ControlEnds { ticks: ticks_in, words: words_in }, edges_in, TransmitEnds { ticks, words, edges })
    }
}
