//! Host side of a travelling-wave ultrasonic motor bench.

pub mod compare;
pub mod configuration;
pub mod demo;
pub mod diagnose;
pub mod identify;
pub mod input;
pub mod instruments;
pub mod link;
pub mod model;
pub mod neck;
pub mod output;
pub mod record;
pub mod report;
pub mod signal;
pub mod sim;
