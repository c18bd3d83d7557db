use super::writer::{CHANNEL_DEVICE, CHANNEL_HOST, CHANNEL_MOTION, CHANNEL_RECORDER};
use super::{MAX_RECORD, METADATA_NAME, Metadata, Sender, StoreError};
use mcap::McapError;
use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use twum_files::input;

/// Bytes asked for at once.
const READ_AHEAD: usize = 1 << 16;
/// Bytes asked for first behind a damaged place, doubled each time: where one follows the other, reading far ahead each time
/// would read the file many times over.
const READ_FIRST: usize = 1 << 10;
/// Opcode and length of a record.
const RECORD_HEAD: usize = 9;
/// Channel, sequence, log time and publish time of a message record.
const MESSAGE_HEAD: usize = 22;

/// More records than any hole in a file holds.
const MAX_MISSING: u32 = 1 << 24;

/// One thing a recording holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry<'a> {
    /// A frame as it was on the line.
    Frame {
        /// Who sent it.
        sender: Sender,
        /// Host time in ns from the start of the recording.
        host_time_ns: u64,
        /// The bytes, separator included.
        bytes: &'a [u8],
    },
    /// A remark of the recorder.
    Remark {
        /// Host time in ns from the start of the recording.
        host_time_ns: u64,
        /// The remark, `{"event": "..."}`.
        json: &'a str,
    },
}

/// How a file ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Ending {
    /// Reading has not come to the end.
    #[default]
    Unread,
    /// With its summary: the recorder finished.
    Finished,
    /// Without: the recorder was stopped, or still runs.
    Stopped,
}

/// What state a recording's file is in, as far as it was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Integrity {
    /// Frames read.
    pub frames: u64,
    /// Places where the file was damaged and reading went on behind.
    pub damaged_places: u64,
    /// Bytes that could not be read there.
    pub skipped_bytes: u64,
    /// Records that are missing by their sequence.
    pub missing_records: u64,
    /// Whether the checksum over the whole file was there and did not match.
    pub checksum_mismatch: bool,
    /// How the file ended.
    pub ending: Ending,
}

impl Integrity {
    /// Whether every record that was written was read.
    pub fn is_whole(&self) -> bool {
        self.damaged_places == 0 && self.missing_records == 0 && !self.checksum_mismatch
    }
}

/// Reads a recording from its beginning to its last whole frame, over damaged places. Memory is bounded by one record.
pub struct Reader<S = File> {
    path: PathBuf,
    file: S,
    records: LinearReader,
    metadata: Metadata,
    /// Where the next record starts.
    position: u64,
    /// Where the record last read started.
    previous: u64,
    /// Sequence the next message should have.
    expected: Option<u32>,
    integrity: Integrity,
    /// The record last read, without its opcode and length.
    current: Vec<u8>,
    ended: bool,
    following: bool,
    read_ahead: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Channel {
    Frames(Sender),
    Remarks,
    /// Decoded from the frames, for other programs.
    Motion,
}

impl Channel {
    /// The channel of an id. The ids are fixed: a damaged channel record then costs nothing.
    fn of(id: u16) -> Option<Self> {
        match id {
            CHANNEL_DEVICE => Some(Self::Frames(Sender::Device)),
            CHANNEL_HOST => Some(Self::Frames(Sender::Host)),
            CHANNEL_RECORDER => Some(Self::Remarks),
            CHANNEL_MOTION => Some(Self::Motion),
            _ => None,
        }
    }
}

/// What a record turned out to be.
enum Step {
    Message {
        channel: Channel,
        log_time: u64,
    },
    Other,
    /// Reading goes on at the first message record at or behind `from` other than the one at `except`.
    Damage {
        from: u64,
        except: Option<u64>,
    },
    /// No more for now.
    Wait,
    End,
}

impl<S> std::fmt::Debug for Reader<S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reader").field("path", &self.path).field("position", &self.position).finish_non_exhaustive()
    }
}

