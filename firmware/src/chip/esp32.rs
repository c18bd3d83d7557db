//! ESP32: two Xtensa cores. Control owns the second, communication the first.

use super::interrupts::{self, ControlLoop};
use esp_hal::gpio::{AnyPin, Event, Input, InputConfig, InputSignal, OutputSignal, Pin, Pull};
use esp_hal::ledc::timer::config::Duty;
use esp_hal::peripherals::{self, Interrupt, LEDC, Peripherals, TIMG1};
use esp_hal::rtc_cntl::{SocResetReason, reset_reason};
use esp_hal::system::{Cpu, CpuControl, Stack};
use esp_hal::time::Instant;
use esp_hal::timer::timg::TimerGroup;
use esp_storage::FlashStorage;
use static_cell::ConstStaticCell;
use twum_shared::message::ResetCause;

pub const CHIP: &str = "esp32";
pub const ENCODER_PIN: u8 = 4;
pub const PWM_PIN: u8 = 16;
pub const DIRECTION_PIN: u8 = 17;
pub const MARK_PIN: u8 = 19;

pub const PWM_DUTY: Duty = Duty::Duty14Bit;
/// GPIO matrix words (reference manual, GPIO_FUNCn_OUT_SEL_CFG): the source, and bit 10, output enable by GPIO_ENABLE.
pub const PLAIN_OUTPUT: u32 = 256 | 1 << 10;
pub const PWM_OUTPUT: u32 = OutputSignal::LEDC_LS_SIG0 as u32 | 1 << 10;
pub const TICK_INTERRUPT: Interrupt = Interrupt::TG1_T0_LEVEL;
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

/// A timer of the second core's own, and the core.
pub struct ControlParts {
    timg1: peripherals::TIMG1<'static>,
    cpu: peripherals::CPU_CTRL<'static>,
}

pub fn parts(p: Peripherals) -> Parts {
    Parts {
        rtc_timer: p.RTC_TIMER,
        timg0: p.TIMG0,
        from_cpu_intr0: p.FROM_CPU_INTR0,
        flash: p.FLASH,
        ledc: p.LEDC,
        encoder: p.GPIO4.degrade(),
        pwm: p.GPIO16.degrade(),
        direction: p.GPIO17.degrade(),
        mark: p.GPIO19.degrade(),
        link: p.UART0,
        link_rx: p.GPIO3.degrade(),
        link_tx: p.GPIO1.degrade(),
        driver: p.UART1,
        control: ControlParts { timg1: p.TIMG1, cpu: p.CPU_CTRL },
    }
}

pub fn reset_cause() -> ResetCause {
    use SocResetReason as R;
    match reset_reason(Cpu::ProCpu) {
        Some(R::ChipPowerOn) => ResetCause::PowerOn,
        Some(R::CoreSw | R::Cpu0Sw) => ResetCause::Software,
        Some(R::SysBrownOut) => ResetCause::BrownOut,
        Some(R::CoreMwdt0 | R::CoreMwdt1 | R::CoreRtcWdt | R::CpuMwdt0 | R::Cpu0RtcWdt | R::SysRtcWdt) => {
            ResetCause::Watchdog
        }
        _ => ResetCause::Unknown,
    }
}

/// Starts the second core, which does nothing but the control interrupts.
pub fn start_control(parts: ControlParts, encoder: AnyPin<'static>, control: ControlLoop) {
    static STACK: ConstStaticCell<Stack<8192>> = ConstStaticCell::new(Stack::new());
    let core = CpuControl::new(parts.cpu).start_app_core(STACK.take(), move || {
        // The registers below are the timer's, which nothing else uses from here on.
        core::mem::forget(TimerGroup::new(parts.timg1));
        TIMG1::regs().int_ena().modify(|_, w| w.t(0).set_bit());
        let mut encoder = Input::new(encoder, InputConfig::default().with_pull(Pull::Up));
        interrupts::begin(control);
        encoder.listen(Event::AnyEdge);
        loop {
            // SAFETY: waits for an interrupt at any level; what they do is theirs.
            unsafe { core::arch::asm!("waiti 0") };
        }
    });
    // Dropping what a started core gives would stop it.
    core::mem::forget(core.expect("the second core was not started before"));
}

