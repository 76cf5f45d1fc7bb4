//! A panic ends the whole process with 70: a daemon or controller with a thread missing must not go on.
//!
//! The panicking thread never unwinds: it sets the flag that asks the others to end, which tell the robot zero, and ends the
//! process when they had time for it. Its last words go to standard error from a thread of their own, since that may be blocked.

use std::cell::Cell;
use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Exit code of an internal error.
pub const EXIT_INTERNAL: u8 = 70;
/// Time that the other threads have to tell the robot zero. The process must be gone 200 ms after the panic.
const LAST_WORDS: Duration = Duration::from_millis(60);

static DYING: AtomicBool = AtomicBool::new(false);

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// From now on a panic in any thread, but for [`contained`] ones, sets `stop` and ends the process with [`EXIT_INTERNAL`].
pub fn end_on_panic(stop: &Arc<AtomicBool>) {
    let stop = Arc::clone(stop);
    std::panic::set_hook(Box::new(move |panic| {
        if CONTAINED.try_with(Cell::get).unwrap_or(false) {
            return;
        }
        DYING.store(true, Ordering::Relaxed);
        stop.store(true, Ordering::Relaxed);
        let thread = std::thread::current();
        let told = panic.to_string().replace('\n', " ");
        let line = format!("internal error: thread {} {told}\n", thread.name().unwrap_or("without a name"));
        let speaker = std::thread::Builder::new().name("last words".to_owned());
        // Without a thread it ends without a word.
        let _ = speaker.spawn(move || std::io::stderr().write_all(line.as_bytes()));
        std::thread::sleep(LAST_WORDS);
        signal_hook::low_level::exit(i32::from(EXIT_INTERNAL));
    }));
}

/// Whether a thread panicked: whoever ends in order meanwhile must not say that all was well.
#[must_use]
pub fn is_dying() -> bool {
    DYING.load(Ordering::Relaxed)
}

/// Runs `call`, whose panics the caller catches and answers for: libraries that panic where they should return an error.
pub fn contained<T>(call: impl FnOnce() -> T) -> T {
    /// Sets the mark back however the call ends.
    struct Mark(bool);
    impl Drop for Mark {
        fn drop(&mut self) {
            CONTAINED.set(self.0);
        }
    }
    let _mark = Mark(CONTAINED.replace(true));
    call()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::{Duration, Instant};

    /// Threads that no test can reach into, such as those that watch over the transport's calls, fall under the same rule.
    #[test]
    fn a_panic_of_a_thread_that_nobody_knows_ends_the_process_with_70() {
        const CHILD: &str = "NOCTULE_TEST_PANIC_CHILD";
        if std::env::var_os(CHILD).is_some() {
            super::end_on_panic(&Arc::default());
            let watch = std::thread::Builder::new().name("noctule-test watch".to_owned());
            watch.spawn(|| panic!("planted")).unwrap();
            std::thread::sleep(Duration::from_secs(10));
            std::process::exit(0);
        }
        let program = std::env::current_exe().unwrap();
        let test = "life::panic::tests::a_panic_of_a_thread_that_nobody_knows_ends_the_process_with_70";
        let began = Instant::now();
        let output = std::process::Command::new(program).args(["--exact", test]).env(CHILD, "1").output().unwrap();
        assert_eq!(output.status.code(), Some(70));
        assert!(began.elapsed() < Duration::from_secs(5));
    }
}
