//! A recorded run as a source: its raw pings at the pace at which they were recorded, stamped with the present.
//!
//! For looking at a recording with the whole daemon, with the wanted velocity of then. What differs from then is "now" itself;
//! `noctule replay` repeats a run to the bit. Sensors keep the times between their emissions.

use super::{Delivery, Source, SourceError};
use crate::io::record::reader::take_ping;
use crate::io::record::{Entry, RunReader};
use crate::io::ros::StepKind;
use crate::signal::{PingSet, SENSORS_MAX, Velocity};
use crate::time::{Clock, Stamp, SystemClock};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Emissions of one set lie within this time.
const SET_NS: i64 = 20_000_000;

/// A recorded run, played back.
pub struct RecordedSource {
    path: PathBuf,
    reader: RunReader,
    /// The set to be given next, with its recorded stamps.
    next: Option<PingSet>,
    /// Whether the recording says which pings the pipeline saw together; else it is guessed from their times.
    has_steps: bool,
    wanted: Option<Velocity>,
    next_wanted: Option<Velocity>,
    /// Present time minus recorded time, on both clocks.
    offset: Option<(u64, u64)>,
    over: bool,
}

impl RecordedSource {
    /// Opens a recording.
    ///
    /// # Errors
    /// One that cannot be read.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        Ok(Self {
            path: path.to_owned(),
            reader: RunReader::open(path)?,
            next: None,
            has_steps: false,
            wanted: None,
            next_wanted: None,
            offset: None,
            over: false,
        })
    }

    /// Reads the next set with its recorded stamps into `set`; false at the end.
    fn read(&mut self, set: &mut PingSet) -> Result<bool, SourceError> {
        set.present = [false; SENSORS_MAX];
        while let Some(entry) = self.reader.next_entry()? {
            match entry {
                Entry::Raw(_, ping) => {
                    take_ping(&self.path, &ping, set)?;
                    if self.has_steps || !is_whole(set) {
                        continue;
                    }
                }
                Entry::Step(step) => {
                    self.has_steps = true;
                    let is_set = StepKind::from_number(step.kind) == Some(StepKind::PingSet);
                    if !is_set || set.iter_present().next().is_none() {
                        continue;
                    }
                    self.next_wanted =
                        Some(Velocity { linear_m_s: step.wanted_linear_m_s, angular_rad_s: step.wanted_angular_rad_s });
                }
                Entry::Input(input) => {
                    self.next_wanted =
                        Some(Velocity { linear_m_s: input.linear_m_s, angular_rad_s: input.angular_rad_s });
                    continue;
                }
                _ => continue,
            }
            set.emitted_at = set.iter_present().map(|ping| ping.emitted_at).min().unwrap_or_default();
            return Ok(true);
        }
        Ok(false)
    }
}

/// Whether every sensor of the set has delivered for one emission. A sensor that is missing is waited for until the next emission.
fn is_whole(set: &mut PingSet) -> bool {
    let newest = set.iter_present().map(|ping| ping.emitted_at).max().unwrap_or_default();
    for (ping, present) in set.pings.iter().zip(&mut set.present) {
        *present &= newest.since_ns(ping.emitted_at) <= SET_NS;
    }
    set.iter_present().count() == set.pings.len()
}

impl Source for RecordedSource {
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError> {
        let mut set = match self.next.take() {
            Some(set) => set,
            None if self.over => return Ok(Delivery::End),
            None => {
                let mut set = pings.clone();
                if !self.read(&mut set)? {
                    self.over = true;
                    return Ok(Delivery::End);
                }
                set
            }
        };
        let now = SystemClock.now();
        let first = set.emitted_at;
        let (boottime_ns, wall_ns) = *self
            .offset
            .get_or_insert((now.boottime_ns.wrapping_sub(first.boottime_ns), now.wall_ns.wrapping_sub(first.wall_ns)));
        let shifted = |at: Stamp| Stamp {
            boottime_ns: at.boottime_ns.wrapping_add(boottime_ns),
            wall_ns: at.wall_ns.wrapping_add(wall_ns),
        };
        let wait_ns = shifted(first).since_ns(now).max(0).cast_unsigned();
        if Duration::from_nanos(wait_ns) > limit {
            self.next = Some(set);
            std::thread::sleep(limit);
            return Ok(Delivery::Nothing);
        }
        std::thread::sleep(Duration::from_nanos(wait_ns));
        set.pings.iter_mut().for_each(|ping| ping.emitted_at = shifted(ping.emitted_at));
        set.emitted_at = shifted(set.emitted_at);
        set.sequence = pings.sequence + 1;
        *pings = set;
        self.wanted = self.next_wanted;
        Ok(Delivery::Set)
    }

    fn wanted_velocity(&self) -> Option<Velocity> {
        self.wanted
    }

    fn describe(&self) -> String {
        format!("recording {}", self.path.display())
    }
}
