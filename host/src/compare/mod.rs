//! A measurement against the fixed-point model and the simulation.

pub mod closed_loop;
pub mod controller;
pub mod ordinary;
pub mod replay;
pub mod simulation;
