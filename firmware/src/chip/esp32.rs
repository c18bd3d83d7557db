//! ESP32: two Xtensa cores. Control owns the second, communication the first.

use super::interrupts::{self, ControlLoop};
use esp_hal::gpio::{AnyPin, Event, Input, InputConfig, InputSignal, OutputSignal, Pin, Pull};
use esp_hal::ledc::timer::config::Duty;
use esp_hal::peripherals::{self, GPIO, IO_MUX, Interrupt, LEDC, Peripherals, TIMG1};
use esp_hal::rtc_cntl::{SocResetReason, reset_reason};
use esp_hal::system::{Cpu, CpuControl, Stack};
use esp_hal::time::Instant;
use esp_hal::timer::timg::TimerGroup;
use esp_storage::FlashStorage;
use static_cell::ConstStaticCell;
use twum_firmware::standstill::{Moving, Standstill};
use twum_shared::message::ResetCause;

pub const CHIP: &str = "esp32";
pub const ENCODER_PIN: u8 = 4;
pub const PWM_PIN: u8 = 16;
pub const DIRECTION_PIN: u8 = 17;
pub const MARK_PIN: u8 = 19;
pub const STOP_PIN: u8 = 18;

pub const PWM_DUTY: Duty = Duty::Duty14Bit;
/// GPIO matrix words (reference manual, GPIO_FUNCn_OUT_SEL_CFG): the source, and bit 10, output enable by GPIO_ENABLE.
pub const PLAIN_OUTPUT: u32 = 256 | 1 << 10;
pub const PWM_OUTPUT: u32 = OutputSignal::LEDC_LS_SIG0 as u32 | 1 << 10;
pub const UART_OUTPUT: u32 = OutputSignal::U1TXD as u32 | 1 << 10;
pub const TICK_INTERRUPT: Interrupt = Interrupt::TG1_T0_LEVEL;
/// IO MUX: the function that gives a pad to the GPIO matrix.
const GPIO_FUNCTION: u8 = 2;

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
        // The registers below are the timers', which nothing else uses from here on.
        core::mem::forget(TimerGroup::new(parts.timg1));
        TIMG1::regs().int_ena().modify(|_, w| w.t(0).set_bit());
        start_clock();
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

/// The timers' clock, 80 MHz, over this is 1 MHz: the tick's.
const TICK_DIVIDER: u16 = 80;
/// And over this 16 MHz, the rate of the system's clock: the control core's.
const CLOCK_DIVIDER: u16 = 5;
const CLOCK_PER_US: u64 = 16;

/// Starts the control core's clock, timer 1 of its own group, with the system's time. Both run from the same 80 MHz.
///
/// The system's clock is one latch for both cores: what one reads, low word, then high, may be latched anew in between by
/// the other, and is 2^32 counts (268 s) off when the low word rolls over there. Nobody else latches this one.
fn start_clock() {
    let timer = TIMG1::regs().t(1);
    let now = Instant::now().duration_since_epoch().as_micros() * CLOCK_PER_US;
    // SAFETY: every value is one the registers may have.
    unsafe {
        timer.loadlo().write(|w| w.bits(now as u32));
        timer.loadhi().write(|w| w.bits((now >> 32) as u32));
        timer.load().write(|w| w.bits(1));
        timer.config().write(|w| w.divider().bits(CLOCK_DIVIDER).increase().set_bit().en().set_bit());
    }
}

/// Device time, µs; on the control core only.
#[inline(always)]
pub fn clock_us() -> u64 {
    let timer = TIMG1::regs().t(1);
    let before = timer.lo().read().bits();
    // SAFETY: any value latches the counter.
    timer.update().write(|w| unsafe { w.bits(1) });
    // The latch is made in the timer's own clock, within a count of it: the words are the old ones until then.
    for _ in 0..CLOCK_DIVIDER {
        if timer.lo().read().bits() != before {
            break;
        }
    }
    let (high, low) = (timer.hi().read().bits(), timer.lo().read().bits());
    ((u64::from(high) << 32) | u64::from(low)) / CLOCK_PER_US
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
        w.divider().bits(TICK_DIVIDER).increase().set_bit().autoreload().set_bit();
        w.level_int_en().set_bit().alarm_en().set_bit().en().set_bit()
    });
}

