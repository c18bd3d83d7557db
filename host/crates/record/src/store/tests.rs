use super::*;
use proptest::prelude::*;
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

/// Frames that differ in content and length; none holds a zero but at its end.
fn frame(index: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..5 + index % 40).map(|i| (1 + (index * 31 + i * 7) % 255) as u8).collect();
    bytes.push(0);
    bytes
}

fn sender(index: usize) -> Sender {
    if index % 5 == 4 { Sender::Host } else { Sender::Device }
}

fn record(dir: &TempDir, frames: usize, finish: bool) -> PathBuf {
    let path = dir.path().join("a.mcap");
    let mut writer = Writer::create(&path, &Metadata::simulated()).unwrap();
    for index in 0..frames {
        writer.frame(sender(index), index as u64 * 1000, &frame(index)).unwrap();
    }
    if finish {
        writer.finish().unwrap();
    } else {
        // What a killed process leaves: no destructor runs.
        std::mem::forget(writer);
    }
    path
}

/// The frames of a recording, and the state of its file.
fn read(path: &Path) -> (Vec<(Sender, u64, Vec<u8>)>, Integrity) {
    let mut reader = Reader::open(path).unwrap();
    let mut frames = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        if let Entry::Frame { sender, host_time_ns, bytes } = entry {
            frames.push((sender, host_time_ns, bytes.to_vec()));
        }
    }
    (frames, reader.integrity())
}

fn expected(frames: usize) -> Vec<(Sender, u64, Vec<u8>)> {
    (0..frames).map(|index| (sender(index), index as u64 * 1000, frame(index))).collect()
}

#[test]
fn frames_come_back_as_they_were_on_the_line() {
    let dir = tempfile::tempdir().unwrap();
    let (frames, integrity) = read(&record(&dir, 200, true));
    assert_eq!(frames, expected(200));
    assert!(integrity.is_whole() && integrity.ending == Ending::Finished && integrity.frames == 200, "{integrity:?}");
}

#[test]
fn metadata_and_remarks_come_back() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut metadata = Metadata::now();
    metadata.firmware_version = "0.1.0".to_owned();
    metadata.motor = "name = \"x\"\n".to_owned();
    metadata.extra.insert("port".to_owned(), "/dev/ttyUSB0".to_owned());
    let mut writer = Writer::create(&path, &metadata).unwrap();
    writer.remark(7, "port lost: \"gone\"").unwrap();
    writer.frame(Sender::Device, 9, &[1, 2, 0, 3, 0, 4]).unwrap();
    assert_eq!(writer.finish().unwrap(), 3);
    let mut reader = Reader::open(&path).unwrap();
    assert_eq!(reader.metadata(), &metadata);
    let json = r#"{"event":"port lost: \"gone\""}"#;
    assert_eq!(reader.next_entry().unwrap(), Some(Entry::Remark { host_time_ns: 7, json }));
    for bytes in [&[1, 2, 0][..], &[3, 0], &[4]] {
        let entry = Entry::Frame { sender: Sender::Device, host_time_ns: 9, bytes };
        assert_eq!(reader.next_entry().unwrap(), Some(entry));
    }
    assert_eq!(reader.next_entry().unwrap(), None);
}

#[test]
fn the_container_is_valid_for_other_readers() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = fs::read(record(&dir, 50, true)).unwrap();
    let messages: Vec<mcap::Message> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    assert_eq!(messages.len(), 50);
    assert_eq!(messages[4].channel.topic, TOPIC_HOST);
    assert_eq!(messages[3].data.as_ref(), frame(3));
    assert_eq!(messages[3].log_time, VIRTUAL_EPOCH_NS + 3000);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 50);
    assert_eq!(summary.metadata_indexes[0].name, METADATA_NAME);
}

#[test]
fn equal_content_gives_equal_bytes() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    assert_eq!(fs::read(record(&a, 30, true)).unwrap(), fs::read(record(&b, 30, true)).unwrap());
}

#[test]
fn a_recording_is_never_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(&dir, 3, true);
    let before = fs::read(&path).unwrap();
    assert!(matches!(Writer::create(&path, &Metadata::now()), Err(StoreError::Exists(_))));
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn a_file_cut_anywhere_gives_every_frame_before_the_cut() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(&dir, 12, false);
    let bytes = fs::read(&path).unwrap();
    let all = expected(12);
    let first = read(&path).0.len();
    assert_eq!(first, 12, "what the process had handed over is all there");
    let cut = dir.path().join("cut.mcap");
    let mut longest = 0;
    for length in 0..bytes.len() {
        fs::write(&cut, &bytes[..length]).unwrap();
        // The beginning is written in one piece before the first frame; without it there is nothing to read.
        if let Ok(mut reader) = Reader::open(&cut) {
            let mut count = 0;
            while reader.next_entry().unwrap().is_some() {
                count += 1;
            }
            let (frames, integrity) = read(&cut);
            assert_eq!(frames, all[..count]);
            assert!(integrity.is_whole() && integrity.ending == Ending::Stopped, "{length}: {integrity:?}");
            assert!(count >= longest, "a longer file held fewer frames");
            longest = count;
        }
    }
    assert_eq!(longest, 11);
}

