//! Recordings and measurement folders: store, import, export.

pub mod check;
pub mod convert;
pub mod decode;
mod earlier;
pub mod export;
mod gate;
pub mod live;
pub mod live_server;
pub mod load;
pub mod measurement;
pub mod order;
pub mod pieces;
pub mod plot;
pub mod recording;
pub mod series;
pub mod store;

#[cfg(test)]
pub(crate) mod synthetic;
