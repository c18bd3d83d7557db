//! The two wires to the driver board, and the start mark: the registers behind [`OutputStage`].
//!
//! The PWM pin is active low. "Off" disconnects it from the PWM unit and drives it high, at once and whatever the unit
//! does: two register writes, which the panic handler can make too. A duty reaches the pin with the next PWM period: the
//! unit loads it then, and the period's interrupt reconnects the pin if it was off before. A period begins with its off
//! part, so the microseconds until that interrupt runs cannot be seen on the pin. A run does not wait for the period to
//! end: the unit runs one at full clock (0.2 ms), which loads the run's first duty, and the next is the run's first.

use super::board;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use esp_hal::gpio::{AnyPin, DriveStrength, Flex, InputConfig, Level, Output as Pin, OutputConfig, Pull};
use esp_hal::peripherals::GPIO;
use twum_firmware::output::OutputStage;
use twum_shared::{Direction, Duty};

/// Timer counts of a PWM period.
const PERIOD: u32 = 1 << board::PWM_BITS;
/// The PWM unit's input clock on every chip, Hz.
const PWM_CLOCK_HZ: u32 = 80_000_000;

/// Whether the wires are the driver board's UART: then the PWM pin is an input, and "off" must not drive against it.
static TEXT: AtomicBool = AtomicBool::new(false);
/// Whether the next PWM period reaches the pin.
static CONNECT: AtomicBool = AtomicBool::new(false);

/// Whether the unit runs the short period before a run.
static PRIMING: AtomicBool = AtomicBool::new(false);
/// The unit's clock divider, 1/256ths.
static DIVIDER: AtomicU32 = AtomicU32::new(divider(50));
/// No division.
const FULL_CLOCK: u32 = 256;

/// The divider for a PWM frequency: 10 to 2000 Hz give 10.8 bits at a resolution of 13 or 14 bits.
const fn divider(hz: u32) -> u32 {
    ((PWM_CLOCK_HZ / hz) << 8) >> board::PWM_BITS
}

/// The only [`OutputStage`] of a board.
pub struct Stage(());

impl Stage {
    pub const fn new() -> Self {
        Self(())
    }
}

impl OutputStage for Stage {
    #[inline(always)]
    fn off(&mut self) {
        off();
    }

    #[inline(always)]
    fn drive(&mut self, duty: Duty, direction: Direction) {
        set(board::DIRECTION_PIN, direction.pin_high());
        // The unit's output is high first: off for what the drive leaves of the period.
        board::set_pwm(PERIOD - duty.on_counts(PERIOD));
        if !CONNECT.load(Ordering::Relaxed) {
            // A period that began before the duty was written did not load it: the next one will.
            board::clear_pwm_period();
            CONNECT.store(true, Ordering::Relaxed);
        }
    }

    #[inline(always)]
    fn restart_period(&mut self) {
        PRIMING.store(true, Ordering::Relaxed);
        board::set_pwm_divider(FULL_CLOCK);
        board::restart_pwm();
    }

    fn set_frequency(&mut self, hz: u16) {
        let divider = divider(u32::from(hz.clamp(10, 2_000)));
        DIVIDER.store(divider, Ordering::Relaxed);
        board::set_pwm_divider(divider);
    }

    #[inline(always)]
    fn mark(&mut self, running: bool) {
        set(board::MARK_PIN, running);
    }
}

/// Off, from anywhere, any number of times.
#[inline(always)]
pub fn off() {
    CONNECT.store(false, Ordering::Relaxed);
    set(board::PWM_PIN, true);
    route(board::PWM_PIN, board::PLAIN_OUTPUT);
    if !TEXT.load(Ordering::Relaxed) {
        enable_output(board::PWM_PIN);
    }
}

/// Off for a panic: even against a driver board that talks (the pin gives 5 mA, which harms neither).
pub fn off_whatever_the_role() {
    TEXT.store(false, Ordering::Relaxed);
    off();
}

/// A PWM period began.
#[inline(always)]
pub fn period_began() {
    if PRIMING.load(Ordering::Relaxed) {
        PRIMING.store(false, Ordering::Relaxed);
        board::set_pwm_divider(DIVIDER.load(Ordering::Relaxed));
        board::restart_pwm();
    }
    if CONNECT.load(Ordering::Relaxed) {
        route(board::PWM_PIN, board::PWM_OUTPUT);
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

#[inline(always)]
fn set(pin: u8, high: bool) {
    // SAFETY: one bit of a write-one-to-set or -clear register, of a pin this module owns.
    if high {
        GPIO::regs().out_w1ts().write(|w| unsafe { w.bits(1 << pin) });
    } else {
        GPIO::regs().out_w1tc().write(|w| unsafe { w.bits(1 << pin) });
    }
}

#[inline(always)]
fn route(pin: u8, source: u32) {
    // SAFETY: the two words a board uses connect a pin to its output register or to the PWM unit.
    GPIO::regs().func_out_sel_cfg(usize::from(pin)).write(|w| unsafe { w.bits(source) });
}

#[inline(always)]
fn enable_output(pin: u8) {
    // SAFETY: as in `set`.
    GPIO::regs().enable_w1ts().write(|w| unsafe { w.bits(1 << pin) });
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
        TEXT.store(false, Ordering::Relaxed);
        off();
        self.pwm.set_output_enable(true);
        self.direction.set_output_enable(true);
        set(board::DIRECTION_PIN, false);
        route(board::DIRECTION_PIN, board::PLAIN_OUTPUT);
    }

    /// The PWM pin listens, pulled up; the direction pin becomes the UART's transmit line.
    pub fn to_text(&mut self) {
        TEXT.store(true, Ordering::Relaxed);
        self.pwm.set_output_enable(false);
        self.pwm.apply_input_config(&InputConfig::default().with_pull(Pull::Up));
        board::DRIVER_RX.connect_to(&self.pwm.peripheral_input());
        board::DRIVER_TX.connect_to(&self.direction);
        self.direction.set_output_enable(true);
    }
}
