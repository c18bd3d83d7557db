use crate::queues::{TickRecord, TransmitEnds, WordRecord};
use crate::shared::{Event, Shared};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::Write;
use heapless::{String, Vec};
use twum_shared::encoder::Edge;
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{
    BLOCK_EDGES, BLOCK_SAMPLES, BitsBlock, ControlBlock, DeviceMessage, EdgesBlock, Identity, ResetCause,
};

/// The queues are looked at this often.
const TURN_MS: u64 = 2;
/// A block that is not full goes out after this many turns: no sample waits longer than a person notices.
const PATIENCE_TURNS: u8 = 50;
/// Words in a block before it goes out.
const WORDS_PER_BLOCK: usize = 8;

/// What the board is, for the answer to a hello.
#[derive(Clone, Debug)]
pub struct About {
    /// Firmware version.
    pub firmware: String<24>,
    /// Chip name, or `simulated`.
    pub chip: String<16>,
    /// Why the board last started.
    pub reset: ResetCause,
}

/// Sends everything the board has to say, for ever. The only owner of the link's transmission.
pub async fn transmit<W: Write>(shared: &Shared, queues: TransmitEnds<'_>, about: About, port: W) {
    let mut transmitter = Transmitter { shared, port, sequence: 0 };
    // Ends whatever a boot loader wrote, so that our first frame stands alone.
    let _ = transmitter.port.write_all(&[0]).await;
    let mut collector = Collector { queues, pending: None, edges_sent: 0, patience: [PATIENCE_TURNS; 3] };
    let mut lost_seen = 0;
    loop {
        while let Some(event) = shared.events.pull() {
            let message = describe(event, &about);
            transmitter.send(message).await;
        }
        let lost = shared.lost_items();
        if lost != lost_seen {
            // What was lost never became a frame; the gap in the sequence says so all the same.
            transmitter.sequence = transmitter.sequence.wrapping_add(1);
            lost_seen = lost;
        }
        collector.wait_a_turn();
        while let Some(message) = collector.next_block(shared) {
            transmitter.send(message).await;
        }
        if let Some(status) = shared.status.try_take() {
            transmitter.send(DeviceMessage::Status(status)).await;
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
            self.shared.lose_sample();
        }
    }
}

/// Makes blocks of what the interrupts queue.
struct Collector<'a> {
    queues: TransmitEnds<'a>,
    pending: Option<TickRecord>,
    edges_sent: u64,
    /// Turns for which ticks, words and edges may still wait for their block to fill.
    patience: [u8; 3],
}

impl Collector<'_> {
    fn wait_a_turn(&mut self) {
        self.patience = self.patience.map(|turns| turns.saturating_sub(1));
    }

    /// The next block that is full or has waited long enough.
    fn next_block(&mut self, shared: &Shared) -> Option<DeviceMessage> {
        let [ticks, words, edges] = self.patience.map(|turns| turns == 0);
        if ticks || self.queues.ticks.len() >= BLOCK_SAMPLES {
            self.patience[0] = PATIENCE_TURNS;
            if let Some(block) = self.control_block() {
                return Some(DeviceMessage::Control(block));
            }
        }
        if words || self.queues.words.len() >= WORDS_PER_BLOCK {
            self.patience[1] = PATIENCE_TURNS;
            if let Some(block) = self.bits_block() {
                return Some(DeviceMessage::Bits(block));
            }
        }
        if edges || self.queues.edges.len() >= BLOCK_EDGES {
            self.patience[2] = PATIENCE_TURNS;
            if let Some(block) = self.edges_block(shared) {
                return Some(DeviceMessage::Edges(block));
            }
        }
        None
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

    fn edges_block(&mut self, shared: &Shared) -> Option<EdgesBlock> {
        let first = self.queues.edges.pull()?;
        let mut edges: Vec<Edge, BLOCK_EDGES> = Vec::new();
        let _ = edges.push(first);
        while !edges.is_full() {
            let Some(edge) = self.queues.edges.pull() else { break };
            let _ = edges.push(edge);
        }
        let first_edge = self.edges_sent.wrapping_add(u64::from(shared.lost_edges()));
        self.edges_sent = self.edges_sent.wrapping_add(edges.len() as u64);
        Some(EdgesBlock { first_edge, edges })
    }
}
