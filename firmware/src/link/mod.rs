//! The link to the host: one task receives, one task owns transmission.

mod receive;
mod transmit;

pub use receive::receive;
pub use transmit::{About, transmit};
