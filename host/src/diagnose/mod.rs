//! Showing what the simulation gets wrong, naming the cause, and saying how sure that is.

pub mod effects;
pub mod fit;
pub mod observe;
pub mod problem;
pub mod rotor;
pub mod search;
pub mod stats;
