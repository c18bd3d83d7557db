//! Host side of a travelling-wave ultrasonic motor bench: what its crates find, as pictures, pages and tables, and a
//! demonstration. The `twum` command stands on it; the crates below are given on under the names of what they hold.

pub mod compare;
pub mod demo;
pub mod live;
pub mod origin;
pub mod plot;
pub mod pulses;
pub mod report;
pub mod serve;

pub use twum_board::{link, sim};
pub use twum_diagnose as diagnose;
pub use twum_files::{input, output};
pub use twum_identify as identify;
pub use twum_instruments as instruments;
pub use twum_motor as model;
pub use twum_neck as neck;
pub use twum_record as record;
pub use twum_record::configuration;
pub use twum_signal as signal;
pub use twum_tune as tune;
