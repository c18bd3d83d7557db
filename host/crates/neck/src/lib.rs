//! The neck simulator: three position-controlled motors in a spherical wrist doing range-of-motion exercises
//! (thesis, section A.8 and Table 5.6).
//!
//! ```
//! use twum_neck::exercise::Exercise;
//! use twum_neck::fixture::setup;
//! use twum_neck::score::Score;
//!
//! let setup = setup(twum_motor::parameters::Flavour::Physical);
//! let session = setup.simulate(&Exercise::shipped("rotation").expect("a shipped exercise"))?;
//! let score = Score::of(&session, &setup);
//! assert!(score.mean_abs_error_m < 0.05, "{} m", score.mean_abs_error_m);
//! # Ok::<(), twum_neck::session::SessionError>(())
//! ```

pub mod control;
pub mod disturbance;
pub mod exercise;
pub mod fixture;
pub mod foxglove;
pub mod joint;
pub mod kinematics;
pub mod load;
pub mod motor;
pub mod path;
pub mod score;
pub mod session;
pub mod study;
pub mod thesis_table;
