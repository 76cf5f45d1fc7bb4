//! Drivers as a source: raw pings of all sensors from their topics, grouped into ping sets by time of emission.
//!
//! A set is complete when every sensor delivered, and is given up for complete at a deadline after its first ping, or, where the
//! sensors fire in turn, after the last sensor's turn; what is missing then is absent. A ping that comes later belongs to no set and is dropped.

use super::{Delivery, Source, SourceError};
use crate::io::{LiveTopics, RawRefusal};
use crate::signal::{PingSet, SENSORS_MAX};
use crate::time::{Clock, SystemClock};
use std::time::{Duration, Instant};

/// Pause between two looks at the topics; a set waits at most this much longer than it must.
const LOOK_PAUSE: Duration = Duration::from_micros(500);
/// Pings of one sensor taken in one look: a flood must not keep the others waiting.
const LOOK_PINGS_MAX: usize = 8;
/// Pings whose triggers lie further apart than this belong to different sets; a sensor's turn is taken off its emission.
const SAME_EMISSION_NS: u64 = 20_000_000;

/// Raw pings from other processes.
pub struct LiveSource {
    topics: LiveTopics,
    group_deadline: Duration,
    slot_ns: u64,
    sensor_count: usize,
    /// When a set that has begun is given up for complete.
    due: Option<Instant>,
    sequence: u64,
    refused_count: u64,
    /// Trigger of the newest set delivered: older pings are late.
    delivered_ns: u64,
}

impl LiveSource {
    /// Listens to opened topics. A set waits `group_deadline` for its sensors after the first of them, and `slot_ns` more for every turn
    /// that is still to come; zero where all fire together.
    #[must_use]
    pub fn new(topics: LiveTopics, sensor_count: usize, group_deadline: Duration, slot_ns: u64) -> Self {
        Self {
            topics,
            group_deadline,
            slot_ns,
            sensor_count,
            due: None,
            sequence: 0,
            refused_count: 0,
            delivered_ns: 0,
        }
    }

    /// Takes what has arrived; pings of an older emission are dropped, a newer emission replaces an incomplete older one.
    fn collect(&mut self, pings: &mut PingSet) {
        for index in 0..self.sensor_count.min(SENSORS_MAX) {
            for _ in 0..LOOK_PINGS_MAX {
                let Some(result) = self.topics.poll(index, &mut pings.pings[index], SystemClock.now()) else { break };
                match result {
                    Ok(()) => self.place(index, pings),
                    Err(refusal) => self.refuse(index, &refusal),
                }
            }
        }
    }

    fn place(&mut self, index: usize, pings: &mut PingSet) {
        let trigger_ns = pings.pings[index].trigger_ns(self.slot_ns);
        if trigger_ns <= self.delivered_ns.saturating_add(SAME_EMISSION_NS) && self.delivered_ns > 0 {
            pings.present[index] = false;
            return;
        }
        let others = (0..pings.pings.len()).filter(|other| pings.present[*other] && *other != index);
        let newest_ns = others.map(|other| pings.pings[other].trigger_ns(self.slot_ns)).max();
        if newest_ns.is_some_and(|newest_ns| trigger_ns > newest_ns.saturating_add(SAME_EMISSION_NS)) {
            pings.present = [false; SENSORS_MAX];
            self.due = None;
        }
        pings.present[index] =
            newest_ns.is_none_or(|newest_ns| trigger_ns.saturating_add(SAME_EMISSION_NS) >= newest_ns);
        let turns = self.sensor_count.saturating_sub(index + 1) as u64;
        let wait = self.group_deadline + Duration::from_nanos(self.slot_ns.saturating_mul(turns));
        self.due.get_or_insert_with(|| Instant::now() + wait);
    }

    fn refuse(&mut self, index: usize, refusal: &RawRefusal) {
        self.refused_count += 1;
        // The first tells what is wrong; a driver that goes on being wrong is counted, not repeated.
        if self.refused_count.is_power_of_two() {
            log::warn!("raw ping of sensor {index} refused ({} so far): {refusal}", self.refused_count);
        }
    }

    fn deliver(&mut self, pings: &mut PingSet) -> Delivery {
        self.due = None;
        let oldest = pings.iter_present().map(|ping| ping.emitted_at).min();
        let present = (0..pings.pings.len()).filter(|index| pings.present[*index]);
        let newest = present.map(|index| pings.pings[index].trigger_ns(self.slot_ns)).max();
        let (Some(oldest), Some(newest_ns)) = (oldest, newest) else { return Delivery::Nothing };
        pings.emitted_at = oldest;
        pings.sequence = self.sequence;
        self.sequence += 1;
        self.delivered_ns = newest_ns;
        Delivery::Set
    }
}

impl Source for LiveSource {
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError> {
        let begin = Instant::now();
        if self.due.is_none() {
            pings.present = [false; SENSORS_MAX];
        }
        loop {
            self.collect(pings);
            let complete = pings.present.iter().filter(|present| **present).count() == self.sensor_count;
            let late = self.due.is_some_and(|due| Instant::now() >= due);
            if complete || late {
                return Ok(self.deliver(pings));
            }
            if begin.elapsed() >= limit {
                return Ok(Delivery::Nothing);
            }
            std::thread::sleep(LOOK_PAUSE);
        }
    }

    fn describe(&self) -> String {
        "drivers on the raw topics".to_owned()
    }
}
