//! The neck simulator: three position-controlled motors in a spherical wrist doing range-of-motion exercises
//! (thesis, section A.8 and Table 5.6).

pub mod exercise;
pub mod kinematics;
pub mod path;
