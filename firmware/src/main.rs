//! The binary for a chip: see the module `chip`. Everything else is the library.
#![cfg_attr(target_os = "none", no_std, no_main)]
// Inline assembly for Xtensa is not stable; espup's toolchain takes it.
#![cfg_attr(target_arch = "xtensa", feature(asm_experimental_arch))]

#[cfg(target_os = "none")]
mod chip;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!(
        "This is firmware: it runs on a chip. In the folder `firmware`:\n  \
         ESP32:    cargo run --release     (espup's toolchain)\n  \
         ESP32-C3: cargo +stable c3\n  \
         ESP32-C6: cargo +stable c6\n\
         Without a chip, `twum sim` runs the same firmware on a simulated board."
    );
    std::process::ExitCode::from(2)
}
