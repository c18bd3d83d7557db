//! Controllers for the motor on the bench: identified from a short run, designed, and tried on what is not known of it.
//!
//! ```
//! use twum_motor::motor::Motor;
//! use twum_motor::parameters::Flavour;
//! use twum_shared::step::ConfigSpec;
//! use twum_tune::margins::{Margins, Rig};
//!
//! // How far the shipped motor may be another before the default controller swings.
//! let motor = Motor::pcbmotor_30mm();
//! let rig = Rig::of(&motor, Flavour::Measured);
//! let margins = Margins::of(&rig, &ConfigSpec::DEFAULT).expect("a valid controller").expect("it is stable");
//! assert!(margins.gain > 1.5 && margins.delay_ms > 5.0);
//! ```

pub mod design;
pub mod fit;
pub mod margins;
pub mod plan;
pub mod predict;
