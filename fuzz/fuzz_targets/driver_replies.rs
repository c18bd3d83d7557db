//! See `twum_fuzz::driver_replies`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| twum_fuzz::driver_replies(data));
