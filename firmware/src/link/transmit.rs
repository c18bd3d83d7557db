use crate::queues::{EdgeRecord, TickRecord, TransmitEnds, WordRecord};
use crate::shared::{Event, Shared};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::Write;
use heapless::{String, Vec};
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{
    BLOCK_EDGES, BLOCK_SAMPLES, BitsBlock, ControlBlock, DeviceMessage, EdgesBlock, Identity, Losses, ResetCause,
};

/// The queues are looked at this often.
const TURN_MS: u64 = 2;
/// A block that is not full goes out after this many turns: no sample waits longer than a person notices.
const PATIENCE_TURNS: u8 = 50;
/// Words in a block before it goes out.
const WORDS_PER_BLOCK: usize = 8;
/// Blocks of capture data in a turn: 20 ms of a full line, so that what is said first waits no longer than that and the
/// watchdog sees the task advance, whatever the streams bring. What does not fit is lost where it is queued, and counted.
const BLOCKS_PER_TURN: usize = 3;
/// Events in a turn: as many as there may be at once.
const EVENTS_PER_TURN: usize = 24;

/// What the board is, for the answer to a hello.
#[derive(Clone, Debug)]
pub struct About {
    /// Firmware version.
    pub firmware: String<24>,
    /// Chip name, or `simulated`.
    pub chip: String<48>,
    /// Why the board last started.
    pub reset: ResetCause,
}

/// Sends everything the board has to say, for ever. The only owner of the link's transmission.
pub async fn transmit<W: Write>(shared: &Shared, queues: TransmitEnds<'_>, about: About, port: W) {
    let mut transmitter = Transmitter { shared, port, sequence: 0 };
    // Ends whatever a boot loader wrote, so that our first frame stands alone.
    let _ = transmitter.port.write_all(&[0]).await;
    let mut collector = Collector::new(queues);
    let (mut lost_seen, mut lost_told) = (Losses::default(), Losses::default());
    loop {
        if let Some(of) = shared.take_stopped() {
            transmitter.send(DeviceMessage::Ack { of }).await;
        }
        for _ in 0..EVENTS_PER_TURN {
            let Some(event) = shared.events.pull() else { break };
            let message = describe(event, &about);
            transmitter.send(message).await;
        }
        let lost = shared.losses();
        if lost != lost_seen {
            // What was lost never became a frame; the gap in the sequence says so all the same.
            transmitter.sequence = transmitter.sequence.wrapping_add(1);
            lost_seen = lost;
        }
        if let Some(status) = shared.status.try_take() {
            transmitter.send(DeviceMessage::Status(status)).await;
            if lost != lost_told {
                transmitter.send(DeviceMessage::Losses(lost)).await;
                lost_told = lost;
            }
        }
        collector.wait_a_turn();
        for _ in 0..BLOCKS_PER_TURN {
            let Some(message) = collector.next_block() else { break };
            transmitter.send(message).await;
        }
        shared.transmit_turned();
        Timer::after(Duration::from_millis(TURN_MS)).await;
    }
}

fn describe(event: Event, about: &About) -> DeviceMessage {
    match event {
        Event::Hello(mode, fault) => DeviceMessage::Hello(Identity {
            firmware: about.firmware.clone(),
            chip: about.chip.clone(),
            reset: about.reset,
            mode,
            fault,
        }),
        Event::Ack(of) => DeviceMessage::Ack { of },
        Event::Nack(of, reason) => DeviceMessage::Nack { of, reason },
        Event::Configured(configuration) => DeviceMessage::Configured(configuration),
        Event::Aligned => DeviceMessage::Aligned,
        Event::RunStarted(start_us) => DeviceMessage::RunStarted { start_us },
        Event::RunEnded(end, end_us) => DeviceMessage::RunEnded { end, end_us },
        Event::Fault(report) => DeviceMessage::Fault(report),
        Event::DriverReply(bytes) => DeviceMessage::DriverReply(bytes),
        Event::DriverDone => DeviceMessage::DriverDone,
        Event::Log(line) => DeviceMessage::Log(line),
        Event::Pass(pass) => DeviceMessage::Pass(pass),
    }
}

struct Transmitter<'a, W> {
    shared: &'a Shared,
    port: W,
    sequence: u32,
}

impl<W: Write> Transmitter<'_, W> {
    async fn send(&mut self, message: DeviceMessage) {
        let header = Header { sequence: self.sequence, time_us: Instant::now().as_micros() };
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0u8; MAX_ENCODED];
        let sent = match frame::encode(header, &message, &mut buffer) {
            Ok(bytes) => self.port.write_all(bytes).await.is_ok(),
            Err(frame::TooLong) => false,
        };
        if !sent {
            self.shared.lose_other();
        }
    }
}

/// Ticks, words, edges.
const STREAMS: usize = 3;

/// Makes blocks of what the interrupts queue.
struct Collector<'a> {
    queues: TransmitEnds<'a>,
    pending: Option<TickRecord>,
    /// Index of the edge after the last that was taken.
    next_edge: u64,
    /// Turns for which ticks, words and edges may still wait for their block to fill.
    patience: [u8; STREAMS],
    /// The stream whose turn it is.
    turn: usize,
}

impl<'a> Collector<'a> {
    const fn new(queues: TransmitEnds<'a>) -> Self {
        Self { queues, pending: None, next_edge: 0, patience: [PATIENCE_TURNS; STREAMS], turn: 0 }
    }

    fn wait_a_turn(&mut self) {
        self.patience = self.patience.map(|turns| turns.saturating_sub(1));
    }

