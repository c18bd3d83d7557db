//! ESP32-C6's own.
//!
//! The pins are plain GPIO at reset ("IO MUX and GPIO Matrix", table "IO MUX Pin Functions").

use esp_hal::peripherals::{LEDC, LP_ANA};

pub const CHIP: &str = "esp32c6";
pub const ENCODER_PIN: u8 = 20;
pub const PWM_PIN: u8 = 18;
pub const DIRECTION_PIN: u8 = 19;
pub const MARK_PIN: u8 = 21;
pub const STOP_PIN: u8 = 22;

/// The pins other drivers take: encoder, link's receive and transmit.
macro_rules! pins {
    ($p:ident) => {
        ($p.GPIO20.degrade(), $p.GPIO17.degrade(), $p.GPIO16.degrade())
    };
}
pub(super) use pins;

/// The duty that was written is to start: one step of no size.
#[inline(always)]
pub fn start_duty() {
    let unit = LEDC::regs();
    unit.ch(0).conf1().write(|w| w.duty_start().set_bit());
    // SAFETY: counts within their fields.
    unit.ch_gamma_wr(0).write(|w| unsafe {
        w.ch_gamma_duty_inc().set_bit().ch_gamma_duty_num().bits(1).ch_gamma_duty_cycle().bits(1);
        w.ch_gamma_scale().bits(0)
    });
}

/// Resets the chip when its supply sags. Below its specified voltage a core may do anything, and the driver board, which has
/// a supply of its own, would obey. The detector's threshold stays the chip's own.
pub fn watch_supply() {
    LP_ANA::regs().bod_mode0_cntl().modify(|_, w| unsafe {
        // SAFETY: the longest wait before the reset, 0x3ff slow cycles (7 ms), as a sag shorter than that resets nothing.
        w.bod_mode0_reset_wait().bits(0x3ff);
        // The whole system, not the core alone: the pads too.
        w.bod_mode0_reset_sel().set_bit().bod_mode0_reset_ena().set_bit()
    });
}
