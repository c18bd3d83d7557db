//! Recordings and measurement folders: store, import, export.

pub mod check;
pub mod convert;
pub mod decode;
pub mod export;
pub mod live;
pub mod live_server;
pub mod load;
pub mod measurement;
pub mod plot;
mod protocol_1;
pub mod recording;
pub mod store;

#[cfg(test)]
pub(crate) mod synthetic;
