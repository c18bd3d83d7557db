//! What `twum live` shows: the latest target, position, speed, duty, state and faults, and their last half minute.
//!
//! Positions count from the board's zero, where it started or was aligned. A run's ticks count from where the run began, so
//! that place is added to them.
//!
//! It is fed with messages and drawn a few times a second by whoever shows it; nothing here waits, so that whoever records is
//! never held up.

use serde::Serialize;
use std::collections::VecDeque;
use twum_files::input::printable;
use twum_shared::Fault;
use twum_shared::message::{DeviceMessage, Mode};

/// How much of the past is shown, µs.
pub const SHOWN_US: u64 = 30_000_000;
/// One point is kept for so much time, µs.
const POINT_EVERY_US: u64 = 50_000;
/// The speed is the distance travelled in this time, µs.
const SPEED_OVER_US: u64 = 300_000;

/// One moment, every 50 ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// The board's clock, µs.
    pub time_us: u64,
    /// Wanted position in degrees, in a closed loop.
    pub target_deg: Option<f64>,
    /// Position in degrees.
    pub position_deg: f64,
    /// Mean speed over the last 0.3 s, rpm.
    pub speed_rpm: f64,
    /// Signed fraction of the PWM period with drive on.
    pub duty: f64,
    /// The board's state.
    pub mode: Option<Mode>,
    /// The latched fault.
    pub fault: Option<Fault>,
}

/// The state of a board as the host last heard it.
#[derive(Debug, Clone, Default)]
pub struct LiveView {
    time_us: u64,
    mode: Option<Mode>,
    fault: Option<Fault>,
    target: Option<i32>,
    position: i32,
    /// Where the run began, on the board's count; none until a status has told.
    origin: Option<i32>,
    /// The last status' position, as long as no run has moved the rotor since.
    resting: Option<i32>,
    /// Signed fraction of the PWM period with drive on.
    duty: f64,
    lost_items: u32,
    late_ticks: u32,
    edges_per_rev: Option<u16>,
    duty_steps: u16,
    /// A run's last ticks may arrive behind its end.
    run_ended: bool,
    recent: VecDeque<(u64, i32)>,
    history: VecDeque<Point>,
    log: VecDeque<String>,
    /// Lines ever noted.
    noted: u64,
}

impl LiveView {
    /// Nothing heard yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message that the board sent at `time_us` of its clock.
    pub fn observe(&mut self, time_us: u64, message: &DeviceMessage) {
        if time_us < self.time_us {
            self.recent.clear();
            self.history.clear();
            self.note("the board has restarted".to_owned());
        }
        self.time_us = time_us;
        match message {
            DeviceMessage::Configured(configuration) => {
                self.edges_per_rev = Some(configuration.edges_per_rev);
                self.duty_steps = configuration.control.duty_steps;
            }
            DeviceMessage::Control(block) => {
                if let Some(sample) = block.samples.last().filter(|_| !self.run_ended) {
                    let origin = self.origin.unwrap_or(0);
                    self.target = Some(origin.wrapping_add(sample.target));
                    self.duty = f64::from(sample.on_steps) / f64::from(self.duty_steps.max(1))
                        * f64::from(sample.direction.sign());
                    self.moved(origin.wrapping_add(sample.position));
                }
            }
            DeviceMessage::Status(status) => {
                (self.mode, self.fault) = (Some(status.mode), status.fault);
                (self.lost_items, self.late_ticks) = (status.lost_items, status.late_ticks);
                if self.target.is_some() && self.origin.is_none() {
                    // What was shown so far stood on another zero; the rotor moves a few counts between tick and status.
                    self.origin = Some(status.position.wrapping_sub(self.position));
                    self.recent.clear();
                    self.history.clear();
                }
                if self.target.is_none() {
                    self.resting = Some(status.position);
                    self.duty = f64::from(status.duty.raw()) / f64::from(twum_shared::Duty::FULL.raw())
                        * f64::from(status.direction.sign());
                    self.moved(status.position);
                }
            }
            DeviceMessage::RunStarted { .. } => {
                self.recent.clear();
                self.run_ended = false;
                self.origin = self.resting.take();
                self.note("run started".to_owned());
            }
            DeviceMessage::RunEnded { end, .. } => {
                (self.target, self.duty, self.run_ended) = (None, 0.0, true);
                self.recent.clear();
                self.note(format!("run ended: {end:?}"));
            }
            DeviceMessage::Fault(report) => {
                self.fault = Some(report.fault);
                self.note(format!("fault {:?}: {}", report.fault, report.fault));
            }
            DeviceMessage::Nack { reason, .. } => self.note(format!("refused: {reason}")),
            DeviceMessage::Aligned => self.note("aligned".to_owned()),
            DeviceMessage::Log(line) => self.note(printable(line)),
            _ => {}
        }
    }

