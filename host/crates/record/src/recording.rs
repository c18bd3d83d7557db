//! A whole recording in memory, as signals: levels, edges and control samples in segments without gaps, runs, and events.

use super::decode::{Decoder, Item, LinkStatistics};
use super::store::{Integrity, Metadata, Sender, StoreError};
use std::io::{Read, Seek};
use std::path::Path;
use twum_shared::bits;
use twum_shared::frame::Header;
use twum_shared::message::{
    BitsBlock, Configuration, ControlBlock, ControlSample, DeviceMessage, EdgesBlock, FaultReport, HostMessage,
    Identity, RunEnd, SpeedRun, Status, TrackRun,
};
use twum_shared::{Direction, encoder};

/// A recording, decoded. Times in µs are the board's clock within its session.
#[derive(Debug)]
pub struct Recording {
    /// What the recording says about itself.
    pub metadata: Metadata,
    /// The state of its file.
    pub integrity: Integrity,
    /// What the line did.
    pub link: LinkStatistics,
    /// The board's starts.
    pub sessions: Vec<Session>,
    /// The encoder line at 1 kHz.
    pub bits: Vec<BitsSegment>,
    /// The encoder's edges.
    pub edges: Vec<EdgesSegment>,
    /// The control loop.
    pub control: Vec<ControlSegment>,
    /// The runs, in order.
    pub runs: Vec<RecordedRun>,
    /// Ten times a second: session, device time, status.
    pub status: Vec<(u32, u64, Status)>,
    /// Everything else, in order.
    pub events: Vec<Event>,
}

/// What is known of one start of the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Session {
    /// Host time less device time in ns, for the frame that took least to arrive: places the board's clock on the host's.
    pub offset_ns: i64,
    /// Device time of the last frame, µs.
    pub end_us: u64,
}

/// 1 kHz samples without a gap.
#[derive(Debug, Clone, PartialEq)]
pub struct BitsSegment {
    /// The board's start.
    pub session: u32,
    /// Index of the first sample in its stream.
    pub first_sample: u64,
    /// Time of the first sample.
    pub first_us: u64,
    /// One level a millisecond.
    pub levels: Vec<bool>,
}

/// Edges without a gap.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgesSegment {
    /// The board's start.
    pub session: u32,
    /// Index of the first edge in its stream.
    pub first_edge: u64,
    /// The edges.
    pub edges: Vec<TimedEdge>,
}

/// An edge on the board's 64-bit clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimedEdge {
    /// When it was seen.
    pub time_us: u64,
    /// The level after it.
    pub level: bool,
    /// The direction pin then.
    pub direction: Direction,
}

/// Consecutive control ticks.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlSegment {
    /// The board's start.
    pub session: u32,
    /// Index of the first tick in its run.
    pub first_tick: u64,
    /// When the first tick was due.
    pub first_us: u64,
    /// Control period in µs.
    pub period_us: u32,
    /// Duty steps in a PWM period.
    pub duty_steps: u16,
    /// One sample a tick.
    pub samples: Vec<ControlSample>,
}

impl ControlSegment {
    /// When the tick at `index` of the segment was due, µs.
    pub fn time_us(&self, index: usize) -> u64 {
        self.first_us.saturating_add((index as u64).saturating_mul(self.period_us.into()))
    }
}

/// What a run was asked to do.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Open loop.
    Speed(SpeedRun),
    /// Closed loop.
    Track(TrackRun),
    /// The recording does not hold the command.
    Unknown,
}

/// One run.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRun {
    /// The board's start.
    pub session: u32,
    /// t = 0 of the run.
    pub start_us: u64,
    /// How and when it ended; `None` when the recording ends first.
    pub end: Option<(RunEnd, u64)>,
    /// The last command before it.
    pub command: Command,
    /// The configuration in force.
    pub configuration: Option<Configuration>,
    /// Whether the motor stood where alignment had left it.
    pub aligned: bool,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// The board's start.
    pub session: u32,
    /// Device time of the frame it came in; of the frame before, for the host's doings.
    pub time_us: u64,
    /// Host time in ns from the start of the recording.
    pub host_time_ns: u64,
    /// What happened.
    pub kind: EventKind,
}

