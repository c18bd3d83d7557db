//! What the neck simulator gives, for people: pictures, a page to play, and scores beside the thesis's table.

pub mod page;
pub mod picture;
pub mod report;