    fn note(&mut self, line: String) {
        self.noted += 1;
        self.log.push_back(format!("{:9.3} s  {line}", self.time_us as f64 * 1e-6));
        if self.log.len() > 100 {
            self.log.pop_front();
        }
    }

    fn moved(&mut self, position: i32) {
        self.position = position;
        self.recent.push_back((self.time_us, position));
        while self.recent.front().is_some_and(|(time_us, _)| self.time_us - time_us > SPEED_OVER_US) {
            self.recent.pop_front();
        }
        if self.history.back().is_none_or(|point| self.time_us - point.time_us >= POINT_EVERY_US) {
            self.history.push_back(Point {
                time_us: self.time_us,
                target_deg: self.target.map(|target| self.degrees(target)),
                position_deg: self.degrees(position),
                speed_rpm: self.speed_rpm(),
                duty: self.duty,
                mode: self.mode,
                fault: self.fault,
            });
            while self.history.front().is_some_and(|point| self.time_us - point.time_us > SHOWN_US) {
                self.history.pop_front();
            }
        }
    }

    /// The board's state, once it has told.
    pub fn mode(&self) -> Option<Mode> {
        self.mode
    }

    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Items the board had to drop.
    pub fn lost_items(&self) -> u32 {
        self.lost_items
    }

    /// Control ticks that came late.
    pub fn late_ticks(&self) -> u32 {
        self.late_ticks
    }

    /// The time that is shown last, µs of the board's clock.
    pub fn now_us(&self) -> u64 {
        self.history.back().map_or(self.time_us, |point| point.time_us)
    }

    /// Wanted position in counts from the board's zero, in a closed loop.
    pub fn target(&self) -> Option<i32> {
        self.target
    }

    /// Position in counts from the board's zero.
    pub fn position(&self) -> i32 {
        self.position
    }

    /// Signed fraction of the PWM period with drive on.
    pub fn duty(&self) -> f64 {
        self.duty
    }

    /// Counts as degrees.
    pub fn degrees(&self, counts: i32) -> f64 {
        f64::from(counts) * 360.0 / f64::from(self.edges_per_rev.unwrap_or(400).max(1))
    }

    /// The last half minute, oldest first.
    pub fn history(&self) -> impl Iterator<Item = &Point> {
        self.history.iter()
    }

    /// The lines noted after the first `seen`, oldest first (at most the last 100), and how many there have been.
    pub fn notes_after(&self, seen: u64) -> (impl Iterator<Item = &str>, u64) {
        let new = self.noted.saturating_sub(seen).min(self.log.len() as u64) as usize;
        (self.log.iter().skip(self.log.len() - new).map(String::as_str), self.noted)
    }

    /// Position in degrees from the board's zero.
    pub fn position_deg(&self) -> f64 {
        self.degrees(self.position)
    }

