//! What the forty checks of the safety page share: how many trials each makes, and where its figures go.
//!
//! A plain test run makes about a thirtieth of the trials; `NOCTULE_FULL=1` makes all of them. Every figure is printed; where
//! `NOCTULE_FIGURES` names a file it is also appended there, a JSON object a line, which is where the README's table comes from.
#![allow(dead_code, reason = "every test file uses another part")]

use std::fmt::Display;
use std::io::Write as _;
use std::sync::atomic::{AtomicI32, Ordering};

/// Share of the trials that a plain run makes.
const SHARE: usize = 30;

/// A line of the file of figures; the number first, by which they are sorted.
#[derive(serde::Serialize)]
struct Figure<'a> {
    check: u8,
    what: &'a str,
    found: String,
    bar: &'a str,
    trials: usize,
    full: bool,
}

/// Whether all trials are asked for.
pub fn is_full() -> bool {
    std::env::var("NOCTULE_FULL").is_ok_and(|value| value == "1")
}

/// Trials to make where the full run makes `full`; a plain run makes a thirtieth, rounded up, and at least `least`.
pub fn trials(full: usize, least: usize) -> usize {
    if is_full() { full } else { full.div_ceil(SHARE).max(least.min(full)) }
}

/// Tells a measured figure of check `number` (1 to 40): what it is of, how many trials it rests on, and the bar it is held to, in
/// words. To be called before the bar is asserted, so that a miss is on record too.
pub fn figure(number: u8, what: &str, found: impl Display, bar: &str, trials: usize) {
    assert!((1..=40).contains(&number), "there are forty checks, not {number}");
    println!("check {number:02}: {what}: {found} ({bar}) in {trials} trials");
    let Some(path) = std::env::var_os("NOCTULE_FIGURES") else { return };
    let line = Figure { check: number, what, found: found.to_string(), bar, trials, full: is_full() };
    let line = serde_json::to_string(&line).expect("JSON");
    let file = std::fs::File::options().create(true).append(true).open(&path);
    // One write call a line: test processes may append side by side.
    let written = file.and_then(|mut file| file.write_all(format!("{line}\n").as_bytes()));
    written.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

static TEST_THREAD: AtomicI32 = AtomicI32::new(0);

/// Says that this thread runs the test, wherever the test runner put it.
pub fn is_the_test() {
    TEST_THREAD.store(rustix::thread::gettid().as_raw_nonzero().get(), Ordering::Relaxed);
}

/// Whether this thread is the test runner's own: it tells of tests that take more than a minute, and allocates for it. Allocates nothing.
pub fn is_the_test_runner() -> bool {
    let thread = rustix::thread::gettid();
    thread == rustix::process::getpid() && thread.as_raw_nonzero().get() != TEST_THREAD.load(Ordering::Relaxed)
}
