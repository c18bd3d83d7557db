//! The PWM unit (LEDC, channel 0 of timer 0), set up once; a board's file has the registers used afterwards.

use super::board;
use super::stage::Chip;
use esp_hal::gpio::{DriveMode, NoPin};
use esp_hal::ledc::channel::{self, Channel, ChannelIFace};
use esp_hal::ledc::timer::{self, LSClockSource, TimerIFace};
use esp_hal::ledc::{LSGlobalClkSource, Ledc, LowSpeed};
use esp_hal::peripherals::LEDC;
use esp_hal::time::Rate;
use twum_firmware::stage::{OFF, Registers};

/// Starts the unit at 50 Hz, connected to no pin: [`super::stage`] connects it.
pub fn start(ledc: LEDC<'static>) {
    let mut ledc = Ledc::new(ledc);
    ledc.set_global_slow_clock(LSGlobalClkSource::APBClk);
    let mut timer = ledc.timer::<LowSpeed>(timer::Number::Timer0);
    let config = timer::config::Config {
        duty: board::PWM_DUTY,
        clock_source: LSClockSource::APBClk,
        frequency: Rate::from_hz(50),
    };
    timer.configure(config).expect("50 Hz is within the unit's range at this resolution");
    let mut channel: Channel<'_, LowSpeed> = Channel::new(channel::Number::Channel0, NoPin);
    let config = channel::config::Config { timer: &timer, duty_pct: 99, drive_mode: DriveMode::PushPull };
    channel.configure(config).expect("the timer is configured");
    // Dropping it would stop the unit.
    core::mem::forget(ledc);
    // What the stage takes for "no drive yet"; loaded with the first period, 20 ms before anything can be armed.
    Chip.write_duty(OFF);
    Chip.start_duty();
    Chip.update_channel();
    board::listen_pwm_period();
}
