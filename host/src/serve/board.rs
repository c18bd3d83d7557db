//! What the board says of itself, as the page shows it: its own status, what is in force, and the last ten minutes in points.
//!
//! It is fed with every frame that arrives, on the thread that owns the port. Nothing here waits: pages read it at their own
//! pace, and one that is late finds the oldest points gone.

use crate::link::Received;
use crate::record::live::{LiveView, Point};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use twum_shared::Fault;
use twum_shared::message::{Configuration, DeviceMessage, Identity, Mode, Status};

/// Points that are kept: ten minutes at 20 a second.
const POINTS: usize = 12_000;
/// A status, of which ten come a second, says how the board is for so long.
const KNOWN: Duration = Duration::from_secs(1);
/// Lines that are kept for pages that come later.
const LINES: usize = 200;

/// One point of the live plots: time in s since the server began, target and position in degrees, speed in rpm, signed duty.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shown(pub f64, pub Option<f64>, pub f64, pub f64, pub f64);

/// What is new to a page.
#[derive(Debug, Serialize)]
pub struct News {
    /// The state now.
    pub state: State,
    /// Points since the last time, oldest first.
    pub points: Vec<Shown>,
    /// Lines since the last time.
    pub lines: Vec<String>,
}

/// Where a page stands.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cursor {
    point: u64,
    line: u64,
}

/// A fault in words.
#[derive(Clone, Debug, Serialize)]
pub struct FaultWords {
    name: String,
    words: String,
    what_to_do: &'static str,
}

/// The board as it says it is, and what the server is doing with it.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    /// Whether the port is open and the board has answered.
    pub connected: bool,
    /// What is wrong with the port, in a sentence.
    pub trouble: Option<String>,
    /// The port's name.
    pub port: String,
    /// The board's mode, from its last status.
    pub mode: Option<Mode>,
    /// The latched fault.
    pub fault: Option<FaultWords>,
    /// Whether the board says that the drive is off and nothing turns; false where that is not known.
    pub is_off: bool,
    /// Whether the board has said lately how it is: without that nothing is known of its motor.
    pub is_known: bool,
    /// How long ago the last status came, ms.
    pub heard_ms_ago: Option<u64>,
    /// Chip.
    pub chip: Option<String>,
    /// Firmware.
    pub firmware: Option<String>,
    /// Why the board last started.
    pub reset: Option<String>,
    /// Control ticks that came late, since the board started.
    pub late_ticks: u32,
    /// Latest start of a tick, µs.
    pub worst_late_us: u32,
    /// Longest tick, µs.
    pub worst_duration_us: u32,
    /// Items the board had to drop.
    pub lost_items: u32,
    /// Position, degrees from the board's zero.
    pub position_deg: f64,
    /// What the server is doing with the board.
    pub doing: Option<Doing>,
    /// How the last run went.
    pub last: Option<Ended>,
    /// Changes with every new configuration.
    pub configuration_version: u64,
}

/// What the server is doing with the board.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Doing {
    /// In words.
    pub what: String,
    /// Where it is recorded.
    pub recording: Option<String>,
    /// How long it lasts, s, where that is known.
    pub seconds: Option<f64>,
    /// For how long it has lasted, s.
    pub elapsed_s: f64,
}

impl Doing {
    /// What is not recorded, for as long as it takes.
    pub const fn new(what: String) -> Self {
        Self { what, recording: None, seconds: None, elapsed_s: 0.0 }
    }
}

/// How something ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ended {
    /// The recording's name, where there is one.
    pub recording: Option<String>,
    /// Whether it came to its end.
    pub ok: bool,
    /// In words.
    pub words: String,
}

/// What a person does about a fault.
fn what_to_do(fault: Fault) -> &'static str {
    match fault {
        Fault::CommandTimeout => {
            "The board heard nothing from this computer for too long. Look at the cable, then clear the fault."
        }
        Fault::EncoderStall => "Look whether the rotor is free and the encoder is plugged in, then clear the fault.",
        Fault::WrongDirection => "Look at count_sign and at the encoder's wiring, then clear the fault.",
        Fault::FollowingError | Fault::Overspeed | Fault::PositionBound => {
            "Look at the last run and at the limits, then clear the fault."
        }
        Fault::AlignFailed | Fault::DriverSilent => {
            "Look at the driver board's power and its wires, then clear the fault."
        }
        _ => "Look for its cause (docs/safety.md), then clear the fault.",
    }
}

