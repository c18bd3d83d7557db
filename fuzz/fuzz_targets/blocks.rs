//! See `twum_fuzz::blocks`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| twum_fuzz::blocks(data));
