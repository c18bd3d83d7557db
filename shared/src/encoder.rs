//! Counting the edges of a one-line encoder. The line says that the rotor moved by one edge, not which way: the way is
//! the direction pin's. A coasting rotor after a reversal is therefore counted in the new direction, and a swapped
//! direction **wire** cannot be seen at all; only a count sign configured against the drive can ([`crate::Fault::WrongDirection`]).

use crate::Direction;
use serde::{Deserialize, Serialize};

/// Which way the count moves while the direction pin is high.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum CountSign {
    /// Clockwise counts up: the convention everywhere else in this project.
    #[default]
    Positive,
    /// Clockwise counts down. Closing a loop over it is positive feedback.
    Reversed,
}

impl CountSign {
    /// What one edge adds to the count under this direction.
    pub const fn increment(self, direction: Direction) -> i32 {
        match self {
            Self::Positive => direction.sign(),
            Self::Reversed => -direction.sign(),
        }
    }
}

/// One transition of the encoder line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edge {
    /// When it was seen, µs of the device clock (the low 32 bits).
    pub time_us: u32,
    /// The level after it.
    pub level: bool,
    /// The direction pin at that time.
    pub direction: Direction,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversed_sign_counts_against_the_drive() {
        assert_eq!(CountSign::Positive.increment(Direction::Cw), 1);
        assert_eq!(CountSign::Positive.increment(Direction::Ccw), -1);
        assert_eq!(CountSign::Reversed.increment(Direction::Cw), -1);
    }
}
