//! What interrupts and tasks share: the encoder, commands, events, requests and counters. All of it is either atomic or
//! guarded by a short critical section.

use crate::count::Encoder;
use crate::mailbox::Mailbox;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};
use heapless::String;
use portable_atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};
use twum_shared::Fault;
use twum_shared::alignment::Failure;
use twum_shared::message::{Configuration, FaultReport, HostMessage, Losses, Mode, Pass, Refusal, RunEnd, Status};

/// What the control interrupt is told.
#[derive(Clone, Debug)]
pub enum Command {
    /// A host's command. Stopping is none of them: it has a slot of its own, `Shared::ask_stop`.
    Host {
        /// Sequence of its frame.
        of: u32,
        /// When it was heard, device time, µs.
        heard_us: u64,
        /// The command.
        message: HostMessage,
    },
    /// The alignment routine of this errand ended.
    AlignEnded(u32, Result<(), Failure>),
    /// The driver's text command of this errand ended.
    PassthroughEnded(u32),
}

/// Whether a command sets the motor in motion, or leads there.
const fn may_move(message: &HostMessage) -> bool {
    matches!(
        message,
        HostMessage::Align(_)
            | HostMessage::Arm { .. }
            | HostMessage::Speed { .. }
            | HostMessage::Track { .. }
            | HostMessage::Driver { .. }
    )
}

/// A stop, as it was asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    /// Sequence of the host's frame.
    pub of: u32,
    /// Whether a latched fault is cleared too.
    pub clear_fault: bool,
}

/// What the control interrupt tells the host, through the transmit task.
#[derive(Clone, Debug)]
pub enum Event {
    /// A hello came; answer with who we are, and how.
    Hello(Mode, Option<Fault>),
    /// Command taken.
    Ack(u32),
    /// Command refused.
    Nack(u32, Refusal),
    /// The configuration in force.
    Configured(Configuration),
    /// Aligned.
    Aligned,
    /// A run began.
    RunStarted(u64),
    /// A run ended.
    RunEnded(RunEnd, u64),
    /// A fault latched.
    Fault(FaultReport),
    /// A piece of the driver's reply.
    DriverReply(heapless::Vec<u8, 64>),
    /// The driver's command is over.
    DriverDone,
    /// A line for people.
    Log(String<96>),
    /// A session's pass.
    Pass(Pass),
}

/// What the driver task is asked to do, under the errand it was given.
#[derive(Clone, Debug)]
pub struct Errand {
    /// Stopping starts a new errand number, which is how the task learns that this one is over.
    pub number: u32,
    /// What to do.
    pub request: DriverRequest,
}

/// What the driver task can do.
#[derive(Clone, Debug)]
pub enum DriverRequest {
    /// Run the alignment routine.
    Align,
    /// Pass this line on and report until the motor stands.
    Passthrough(String<64>),
}

/// Shared by every interrupt and task of one board.
pub struct Shared {
    /// The encoder.
    pub encoder: Encoder,
    pub(crate) commands: Mailbox<Command, 8>,
    pub(crate) events: Mailbox<Event, 24>,
    pub(crate) driver: Signal<CriticalSectionRawMutex, Errand>,
    pub(crate) status: Signal<CriticalSectionRawMutex, Status>,
    stop: Signal<CriticalSectionRawMutex, Stop>,
    stopped: Signal<CriticalSectionRawMutex, u32>,
    /// Signalled when the board is to restart itself; the motor is already off.
    pub reboot: Signal<CriticalSectionRawMutex, ()>,
    keep: Signal<CriticalSectionRawMutex, Configuration>,
    keeper: AtomicBool,
    keeping: AtomicBool,
    requested_fault: AtomicU8,
    errand: AtomicU32,
    driver_busy: AtomicBool,
    line_us: AtomicU32,
    holder: AtomicU32,
    host_frames: AtomicU32,
    bad_frames: AtomicU32,
    ticks: AtomicU32,
    transmitted: AtomicU32,
    lost_ticks: AtomicU32,
    lost_words: AtomicU32,
    lost_edges: AtomicU32,
    lost_others: AtomicU32,
}

