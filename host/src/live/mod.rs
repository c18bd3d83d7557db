//! What `twum live` shows: in the terminal, and to Foxglove on this machine.

mod gate;
mod screen;
mod server;

pub use screen::draw;
pub use server::{LiveServer, LiveServerError, TOPIC_LIVE, TOPIC_LOG};
