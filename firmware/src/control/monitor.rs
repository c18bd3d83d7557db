//! The fault monitors of the control interrupt: what is seen each tick against the configured limits.

use twum_shared::message::Configuration;
use twum_shared::safety::Limits;
use twum_shared::stall::Stall;
use twum_shared::{Direction, Duty, Fault};

/// Speed is judged over this window.
const SPEED_WINDOW_US: u32 = 50_000;

/// What one tick sees.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// A session holds the motor, and has to be heard.
    pub held: bool,
    /// Armed or running.
    pub live: bool,
    pub running: bool,
    pub late_us: u64,
    pub position: i32,
    pub edges: u32,
    pub host_frames: u32,
    /// For how long the driver board goes on by itself after its errand is over, µs.
    pub line_us: u32,
    /// The drive since the tick before.
    pub duty: Duty,
    pub direction: Direction,
    pub lost_in_a_row: u16,
}

/// What the monitors remember between ticks.
#[derive(Debug, Default)]
pub(super) struct Monitor {
    position: i32,
    edges: u32,
    host_frames: u32,
    silent_us: u32,
    stall: Stall,
    against: u32,
    late: u8,
    window_us: u32,
    window_position: i32,
    fresh: bool,
}

impl Monitor {
    pub fn new(configuration: &Configuration) -> Self {
        Self { stall: Stall::new(configuration), ..Self::default() }
    }

    /// Forgets the past: a run is judged from its own start.
    pub fn reset(&mut self) {
        *self = Self { host_frames: self.host_frames, stall: self.stall.anew(), ..Self::default() };
    }

    /// The fault this tick shows, if any.
    pub fn check(&mut self, limits: &Limits, period_us: u32, seen: Seen) -> Option<Fault> {
        if !self.fresh {
            (self.position, self.edges, self.window_position) = (seen.position, seen.edges, seen.position);
            (self.host_frames, self.fresh) = (seen.host_frames, true);
        }
        let moved = seen.position.wrapping_sub(self.position);
        let edges = seen.edges.wrapping_sub(self.edges);
        let host_spoke = seen.host_frames != self.host_frames;
        (self.position, self.edges, self.host_frames) = (seen.position, seen.edges, seen.host_frames);

        self.silent_us = if host_spoke || !seen.held { 0 } else { self.silent_us.saturating_add(period_us) };
        let late = seen.late_us > u64::from(limits.late_tick_us);
        self.late = if late { self.late.saturating_add(1) } else { 0 };
        let overrun =
            self.late >= limits.late_ticks || seen.late_us > u64::from(period_us) * u64::from(limits.late_ticks);
        if seen.live && overrun {
            return Some(Fault::LoopOverrun);
        }
        // What the driver board does by itself ends with its line, and so the line has to end within the timeout. However slow the board
        // is, half of it is left for the next sign of life.
        let timeout_us = u32::from(limits.command_timeout_ms) * 1_000;
        if self.silent_us.saturating_add(seen.line_us.min(timeout_us / 2)) > timeout_us {
            return Some(Fault::CommandTimeout);
        }
        if !seen.live {
            return None;
        }
        if seen.lost_in_a_row >= limits.lost_items {
            return Some(Fault::QueueOverflow);
        }
        if edges > u32::from(limits.chatter_edges) {
            return Some(Fault::EncoderChatter);
        }
        if !seen.running {
            return None;
        }
        self.moving(limits, period_us, seen, moved, edges)
    }

    fn moving(&mut self, limits: &Limits, period_us: u32, seen: Seen, moved: i32, edges: u32) -> Option<Fault> {
        let along = moved.saturating_mul(seen.direction.sign());
        self.against = match along {
            0 => self.against,
            1.. => 0,
            _ => self.against.saturating_add(along.unsigned_abs()),
        };
        if self.against >= u32::from(limits.wrong_direction_counts) {
            return Some(Fault::WrongDirection);
        }
        if self.stall.check(seen.duty, edges) {
            return Some(Fault::EncoderStall);
        }
        if seen.position < limits.position_min || seen.position > limits.position_max {
            return Some(Fault::PositionBound);
        }
        self.window_us += period_us;
        if self.window_us >= SPEED_WINDOW_US {
            let travelled = u64::from(seen.position.wrapping_sub(self.window_position).unsigned_abs());
            let speed = travelled * 1_000_000 / u64::from(self.window_us.max(1));
            (self.window_us, self.window_position) = (0, seen.position);
            if speed > u64::from(limits.overspeed_counts_s) {
                return Some(Fault::Overspeed);
            }
        }
        None
    }
}
