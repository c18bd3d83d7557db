//! Recordings and measurement folders: store, import, export.

pub mod check;
pub mod convert;
pub mod measurement;
pub mod store;