#[test]
fn a_recording_is_followed_while_it_is_made() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut writer = Writer::create(&path, &Metadata::simulated()).unwrap();
    let mut reader = Reader::open(&path).unwrap();
    reader.follow();
    for index in 0..50 {
        assert_eq!(reader.next_entry().unwrap(), None);
        writer.frame(Sender::Device, 1, &frame(index)).unwrap();
        let bytes = frame(index);
        let expected = Entry::Frame { sender: Sender::Device, host_time_ns: 1, bytes: &bytes };
        assert_eq!(reader.next_entry().unwrap(), Some(expected));
    }
    assert_eq!(reader.integrity().ending, Ending::Unread);
    writer.finish().unwrap();
    assert_eq!(reader.next_entry().unwrap(), None);
    assert_eq!(reader.integrity().ending, Ending::Finished);
    assert!(reader.integrity().is_whole());
}

#[test]
fn a_hole_costs_the_frames_in_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(&dir, 100, true);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 300].fill(0);
    fs::write(&path, &bytes).unwrap();
    let (frames, integrity) = read(&path);
    let missing = 100 - frames.len() as u64;
    assert!((4..12).contains(&missing), "{missing} frames lost to 300 bytes");
    assert_eq!((integrity.missing_records, integrity.damaged_places), (missing, 1), "{integrity:?}");
    let all = expected(100);
    assert!(frames.iter().all(|frame| all.contains(frame)));
}

#[test]
fn what_is_not_a_recording_is_refused_with_a_reason() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a");
    for (content, reason) in
        [(&b""[..], "the file is empty"), (b"time_us,level\n", "not an MCAP file"), (b"x", "cut off")]
    {
        fs::write(&path, content).unwrap();
        let error = Reader::open(&path).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    let error = Reader::open(dir.path()).unwrap_err().to_string();
    assert!(error.contains("a folder: name one"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported_and_ends_the_recording() {
    // /dev/full exists already, so it is opened as a sink directly.
    let file = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut sink = sink::Sink::new(file);
    std::io::Write::write_all(&mut sink, b"frame").unwrap();
    let error = std::io::Write::flush(&mut sink).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);
}

/// One damaged byte costs at most the frame it lies in, and is noticed where it costs one.
#[test]
fn a_damaged_byte_costs_at_most_its_frame() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(&dir, 10, true);
    let intact = fs::read(&path).unwrap();
    let all = expected(10);
    let mut unreadable = 0;
    for at in 0..intact.len() {
        for flip in [0x03, 0xff] {
            let mut bytes = intact.clone();
            bytes[at] ^= flip;
            fs::write(&path, &bytes).unwrap();
            if Reader::open(&path).is_err() {
                unreadable = at;
                continue;
            }
            let (frames, integrity) = read(&path);
            // Times may move: the start stands once, in the metadata.
            let kept = all.iter().filter(|(_, _, bytes)| frames.iter().any(|frame| &frame.2 == bytes)).count();
            assert!(kept >= 9, "byte {at} ^ {flip:#x} cost {} frames: {integrity:?}", 10 - kept);
            assert!(frames.len() >= 10 || !integrity.is_whole(), "byte {at} ^ {flip:#x}: {integrity:?}");
        }
    }
    // Only the metadata, at the beginning, is not there twice.
    assert!(unreadable < 550, "byte {unreadable} made the whole file unreadable");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn arbitrary_bytes_behind_a_valid_beginning_never_panic(junk in prop::collection::vec(any::<u8>(), 0..4000)) {
        let dir = tempfile::tempdir().unwrap();
        let path = record(&dir, 3, false);
        let mut bytes = fs::read(&path).unwrap();
        bytes.extend(junk);
        fs::write(&path, &bytes).unwrap();
        let (frames, _) = read(&path);
        prop_assert_eq!(&frames[..3], &expected(3));
    }
}

/// Counts what is read of it.
struct Counted(std::io::Cursor<Vec<u8>>, std::rc::Rc<std::cell::Cell<u64>>);

impl std::io::Read for Counted {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let read = self.0.read(into)?;
        self.1.set(self.1.get() + read as u64);
        Ok(read)
    }
}

impl std::io::Seek for Counted {
    fn seek(&mut self, target: std::io::SeekFrom) -> std::io::Result<u64> {
        self.0.seek(target)
    }
}

#[test]
fn damage_after_damage_does_not_read_the_file_many_times_over() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut writer = Writer::create(&path, &Metadata::simulated()).unwrap();
    for k in 0..20_000 {
        writer.frame(Sender::Device, k, &[7, 7, 7, 0]).unwrap();
    }
    writer.finish().unwrap();
    let mut bytes = fs::read(&path).unwrap();
    // The opcode of every other message.
    let first = bytes.windows(9).position(|head| head == [5, 26, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    let mut damaged = 0;
    for at in (first..first + 35 * 20_000).step_by(70) {
        bytes[at] = 0xee;
        damaged += 1;
    }
    let size = bytes.len() as u64;
    let read = std::rc::Rc::new(std::cell::Cell::new(0));
    let counted = Counted(std::io::Cursor::new(bytes), std::rc::Rc::clone(&read));
    let mut reader = Reader::new(counted, Path::new("a.mcap")).unwrap();
    while reader.next_entry().unwrap().is_some() {}
    let integrity = reader.integrity();
    assert_eq!((damaged, integrity.frames), (10_000, 10_000));
    assert!(read.get() < 100 * size, "{} times the file was read", read.get() / size);
}
