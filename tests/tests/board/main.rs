//! The real firmware library on its simulated board, with the host's own session on top, in virtual time.

mod bench;
mod chaos;
mod closed_loop;
mod configuration;
mod document;
mod faults;
mod link;
mod recording;
mod runs;
mod silicon;
mod soak;
