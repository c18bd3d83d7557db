//! What was identified, for people: pictures and text.

pub mod figures;
pub mod text;
