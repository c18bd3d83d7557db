//! Recordings: the container, the frames in it, and what is made of them.

use crate::sealed;
use std::io::Cursor;
use std::path::Path;
use twum_host::compare::replay::Replay;
use twum_host::record::decode::{Decoder, Item};
use twum_host::record::export::{EncoderSource, to_measurement};
use twum_host::record::recording::Recording;
use twum_host::record::store::{Ending, Integrity, Reader};

/// The first byte chooses: a raw file, or records of sealed frames behind a good beginning; and what is made of it.
pub fn recordings(data: &[u8]) {
    let Some((choice, rest)) = data.split_first() else { return };
    let made = if choice & 1 == 0 { rest.to_vec() } else { composed(rest) };
    let bytes = made.len() as u64;
    let Ok(reader) = Reader::new(Cursor::new(made), Path::new("fuzz.mcap")) else { return };
    let decoder = Decoder::new(reader);
    let integrity = if choice & 2 == 0 {
        replayed(decoder)
    } else {
        let recording = Recording::read(decoder).expect("memory is always readable");
        let _ = recording.losses();
        let source = if choice & 4 == 0 { EncoderSource::Edges } else { EncoderSource::Bits };
        let _ = to_measurement(&recording, "fuzz", source);
        for run in &recording.runs {
            let _ = recording.host_time_ns(run.session, run.start_us);
        }
        recording.integrity
    };
    assert_ne!(integrity.ending, Ending::Unread, "the end was reached");
    assert!(integrity.frames <= bytes / 31, "{integrity:?} of {bytes} bytes");
}

fn replayed(mut decoder: Decoder<Cursor<Vec<u8>>>) -> Integrity {
    let mut replay = Replay::new();
    while let Some(item) = decoder.next_item().expect("memory is always readable") {
        if let Item::Device { message, .. } = item {
            replay.observe(&message);
        }
    }
    decoder.integrity()
}

/// Each record: what it is, how much later, how long, and its bytes.
fn composed(mut records: &[u8]) -> Vec<u8> {
    let mut file = beginning();
    let (mut sequence, mut time_us) = (0u32, 0u64);
    while let [kind, later, length, rest @ ..] = records {
        let (payload, rest) = rest.split_at(rest.len().min(usize::from(*length)));
        records = rest;
        time_us = match kind >> 4 {
            0..14 => time_us.saturating_add(u64::from(*later) << (kind >> 4)),
            14 => u64::MAX - u64::from(*later),
            _ => 0,
        };
        let (channel, bytes) = match kind & 7 {
            0..=3 => (1, sealed::frame(b'D', sequence, time_us, payload)),
            4 | 5 => (2, sealed::frame(b'H', sequence, 0, payload)),
            6 => (3, payload.to_vec()),
            _ => (u16::from(*later), payload.to_vec()),
        };
        let gap = u32::from(kind & 8 != 0);
        message(&mut file, channel, sequence, time_us.saturating_mul(1_000), &bytes);
        sequence = sequence.wrapping_add(1 + gap);
    }
    file
}

/// The container's magic, its header and our metadata (mcap.dev/spec).
fn beginning() -> Vec<u8> {
    let text = |out: &mut Vec<u8>, text: &str| {
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.as_bytes());
    };
    let mut file = b"\x89MCAP0\r\n".to_vec();
    let mut header = Vec::new();
    text(&mut header, "");
    text(&mut header, "fuzz");
    record(&mut file, 0x01, &header);
    let mut pairs = Vec::new();
    for (key, value) in [("layout", "1"), ("start_unix_ns", "0")] {
        text(&mut pairs, key);
        text(&mut pairs, value);
    }
    let mut metadata = Vec::new();
    text(&mut metadata, "twum");
    metadata.extend((pairs.len() as u32).to_le_bytes());
    metadata.extend(pairs);
    record(&mut file, 0x0C, &metadata);
    file
}

fn message(file: &mut Vec<u8>, channel: u16, sequence: u32, time_ns: u64, bytes: &[u8]) {
    let mut body = channel.to_le_bytes().to_vec();
    body.extend(sequence.to_le_bytes());
    body.extend(time_ns.to_le_bytes());
    body.extend(time_ns.to_le_bytes());
    body.extend(bytes);
    record(file, 0x05, &body);
}

fn record(file: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    file.push(opcode);
    file.extend((body.len() as u64).to_le_bytes());
    file.extend(body);
}
