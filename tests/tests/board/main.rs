//! The real firmware library on its simulated board, with the host's own session on top, in virtual time.

mod bench;
mod faults;
mod recording;
mod runs;
