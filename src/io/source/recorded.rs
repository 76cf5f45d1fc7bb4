//! A recorded run as a source: its raw pings at the pace at which they were recorded, all times moved to the present by the same
//! amount, and with each set what the pipeline was told then: wanted velocity, pose, operators' requests, "now".
//!
//! So the same commands are made again. A recording of the topics alone does not say when the daemon heard what: there pings are put
//! together by their times, and the wanted velocity is the newest.

use super::{Delivery, Moment, Source, SourceError};
use crate::io::record::reader::take_ping;
use crate::io::record::{Entry, RunReader};
use crate::io::ros::{PipelineStep, StepKind};
use crate::signal::{PingSet, SENSORS_MAX, Velocity};
use crate::time::{Clock, Stamp, SystemClock};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Triggers of one set, by the stamps of its pings, lie within this time.
const SET_NS: u64 = 20_000_000;

/// A recorded run, played back.
pub struct RecordedSource {
    path: PathBuf,
    slot_ns: u64,
    reader: RunReader,
    /// The set to be given next, with its recorded stamps.
    next: Option<PingSet>,
    /// Whether the recording says which pings the pipeline saw together; else it is guessed from their times.
    has_steps: bool,
    wanted: Option<Velocity>,
    /// The step of the set read last, and those before it.
    step: Option<PipelineStep>,
    steps: Vec<PipelineStep>,
    epoch: u64,
    /// Present time minus recorded time, on both clocks.
    offset: Option<(u64, u64)>,
    over: bool,
}

impl RecordedSource {
    /// Opens a recording of sensors that fire `slot_ns` after one another.
    ///
    /// # Errors
    /// One that cannot be read.
    pub fn open(path: &Path, slot_ns: u64) -> Result<Self, SourceError> {
        Ok(Self {
            slot_ns,
            path: path.to_owned(),
            reader: RunReader::open(path)?,
            next: None,
            has_steps: false,
            wanted: None,
            step: None,
            steps: Vec::new(),
            epoch: 0,
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
                    if self.has_steps || !is_whole(set, self.slot_ns) {
                        continue;
                    }
                }
                Entry::Step(step) => {
                    self.has_steps = true;
                    match StepKind::from_number(step.kind) {
                        Some(StepKind::Begin) => self.epoch = step.epoch,
                        Some(StepKind::PingSet) if set.iter_present().next().is_some() => {
                            set.emitted_at = step.set_emitted_at();
                            self.step = Some(step);
                            return Ok(true);
                        }
                        _ => self.steps.push(step),
                    }
                    continue;
                }
                Entry::Input(input) => {
                    self.wanted = Some(Velocity { linear_m_s: input.linear_m_s, angular_rad_s: input.angular_rad_s });
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

/// A recorded time, moved to the present.
fn moved(at: Stamp, (boottime_ns, wall_ns): (u64, u64)) -> Stamp {
    Stamp { boottime_ns: at.boottime_ns.wrapping_add(boottime_ns), wall_ns: at.wall_ns.wrapping_add(wall_ns) }
}

/// Whether every sensor of the set has delivered for one emission. A sensor that is missing is waited for until the next emission.
fn is_whole(set: &mut PingSet, slot_ns: u64) -> bool {
    let newest_ns = set.iter_present().map(|ping| ping.trigger_ns(slot_ns)).max().unwrap_or_default();
    for (ping, present) in set.pings.iter().zip(&mut set.present) {
        *present &= newest_ns - ping.trigger_ns(slot_ns) <= SET_NS;
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
        let offset = *self
            .offset
            .get_or_insert((now.boottime_ns.wrapping_sub(first.boottime_ns), now.wall_ns.wrapping_sub(first.wall_ns)));
        let wait_ns = moved(first, offset).since_ns(now).max(0).cast_unsigned();
        if Duration::from_nanos(wait_ns) > limit {
            self.next = Some(set);
            std::thread::sleep(limit);
            return Ok(Delivery::Nothing);
        }
        std::thread::sleep(Duration::from_nanos(wait_ns));
        set.pings.iter_mut().for_each(|ping| ping.emitted_at = moved(ping.emitted_at, offset));
        set.emitted_at = moved(set.emitted_at, offset);
        set.sequence = self.step.as_ref().map_or(pings.sequence + 1, |step| step.set_sequence);
        *pings = set;
        Ok(Delivery::Set)
    }

    fn moment(&mut self) -> Option<Moment> {
        let (step, offset) = (self.step.take()?, self.offset?);
        let mut steps = std::mem::take(&mut self.steps);
        for step in &mut steps {
            let now = moved(step.now(), offset);
            (step.t_monotonic_ns, step.t_wall_ns) = (now.boottime_ns, now.wall_ns);
            step.requested_at_ns = step.requested_at_ns.wrapping_add(offset.0);
        }
        Some(Moment {
            now: moved(step.now(), offset),
            wanted: step.wanted(),
            pose: step.pose(),
            steps,
            epoch: self.epoch,
        })
    }

    fn wanted_velocity(&self) -> Option<Velocity> {
        self.wanted
    }

    fn describe(&self) -> String {
        format!("recording {}", self.path.display())
    }
}
