//! The contract between chip and host.
#![no_std]
#![forbid(unsafe_code)]
