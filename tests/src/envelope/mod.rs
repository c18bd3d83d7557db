//! Generator E: the envelopes of two standing waves, and a rotor that hangs on them by bristles.
//!
//! The stator is two orthogonal modes of slowly varying complex amplitude ([`stator`]), pushed by a supply that the PWM gates.
//! Where the modes are in quadrature they make a travelling wave; its surface drags bristles that bend, slip and are let go of as
//! the crests pass, and the bristles drag the rotor ([`bristles`], after Dahl). Without a wave the same bristles hold it.
//! Effects ([`effects`], [`acting`]) change the push, the tuning, the grip, the path of the duty, the encoder or the clock.

pub mod acting;
pub mod bench;
pub mod bristles;
pub mod curves;
pub mod effects;
pub mod loops;
pub mod make;
pub mod motor;
pub mod ride;
pub mod scene;
pub mod stator;
pub mod wheel;

pub use make::make;
