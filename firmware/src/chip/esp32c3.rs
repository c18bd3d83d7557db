//! ESP32-C3's own.
//!
//! The pins are plain GPIO at reset ("IO MUX and GPIO Matrix", table "IO MUX Pin Functions": function 0 of GPIO 0, 1, 3 and
//! 10 is the GPIO itself). GPIO 4 to 7 would not be: they are the JTAG port's then, of which 4 is an input and serves as one; 2, 8
//! and 9 choose how the chip boots.

use esp_hal::peripherals::{LEDC, LPWR};

pub const CHIP: &str = "esp32c3";
pub const ENCODER_PIN: u8 = 0;
pub const PWM_PIN: u8 = 10;
pub const DIRECTION_PIN: u8 = 3;
pub const MARK_PIN: u8 = 1;
pub const STOP_PIN: u8 = 4;

/// The pins other drivers take: encoder, link's receive and transmit.
macro_rules! pins {
    ($p:ident) => {
        ($p.GPIO0.degrade(), $p.GPIO20.degrade(), $p.GPIO21.degrade())
    };
}
pub(super) use pins;

/// The duty that was written is to start: one step of no size.
#[inline(always)]
pub fn start_duty() {
    // SAFETY: counts within their fields.
    LEDC::regs().ch(0).conf1().write(|w| unsafe {
        w.duty_start().set_bit().duty_inc().set_bit().duty_num().bits(1).duty_cycle().bits(1).duty_scale().bits(0)
    });
}

/// Resets the chip when its supply sags. Below its specified voltage a core may do anything, and the driver board, which has
/// a supply of its own, would obey. The detector's threshold stays the chip's own.
pub fn watch_supply() {
    LPWR::regs().brown_out().modify(|_, w| unsafe {
        // SAFETY: the longest wait before the reset, 0x3ff slow cycles (7 ms), as a sag shorter than that resets nothing.
        w.brown_out_rst_wait().bits(0x3ff);
        // The whole system, not the core alone: the pads too.
        w.brown_out_rst_sel().set_bit().brown_out_rst_ena().set_bit().brown_out_ena().set_bit()
    });
}
