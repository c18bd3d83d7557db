use super::{LinkError, Port};
use crate::record::order::{Arrival, Order};
use crate::record::store::{Sender, StoreError, Writer};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use twum_shared::Fault;
use twum_shared::frame::{self, FrameError, Header, MAX_ENCODED};
use twum_shared::message::{
    CaptureMode, Configuration, DeviceMessage, HostMessage, Identity, Mode, Refusal, RunEnd, SpeedRun, TrackRun,
};

/// A keepalive goes out this often while the host waits: well inside the device's command timeout.
const KEEPALIVE: Duration = Duration::from_millis(100);
/// How long a command's answer may take.
const ANSWER: Duration = Duration::from_millis(1_000);
/// How long a busy board is left alone before it is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(20);
/// Longest alignment: four attempts of a search of 20 s at most.
const ALIGNMENT: Duration = Duration::from_secs(100);

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
    /// Frames that came again and were dropped.
    pub duplicates: u64,
    /// Times a lost port was opened again; what was sent meanwhile is lost and not in the count.
    pub reconnects: u64,
    /// Most frames lost in a row.
    pub longest_gap: u64,
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

/// A conversation with a board.
pub struct Session<P> {
    port: P,
    sequence: u32,
    order: Order,
    bytes: Vec<u8>,
    block: Vec<u8>,
    inbox: VecDeque<Received>,
    tally: Tally,
    last_sent: Duration,
    writer: Option<Writer>,
    recording_start: Duration,
    interrupt: Option<&'static AtomicBool>,
}

impl<P: Port> Session<P> {
    /// A session over an open port; nothing is sent yet.
    pub fn new(port: P) -> Self {
        Self {
            port,
            sequence: 0,
            order: Order::default(),
            bytes: Vec::new(),
            block: Vec::new(),
            inbox: VecDeque::new(),
            tally: Tally::default(),
            last_sent: Duration::ZERO,
            writer: None,
            recording_start: Duration::ZERO,
            interrupt: None,
        }
    }

    /// Ends every wait with [`LinkError::Interrupted`] once the flag is set.
    pub fn interrupt_by(&mut self, flag: &'static AtomicBool) {
        self.interrupt = Some(flag);
    }

    /// Waits no longer end when the flag is set: what follows cleans up.
    pub fn ignore_interrupts(&mut self) {
        self.interrupt = None;
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
        self.writer = Some(writer);
    }

    /// Ends the recording; gives its number of frames.
    ///
    /// # Errors
    /// When its end cannot be written; every frame is intact.
    pub fn finish_recording(&mut self) -> Result<u64, StoreError> {
        self.writer.take().map_or(Ok(0), Writer::finish)
    }

    /// Puts a remark into the recording, if there is one.
    ///
    /// # Errors
    /// When the recording cannot be written.
    pub fn remark(&mut self, event: &str) -> Result<(), LinkError> {
        let time_ns = self.recording_time_ns();
        if let Some(writer) = &mut self.writer {
            writer.remark(time_ns, event)?;
        }
        Ok(())
    }

    /// Goes on over another port, after the first was lost. The gap is remarked.
    ///
    /// # Errors
    /// When the recording cannot be written.
    pub fn reattach(&mut self, port: P) -> Result<(), LinkError> {
        self.port = port;
        self.bytes.clear();
        self.block.clear();
        self.order.allow_gap();
        self.last_sent = Duration::ZERO;
        self.tally.reconnects += 1;
        self.remark("reconnected")
    }

    fn recording_time_ns(&self) -> u64 {
        self.port.elapsed().saturating_sub(self.recording_start).as_nanos() as u64
    }

