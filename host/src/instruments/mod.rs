//! Bench instruments over SCPI, the frequency sweep of a stator, and a simulated bench to try both on.
//!
//! Equipment and wiring are the thesis's (sections A.1.1 and B.1): a two-channel generator drives the stator's phases, a
//! shunt carries the current of the first, an oscilloscope sees both ends of the shunt.

pub mod generator;
pub mod oscilloscope;
pub mod scpi;
pub mod simulate;
pub mod sweep;
