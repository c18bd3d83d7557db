//! Parameters from measurements: stator circuit, friction, force factor.

pub mod circuit;
pub mod figures;
pub mod fit;
pub mod force_factor;
pub mod friction;
pub mod modes;
pub mod read;
pub mod save;
pub mod sine;
pub mod stator;
pub mod sweep;
pub mod thesis;
