//! Recordings and measurement folders: store, import, export.

pub mod measurement;
