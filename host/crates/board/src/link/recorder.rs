//! A session's recording, written on a thread of its own: what moves the motor, or stops it, waits for no disk.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use twum_record::store::{Sender, StoreError, Writer};

/// What may wait for the disk. A full link of 921 600 baud brings 4 600 of the shortest frames a second, and 300 of those of a
/// run: a disk may stand still for 14 s at the least, and costs 40 MB at most.
const WAITING: usize = 1 << 16;

/// A frame or a remark on its way to the disk, with the host's time since the recording's start, ns.
enum Piece {
    Frame(Sender, u64, Vec<u8>),
    Remark(u64, String),
}

/// Hands what is recorded to the thread that writes it.
#[derive(Debug)]
pub(super) struct Recorder {
    path: PathBuf,
    /// Dropped to end the thread.
    queue: Option<SyncSender<Piece>>,
    thread: Option<JoinHandle<Result<u64, StoreError>>>,
    /// In virtual time the board waits for the disk.
    waits: bool,
}

impl Recorder {
    pub fn new(writer: Writer, waits: bool) -> Self {
        let (queue, pieces) = sync_channel(WAITING);
        let path = writer.path().to_owned();
        let thread = std::thread::spawn(move || write(writer, &pieces));
        Self { path, queue: Some(queue), thread: Some(thread), waits }
    }

    /// Appends a frame, as [`Writer::frame`].
    ///
    /// # Errors
    /// When an earlier piece could not be written, or the disk is too far behind.
    pub fn frame(&mut self, sender: Sender, time_ns: u64, bytes: &[u8]) -> Result<(), StoreError> {
        self.push(Piece::Frame(sender, time_ns, bytes.to_vec()))
    }

    /// Appends a remark, as [`Writer::remark`].
    ///
    /// # Errors
    /// As [`Self::frame`].
    pub fn remark(&mut self, time_ns: u64, event: &str) -> Result<(), StoreError> {
        self.push(Piece::Remark(time_ns, event.to_owned()))
    }

    /// Whether it can no longer write, which [`Self::finish`] tells.
    pub fn has_failed(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    fn push(&mut self, piece: Piece) -> Result<(), StoreError> {
        // Without a queue it failed before, and its end tells why.
        let Some(queue) = &self.queue else { return Ok(()) };
        let sent = if self.waits { queue.send(piece).map_err(|_| None) } else { queue.try_send(piece).map_err(Some) };
        match sent {
            Ok(()) => Ok(()),
            Err(Some(TrySendError::Full(_))) => {
                self.queue = None;
                Err(StoreError::Behind { path: self.path.clone(), waiting: WAITING })
            }
            Err(_) => self.finish().map(|_| ()),
        }
    }

    /// Waits until all of it is written and the recording closed; gives its number of frames. The motor needs nothing then.
    ///
    /// # Errors
    /// When a piece could not be written.
    pub fn finish(&mut self) -> Result<u64, StoreError> {
        self.queue = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(written)) => written,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(0),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.queue = None;
        // What was captured is not lost by a session that ends early; a defect of the thread was told where it happened.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn write(mut writer: Writer, pieces: &Receiver<Piece>) -> Result<u64, StoreError> {
    for piece in pieces {
        match piece {
            Piece::Frame(sender, time_ns, bytes) => writer.frame(sender, time_ns, &bytes)?,
            Piece::Remark(time_ns, event) => writer.remark(time_ns, &event)?,
        }
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::super::{LinkError, Port, Session};
    use super::*;
    use std::fs::File;
    use std::io::Read;
    use std::os::fd::OwnedFd;
    use std::path::Path;
    use std::time::{Duration, Instant};
    use twum_record::store::{Metadata, Reader};
    use twum_shared::frame::{self, Decoder, Header, MAX_ENCODED};
    use twum_shared::message::{DeviceMessage, HostMessage, Mode, Status};
    use twum_shared::{Direction, Duty};

    /// A board that says something a thousand times a second, takes a stop, and remembers when it heard a sign of life.
    struct Talker {
        began: Instant,
        heard: Decoder,
        sequence: u32,
        alive: Vec<Duration>,
        stopped: Option<u32>,
    }

    impl Talker {
        fn new() -> Self {
            Self { began: Instant::now(), heard: Decoder::new(), sequence: 0, alive: Vec::new(), stopped: None }
        }

        fn say(&mut self, message: &DeviceMessage, into: &mut Vec<u8>) {
            let header = Header { sequence: self.sequence, time_us: self.began.elapsed().as_micros() as u64 };
            self.sequence += 1;
            into.extend_from_slice(frame::encode(header, message, &mut [0; MAX_ENCODED]).unwrap());
        }
    }

    impl Port for Talker {
        fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
            for &byte in bytes {
                match self.heard.push::<HostMessage>(byte) {
                    Some(Ok((_, HostMessage::Keepalive { .. }))) => self.alive.push(self.began.elapsed()),
                    Some(Ok((header, HostMessage::Stop { .. }))) => self.stopped = Some(header.sequence),
                    _ => {}
                }
            }
            Ok(())
        }

        fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
            std::thread::sleep(wait.min(Duration::from_millis(1)));
            if let Some(of) = self.stopped {
                self.say(&DeviceMessage::Ack { of }, into);
            }
            let status = Status {
                mode: Mode::Idle,
                fault: None,
                position: 0,
                duty: Duty::OFF,
                direction: Direction::Cw,
                ticks: 0,
                late_ticks: 0,
                worst_late_us: 0,
                worst_duration_us: 0,
                edges: 0,
                lost_items: 0,
                bad_frames: 0,
            };
            for _ in 0..10 {
                self.say(&DeviceMessage::Status(status), into);
            }
            Ok(())
        }

        fn elapsed(&self) -> Duration {
            self.began.elapsed()
        }

        fn is_virtual(&self) -> bool {
            false
        }
    }

