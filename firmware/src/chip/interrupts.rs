//! The control core's three interrupts: the tick, an encoder edge, the start of a PWM period. They share one priority, the
//! highest, on one core, so none ever interrupts another: what they share needs no lock.

use super::board;
use super::flash::STANDSTILL;
use super::stage::{self, Stage};
use core::cell::UnsafeCell;
use esp_hal::interrupt::{InterruptHandler, Priority};
use esp_hal::peripherals::GPIO;
use esp_hal::ram;
use twum_firmware::control::Control;
use twum_firmware::encoder::EncoderInterrupt;
use twum_shared::Direction;

/// What the interrupts own.
pub struct ControlLoop {
    control: &'static mut Control<'static, Stage>,
    encoder: EncoderInterrupt<'static>,
    /// When the next tick is due; `None` before the first, which sets it.
    due_us: Option<u64>,
    period_us: u32,
}

impl ControlLoop {
    pub fn new(control: &'static mut Control<'static, Stage>, encoder: EncoderInterrupt<'static>) -> Self {
        let period_us = control.period_us();
        Self { control, encoder, due_us: None, period_us }
    }

    #[inline(always)]
    fn tick(&mut self) {
        let now_us = board::clock_us();
        let due_us = self.due_us.unwrap_or(now_us);
        if !stage::level(board::STOP_PIN) {
            self.control.stop_input_is_low();
        }
        self.control.tick(due_us, now_us, stage::level(board::ENCODER_PIN), board::clock_us);

        // Periods that passed meanwhile are skipped, not made up for: the timer raised one interrupt for all of them.
        let late_us = now_us.saturating_sub(due_us).min(u64::from(u32::MAX)) as u32;
        let missed = late_us / self.period_us.max(1);
        self.due_us = Some(due_us + u64::from(self.period_us) * (1 + u64::from(missed)));

        if self.control.is_at_rest() && STANDSTILL.stand() {
            self.due_us = None;
            board::set_tick_period(self.period_us);
        }
        let period_us = self.control.period_us();
        if period_us != self.period_us {
            (self.period_us, self.due_us) = (period_us, None);
            board::set_tick_period(period_us);
        }
    }
}

/// Holds the loop for the interrupts.
struct Slot(UnsafeCell<Option<ControlLoop>>);

// SAFETY: written once, by `begin`, before it lets the first interrupt through; afterwards only the three handlers below
// reach it, on one core and at one priority, so never two at a time.
unsafe impl Sync for Slot {}

static LOOP: Slot = Slot(UnsafeCell::new(None));

/// The highest priority: nothing but a critical section delays these.
const fn handler(function: extern "C" fn()) -> InterruptHandler {
    InterruptHandler::new(function, Priority::max())
}

/// Starts the interrupts on the core this is called on.
pub fn begin(control: ControlLoop) {
    let period_us = control.period_us;
    // SAFETY: the interrupts are not bound yet, so this is the only access.
    unsafe { *LOOP.0.get() = Some(control) };
    // Pulled up: nothing connected is no stop.
    board::take_pad(board::STOP_PIN, true);
    esp_hal::interrupt::bind_handler(board::TICK_INTERRUPT, handler(tick));
    board::set_tick_period(period_us);
    esp_hal::interrupt::bind_handler(esp_hal::peripherals::Interrupt::GPIO, handler(edge));
    esp_hal::interrupt::bind_handler(esp_hal::peripherals::Interrupt::LEDC, handler(period));
}

#[ram]
extern "C" fn tick() {
    board::clear_tick();
    // SAFETY: see `Slot`.
    if let Some(control) = unsafe { &mut *LOOP.0.get() } {
        control.tick();
    }
}

#[ram]
extern "C" fn edge() {
    let time_us = board::clock_us() as u32;
    // Cleared before the level is read: an edge after that raises the interrupt again, and is not lost.
    // SAFETY: one bit of a write-one-to-clear register.
    GPIO::regs().status_w1tc().write(|w| unsafe { w.bits(1 << board::ENCODER_PIN) });
    let level = stage::level(board::ENCODER_PIN);
    let direction = Direction::from_pin(stage::set_level(board::DIRECTION_PIN));
    // SAFETY: see `Slot`.
    if let Some(control) = unsafe { &mut *LOOP.0.get() } {
        control.encoder.edge(level, direction, time_us);
    }
}

#[ram]
extern "C" fn period() {
    board::clear_pwm_period();
    // SAFETY: see `Slot`.
    if let Some(control) = unsafe { &mut *LOOP.0.get() } {
        control.control.period_began(board::clock_us());
    }
}
