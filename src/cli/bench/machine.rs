//! What this machine can do, measured in a second: the rates that counted floors are divided by. And what a process took of it.
//!
//! In: nothing. Out: multiply-adds a second of a single-precision matrix product on all cores, bytes a second of copying,
//! the peak of this process's memory. Never decides anything.

use crate::cli::series::cores;
use nalgebra::DMatrix;
use std::time::{Duration, Instant};

/// Side of the matrices: three of them fit into a second-level cache, as the tiles of a good product do.
const SIDE: usize = 256;
/// Bytes that a copy moves, far more than any cache holds: read half of them, write the other half.
const COPY_BYTES: usize = 256 << 20;
/// Time that each measurement goes on for.
const DURATION: Duration = Duration::from_millis(400);

/// Rates of the whole machine, all cores together.
#[derive(Debug, Clone, Copy)]
pub struct Rates {
    /// Single-precision multiply-adds a second, in matrix products.
    pub multiply_adds_hz: f64,
    /// Bytes a second, each read and each written one counted.
    pub memory_bytes_s: f64,
}

impl Rates {
    /// Measures both; takes about a second.
    #[must_use]
    pub fn measure() -> Self {
        let cores = cores();
        Self { multiply_adds_hz: on_all(cores, products), memory_bytes_s: on_all(cores, move |end| copies(end, cores)) }
    }

    /// Shortest time for a stage, in milliseconds: whichever of the two takes longer.
    #[must_use]
    pub fn floor_ms(&self, operations: u64, bytes: u64) -> f64 {
        1e3 * (operations as f64 / self.multiply_adds_hz).max(bytes as f64 / self.memory_bytes_s)
    }
}

/// Sum of the rates of as many threads.
fn on_all(count: usize, rate: impl Fn(Instant) -> f64 + Sync) -> f64 {
    let end = Instant::now() + DURATION;
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..count).map(|_| scope.spawn(|| rate(end))).collect();
        threads.into_iter().filter_map(|thread| thread.join().ok()).sum()
    })
}

/// Best rate of one thread until `end`: what the machine can, not what others left of it.
fn products(end: Instant) -> f64 {
    let value = |row: usize, column: usize| ((row * 7 + column * 3) % 13) as f32 - 6.0;
    let (a, b) = (DMatrix::from_fn(SIDE, SIDE, value), DMatrix::from_fn(SIDE, SIDE, value));
    let mut c = DMatrix::<f32>::zeros(SIDE, SIDE);
    best(end, || {
        // The product of large matrices is the matrixmultiply crate's, with the widest instructions that it knows.
        c.gemm(1.0, &a, &b, 0.0);
        std::hint::black_box(&mut c);
        (SIDE * SIDE * SIDE) as f64
    })
}

fn copies(end: Instant, threads: usize) -> f64 {
    let len = COPY_BYTES / 2 / threads;
    let from = vec![1_u8; len];
    let mut to = vec![0_u8; len];
    best(end, || {
        to.copy_from_slice(std::hint::black_box(&from));
        std::hint::black_box(&mut to);
        2.0 * len as f64
    })
}

fn best(end: Instant, mut work: impl FnMut() -> f64) -> f64 {
    let mut best = 0.0_f64;
    while best == 0.0 || Instant::now() < end {
        let start = Instant::now();
        let done = work();
        best = best.max(done / start.elapsed().as_secs_f64().max(1e-9));
    }
    best
}

/// Lets the peak begin again from what is resident now. Where the system does not know how, the peak stays what it was: too
/// high rather than too low.
pub fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Largest resident set of this process so far; `None` where the system does not tell.
#[must_use]
pub fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_floor_is_the_slower_of_the_two() {
        let rates = Rates { multiply_adds_hz: 1e9, memory_bytes_s: 2e9 };
        assert_eq!(rates.floor_ms(5_000_000, 2_000_000), 5.0);
        assert_eq!(rates.floor_ms(500_000, 2_000_000), 1.0);
    }
}