/// What happened.
#[derive(Debug, Clone, PartialEq)]
pub enum EventKind {
    /// The board said who it is.
    Hello(Identity),
    /// A configuration came into force.
    Configured(Configuration),
    /// The motor was aligned.
    Aligned,
    /// A run began.
    RunStarted,
    /// A run ended.
    RunEnded(RunEnd),
    /// A fault latched.
    Fault(FaultReport),
    /// A line of the board for people.
    Log(String),
    /// A command of the host (keep-alives left out).
    Command(String),
    /// A command was refused.
    Refused(String),
    /// A remark of the recorder, as JSON.
    Remark(String),
    /// A frame arrived broken.
    Broken(Sender, String),
}

impl EventKind {
    /// A short name of the kind, and what there is to read about it.
    pub fn describe(&self) -> (&'static str, String) {
        match self {
            Self::Hello(identity) => {
                ("hello", format!("{} on {}, reset: {:?}", identity.firmware, identity.chip, identity.reset))
            }
            Self::Configured(configuration) => {
                ("configured", serde_json::to_string(configuration).unwrap_or_else(|_| format!("{configuration:?}")))
            }
            Self::Aligned => ("aligned", String::new()),
            Self::RunStarted => ("run-started", String::new()),
            Self::RunEnded(end) => ("run-ended", format!("{end:?}")),
            Self::Fault(report) => {
                ("fault", format!("{:?}: {} (off at {} us)", report.fault, report.fault, report.off_us))
            }
            Self::Log(line) => ("log", line.clone()),
            Self::Command(command) => ("command", command.clone()),
            Self::Refused(reason) => ("refused", reason.clone()),
            Self::Remark(json) => ("recorder", json.clone()),
            Self::Broken(sender, error) => ("broken", format!("{sender:?}: {error}")),
        }
    }
}

impl Recording {
    /// What the file or the line lost, one sentence each; empty when nothing is missing.
    pub fn losses(&self) -> Vec<String> {
        let (file, link) = (self.integrity, self.link);
        let mut losses = Vec::new();
        if file.damaged_places > 0 || file.missing_records > 0 {
            losses.push(format!(
                "the file is damaged in {} places ({} bytes skipped, {} records missing)",
                file.damaged_places, file.skipped_bytes, file.missing_records
            ));
        } else if file.checksum_mismatch {
            losses.push("the file's checksum does not match, though every record could be read".to_owned());
        }
        if link.broken_frames > 0 || link.missing_sequences > 0 {
            losses.push(format!(
                "{} frames arrived broken and {} sequence numbers are missing, in {} gaps",
                link.broken_frames, link.missing_sequences, link.gaps
            ));
        }
        if let Some(lost) = self.status.iter().map(|(_, _, status)| status.lost_items).max().filter(|lost| *lost > 0) {
            losses.push(format!("the board itself lost {lost} capture items (its queues were full)"));
        }
        losses
    }

    /// Host time of a moment of the board's clock, ns from the start of the recording.
    pub fn host_time_ns(&self, session: u32, time_us: u64) -> u64 {
        let offset_ns = self.sessions.get(session as usize).map_or(0, |session| session.offset_ns);
        (time_us.saturating_mul(1000) as i64).saturating_add(offset_ns).max(0) as u64
    }

    /// Reads a recording.
    ///
    /// # Errors
    /// As [`Decoder::open`] and [`Decoder::next_item`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::read(Decoder::open(path)?)
    }

    /// Reads a recording to its end.
    ///
    /// # Errors
    /// As [`Decoder::next_item`].
    pub fn read<S: Read + Seek>(mut decoder: Decoder<S>) -> Result<Self, StoreError> {
        let mut builder = Builder::new(decoder.metadata().clone());
        while let Some(item) = decoder.next_item()? {
            builder.add(item);
        }
        let mut recording = builder.recording;
        recording.integrity = decoder.integrity();
        recording.link = decoder.statistics();
        Ok(recording)
    }
}

/// A recording put together in memory while its messages arrive.
#[derive(Debug)]
pub struct Gathering {
    builder: Builder,
    session: u32,
    time_us: u64,
}

impl Gathering {
    /// Nothing yet, of a run that was asked for with `command`.
    pub fn new(command: Command) -> Self {
        let mut builder = Builder::new(Metadata::now());
        builder.command = command;
        Self { builder, session: 0, time_us: 0 }
    }

