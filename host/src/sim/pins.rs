//! The simulated PWM and direction pins, seen as on and off phases of the drive.

use std::cell::RefCell;
use std::rc::Rc;
use twum_firmware::output::OutputStage;
use twum_shared::{Direction, Duty};

/// The state of the pins. The off part of a period comes first; a new duty takes effect with the next period.
#[derive(Clone, Debug)]
pub(super) struct Pins {
    period_us: u64,
    period_start_us: u64,
    duty: Duty,
    next_duty: Duty,
    pub direction: Direction,
    /// Whether the wires are PWM and direction (else the driver's UART).
    pub hardware: bool,
    /// The start-mark pin.
    pub mark: bool,
}

impl Default for Pins {
    fn default() -> Self {
        Self {
            period_us: 20_000,
            period_start_us: 0,
            duty: Duty::OFF,
            next_duty: Duty::OFF,
            direction: Direction::Ccw,
            hardware: false,
            mark: false,
        }
    }
}

impl Pins {
    fn on_from_us(&self) -> u64 {
        let on_us = u64::from(self.duty.on_counts(self.period_us as u32));
        self.period_start_us + self.period_us - on_us
    }

    /// Catches up with the periods that began up to `now_us`.
    pub fn turn(&mut self, now_us: u64) {
        while now_us >= self.period_start_us + self.period_us {
            self.period_start_us += self.period_us;
            self.duty = self.next_duty;
        }
    }

    /// The running period's duty, and its length (s).
    pub fn pwm(&self) -> (f64, f64) {
        let period_s = self.period_us as f64 * 1e-6;
        (f64::from(self.duty.on_counts(self.period_us as u32)) / self.period_us as f64, period_s)
    }

    /// Whether the drive is on at `now_us`, after [`Pins::turn`].
    pub fn drive_on(&self, now_us: u64) -> bool {
        self.hardware && !self.duty.is_off() && now_us >= self.on_from_us()
    }

    /// When the drive next may change, after `now_us`.
    pub fn next_change_us(&self, now_us: u64) -> u64 {
        let on_from = self.on_from_us();
        if on_from > now_us { on_from } else { self.period_start_us + self.period_us }
    }

    /// Whether the pins hold the motor off, now and in the next period.
    pub fn is_off(&self) -> bool {
        self.duty.is_off() && self.next_duty.is_off()
    }
}

/// The pins as the firmware's output stage.
#[derive(Clone, Debug, Default)]
pub(super) struct Stage {
    pub pins: Rc<RefCell<Pins>>,
}

impl OutputStage for Stage {
    fn off(&mut self) {
        let mut pins = self.pins.borrow_mut();
        (pins.duty, pins.next_duty) = (Duty::OFF, Duty::OFF);
    }

    fn drive(&mut self, duty: Duty, direction: Direction) {
        let mut pins = self.pins.borrow_mut();
        (pins.next_duty, pins.direction) = (duty, direction);
        if super::clock::now_us() == pins.period_start_us {
            pins.duty = duty;
        }
    }

    fn restart_period(&mut self) {
        let mut pins = self.pins.borrow_mut();
        pins.period_start_us = super::clock::now_us();
        pins.duty = pins.next_duty;
    }

    fn set_frequency(&mut self, hz: u16) {
        let mut pins = self.pins.borrow_mut();
        pins.period_us = 1_000_000 / u64::from(hz.max(1));
    }

    fn mark(&mut self, running: bool) {
        self.pins.borrow_mut().mark = running;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_off_part_comes_first_and_a_new_duty_waits_for_its_period() {
        super::super::clock::reset(0);
        let mut stage = Stage::default();
        stage.pins.borrow_mut().hardware = true;
        stage.restart_period();
        stage.drive(Duty::from_ratio(1, 4), Direction::Cw);
        let mut pins = stage.pins.borrow().clone();
        assert!(!pins.drive_on(14_999) && pins.drive_on(15_000));
        assert_eq!((pins.next_change_us(0), pins.next_change_us(15_000)), (15_000, 20_000));
        super::super::clock::set(5_000);
        stage.drive(Duty::FULL, Direction::Cw);
        pins = stage.pins.borrow().clone();
        assert!(!pins.drive_on(5_000));
        pins.turn(20_000);
        assert!(pins.drive_on(20_000));
    }
}
