//! Hands the linker the chip's memory layout, which esp-hal provides, and what is to run from RAM. A host build needs none.

fn main() {
    println!("cargo:rerun-if-changed=rwtext_hook.x");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let folder = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
        println!("cargo:rustc-link-search={folder}");
        println!("cargo:rustc-link-arg-bins=-Tlinkall.x");
    }
}
