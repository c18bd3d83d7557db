//! Recordings: the raw frames of both directions, append-only, in an MCAP container.
//!
//! A recording is the truth; every decoded form is an export. It is written so that it can be read after the recorder
//! was killed at any moment: every frame is one MCAP message record outside any chunk, handed to the operating system
//! whole before the next one is accepted, and what describes the recording stands at its beginning. Only a loss of power
//! can cost more: what the operating system had not yet written out (it is asked to every second).
//!
//! Channels: [`TOPIC_DEVICE`] and [`TOPIC_HOST`] carry frames as they were on the line, their separator included;
//! [`TOPIC_MOTION`] carries what the board's frames say of the motion, decoded, as JSON with a schema: Foxglove and PlotJuggler plot
//! it without an export. [`TOPIC_RECORDER`] carries what the recorder has to say, as JSON (`{"event": "..."}`). A message's log time is the
//! host's time of arrival or sending; its sequence counts the records of the file, so a hole in the file shows.

mod decoded;
mod reader;
mod sink;
mod writer;

pub use reader::{Ending, Entry, Integrity, Reader};
pub use writer::Writer;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Topic of the frames the device sent.
pub const TOPIC_DEVICE: &str = "/twum/raw/device";
/// Topic of the frames the host sent.
pub const TOPIC_HOST: &str = "/twum/raw/host";
/// Topic of the recorder's own remarks.
pub const TOPIC_RECORDER: &str = "/twum/recorder";
/// Topic of the decoded motion.
pub const TOPIC_MOTION: &str = "/twum/motion";
/// Start of a recording made in virtual time, ns since the Unix epoch (2000-01-01): equal seeds give equal bytes.
pub const VIRTUAL_EPOCH_NS: u64 = 946_684_800_000_000_000;

/// Name of the metadata record.
const METADATA_NAME: &str = "twum";
/// Version of the layout described above.
const LAYOUT: &str = "1";
/// Longest MCAP record written or accepted, bytes.
const MAX_RECORD: usize = 1 << 20;

/// Which end sent a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sender {
    /// The board.
    Device,
    /// This computer.
    Host,
}

/// The clock a recording's host times are read from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// This computer's.
    Wall,
    /// The simulated board's.
    Virtual,
}

/// What a recording says about itself. Everything else (configuration in force, drops, faults) is in its frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Metadata {
    /// The clock of the host times.
    pub clock: Clock,
    /// Start of the recording, ns since the Unix epoch; host times count from here.
    pub start_ns: u64,
    /// Version of the recording program.
    pub host_version: String,
    /// Version of the firmware, empty when the board did not say.
    pub firmware_version: String,
    /// Chip, or `simulated`.
    pub chip: String,
    /// The motor parameter set's name, or the content of its file.
    pub motor: String,
    /// Anything else: seed, port, notes.
    pub extra: BTreeMap<String, String>,
}

impl Metadata {
    /// A recording that starts now.
    pub fn now() -> Self {
        let since_epoch = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        Self::new(Clock::Wall, u64::try_from(since_epoch.as_nanos()).unwrap_or(u64::MAX))
    }

    /// A recording in virtual time.
    pub fn simulated() -> Self {
        Self { chip: "simulated".to_owned(), ..Self::new(Clock::Virtual, VIRTUAL_EPOCH_NS) }
    }

    fn new(clock: Clock, start_ns: u64) -> Self {
        Self {
            clock,
            start_ns,
            host_version: env!("CARGO_PKG_VERSION").to_owned(),
            firmware_version: String::new(),
            chip: String::new(),
            motor: String::new(),
            extra: BTreeMap::new(),
        }
    }

    fn to_map(&self) -> BTreeMap<String, String> {
        let mut map: BTreeMap<String, String> =
            self.extra.iter().map(|(key, value)| (format!("x-{key}"), value.clone())).collect();
        let clock = match self.clock {
            Clock::Wall => "wall",
            Clock::Virtual => "virtual",
        };
        let units = "time ns (host) and us (device); position and target counts; u signed duty steps in Q16.16; \
                     duty fraction of the PWM period with drive on";
        for (key, value) in [
            ("layout", LAYOUT),
            ("clock", clock),
            ("start_unix_ns", &self.start_ns.to_string()),
            ("host_version", &self.host_version),
            ("firmware_version", &self.firmware_version),
            ("chip", &self.chip),
            ("motor", &self.motor),
            ("units", units),
        ] {
            map.insert(key.to_owned(), value.to_owned());
        }
        map
    }

    fn from_map(mut map: BTreeMap<String, String>) -> Result<Self, String> {
        let mut take = |key: &str| map.remove(key).unwrap_or_default();
        let layout = take("layout");
        if layout != LAYOUT {
            return Err(format!("layout `{layout}`, this version reads `{LAYOUT}`: use the version that recorded it"));
        }
        let clock = match take("clock").as_str() {
            "virtual" => Clock::Virtual,
            _ => Clock::Wall,
        };
        Ok(Self {
            clock,
            start_ns: take("start_unix_ns").parse().map_err(|_| "no start time in the metadata".to_owned())?,
            host_version: take("host_version"),
            firmware_version: take("firmware_version"),
            chip: take("chip"),
            motor: take("motor"),
            extra: map
                .into_iter()
                .filter_map(|(key, value)| Some((key.strip_prefix("x-")?.to_owned(), value)))
                .collect(),
        })
    }
}

/// Why a recording cannot be written or read.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The file is there already.
    #[error("{}: exists; a recording is never overwritten, choose another name", .0.display())]
    Exists(PathBuf),
    /// The system refused.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The recording.
        path: PathBuf,
        /// The system's reason.
        reason: std::io::Error,
    },
    /// Writing stopped; what was captured before is intact.
    #[error("{}: cannot write any more ({reason}); the {frames} frames captured so far are intact", path.display())]
    Stopped {
        /// The recording.
        path: PathBuf,
        /// The system's reason.
        reason: std::io::Error,
        /// Frames in the file.
        frames: u64,
    },
    /// The disk does not keep up; what it took is intact.
    #[error("{}: the disk does not keep up: {waiting} frames wait for it", path.display())]
    Behind {
        /// The recording.
        path: PathBuf,
        /// Frames that wait.
        waiting: usize,
    },
    /// Not a recording of this program.
    #[error("{}: not a recording: {what}", path.display())]
    NotARecording {
        /// The file.
        path: PathBuf,
        /// What was found.
        what: String,
    },
}

impl StoreError {
    fn io(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason }
    }

    fn not(path: &Path, what: impl Into<String>) -> Self {
        Self::NotARecording { path: path.to_owned(), what: what.into() }
    }
}

#[cfg(test)]
mod tests;
