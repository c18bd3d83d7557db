//! The chip's output stage: the two wires to the driver board and the start mark, through the registers of a PWM unit
//! (LEDC) and of the pads. One piece of code for every chip and for the simulated one, which only give it [`Registers`].
//!
//! The PWM pin is active low. "Off" disconnects it from the PWM unit and drives it high, at once and whatever the unit
//! does: two register writes, which a panic handler can make too.
//!
//! The unit's counter is never touched: it runs from boot on, and a duty reaches the pin with a period's beginning. While
//! the output is off the unit is told [`OFF`]; the interrupt of a period reconnects the pin only once the unit itself says
//! that it runs with another duty. So nothing rests on when the unit takes what was written, and the period that a run
//! waits for is the one that carries its first duty. A period begins with its off part, so the microseconds until its
//! interrupt runs cannot be seen on the pin.

use crate::output::OutputStage;
use portable_atomic::{AtomicBool, Ordering};
use twum_shared::{Direction, Duty};

/// Resolution of the PWM unit's counter, bits, on every chip.
pub const PWM_BITS: u32 = 14;
/// Timer counts of a PWM period.
pub const PERIOD: u32 = 1 << PWM_BITS;
/// The PWM unit's input clock on every chip, Hz.
pub const PWM_CLOCK_HZ: u32 = 80_000_000;
/// Counts high while the output is off: as many as a counter at its full resolution takes (C3 and C6 must not be told
/// 2^14). The one count that is left is never on the pin, and never a drive's: those are two counts and more.
pub const OFF: u32 = PERIOD - 1;

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
    /// The driver board's UART.
    Uart,
}

/// The registers behind a stage. Each call is one write or read of the peripheral; none waits.
pub trait Registers {
    /// IO MUX: makes the wire's pad the GPIO matrix's, with 5 mA; the PWM wire's is pulled up and may be read.
    fn take_pad(&self, wire: Wire);
    /// GPIO output register: the level a wire has while its source is [`Source::Level`].
    fn set_level(&self, wire: Wire, high: bool);
    /// GPIO matrix: what drives the wire.
    fn route(&self, wire: Wire, source: Source);
    /// GPIO enable register: whether the wire's driver is on.
    fn enable_output(&self, wire: Wire, on: bool);
    /// GPIO matrix: the driver board's UART listens to the wire.
    fn receive_on(&self, wire: Wire);
    /// PWM channel: timer counts the output is high in a period.
    fn write_duty(&self, high: u32);
    /// PWM channel: the duty that was written is to start.
    fn start_duty(&self);
    /// PWM channel: what was written is to be taken.
    fn update_channel(&self);
    /// PWM channel: the duty the unit runs with.
    fn loaded_duty(&self) -> u32;
    /// PWM timer: the clock's divider, 1/256ths.
    fn write_divider(&self, divider: u32);
    /// PWM timer: what was written is to be taken.
    fn update_timer(&self);
    /// PWM timer: the counter.
    fn count(&self) -> u32;
    /// PWM timer: forgets that the counter overflowed.
    fn clear_overflow(&self);
}

/// What the stage, the panic handler and the driver board's port share.
#[derive(Debug, Default)]
pub struct Flags {
    /// Whether the wires are the driver board's UART: then the PWM pin is an input, and "off" must not drive against it.
    text: AtomicBool,
}

impl Flags {
    /// Wires in their hardware role.
    pub const fn new() -> Self {
        Self { text: AtomicBool::new(false) }
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
    divider: u32,
    /// Whether the unit was told a drive's duty.
    told: bool,
    /// Whether the unit's output is on the pin.
    connected: bool,
}

impl<R: Registers> Stage<R> {
    /// Takes the wires' pads. Each has its level before its function, and its function before its driver: the PWM wire goes
    /// from pulled up to driven high, and is nothing in between.
    pub fn new(registers: R, flags: &'static Flags) -> Self {
        for (wire, level) in [(Wire::Pwm, true), (Wire::Direction, false), (Wire::Mark, false)] {
            registers.set_level(wire, level);
            registers.route(wire, Source::Level);
            registers.take_pad(wire);
            registers.enable_output(wire, true);
        }
        Self { registers, flags, divider: divider(50), told: false, connected: false }
    }

    #[inline(always)]
    fn tell(&self, high: u32) {
        self.registers.write_duty(high);
        self.registers.start_duty();
        self.registers.update_channel();
    }
}

impl<R: Registers> OutputStage for Stage<R> {
    #[inline(always)]
    fn off(&mut self) {
        off(&self.registers, self.flags);
        self.connected = false;
        if self.told {
            self.tell(OFF);
            self.told = false;
        }
    }

    #[inline(always)]
    fn drive(&mut self, duty: Duty, direction: Direction) {
        self.registers.set_level(Wire::Direction, direction.pin_high());
        // The unit's output is high first: off for what the drive leaves of the period.
        self.tell((PERIOD - duty.on_counts(PERIOD)).min(OFF - 1));
        if !self.told {
            // A period that began before cannot carry it.
            self.registers.clear_overflow();
            self.told = true;
        }
    }

    #[inline(always)]
    fn period_began(&mut self) -> Option<u32> {
        if self.told && !self.connected {
            if self.registers.loaded_duty() == OFF {
                return None;
            }
            self.registers.route(Wire::Pwm, Source::Pwm);
            self.connected = true;
        }
        // Less than 2^14 counts of less than 2^18 / 256 cycles.
        Some(((self.registers.count() * self.divider) >> 8) / (PWM_CLOCK_HZ / 1_000_000))
    }

    fn set_frequency(&mut self, hz: u16) {
        self.divider = divider(u32::from(hz.clamp(10, 2_000)));
        self.registers.write_divider(self.divider);
        self.registers.update_timer();
    }

    #[inline(always)]
    fn mark(&mut self, running: bool) {
        self.registers.set_level(Wire::Mark, running);
    }
}

#[inline(always)]
fn off(registers: &impl Registers, flags: &Flags) {
    registers.set_level(Wire::Pwm, true);
    registers.route(Wire::Pwm, Source::Level);
    if !flags.text.load(Ordering::Relaxed) {
        registers.enable_output(Wire::Pwm, true);
    }
}

/// Off for a panic: from anywhere, any number of times, even against a driver board that talks (the pin gives 5 mA, which
/// harms neither).
pub fn off_whatever_the_role(registers: &impl Registers, flags: &Flags) {
    flags.text.store(false, Ordering::Relaxed);
    off(registers, flags);
}

/// The wires are the driver board's UART: the PWM pin listens, pulled up; the direction pin talks.
pub fn to_text(registers: &impl Registers, flags: &Flags) {
    flags.text.store(true, Ordering::Relaxed);
    registers.enable_output(Wire::Pwm, false);
    registers.receive_on(Wire::Pwm);
    registers.route(Wire::Direction, Source::Uart);
}

/// The wires are PWM, held off, and direction.
pub fn to_hardware(registers: &impl Registers, flags: &Flags) {
    off_whatever_the_role(registers, flags);
    registers.set_level(Wire::Direction, false);
    registers.route(Wire::Direction, Source::Level);
}
