//! The commands that move the motor, and what may end them.

/// A command that moves the motor.
#[derive(Clone, Copy, PartialEq)]
pub struct Mover {
    pub name: &'static str,
    pub arguments: &'static [&'static str],
    /// Whether it makes a recording, or a folder of them.
    pub out: Option<&'static str>,
    /// The motion whose middle is waited for: alignment is the first, runs come after it.
    pub motion: u32,
    /// How long that motion lasts, ms.
    pub lasts_ms: u64,
}

pub const MOVERS: [Mover; 5] = [
    Mover { name: "track", arguments: &["track", "--seconds", "2"], out: Some("a.mcap"), motion: 2, lasts_ms: 2_000 },
    Mover {
        name: "speed",
        arguments: &["speed", "--duty", "1", "--seconds", "2"],
        out: Some("a.mcap"),
        motion: 2,
        lasts_ms: 2_000,
    },
    Mover {
        name: "experiment run, run 2",
        arguments: &["experiment", "run", "--duties", "1", "--trials", "2", "--seconds", "2"],
        out: Some("folder"),
        motion: 3,
        lasts_ms: 2_000,
    },
    Mover { name: "align", arguments: &["align"], out: None, motion: 1, lasts_ms: 500 },
    Mover { name: "driver", arguments: &["driver", "u2000"], out: Some("a.mcap"), motion: 1, lasts_ms: 2_000 },
];

/// The laws whose PWM is the tick's own, and most of whose ticks are off; and a tuning, whose runs are a series.
pub const GATED_AND_TUNED: [Mover; 3] = [
    Mover {
        name: "track, gated",
        arguments: &["track", "--control", "gated", "--seconds", "2"],
        out: Some("a.mcap"),
        motion: 2,
        lasts_ms: 2_000,
    },
    Mover {
        name: "track, planned",
        arguments: &["track", "--control", "planned", "--seconds", "2"],
        out: Some("a.mcap"),
        motion: 2,
        lasts_ms: 2_000,
    },
    Mover {
        name: TUNE,
        arguments: &["tune", "--draws", "10", "--seconds", "1"],
        out: Some("folder"),
        motion: 3,
        lasts_ms: 2_500,
    },
];
pub const TUNE: &str = "tune, run 2";

/// What happens in the middle of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    Signal(&'static str),
    WindowClosed,
    CablePulled,
    DiskFull,
    PipeClosed,
    BoardRestarts,
    StopsLost(u32),
    /// The host is killed while a viewer shows life.
    SecondViewer,
    Fault,
    /// The host is killed, and all it ever said comes again.
    Replayed,
}

pub const EVENTS: [Event; 16] = [
    Event::Signal("INT"),
    Event::Signal("TERM"),
    Event::Signal("HUP"),
    Event::Signal("QUIT"),
    Event::Signal("STOP"),
    Event::Signal("KILL"),
    Event::WindowClosed,
    Event::CablePulled,
    Event::DiskFull,
    Event::PipeClosed,
    Event::BoardRestarts,
    Event::StopsLost(1),
    Event::StopsLost(3),
    Event::SecondViewer,
    Event::Fault,
    Event::Replayed,
];

impl Event {
    pub fn name(self) -> String {
        match self {
            Self::Signal(name) => name.to_owned(),
            Self::WindowClosed => "window closed".to_owned(),
            Self::CablePulled => "cable pulled".to_owned(),
            Self::DiskFull => "disk full".to_owned(),
            Self::PipeClosed => "pipe closed".to_owned(),
            Self::BoardRestarts => "board restarts".to_owned(),
            Self::StopsLost(count) => format!("INT, {count} stop frames lost"),
            Self::SecondViewer => "KILL, a second viewer".to_owned(),
            Self::Fault => "a fault".to_owned(),
            Self::Replayed => "KILL, its frames replayed".to_owned(),
        }
    }

    /// Whether the host can still say something.
    pub fn host_lives(self) -> bool {
        !matches!(self, Self::Signal("STOP" | "KILL") | Self::CablePulled | Self::SecondViewer | Self::Replayed)
    }

    /// The exit codes it may have; none when it does not come to one by itself.
    pub fn codes(self, mover: Mover) -> Vec<Option<i32>> {
        match self {
            Self::Signal("INT" | "TERM" | "HUP" | "QUIT") | Self::WindowClosed | Self::StopsLost(_) => vec![Some(130)],
            // It goes on when it is let, and finds the fault.
            Self::Signal("STOP") => vec![Some(3)],
            Self::Signal(_) | Self::SecondViewer | Self::Replayed => vec![None],
            Self::CablePulled => vec![Some(5)],
            Self::DiskFull if mover.out.is_none() => vec![Some(0)],
            Self::DiskFull => vec![Some(2)],
            Self::PipeClosed => vec![Some(0)],
            Self::BoardRestarts => vec![Some(4)],
            Self::Fault => vec![Some(3)],
        }
    }

    /// Whether it ends the motion at all.
    pub fn ends(self, mover: Mover) -> bool {
        !(self == Self::PipeClosed || self == Self::DiskFull && mover.out.is_none())
    }
}