    /// The next block that is full or has waited long enough. The streams take turns, so that none starves another.
    fn next_block(&mut self) -> Option<DeviceMessage> {
        for _ in 0..STREAMS {
            let stream = self.turn;
            self.turn = (self.turn + 1) % STREAMS;
            let block = match stream {
                0 if self.is_due(0, self.queues.ticks.len(), BLOCK_SAMPLES) => {
                    self.control_block().map(DeviceMessage::Control)
                }
                1 if self.is_due(1, self.queues.words.len(), WORDS_PER_BLOCK) => {
                    self.bits_block().map(DeviceMessage::Bits)
                }
                2 if self.is_due(2, self.queues.edges.len(), BLOCK_EDGES) => {
                    self.edges_block().map(DeviceMessage::Edges)
                }
                _ => None,
            };
            if block.is_some() {
                return block;
            }
        }
        None
    }

    /// Whether a stream's block goes out now; if so, the next one may wait anew.
    fn is_due(&mut self, stream: usize, waiting: usize, full: usize) -> bool {
        let Some(patience) = self.patience.get_mut(stream) else { return false };
        let due = *patience == 0 || waiting >= full;
        if due {
            *patience = PATIENCE_TURNS;
        }
        due
    }

    fn control_block(&mut self) -> Option<ControlBlock> {
        let first = self.pending.take().or_else(|| self.queues.ticks.pull())?;
        let mut samples = Vec::new();
        let _ = samples.push(first.sample);
        let mut tick = first.tick;
        while samples.len() < BLOCK_SAMPLES {
            let Some(record) = self.queues.ticks.pull() else { break };
            if record.tick != tick + 1 {
                // A block holds consecutive ticks: what follows a gap, or starts a run, opens the next one.
                self.pending = Some(record);
                break;
            }
            tick = record.tick;
            let _ = samples.push(record.sample);
        }
        Some(ControlBlock { first_tick: first.tick, first_us: first.due_us, state: first.state, samples })
    }

    fn bits_block(&mut self) -> Option<BitsBlock> {
        let WordRecord { first_sample, first_us, samples, word } = self.queues.words.pull()?;
        let mut block = BitsBlock { first_sample, first_us, samples: u16::from(samples), words: Vec::new() };
        let _ = block.words.push(word);
        while block.words.len() < WORDS_PER_BLOCK && block.samples.is_multiple_of(32) {
            let follows = |record: &WordRecord| record.first_sample == first_sample + u64::from(block.samples);
            if !self.queues.words.peek().as_ref().is_some_and(follows) {
                break;
            }
            let Some(record) = self.queues.words.pull() else { break };
            block.samples += u16::from(record.samples);
            let _ = block.words.push(record.word);
        }
        Some(block)
    }

    fn edges_block(&mut self) -> Option<EdgesBlock> {
        let EdgeRecord { index, edge } = self.queues.edges.pull()?;
        let first_edge = self.next_edge.wrapping_add(u64::from(index.wrapping_sub(self.next_edge as u32)));
        let mut edges = Vec::new();
        let _ = edges.push(edge);
        while !edges.is_full() {
            // A block holds consecutive edges: what follows a loss opens the next one.
            let next = first_edge.wrapping_add(edges.len() as u64) as u32;
            if self.queues.edges.peek().is_none_or(|record| record.index != next) {
                break;
            }
            let Some(EdgeRecord { edge, .. }) = self.queues.edges.pull() else { break };
            let _ = edges.push(edge);
        }
        self.next_edge = first_edge.wrapping_add(edges.len() as u64);
        Some(EdgesBlock { first_edge, edges })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::encoder::EncoderInterrupt;
    use crate::queues::Queues;
    use twum_shared::Direction;

    /// Index and time of every edge the host is told of.
    fn told(collector: &mut Collector<'_>) -> std::vec::Vec<(u64, u32)> {
        let mut told = std::vec::Vec::new();
        while let Some(EdgesBlock { first_edge, edges }) = collector.edges_block() {
            told.extend((first_edge..).zip(edges.iter().map(|edge| edge.time_us)));
        }
        told
    }

    #[test]
    fn a_lost_edge_shows_where_it_was_lost() {
        let (shared, mut queues) = (Shared::new(), Queues::new());
        let (_, end, ends) = queues.split();
        let (mut interrupt, mut collector) = (EncoderInterrupt::new(&shared, end), Collector::new(ends));
        shared.encoder.set_streaming(true);
        // An edge's time is its index, so a wrong index shows.
        for index in 0..300 {
            interrupt.edge(index % 2 == 0, Direction::Cw, index);
        }
        let first: std::vec::Vec<(u64, u32)> = told(&mut collector);
        for index in 300..310 {
            interrupt.edge(index % 2 == 0, Direction::Cw, index);
        }
        let then = told(&mut collector);
        assert_eq!((first.len(), then.len(), shared.lost_edges()), (256, 10, 44));
        for (index, time_us) in first.into_iter().chain(then) {
            assert_eq!(index, u64::from(time_us));
        }
    }

    #[test]
    fn the_index_goes_on_beyond_32_bits() {
        let (shared, mut queues) = (Shared::new(), Queues::new());
        let (_, _, ends) = queues.split();
        let mut collector = Collector::new(ends);
        collector.next_edge = u64::from(u32::MAX) - 1;
        let edge = twum_shared::encoder::Edge { time_us: 0, level: true, direction: Direction::Cw };
        for index in [u32::MAX - 1, u32::MAX, 0, 2] {
            assert!(collector.queues.edges.push(EdgeRecord { index, edge }).is_ok());
        }
        let blocks: std::vec::Vec<(u64, usize)> = core::iter::from_fn(|| collector.edges_block())
            .map(|block| (block.first_edge, block.edges.len()))
            .collect();
        assert_eq!(blocks, [(u64::from(u32::MAX) - 1, 3), ((1 << 32) + 2, 1)]);
        assert_eq!(shared.lost_edges(), 0);
    }
}