/// The timer's clock, 80 MHz, over this is 1 MHz.
const DIVIDER: u16 = 80;

/// Device time, µs.
#[inline(always)]
pub fn clock_us() -> u64 {
    Instant::now().duration_since_epoch().as_micros()
}

/// Starts the tick anew with this period.
pub fn set_tick_period(period_us: u32) {
    let timer = TIMG1::regs().t(0);
    timer.config().write(|w| w.en().clear_bit());
    // SAFETY: counts from zero to the period and starts again; every value is one the registers may have.
    unsafe {
        timer.loadlo().write(|w| w.bits(0));
        timer.loadhi().write(|w| w.bits(0));
        timer.load().write(|w| w.bits(1));
        timer.alarmlo().write(|w| w.bits(period_us));
        timer.alarmhi().write(|w| w.bits(0));
    }
    // SAFETY: as above.
    timer.config().write(|w| unsafe {
        w.divider().bits(DIVIDER).increase().set_bit().autoreload().set_bit();
        w.level_int_en().set_bit().alarm_en().set_bit().en().set_bit()
    });
}

/// Forgets that a tick is due, and lets the next one raise its interrupt.
#[inline(always)]
pub fn clear_tick() {
    TIMG1::regs().int_clr().write(|w| w.t(0).clear_bit_by_one());
    TIMG1::regs().t(0).config().modify(|_, w| w.alarm_en().set_bit());
}

/// Stops the core this is not called on.
pub fn stop_other_core() {
    let other = if Cpu::current() == Cpu::ProCpu { Cpu::AppCpu } else { Cpu::ProCpu };
    // SAFETY: only a panic calls this, and ends in a restart, which starts both cores anew. The instance is not used
    // for anything else.
    unsafe { CpuControl::new(peripherals::CPU_CTRL::steal()).park_core(other) };
}

/// The second core runs from flash too: it is parked while flash is written.
pub fn share_flash(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash.multicore_auto_park()
}

/// Timer counts the PWM unit's output is high, from the next period on.
#[inline(always)]
pub fn set_pwm(high: u32) {
    let channel = LEDC::regs().lsch(0);
    // SAFETY: the field has four fractional bits below the counts, which stay zero.
    channel.duty().write(|w| unsafe { w.duty().bits(high << 4) });
    // SAFETY: one step of no size: the duty is loaded as it stands.
    channel.conf1().write(|w| unsafe {
        w.duty_start().set_bit().duty_inc().set_bit().duty_num().bits(1).duty_cycle().bits(1).duty_scale().bits(0)
    });
    channel.conf0().modify(|_, w| w.para_up().set_bit());
}

/// Divides the unit's clock: 1/256ths.
#[inline(always)]
pub fn set_pwm_divider(divider: u32) {
    // SAFETY: the caller keeps the divider within 18 bits.
    LEDC::regs().lstimer(0).conf().modify(|_, w| unsafe { w.div_num().bits(divider).para_up().set_bit() });
}

/// Sets the unit's counter to zero.
#[inline(always)]
pub fn restart_pwm() {
    let conf = LEDC::regs().lstimer(0).conf();
    conf.modify(|_, w| w.rst().set_bit());
    conf.modify(|_, w| w.rst().clear_bit());
}

/// Lets each period's start raise an interrupt.
pub fn listen_pwm_period() {
    LEDC::regs().int_ena().write(|w| w.lstimer_ovf(0).set_bit());
}

/// Forgets that a period started.
#[inline(always)]
pub fn clear_pwm_period() {
    LEDC::regs().int_clr().write(|w| w.lstimer_ovf(0).clear_bit_by_one());
}
