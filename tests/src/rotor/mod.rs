//! Generator B: any motor of the kind, its rotor equation integrated in time within each PWM period.
//!
//! The rotor is drawn towards the crest of a wave that comes and goes with the drive, by a friction that saturates; with
//! the wave gone the same friction, or less of it, holds it against the stator. Edges are solved for in each step, and
//! the recorder sees nothing else.

pub mod design;
pub mod effects;
pub mod loops;
pub mod make;
pub mod motion;
pub mod recorder;
pub mod shape;

pub use make::make;
