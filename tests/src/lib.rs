//! An independent source of measurement folders in which effects are hidden.
//!
//! Nothing here is shared with the motor model of the host: the equations, the solver and the forms of the effects are
//! this crate's own, so a diagnosis that names an effect found here did not look into a mirror.

pub mod carrier;
pub mod experiment;
pub mod hidden;
pub mod motor;
pub mod noise;
pub mod solver;
pub mod tracking;
