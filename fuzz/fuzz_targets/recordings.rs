//! See `twum_fuzz::recordings`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| twum_fuzz::recordings(data));
