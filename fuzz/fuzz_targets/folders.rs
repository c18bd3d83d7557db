//! See `twum_fuzz::folders`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| twum_fuzz::folders(data));
