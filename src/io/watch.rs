//! Frees a process that hangs inside the transport: whatever opens a shared-memory file waits for ever for one whose maker was
//! killed before the file had a size, and sending and receiving open the connections of new peers.
//!
//! In: the ports of a set-up. Out: a thread that looks whether one of them is inside the same call for too long, and then removes
//! what is half made. While all is well it looks at some numbers 40 times a second, and neither allocates nor touches a file. No
//! point of a peer's start is known at which a port hangs; set-up and end, which do, sweep by themselves.

use super::files;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Pause between two looks. A call that takes longer than this hangs: the longest healthy one takes microseconds.
const LOOK_PAUSE: Duration = Duration::from_millis(25);
/// Time that a file gets to become whole before it is removed. With the looks before, a hang ends within 100 ms, which is well
/// within the 250 ms after which a platform stops by itself.
const PATIENCE: Duration = Duration::from_millis(50);

/// Counts the beginnings and ends of a port's calls: odd inside of one.
#[derive(Debug, Clone, Default)]
pub(super) struct Calls(Arc<AtomicU64>);

impl Calls {
    /// Runs a call of the transport under the eyes of the watch.
    pub(super) fn during<R>(&self, call: impl FnOnce() -> R) -> R {
        self.0.fetch_add(1, Ordering::Relaxed);
        let result = call();
        self.0.fetch_add(1, Ordering::Relaxed);
        result
    }
}

/// Watches `ports` until all of them are dropped. Without a thread to spare there is no watch, and a hang is left to the
/// supervisor and to the platform's own timeout.
pub(super) fn start(node_name: &str, prefix: String, ports: Vec<Calls>) {
    let watch = move || {
        let mut seen: Vec<u64> = vec![0; ports.len()];
        // The port's own count is gone when only ours is left.
        while ports.iter().any(|calls| Arc::strong_count(&calls.0) > 1) {
            std::thread::sleep(LOOK_PAUSE);
            let mut hangs = false;
            for (calls, seen) in ports.iter().zip(&mut seen) {
                let now = calls.0.load(Ordering::Relaxed);
                hangs |= now % 2 == 1 && now == *seen;
                *seen = now;
            }
            if hangs {
                files::sweep_half_made(&prefix, PATIENCE);
            }
        }
    };
    let thread = std::thread::Builder::new().name(format!("{node_name} watch"));
    if let Err(error) = thread.spawn(watch) {
        log::warn!("nobody watches over {node_name}: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::time::Instant;

    #[test]
    fn a_file_that_a_call_waits_for_is_removed_within_a_quarter_of_a_second() {
        let prefix = format!("watch{}_", std::process::id());
        let path = Path::new(files::SHARED_MEMORY).join(format!("{prefix}{}_1.connection", "0".repeat(40)));
        let calls = Calls::default();
        start("test", prefix, vec![calls.clone()]);
        std::fs::write(&path, "").expect("half made");
        std::thread::sleep(Duration::from_millis(200));
        assert!(path.exists(), "nobody waits for it");
        let begun = Instant::now();
        calls.during(|| {
            while path.exists() && begun.elapsed() < Duration::from_secs(2) {
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        let took = begun.elapsed();
        assert!(!path.exists() && took < Duration::from_millis(250), "{took:?}");
    }
}
