//! Bench instruments over SCPI.
