//! Aligning the motor to the beginning of an encoder pulse, through the driver board's text mode.
//!
//! The routine asks the sensor's level, microsteps until it flips, steps back to see it flip back, and steps forward
//! again (thesis C.1, `align_Motor`). It is a pure state machine: told what happened, it says what to do next. Attempts
//! and every wait are bounded, so it ends whatever the driver board does.

use crate::driver::{self, Command, Line};

/// Sensor threshold between levels, mV (thesis C.1).
pub const THRESHOLD_MV: u16 = 2100;
/// Microsteps tried in one search (thesis C.1): more than an encoder edge is wide.
pub const SEARCH_MICROSTEPS: u16 = 100;
/// Lines that a search is given in: the board cannot be stopped within a line.
const SEARCH_LINES: u16 = SEARCH_MICROSTEPS / driver::LINE_MICROSTEPS;
/// Searches before giving up.
pub const MAX_ATTEMPTS: u8 = 4;

/// What the caller does next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Send a line, then collect the reply until `quiet_ms` pass without a byte, `first_ms` at most before the first one
    /// and `total_ms` in all; report [`Event::Reply`] or [`Event::Silence`].
    Ask {
        /// The line.
        line: Line,
        /// Wait for the first byte, ms.
        first_ms: u32,
        /// A pause that ends the reply, ms.
        quiet_ms: u32,
        /// Longest wait for the whole reply, ms.
        total_ms: u32,
    },
    /// Send a line whose reply does not matter, wait so long, then report [`Event::Waited`] with the encoder pin's level.
    Do {
        /// The line.
        line: Line,
        /// How long the driver may take, ms.
        wait_ms: u32,
    },
    /// The rotor stands at the beginning of a pulse.
    Aligned,
    /// It could not be aligned.
    Failed(Failure),
}

/// What happened since the last action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event<'a> {
    /// The driver's reply.
    Reply(&'a [u8]),
    /// No byte came in time.
    Silence,
    /// The wait is over; the encoder pin's level now.
    Waited(bool),
}

/// Why alignment ended without success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The driver board said nothing, in every attempt.
    DriverSilent,
    /// Its replies hold no level, or no edge could be confirmed.
    NoEdge,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Level,
    Search { level: bool, lines_left: u16 },
    Settle,
    StepBack { level: bool },
    StepForward { confirmed: bool },
    HardwareMode,
    Ended,
}

/// The alignment routine.
#[derive(Clone, Debug)]
pub struct Alignment {
    stage: Stage,
    attempts: u8,
    heard: bool,
}

impl Alignment {
    /// Starts the routine: itself, and the first action.
    pub fn start() -> (Self, Action) {
        let mut alignment = Self { stage: Stage::Level, attempts: 0, heard: false };
        let action = alignment.attempt();
        (alignment, action)
    }

    /// The next action, given what happened. Events that do not fit the stage count as a failed attempt.
    pub fn next(&mut self, event: Event<'_>) -> Action {
        self.heard |= matches!(event, Event::Reply(_));
        match (self.stage, event) {
            (Stage::Level, Event::Reply(reply)) => match driver::sensor_level(reply) {
                Ok(level) => self.search(level, SEARCH_LINES),
                Err(_) => self.attempt(),
            },
            (Stage::Search { level, lines_left: lines_left @ 1.. }, Event::Reply(reply))
                if driver::sensor_level(reply) == Ok(level) =>
            {
                self.search(level, lines_left)
            }
            (Stage::Search { .. }, Event::Reply(_)) => {
                // The pin is read with the driver at rest: the search's own replies say nothing more of it.
                self.stage = Stage::Settle;
                Action::Do { line: line(&[Command::SensorReport]), wait_ms: 100 }
            }
            (Stage::Settle, Event::Waited(level)) => {
                self.stage = Stage::StepBack { level };
                Action::Do { line: line(&[Command::Microsteps { count: 1, back: true }]), wait_ms: 100 }
            }
            (Stage::StepBack { level }, Event::Waited(now)) => {
                self.stage = Stage::StepForward { confirmed: now != level };
                Action::Do { line: line(&[Command::Microsteps { count: 1, back: false }]), wait_ms: 100 }
            }
            (Stage::StepForward { confirmed: true }, Event::Waited(_)) => {
                self.stage = Stage::HardwareMode;
                Action::Do { line: line(&[Command::HardwareMode]), wait_ms: 100 }
            }
            (Stage::HardwareMode, Event::Waited(_)) => {
                self.stage = Stage::Ended;
                Action::Aligned
            }
            _ => self.attempt(),
        }
    }