impl Reader<File> {
    /// Opens a recording and reads its metadata.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a recording.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        let path = path.as_ref();
        let file = input::open(path).map_err(|reason| match reason.kind() {
            io::ErrorKind::InvalidInput if path.is_dir() => {
                StoreError::not(path, "a folder: name one of the .mcap files in it")
            }
            io::ErrorKind::InvalidInput => StoreError::not(path, "not a regular file"),
            _ => StoreError::io(path, reason),
        })?;
        let length = file.metadata().map_err(|reason| StoreError::io(path, reason))?.len();
        if length == 0 {
            return Err(StoreError::not(path, "the file is empty: the recorder was stopped before its first frame"));
        }
        Self::new(file, path)
    }
}

impl<S: Read + Seek> Reader<S> {
    /// Reads a recording from anything that can be read and sought, from its beginning; `path` is its name in messages.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn new(file: S, path: &Path) -> Result<Self, StoreError> {
        let options = LinearReaderOptions::default().with_validate_data_section_crc(true);
        let mut reader = Self {
            path: path.to_owned(),
            file,
            records: LinearReader::new_with_options(bounded(options)),
            metadata: Metadata::now(),
            position: mcap::MAGIC.len() as u64,
            previous: 0,
            expected: None,
            integrity: Integrity::default(),
            current: Vec::new(),
            ended: false,
            following: false,
            read_ahead: READ_AHEAD,
        };
        reader.metadata = reader.read_metadata()?;
        Ok(reader)
    }

    /// What the recording says about itself.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// The state of the file as far as it was read; complete once [`Self::next_entry`] has returned `None`.
    pub fn integrity(&self) -> Integrity {
        self.integrity
    }

    /// Reads on behind the present end: the recording is still being made. [`Self::next_entry`] then gives `None` when
    /// there is nothing new, and may be asked again; [`Integrity::ending`] says when the recorder has finished.
    pub fn follow(&mut self) {
        self.following = true;
    }

    /// The next frame or remark, `None` at the end.
    ///
    /// # Errors
    /// When the system refuses to read. Damage is not an error: it is skipped and counted.
    pub fn next_entry(&mut self) -> Result<Option<Entry<'_>>, StoreError> {
        while !self.ended {
            match self.step()? {
                Step::Message { channel, log_time } => {
                    let host_time_ns = log_time.saturating_sub(self.metadata.start_ns);
                    let entry = match channel {
                        Channel::Frames(sender) => {
                            self.integrity.frames += 1;
                            Entry::Frame { sender, host_time_ns, bytes: &self.current[MESSAGE_HEAD..] }
                        }
                        Channel::Remarks => Entry::Remark {
                            host_time_ns,
                            json: std::str::from_utf8(&self.current[MESSAGE_HEAD..]).unwrap_or_default(),
                        },
                        Channel::Motion => continue,
                    };
                    return Ok(Some(entry));
                }
                Step::Other => {}
                Step::Damage { from, except } => self.resume(from, except)?,
                Step::Wait => return Ok(None),
                Step::End => self.ended = true,
            }
        }
        Ok(None)
    }

    fn read_metadata(&mut self) -> Result<Metadata, StoreError> {
        loop {
            match self.next_record()? {
                Some(Ok(op::HEADER)) => {}
                Some(Ok(op::METADATA)) => match metadata_record(&self.current) {
                    Some((METADATA_NAME, map)) => {
                        return Metadata::from_map(map).map_err(|what| StoreError::not(&self.path, what));
                    }
                    _ => return Err(StoreError::not(&self.path, "an MCAP file that twum did not record")),
                },
                // Not handed to the parser, which panics at an attachment cut short (mcap 0.26).
                Some(Ok(_)) => return Err(StoreError::not(&self.path, "an MCAP file that twum did not record")),
                Some(Err(McapError::BadMagic)) => return Err(StoreError::not(&self.path, "not an MCAP file")),
                Some(Err(_)) | None => {
                    return Err(StoreError::not(&self.path, "its beginning is cut off or damaged"));
                }
            }
        }
    }

    fn step(&mut self) -> Result<Step, StoreError> {
        let failed_at = self.position;
        // The record before may be the damaged one, and a wrong length of it may have hidden others.
        let unreadable = Step::Damage { from: self.previous + 1, except: Some(failed_at) };
        let opcode = match self.next_record()? {
            Some(Ok(opcode)) => opcode,
            Some(Err(McapError::UnexpectedEof)) if self.following => return Ok(Step::Wait),
            Some(Err(McapError::UnexpectedEof)) => {
                // Cut off, unless a damaged length made a record swallow the rest of the file.
                let swallowed = self.ends_with_magic()? || self.find_message(failed_at + 1, None)?.is_some();
                return Ok(if swallowed { unreadable } else { self.end(Ending::Stopped) });
            }
            Some(Err(McapError::BadDataCrc { .. })) => {
                self.integrity.checksum_mismatch = true;
                return Ok(self.end(Ending::Finished));
            }
            Some(Err(_)) => return Ok(unreadable),
            None => return Ok(self.end(Ending::Stopped)),
        };
        Ok(match opcode {
            op::MESSAGE => match message(&self.current) {
                Some((channel, header)) => {
                    self.count_missing(header.sequence);
                    Step::Message { channel, log_time: header.log_time }
                }
                None => Step::Damage { from: failed_at + 1, except: None },
            },
            op::CHUNK if is_chunk(&self.current) => {
                return Err(StoreError::not(
                    &self.path,
                    "another program has rewritten it in chunks: give the file that twum recorded",
                ));
            }
            op::CHUNK => unreadable,
            op::DATA_END => self.end(Ending::Finished),
            op::HEADER..=op::DATA_END => Step::Other,
            _ => unreadable,
        })
    }

    /// Brings the next record into `current`; gives its opcode, the container's own error, or `None` at the end.
    fn next_record(&mut self) -> Result<Option<Result<u8, McapError>>, StoreError> {
        loop {
            let wanted = match self.records.next_event() {
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => wanted.max(self.read_ahead),
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    self.current.clear();
                    self.current.extend_from_slice(data);
                    self.previous = self.position;
                    self.position += (RECORD_HEAD + data.len()) as u64;
                    return Ok(Some(Ok(opcode)));
                }
                Some(Err(error)) => return Ok(Some(Err(error))),
                None => return Ok(None),
            };
            let read =
                self.file.read(self.records.insert(wanted)).map_err(|reason| StoreError::io(&self.path, reason))?;
            self.read_ahead = (2 * self.read_ahead).min(READ_AHEAD);
            if read == 0 && self.following {
                return Ok(Some(Err(McapError::UnexpectedEof)));
            }
            self.records.notify_read(read);
        }
    }

    fn count_missing(&mut self, sequence: u32) {
        match sequence.wrapping_sub(self.expected.unwrap_or(0)) {
            missing @ 0..MAX_MISSING => self.integrity.missing_records += u64::from(missing),
            // No hole is as large: the number itself is damaged.
            _ => self.integrity.damaged_places += 1,
        }
        self.expected = Some(sequence.wrapping_add(1));
    }

    fn end(&mut self, ending: Ending) -> Step {
        self.integrity.ending = ending;
        Step::End
    }

    fn resume(&mut self, from: u64, except: Option<u64>) -> Result<(), StoreError> {
        self.integrity.damaged_places += 1;
        match self.find_message(from, except)? {
            Some(start) => {
                self.integrity.skipped_bytes += start.saturating_sub(from);
                self.file.seek(SeekFrom::Start(start)).map_err(|reason| StoreError::io(&self.path, reason))?;
                let options = LinearReaderOptions::default().with_skip_start_magic(true);
                self.records = LinearReader::new_with_options(bounded(options));
                (self.position, self.previous) = (start, start);
                self.read_ahead = READ_FIRST;
            }
            None => {
                self.integrity.ending = Ending::Stopped;
                self.ended = true;
            }
        }
        Ok(())
    }

    /// Whether the file ends as a finished one does.
    fn ends_with_magic(&mut self) -> Result<bool, StoreError> {
        let io_error = |reason| StoreError::io(&self.path, reason);
        let mut end = Vec::new();
        self.file.seek(SeekFrom::End(-(mcap::MAGIC.len() as i64))).map_err(io_error)?;
        self.file.read_to_end(&mut end).map_err(io_error)?;
        Ok(end == mcap::MAGIC)
    }

    /// Where the next plausible message record starts, from `from` on. Its two equal times and its known channel make a
    /// false one as good as impossible.
    fn find_message(&mut self, from: u64, except: Option<u64>) -> Result<Option<u64>, StoreError> {
        let io_error = |reason| StoreError::io(&self.path, reason);
        self.file.seek(SeekFrom::Start(from)).map_err(io_error)?;
        let mut window = Vec::with_capacity(2 * READ_FIRST);
        let mut window_start = from;
        let mut read_ahead = READ_FIRST;
        loop {
            let read = (&mut self.file).take(read_ahead as u64).read_to_end(&mut window).map_err(io_error)?;
            let head = RECORD_HEAD + MESSAGE_HEAD;
            for (offset, bytes) in window.windows(head).enumerate() {
                let length = u64::from_le_bytes(bytes[1..9].try_into().expect("8 bytes"));
                let plausible = bytes[0] == op::MESSAGE
                    && (MESSAGE_HEAD as u64..=MAX_RECORD as u64).contains(&length)
                    && Channel::of(u16::from_le_bytes([bytes[9], bytes[10]])).is_some()
                    && bytes[15..23] == bytes[23..31]
                    && Some(window_start + offset as u64) != except;
                if plausible {
                    return Ok(Some(window_start + offset as u64));
                }
            }
            if read == 0 {
                return Ok(None);
            }
            read_ahead = (2 * read_ahead).min(READ_AHEAD);
            let keep = window.len().min(head - 1);
            window_start += (window.len() - keep) as u64;
            window.drain(..window.len() - keep);
        }
    }
}

