//! Gives the linker the memory of QEMU's `virt` machine. The host half needs none.

use std::{env, fs, path::PathBuf};

fn main() {
    println!("cargo:rerun-if-changed=virt.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
        fs::copy("virt.x", out.join("virt.x")).expect("cargo's output directory is writable");
        println!("cargo:rustc-link-search={}", out.display());
        println!("cargo:rustc-link-arg-bins=-Tvirt.x");
    }
}
