use super::decoded::{MOTION_SCHEMA, Motion};
use super::sink::Sink;
use super::{
    LAYOUT, MAX_RECORD, METADATA_NAME, Metadata, Sender, StoreError, TOPIC_DEVICE, TOPIC_HOST, TOPIC_MOTION,
    TOPIC_RECORDER,
};
use mcap::McapError;
use mcap::records::MessageHeader;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

/// Ids of the channels, in the order in which they are added.
pub(super) const CHANNEL_DEVICE: u16 = 1;
pub(super) const CHANNEL_HOST: u16 = 2;
pub(super) const CHANNEL_RECORDER: u16 = 3;
pub(super) const CHANNEL_MOTION: u16 = 4;

const RECORDER_SCHEMA: &[u8] = br#"{"type":"object","properties":{"event":{"type":"string"}},"required":["event"]}"#;

/// Writes a recording. Each call returns once the operating system has the frame.
#[derive(Debug)]
pub struct Writer {
    path: PathBuf,
    container: Option<Container>,
    start_ns: u64,
    records: u32,
    frames: u64,
    motion: Motion,
    /// Dropped to end the thread that asks for the data to reach the disk.
    syncing: Option<mpsc::Sender<()>>,
}

struct Container(mcap::Writer<Sink>);

impl std::fmt::Debug for Container {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Container")
    }
}

impl Writer {
    /// Creates a recording.
    ///
    /// # Errors
    /// When the file exists or cannot be written.
    pub fn create(path: impl AsRef<Path>, metadata: &Metadata) -> Result<Self, StoreError> {
        let path = path.as_ref();
        let file =
            OpenOptions::new().write(true).create_new(true).open(path).map_err(|reason| match reason.kind() {
                io::ErrorKind::AlreadyExists => StoreError::Exists(path.to_owned()),
                _ => StoreError::io(path, reason),
            })?;
        Self::onto(file, path, metadata)
    }

    /// The recording's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Begins a recording in an open file, which goes by `path`.
    ///
    /// # Errors
    /// [`StoreError::Io`] when it cannot be written.
    pub fn onto(file: File, path: &Path, metadata: &Metadata) -> Result<Self, StoreError> {
        let syncing = file.try_clone().ok().map(sync_every_second);
        let begin = || -> Result<Container, McapError> {
            let options = mcap::WriteOptions::new()
                .profile("")
                .library(format!("twum {} layout {LAYOUT}", env!("CARGO_PKG_VERSION")))
                .use_chunks(false)
                .compression(None);
            let mut writer = options.create(Sink::new(file))?;
            let none = BTreeMap::new();
            writer.write_metadata(&mcap::records::Metadata {
                name: METADATA_NAME.to_owned(),
                metadata: metadata.to_map(),
            })?;
            let motion = writer.add_schema("twum.Motion", "jsonschema", MOTION_SCHEMA.as_bytes())?;
            let event = writer.add_schema("twum.RecorderEvent", "jsonschema", RECORDER_SCHEMA)?;
            for (expected, schema, topic, encoding) in [
                (CHANNEL_DEVICE, 0, TOPIC_DEVICE, "twum-frame"),
                (CHANNEL_HOST, 0, TOPIC_HOST, "twum-frame"),
                (CHANNEL_RECORDER, event, TOPIC_RECORDER, "json"),
                (CHANNEL_MOTION, motion, TOPIC_MOTION, "json"),
            ] {
                let id = writer.add_channel(schema, topic, encoding, &none)?;
                debug_assert_eq!(id, expected);
            }
            writer.flush()?;
            Ok(Container(writer))
        };
        let container = begin().map_err(|error| StoreError::io(path, to_io(error)))?;
        Ok(Self {
            path: path.to_owned(),
            container: Some(container),
            start_ns: metadata.start_ns,
            records: 0,
            frames: 0,
            motion: Motion::default(),
            syncing,
        })
    }

