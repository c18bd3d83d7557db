//! The chip's output stage: the two wires to the driver board and the start mark, through the registers of a PWM unit
//! (LEDC) and of the pads. One piece of code for every chip and for the simulated one, which only give it [`Registers`].
//!
//! The PWM pin is active low. "Off" disconnects it from the PWM unit and drives it high, at once and whatever the unit
//! does: two register writes, which a panic handler can make too. A duty reaches the pin with the next PWM period: the
//! unit loads it then, and the period's interrupt reconnects the pin if it was off before. A period begins with its off
//! part, so the microseconds until that interrupt runs cannot be seen on the pin. A run does not wait for the period to
//! end: the unit runs one at full clock (0.2 ms), which loads the run's first duty, and the next is the run's first.

use crate::output::OutputStage;
use portable_atomic::{AtomicBool, AtomicU32, Ordering};
use twum_shared::{Direction, Duty};

/// Resolution of the PWM unit's counter, bits, on every chip.
pub const PWM_BITS: u32 = 14;
/// Timer counts of a PWM period.
pub const PERIOD: u32 = 1 << PWM_BITS;
/// The PWM unit's input clock on every chip, Hz.
pub const PWM_CLOCK_HZ: u32 = 80_000_000;
/// No division of the unit's clock, in 1/256ths.
const FULL_CLOCK: u32 = 256;

/// The wires a stage has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// PWM, active low; the UART's receive line in the driver board's text mode.
    Pwm,
    /// Direction, high is clockwise; the UART's transmit line in the driver board's text mode.
    Direction,
    /// The start mark.
    Mark,
}

/// What the GPIO matrix puts on a wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The level written to the GPIO output register.
    Level,
    /// The PWM unit's output.
    Pwm,
}

/// The registers behind a stage. Each call is one write or read of the peripheral; none waits.
pub trait Registers {
    /// GPIO output register: the level a wire has while its source is [`Source::Level`].
    fn set_level(&self, wire: Wire, high: bool);
    /// GPIO matrix: what drives the wire.
    fn route(&self, wire: Wire, source: Source);
    /// GPIO enable register: whether the wire's driver is on.
    fn enable_output(&self, wire: Wire, on: bool);
    /// PWM channel: timer counts the output is high in a period, and the request to load it.
    fn write_duty(&self, high: u32);
    /// PWM timer: the clock's divider, 1/256ths, and the request to load it.
    fn write_divider(&self, divider: u32);
    /// PWM timer: the counter is zero.
    fn reset_counter(&self);
    /// PWM timer: forgets that the counter overflowed.
    fn clear_overflow(&self);
}

/// What the stage, the panic handler and the driver board's port share.
#[derive(Debug)]
pub struct Flags {
    /// Whether the wires are the driver board's UART: then the PWM pin is an input, and "off" must not drive against it.
    text: AtomicBool,
    /// Whether the next PWM period reaches the pin.
    connect: AtomicBool,
    /// Whether the unit runs the short period before a run.
    priming: AtomicBool,
    /// The unit's clock divider, 1/256ths.
    divider: AtomicU32,
}

impl Flags {
    /// Wires in their hardware role, off.
    pub const fn new() -> Self {
        Self {
            text: AtomicBool::new(false),
            connect: AtomicBool::new(false),
            priming: AtomicBool::new(false),
            divider: AtomicU32::new(divider(50)),
        }
    }

    /// Whether the stage holds the output off, now and with the next period.
    pub fn is_off(&self) -> bool {
        !self.connect.load(Ordering::Relaxed)
    }
}

impl Default for Flags {
    fn default() -> Self {
        Self::new()
    }
}

/// The divider for a PWM frequency, 1/256ths: 10 to 2000 Hz give 10.8 bits of clock division at 14 bits of duty.
pub const fn divider(hz: u32) -> u32 {
    ((PWM_CLOCK_HZ / hz) << 8) >> PWM_BITS
}

/// The only [`OutputStage`] of a board.
#[derive(Debug)]
pub struct Stage<R: 'static> {
    registers: R,
    flags: &'static Flags,
}

impl<R: Registers> Stage<R> {
    /// A stage on these registers.
    pub const fn new(registers: R, flags: &'static Flags) -> Self {
        Self { registers, flags }
    }
}

impl<R: Registers> OutputStage for Stage<R> {
    #[inline(always)]
    fn off(&mut self) {
        off(&self.registers, self.flags);
    }

    #[inline(always)]
    fn drive(&mut self, duty: Duty, direction: Direction) {
        self.registers.set_level(Wire::Direction, direction.pin_high());
        // The unit's output is high first: off for what the drive leaves of the period.
        self.registers.write_duty(PERIOD - duty.on_counts(PERIOD));
        if !self.flags.connect.load(Ordering::Relaxed) {
            // A period that began before the duty was written did not load it: the next one will.
            self.registers.clear_overflow();
            self.flags.connect.store(true, Ordering::Relaxed);
        }
    }

    #[inline(always)]
    fn restart_period(&mut self) {
        self.flags.priming.store(true, Ordering::Relaxed);
        self.registers.write_divider(FULL_CLOCK);
        self.registers.reset_counter();
    }

    fn set_frequency(&mut self, hz: u16) {
        let divider = divider(u32::from(hz.clamp(10, 2_000)));
        self.flags.divider.store(divider, Ordering::Relaxed);
        self.registers.write_divider(divider);
    }

    #[inline(always)]
    fn mark(&mut self, running: bool) {
        self.registers.set_level(Wire::Mark, running);
    }
}

/// Off, from anywhere, any number of times.
#[inline(always)]
pub fn off(registers: &impl Registers, flags: &Flags) {
    flags.connect.store(false, Ordering::Relaxed);
    registers.set_level(Wire::Pwm, true);
    registers.route(Wire::Pwm, Source::Level);
    if !flags.text.load(Ordering::Relaxed) {
        registers.enable_output(Wire::Pwm, true);
    }
}

/// Off for a panic: even against a driver board that talks (the pin gives 5 mA, which harms neither).
pub fn off_whatever_the_role(registers: &impl Registers, flags: &Flags) {
    flags.text.store(false, Ordering::Relaxed);
    off(registers, flags);
}

/// A PWM period began.
#[inline(always)]
pub fn period_began(registers: &impl Registers, flags: &Flags) {
    if flags.priming.load(Ordering::Relaxed) {
        flags.priming.store(false, Ordering::Relaxed);
        registers.write_divider(flags.divider.load(Ordering::Relaxed));
        registers.reset_counter();
    }
    if flags.connect.load(Ordering::Relaxed) {
        registers.route(Wire::Pwm, Source::Pwm);
    }
}

/// The wires are the driver board's UART: the PWM pin listens.
pub fn to_text(registers: &impl Registers, flags: &Flags) {
    flags.text.store(true, Ordering::Relaxed);
    registers.enable_output(Wire::Pwm, false);
}

/// The wires are PWM, held off, and direction.
pub fn to_hardware(registers: &impl Registers, flags: &Flags) {
    flags.text.store(false, Ordering::Relaxed);
    off(registers, flags);
    registers.set_level(Wire::Direction, false);
    registers.route(Wire::Direction, Source::Level);
}
