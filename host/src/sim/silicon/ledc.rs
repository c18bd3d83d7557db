//! The PWM unit (LEDC): one timer and one channel, as the reference manuals describe them. Times are cycles of its 80 MHz
//! clock. Chapters are named, not numbered: their numbers differ between editions.

use super::Chip;
use twum_firmware::stage::{PERIOD, divider};

/// The unit.
#[derive(Clone, Debug)]
pub(super) struct Ledc {
    chip: Chip,
    /// Divider in force and the one that was written, 1/256ths.
    divider: u32,
    written_divider: Option<u32>,
    /// Counts the output is high: in force, and written.
    duty: u32,
    written_duty: Option<u32>,
    /// When the counter was last zero.
    period_start: u64,
    /// Raw overflow interrupt.
    pub overflowed: bool,
}

impl Ledc {
    /// As the firmware sets the unit up: 50 Hz, its output high throughout.
    pub fn new(chip: Chip, now: u64) -> Self {
        Self {
            chip,
            divider: divider(50),
            written_divider: None,
            duty: PERIOD,
            written_duty: None,
            period_start: now,
            overflowed: false,
        }
    }

    /// "LED PWM Controller", Timers: the counter counts to 2^resolution − 1 at the clock over the divider, whose low
    /// eight bits are a fraction, then overflows to zero.
    fn overflow_at(&self) -> u64 {
        self.period_start + (u64::from(self.divider) * u64::from(PERIOD)) / 256
    }

    /// "LED PWM Controller", PWM Generators: the output goes high when the counter reaches hpoint (0 here) and low when it
    /// reaches lpoint, which is hpoint + duty; a lpoint beyond the counter's range is never reached.
    fn falls_at(&self) -> Option<u64> {
        (self.duty < PERIOD).then(|| self.period_start + (u64::from(self.divider) * u64::from(self.duty)) / 256)
    }

    /// The unit's output.
    pub fn output(&self, now: u64) -> bool {
        self.falls_at().is_none_or(|falls| now < falls)
    }

    /// When the output or the counter next does something, after `now`.
    pub fn next_event(&self, now: u64) -> u64 {
        self.falls_at().filter(|falls| *falls > now).map_or(self.overflow_at(), |falls| falls.min(self.overflow_at()))
    }

    /// Whether the counter overflows at `now`; then everything that waits for it happens.
    pub fn overflow(&mut self, now: u64) -> bool {
        if now < self.overflow_at() {
            return false;
        }
        self.period_start = self.overflow_at();
        // "LED PWM Controller", Timers (C3, C6): a divider written with PARA_UP is taken at the counter's next overflow.
        self.divider = self.written_divider.take().unwrap_or(self.divider);
        // "LED PWM Controller", PWM Generators: a duty written with DUTY_START and PARA_UP is taken at the next overflow.
        self.duty = self.written_duty.take().unwrap_or(self.duty);
        // "LED PWM Controller", Interrupts: TIMERx_OVF is raised when the counter reaches its maximum.
        self.overflowed = true;
        true
    }

    pub fn write_duty(&mut self, high: u32) {
        self.written_duty = Some(high);
    }

    pub fn write_divider(&mut self, divider: u32, now: u64) {
        match self.chip {
            // The ESP32's manual says only that PARA_UP makes a low-speed timer take its new settings: taken as at once.
            Chip::Esp32 => {
                let counts = self.count(now);
                self.divider = divider;
                self.period_start = now.saturating_sub(u64::from(counts) * u64::from(divider) / 256);
            }
            Chip::Esp32c3 | Chip::Esp32c6 => self.written_divider = Some(divider),
        }
    }

    /// "LED PWM Controller", Timers: RST sets the counter to zero. That is no overflow: nothing is taken, nothing raised.
    pub fn reset_counter(&mut self, now: u64) {
        self.period_start = now;
    }

    /// "LED PWM Controller", registers: TIMERx_VALUE reads the counter.
    pub fn count(&self, now: u64) -> u32 {
        ((now - self.period_start) * 256 / u64::from(self.divider)).min(u64::from(PERIOD) - 1) as u32
    }
}
