use super::recorder::Recorder;
use super::{LinkError, Port};
use std::collections::VecDeque;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;
use twum_record::order::{Arrival, Order};
use twum_record::store::{Sender, StoreError, Writer};
use twum_shared::frame::{self, FrameError, Header, MAX_ENCODED};
use twum_shared::message::{DeviceMessage, HostMessage, Pass, RunEnd};

/// A keepalive goes out this often while the session holds the motor: well inside the device's command timeout. It is recorded, so a
/// disk that is full is met within this time, whatever the board has to say; with the longest line of the driver board (40 ms)
/// and a turn of the waiting the drive is then off within 100 ms.
const KEEPALIVE: Duration = Duration::from_millis(30);
/// An interruption is seen within this time.
const INTERRUPTION: Duration = Duration::from_millis(10);

/// What a session saw, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Tally {
    /// Intact frames.
    pub received: u64,
    /// Frames the sequence says were sent and that did not arrive intact.
    pub lost: u64,
    /// Blocks that are not intact frames.
    pub bad: u64,
    /// Blocks of plain text (a boot loader's), which are no frames and no loss.
    pub text: u64,
    /// Times the device started anew.
    pub restarts: u64,
    /// Times a lost port was opened again; what was sent meanwhile is lost and not in the count.
    pub reconnects: u64,
    /// Most frames lost in a row.
    pub longest_gap: u64,
    /// Frames that came twice; the second is dropped.
    pub duplicates: u64,
}

impl Tally {
    /// Whether anything is missing.
    pub fn is_lossless(&self) -> bool {
        self.lost == 0 && self.bad == 0 && self.reconnects == 0 && self.restarts == 0
    }
}

/// A frame from the device.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Its header.
    pub header: Header,
    /// Its message.
    pub message: DeviceMessage,
}

/// How a run went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunReport {
    /// How it ended.
    pub end: RunEnd,
    /// Device time of its first tick, µs.
    pub start_us: u64,
    /// Device time of its end, µs.
    pub end_us: u64,
}

/// Sessions of this process that hold a motor.
static HOLDING: AtomicUsize = AtomicUsize::new(0);

/// Whether a session of this process has set a motor in motion, or may have, and has not seen it stand since. Whoever ends the
/// process then first lets the session stop it.
pub fn is_motor_held() -> bool {
    HOLDING.load(Ordering::Relaxed) > 0
}

/// What ends a wait.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Attention {
    /// An interruption and a recording that fails end it; keepalives go out.
    Ordinary,
    /// Nothing but the port's loss: the motor is being stopped, or has been.
    Stopping,
}

/// A conversation with a board.
///
/// It is also the guard of what it sets in motion: dropped for whatever reason while it holds the motor, it stops it.
pub struct Session<P: Port> {
    pub(super) port: P,
    pub(super) token: u32,
    pub(super) pass: Option<Pass>,
    pub(super) holding: bool,
    sequence: u32,
    order: Order,
    bytes: Vec<u8>,
    block: Vec<u8>,
    pub(super) inbox: VecDeque<Received>,
    tally: Tally,
    spoke: bool,
    last_keepalive: Duration,
    recorder: Option<Recorder>,
    /// Why there is no recording any more. It waits until the motor needs nothing.
    failed: Option<StoreError>,
    recording_start: Duration,
    interrupt: Option<&'static AtomicBool>,
}

impl<P: Port> Drop for Session<P> {
    fn drop(&mut self) {
        if self.holding {
            // What cannot be told switches off by its command timeout, which nobody feeds any more.
            let _ = self.switch_off(false);
        }
        self.hold(false);
    }
}

impl<P: Port> Session<P> {
    /// A session over an open port; nothing is sent yet.
    pub fn new(port: P) -> Self {
        // In virtual time nobody else is there, and equal seeds give equal bytes.
        let random = if port.is_virtual() { 1 } else { RandomState::new().build_hasher().finish() };
        Self {
            port,
            token: (random as u32).max(1),
            pass: None,
            holding: false,
            // So that no other session's answers are taken for this one's.
            sequence: (random >> 32) as u32,
            order: Order::default(),
            bytes: Vec::new(),
            block: Vec::new(),
            inbox: VecDeque::new(),
            tally: Tally::default(),
            spoke: false,
            last_keepalive: Duration::ZERO,
            recorder: None,
            failed: None,
            recording_start: Duration::ZERO,
            interrupt: None,
        }
    }

    pub(super) fn hold(&mut self, holding: bool) {
        match (self.holding, holding) {
            (false, true) => HOLDING.fetch_add(1, Ordering::Relaxed),
            (true, false) => HOLDING.fetch_sub(1, Ordering::Relaxed),
            _ => 0,
        };
        self.holding = holding;
    }

