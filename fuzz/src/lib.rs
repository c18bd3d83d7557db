//! What each fuzz target does with its input: one function a target. Nothing here touches the file system, so that a
//! target runs tens of thousands of times a second. `tests/tests/fuzz_corpus.rs` runs the kept corpus through the same
//! functions on every test run.

mod sealed;

mod driver_replies;
mod frames;

#[cfg(feature = "host")]
mod blocks;
#[cfg(feature = "host")]
mod folders;
#[cfg(feature = "host")]
mod motors;
#[cfg(feature = "host")]
mod recordings;

pub use driver_replies::driver_replies;
pub use frames::frames;

#[cfg(feature = "host")]
pub use {blocks::blocks, folders::folders, motors::motors, recordings::recordings};
