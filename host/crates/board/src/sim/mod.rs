//! The simulated board: the firmware library itself, run in virtual time against a simulated driver board and motor.
//!
//! [`Board`] is deterministic: the same [`Setup`] and the same bytes at the same times give the same bytes back. Its clock
//! ([`clock`]) belongs to the thread it runs on, so boards on different threads do not disturb each other.

mod board;
pub mod clock;
mod driver_board;
mod firmware;
mod flash;
mod hybrid;
mod motor;
mod silicon;
mod wire;

pub use board::{Board, Disturbance, Setup};
pub use driver_board::DriverHealth;
pub use hybrid::{HybridMotor, NotOnABoard, Simulated};
pub use motor::{FirstOrderMotor, SimulatedMotor};
pub use silicon::{Chip, Half, PadEdge};
