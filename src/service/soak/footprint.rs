//! What this process holds of the machine: memory, descriptors, threads, shared memory. Read from `/proc`; nothing where there is none.

use serde::Serialize;

/// A reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Footprint {
    /// Memory in use.
    pub rss_kib: u64,
    /// Open descriptors.
    pub descriptors: u64,
    /// Threads.
    pub threads: u64,
    /// Files of shared memory that are mapped.
    pub shared_files: u64,
}

impl Footprint {
    /// Reads the present one.
    #[must_use]
    pub fn read() -> Option<Self> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let field = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name))?;
            line.split_whitespace().next()?.parse().ok()
        };
        let mut shared: Vec<String> =
            std::fs::read_to_string("/proc/self/maps").ok()?.lines().filter_map(shared_file).collect();
        shared.sort_unstable();
        shared.dedup();
        Some(Self {
            rss_kib: field("VmRSS:")?,
            // The folder itself is open while it is read.
            descriptors: (std::fs::read_dir("/proc/self/fd").ok()?.count() as u64).saturating_sub(1),
            threads: field("Threads:")?,
            shared_files: shared.len() as u64,
        })
    }
}

fn shared_file(line: &str) -> Option<String> {
    line.find("/dev/shm/").map(|at| line[at..].to_owned())
}