impl Default for Shared {
    fn default() -> Self {
        Self::new()
    }
}

impl Shared {
    /// Nothing happened yet.
    pub const fn new() -> Self {
        Self {
            encoder: Encoder::new(),
            commands: Mailbox::new(),
            events: Mailbox::new(),
            driver: Signal::new(),
            status: Signal::new(),
            stop: Signal::new(),
            stopped: Signal::new(),
            reboot: Signal::new(),
            keep: Signal::new(),
            keeper: AtomicBool::new(false),
            keeping: AtomicBool::new(false),
            requested_fault: AtomicU8::new(0),
            errand: AtomicU32::new(0),
            driver_busy: AtomicBool::new(false),
            line_us: AtomicU32::new(0),
            holder: AtomicU32::new(0),
            host_frames: AtomicU32::new(0),
            bad_frames: AtomicU32::new(0),
            ticks: AtomicU32::new(0),
            transmitted: AtomicU32::new(0),
            lost_ticks: AtomicU32::new(0),
            lost_words: AtomicU32::new(0),
            lost_edges: AtomicU32::new(0),
            lost_others: AtomicU32::new(0),
        }
    }

    /// Asks the control interrupt to latch a fault at its next tick. The first request since then wins.
    pub fn request_fault(&self, fault: Fault) {
        // A lost race means another fault is already requested, which stops the motor just as well.
        let _ = self.requested_fault.compare_exchange(0, fault.code(), Ordering::AcqRel, Ordering::Relaxed);
    }

    pub(crate) fn take_requested_fault(&self) -> Option<Fault> {
        if self.requested_fault.load(Ordering::Relaxed) == 0 {
            return None;
        }
        Fault::from_code(self.requested_fault.swap(0, Ordering::AcqRel))
    }

    /// Tells the host, or counts the loss where the queue is full: an event is never waited for.
    pub(crate) fn tell(&self, event: Event) {
        if self.events.push(event).is_err() {
            self.request_fault(Fault::QueueOverflow);
            self.lose_other();
        }
    }

    /// Asks for a stop at the next tick, ahead of every command, and takes back the commands that came before it and were not
    /// looked at yet. Called where commands come in, so that none overtakes a stop. There is always room: a second stop
    /// takes the first one's place, and clears a fault if either would.
    pub(crate) fn ask_stop(&self, stop: Stop) {
        for _ in 0..self.commands.len() {
            match self.commands.pull() {
                Some(Command::Host { of, message, .. }) if may_move(&message) => {
                    self.tell(Event::Nack(of, Refusal::Overtaken))
                }
                // There is room: this one just left.
                Some(other) => _ = self.commands.push(other),
                None => break,
            }
        }
        let clear_fault = stop.clear_fault || self.stop.try_take().is_some_and(|first| first.clear_fault);
        self.stop.signal(Stop { clear_fault, ..stop });
    }

    pub(crate) fn take_stop(&self) -> Option<Stop> {
        self.stop.try_take()
    }

    /// Acknowledges a stop; the acknowledgement waits behind nothing.
    pub(crate) fn have_stopped(&self, of: u32) {
        self.stopped.signal(of);
    }

    pub(crate) fn take_stopped(&self) -> Option<u32> {
        self.stopped.try_take()
    }

    /// The session that set the motor in motion, or may; zero for none.
    pub(crate) fn holder(&self) -> u32 {
        self.holder.load(Ordering::Acquire)
    }

    pub(crate) fn set_holder(&self, token: u32) {
        self.holder.store(token, Ordering::Release);
    }

    pub(crate) fn log(&self, text: &str) {
        self.tell(Event::Log(String::try_from(text).unwrap_or_default()));
    }

    /// This board keeps configurations.
    pub(crate) fn will_keep(&self) {
        self.keeper.store(true, Ordering::Release);
    }

    /// Hands a configuration to the board's store, if it has one. Until it is kept, the motor cannot be armed.
    pub(crate) fn have_kept(&self, configuration: Configuration) {
        if self.keeper.load(Ordering::Acquire) {
            self.keeping.store(true, Ordering::Release);
            self.keep.signal(configuration);
        }
    }

