//! The real firmware library on its simulated board, with the host's own session on top, in virtual time.

mod bench;
mod chaos;
mod closed_loop;
mod configuration;
mod dead_encoder;
mod document;
mod drives;
mod faults;
mod holding;
mod link;
mod recording;
mod restart;
mod runs;
mod saturated_link;
mod silicon;
mod soak;
mod sound_encoder;
mod text_mode;
