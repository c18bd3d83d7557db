//! From the raw frames of a recording to messages, with every loss counted.

use super::earlier::{self, Recorded};
use super::order::{Arrival, Order};
use super::store::{Entry, Integrity, Metadata, Reader, Sender, StoreError};
use serde::Serialize;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;
use twum_shared::frame::{FrameError, Header, MAX_ENCODED};
use twum_shared::message::{DeviceMessage, HostMessage};

/// One decoded thing of a recording.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one at a time is alive; boxing each would cost an allocation a frame")]
pub enum Item {
    /// A message of the board.
    Device {
        /// Counts the board's starts: its clock, its sequence and its indices begin anew with each.
        session: u32,
        /// Host time in ns from the start of the recording.
        host_time_ns: u64,
        /// Sequence and device time.
        header: Header,
        /// The message.
        message: DeviceMessage,
    },
    /// A message of the host.
    Host {
        /// Host time in ns from the start of the recording.
        host_time_ns: u64,
        /// Its sequence.
        header: Header,
        /// The message.
        message: HostMessage,
    },
    /// Bytes on the line that are no frame.
    Broken {
        /// Who sent them.
        sender: Sender,
        /// Host time in ns from the start of the recording.
        host_time_ns: u64,
        /// What is wrong with them.
        error: FrameError,
    },
    /// A remark of the recorder, `{"event": "..."}`.
    Remark {
        /// Host time in ns from the start of the recording.
        host_time_ns: u64,
        /// The remark.
        json: String,
    },
}

/// What the line did to the frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct LinkStatistics {
    /// Intact frames of the board.
    pub device_frames: u64,
    /// Intact frames of the host.
    pub host_frames: u64,
    /// Frames that arrived broken.
    pub broken_frames: u64,
    /// Sequence numbers of the board that never arrived: frames lost on the line, and losses the board itself reports.
    pub missing_sequences: u64,
    /// Places in the stream where sequence numbers are missing.
    pub gaps: u64,
    /// Starts of the board.
    pub sessions: u32,
    /// Frames of the board that came again and were dropped.
    pub duplicates: u64,
}

/// Decodes a recording from beginning to end.
#[derive(Debug)]
pub struct Decoder<S = File> {
    reader: Reader<S>,
    statistics: LinkStatistics,
    order: Order,
}

impl Decoder<File> {
    /// Opens a recording.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        Ok(Self::new(Reader::open(path)?))
    }
}

impl<S: Read + Seek> Decoder<S> {
    /// Decodes what a reader gives.
    pub fn new(reader: Reader<S>) -> Self {
        Self { reader, statistics: LinkStatistics::default(), order: Order::default() }
    }

    /// What the recording says about itself.
    pub fn metadata(&self) -> &Metadata {
        self.reader.metadata()
    }

    /// The state of the file as far as it was read.
    pub fn integrity(&self) -> Integrity {
        self.reader.integrity()
    }

    /// What the line did, as far as it was read.
    pub fn statistics(&self) -> LinkStatistics {
        self.statistics
    }

    /// Reads on behind the present end, as [`Reader::follow`].
    pub fn follow(&mut self) {
        self.reader.follow();
    }

    /// The next item, `None` at the end.
    ///
    /// # Errors
    /// As [`Reader::next_entry`].
    pub fn next_item(&mut self) -> Result<Option<Item>, StoreError> {
        loop {
            let item = match self.reader.next_entry()? {
                None => return Ok(None),
                Some(Entry::Remark { host_time_ns, json }) => Item::Remark { host_time_ns, json: json.to_owned() },
                // A separator alone ends nothing.
                Some(Entry::Frame { bytes: [0], .. }) => continue,
                Some(Entry::Frame { sender: Sender::Device, host_time_ns, bytes }) => match decode(bytes) {
                    Ok((header, message)) => {
                        let Some(session) = self.track(header, &message) else { continue };
                        self.statistics.device_frames += 1;
                        Item::Device { session, host_time_ns, header, message }
                    }
                    Err(error) => Item::Broken { sender: Sender::Device, host_time_ns, error },
                },
                Some(Entry::Frame { sender: Sender::Host, host_time_ns, bytes }) => match decode(bytes) {
                    Ok((header, message)) => {
                        self.statistics.host_frames += 1;
                        Item::Host { host_time_ns, header, message }
                    }
                    Err(error) => Item::Broken { sender: Sender::Host, host_time_ns, error },
                },
            };
            self.statistics.broken_frames += u64::from(matches!(item, Item::Broken { .. }));
            return Ok(Some(item));
        }
    }

    /// Keeps track of the board's sequence and clock; gives the session the frame belongs to, none if it came again.
    fn track(&mut self, header: Header, message: &DeviceMessage) -> Option<u32> {
        match self.order.take(header, matches!(message, DeviceMessage::Hello(_))) {
            Arrival::Again => {
                self.statistics.duplicates += 1;
                return None;
            }
            Arrival::First | Arrival::Restart => self.statistics.sessions += 1,
            Arrival::Next { missing } => {
                self.statistics.missing_sequences += u64::from(missing);
                self.statistics.gaps += u64::from(missing > 0);
            }
        }
        Some(self.statistics.sessions.saturating_sub(1))
    }
}

fn decode<M: Recorded>(bytes: &[u8]) -> Result<(Header, M), FrameError> {
    let mut block = [0; MAX_ENCODED];
    let Some((0, content)) = bytes.split_last() else { return Err(FrameError::NotAFrame) };
    let block = block.get_mut(..content.len()).ok_or(FrameError::TooLong)?;
    block.copy_from_slice(content);
    earlier::decode(block)
}
