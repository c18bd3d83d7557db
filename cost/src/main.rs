//! What a control step costs on the chips' instruction set.
//!
//! One program in two halves. Built for RISC-V it runs bare-metal in QEMU (`guest`): it takes recorded inputs, runs the
//! fixed-point step, the thesis's doubles and the frame encoder over them, and counts the instructions of each call.
//! Built for the host (`host`) it makes the inputs, starts QEMU, compares every output with its own, bit for bit, and
//! prints the table.
#![cfg_attr(target_os = "none", no_std, no_main)]

mod exchange;
mod work;

#[cfg(not(target_os = "none"))]
mod binary;
#[cfg(target_os = "none")]
mod guest;
#[cfg(not(target_os = "none"))]
mod host;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    host::main()
}
