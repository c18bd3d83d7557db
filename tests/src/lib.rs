//! Independent sources of measurement folders in which effects are hidden.
//!
//! Nothing here is shared with the motor model of the host: the equations, the solver and the forms of the effects are
//! this crate's own, so a diagnosis that names an effect found here did not look into a mirror. There are five, written
//! apart from one another:
//!
//! - `carrier` to `tracking` below: one motor, checked at carrier resolution, one design (see [`experiment`]);
//! - [`rotor`]: any motor of the kind, its rotor equation integrated within each PWM period;
//! - [`profile`]: no rotor equation, but how speed rises and falls in a period, as smooth random curves;
//! - [`contact`]: a rotor on a travelling wave, through a contact whose torque over the slip is drawn for each motor;
//! - [`envelope`]: two standing waves by their envelopes, and a rotor that hangs on them by bristles.
//!
//! The last four write [`folder`]s with a [`truth`] beside each, and share with one another that format, the way a run is driven and the
//! definition of an effect's [`strength`]; [`contact`] and [`envelope`] take their source of random numbers from [`profile`]. No more.

pub mod carrier;
pub mod contact;
pub mod drive;
pub mod drives;
pub mod envelope;
pub mod experiment;
pub mod first;
pub mod folder;
pub mod friction;
pub mod hidden;
pub mod motor;
pub mod noise;
pub mod profile;
mod refitted;
pub mod rotor;
pub mod solver;
pub mod strength;
pub mod suite;
pub mod trace;
pub mod tracking;
pub mod truth;
pub mod twins;