    /// Takes a message of the board.
    pub fn take(&mut self, header: Header, message: &DeviceMessage) {
        if header.time_us < self.time_us {
            self.session += 1;
        }
        self.time_us = header.time_us;
        let (session, host_time_ns) = (self.session, header.time_us.saturating_mul(1000));
        let command = self.builder.command.clone();
        self.builder.add(Item::Device { session, host_time_ns, header, message: message.clone() });
        // A session's first message forgets the command before it: here it was this session's.
        if session == 0 {
            self.builder.command = command;
        }
    }

    /// What was gathered.
    pub fn recording(self) -> Recording {
        self.builder.recording
    }
}

/// Puts a recording together from its items.
#[derive(Debug)]
pub(super) struct Builder {
    pub(super) recording: Recording,
    session: u32,
    time_us: u64,
    configuration: Option<Configuration>,
    command: Command,
    aligned: bool,
}

impl Builder {
    pub(super) fn new(metadata: Metadata) -> Self {
        Self {
            recording: Recording {
                metadata,
                integrity: Integrity::default(),
                link: LinkStatistics::default(),
                sessions: Vec::new(),
                bits: Vec::new(),
                edges: Vec::new(),
                control: Vec::new(),
                runs: Vec::new(),
                status: Vec::new(),
                events: Vec::new(),
            },
            session: 0,
            time_us: 0,
            configuration: None,
            command: Command::Unknown,
            aligned: false,
        }
    }

    pub(super) fn add(&mut self, item: Item) {
        match item {
            Item::Device { session, host_time_ns, header, message } => {
                let end_us = header.time_us;
                let offset_ns = (host_time_ns as i64).wrapping_sub(end_us.saturating_mul(1000) as i64);
                if session as usize == self.recording.sessions.len() {
                    self.recording.sessions.push(Session { offset_ns, end_us });
                    (self.session, self.configuration, self.aligned) = (session, None, false);
                    self.command = Command::Unknown;
                }
                if let Some(known) = self.recording.sessions.last_mut() {
                    *known = Session { offset_ns: known.offset_ns.min(offset_ns), end_us };
                }
                self.time_us = end_us;
                self.device(host_time_ns, message);
            }
            Item::Host { host_time_ns, message, .. } => self.host(host_time_ns, message),
            Item::Broken { sender, host_time_ns, error } => {
                self.event(host_time_ns, EventKind::Broken(sender, error.to_string()));
            }
            Item::Remark { host_time_ns, json } => self.event(host_time_ns, EventKind::Remark(json)),
        }
    }

    fn event(&mut self, host_time_ns: u64, kind: EventKind) {
        self.recording.events.push(Event { session: self.session, time_us: self.time_us, host_time_ns, kind });
    }

    fn host(&mut self, host_time_ns: u64, message: HostMessage) {
        match &message {
            HostMessage::Keepalive { .. } | HostMessage::AskPass { .. } => return,
            HostMessage::Speed { run, .. } => self.command = Command::Speed(*run),
            HostMessage::Track { run, .. } => self.command = Command::Track(run.clone()),
            _ => {}
        }
        self.event(host_time_ns, EventKind::Command(format!("{message:?}")));
    }