    /// Appends a frame: the bytes as they were on the line, up to and including their `0x00` (which may be missing where
    /// the line broke off). Bytes that hold several separators become several frames. `host_time_ns` counts from the
    /// start of the recording.
    ///
    /// # Errors
    /// When the system takes no more. The file then ends with the last whole frame, and nothing more can be written.
    pub fn frame(&mut self, sender: Sender, host_time_ns: u64, bytes: &[u8]) -> Result<(), StoreError> {
        let channel = match sender {
            Sender::Device => CHANNEL_DEVICE,
            Sender::Host => CHANNEL_HOST,
        };
        for frame in bytes.split_inclusive(|byte| *byte == 0) {
            for piece in frame.chunks(MAX_RECORD / 2) {
                self.append(channel, host_time_ns, piece)?;
            }
            self.frames += 1;
            if let Some(json) = (sender == Sender::Device).then(|| self.motion.of(frame)).flatten() {
                // Not worth a call of its own to the system: it goes out with the next frame.
                self.write(CHANNEL_MOTION, host_time_ns, json.as_bytes(), false)?;
            }
        }
        Ok(())
    }

    /// Appends a remark of the recorder, such as that the port was lost.
    ///
    /// # Errors
    /// As [`Self::frame`].
    pub fn remark(&mut self, host_time_ns: u64, event: &str) -> Result<(), StoreError> {
        let event: String = event.chars().take(1000).collect();
        let json = serde_json::json!({ "event": event }).to_string();
        self.append(CHANNEL_RECORDER, host_time_ns, json.as_bytes())
    }

    fn append(&mut self, channel_id: u16, host_time_ns: u64, bytes: &[u8]) -> Result<(), StoreError> {
        self.write(channel_id, host_time_ns, bytes, true)
    }

    fn write(&mut self, channel_id: u16, host_time_ns: u64, bytes: &[u8], through: bool) -> Result<(), StoreError> {
        let time = self.start_ns.saturating_add(host_time_ns);
        let header = MessageHeader { channel_id, sequence: self.records, log_time: time, publish_time: time };
        let Some(container) = &mut self.container else {
            return Err(self.stopped(io::Error::other("an earlier write failed")));
        };
        let written = container
            .0
            .write_to_known_channel(&header, bytes)
            .and_then(|()| if through { container.0.flush() } else { Ok(()) });
        if let Err(error) = written {
            self.abandon();
            return Err(self.stopped(to_io(error)));
        }
        self.records = self.records.wrapping_add(1);
        Ok(())
    }

    /// Writes the summary and closes the file; gives the number of frames. A recording without a summary (the process
    /// was killed) is as good, only slower to open in other programs.
    ///
    /// # Errors
    /// When the system takes no more; every frame is intact.
    pub fn finish(mut self) -> Result<u64, StoreError> {
        self.close()?;
        Ok(self.frames)
    }

    fn close(&mut self) -> Result<(), StoreError> {
        self.syncing = None;
        let Some(Container(mut writer)) = self.container.take() else { return Ok(()) };
        let finished = writer.finish().map_err(to_io);
        let mut sink = writer.into_inner();
        finished.and_then(|_| io::Write::flush(&mut sink)).map_err(|reason| self.stopped(reason))
    }

    /// Lets go of a container that failed, without another attempt to write its summary.
    fn abandon(&mut self) {
        self.syncing = None;
        if let Some(Container(writer)) = self.container.take() {
            drop(writer.into_inner());
        }
    }

    fn stopped(&self, reason: io::Error) -> StoreError {
        StoreError::Stopped { path: self.path.clone(), reason, frames: self.frames }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // The frames are in the file already; a summary that cannot be written costs nothing but speed.
        let _ = self.close();
    }
}

fn to_io(error: McapError) -> io::Error {
    match error {
        McapError::Io(reason) => reason,
        other => io::Error::other(other),
    }
}

/// A power cut costs what the operating system has not written out. Asking for it blocks for as long as the disk takes,
/// so it happens beside the recorder.
fn sync_every_second(file: File) -> mpsc::Sender<()> {
    let (keep, ended) = mpsc::channel();
    thread::spawn(move || {
        while ended.recv_timeout(Duration::from_secs(1)) == Err(mpsc::RecvTimeoutError::Timeout) {
            let _ = file.sync_data();
        }
    });
    keep
}
