use super::{ExportError, rows};
use crate::recording::{EventKind, Recording};
use ::mcap::records::{MessageHeader, Metadata};
use ::mcap::{McapError, WriteOptions};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::Write;
use std::iter::Peekable;
use std::path::Path;
use twum_files::output::{Existing, Output};

/// Writes the signals of a recording as an indexed MCAP file with JSON messages and schemas, which Foxglove and PlotJuggler
/// open: `/control`, `/edge`, `/level`, `/status` and `/log`. Log times are host times: the board's clock, placed on the
/// host's by the frame that took least to arrive.
///
/// # Errors
/// When the file exists and is to be kept, or writing fails.
pub fn write_mcap(recording: &Recording, path: &Path, existing: Existing) -> Result<(), ExportError> {
    let mut file = Output::begin(path, existing)?;
    write(recording, &mut file).map_err(|reason| match reason {
        McapError::Io(reason) => file.failed(reason).into(),
        reason => ExportError::Mcap { path: path.to_owned(), reason },
    })?;
    Ok(file.finish()?)
}

/// Time in ns from the start of the recording, and the message.
type Stream<'a> = Peekable<Box<dyn Iterator<Item = (u64, String)> + 'a>>;

fn write(recording: &Recording, out: &mut (impl Write + std::io::Seek)) -> Result<(), McapError> {
    let options = WriteOptions::new().library(concat!("twum ", env!("CARGO_PKG_VERSION"))).compression(None);
    let mut writer = options.create(out)?;
    let text = |value: &str| value.to_owned();
    writer.write_metadata(&Metadata {
        name: text("twum-export"),
        metadata: BTreeMap::from([
            (text("firmware_version"), recording.metadata.firmware_version.clone()),
            (text("host_version"), recording.metadata.host_version.clone()),
            (text("chip"), recording.metadata.chip.clone()),
            (text("frames_broken"), recording.link.broken_frames.to_string()),
            (text("sequences_missing"), recording.link.missing_sequences.to_string()),
        ]),
    })?;
    let mut streams: Vec<(u16, u32, Stream)> = Vec::new();
    for (topic, schema_name, schema, messages) in [
        (
            "/control",
            "twum.Control",
            CONTROL_SCHEMA,
            messages(recording, rows::control(recording), |r| (r.session, r.time_us)),
        ),
        ("/edge", "twum.Edge", EDGE_SCHEMA, messages(recording, rows::edges(recording), |r| (r.session, r.time_us))),
        (
            "/level",
            "twum.Level",
            LEVEL_SCHEMA,
            messages(recording, rows::levels(recording), |r| (r.session, r.time_us)),
        ),
        (
            "/status",
            "twum.Status",
            STATUS_SCHEMA,
            messages(recording, rows::status(recording), |r| (r.session, r.time_us)),
        ),
        ("/log", "foxglove.Log", LOG_SCHEMA, log(recording)),
    ] {
        let schema = writer.add_schema(schema_name, "jsonschema", schema.as_bytes())?;
        let channel = writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
        streams.push((channel, 0, messages.peekable()));
    }
    // Merged by time: readers then find neighbouring messages in neighbouring chunks.
    while let Some((channel_id, sequence, stream)) = streams
        .iter_mut()
        .filter_map(|stream| stream.2.peek().map(|head| head.0).map(|time| (time, stream)))
        .min_by_key(|(time, _)| *time)
        .map(|(_, stream)| stream)
    {
        let Some((time_ns, message)) = stream.next() else { break };
        let log_time = recording.metadata.start_ns.saturating_add(time_ns);
        let header = MessageHeader { channel_id: *channel_id, sequence: *sequence, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, message.as_bytes())?;
        *sequence = sequence.wrapping_add(1);
    }
    writer.finish()?;
    Ok(())
}

