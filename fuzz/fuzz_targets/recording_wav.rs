//! `cargo fuzz run recording_wav`: see `fuzz/README.md`.
#![no_main]

#[path = "../../tests/bad_input_entries/mod.rs"]
mod bad_input_entries;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    bad_input_entries::run("recording_wav", bytes);
});
