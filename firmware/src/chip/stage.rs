//! The registers behind [`twum_firmware::stage`], and the pads of the two wires to the driver board and of the start mark.

use super::board;
use esp_hal::gpio::{AnyPin, DriveStrength, Flex, InputConfig, Level, Output as Pin, OutputConfig, Pull};
use esp_hal::peripherals::GPIO;
use twum_firmware::stage::{self, Flags, Registers, Source, Wire};

/// This chip's stage.
pub type Stage = stage::Stage<Chip>;

/// What the stage, the panic handler and the driver board's port share.
pub static FLAGS: Flags = Flags::new();

/// The chip's registers.
#[derive(Clone, Copy, Debug)]
pub struct Chip;

const fn pin(wire: Wire) -> u8 {
    match wire {
        Wire::Pwm => board::PWM_PIN,
        Wire::Direction => board::DIRECTION_PIN,
        Wire::Mark => board::MARK_PIN,
    }
}

impl Registers for Chip {
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
        };
        // SAFETY: the two words a board uses connect a pin to its output register or to the PWM unit.
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

    #[inline(always)]
    fn write_duty(&self, high: u32) {
        board::set_pwm(high);
    }

    #[inline(always)]
    fn write_divider(&self, divider: u32) {
        board::set_pwm_divider(divider);
    }

    #[inline(always)]
    fn reset_counter(&self) {
        board::restart_pwm();
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

/// The two wires, whose role [`super::port`] changes.
pub struct Pins {
    pub pwm: Flex<'static>,
    pub direction: Flex<'static>,
}

/// Sets the pins' pads up: 5 mA, so that a driver board that talks while the pin is held high is not harmed.
pub fn wire(pwm: AnyPin<'static>, direction: AnyPin<'static>, mark: AnyPin<'static>) -> Pins {
    let weak = OutputConfig::default().with_drive_strength(DriveStrength::_5mA);
    let mut pins = Pins { pwm: Flex::new(pwm), direction: Flex::new(direction) };
    pins.pwm.apply_output_config(&weak.with_pull(Pull::Up));
    pins.direction.apply_output_config(&weak);
    pins.to_hardware();
    // Kept for ever: dropping it would release the pin.
    core::mem::forget(Pin::new(mark, Level::Low, OutputConfig::default()));
    pins
}

impl Pins {
    /// PWM held off, and direction: what the driver board expects in hardware mode.
    pub fn to_hardware(&mut self) {
        stage::to_hardware(&Chip, &FLAGS);
        self.direction.set_output_enable(true);
    }

    /// The PWM pin listens, pulled up; the direction pin becomes the UART's transmit line.
    pub fn to_text(&mut self) {
        stage::to_text(&Chip, &FLAGS);
        self.pwm.apply_input_config(&InputConfig::default().with_pull(Pull::Up));
        board::DRIVER_RX.connect_to(&self.pwm.peripheral_input());
        board::DRIVER_TX.connect_to(&self.direction);
        self.direction.set_output_enable(true);
    }
}