    fn device(&mut self, host_time_ns: u64, message: DeviceMessage) {
        let kind = match message {
            DeviceMessage::Bits(block) => return self.bits(&block),
            DeviceMessage::Edges(block) => return self.edges(&block),
            DeviceMessage::Control(block) => return self.control(&block),
            DeviceMessage::Status(status) => {
                self.recording.status.push((self.session, self.time_us, status));
                return;
            }
            DeviceMessage::Hello(identity) => EventKind::Hello(identity),
            DeviceMessage::Ack { .. } | DeviceMessage::Pass(_) => return,
            DeviceMessage::Nack { of, reason } => {
                self.command = Command::Unknown;
                EventKind::Refused(format!("{of}: {reason}"))
            }
            DeviceMessage::Configured(configuration) => {
                self.configuration = Some(configuration);
                EventKind::Configured(configuration)
            }
            DeviceMessage::Aligned => {
                self.aligned = true;
                EventKind::Aligned
            }
            DeviceMessage::RunStarted { start_us } => {
                self.recording.runs.push(RecordedRun {
                    session: self.session,
                    start_us,
                    end: None,
                    command: self.command.clone(),
                    configuration: self.configuration,
                    aligned: std::mem::take(&mut self.aligned),
                });
                EventKind::RunStarted
            }
            DeviceMessage::RunEnded { end, end_us } => {
                if let Some(run) = self.recording.runs.last_mut().filter(|run| run.session == self.session) {
                    run.end.get_or_insert((end, end_us));
                }
                EventKind::RunEnded(end)
            }
            DeviceMessage::Fault(report) => EventKind::Fault(report),
            DeviceMessage::DriverReply(bytes) => {
                EventKind::Log(format!("driver: {}", String::from_utf8_lossy(&bytes).trim_end()))
            }
            DeviceMessage::DriverDone => EventKind::Log("driver: done".to_owned()),
            DeviceMessage::Log(line) => EventKind::Log(line.as_str().to_owned()),
            DeviceMessage::Losses(lost) => EventKind::Log(format!("lost since the board's start: {lost:?}")),
        };
        self.event(host_time_ns, kind);
    }

    fn bits(&mut self, block: &BitsBlock) {
        let session = self.session;
        let follows = |segment: &&mut BitsSegment| {
            let next = segment.first_sample.wrapping_add(segment.levels.len() as u64);
            segment.session == session && next == block.first_sample && block.first_sample > 0
        };
        let levels = block.words.iter().enumerate().flat_map(|(index, word)| {
            let left = usize::from(block.samples).saturating_sub(32 * index).min(32);
            bits::levels(*word, left as u8)
        });
        if let Some(segment) = self.recording.bits.last_mut().filter(follows) {
            segment.levels.extend(levels);
        } else {
            let levels = levels.collect();
            let (first_sample, first_us) = (block.first_sample, block.first_us);
            self.recording.bits.push(BitsSegment { session, first_sample, first_us, levels });
        }
    }

    fn edges(&mut self, block: &EdgesBlock) {
        let (session, now_us) = (self.session, self.time_us);
        let timed = block.edges.iter().map(|edge| TimedEdge {
            time_us: full_time_us(now_us, edge),
            level: edge.level,
            direction: edge.direction,
        });
        let follows = |segment: &&mut EdgesSegment| {
            // A lost edge also shows as a level that does not alternate.
            let alternates = match (segment.edges.last(), block.edges.first()) {
                (Some(last), Some(first)) => last.level != first.level,
                _ => true,
            };
            let next = segment.first_edge.wrapping_add(segment.edges.len() as u64);
            segment.session == session && next == block.first_edge && alternates
        };
        if let Some(segment) = self.recording.edges.last_mut().filter(follows) {
            segment.edges.extend(timed);
        } else {
            let edges = timed.collect();
            self.recording.edges.push(EdgesSegment { session, first_edge: block.first_edge, edges });
        }
    }

    fn control(&mut self, block: &ControlBlock) {
        let session = self.session;
        let control = self.configuration.map(|configuration| configuration.control);
        let period_us = control.map_or(500, |control| control.period_us);
        let duty_steps = control.map_or(0, |control| control.duty_steps);
        let follows = |segment: &&mut ControlSegment| {
            let next = segment.first_tick.wrapping_add(segment.samples.len() as u64);
            segment.session == session
                && next == block.first_tick
                && block.first_tick > 0
                && segment.time_us(segment.samples.len()) == block.first_us
                && (segment.period_us, segment.duty_steps) == (period_us, duty_steps)
        };
        if let Some(segment) = self.recording.control.last_mut().filter(follows) {
            segment.samples.extend_from_slice(&block.samples);
        } else {
            self.recording.control.push(ControlSegment {
                session,
                first_tick: block.first_tick,
                first_us: block.first_us,
                period_us,
                duty_steps,
                samples: block.samples.to_vec(),
            });
        }
    }
}

/// An edge carries the low 32 bits of the clock; it happened less than 71 minutes before its frame was sent.
fn full_time_us(sent_us: u64, edge: &encoder::Edge) -> u64 {
    sent_us.saturating_sub(u64::from((sent_us as u32).wrapping_sub(edge.time_us)))
}

#[cfg(test)]
mod tests;
