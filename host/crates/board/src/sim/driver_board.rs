//! The PCBMotor driver board: its text mode, and hardware mode, which only cycling its power leaves.
//!
//! The `ap` reply is known only in the place of its sensor level (fourth byte from the end); the rest of the text here is
//! this project's.

use super::wire::Wire;
use twum_shared::driver::{self, Command, Line, MAX_LINE};

/// How well the driver board is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DriverHealth {
    /// Answers and moves the rotor.
    #[default]
    Well,
    /// Never answers.
    Silent,
    /// Answers with noise.
    Garbage,
    /// Answers, but its microsteps do not move the rotor.
    Lame,
    /// Takes five times as long for a microstep.
    Slow,
}

/// Rotor motion of one microstep, rad: 0.05°.
const MICROSTEP_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Time a microstep takes, µs.
const MICROSTEP_US: u64 = 2_000;
/// Time the board needs to understand a line, µs.
const LINE_US: u64 = 1_500;

/// Work in progress: the commands of a line, the one being executed, and how often the line still repeats.
#[derive(Debug)]
struct Work {
    line: Line,
    at: usize,
    repeats: u16,
    /// Microsteps to come before the next command, and their way.
    steps: (u16, bool),
    ready_us: u64,
}

/// The driver board.
#[derive(Debug)]
pub(super) struct DriverBoard {
    pub health: DriverHealth,
    pub hardware: bool,
    received: String,
    work: Option<Work>,
}

impl DriverBoard {
    pub fn new(health: DriverHealth) -> Self {
        Self { health, hardware: false, received: String::new(), work: None }
    }

    /// When the board has something to do.
    pub fn next_us(&self, from_host: &Wire) -> Option<u64> {
        if self.hardware {
            return None;
        }
        match &self.work {
            Some(work) => Some(work.ready_us),
            None => from_host.next_arrival_us(),
        }
    }

    /// Reads what arrived, executes the command that is due, and gives the angle by which it moves the rotor, rad. `level`
    /// is the encoder's.
    pub fn turn(&mut self, now_us: u64, from_host: &Wire, to_host: &Wire, level: bool) -> f64 {
        if self.hardware || self.health == DriverHealth::Silent {
            from_host.clear();
            return 0.0;
        }
        while self.work.is_none() {
            let Some(byte) = from_host.receive(now_us) else { return 0.0 };
            match byte {
                b'\n' => {}
                b'\r' => self.accept(now_us, to_host),
                _ if self.received.len() < MAX_LINE => self.received.push(char::from(byte)),
                _ => self.received.clear(),
            }
        }
        if self.work.as_ref().is_some_and(|work| work.ready_us <= now_us) {
            return self.execute(now_us, to_host, level);
        }
        0.0
    }

    fn accept(&mut self, now_us: u64, to_host: &Wire) {
        let text = std::mem::take(&mut self.received);
        match driver::parse(&text) {
            Ok(line) => {
                let repeats = line.iter().find_map(|c| if let Command::Repeat(n) = c { Some(*n) } else { None });
                let repeats = repeats.unwrap_or(1);
                self.work = Some(Work { line, at: 0, repeats, steps: (0, false), ready_us: now_us + LINE_US });
            }
            Err(_) => reply(to_host, now_us, "?\r\n"),
        }
    }

    fn execute(&mut self, now_us: u64, to_host: &Wire, high: bool) -> f64 {
        let Some(work) = &mut self.work else { return 0.0 };
        if let (1.., back) = work.steps {
            work.steps.0 -= 1;
            work.ready_us = now_us + if self.health == DriverHealth::Slow { 5 * MICROSTEP_US } else { MICROSTEP_US };
            return match self.health {
                DriverHealth::Lame => 0.0,
                _ if back => -MICROSTEP_RAD,
                _ => MICROSTEP_RAD,
            };
        }
        let Some(&command) = work.line.get(work.at) else {
            work.repeats = work.repeats.saturating_sub(1);
            work.at = 0;
            if work.repeats == 0 {
                self.work = None;
            }
            return 0.0;
        };
        work.at += 1;
        match command {
            Command::SensorReport if self.health == DriverHealth::Garbage => reply(to_host, now_us, "\u{7f}@#?~!"),
            Command::SensorReport => {
                let millivolts = if high { 2_950 } else { 310 };
                reply(to_host, now_us, &format!("ap {millivolts} {} \r\n", u8::from(high)));
                work.ready_us = now_us + 200;
            }
            Command::Microsteps { count, back } => work.steps = (count, back),
            Command::HardwareMode => {
                self.hardware = true;
                self.work = None;
            }
            Command::StopWhen { above, millivolts } => {
                let sensor = if high { 2_950 } else { 310 };
                if (above && sensor > millivolts) || (!above && sensor < millivolts) {
                    self.work = None;
                }
            }
            Command::Repeat(_) => {}
        }
        0.0
    }
}

fn reply(to_host: &Wire, now_us: u64, text: &str) {
    for byte in text.bytes() {
        to_host.send(now_us, byte);
    }
}
