//! See `twum_fuzz::motors`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| twum_fuzz::motors(data));
