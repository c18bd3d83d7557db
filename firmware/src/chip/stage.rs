//! The registers behind [`twum_firmware::stage`].

use super::board;
use esp_hal::peripherals::GPIO;
use twum_firmware::stage::{self, Flags, Registers, Source, Wire};

/// This chip's stage.
pub type Stage = stage::Stage<Chip>;

/// What the stage, the panic handler and the driver board's port share.
pub static FLAGS: Flags = Flags::new();

/// The chip's registers.
#[derive(Clone, Copy, Debug)]
pub struct Chip;

#[inline(always)]
const fn pin(wire: Wire) -> u8 {
    match wire {
        Wire::Pwm => board::PWM_PIN,
        Wire::Direction => board::DIRECTION_PIN,
        Wire::Mark => board::MARK_PIN,
    }
}

impl Registers for Chip {
    #[inline(always)]
    fn take_pad(&self, wire: Wire) {
        board::take_pad(pin(wire), wire == Wire::Pwm);
    }

    #[inline(always)]
    fn set_level(&self, wire: Wire, high: bool) {
        let bit = 1 << pin(wire);
        // SAFETY: one bit of a write-one-to-set or -clear register, of a pin this module owns.
        if high {
            GPIO::regs().out_w1ts().write(|w| unsafe { w.bits(bit) });
        } else {
            GPIO::regs().out_w1tc().write(|w| unsafe { w.bits(bit) });
        }
    }

    #[inline(always)]
    fn route(&self, wire: Wire, source: Source) {
        let word = match source {
            Source::Level => board::PLAIN_OUTPUT,
            Source::Pwm => board::PWM_OUTPUT,
            Source::Uart => board::UART_OUTPUT,
        };
        // SAFETY: the words connect a pin to its output register, the PWM unit or the UART.
        GPIO::regs().func_out_sel_cfg(usize::from(pin(wire))).write(|w| unsafe { w.bits(word) });
    }

    #[inline(always)]
    fn enable_output(&self, wire: Wire, on: bool) {
        let bit = 1 << pin(wire);
        // SAFETY: as in `set_level`.
        if on {
            GPIO::regs().enable_w1ts().write(|w| unsafe { w.bits(bit) });
        } else {
            GPIO::regs().enable_w1tc().write(|w| unsafe { w.bits(bit) });
        }
    }

    fn receive_on(&self, wire: Wire) {
        board::receive_on(pin(wire));
    }

    #[inline(always)]
    fn write_duty(&self, high: u32) {
        board::write_duty(high);
    }

    #[inline(always)]
    fn start_duty(&self) {
        board::start_duty();
    }

    #[inline(always)]
    fn update_channel(&self) {
        board::update_channel();
    }

    #[inline(always)]
    fn loaded_duty(&self) -> u32 {
        board::loaded_duty()
    }

    fn write_divider(&self, divider: u32) {
        board::write_divider(divider);
    }

    fn update_timer(&self) {
        board::update_timer();
    }

    #[inline(always)]
    fn count(&self) -> u32 {
        board::count()
    }

    #[inline(always)]
    fn clear_overflow(&self) {
        board::clear_pwm_period();
    }
}

/// The level on a pin.
#[inline(always)]
pub fn level(pin: u8) -> bool {
    GPIO::regs().in_().read().bits() & (1 << pin) != 0
}

/// The level a pin is told to have.
#[inline(always)]
pub fn set_level(pin: u8) -> bool {
    GPIO::regs().out().read().bits() & (1 << pin) != 0
}
