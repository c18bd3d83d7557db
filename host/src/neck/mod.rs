//! The neck simulator: three position-controlled motors in a spherical wrist doing range-of-motion exercises
//! (thesis, section A.8 and Table 5.6).

pub mod control;
pub mod disturbance;
pub mod exercise;
#[cfg(test)]
mod fixture;
pub mod foxglove;
pub mod joint;
pub mod kinematics;
pub mod load;
pub mod motor;
pub mod page;
pub mod path;
pub mod picture;
pub mod report;
pub mod score;
pub mod session;
pub mod study;
pub mod thesis_table;
