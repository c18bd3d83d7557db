//! Figures (SVG, PNG) and self-contained HTML pages, made without a display and equal byte for byte for equal input.

pub mod comparison;
pub mod diagnosis;
pub mod figure;
pub mod identified;
pub mod neck;
pub mod ordinary;
pub mod page;
pub mod run;
pub mod speed;
pub mod table;
