//! What one sensor's direct path told over many pings.
//!
//! In: raw pings, of each a few channels in turn. Out: mean time and level of each channel ([`Observer::heard`], [`Observer::levels`]),
//! ready for [`super::solve`]. Times hang on one phase that all channels share (the transducers'), found from the first
//! arrivals or given. Changes no sample, decides nothing, allocates nothing after it was made.

use super::arrival::{Arrival, Sweep};
use super::running::Running;
use super::solve::Heard;
use crate::imaging::direct_path::start;
use crate::imaging::plan::ImagingPlan;
use crate::sensor::SensorSetup;
use crate::signal::Samples;
use nalgebra::{Complex, Vector3};
use std::sync::Arc;

/// Correlation coefficient from which an arrival counts: cut off at full scale it is 0.9, in noise as loud as itself 0.7.
const CLEAR_MIN: f64 = 0.5;
/// Arrivals from which the shared phase is taken.
const PHASE_ARRIVALS: u32 = 64;
/// Pings over which hearing is averaged.
const HEARING_PINGS: f64 = 16.0;
/// What no average makes better: the sweep as the air and the transducers bend it, echoes that always come.
const FLOOR_M: f64 = 4e-6;
const FLOOR_LN: f64 = 1e-3;
/// Share of the emission cut off from which its amplitude says nothing of the gain.
pub const CLIPPED_MAX: f64 = 0.01;
/// Slowest and fastest speed of sound that is listened for, for the length of a start.
const SPEED_MIN_M_S: f64 = 300.0;
/// Latest start of an emission that is listened for.
const LATE_MAX_S: f64 = 50e-6;

/// A channel's level: natural logarithm of amplitude times distance.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Level {
    /// ln(amplitude times distance in metres); meaningless when not `good`.
    pub ln: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Heard, and not cut off.
    pub good: bool,
    /// Share of the emission cut off at full scale.
    pub clipped: f64,
}

#[derive(Debug, Clone)]
struct Channel {
    index: usize,
    place_m: Vector3<f64>,
    distance_m: f64,
    lag: Running,
    level: Running,
    clipped: f64,
    heard: u64,
    /// Share of the last pings in which it was heard.
    hearing: f64,
}

/// Remembers what one sensor's channels told.
#[derive(Debug, Clone)]
pub struct Observer {
    sweep: Arc<Sweep>,
    channels: Vec<Channel>,
    reference_m_s: f64,
    rate_hz: f64,
    shared: Complex<f64>,
    shared_count: u32,
    fixed_rad: Option<f64>,
    clear_min: f64,
    next: usize,
    batch: usize,
    pings: u64,
    arrivals: u64,
    start: Vec<f32>,
}

impl Observer {
    /// Listens to `sensor`, at most `batch` of its channels in a ping, with a memory of `memory` blocks of
    /// [`super::running::BLOCK`] values. `shared_rad` is the phase that the transducers turn the sweep by, where it is known.
    #[must_use]
    pub fn new(
        plan: &ImagingPlan,
        sensor: &SensorSetup,
        sweep: &Arc<Sweep>,
        reference_m_s: f64,
        (batch, memory): (usize, f64),
        shared_rad: Option<f64>,
    ) -> Self {
        let array = &sensor.array;
        let channel = |index: usize| {
            let place_m = array.positions_m[index];
            Channel {
                index,
                place_m,
                distance_m: (place_m - sensor.emitter_m).norm(),
                lag: Running::new(memory),
                level: Running::new(memory),
                clipped: 0.0,
                heard: 0,
                hearing: 1.0,
            }
        };
        let channels: Vec<Channel> =
            (0..array.channel_count()).filter(|index| array.enabled[*index]).map(channel).collect();
        let farthest_m = channels.iter().map(|channel| channel.distance_m).fold(0.0, f64::max);
        let last_lag = (farthest_m / SPEED_MIN_M_S + LATE_MAX_S) * plan.sample_rate_hz;
        let start_len = sweep.start_len(last_lag.ceil() as usize).min(plan.sample_count);
        Self {
            sweep: Arc::clone(sweep),
            batch: batch.clamp(1, channels.len().max(1)),
            channels,
            reference_m_s,
            rate_hz: plan.sample_rate_hz,
            shared: Complex::new(0.0, 0.0),
            shared_count: 0,
            fixed_rad: shared_rad,
            clear_min: CLEAR_MIN,
            next: 0,
            pings: 0,
            arrivals: 0,
            start: vec![0.0; start_len],
        }
    }

