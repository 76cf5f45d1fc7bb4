//! How long something took, less the time in which this thread was ready to run and other programs had the processor: what it would have
//! taken on an idle machine. Where the system does not tell, simply how long it took.

use std::time::{Duration, Instant};

/// A start.
#[derive(Debug, Clone, Copy)]
pub struct Lap {
    begin: Instant,
    waited: Duration,
}

impl Lap {
    pub fn start() -> Self {
        Self { waited: waited(), begin: Instant::now() }
    }

    pub fn took(&self) -> Duration {
        let elapsed = self.begin.elapsed();
        elapsed.saturating_sub(waited().saturating_sub(self.waited))
    }
}

/// Time that this thread has waited for a processor since it began: the second number of its statistics.
fn waited() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let waited_ns = text.split_whitespace().nth(1).and_then(|number| number.parse().ok());
    Duration::from_nanos(waited_ns.unwrap_or(0))
}