    /// Ends every wait with [`LinkError::Interrupted`] from the moment the flag is set, but for those that stop the motor.
    pub fn interrupt_by(&mut self, flag: &'static AtomicBool) {
        self.interrupt = Some(flag);
    }

    /// Whether the flag is set.
    pub fn is_interrupted(&self) -> bool {
        self.interrupt.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// The port.
    pub fn port(&mut self) -> &mut P {
        &mut self.port
    }

    /// What was seen so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Records every frame from here on, of both directions. The tally starts anew: it is the recording's.
    pub fn record(&mut self, writer: Writer) {
        self.recording_start = self.port.elapsed();
        self.tally = Tally::default();
        self.recorder = Some(Recorder::new(writer, self.port.is_virtual()));
    }

    /// Ends the recording; gives its number of frames.
    ///
    /// # Errors
    /// When its end, or an earlier frame, could not be written; every frame before that is intact.
    pub fn finish_recording(&mut self) -> Result<u64, StoreError> {
        let written = self.recorder.take().map_or(Ok(0), |mut recorder| recorder.finish());
        self.failed.take().map_or(written, Err)
    }

    /// Writes into the recording, if there is one. A recording that fails ends, and is told of at the next ordinary wait:
    /// what the motor needs goes first.
    fn write(&mut self, what: impl FnOnce(&mut Recorder, u64) -> Result<(), StoreError>) {
        let time_ns = self.recording_time_ns();
        if let Some(Err(error)) = self.recorder.as_mut().map(|recorder| what(recorder, time_ns)) {
            self.failed = Some(error);
        }
    }

    /// Whether the recording can still be written.
    fn look_at_recording(&mut self) -> Result<(), StoreError> {
        if self.failed.is_none() && self.recorder.as_ref().is_some_and(Recorder::has_failed) {
            self.finish_recording()?;
        }
        self.failed.take().map_or(Ok(()), Err)
    }

    /// Puts a remark into the recording, if there is one.
    pub fn remark(&mut self, event: &str) {
        self.write(|recorder, time_ns| recorder.remark(time_ns, event));
    }

    /// Goes on over another port, after the first was lost. The gap is remarked.
    pub fn reattach(&mut self, port: P) {
        self.port = port;
        self.bytes.clear();
        self.block.clear();
        self.order = Order::default();
        self.spoke = false;
        self.pass = None;
        self.tally.reconnects += 1;
        self.remark("reconnected");
    }

    fn recording_time_ns(&self) -> u64 {
        self.port.elapsed().saturating_sub(self.recording_start).as_nanos() as u64
    }

    /// Sends a message; gives the sequence of its frame. What is sent is recorded after it is on the line: nothing that moves
    /// the motor, or stops it, waits for storage.
    ///
    /// # Errors
    /// When the port is gone.
    pub fn send(&mut self, message: &HostMessage) -> Result<u32, LinkError> {
        let sequence = self.sequence;
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0; MAX_ENCODED];
        let bytes = frame::encode(Header { sequence, time_us: 0 }, message, &mut buffer).expect(
            "every host message fits a frame: its collections are bounded, and a test frames each at its fullest",
        );
        if !self.spoke {
            self.port.send(&[0])?;
            self.spoke = true;
        }
        self.port.send(bytes)?;
        self.write(|recorder, time_ns| recorder.frame(Sender::Host, time_ns, bytes));
        Ok(sequence)
    }

    /// Says that this session is alive, if it holds the motor; waiting does so too.
    ///
    /// # Errors
    /// When the port is gone.
    pub fn keep_alive(&mut self) -> Result<(), LinkError> {
        if self.holding {
            self.last_keepalive = self.port.elapsed();
            self.send(&HostMessage::Keepalive { token: self.token })?;
        }
        Ok(())
    }

    /// The next message, waiting up to `wait`; keeps the device's command timeout from running out meanwhile.
    ///
    /// # Errors
    /// Another protocol version, a lost port, an interruption, or a recording that cannot be written.
    pub fn next(&mut self, wait: Duration) -> Result<Option<Received>, LinkError> {
        self.next_with(wait, Attention::Ordinary)
    }

    /// The next message of a motor that stands: neither an interruption nor a full disk ends this wait.
    ///
    /// # Errors
    /// Another protocol version, or a lost port.
    pub fn next_at_rest(&mut self, wait: Duration) -> Result<Option<Received>, LinkError> {
        self.next_with(wait, Attention::Stopping)
    }

    /// Lets so much time pass, listening; what comes meanwhile is dropped.
    ///
    /// # Errors
    /// As [`Session::next`].
    pub fn rest(&mut self, wait: Duration) -> Result<(), LinkError> {
        let deadline = self.port.elapsed() + wait;
        while self.port.elapsed() < deadline {
            let left = deadline.saturating_sub(self.port.elapsed());
            self.next(left)?;
        }
        Ok(())
    }

