//! A panic, or an exception (which esp-hal turns into one): output off, then the message on the link, then a restart that
//! knows why.

use super::board;
use super::stage::{Chip, FLAGS};
use esp_hal::ram;
use portable_atomic::{AtomicU32, Ordering};
use twum_firmware::stage::{off, off_whatever_the_role};
use twum_shared::message::ResetCause;

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

/// Restarts on the host's request.
pub fn reboot() -> ! {
    off(&Chip, &FLAGS);
    MARK.store(REBOOTED, Ordering::Relaxed);
    esp_hal::system::software_reset()
}

/// Called by esp-backtrace before it does anything else.
#[unsafe(no_mangle)]
fn custom_pre_backtrace() {
    off_whatever_the_role(&Chip, &FLAGS);
    // A control core that still runs could drive again.
    board::stop_other_core();
    off_whatever_the_role(&Chip, &FLAGS);
    MARK.store(PANICKED, Ordering::Relaxed);
    // Ends the frame that was on its way: what follows is text, and no frame can be taken out of it.
    esp_println::Printer::write_bytes(&[0]);
}

/// Called by esp-backtrace after the message and the backtrace.
#[unsafe(no_mangle)]
fn custom_halt() -> ! {
    // The transmit FIFO holds 128 bytes: 1.4 ms. Busy waiting needs no timer that may have failed.
    for _ in 0..5_000_000 {
        core::hint::spin_loop();
    }
    esp_hal::system::software_reset()
}