fn bounded(options: LinearReaderOptions) -> LinearReaderOptions {
    options.with_skip_end_magic(true).with_emit_chunks(true).with_record_length_limit(MAX_RECORD)
}

/// A text behind its length, and the bytes after it. The container's own reader (mcap 0.26) makes room for any length that
/// stands there, up to 4 GB, before it looks.
fn text(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some((std::str::from_utf8(text).ok()?, rest))
}

/// Name and entries of a metadata record.
fn metadata_record(data: &[u8]) -> Option<(&str, BTreeMap<String, String>)> {
    let (name, rest) = text(data)?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let mut entries = rest.get(..u32::from_le_bytes(*length) as usize)?;
    let mut map = BTreeMap::new();
    while !entries.is_empty() {
        let (key, rest) = text(entries)?;
        let (value, rest) = text(rest)?;
        map.insert(key.to_owned(), value.to_owned());
        entries = rest;
    }
    Some((name, map))
}

/// Whether a record reads as a chunk: two times, a size, a checksum and the name of a compression.
fn is_chunk(data: &[u8]) -> bool {
    data.get(28..).and_then(text).is_some_and(|(compression, _)| ["", "lz4", "zstd"].contains(&compression))
}

/// The channel and header of a message record, if it is one of ours.
fn message(data: &[u8]) -> Option<(Channel, MessageHeader)> {
    let Ok(Record::Message { header, data }) = mcap::parse_record(op::MESSAGE, data) else { return None };
    let channel = Channel::of(header.channel_id)?;
    let (_, before_last) = data.split_last()?;
    let one_frame = !matches!(channel, Channel::Frames(_)) || !before_last.contains(&0);
    (header.log_time == header.publish_time && one_frame).then_some((channel, header))
}