struct Inner {
    view: LiveView,
    identity: Option<Identity>,
    configuration: Option<Configuration>,
    configuration_version: u64,
    status: Option<(Status, Instant)>,
    trouble: Option<String>,
    connected: bool,
    doing: Option<(Doing, Instant)>,
    last: Option<Ended>,
    points: VecDeque<Shown>,
    /// Points ever made.
    made: u64,
    last_point_us: Option<u64>,
    /// Server's time less the board's, µs.
    offset_us: i64,
    last_us: u64,
    lines: VecDeque<String>,
    said: u64,
    noted: u64,
}

/// What everybody may look at.
pub struct Board {
    inner: Mutex<Inner>,
    changed: watch::Sender<u64>,
    began: Instant,
    port: String,
}

impl Board {
    /// Nothing heard yet.
    pub fn new(port: &str) -> Self {
        let inner = Inner {
            view: LiveView::new(),
            identity: None,
            configuration: None,
            configuration_version: 0,
            status: None,
            trouble: Some(format!("{port} is not open yet")),
            connected: false,
            doing: None,
            last: None,
            points: VecDeque::new(),
            made: 0,
            last_point_us: None,
            offset_us: 0,
            last_us: u64::MAX,
            lines: VecDeque::new(),
            said: 0,
            noted: 0,
        };
        Self { inner: Mutex::new(inner), changed: watch::channel(0).0, began: Instant::now(), port: port.to_owned() }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().expect("nothing panics while it holds the state")
    }

    /// While this lives nobody is told or shown anything.
    #[cfg(test)]
    pub fn held(&self) -> impl Sized {
        self.lock()
    }

    fn tell(&self) {
        self.changed.send_modify(|version| *version += 1);
    }

    /// Tells when something is new.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Takes what the board said.
    pub fn observe(&self, received: &Received) {
        let Received { header, message } = received;
        let mut inner = self.lock();
        if header.time_us < inner.last_us {
            inner.offset_us = self.began.elapsed().as_micros() as i64 - header.time_us as i64;
            inner.last_point_us = None;
        }
        inner.last_us = header.time_us;
        match message {
            DeviceMessage::Hello(identity) => inner.identity = Some(identity.clone()),
            DeviceMessage::Configured(configuration) => inner.configure(Some(*configuration)),
            DeviceMessage::Status(status) => inner.status = Some((*status, Instant::now())),
            _ => {}
        }
        inner.view.observe(header.time_us, message);
        let news = inner.take_point() | inner.take_notes();
        drop(inner);
        if news || !matches!(message, DeviceMessage::Control(_) | DeviceMessage::Edges(_) | DeviceMessage::Bits(_)) {
            self.tell();
        }
    }

    /// The board answers, and is configured so.
    pub fn connected(&self, configuration: Option<Configuration>) {
        let mut inner = self.lock();
        (inner.connected, inner.trouble) = (true, None);
        if inner.configuration != configuration {
            inner.configure(configuration);
        }
        drop(inner);
        self.tell();
    }

    /// The board cannot be reached, and why.
    pub fn lost(&self, why: &str) {
        let mut inner = self.lock();
        if inner.trouble.as_deref() != Some(why) {
            inner.say(why.to_owned());
        }
        (inner.connected, inner.trouble) = (false, Some(why.to_owned()));
        // What it said last is nothing that is known of it now.
        inner.status = None;
        drop(inner);
        self.tell();
    }

    /// Says a line to everybody.
    pub fn say(&self, line: impl Into<String>) {
        self.lock().say(line.into());
        self.tell();
    }

    /// What the server does with the board from here on.
    pub fn doing(&self, doing: Option<Doing>) {
        self.lock().doing = doing.map(|doing| (doing, Instant::now()));
        self.tell();
    }

    /// How far that is, in words.
    pub fn goes_on(&self, what: String) {
        if let Some((doing, _)) = &mut self.lock().doing {
            doing.what = what;
        }
        self.tell();
    }

    /// How it ended.
    pub fn ended(&self, ended: Ended) {
        let mut inner = self.lock();
        inner.say(ended.words.clone());
        (inner.last, inner.doing) = (Some(ended), None);
        drop(inner);
        self.tell();
    }

    /// The configuration in force.
    pub fn configuration(&self) -> Option<Configuration> {
        self.lock().configuration
    }

    /// Who the board is.
    pub fn identity(&self) -> Option<Identity> {
        self.lock().identity.clone()
    }

    /// Silence of a page that holds the motor which stops it: that of this computer which stops the board.
    pub fn command_timeout(&self) -> Duration {
        let configured = self.lock().configuration.map_or(twum_shared::safety::Limits::DEFAULT, |it| it.limits);
        Duration::from_millis(configured.command_timeout_ms.into())
    }