    /// Microsteps towards the other level, a line's worth.
    fn search(&mut self, level: bool, lines: u16) -> Action {
        self.stage = Stage::Search { level, lines_left: lines.saturating_sub(1) };
        let commands = [
            Command::Microsteps { count: 1, back: false },
            Command::SensorReport,
            Command::StopWhen { above: !level, millivolts: THRESHOLD_MV },
            Command::Repeat(driver::LINE_MICROSTEPS),
        ];
        Action::Ask { line: line(&commands), first_ms: 500, quiet_ms: 300, total_ms: 20_000 }
    }

    fn attempt(&mut self) -> Action {
        if self.attempts == MAX_ATTEMPTS {
            self.stage = Stage::Ended;
            return Action::Failed(if self.heard { Failure::NoEdge } else { Failure::DriverSilent });
        }
        self.attempts += 1;
        self.stage = Stage::Level;
        Action::Ask { line: line(&[Command::SensorReport]), first_ms: 2_000, quiet_ms: 50, total_ms: 3_000 }
    }
}

/// Lines here hold at most four commands, half of what fits.
fn line(commands: &[Command]) -> Line {
    Line::from_slice(commands).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    fn text(action: &Action) -> std::string::String {
        match action {
            Action::Ask { line, .. } | Action::Do { line, .. } => driver::write(line).unwrap().as_str().into(),
            other => std::format!("{other:?}"),
        }
    }

    #[test]
    fn both_levels_search_for_the_other() {
        for (reply, search) in [(b"0 \r\n", "u1,ap,ADC>2100?S,x20"), (b"1 \r\n", "u1,ap,ADC<2100?S,x20")] {
            let (mut alignment, first) = Alignment::start();
            assert_eq!(text(&first), "ap");
            assert_eq!(text(&alignment.next(Event::Reply(reply))), search);
        }
    }

    #[test]
    fn a_search_is_the_thesis_s_hundred_microsteps_in_lines_that_can_be_stopped_between() {
        let (mut alignment, _) = Alignment::start();
        let mut action = alignment.next(Event::Reply(b"0 \r\n"));
        for _ in 0..SEARCH_MICROSTEPS / driver::LINE_MICROSTEPS {
            assert_eq!(text(&action), "u1,ap,ADC>2100?S,x20");
            action = alignment.next(Event::Reply(b"0 \r\n"));
        }
        assert_eq!(text(&action), "ap");
    }

    #[test]
    fn a_confirmed_edge_ends_in_hardware_mode() {
        let (mut alignment, _) = Alignment::start();
        alignment.next(Event::Reply(b"0 \r\n"));
        assert_eq!(text(&alignment.next(Event::Reply(b"1 \r\n"))), "ap");
        assert_eq!(text(&alignment.next(Event::Waited(true))), "u1-");
        assert_eq!(text(&alignment.next(Event::Waited(false))), "u1");
        assert_eq!(text(&alignment.next(Event::Waited(true))), "t");
        assert_eq!(alignment.next(Event::Waited(true)), Action::Aligned);
    }

    #[test]
    fn an_unconfirmed_edge_starts_over_and_ends() {
        let (mut alignment, mut action) = Alignment::start();
        let mut rounds = 0;
        loop {
            action = match action {
                Action::Ask { .. } => alignment.next(Event::Reply(b"0 \r\n")),
                Action::Do { .. } => alignment.next(Event::Waited(true)),
                ended => {
                    assert_eq!(ended, Action::Failed(Failure::NoEdge));
                    break;
                }
            };
            rounds += 1;
            assert!(rounds < 100, "alignment must end");
        }
    }

    #[test]
    fn silence_and_garbage_are_told_apart() {
        for (event, failure) in [(Event::Silence, Failure::DriverSilent), (Event::Reply(b"@@@@@@"), Failure::NoEdge)] {
            let (mut alignment, mut action) = Alignment::start();
            let mut rounds = 0;
            while !matches!(action, Action::Failed(_)) {
                action = alignment.next(event);
                rounds += 1;
                assert!(rounds < 100);
            }
            assert_eq!(action, Action::Failed(failure));
        }
    }
}
