//! Recordings as a source: one file a sensor, at the pace of the control rate, stamped with the present.
//!
//! For looking at recordings with the whole daemon; `noctule process` is the way to reprocess them.

use super::{Delivery, Source, SourceError};
use crate::io::recording_file::{FileHints, RecordingError, RecordingFile};
use crate::signal::PingSet;
use crate::time::{Clock, Stamp, SystemClock};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Recordings played back together.
pub struct ReplaySource {
    files: Vec<RecordingFile>,
    period_ns: u64,
    /// From one sensor's turn to the next one's.
    slot_ns: u64,
    next: Option<Stamp>,
    sequence: u64,
}

impl ReplaySource {
    /// Opens one recording for each sensor, in the order of the configuration; sensors without a file are absent.
    /// `raw_lens` are the values that a ping of each sensor must have, for `hints` see [`RecordingFile::open`].
    ///
    /// # Errors
    /// A file that cannot be read or does not fit the configuration.
    pub fn open(
        paths: &[PathBuf],
        hints: impl Into<FileHints>,
        expected: &PingSet,
        rate_hz: f64,
        slot_ns: u64,
    ) -> Result<Self, SourceError> {
        let hints = hints.into();
        let mut files = Vec::with_capacity(paths.len());
        for (path, ping) in paths.iter().zip(&expected.pings) {
            let file = RecordingFile::open(path, hints)?;
            let shape = file.shape();
            let len = shape.sample_count * shape.channel_count.unwrap_or(1);
            if shape.format != ping.samples.format() || len != ping.samples.len() {
                return Err(misfit(path, &file, ping.samples.format().as_str(), ping.samples.len()).into());
            }
            files.push(file);
        }
        if paths.len() > expected.pings.len() {
            let message =
                format!("found {} files, the configuration has {} sensors", paths.len(), expected.pings.len());
            return Err(SourceError::Other(message));
        }
        Ok(Self { files, period_ns: (1e9 / rate_hz) as u64, slot_ns, next: None, sequence: 0 })
    }
}

fn misfit(path: &Path, file: &RecordingFile, format: &str, len: usize) -> RecordingError {
    let shape = file.shape();
    let found = shape.sample_count * shape.channel_count.unwrap_or(1);
    RecordingError::Content {
        path: path.to_owned(),
        found: format!("{} pings of {found} values", shape.format.as_str()),
        allowed: format!("{format} pings of {len} values, as the configuration says"),
    }
}

impl Source for ReplaySource {
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError> {
        let now = SystemClock.now();
        let due = *self.next.get_or_insert(now);
        let wait_ns = due.since_ns(now).max(0).cast_unsigned();
        if Duration::from_nanos(wait_ns) > limit {
            std::thread::sleep(limit);
            return Ok(Delivery::Nothing);
        }
        std::thread::sleep(Duration::from_nanos(wait_ns));
        // The last sensor's turn is now: no ping is from the future.
        let now = SystemClock.now();
        let turn = |turns: usize| {
            let ago_ns = self.slot_ns.saturating_mul(turns as u64);
            Stamp { boottime_ns: now.boottime_ns.saturating_sub(ago_ns), wall_ns: now.wall_ns.saturating_sub(ago_ns) }
        };
        let last = pings.pings.len().saturating_sub(1);
        self.next = Some(due.plus_ns(self.period_ns));
        pings.present = [false; crate::signal::SENSORS_MAX];
        let mut any = false;
        for (index, file) in self.files.iter_mut().enumerate() {
            let ping = &mut pings.pings[index];
            match file.read_ping(ping.samples_mut()) {
                Ok(more) => pings.present[index] = more,
                // One truncated file ends alone; the others go on.
                Err(error) => log::error!("{error}"),
            }
            ping.sequence = self.sequence;
            ping.emitted_at = turn(last - index.min(last));
            any |= pings.present[index];
        }
        pings.sequence = self.sequence;
        pings.emitted_at = turn(last);
        self.sequence += 1;
        Ok(if any { Delivery::Set } else { Delivery::End })
    }

    fn describe(&self) -> String {
        let names: Vec<String> = self.files.iter().map(|file| file.path().display().to_string()).collect();
        format!("recording {}", names.join(", "))
    }
}