    fn next_with(&mut self, wait: Duration, attention: Attention) -> Result<Option<Received>, LinkError> {
        let deadline = self.port.elapsed() + wait;
        loop {
            if let Some(received) = self.inbox.pop_front() {
                return Ok(Some(received));
            }
            self.fill(deadline, attention)?;
            if self.inbox.is_empty() && self.port.elapsed() >= deadline {
                return Ok(None);
            }
        }
    }

    /// Reads once, at most until the deadline or the next keepalive.
    pub(super) fn fill(&mut self, deadline: Duration, attention: Attention) -> Result<(), LinkError> {
        let now = self.port.elapsed();
        let mut until = deadline.min(now + KEEPALIVE / 4);
        if attention == Attention::Ordinary {
            if self.is_interrupted() {
                return Err(LinkError::Interrupted);
            }
            self.look_at_recording()?;
            if now.saturating_sub(self.last_keepalive) >= KEEPALIVE {
                self.keep_alive()?;
            }
            until = until.min(now + INTERRUPTION);
        }
        self.port.receive(&mut self.bytes, until.saturating_sub(now))?;
        let restarts = self.tally.restarts;
        let bytes = std::mem::take(&mut self.bytes);
        for &byte in &bytes {
            self.block.push(byte);
            if byte == 0 {
                self.take_block()?;
            } else if self.block.len() > 4 * MAX_ENCODED {
                // No frame is that long: what is kept of a stream without separators stays bounded.
                self.take_block()?;
            }
        }
        // What this session set in motion is over, and does not go on by itself.
        if attention == Attention::Ordinary && self.holding && self.tally.restarts > restarts {
            self.hold(false);
            return Err(LinkError::Restarted);
        }
        Ok(())
    }

    fn take_block(&mut self) -> Result<(), LinkError> {
        let mut block = std::mem::take(&mut self.block);
        if block == [0] {
            return Ok(());
        }
        self.write(|recorder, time_ns| recorder.frame(Sender::Device, time_ns, &block));
        if block.last() == Some(&0) {
            block.pop();
        }
        let is_text = block.iter().all(|byte| (0x20..0x7f).contains(byte) || b"\r\n\t\x1b".contains(byte));
        match frame::decode::<DeviceMessage>(&mut block) {
            Ok((header, message)) => {
                if self.count(header, &message) {
                    self.inbox.push_back(Received { header, message });
                }
                Ok(())
            }
            Err(FrameError::Version(version)) => Err(LinkError::Version(version)),
            Err(_) if is_text => {
                self.tally.text += 1;
                Ok(())
            }
            // The first block of a stream that was opened midway is the rest of a frame.
            Err(_) if !self.order.has_begun() && self.tally.received == 0 => Ok(()),
            Err(_) => {
                self.tally.bad += 1;
                Ok(())
            }
        }
    }

    /// Counts a frame; whether it is a new one.
    fn count(&mut self, header: Header, message: &DeviceMessage) -> bool {
        match self.order.take(header, matches!(message, DeviceMessage::Hello(_))) {
            Arrival::Again => {
                self.tally.duplicates += 1;
                return false;
            }
            Arrival::First => {}
            Arrival::Restart => self.tally.restarts += 1,
            Arrival::Next { missing } => {
                self.tally.lost += u64::from(missing);
                self.tally.longest_gap = self.tally.longest_gap.max(missing.into());
            }
        }
        self.tally.received += 1;
        true
    }

    /// Waits for the first message `wanted` takes, and removes it; the others stay in order.
    pub(super) fn wait_for<T>(
        &mut self,
        wait: Duration,
        mut wanted: impl FnMut(&DeviceMessage) -> Option<T>,
    ) -> Result<T, LinkError> {
        let deadline = self.port.elapsed() + wait;
        self.search(deadline, Attention::Ordinary, |received| wanted(&received.message))?
            .ok_or(LinkError::NoAnswer { waited_ms: wait.as_millis() as u64 })
    }

    pub(super) fn search<T>(
        &mut self,
        deadline: Duration,
        attention: Attention,
        mut wanted: impl FnMut(&Received) -> Option<T>,
    ) -> Result<Option<T>, LinkError> {
        let mut looked_at = 0;
        loop {
            while let Some(received) = self.inbox.get(looked_at) {
                if let Some(answer) = wanted(received) {
                    self.inbox.remove(looked_at);
                    return Ok(Some(answer));
                }
                looked_at += 1;
            }
            if self.port.elapsed() >= deadline {
                return Ok(None);
            }
            self.fill(deadline, attention)?;
        }
    }
}
