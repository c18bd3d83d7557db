//! ESP32-C6: one high-performance RISC-V core. Control is its highest interrupt priority.

use super::interrupts::{self, ControlLoop};
use esp_hal::gpio::{AnyPin, Event, Input, InputConfig, InputSignal, OutputSignal, Pin, Pull};
use esp_hal::ledc::timer::config::Duty;
use esp_hal::peripherals::{self, Interrupt, LEDC, Peripherals, SYSTIMER};
use esp_hal::rtc_cntl::{SocResetReason, reset_reason};
use esp_hal::system::Cpu;
use esp_hal::timer::systimer::{Alarm, SystemTimer, Unit};
use esp_storage::FlashStorage;
use twum_shared::message::ResetCause;

pub const CHIP: &str = "esp32c6";
pub const ENCODER_PIN: u8 = 20;
pub const PWM_PIN: u8 = 18;
pub const DIRECTION_PIN: u8 = 19;
pub const MARK_PIN: u8 = 21;

pub const PWM_DUTY: Duty = Duty::Duty14Bit;
/// GPIO matrix words (reference manual, GPIO_FUNCn_OUT_SEL_CFG): the source, and bit 9, output enable by GPIO_ENABLE.
pub const PLAIN_OUTPUT: u32 = 128 | 1 << 9;
pub const PWM_OUTPUT: u32 = OutputSignal::LEDC_LS_SIG0 as u32 | 1 << 9;
pub const TICK_INTERRUPT: Interrupt = Interrupt::SYSTIMER_TARGET1;
pub const DRIVER_RX: InputSignal = InputSignal::U1RXD;
pub const DRIVER_TX: OutputSignal = OutputSignal::U1TXD;

/// The chip's parts, by what they are for.
pub struct Parts {
    pub rtc_timer: peripherals::RTC_TIMER<'static>,
    pub timg0: peripherals::TIMG0<'static>,
    pub from_cpu_intr0: peripherals::FROM_CPU_INTR0<'static>,
    pub flash: peripherals::FLASH<'static>,
    pub ledc: LEDC<'static>,
    pub pwm: AnyPin<'static>,
    pub direction: AnyPin<'static>,
    pub mark: AnyPin<'static>,
    pub encoder: AnyPin<'static>,
    pub link: peripherals::UART0<'static>,
    pub link_rx: AnyPin<'static>,
    pub link_tx: AnyPin<'static>,
    pub driver: peripherals::UART1<'static>,
    pub control: ControlParts,
}

pub type ControlParts = Alarm<'static>;

pub fn parts(p: Peripherals) -> Parts {
    Parts {
        rtc_timer: p.RTC_TIMER,
        timg0: p.TIMG0,
        from_cpu_intr0: p.FROM_CPU_INTR0,
        flash: p.FLASH,
        ledc: p.LEDC,
        encoder: p.GPIO20.degrade(),
        pwm: p.GPIO18.degrade(),
        direction: p.GPIO19.degrade(),
        mark: p.GPIO21.degrade(),
        link: p.UART0,
        link_rx: p.GPIO17.degrade(),
        link_tx: p.GPIO16.degrade(),
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

/// There is no other core.
pub const fn stop_other_core() {}

pub const fn share_flash(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash
}

/// Timer counts the PWM unit's output is high, from the next period on.
#[inline(always)]
pub fn set_pwm(high: u32) {
    let channel = LEDC::regs().ch(0);
    // SAFETY: the field has four fractional bits below the counts, which stay zero.
    channel.duty().write(|w| unsafe { w.duty().bits(high << 4) });
    channel.conf1().write(|w| w.duty_start().set_bit());
    // SAFETY: one step of no size: the duty is loaded as it stands.
    LEDC::regs().ch_gamma_wr(0).write(|w| unsafe {
        w.ch_gamma_duty_inc().set_bit().ch_gamma_duty_num().bits(1).ch_gamma_duty_cycle().bits(1);
        w.ch_gamma_scale().bits(0)
    });
    channel.conf0().modify(|_, w| w.para_up().set_bit());
}

/// Divides the unit's clock: 1/256ths.
#[inline(always)]
pub fn set_pwm_divider(divider: u32) {
    // SAFETY: the caller keeps the divider within 18 bits.
    LEDC::regs().timer(0).conf().modify(|_, w| unsafe { w.clk_div().bits(divider).para_up().set_bit() });
}

/// Sets the unit's counter to zero.
#[inline(always)]
pub fn restart_pwm() {
    let conf = LEDC::regs().timer(0).conf();
    conf.modify(|_, w| w.rst().set_bit());
    conf.modify(|_, w| w.rst().clear_bit());
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
