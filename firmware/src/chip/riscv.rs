//! ESP32-C3 and -C6: one RISC-V core. Control is its highest interrupt priority. What differs is in a file for each.

use super::interrupts::{self, ControlLoop};
use esp_hal::gpio::{AnyPin, Event, Input, InputConfig, InputSignal, OutputSignal, Pin, Pull};
use esp_hal::ledc::timer::config::Duty;
use esp_hal::peripherals::{self, GPIO, IO_MUX, Interrupt, LEDC, Peripherals, SYSTIMER};
use esp_hal::rtc_cntl::{SocResetReason, reset_reason};
use esp_hal::system::Cpu;
use esp_hal::timer::systimer::{Alarm, SystemTimer, Unit};
use esp_storage::FlashStorage;
use twum_firmware::standstill::{Moving, Standstill};
use twum_shared::message::ResetCause;

#[cfg_attr(feature = "esp32c3", path = "esp32c3.rs")]
#[cfg_attr(feature = "esp32c6", path = "esp32c6.rs")]
mod one;

pub use one::*;

pub const PWM_DUTY: Duty = Duty::Duty14Bit;
/// GPIO matrix words (reference manual, GPIO_FUNCn_OUT_SEL_CFG): the source, and bit 9, output enable by GPIO_ENABLE.
pub const PLAIN_OUTPUT: u32 = 128 | 1 << 9;
pub const PWM_OUTPUT: u32 = OutputSignal::LEDC_LS_SIG0 as u32 | 1 << 9;
pub const UART_OUTPUT: u32 = OutputSignal::U1TXD as u32 | 1 << 9;
pub const TICK_INTERRUPT: Interrupt = Interrupt::SYSTIMER_TARGET1;
/// IO MUX: the function that gives a pad to the GPIO matrix.
const GPIO_FUNCTION: u8 = 1;

/// The chip's parts, by what they are for.
pub struct Parts {
    pub rtc_timer: peripherals::RTC_TIMER<'static>,
    pub timg0: peripherals::TIMG0<'static>,
    pub from_cpu_intr0: peripherals::FROM_CPU_INTR0<'static>,
    pub flash: peripherals::FLASH<'static>,
    pub ledc: LEDC<'static>,
    pub encoder: AnyPin<'static>,
    pub link: peripherals::UART0<'static>,
    pub link_rx: AnyPin<'static>,
    pub link_tx: AnyPin<'static>,
    pub driver: peripherals::UART1<'static>,
    pub control: ControlParts,
}

pub type ControlParts = Alarm<'static>;

pub fn parts(p: Peripherals) -> Parts {
    let (encoder, link_rx, link_tx) = pins!(p);
    Parts {
        rtc_timer: p.RTC_TIMER,
        timg0: p.TIMG0,
        from_cpu_intr0: p.FROM_CPU_INTR0,
        flash: p.FLASH,
        ledc: p.LEDC,
        encoder,
        link: p.UART0,
        link_rx,
        link_tx,
        driver: p.UART1,
        control: SystemTimer::new(p.SYSTIMER).alarm1,
    }
}

pub fn reset_cause() -> ResetCause {
    use SocResetReason as R;
    match reset_reason(Cpu::ProCpu) {
        Some(R::ChipPowerOn) => ResetCause::PowerOn,
        Some(R::CoreSw | R::Cpu0Sw) => ResetCause::Software,
        Some(R::CoreUsbUart | R::CoreUsbJtag) => ResetCause::External,
        Some(R::SysBrownOut) => ResetCause::BrownOut,
        Some(
            R::CoreMwdt0
            | R::CoreMwdt1
            | R::CoreRtcWdt
            | R::Cpu0Mwdt0
            | R::Cpu0Mwdt1
            | R::Cpu0RtcWdt
            | R::SysRtcWdt
            | R::SysSuperWdt,
        ) => ResetCause::Watchdog,
        _ => ResetCause::Unknown,
    }
}

/// Starts the control interrupts on this core.
pub fn start_control(alarm: ControlParts, encoder: AnyPin<'static>, control: ControlLoop) {
    // The registers below are the alarm's, which nothing else uses from here on.
    core::mem::forget(alarm);
    assert!(SystemTimer::ticks_per_second() == u64::from(TICKS_PER_US) * 1_000_000);
    SYSTIMER::regs().int_ena().modify(|_, w| w.target(1).set_bit());
    let mut encoder = Input::new(encoder, InputConfig::default().with_pull(Pull::Up));
    interrupts::begin(control);
    encoder.listen(Event::AnyEdge);
    // Kept for ever: dropping it would release the pin.
    core::mem::forget(encoder);
}

