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
