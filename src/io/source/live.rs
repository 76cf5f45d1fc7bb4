//! Drivers as a source: raw pings of all sensors from their topics, grouped into ping sets by time of emission.
//!
//! A set is complete when every sensor delivered, and is given up for complete at a deadline after its first ping; what
//! is missing then is absent. A ping that comes later belongs to no set and is dropped.

use super::{Delivery, Source, SourceError};
use crate::io::{LiveTopics, RawRefusal};
use crate::signal::{PingSet, SENSORS_MAX};
use crate::time::{Clock, SystemClock};
use std::time::{Duration, Instant};

/// Pause between two looks at the topics; a set waits at most this much longer than it must.
const LOOK_PAUSE: Duration = Duration::from_micros(500);
/// Pings of one sensor taken in one look: a flood must not keep the others waiting.
const LOOK_PINGS_MAX: usize = 8;
/// Pings whose emissions lie further apart than this belong to different sets.
const SAME_EMISSION_NS: u64 = 20_000_000;

/// Raw pings from other processes.
pub struct LiveSource {
    topics: LiveTopics,
    group_deadline: Duration,
    sensor_count: usize,
    began: Option<Instant>,
    sequence: u64,
    refused_count: u64,
    /// Emission of the newest set delivered: older pings are late.
    delivered_ns: u64,
}

impl LiveSource {
    /// Listens to opened topics. A set waits `group_deadline` for its sensors after the first of them.
    #[must_use]
    pub fn new(topics: LiveTopics, sensor_count: usize, group_deadline: Duration) -> Self {
        Self { topics, group_deadline, sensor_count, began: None, sequence: 0, refused_count: 0, delivered_ns: 0 }
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
        let emitted_ns = pings.pings[index].emitted_at.boottime_ns;
        if emitted_ns <= self.delivered_ns.saturating_add(SAME_EMISSION_NS) && self.delivered_ns > 0 {
            pings.present[index] = false;
            return;
        }
        let others = pings.pings.iter().zip(pings.present).enumerate();
        let newest = others.filter(|(other, (_, present))| *present && *other != index);
        let newest_ns = newest.map(|(_, (ping, _))| ping.emitted_at.boottime_ns).max();
        if newest_ns.is_some_and(|newest_ns| emitted_ns > newest_ns.saturating_add(SAME_EMISSION_NS)) {
            pings.present = [false; SENSORS_MAX];
            self.began = None;
        }
        pings.present[index] =
            newest_ns.is_none_or(|newest_ns| emitted_ns.saturating_add(SAME_EMISSION_NS) >= newest_ns);
        self.began.get_or_insert_with(Instant::now);
    }

    fn refuse(&mut self, index: usize, refusal: &RawRefusal) {
        self.refused_count += 1;
        // The first tells what is wrong; a driver that goes on being wrong is counted, not repeated.
        if self.refused_count.is_power_of_two() {
            log::warn!("raw ping of sensor {index} refused ({} so far): {refusal}", self.refused_count);
        }
    }

    fn deliver(&mut self, pings: &mut PingSet) -> Delivery {
        self.began = None;
        let stamps = || pings.iter_present().map(|ping| ping.emitted_at);
        let (Some(oldest), Some(newest)) = (stamps().min(), stamps().max()) else { return Delivery::Nothing };
        pings.emitted_at = oldest;
        pings.sequence = self.sequence;
        self.sequence += 1;
        self.delivered_ns = newest.boottime_ns;
        Delivery::Set
    }
}

impl Source for LiveSource {
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError> {
        let begin = Instant::now();
        if self.began.is_none() {
            pings.present = [false; SENSORS_MAX];
        }
        loop {
            self.collect(pings);
            let complete = pings.present.iter().filter(|present| **present).count() == self.sensor_count;
            let late = self.began.is_some_and(|began| began.elapsed() >= self.group_deadline);
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