    /// A recording on a disk that takes some 64 KiB and then stands still until it is read.
    fn stuck() -> (File, Writer) {
        let (reader, writer) = std::io::pipe().unwrap();
        let file = File::from(OwnedFd::from(writer));
        let writer = Writer::onto(file, Path::new("stuck.mcap"), &Metadata::simulated()).unwrap();
        (File::from(OwnedFd::from(reader)), writer)
    }

    #[test]
    fn a_disk_that_stands_still_delays_neither_signs_of_life_nor_a_stop_and_loses_nothing() {
        let (mut disk, writer) = stuck();
        let mut session = Session::new(Talker::new());
        session.record(writer);
        session.hold(true);
        let until = Instant::now() + Duration::from_secs(2);
        let mut seen = 0;
        while Instant::now() < until {
            seen += u64::from(session.next(Duration::from_millis(5)).unwrap().is_some());
        }
        session.halt().unwrap();
        assert!(seen > 4_000, "{seen} frames are more than the disk took at once");
        let alive = &session.port().alive;
        let longest = alive.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        // They are due every 100 ms; the board gives up after 500 ms.
        assert!(alive.len() > 4 && longest < Duration::from_millis(450), "{} signs of life, {longest:?}", alive.len());
        let reading = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            disk.read_to_end(&mut bytes).map(|_| bytes)
        });
        let recorded = session.finish_recording().unwrap();
        let mut reader = Reader::new(std::io::Cursor::new(reading.join().unwrap().unwrap()), Path::new("a")).unwrap();
        let mut frames = 0;
        while reader.next_entry().unwrap().is_some() {
            frames += 1;
        }
        assert_eq!(frames, recorded);
        assert!(recorded >= seen && reader.integrity().is_whole());
    }

    #[test]
    fn a_disk_that_falls_too_far_behind_ends_the_recording_and_is_named() {
        let (disk, writer) = stuck();
        let mut recorder = Recorder::new(writer, false);
        let pushed =
            (0..WAITING as u64 * 2).find_map(|index| recorder.frame(Sender::Device, index, &[1, 2, 3, 0]).err());
        let message = pushed.expect("a queue has an end").to_string();
        assert!(message.contains("stuck.mcap") && message.contains("does not keep up"), "{message}");
        drop(disk);
        assert!(recorder.finish().is_err(), "the disk is gone");
    }
}
