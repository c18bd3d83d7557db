//! A panic, or an exception (which esp-hal turns into one): output off for good, then the message on the link, then a
//! restart that knows why.

use super::board;
use super::stage::{Chip, FLAGS};
use esp_hal::peripherals::UART0;
use esp_hal::ram;
use portable_atomic::{AtomicU32, Ordering};
use twum_firmware::fatal::{self, System};
use twum_firmware::output::Latch;
use twum_shared::message::ResetCause;

/// Shut by the first panic; the output refuses from then on.
pub static LATCH: Latch = Latch::new();

/// Survives a software reset; a random word after power came. The ESP32's second core reaches only the slow memory.
#[cfg_attr(target_arch = "xtensa", ram(unstable(rtc_slow, persistent)))]
#[cfg_attr(target_arch = "riscv32", ram(unstable(rtc_fast, persistent)))]
static MARK: AtomicU32 = AtomicU32::new(0);

/// Words that memory does not hold by chance.
const PANICKED: u32 = 0x9a41_c0de;
const REBOOTED: u32 = 0x4eb0_07ed;

/// Why the program restarted itself, if it did; asked once.
pub fn take_mark() -> Option<ResetCause> {
    match MARK.swap(0, Ordering::Relaxed) {
        PANICKED => Some(ResetCause::Panic),
        REBOOTED => Some(ResetCause::Software),
        _ => None,
    }
}

impl System for Chip {
    fn mask_interrupts(&self) {
        board::mask_interrupts();
    }

    fn hold_other_core(&self) {
        board::hold_other_core();
    }

    fn release_other_core(&self) {
        board::release_other_core();
    }

    fn reset(&self) {
        esp_hal::system::software_reset();
    }
}

fn end(mark: u32) {
    fatal::silence(&Chip, &Chip, &FLAGS, &LATCH);
    MARK.store(mark, Ordering::Relaxed);
}

fn restart() -> ! {
    loop {
        fatal::restart(&Chip);
    }
}

/// Restarts on the host's request.
pub fn reboot() -> ! {
    end(REBOOTED);
    restart()
}

/// Called by esp-backtrace before it does anything else.
#[unsafe(no_mangle)]
fn custom_pre_backtrace() {
    end(PANICKED);
    // Ends the frame that was on its way: what follows is text, and no frame can be taken out of it.
    esp_println::Printer::write_bytes(&[0]);
}

/// Called by esp-backtrace after the message and the backtrace.
#[unsafe(no_mangle)]
fn custom_halt() -> ! {
    // The reset would cut off what the transmit FIFO still holds: up to 128 bytes, 1.4 ms. Reading a register takes 10 ns or
    // more, so that this ends after 10 ms and more even if the line does not move; a timer may have failed.
    for _ in 0..1_000_000 {
        if UART0::regs().status().read().txfifo_cnt().bits() == 0 {
            break;
        }
    }
    // The byte on the line: 11 µs, and as many reads.
    for _ in 0..10_000 {
        let _ = UART0::regs().status().read();
    }
    restart()
}
