//! A measurement against the fixed-point model and the simulation.

pub mod controller;
pub mod replay;
pub mod simulation;
