//! The contract between chip and host of a travelling-wave ultrasonic motor bench.
//!
//! Everything here is pure, integer-only and allocation-free: the chip's interrupt, the simulated board and the host's
//! check of a recording call the same [`step::step`], so a recording replays bit for bit. Frames ([`frame`]) carry
//! [`message`]s over any byte stream.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(clippy::float_arithmetic, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

pub mod alignment;
pub mod bits;
pub mod driver;
pub mod duty;
pub mod encoder;
pub mod fault;
pub mod frame;
pub mod message;
pub mod reference;
pub mod safety;
pub mod stall;
pub mod step;

pub use duty::{Direction, Duty};
pub use fault::Fault;
