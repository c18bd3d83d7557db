//! What is told of the ticks and of the board's state, ten times a second.

use super::Control;
use crate::output::OutputStage;
use twum_shared::message::Status;

/// Status is published every so many µs.
const STATUS_US: u64 = 100_000;

/// How the ticks went.
#[derive(Debug, Default)]
pub(super) struct Timing {
    pub ticks: u64,
    pub previous_duration_us: u16,
    worst_late_us: u32,
    worst_duration_us: u32,
    late_ticks: u32,
    pub next_status_us: u64,
}

impl Timing {
    /// A tick started so late.
    pub fn started(&mut self, late_us: u64, limit_us: u16) {
        self.worst_late_us = self.worst_late_us.max(late_us.min(u64::from(u32::MAX)) as u32);
        self.late_ticks = self.late_ticks.saturating_add(u32::from(late_us > u64::from(limit_us)));
    }

    /// It took so long.
    pub fn ended(&mut self, duration_us: u64) {
        self.previous_duration_us = duration_us.min(u64::from(u16::MAX)) as u16;
        self.worst_duration_us = self.worst_duration_us.max(duration_us.min(u64::from(u32::MAX)) as u32);
    }
}

impl<S: OutputStage> Control<'_, S> {
    pub(super) fn publish(&mut self, now_us: u64, position: i32) {
        if now_us < self.timing.next_status_us {
            return;
        }
        self.timing.next_status_us = now_us + STATUS_US;
        self.shared.status.signal(Status {
            mode: self.mode,
            fault: self.fault,
            position,
            duty: self.output.duty(),
            direction: self.output.direction(),
            ticks: self.timing.ticks,
            late_ticks: self.timing.late_ticks,
            worst_late_us: self.timing.worst_late_us,
            worst_duration_us: self.timing.worst_duration_us,
            edges: self.shared.encoder.edges(),
            lost_items: self.shared.lost_items(),
            bad_frames: self.shared.bad_frames(),
        });
    }
}
