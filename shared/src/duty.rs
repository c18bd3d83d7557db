//! What reaches the motor: a fraction of the PWM period with the drive on, and a direction.

use serde::{Deserialize, Serialize};

/// Sense of rotation. Clockwise is the direction pin high, and counts as positive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Direction {
    /// Direction pin high, positive counts.
    Cw,
    /// Direction pin low, negative counts.
    Ccw,
}

impl Direction {
    /// +1 for clockwise, -1 for counter-clockwise.
    pub const fn sign(self) -> i32 {
        match self {
            Self::Cw => 1,
            Self::Ccw => -1,
        }
    }

    /// The other one.
    pub const fn opposite(self) -> Self {
        match self {
            Self::Cw => Self::Ccw,
            Self::Ccw => Self::Cw,
        }
    }

    /// The level of the direction pin.
    pub const fn pin_high(self) -> bool {
        matches!(self, Self::Cw)
    }

    /// The direction a pin level stands for.
    pub const fn from_pin(high: bool) -> Self {
        if high { Self::Cw } else { Self::Ccw }
    }
}

/// Fraction of the PWM period with the drive **on**, in 1/32768ths: 0 is true off, [`Duty::FULL`] never off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "u16", into = "u16")]
pub struct Duty(u16);

/// A duty above one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("duty {0}/32768 is above 1")]
pub struct DutyAboveOne(pub u16);

impl Duty {
    /// No drive at all.
    pub const OFF: Self = Self(0);
    /// Drive on during the whole period.
    pub const FULL: Self = Self(1 << 15);

    /// `on` of `steps` equal parts of the period, saturating at [`Duty::FULL`]; no parts at all are off.
    pub const fn from_ratio(on: u16, steps: u16) -> Self {
        if steps == 0 {
            return Self::OFF;
        }
        if on >= steps {
            return Self::FULL;
        }
        Self(((on as u32 * Self::FULL.0 as u32 + steps as u32 / 2) / steps as u32) as u16)
    }

    /// The fraction in 1/32768ths.
    pub const fn raw(self) -> u16 {
        self.0
    }

    /// Whether the drive is never on.
    pub const fn is_off(self) -> bool {
        self.0 == 0
    }

    /// How many of `top` timer counts the drive is on, rounded to nearest, but never zero for a duty above zero.
    pub const fn on_counts(self, top: u32) -> u32 {
        let on = ((self.0 as u64 * top as u64 + (1 << 14)) >> 15) as u32;
        if on == 0 && self.0 != 0 && top > 0 { 1 } else { on }
    }
}

impl TryFrom<u16> for Duty {
    type Error = DutyAboveOne;

    fn try_from(raw: u16) -> Result<Self, DutyAboveOne> {
        if raw <= Self::FULL.0 { Ok(Self(raw)) } else { Err(DutyAboveOne(raw)) }
    }
}

impl From<Duty> for u16 {
    fn from(duty: Duty) -> u16 {
        duty.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thirty_second_is_exact_and_full_is_the_whole_timer() {
        assert_eq!(Duty::from_ratio(1, 32).raw(), 1024);
        assert_eq!(Duty::from_ratio(32, 32), Duty::FULL);
        assert_eq!(Duty::FULL.on_counts(16383), 16383);
        assert_eq!(Duty::from_ratio(16, 32).on_counts(16384), 8192);
    }

    #[test]
    fn a_ratio_is_rounded_to_the_nearest_part_and_nothing_of_nothing_is_off() {
        // 4/7 of 32768 is 18724.57; 2/7 is 9362.29.
        assert_eq!((Duty::from_ratio(4, 7).raw(), Duty::from_ratio(2, 7).raw()), (18_725, 9_362));
        assert_eq!((Duty::from_ratio(0, 0), Duty::from_ratio(5, 0)), (Duty::OFF, Duty::OFF));
        assert_eq!((Duty::from_ratio(0, 7), Duty::from_ratio(8, 7)), (Duty::OFF, Duty::FULL));
        assert!(Duty::OFF.is_off() && !Duty::FULL.is_off() && !Duty::from_ratio(1, 32_768).is_off());
        assert_eq!(u16::from(Duty::from_ratio(4, 7)), 18_725);
    }

    #[test]
    fn counts_are_rounded_to_the_nearest() {
        // A quarter of 6 is 1.5, of 5 is 1.25.
        assert_eq!((Duty::from_ratio(1, 4).on_counts(6), Duty::from_ratio(1, 4).on_counts(5)), (2, 1));
        assert_eq!(Duty::from_ratio(1, 4).on_counts(0), 0);
        assert_eq!(Duty::FULL.on_counts(u32::MAX), u32::MAX);
    }

    #[test]
    fn clockwise_is_the_pin_high_and_positive() {
        assert!(Direction::Cw.pin_high() && !Direction::Ccw.pin_high());
        assert_eq!((Direction::from_pin(true), Direction::from_pin(false)), (Direction::Cw, Direction::Ccw));
        assert_eq!((Direction::Cw.sign(), Direction::Ccw.sign()), (1, -1));
    }

    #[test]
    fn off_is_off_and_the_smallest_duty_is_not() {
        assert_eq!(Duty::OFF.on_counts(16383), 0);
        assert_eq!(Duty::try_from(1).map(|d| d.on_counts(32)), Ok(1));
        assert_eq!(Duty::try_from(32769), Err(DutyAboveOne(32769)));
    }
}