const CONTROL_SCHEMA: &str = r#"{"type":"object","title":"twum.Control","properties":{
"session":{"type":"integer","description":"the board's starts, from 0"},
"time_us":{"type":"integer","description":"of the board's clock"},
"tick":{"type":"integer","description":"since the run started"},
"target":{"type":"integer","description":"counts"},
"target_rate":{"type":"integer","description":"counts/s"},
"position":{"type":"integer","description":"counts"},
"u":{"type":"number","description":"signed duty steps"},
"duty":{"type":"number","description":"fraction of the PWM period with drive on"},
"direction":{"type":"integer","description":"1 clockwise, -1 counterclockwise"},
"late_us":{"type":"integer"},"duration_us":{"type":"integer"}}}"#;

const EDGE_SCHEMA: &str = r#"{"type":"object","title":"twum.Edge","properties":{
"session":{"type":"integer","description":"the board's starts, from 0"},
"time_us":{"type":"integer","description":"of the board's clock"},
"edge":{"type":"integer","description":"since the stream was switched on"},
"level":{"type":"integer"},
"direction":{"type":"integer","description":"1 clockwise, -1 counterclockwise"}}}"#;

const LEVEL_SCHEMA: &str = r#"{"type":"object","title":"twum.Level","properties":{
"session":{"type":"integer","description":"the board's starts, from 0"},
"time_us":{"type":"integer","description":"of the board's clock"},
"sample":{"type":"integer","description":"since the stream was switched on"},
"level":{"type":"integer"}}}"#;

const STATUS_SCHEMA: &str = r#"{"type":"object","title":"twum.Status","properties":{
"session":{"type":"integer","description":"the board's starts, from 0"},
"time_us":{"type":"integer","description":"of the board's clock"},
"mode":{"type":"string"},"fault":{"type":"string"},
"position":{"type":"integer","description":"counts"},
"duty":{"type":"number","description":"fraction of the PWM period with drive on"},
"direction":{"type":"integer","description":"1 clockwise, -1 counterclockwise"},
"ticks":{"type":"integer"},"late_ticks":{"type":"integer"},"worst_late_us":{"type":"integer"},"worst_duration_us":{"type":"integer"},
"edges":{"type":"integer"},"lost_items":{"type":"integer"},"bad_frames":{"type":"integer"}}}"#;

/// The part of Foxglove's own schema that its log panel needs.
pub const LOG_SCHEMA: &str = r#"{"type":"object","title":"foxglove.Log","properties":{
"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"level":{"type":"integer"},"message":{"type":"string"},"name":{"type":"string"},
"file":{"type":"string"},"line":{"type":"integer"}}}"#;

type Messages<'a> = Box<dyn Iterator<Item = (u64, String)> + 'a>;

/// Rows as JSON at the host's time, from the board's session and time of each.
fn messages<'a, R: Serialize>(
    recording: &'a Recording,
    rows: impl Iterator<Item = R> + 'a,
    at: impl Fn(&R) -> (u32, u64) + 'a,
) -> Messages<'a> {
    Box::new(rows.map(move |row| {
        let (session, time_us) = at(&row);
        let json = serde_json::to_string(&row).expect("a row has neither maps nor values that JSON lacks");
        (recording.host_time_ns(session, time_us), json)
    }))
}

fn log(recording: &Recording) -> Messages<'_> {
    Box::new(recording.events.iter().map(move |event| {
        const INFO: u8 = 2;
        const WARNING: u8 = 3;
        const ERROR: u8 = 4;
        let level = match event.kind {
            EventKind::Fault(_) => ERROR,
            EventKind::Refused(_) | EventKind::Broken(..) => WARNING,
            _ => INFO,
        };
        let (name, text) = event.kind.describe();
        let at_ns = recording.metadata.start_ns.saturating_add(event.host_time_ns);
        let message = serde_json::json!({
            "timestamp": { "sec": at_ns / 1_000_000_000, "nsec": at_ns % 1_000_000_000 },
            "level": level, "message": text, "name": name, "file": "", "line": 0,
        });
        (event.host_time_ns, message.to_string())
    }))
}
