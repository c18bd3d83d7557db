//! The PWM unit (LEDC): one timer and one channel, as the reference manuals describe them. Times are cycles of its 80 MHz
//! clock. Sections are named, not numbered: their numbers differ between editions.

use super::Chip;
use twum_firmware::stage::{OFF, PERIOD, PWM_CLOCK_HZ, divider};

/// The unit.
#[derive(Clone, Debug)]
pub(super) struct Ledc {
    chip: Chip,
    /// The divider in force, the register, and whether it is to be taken, 1/256ths.
    divider: u32,
    divider_register: u32,
    timer_update: bool,
    /// Counts the output is high: in force, the register, and whether it is to be taken.
    duty: u32,
    duty_register: u32,
    duty_start: bool,
    channel_update: bool,
    /// When the counter was last zero.
    period_start: u64,
    /// Raw overflow interrupt.
    pub overflowed: bool,
}

impl Ledc {
    /// As the firmware sets the unit up: 50 Hz, told "off".
    pub const fn new(chip: Chip, now: u64) -> Self {
        Self {
            chip,
            divider: divider(50),
            divider_register: divider(50),
            timer_update: false,
            duty: OFF,
            duty_register: OFF,
            duty_start: false,
            channel_update: false,
            period_start: now,
            overflowed: false,
        }
    }

    fn cycles(&self, counts: u32) -> u64 {
        u64::from(self.divider) * u64::from(counts) / 256
    }

    /// Section "Timers": the counter counts to 2^resolution − 1 at the clock over the divider, whose low eight bits are a
    /// fraction, then overflows to zero.
    fn overflow_at(&self) -> u64 {
        self.period_start + self.cycles(PERIOD)
    }

    /// Section "PWM Generators": the output goes high when the counter reaches hpoint (0 here) and low when it reaches lpoint,
    /// which is hpoint + duty.
    fn falls_at(&self) -> u64 {
        self.period_start + self.cycles(self.duty)
    }

    /// The unit's output.
    pub fn output(&self, now: u64) -> bool {
        now < self.falls_at()
    }

    /// The fraction of the running period in which the output is low, none when told off, and the period's length (s).
    pub fn running(&self) -> (f64, f64) {
        let low = if self.duty == OFF { 0 } else { PERIOD - self.duty.min(PERIOD) };
        (f64::from(low) / f64::from(PERIOD), self.cycles(PERIOD) as f64 / f64::from(PWM_CLOCK_HZ))
    }

    /// When the output or the counter next does something, after `now`.
    pub fn next_event(&self, now: u64) -> u64 {
        Some(self.falls_at()).filter(|falls| *falls > now).unwrap_or(u64::MAX).min(self.overflow_at())
    }

    /// Lets the counter overflow, if it does at `now`; everything that waits for that happens.
    pub fn turn(&mut self, now: u64) {
        if now < self.overflow_at() {
            return;
        }
        self.period_start = self.overflow_at();
        // Section "Timers" of the C3's and C6's manual: a divider that was written is taken, after PARA_UP, at the next
        // overflow of the counter.
        if std::mem::take(&mut self.timer_update) {
            self.divider = self.divider_register;
        }
        // Section "PWM Generators": a duty that was written is taken at the next overflow after DUTY_START and PARA_UP.
        if self.duty_start && self.channel_update {
            self.duty = self.duty_register;
            (self.duty_start, self.channel_update) = (false, false);
        }
        // Section "Interrupts": TIMERx_OVF is raised when the counter reaches its maximum.
        self.overflowed = true;
    }

    pub const fn write_duty(&mut self, high: u32) {
        self.duty_register = high;
    }

    pub const fn start_duty(&mut self) {
        self.duty_start = true;
    }

    pub const fn update_channel(&mut self) {
        self.channel_update = true;
    }

    /// Section "Registers", CHn_DUTY_R: the current duty of the output signal.
    pub const fn loaded_duty(&self) -> u32 {
        self.duty
    }

    /// Whether the output is told off, now and for the next period.
    pub const fn is_told_off(&self) -> bool {
        self.duty_register == OFF
    }

    pub const fn write_divider(&mut self, divider: u32) {
        self.divider_register = divider;
    }