    /// The same, for emissions that something louder lies over: they count from this correlation coefficient on.
    #[must_use]
    pub fn clear_from(self, clear_min: f64) -> Self {
        Self { clear_min, ..self }
    }

    /// Listens to the next few channels of a ping.
    pub fn listen(&mut self, plan: &ImagingPlan, samples: &Samples) {
        self.pings += 1;
        for _ in 0..self.batch.min(self.channels.len()) {
            let place = self.next;
            self.next = (self.next + 1) % self.channels.len();
            let channel = &mut self.channels[place];
            let expected = channel.distance_m / self.reference_m_s * self.rate_hz;
            let read = start::read(plan, samples, channel.index, 0, 1, &mut self.start);
            let found = if read { self.sweep.find(&self.start, expected) } else { None };
            let found = found.filter(|found| found.coefficient >= self.clear_min);
            channel.hearing += (f64::from(u8::from(found.is_some())) - channel.hearing) / HEARING_PINGS;
            if let Some(found) = found {
                self.take(place, &found);
            }
        }
    }

    fn take(&mut self, place: usize, found: &Arrival) {
        let Some(shared_rad) = self.shared_rad() else {
            self.shared += found.phasor(&self.sweep);
            self.shared_count += 1;
            return;
        };
        self.arrivals += 1;
        let channel = &mut self.channels[place];
        channel.heard += 1;
        channel.clipped += (found.clipped - channel.clipped) / (channel.heard as f64).min(64.0);
        channel.lag.push(found.phase_lag(&self.sweep, shared_rad));
        channel.level.push((found.amplitude * channel.distance_m).ln());
    }

    /// The phase that the transducers turn the sweep by, once it is known.
    #[must_use]
    pub fn shared_rad(&self) -> Option<f64> {
        let told = || (self.shared_count >= PHASE_ARRIVALS).then(|| self.shared.arg());
        self.fixed_rad.or_else(told)
    }

    /// The speed of sound that ways are told with.
    #[must_use]
    pub fn reference_m_s(&self) -> f64 {
        self.reference_m_s
    }

    /// Pings listened to.
    #[must_use]
    pub fn pings(&self) -> u64 {
        self.pings
    }

    /// Arrivals taken, of all channels together.
    #[must_use]
    pub fn arrivals(&self) -> u64 {
        self.arrivals
    }

    /// Channel numbers, in the order of [`Observer::heard`] and [`Observer::levels`].
    pub fn indices(&self) -> impl Iterator<Item = usize> {
        self.channels.iter().map(|channel| channel.index)
    }

    /// The times, one entry a channel in use, into `out`, which must have room.
    pub fn heard(&self, out: &mut Vec<Heard>) {
        let metres = self.reference_m_s / self.rate_hz;
        out.clear();
        out.extend(self.channels.iter().map(|channel| {
            let told = channel.lag.mean().filter(|_| channel.is_heard());
            let (lag, sd) = told.unwrap_or((0.0, 0.0));
            Heard {
                place_m: channel.place_m,
                way_m: lag * metres,
                sd_m: (sd * metres).hypot(FLOOR_M),
                unheard: told.is_none(),
            }
        }));
    }

    /// The levels, one entry a channel in use, into `out`, which must have room.
    pub fn levels(&self, out: &mut Vec<Level>) {
        out.clear();
        out.extend(self.channels.iter().map(|channel| {
            let told = channel.level.mean().filter(|_| channel.is_heard());
            let (ln, sd) = told.unwrap_or((0.0, 0.0));
            let good = told.is_some() && channel.clipped <= CLIPPED_MAX;
            Level { ln, sd: sd.hypot(FLOOR_LN), good, clipped: channel.clipped }
        }));
    }
}

impl Channel {
    /// Heard in more than half of the last pings: what it told before it fell silent is old.
    fn is_heard(&self) -> bool {
        self.heard > 0 && self.hearing > 0.5
    }
}