    /// Sends a message; gives the sequence of its frame.
    ///
    /// # Errors
    /// When the port is gone or the recording cannot be written.
    pub fn send(&mut self, message: &HostMessage) -> Result<u32, LinkError> {
        let sequence = self.sequence;
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0; MAX_ENCODED];
        let bytes = frame::encode(Header { sequence, time_us: 0 }, message, &mut buffer).expect(
            "every host message fits a frame: its collections are bounded, and a test frames each at its fullest",
        );
        let time_ns = self.recording_time_ns();
        if let Some(writer) = &mut self.writer {
            writer.frame(Sender::Host, time_ns, bytes)?;
        }
        if self.last_sent == Duration::ZERO {
            self.port.send(&[0])?;
        }
        self.port.send(bytes)?;
        self.last_sent = self.port.elapsed();
        Ok(sequence)
    }

    /// The next message, waiting up to `wait`; keeps the device's command timeout from running out meanwhile.
    ///
    /// # Errors
    /// Another protocol version, a lost port, an interruption, or a recording that cannot be written.
    pub fn next(&mut self, wait: Duration) -> Result<Option<Received>, LinkError> {
        let deadline = self.port.elapsed() + wait;
        loop {
            if let Some(received) = self.inbox.pop_front() {
                return Ok(Some(received));
            }
            self.fill(deadline)?;
            if self.inbox.is_empty() && self.port.elapsed() >= deadline {
                return Ok(None);
            }
        }
    }

    /// Reads once, at most until the deadline or the next keepalive.
    fn fill(&mut self, deadline: Duration) -> Result<(), LinkError> {
        if self.is_interrupted() {
            return Err(LinkError::Interrupted);
        }
        let now = self.port.elapsed();
        if now.saturating_sub(self.last_sent) >= KEEPALIVE && self.last_sent != Duration::ZERO {
            self.send(&HostMessage::Keepalive)?;
        }
        let until = deadline.min(now + KEEPALIVE / 4);
        self.port.receive(&mut self.bytes, until.saturating_sub(now))?;
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
        Ok(())
    }

    fn take_block(&mut self) -> Result<(), LinkError> {
        let mut block = std::mem::take(&mut self.block);
        if block == [0] {
            return Ok(());
        }
        let time_ns = self.recording_time_ns();
        if let Some(writer) = &mut self.writer {
            writer.frame(Sender::Device, time_ns, &block)?;
        }
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
            Err(_) if !self.order.has_begun() => Ok(()),
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

    /// Sends a command and waits for its answer; other messages stay in order for [`Session::next`]. A board that is busy,
    /// as while it writes a new configuration to flash, is asked again.
    fn command(&mut self, name: &'static str, message: &HostMessage) -> Result<(), LinkError> {
        let patience = self.port.elapsed() + ANSWER;
        loop {
            let sent = self.send(message)?;
            let answer = self.wait_for(ANSWER, |message| match message {
                DeviceMessage::Ack { of } if *of == sent => Some(Ok(())),
                DeviceMessage::Nack { of, reason } if *of == sent => Some(Err(*reason)),
                _ => None,
            })?;
            match answer {
                Ok(()) => return Ok(()),
                Err(Refusal::Busy) if self.port.elapsed() < patience => {
                    match self.wait_for(ASK_AGAIN, |_| None::<()>) {
                        Ok(()) | Err(LinkError::NoAnswer { .. }) => {}
                        Err(error) => return Err(error),
                    }
                }
                Err(reason) => return Err(LinkError::Refused { command: name, reason }),
            }
        }
    }

    /// Waits for the first message `wanted` takes, and removes it; the others stay in order.
    fn wait_for<T>(
        &mut self,
        wait: Duration,
        mut wanted: impl FnMut(&DeviceMessage) -> Option<T>,
    ) -> Result<T, LinkError> {
        let deadline = self.port.elapsed() + wait;
        let mut looked_at = 0;
        loop {
            while let Some(received) = self.inbox.get(looked_at) {
                if let Some(answer) = wanted(&received.message) {
                    self.inbox.remove(looked_at);
                    return Ok(answer);
                }
                looked_at += 1;
            }
            if self.port.elapsed() >= deadline {
                return Err(LinkError::NoAnswer { waited_ms: wait.as_millis() as u64 });
            }
            self.fill(deadline)?;
        }
    }

    /// Asks who the device is. Tries for three seconds: a board that was just opened may still boot.
    ///
    /// # Errors
    /// No answer, or another protocol version.
    pub fn hello(&mut self) -> Result<Identity, LinkError> {
        let mut result = Err(LinkError::NoAnswer { waited_ms: 3_000 });
        for _ in 0..6 {
            self.send(&HostMessage::Hello)?;
            let answer = self.wait_for(Duration::from_millis(500), |message| match message {
                DeviceMessage::Hello(identity) => Some(identity.clone()),
                _ => None,
            });
            match answer {
                Ok(identity) => return Ok(identity),
                Err(LinkError::NoAnswer { .. }) => {}
                Err(error) => {
                    result = Err(error);
                    break;
                }
            }
        }
        result
    }

    /// Sets the configuration.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn configure(&mut self, configuration: Configuration) -> Result<(), LinkError> {
        self.command("the configuration", &HostMessage::Configure(configuration))
    }

    /// Aligns the motor and waits for the end of it.
    ///
    /// # Errors
    /// Refused, the fault it ended in, or no answer.
    pub fn align(&mut self) -> Result<(), LinkError> {
        self.command("alignment", &HostMessage::Align)?;
        self.wait_for(ALIGNMENT, |message| match message {
            DeviceMessage::Aligned => Some(Ok(())),
            DeviceMessage::Fault(report) => Some(Err(LinkError::Fault(report.fault))),
            DeviceMessage::Status(status) if status.mode == Mode::Fault => {
                Some(Err(LinkError::Fault(status.fault.unwrap_or(Fault::AlignFailed))))
            }
            _ => None,
        })?
    }

    /// Allows runs.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn arm(&mut self) -> Result<(), LinkError> {
        self.command("arming", &HostMessage::Arm)
    }

    /// Chooses the capture streams.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn capture(&mut self, mode: CaptureMode) -> Result<(), LinkError> {
        self.command("the capture mode", &HostMessage::Capture(mode))
    }

    /// Starts a run at constant duty.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn start_speed(&mut self, run: SpeedRun) -> Result<(), LinkError> {
        self.command("the run", &HostMessage::Speed(run))
    }

    /// Starts a closed-loop run.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn start_track(&mut self, run: TrackRun) -> Result<(), LinkError> {
        self.command("the run", &HostMessage::Track(run))
    }

    /// Passes a line to the driver board.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn driver(&mut self, line: heapless::String<64>) -> Result<(), LinkError> {
        self.command("the driver line", &HostMessage::Driver(line))
    }

    /// Stops the motor, clears faults, disarms.
    ///
    /// # Errors
    /// No answer.
    pub fn stop(&mut self) -> Result<(), LinkError> {
        self.command("stopping", &HostMessage::Stop)
    }

    /// Restarts the device.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn reboot(&mut self) -> Result<(), LinkError> {
        self.command("the reboot", &HostMessage::Reboot)
    }
}
