//! Generator D: a rotor with inertia on a travelling wave, pulled through a contact whose torque over the slip is a smooth
//! random rising function, drawn for each motor.
//!
//! The wave is the slow envelope of the stator's two modes, each a damped resonator a little off its drive: it builds up and
//! dies in every PWM period, and turns round through a standing wave. Speed and angle are integrated with steps that follow
//! the contact, and edges are found on them. What is hidden acts through random functions drawn from a Gaussian process over
//! what the effect hangs on.

pub mod acting;
pub mod bench;
pub mod effects;
pub mod encoder;
pub mod loops;
pub mod make;
pub mod motor;
pub mod smooth;

pub use make::make;
