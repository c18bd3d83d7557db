//! What stops the motor: faults that latch, and a stop that is never refused.

use super::monitor::Seen;
use super::{Control, UNCONFIGURED_PERIOD_US};
use crate::output::OutputStage;
use crate::shared::{Event, Shared, Stop};
use twum_shared::Fault;
use twum_shared::message::{FaultReport, Mode, RunEnd};
use twum_shared::safety::Limits;

/// Capture items that were lost, as the limit on them counts.
#[derive(Debug, Default)]
pub(super) struct Lost {
    pub in_a_row: u16,
    edges_seen: u32,
}

impl Lost {
    /// Counts an item, lost or not.
    pub fn count(&mut self, lost: bool) {
        self.in_a_row = if lost { self.in_a_row.saturating_add(1) } else { 0 };
    }

    /// Counts what the edge interrupt lost since the last look, once.
    fn look(&mut self, edges: u32) {
        if edges != self.edges_seen {
            self.in_a_row = self.in_a_row.saturating_add(1);
            self.edges_seen = edges;
        }
    }
}

impl<S: OutputStage> Control<'_, S> {
    /// Everything that can stop the motor, before anything that can move it.
    pub(super) fn observe(&mut self, now_us: u64, late_us: u64, position: i32) {
        let requested = self.shared.take_requested_fault();
        // Bytes lost while nothing can move cost a command, which the host repeats; they are counted, not latched.
        let requested = requested.filter(|fault| *fault != Fault::RxOverrun || Shared::is_live(self.mode));
        if let Some(fault) = requested {
            self.latch(fault, now_us, position);
        }
        self.lost.look(self.shared.lost_edges());
        // Alignment needs no configuration, but a host that is there.
        let (limits, period_us) = match &self.configured {
            Some(configured) => (&configured.message.limits, configured.message.control.period_us),
            None => (&Limits::DEFAULT, UNCONFIGURED_PERIOD_US),
        };
        self.timing.started(late_us, limits.late_tick_us);
        let seen = Seen {
            held: Shared::is_held(self.mode),
            live: Shared::is_live(self.mode),
            running: self.mode == Mode::Running,
            late_us,
            position,
            edges: self.shared.encoder.edges(),
            host_frames: self.shared.host_frames(),
            line_us: self.shared.line_us(),
            duty: self.output.duty(),
            direction: self.output.direction(),
            lost_in_a_row: self.lost.in_a_row,
        };
        if let Some(fault) = self.monitor.check(limits, period_us, seen) {
            self.latch(fault, now_us, position);
        }
    }

    pub(super) fn latch(&mut self, fault: Fault, now_us: u64, position: i32) {
        self.output.off();
        if self.fault.is_some() {
            return;
        }
        self.end_run(RunEnd::Fault(fault), now_us);
        self.fault = Some(fault);
        self.mode = Mode::Fault;
        self.release();
        self.shared.tell(Event::Fault(FaultReport { fault, off_us: now_us, position }));
    }

    /// Off at once. What the driver board does by itself ends within its line: only then is the motor said to be idle.
    pub(super) fn stop(&mut self, stop: Stop, now_us: u64) {
        self.output.off();
        self.end_run(RunEnd::Stopped, now_us);
        self.release();
        if stop.clear_fault {
            self.fault = None;
        }
        self.mode = match self.fault {
            Some(_) => Mode::Fault,
            None => Mode::Stopping,
        };
        self.shared.have_stopped(stop.of);
        self.timing.next_status_us = now_us;
    }

    /// Leaves [`Mode::Stopping`] once nothing moves.
    pub(super) fn settle(&mut self, now_us: u64) {
        if self.mode == Mode::Stopping && !self.shared.is_driver_busy() {
            self.mode = Mode::Idle;
            self.timing.next_status_us = now_us;
        }
    }
}
