//! Recordings and measurement folders: store, import, export.
