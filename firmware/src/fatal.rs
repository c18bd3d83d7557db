//! The end of the program: a panic, an exception, or a restart that was asked for. The motor is off before anything else,
//! and nothing of this program can drive it again.

use crate::output::Latch;
use crate::stage::{Flags, Registers, off_whatever_the_role};

/// The cores and the reset of a chip, for the core that calls.
pub trait System {
    /// Takes this core's interrupts away, until it is reset.
    fn mask_interrupts(&self);
    /// Stalls the other core, where there is one.
    fn hold_other_core(&self);
    /// Lets the other core go on. Its stall would outlive the reset.
    fn release_other_core(&self);
    /// Resets the digital part of the chip. Returns on a simulated chip only.
    fn reset(&self);
}

/// Off for good, from any core and any context, at any instruction of the rest of the program.
pub fn silence(system: &impl System, registers: &impl Registers, flags: &Flags, latch: &Latch) {
    // The control interrupts of this core must not run any more: they would drive again.
    system.mask_interrupts();
    // Those of another core find the output dead,
    latch.shut();
    off_whatever_the_role(registers, flags);
    // and if one was past looking, and switched on since, it gets no further than this.
    system.hold_other_core();
    off_whatever_the_role(registers, flags);
}

/// Restarts the chip, after [`silence`].
pub fn restart(system: &impl System) {
    // A core that is still stalled would not start: only the watchdog's reset ends a stall. What the core does in the
    // few instructions until the reset is harmless, its output is dead.
    system.release_other_core();
    system.reset();
}
