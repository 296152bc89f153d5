#![no_main]

#[path = "../targets/record_stream.rs"]
mod target;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| target::run(bytes));