    /// Mean speed over the last 0.3 s, rpm.
    pub fn speed_rpm(&self) -> f64 {
        match (self.recent.front(), self.recent.back()) {
            (Some((from_us, from)), Some((to_us, to))) if to_us > from_us => {
                let turned = self.degrees(to.wrapping_sub(*from)) / 360.0;
                turned / ((to_us - from_us) as f64 * 1e-6) * 60.0
            }
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{configured, control_blocks};
    use twum_shared::step::ConfigSpec;

    #[test]
    fn speed_is_the_distance_over_the_last_moments() {
        let mut view = LiveView::new();
        view.observe(0, &configured(ConfigSpec::THESIS));
        // 100 counts/s over a 400-edge encoder are 15 rpm.
        for block in 0..100u64 {
            let mut message = control_blocks(ConfigSpec::THESIS, 0, 1).remove(0);
            message.samples.last_mut().unwrap().position = block as i32;
            view.observe(block * 10_000, &DeviceMessage::Control(message));
        }
        assert!((view.speed_rpm() - 15.0).abs() < 0.01, "{}", view.speed_rpm());
        assert!((view.position_deg() - 89.1).abs() < 1e-9, "{}", view.position_deg());
    }

    #[test]
    fn ticks_that_arrive_behind_the_end_of_their_run_do_not_revive_it() {
        let mut view = LiveView::new();
        view.observe(0, &configured(ConfigSpec::THESIS));
        let mut blocks = control_blocks(ConfigSpec::THESIS, 0, 40);
        let last = blocks.pop().unwrap();
        for block in blocks {
            view.observe(block.first_us, &DeviceMessage::Control(block));
        }
        let end = twum_shared::message::RunEnd::Completed;
        view.observe(400_000, &DeviceMessage::RunEnded { end, end_us: 320_000 });
        view.observe(401_000, &DeviceMessage::Control(last));
        assert_eq!((view.target, view.duty), (None, 0.0));
    }

    /// A run's ticks count from where it began; the status counts from the board's zero.
    #[test]
    fn a_run_that_begins_away_from_zero_does_not_jump() {
        let status = |position| {
            DeviceMessage::Status(twum_shared::message::Status {
                mode: Mode::Armed,
                fault: None,
                position,
                duty: twum_shared::Duty::OFF,
                direction: twum_shared::Direction::Cw,
                ticks: 0,
                late_ticks: 0,
                worst_late_us: 0,
                worst_duration_us: 0,
                edges: 0,
                lost_items: 0,
                bad_frames: 0,
            })
        };
        let mut view = LiveView::new();
        view.observe(0, &configured(ConfigSpec::THESIS));
        view.observe(100_000, &status(1000));
        view.observe(150_000, &DeviceMessage::RunStarted { start_us: 150_000 });
        let mut last = 0;
        for block in control_blocks(ConfigSpec::THESIS, 0, 200) {
            last = block.samples.last().unwrap().position;
            view.observe(150_000 + block.first_us, &DeviceMessage::Control(block));
        }
        assert_eq!(view.position, 1000 + last);
        let end = twum_shared::message::RunEnd::Completed;
        view.observe(2_000_000, &DeviceMessage::RunEnded { end, end_us: 1_900_000 });
        view.observe(2_100_000, &status(1000 + last));
        let shown: Vec<f64> = view.history().map(|point| point.position_deg).collect();
        let jump = shown.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        // At 35 rpm the rotor turns 10° in the 50 ms of a point.
        assert!(shown.len() > 10 && jump < 15.0, "{jump}: {shown:?}");
        // Watched from the middle of a run, the first status tells where it began.
        let mut late = LiveView::new();
        late.observe(0, &configured(ConfigSpec::THESIS));
        let block = control_blocks(ConfigSpec::THESIS, 0, 1).remove(0);
        let position = block.samples.last().unwrap().position;
        late.observe(10_000, &DeviceMessage::Control(block.clone()));
        late.observe(20_000, &status(500 + position));
        late.observe(30_000, &DeviceMessage::Control(block));
        assert_eq!(late.position, 500 + position);
    }

    #[test]
    fn memory_does_not_grow_with_the_time_watched() {
        let mut view = LiveView::new();
        let block = control_blocks(ConfigSpec::THESIS, 0, 1).remove(0);
        for tick in 0..50_000u64 {
            view.observe(tick * 8000, &DeviceMessage::Control(block.clone()));
        }
        assert!(view.history.len() <= (SHOWN_US / POINT_EVERY_US) as usize + 2);
        assert!(view.recent.len() <= (SPEED_OVER_US / 8000) as usize + 2);
    }
}