    /// Whether something is going on that a person answers for: the server is doing something, or the board is neither idle
    /// nor in fault.
    pub fn is_at_work(&self) -> bool {
        let inner = self.lock();
        inner.doing.is_some() || inner.status.is_some_and(|(status, _)| !is_off(&status))
    }

    /// The state now.
    pub fn state(&self) -> State {
        self.lock().state(&self.port)
    }

    /// What is new since `cursor`, which is moved on.
    pub fn news(&self, cursor: &mut Cursor) -> News {
        let inner = self.lock();
        let new = |made: u64, seen: u64, kept: usize| (made - seen).min(kept as u64) as usize;
        let points = new(inner.made, cursor.point, inner.points.len());
        let lines = new(inner.said, cursor.line, inner.lines.len());
        *cursor = Cursor { point: inner.made, line: inner.said };
        News {
            state: inner.state(&self.port),
            points: inner.points.range(inner.points.len() - points..).copied().collect(),
            lines: inner.lines.range(inner.lines.len() - lines..).cloned().collect(),
        }
    }
}

fn is_off(status: &Status) -> bool {
    status.duty.is_off() && matches!(status.mode, Mode::Idle | Mode::Fault)
}

impl Inner {
    fn configure(&mut self, configuration: Option<Configuration>) {
        self.configuration = configuration;
        self.configuration_version += 1;
    }

    fn say(&mut self, line: String) {
        self.said += 1;
        self.lines.push_back(line);
        if self.lines.len() > LINES {
            self.lines.pop_front();
        }
    }

    fn take_notes(&mut self) -> bool {
        let (lines, noted) = self.view.notes_after(self.noted);
        let lines: Vec<String> = lines.map(str::to_owned).collect();
        self.noted = noted;
        let any = !lines.is_empty();
        lines.into_iter().for_each(|line| self.say(line));
        any
    }

    fn take_point(&mut self) -> bool {
        let Some(Point { time_us, target_deg, position_deg, speed_rpm, duty, .. }) =
            self.view.history().last().copied()
        else {
            return false;
        };
        if self.last_point_us == Some(time_us) {
            return false;
        }
        self.last_point_us = Some(time_us);
        let round = |value: f64, unit: f64| (value / unit).round() * unit + 0.0;
        let time_s = (time_us as i64 + self.offset_us) as f64 * 1e-6;
        // The encoder resolves no less than 0.036 degrees.
        let target_deg = target_deg.map(|target| round(target, 1e-3));
        let shown = Shown(
            round(time_s, 1e-3),
            target_deg,
            round(position_deg, 1e-3),
            round(speed_rpm, 1e-2),
            round(duty, 1e-4),
        );
        self.points.push_back(shown);
        self.made += 1;
        if self.points.len() > POINTS {
            self.points.pop_front();
        }
        true
    }

    fn state(&self, port: &str) -> State {
        let status = self.status.as_ref().map(|(status, _)| status);
        let is_known = self.connected && self.status.is_some_and(|(_, at)| at.elapsed() < KNOWN);
        let fault = |fault: Fault| FaultWords {
            name: format!("{fault:?}"),
            words: fault.to_string(),
            what_to_do: what_to_do(fault),
        };
        let identity = self.identity.as_ref();
        State {
            connected: self.connected,
            trouble: self.trouble.clone(),
            port: port.to_owned(),
            mode: status.map(|status| status.mode),
            fault: status.and_then(|status| status.fault).map(fault),
            is_off: is_known && status.is_some_and(is_off),
            is_known,
            heard_ms_ago: self.status.map(|(_, at)| at.elapsed().as_millis() as u64),
            chip: identity.map(|it| crate::input::printable(&it.chip)),
            firmware: identity.map(|it| crate::input::printable(&it.firmware)),
            reset: identity.map(|it| format!("{:?}", it.reset)),
            late_ticks: status.map_or(0, |status| status.late_ticks),
            worst_late_us: status.map_or(0, |status| status.worst_late_us),
            worst_duration_us: status.map_or(0, |status| status.worst_duration_us),
            lost_items: status.map_or(0, |status| status.lost_items),
            position_deg: self.view.position_deg(),
            doing: self
                .doing
                .as_ref()
                .map(|(doing, since)| Doing { elapsed_s: since.elapsed().as_secs_f64(), ..doing.clone() }),
            last: self.last.clone(),
            configuration_version: self.configuration_version,
        }
    }
}
