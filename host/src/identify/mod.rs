//! Parameters from measurements: stator circuit, friction, force factor.