/// Forgets that a tick is due, and lets the next one raise its interrupt.
#[inline(always)]
pub fn clear_tick() {
    TIMG1::regs().int_clr().write(|w| w.t(0).clear_bit_by_one());
    TIMG1::regs().t(0).config().modify(|_, w| w.alarm_en().set_bit());
}

/// Takes this core's interrupts away: level 15 masks every one that can be.
#[inline(always)]
pub fn mask_interrupts() {
    // SAFETY: this core's interrupt level, which nothing lowers again before the reset that ends what calls this.
    unsafe { core::arch::asm!("rsil {0}, 15", out(reg) _, options(nostack)) };
}

fn other_core() -> Cpu {
    if Cpu::current() == Cpu::ProCpu { Cpu::AppCpu } else { Cpu::ProCpu }
}

/// Stalls the core this is not called on.
pub fn hold_other_core() {
    // SAFETY: only what ends in a restart calls this. The instance is not used again.
    unsafe { CpuControl::new(peripherals::CPU_CTRL::steal()).park_core(other_core()) };
}

/// Releases the core this is not called on.
pub fn release_other_core() {
    // SAFETY: as above.
    CpuControl::new(unsafe { peripherals::CPU_CTRL::steal() }).unpark_core(other_core());
}

/// Writing stalls both cores: they share the flash. The control core has asked for that when it comes to it ([`super::flash`]).
pub fn share_flash(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash.multicore_auto_park()
}

/// Asks the control core to stand still.
pub async fn stand_still(still: &Standstill) -> Result<(), Moving> {
    still.begin(|| embassy_time::Timer::after_millis(1)).await
}

/// Gives a pin's pad to the GPIO matrix, with 5 mA; one that listens is pulled up and may be read.
#[inline(always)]
pub fn take_pad(pin: u8, listens: bool) {
    let pads = IO_MUX::regs();
    let pad = match pin {
        PWM_PIN => pads.gpio16(),
        DIRECTION_PIN => pads.gpio17(),
        STOP_PIN => pads.gpio18(),
        _ => pads.gpio19(),
    };
    // SAFETY: a function and a strength every pad has.
    pad.write(|w| unsafe {
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

/// Resets the chip when its supply sags. Below its specified voltage a core may do anything, and the driver board, which has
/// a supply of its own, would obey. The threshold is the lowest, 2.43 V: the chip is specified from 2.3 V, and the dips of a
/// radio or a USB supply stay above it.
pub fn watch_supply() {
    // SAFETY: the longest wait before the reset, 0x3ff slow cycles (7 ms), as a sag shorter than that resets nothing.
    peripherals::LPWR::regs().brown_out().modify(|_, w| unsafe {
        w.dbrown_out_thres().bits(0).rst_wait().bits(0x3ff).rst_ena().set_bit().ena().set_bit()
    });
}

/// Timer counts the PWM unit's output is high.
#[inline(always)]
pub fn write_duty(high: u32) {
    // SAFETY: the field has four fractional bits below the counts, which stay zero.
    LEDC::regs().lsch(0).duty().write(|w| unsafe { w.duty().bits(high << 4) });
}

/// The duty that was written is to start: one step of no size.
#[inline(always)]
pub fn start_duty() {
    // SAFETY: counts within their fields.
    LEDC::regs().lsch(0).conf1().write(|w| unsafe {
        w.duty_start().set_bit().duty_inc().set_bit().duty_num().bits(1).duty_cycle().bits(1).duty_scale().bits(0)
    });
}

/// The PWM unit is to take what was written for its channel.
#[inline(always)]
pub fn update_channel() {
    LEDC::regs().lsch(0).conf0().modify(|_, w| w.para_up().set_bit());
}

/// The counts the PWM unit's output is high now.
#[inline(always)]
pub fn loaded_duty() -> u32 {
    LEDC::regs().lsch(0).duty_r().read().bits() >> 4
}

/// Divides the PWM unit's clock: 1/256ths.
pub fn write_divider(divider: u32) {
    // SAFETY: the caller keeps the divider within 18 bits.
    LEDC::regs().lstimer(0).conf().modify(|_, w| unsafe { w.div_num().bits(divider) });
}

/// The PWM unit is to take what was written for its timer.
pub fn update_timer() {
    LEDC::regs().lstimer(0).conf().modify(|_, w| w.para_up().set_bit());
}

/// The PWM unit's counter.
#[inline(always)]
pub fn count() -> u32 {
    LEDC::regs().lstimer(0).value().read().bits()
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
