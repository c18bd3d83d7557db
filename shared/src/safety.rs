//! Limits within which the motor may move. They travel with the configuration and are checked every control tick. Each is
//! bounded from both sides: one that is too wide to stop a runaway in time is refused like one that limits nothing.

use serde::{Deserialize, Serialize};

/// Limits; a zero count or time is never "off": [`Limits::validate`] refuses it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Silence of the session that holds the motor which stops it, ms.
    pub command_timeout_ms: u16,
    /// Duty (1/32768ths) for which `stall_ms` is meant. At any other duty the time is the one that gives the same product: it is
    /// the drive that was given, duty times time, that has to have moved the rotor.
    pub stall_duty: u16,
    /// How long a motor driven at `stall_duty` may go without an edge, ms.
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
    /// The slowest speed that counts as turning, in percent of the motor's in proportion to the duty. An encoder that shows less
    /// is taken for one that fails, one that shows more is believed.
    pub slowest_percent: u8,
    /// Duty (1/32768ths) below which a motor may be slower still, in proportion to the duty once more; zero for one that is not.
    pub slow_start_duty: u16,
}

/// No bound on the position lies farther out than where references end, counts.
const FARTHEST: u32 = 1 << 24;

impl Limits {
    /// Limits for the 30 mm PCBMotor: 35 rpm at full drive is 233 counts/s, start-up overshoots to 48 rpm (320 counts/s). A
    /// stall is half drive for 500 ms, a quarter of a second of full drive, in which this motor turns by 52°, 72° at most. The
    /// slowest speed leaves room for a load that takes three quarters of it, and below a seventh of the duty for a motor that
    /// takes 6 ms to start in every 20 ms period.
    pub const DEFAULT: Self = Self {
        command_timeout_ms: 500,
        stall_duty: 16_384,
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
        slowest_percent: 25,
        slow_start_duty: 4_681,
    };

    /// Checks that every limit limits, and stops in time.
    ///
    /// # Errors
    /// Names the first that does not.
    pub fn validate(&self) -> Result<(), LimitsError> {
        let within = [
            // Two seconds of full speed are more than a turn.
            ("command_timeout_ms", (1..=2_000).contains(&self.command_timeout_ms)),
            ("stall_duty", (1..=32_768).contains(&self.stall_duty)),
            ("stall_ms", (1..=2_000).contains(&self.stall_ms)),
            // 20 edges in the shortest period are 200 000 a second: no encoder, and more than the interrupt can serve.
            ("chatter_edges", (1..=20).contains(&self.chatter_edges)),
            // A quarter turn of a 400-edge encoder.
            ("wrong_direction_counts", (1..=100).contains(&self.wrong_direction_counts)),
            ("following_error_counts", (1..=FARTHEST).contains(&self.following_error_counts)),
            // 30 times the motor's top speed.
            ("overspeed_counts_s", (1..=10_000).contains(&self.overspeed_counts_s)),
            ("position_min", (-(FARTHEST as i32)..=0).contains(&self.position_min)),
            ("position_max", (0..=FARTHEST as i32).contains(&self.position_max)),
            ("late_tick_us", (1..=1_000).contains(&self.late_tick_us)),
            ("late_ticks", (1..=20).contains(&self.late_ticks)),
            // 5 s of a default stream.
            ("lost_items", (1..=10_000).contains(&self.lost_items)),
            ("slowest_percent", (1..=100).contains(&self.slowest_percent)),
            ("slow_start_duty", (0..=32_768).contains(&self.slow_start_duty)),
        ];
        match within.into_iter().find(|(_, limits)| !limits) {
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
    fn the_default_limits_are_valid_and_each_that_is_out_of_bounds_is_refused() {
        assert_eq!(Limits::DEFAULT.validate(), Ok(()));
        type Change = fn(&mut Limits);
        let broken: [(Change, &str); 26] = [
            (|l| l.command_timeout_ms = 0, "command_timeout_ms"),
            (|l| l.command_timeout_ms = 2_001, "command_timeout_ms"),
            (|l| l.stall_duty = 0, "stall_duty"),
            (|l| l.stall_duty = 32_769, "stall_duty"),
            (|l| l.stall_ms = 0, "stall_ms"),
            (|l| l.stall_ms = 2_001, "stall_ms"),
            (|l| l.chatter_edges = 0, "chatter_edges"),
            (|l| l.chatter_edges = 21, "chatter_edges"),
            (|l| l.wrong_direction_counts = 0, "wrong_direction_counts"),
            (|l| l.wrong_direction_counts = 101, "wrong_direction_counts"),
            (|l| l.following_error_counts = 0, "following_error_counts"),
            (|l| l.following_error_counts = (1 << 24) + 1, "following_error_counts"),
            (|l| l.overspeed_counts_s = 0, "overspeed_counts_s"),
            (|l| l.overspeed_counts_s = 10_001, "overspeed_counts_s"),
            (|l| l.position_min = 1, "position_min"),
            (|l| l.position_min = i32::MIN, "position_min"),
            (|l| l.position_max = -1, "position_max"),
            (|l| l.position_max = i32::MAX, "position_max"),
            (|l| l.late_tick_us = 0, "late_tick_us"),
            (|l| l.late_tick_us = 1_001, "late_tick_us"),
            (|l| l.late_ticks = 21, "late_ticks"),
            (|l| l.lost_items = 0, "lost_items"),
            (|l| l.lost_items = 10_001, "lost_items"),
            (|l| l.slowest_percent = 0, "slowest_percent"),
            (|l| l.slowest_percent = 101, "slowest_percent"),
            (|l| l.slow_start_duty = 32_769, "slow_start_duty"),
        ];
        let mut widest = Limits::DEFAULT;
        (widest.command_timeout_ms, widest.stall_duty, widest.stall_ms) = (2_000, 32_768, 2_000);
        (widest.chatter_edges, widest.wrong_direction_counts, widest.following_error_counts) = (20, 100, FARTHEST);
        (widest.overspeed_counts_s, widest.lost_items) = (10_000, 10_000);
        (widest.position_min, widest.position_max) = (-(FARTHEST as i32), FARTHEST as i32);
        (widest.late_tick_us, widest.late_ticks) = (1_000, 20);
        (widest.slowest_percent, widest.slow_start_duty) = (100, 32_768);
        assert_eq!(widest.validate(), Ok(()));
        for (change, name) in broken {
            let mut limits = Limits::DEFAULT;
            change(&mut limits);
            assert_eq!(limits.validate(), Err(LimitsError(name)));
        }
    }
}
