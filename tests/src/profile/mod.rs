//! Generator C: no rotor equation. How the speed rises while the drive is on and falls while it is off are smooth random
//! curves; each run follows them pulse by pulse, and the angle is their integral.
//!
//! Effects are smooth random functions of what they hang on, seldom formulas, and act on those curves.

pub mod bench;
pub mod course;
pub mod effects;
pub mod loops;
pub mod make;
pub mod random;

pub use make::make;
