//! Parameters from measurements: stator circuit, friction, force factor.

pub mod circuit;
pub mod figures;
pub mod fit;
pub mod friction;
pub mod modes;
pub mod read;
pub mod sine;
pub mod stator;
pub mod sweep;
pub mod thesis;