    /// The ESP32's manual says only that a low-speed timer takes its new settings with PARA_UP: taken as at once, the
    /// counter keeping its value.
    pub fn update_timer(&mut self, now: u64) {
        match self.chip {
            Chip::Esp32 => {
                let counts = self.count(now);
                self.divider = self.divider_register;
                self.period_start = now.saturating_sub(self.cycles(counts));
            }
            Chip::Esp32c3 | Chip::Esp32c6 => self.timer_update = true,
        }
    }

    /// Section "Registers", TIMERx_VALUE: the counter.
    pub fn count(&self, now: u64) -> u32 {
        ((now - self.period_start) * 256 / u64::from(self.divider)).min(u64::from(PERIOD) - 1) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cycles of a period at 50 Hz.
    const PERIOD_50_HZ: u64 = 1_600_000;

    fn unit(chip: Chip) -> Ledc {
        Ledc::new(chip, 0)
    }

    fn tell(unit: &mut Ledc, high: u32) {
        unit.write_duty(high);
        unit.start_duty();
        unit.update_channel();
    }

    #[test]
    fn the_counter_runs_at_the_divided_clock_and_overflows() {
        let mut unit = unit(Chip::Esp32c3);
        assert_eq!((unit.count(0), unit.count(PERIOD_50_HZ / 2), unit.count(PERIOD_50_HZ - 1)), (0, 8_192, PERIOD - 1));
        unit.turn(PERIOD_50_HZ - 1);
        assert!(!unit.overflowed);
        unit.turn(PERIOD_50_HZ);
        assert!(unit.overflowed);
        assert_eq!(unit.count(PERIOD_50_HZ), 0);
    }

    #[test]
    fn a_duty_waits_for_the_overflow_after_its_start_and_update() {
        let mut unit = unit(Chip::Esp32c3);
        tell(&mut unit, PERIOD / 4);
        assert_eq!(unit.loaded_duty(), OFF, "not at once");
        unit.turn(PERIOD_50_HZ);
        assert_eq!(unit.loaded_duty(), PERIOD / 4);
        let (first, falls) = (PERIOD_50_HZ, PERIOD_50_HZ + PERIOD_50_HZ / 4);
        assert_eq!((unit.output(first), unit.output(falls - 1), unit.output(falls)), (true, true, false));
        assert_eq!((unit.next_event(first), unit.next_event(falls)), (falls, 2 * PERIOD_50_HZ));
        for (start, update) in [(false, false), (true, false), (false, true)] {
            unit.write_duty(7);
            if start {
                unit.start_duty();
            }
            if update {
                unit.update_channel();
            }
            let next = unit.overflow_at();
            unit.turn(next);
            assert_eq!(unit.loaded_duty(), PERIOD / 4, "start {start}, update {update}");
            (unit.duty_start, unit.channel_update) = (false, false);
        }
    }

    #[test]
    fn a_divider_waits_for_the_overflow_on_c3_and_c6_and_for_nothing_on_the_esp32() {
        for chip in Chip::ALL {
            let mut unit = unit(chip);
            unit.write_divider(divider(2_000));
            unit.turn(PERIOD_50_HZ);
            assert_eq!(unit.overflow_at(), 2 * PERIOD_50_HZ, "{chip:?}: not without an update");
            unit.update_timer(PERIOD_50_HZ);
            let at_once = unit.overflow_at();
            unit.turn(2 * PERIOD_50_HZ);
            let expected = if chip == Chip::Esp32 { PERIOD_50_HZ + 40_000 } else { 2 * PERIOD_50_HZ };
            assert_eq!(at_once, expected, "{chip:?}");
            assert_eq!(unit.divider, divider(2_000));
        }
    }

    #[test]
    fn a_divider_taken_at_once_leaves_the_counter_its_value() {
        let mut unit = unit(Chip::Esp32);
        unit.write_divider(divider(2_000));
        unit.update_timer(PERIOD_50_HZ / 2);
        assert_eq!(unit.count(PERIOD_50_HZ / 2), PERIOD / 2);
        assert_eq!(unit.overflow_at(), PERIOD_50_HZ / 2 + 20_000);
    }
}
