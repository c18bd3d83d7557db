//! Limits within which the motor may move. They travel with the configuration and are checked every control tick.

use serde::{Deserialize, Serialize};

/// Limits; a zero count or time is never "off": [`Limits::validate`] refuses it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Silence of the host, while armed or running, that stops the motor, ms.
    pub command_timeout_ms: u16,
    /// Duty (1/32768ths) at and above which a standing encoder is a stall.
    pub stall_duty: u16,
    /// How long a driven motor may go without an edge, ms.
    pub stall_ms: u16,
    /// Edges within one control tick above which the encoder chatters.
    pub chatter_edges: u8,
    /// Counts moved against the drive that prove the count's sign wrong.
    pub wrong_direction_counts: u16,
    /// Largest position error while tracking, counts.
    pub following_error_counts: u32,
    /// Fastest allowed motion, counts/s, measured over 50 ms.
    pub overspeed_counts_s: u32,
    /// Lowest allowed position, counts.
    pub position_min: i32,
    /// Highest allowed position, counts.
    pub position_max: i32,
    /// A tick that starts later than this is late, µs.
    pub late_tick_us: u16,
    /// Consecutive late ticks that are an overrun.
    pub late_ticks: u8,
    /// Capture items lost in a row that are an overflow.
    pub lost_items: u16,
}

impl Limits {
    /// Limits for the 30 mm PCBMotor: 35 rpm at full drive is 233 counts/s, start-up overshoots to 48 rpm (320 counts/s).
    pub const DEFAULT: Self = Self {
        command_timeout_ms: 500,
        stall_duty: 8192,
        stall_ms: 500,
        chatter_edges: 4,
        wrong_direction_counts: 8,
        following_error_counts: 120,
        overspeed_counts_s: 600,
        position_min: -1_000_000,
        position_max: 1_000_000,
        late_tick_us: 100,
        late_ticks: 4,
        lost_items: 2_000,
    };

    /// Checks that every limit limits.
    ///
    /// # Errors
    /// Names the first that does not.
    pub fn validate(&self) -> Result<(), LimitsError> {
        let positive = [
            ("command_timeout_ms", self.command_timeout_ms != 0),
            ("stall_duty", (1..=32_768).contains(&self.stall_duty)),
            ("stall_ms", self.stall_ms != 0),
            ("chatter_edges", self.chatter_edges != 0),
            ("wrong_direction_counts", self.wrong_direction_counts != 0),
            ("following_error_counts", self.following_error_counts != 0),
            ("overspeed_counts_s", self.overspeed_counts_s != 0),
            ("position_min", self.position_min <= 0),
            ("position_max", self.position_max >= 0),
            ("late_tick_us", self.late_tick_us != 0),
            ("late_ticks", self.late_ticks != 0),
            ("lost_items", self.lost_items != 0),
        ];
        match positive.into_iter().find(|(_, limits)| !limits) {
            Some((name, _)) => Err(LimitsError(name)),
            None => Ok(()),
        }
    }
}

/// A limit that does not limit, by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("limit {0} is out of range")]
pub struct LimitsError(pub &'static str);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_limits_are_valid_and_each_zero_is_refused() {
        assert_eq!(Limits::DEFAULT.validate(), Ok(()));
        type Change = fn(&mut Limits);
        let broken: [(Change, &str); 12] = [
            (|l| l.command_timeout_ms = 0, "command_timeout_ms"),
            (|l| l.stall_duty = 32_769, "stall_duty"),
            (|l| l.stall_ms = 0, "stall_ms"),
            (|l| l.chatter_edges = 0, "chatter_edges"),
            (|l| l.wrong_direction_counts = 0, "wrong_direction_counts"),
            (|l| l.following_error_counts = 0, "following_error_counts"),
            (|l| l.overspeed_counts_s = 0, "overspeed_counts_s"),
            (|l| l.position_min = 1, "position_min"),
            (|l| l.position_max = -1, "position_max"),
            (|l| l.late_tick_us = 0, "late_tick_us"),
            (|l| l.late_ticks = 0, "late_ticks"),
            (|l| l.lost_items = 0, "lost_items"),
        ];
        for (change, name) in broken {
            let mut limits = Limits::DEFAULT;
            change(&mut limits);
            assert_eq!(limits.validate(), Err(LimitsError(name)));
        }
    }
}