    pub(crate) async fn to_keep(&self) -> Configuration {
        self.keep.wait().await
    }

    pub(crate) fn kept(&self) {
        // Another one may have come while this one was written.
        if !self.keep.signaled() {
            self.keeping.store(false, Ordering::Release);
        }
    }

    pub(crate) fn is_keeping(&self) -> bool {
        self.keeping.load(Ordering::Acquire)
    }

    /// Waits for room: the control interrupt takes two commands a tick.
    pub(crate) async fn command(&self, mut command: Command) {
        while let Err(refused) = self.commands.push(command) {
            command = refused;
            Timer::after(Duration::from_millis(1)).await;
        }
    }

    pub(crate) fn errand(&self) -> u32 {
        self.errand.load(Ordering::Acquire)
    }

    /// Ends the driver task's errand, whether it has begun or not.
    pub(crate) fn end_errand(&self) {
        if self.driver.try_take().is_some() {
            self.driver_rests();
        }
        self.errand.fetch_add(1, Ordering::AcqRel);
    }

    pub(crate) fn begin_errand(&self, request: DriverRequest) {
        self.driver_busy.store(true, Ordering::Release);
        self.driver.signal(Errand { number: self.errand(), request });
    }

    /// Whether the driver board may still move the rotor by itself.
    pub(crate) fn is_driver_busy(&self) -> bool {
        self.driver_busy.load(Ordering::Acquire)
    }

    pub(crate) fn driver_rests(&self) {
        self.driver_busy.store(false, Ordering::Release);
        self.line_us.store(0, Ordering::Relaxed);
    }

    /// The driver board was seen to be busy with one line for so long.
    pub(crate) fn line_lasted(&self, line_us: u32) {
        self.line_us.fetch_max(line_us, Ordering::Relaxed);
    }

    /// For how long the driver board may go on by itself once its errand is over: the longest line of this errand, µs.
    pub(crate) fn line_us(&self) -> u32 {
        self.line_us.load(Ordering::Relaxed)
    }

    pub(crate) fn host_spoke(&self) {
        self.host_frames.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn host_frames(&self) -> u32 {
        self.host_frames.load(Ordering::Relaxed)
    }

    pub(crate) fn bad_frame(&self) {
        self.bad_frames.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn bad_frames(&self) -> u32 {
        self.bad_frames.load(Ordering::Relaxed)
    }

    pub(crate) fn ticked(&self) {
        self.ticks.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn ticks(&self) -> u32 {
        self.ticks.load(Ordering::Relaxed)
    }

    pub(crate) fn transmit_turned(&self) {
        self.transmitted.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn transmit_turns(&self) -> u32 {
        self.transmitted.load(Ordering::Relaxed)
    }

    pub(crate) fn lose_tick(&self) {
        self.lost_ticks.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn lose_word(&self) {
        self.lost_words.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn lose_edge(&self) {
        self.lost_edges.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn lose_other(&self) {
        self.lost_others.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn lost_edges(&self) -> u32 {
        self.lost_edges.load(Ordering::Relaxed)
    }

    pub(crate) fn losses(&self) -> Losses {
        Losses {
            ticks: self.lost_ticks.load(Ordering::Relaxed),
            words: self.lost_words.load(Ordering::Relaxed),
            edges: self.lost_edges(),
            others: self.lost_others.load(Ordering::Relaxed),
        }
    }

    pub(crate) fn lost_items(&self) -> u32 {
        let Losses { ticks, words, edges, others } = self.losses();
        ticks.wrapping_add(words).wrapping_add(edges).wrapping_add(others)
    }

    /// Whether a session holds the motor in this mode, and has to be heard.
    pub(crate) const fn is_held(mode: Mode) -> bool {
        matches!(mode, Mode::Aligning | Mode::Passthrough | Mode::Armed | Mode::Running)
    }

    /// Whether a mode lets the motor move in hardware mode.
    pub(crate) const fn is_live(mode: Mode) -> bool {
        matches!(mode, Mode::Armed | Mode::Running)
    }
}
