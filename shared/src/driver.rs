//! The PCBMotor driver board's text commands (19200 8N1), as far as the thesis shows them: commands joined by commas on
//! one line, ended by CR LF.
//!
//! `ap` reports the position sensor, `u1` / `u1-` make one microstep forward / back, `t` switches to hardware mode (left
//! only by cycling the board's power), `ADC>2100?S` ends the line's repetition when the sensor is above 2100 mV, `x100`
//! repeats the line up to 100 times.

use core::fmt::Write;
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Longest line, bytes, without its end.
pub const MAX_LINE: usize = 64;
/// Most microsteps the firmware gives the board in one line. No text command ends a motion that has begun, so what is still
/// to come when the motor has to stand is at most this: 1° at the 0.05° a microstep is here, 40 ms at 2 ms each.
pub const LINE_MICROSTEPS: u16 = 20;
/// Most commands on a line.
pub const MAX_COMMANDS: usize = 8;

/// One command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// `ap`: report the position sensor.
    SensorReport,
    /// `uN` or `uN-`: so many microsteps forward or back.
    Microsteps {
        /// How many.
        count: u16,
        /// Whether the step is back.
        back: bool,
    },
    /// `t`: hardware mode.
    HardwareMode,
    /// `ADC>N?S` or `ADC<N?S`: stop repeating when the sensor is above or below so many mV.
    StopWhen {
        /// Whether above (else below).
        above: bool,
        /// Threshold, mV.
        millivolts: u16,
    },
    /// `xN`: repeat the line up to N times.
    Repeat(u16),
}

/// A line of commands.
pub type Line = Vec<Command, MAX_COMMANDS>;

/// Why a line is not understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineError {
    /// An unknown command, by its index.
    #[error("command {0} on the line is not known")]
    Unknown(u8),
    /// More than [`MAX_COMMANDS`] commands.
    #[error("too many commands on the line")]
    TooMany,
    /// Longer than [`MAX_LINE`].
    #[error("the line is too long")]
    TooLong,
}

/// Parses a line without its end.
///
/// # Errors
/// The first command that is not understood, or a line out of bounds.
pub fn parse(line: &str) -> Result<Line, LineError> {
    if line.len() > MAX_LINE {
        return Err(LineError::TooLong);
    }
    let mut commands = Line::new();
    for (index, word) in line.split(',').enumerate() {
        let command = parse_command(word.trim()).ok_or(LineError::Unknown(index as u8))?;
        commands.push(command).map_err(|_| LineError::TooMany)?;
    }
    Ok(commands)
}

fn parse_command(word: &str) -> Option<Command> {
    if word == "ap" {
        return Some(Command::SensorReport);
    }
    if word == "t" {
        return Some(Command::HardwareMode);
    }
    if let Some(rest) = word.strip_prefix('u') {
        let (digits, back) = rest.strip_suffix('-').map_or((rest, false), |digits| (digits, true));
        return number(digits).map(|count| Command::Microsteps { count, back });
    }
    if let Some(rest) = word.strip_prefix('x') {
        return number(rest).map(Command::Repeat);
    }
    let condition = word.strip_prefix("ADC")?.strip_suffix("?S")?;
    let (above, digits) = match condition.strip_prefix('>') {
        Some(digits) => (true, digits),
        None => (false, condition.strip_prefix('<')?),
    };
    number(digits).map(|millivolts| Command::StopWhen { above, millivolts })
}

/// `str::parse` also takes a sign, which no command has.
fn number(digits: &str) -> Option<u16> {
    if digits.bytes().all(|byte| byte.is_ascii_digit()) { digits.parse().ok() } else { None }
}

/// Writes a line, without its end.
///
/// # Errors
/// [`LineError::TooLong`] when it does not fit.
pub fn write(line: &[Command]) -> Result<String<MAX_LINE>, LineError> {
    let mut text = String::new();
    for (index, command) in line.iter().enumerate() {
        if index > 0 {
            text.push(',').map_err(|_| LineError::TooLong)?;
        }
        let written = match *command {
            Command::SensorReport => text.push_str("ap").map_err(|_| core::fmt::Error),
            Command::Microsteps { count, back } => write!(text, "u{count}{}", if back { "-" } else { "" }),
            Command::HardwareMode => text.push('t').map_err(|_| core::fmt::Error),
            Command::StopWhen { above, millivolts } => {
                write!(text, "ADC{}{millivolts}?S", if above { '>' } else { '<' })
            }
            Command::Repeat(times) => write!(text, "x{times}"),
        };
        written.map_err(|_| LineError::TooLong)?;
    }
    Ok(text)
}

/// Why a reply to `ap` cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplyError {
    /// Shorter than four characters.
    #[error("the driver's reply is too short to hold a sensor level")]
    TooShort,
    /// The level's character is neither 0 nor 1.
    #[error("the driver's reply holds {0:#04x} where the sensor level should be")]
    NotALevel(u8),
}

/// The sensor level in a reply to `ap`: the fourth byte from the end, line end included. Nothing more of the reply is known.
///
/// # Errors
/// A reply too short, or without a level there.
pub fn sensor_level(reply: &[u8]) -> Result<bool, ReplyError> {
    let byte = reply.len().checked_sub(4).and_then(|at| reply.get(at)).ok_or(ReplyError::TooShort)?;
    match byte {
        b'0' => Ok(false),
        b'1' => Ok(true),
        other => Err(ReplyError::NotALevel(*other)),
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_alignment_line_reads_as_the_thesis_writes_it() {
        let line = parse("u1,ap,ADC>2100?S,x100").unwrap();
        assert_eq!(
            line.as_slice(),
            [
                Command::Microsteps { count: 1, back: false },
                Command::SensorReport,
                Command::StopWhen { above: true, millivolts: 2100 },
                Command::Repeat(100),
            ]
        );
        assert_eq!(write(&line).unwrap(), "u1,ap,ADC>2100?S,x100");
        assert_eq!(parse("u1-").unwrap().as_slice(), [Command::Microsteps { count: 1, back: true }]);
    }

    #[test]
    fn what_is_not_a_command_is_named() {
        assert_eq!(parse("u1,fly"), Err(LineError::Unknown(1)));
        assert_eq!(parse("u+1"), Err(LineError::Unknown(0)));
        assert_eq!(parse(""), Err(LineError::Unknown(0)));
        assert_eq!(parse("ADC=3?S"), Err(LineError::Unknown(0)));
        assert_eq!(parse("t,t,t,t,t,t,t,t,t"), Err(LineError::TooMany));
        assert_eq!(parse(&"t".repeat(65)), Err(LineError::TooLong));
        // The longest line there may be: spaces around a word are nothing.
        assert_eq!(parse(&std::format!("{:64}", "t")).unwrap().as_slice(), [Command::HardwareMode]);
    }

    #[test]
    fn the_level_is_the_fourth_byte_from_the_end() {
        assert_eq!(sensor_level(b"ap:1 \r\n"), Ok(true));
        assert_eq!(sensor_level(b"0 \r\n"), Ok(false));
        assert_eq!(sensor_level(b"1\r\n"), Err(ReplyError::TooShort));
        assert_eq!(sensor_level(b"what?\r\n"), Err(ReplyError::NotALevel(b't')));
    }

    proptest! {
        #[test]
        fn parsing_never_panics_and_writing_parses_back(text in "\\PC{0,80}") {
            if let Ok(line) = parse(&text) {
                let written = write(&line);
                if let Ok(written) = written {
                    prop_assert_eq!(parse(&written), Ok(line));
                }
            }
        }
    }
}