/// The system timer's, which is the time everywhere else too.
const TICKS_PER_US: u32 = 16;

/// Device time, µs.
#[inline(always)]
pub fn clock_us() -> u64 {
    SystemTimer::unit_value(Unit::Unit0) / u64::from(TICKS_PER_US)
}

/// Starts the tick anew with this period.
pub fn set_tick_period(period_us: u32) {
    let timer = SYSTIMER::regs();
    timer.conf().modify(|_, w| w.target1_work_en().clear_bit());
    // SAFETY: 10 ms, the longest, are 160,000 ticks: 18 of the field's 26 bits.
    timer.target_conf(1).write(|w| unsafe { w.period().bits(TICKS_PER_US * period_us) });
    timer.comp_load(1).write(|w| w.load().set_bit());
    // Setting the mode after the period starts it from now.
    timer.target_conf(1).modify(|_, w| w.period_mode().set_bit());
    timer.conf().modify(|_, w| w.target1_work_en().set_bit());
}

/// Forgets that a tick is due.
#[inline(always)]
pub fn clear_tick() {
    SYSTIMER::regs().int_clr().write(|w| w.target(1).clear_bit_by_one());
}

/// Takes this core's interrupts away: clears `mstatus.MIE`.
#[inline(always)]
pub fn mask_interrupts() {
    // SAFETY: one bit of this core's status, which nothing sets again before the reset that ends what calls this.
    unsafe { core::arch::asm!("csrci mstatus, 8") };
}

/// There is no other core.
pub const fn hold_other_core() {}

/// There is no other core.
pub const fn release_other_core() {}

pub const fn share_flash(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash
}

/// The core that writes is the one that ticks: it does not while it writes.
pub async fn stand_still(_: &Standstill) -> Result<(), Moving> {
    Ok(())
}

/// Gives a pin's pad to the GPIO matrix, with 5 mA; one that listens is pulled up and may be read.
#[inline(always)]
pub fn take_pad(pin: u8, listens: bool) {
    // SAFETY: a function and a strength every pad has.
    IO_MUX::regs().gpio(usize::from(pin)).write(|w| unsafe {
        w.mcu_sel().bits(GPIO_FUNCTION).fun_drv().bits(0).fun_wpu().bit(listens).fun_ie().bit(listens)
    });
}

/// Lets the driver board's UART listen to a pin.
pub fn receive_on(pin: u8) {
    // SAFETY: a pin's number selects that pin; `sel` takes the signal from the matrix.
    GPIO::regs()
        .func_in_sel_cfg(InputSignal::U1RXD as usize)
        .write(|w| unsafe { w.in_sel().bits(pin).sel().set_bit() });
}

/// Timer counts the PWM unit's output is high.
#[inline(always)]
pub fn write_duty(high: u32) {
    // SAFETY: the field has four fractional bits below the counts, which stay zero.
    LEDC::regs().ch(0).duty().write(|w| unsafe { w.duty().bits(high << 4) });
}

/// The PWM unit is to take what was written for its channel.
#[inline(always)]
pub fn update_channel() {
    LEDC::regs().ch(0).conf0().modify(|_, w| w.para_up().set_bit());
}

/// The counts the PWM unit's output is high now.
#[inline(always)]
pub fn loaded_duty() -> u32 {
    LEDC::regs().ch(0).duty_r().read().bits() >> 4
}

/// Divides the PWM unit's clock: 1/256ths.
pub fn write_divider(divider: u32) {
    // SAFETY: the caller keeps the divider within 18 bits.
    LEDC::regs().timer(0).conf().modify(|_, w| unsafe { w.clk_div().bits(divider) });
}

/// The PWM unit is to take what was written for its timer.
pub fn update_timer() {
    LEDC::regs().timer(0).conf().modify(|_, w| w.para_up().set_bit());
}

/// The PWM unit's counter.
#[inline(always)]
pub fn count() -> u32 {
    LEDC::regs().timer(0).value().read().bits()
}

/// Lets each period's start raise an interrupt.
pub fn listen_pwm_period() {
    LEDC::regs().int_ena().write(|w| w.timer_ovf(0).set_bit());
}

/// Forgets that a period started.
#[inline(always)]
pub fn clear_pwm_period() {
    LEDC::regs().int_clr().write(|w| w.timer_ovf(0).clear_bit_by_one());
}
