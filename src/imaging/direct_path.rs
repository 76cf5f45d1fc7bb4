//! Does a sensor hear its own emission, on every microphone, when and as loudly as its geometry says? The sound that goes straight
//! from the emitter to the microphones is in every ping; a ping without it comes from a dead emitter or from no sensor at
//! all, and its silence means nothing. Microphones that hear it at another's time are exchanged, or the array is another one;
//! all of them at another time, the sample rate is wrong.
//!
//! In: the raw ping. Out: how well it is heard ([`DirectFindings`]), which channels are unfit, and over many pings the emitter's
//! place and the speed of sound ([`Calibration`]). Works on raw samples, apart from the backends, so that a broken backend cannot
//! vouch for itself. Changes no sample and decides nothing.
//!
//! Cost: one complex inner product of thinned samples a channel, 376 of them for the default emission. Of PCM all channels are
//! heard every ping (32 channels: 36 thousand multiplications, and 170 kB read), of PDM eight in turn, since each
//! costs 46 thousand additions to demodulate; all lags are looked through only for a channel that is not where it should be.
//!
//! What the direct path cannot tell: a mirror image of the array in a plane through the emitter, and two microphones that are
//! equally far from it.

mod channel;
mod pattern;
mod sensor;
pub(crate) mod start;
pub(crate) mod template;

pub use pattern::{Calibration, OUTLIER_MAX_M, OUTLIER_MIN_M, RMS_MAX_M};

use super::channels::ChannelFinding;
use super::plan::ImagingPlan;
use crate::sensor::{SensorSetup, per_emission};
use crate::signal::RawPing;
use sensor::SensorPath;
use template::Template;

/// Correlation coefficient that counts as heard. Noise gives about 1 / sqrt(samples) times a few for the best of the lags,
/// 0.2 at most; a clean direct path 1, one through a resonant transducer or clipped 0.5 and more.
pub const HEARD_MIN: f32 = 0.3;

/// Whether the channels are where the array's geometry says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChannelMap {
    /// Never judged yet.
    #[default]
    Unknown,
    /// They are.
    Fits,
    /// They do not seem to be; not for long enough to be sure, since a hand before the array looks so too.
    Doubted,
    /// They are not: channels exchanged, another array, another sample rate.
    Wrong,
}

/// What was found of one ping.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DirectFindings {
    /// Median correlation coefficient of the channels heard, 0 to 1; 0 for a sensor that is not known. Not heard below
    /// [`HEARD_MIN`]; NaN counts as not heard when it is compared as `!(value >= HEARD_MIN)`.
    pub correlation: f32,
    /// Whether the channels are where they should be, as far as pings up to this one tell.
    pub map: ChannelMap,
}

/// Listens to the direct paths of all sensors and remembers what was heard. Buffers are made once.
#[derive(Debug, Clone)]
pub struct DirectPath {
    sensors: Vec<SensorPath>,
}

impl DirectPath {
    /// Prepares for the sensors of a plan, in its order.
    #[must_use]
    pub fn new(plan: &ImagingPlan, sensors: &[SensorSetup], speed_of_sound_m_s: f64) -> Self {
        // Sensors with equal emissions share a template.
        let templates = per_emission(sensors, |index| Template::new(&sensors[index].emission));
        let path = |(sensor, template)| SensorPath::new(plan, sensor, template, speed_of_sound_m_s);
        Self { sensors: sensors.iter().zip(&templates).map(path).collect() }
    }

    /// Listens to a ping. Allocates nothing.
    pub fn listen(&mut self, plan: &ImagingPlan, ping: &RawPing) -> DirectFindings {
        let path = self.sensors.get_mut(ping.sensor_index);
        path.map_or_else(DirectFindings::default, |path| path.listen(plan, &ping.samples))
    }

    /// What makes each channel of a sensor unfit for an image; [`ChannelFinding::Good`] where nothing does.
    #[must_use]
    pub fn unfit(&self, sensor_index: usize) -> &[ChannelFinding] {
        self.sensors.get(sensor_index).map_or(&[], SensorPath::unfit)
    }

    /// Forgets what the last ping told of a sensor's channels: it was clipped all over, and says nothing of them.
    pub fn disregard(&mut self, sensor_index: usize) {
        if let Some(path) = self.sensors.get_mut(sensor_index) {
            path.disregard();
        }
    }

    /// What fits the direct paths heard so far best; `None` before the channels were found where they should be.
    #[must_use]
    pub fn calibration(&self, sensor_index: usize) -> Option<Calibration> {
        self.sensors.get(sensor_index).and_then(SensorPath::calibration)
    }
}

#[cfg(test)]
mod tests;
