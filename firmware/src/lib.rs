//! Firmware for travelling-wave ultrasonic motors, generic over the board.
//!
//! A board supplies an [`output::OutputStage`], two byte streams and an encoder pin; this library does the rest:
//!
//! - [`control::Control::tick`] runs in a hardware-timer interrupt every control period. It owns the output, the supervisor
//!   and every fault monitor: nothing else can energise the motor.
//! - [`encoder::EncoderInterrupt::edge`] runs in the encoder pin's interrupt.
//! - [`link::receive`], [`link::transmit`], [`driver::serve`], [`store::keep`] and [`watchdog::supervise`] are async tasks
//!   on the communication core.
//!
//! They share one [`Shared`] and the queues of [`queues::Queues`]; nothing here allocates, and the control path neither
//! waits nor uses floating point.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(clippy::float_arithmetic, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

pub mod control;
pub mod count;
pub mod driver;
pub mod encoder;
pub mod fatal;
pub mod link;
mod mailbox;
pub mod output;
pub mod queues;
pub mod shared;
pub mod stage;
pub mod standstill;
pub mod store;
pub mod watchdog;

pub use shared::Shared;
