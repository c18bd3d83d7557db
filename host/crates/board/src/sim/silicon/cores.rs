//! The cores: whose interrupts are masked, who is stalled, and what a reset ends.

use super::Chip;

/// Which of the firmware's two halves a core runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// The link's and the driver's tasks.
    Tasks,
    /// The control interrupts.
    Control,
}

/// State of the cores.
#[derive(Clone, Debug)]
pub(super) struct Cores {
    chip: Chip,
    masked: [bool; 2],
    stalled: [bool; 2],
}

impl Cores {
    pub const fn new(chip: Chip) -> Self {
        Self { chip, masked: [false; 2], stalled: [false; 2] }
    }

    const fn of(&self, half: Half) -> usize {
        match (self.chip, half) {
            (Chip::Esp32, Half::Control) => 1,
            _ => 0,
        }
    }

    pub fn mask(&mut self, half: Half) {
        self.masked[self.of(half)] = true;
    }

    /// ESP32, "Low-Power Management", SW_CPU_STALL and OPTIONS0: a stalled core executes nothing until it is released.
    pub fn stall_other(&mut self, half: Half, stalled: bool) {
        if self.chip == Chip::Esp32 {
            self.stalled[1 - self.of(half)] = stalled;
        }
    }

    /// Whether this half's interrupts are served.
    pub fn interruptible(&self, half: Half) -> bool {
        let core = self.of(half);
        !self.masked[core] && !self.stalled[core]
    }

    /// Whether this half's core executes instructions.
    pub fn executes(&self, half: Half) -> bool {
        !self.stalled[self.of(half)]
    }

    /// ESP32, "Reset and Clock" and "Low-Power Management": a software reset restarts both cores, but the stall bits are in
    /// the RTC's part, which it does not reach; the RTC watchdog's and a power-on reset do.
    pub fn reset(&mut self, software: bool) {
        self.masked = [false; 2];
        if !software {
            self.stalled = [false; 2];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_masked_core_serves_no_interrupt_until_any_reset() {
        for software in [true, false] {
            let mut cores = Cores::new(Chip::Esp32);
            cores.mask(Half::Tasks);
            assert!(!cores.interruptible(Half::Tasks) && cores.interruptible(Half::Control));
            assert!(cores.executes(Half::Tasks), "it goes on with what it was at");
            cores.reset(software);
            assert!(cores.interruptible(Half::Tasks));
        }
        let mut one = Cores::new(Chip::Esp32c3);
        one.mask(Half::Tasks);
        assert!(!one.interruptible(Half::Control), "one core serves both halves");
    }

    #[test]
    fn a_stall_ends_with_its_release_or_a_reset_that_reaches_the_rtc() {
        let mut cores = Cores::new(Chip::Esp32);
        cores.stall_other(Half::Control, true);
        assert!(!cores.executes(Half::Tasks) && !cores.interruptible(Half::Tasks) && cores.executes(Half::Control));
        cores.reset(true);
        assert!(!cores.executes(Half::Tasks), "a software reset does not reach it");
        let mut released = cores.clone();
        released.stall_other(Half::Control, false);
        assert!(released.executes(Half::Tasks));
        cores.reset(false);
        assert!(cores.executes(Half::Tasks));
        let mut one = Cores::new(Chip::Esp32c6);
        one.stall_other(Half::Control, true);
        assert!(one.executes(Half::Tasks), "there is no other core to stall");
    }
}
