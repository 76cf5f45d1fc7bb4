//! The simulated robot as a source: it emits in real time, hears its world, and obeys only `noctule/platform`.
//!
//! A ping set is made at its time of emission and delivered when a sensor would have recorded its last sample. Motion goes
//! on meanwhile, by what the controller process commands; a robot that hears nothing for 250 ms stops, as a real base does.

use super::{Delivery, Source, SourceError};
use crate::io::{InputPublisher, Ipc, PlatformSubscriber};
use crate::signal::{PingSet, Velocity};
use crate::sim::Simulator;
use crate::time::{Clock, Stamp, SystemClock};
use std::time::Duration;

/// The base's own watchdog.
const SILENCE_LIMIT_NS: i64 = 250_000_000;
/// Motion is integrated at least this often.
const STEP_NS: u64 = 5_000_000;

/// A simulator between the topics of a robot's platform.
pub struct SimulatorSource {
    simulator: Simulator,
    platform: PlatformSubscriber,
    odometry: InputPublisher,
    period_ns: u64,
    recording_ns: u64,
    next_emission: Option<Stamp>,
    /// Emission of the set that waits in the caller's buffer for its last sample.
    waiting: Option<Stamp>,
    moved_to: Option<Stamp>,
    velocity: Velocity,
    heard_at: Stamp,
    touched: bool,
}

impl SimulatorSource {
    /// Connects a simulator that emits `rate_hz` times a second and records for `recording_s`, all turns of a set included.
    ///
    /// # Errors
    /// When the platform's topics cannot be opened.
    pub fn open(simulator: Simulator, ipc: &Ipc, rate_hz: f64, recording_s: f64) -> Result<Self, SourceError> {
        Ok(Self {
            simulator,
            platform: PlatformSubscriber::open(ipc)?,
            odometry: InputPublisher::open(ipc, true)?,
            period_ns: (1e9 / rate_hz) as u64,
            recording_ns: (1e9 * recording_s) as u64,
            next_emission: None,
            waiting: None,
            moved_to: None,
            velocity: Velocity::ZERO,
            heard_at: Stamp::default(),
            touched: false,
        })
    }

    fn obey(&mut self, now: Stamp) {
        if let Some(commanded) = self.platform.newest() {
            self.velocity = Velocity { linear_m_s: commanded.linear_m_s, angular_rad_s: commanded.angular_rad_s };
            self.heard_at = now;
        }
        // NaN from a broken controller stops the robot as silence does.
        if now.since_ns(self.heard_at) > SILENCE_LIMIT_NS || !self.velocity.is_finite() {
            self.velocity = Velocity::ZERO;
        }
    }

    fn move_to(&mut self, now: Stamp) {
        let before = self.moved_to.replace(now).unwrap_or(now);
        let elapsed_ns = now.since_ns(before).clamp(0, 1_000_000_000);
        self.simulator.step(self.velocity, elapsed_ns as f64 * 1e-9);
        if self.simulator.contact() && !self.touched {
            log::error!("the simulated robot touched something at {:.1} s", self.simulator.time_s());
        }
        self.touched = self.simulator.contact();
    }

    fn emit(&mut self, at: Stamp, pings: &mut PingSet) {
        let odometry = self.simulator.odometry();
        if let Err(error) = self.odometry.tell(odometry.pose, odometry.twist, at) {
            log::warn!("{error}");
        }
        self.simulator.ping_set(at, pings);
        self.waiting = Some(at);
    }
}

impl Source for SimulatorSource {
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError> {
        let begin = SystemClock.now();
        let end = begin.plus_ns(u64::try_from(limit.as_nanos()).unwrap_or(u64::MAX / 4));
        loop {
            let now = SystemClock.now();
            self.obey(now);
            self.move_to(now);
            if let Some(emitted_at) = self.waiting {
                if now.since_ns(emitted_at.plus_ns(self.recording_ns)) >= 0 {
                    self.waiting = None;
                    return Ok(Delivery::Set);
                }
            } else {
                let due = *self.next_emission.get_or_insert(now);
                if now.since_ns(due) >= 0 {
                    // A source that fell behind goes on from now: it never makes up for lost pings in a burst.
                    let late = now.since_ns(due.plus_ns(self.period_ns)) >= 0;
                    self.next_emission = Some(if late { now } else { due }.plus_ns(self.period_ns));
                    self.emit(now, pings);
                    continue;
                }
            }
            if now.since_ns(end) >= 0 {
                return Ok(Delivery::Nothing);
            }
            let next = match (self.waiting, self.next_emission) {
                (Some(emitted_at), _) => emitted_at.plus_ns(self.recording_ns),
                (None, Some(due)) => due,
                (None, None) => now,
            };
            let pause_ns = next.since_ns(now).clamp(100_000, STEP_NS.cast_signed());
            std::thread::sleep(Duration::from_nanos(pause_ns.cast_unsigned()));
        }
    }

    fn wanted_velocity(&self) -> Option<Velocity> {
        Some(self.simulator.wanted_velocity())
    }

    fn describe(&self) -> String {
        "simulated robot".to_owned()
    }
}
