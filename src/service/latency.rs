//! Latencies of the last minutes in a fixed room: newest value, median, 99th percentile, maximum since the start.

/// Values kept: 100 s at 10 Hz.
const KEPT: usize = 1024;

/// A ring of latencies. Allocates at the start only.
#[derive(Debug, Clone)]
pub struct Latencies {
    ring: Vec<f32>,
    sorted: Vec<f32>,
    next: usize,
    max_ms: f32,
}

/// What can be said of latencies; zeros when there are none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LatencySummary {
    /// The newest.
    pub newest_ms: f64,
    /// Median of those kept.
    pub p50_ms: f64,
    /// 99th percentile of those kept.
    pub p99_ms: f64,
    /// Largest of all.
    pub max_ms: f64,
}

impl Default for Latencies {
    fn default() -> Self {
        Self { ring: Vec::with_capacity(KEPT), sorted: Vec::with_capacity(KEPT), next: 0, max_ms: 0.0 }
    }
}

impl Latencies {
    /// Adds one.
    pub fn add(&mut self, latency_ms: f64) {
        let value = latency_ms as f32;
        if self.ring.len() < KEPT {
            self.ring.push(value);
        } else {
            self.ring[self.next] = value;
        }
        self.next = (self.next + 1) % KEPT;
        self.max_ms = self.max_ms.max(value);
    }

    /// Sums up; sorts a copy in room that was reserved at the start.
    pub fn summary(&mut self) -> LatencySummary {
        if self.ring.is_empty() {
            return LatencySummary::default();
        }
        self.sorted.clear();
        self.sorted.extend_from_slice(&self.ring);
        self.sorted.sort_unstable_by(f32::total_cmp);
        // Nearest-rank percentile: the smallest value that at least this share does not exceed.
        let rank = |share: f64| {
            let index = (share * self.sorted.len() as f64).ceil() as usize;
            f64::from(self.sorted[index.clamp(1, self.sorted.len()) - 1])
        };
        let newest = (self.next + KEPT - 1) % KEPT;
        LatencySummary {
            newest_ms: f64::from(self.ring[newest]),
            p50_ms: rank(0.50),
            p99_ms: rank(0.99),
            max_ms: f64::from(self.max_ms),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let mut latencies = Latencies::default();
        (1..=100).for_each(|value| latencies.add(f64::from(value)));
        let summary = latencies.summary();
        assert_eq!(summary, LatencySummary { newest_ms: 100.0, p50_ms: 50.0, p99_ms: 99.0, max_ms: 100.0 });
    }

    #[test]
    fn the_maximum_outlives_the_ring() {
        let mut latencies = Latencies::default();
        latencies.add(500.0);
        (0..3 * KEPT).for_each(|_| latencies.add(1.0));
        let summary = latencies.summary();
        assert_eq!((summary.p99_ms, summary.max_ms, summary.newest_ms), (1.0, 500.0, 1.0));
    }

    #[test]
    fn nothing_measured_is_zero() {
        assert_eq!(Latencies::default().summary(), LatencySummary::default());
    }
}
