//! Does a sensor hear its own emission? The sound that goes straight from the emitter to the microphones is in every ping;
//! a ping without it comes from a dead emitter or from no sensor at all, and its silence means nothing.
//!
//! In: the raw ping. Out: how well the start of some channels correlates with the emission at the expected delay.
//! Works on raw samples, apart from the backends, so that a broken backend cannot vouch for itself.

use super::plan::ImagingPlan;
use crate::sensor::SensorSetup;
use crate::signal::{RawPing, Samples};

/// Channels that give an answer: the median of three stands against one that lies.
const CHANNELS: usize = 3;
/// Partial sums of a correlation, so that the compiler may use vector instructions without reordering a single sum.
const LANES: usize = 16;
/// Lags around the expected delay, in demodulated samples: a tenth of a millisecond at 450 kHz, more than any error of
/// the emitter's place, and enough to find a maximum whatever phase the transducers add.
const LAGS: usize = 45;
/// Correlation coefficient that counts as heard. Noise gives about 1 / sqrt(samples) times a few for the best of the lags,
/// 0.1 at most; a clean direct path 1, one through a resonant transducer or clipped 0.5 and more.
pub const HEARD_MIN: f32 = 0.3;

/// Looks for the direct path. Buffers are made once.
#[derive(Debug, Clone)]
pub struct DirectPath {
    sensors: Vec<SensorPath>,
    start: Vec<f32>,
}

#[derive(Debug, Clone)]
struct SensorPath {
    emission: Vec<f32>,
    emission_norm: f32,
    /// Channel and first lag of every channel in use, neighbours in the list far apart in the array's numbering.
    channels: Vec<(usize, usize)>,
}

impl DirectPath {
    /// Prepares for the sensors of a plan, in its order.
    #[must_use]
    pub fn new(plan: &ImagingPlan, sensors: &[SensorSetup], speed_of_sound_m_s: f64) -> Self {
        let path = |sensor: &SensorSetup| {
            let emission: Vec<f32> = sensor.emission.samples.iter().map(|sample| *sample as f32).collect();
            let used: Vec<usize> = (0..sensor.array.channel_count()).filter(|k| sensor.array.enabled[*k]).collect();
            let stride = used.len().div_ceil(CHANNELS).max(1);
            let spread = (0..stride).flat_map(|first| used.iter().skip(first).step_by(stride));
            let first_lag = |channel: usize| {
                let distance_m = (sensor.array.positions_m[channel] - sensor.emitter_m).norm();
                let delay = distance_m / speed_of_sound_m_s * plan.sample_rate_hz;
                (delay as usize).saturating_sub(LAGS / 2)
            };
            SensorPath {
                emission_norm: emission.iter().map(|sample| sample * sample).sum::<f32>().sqrt(),
                emission,
                channels: spread.map(|channel| (*channel, first_lag(*channel))).collect(),
            }
        };
        let sensors: Vec<SensorPath> = sensors.iter().map(path).collect();
        let longest =
            sensors.iter().flat_map(|path| path.channels.iter().map(|(_, lag)| lag + path.emission.len())).max();
        Self { sensors, start: vec![0.0; (longest.unwrap_or(0) + LAGS).min(plan.sample_count)] }
    }

    /// Median over the first channels that deliver anything of the best correlation coefficient, 0 to 1; 0 for a sensor that
    /// is not known. Not heard below [`HEARD_MIN`]; NaN counts as not heard when it is compared as `!(value >= HEARD_MIN)`.
    pub fn correlation(&mut self, plan: &ImagingPlan, ping: &RawPing) -> f32 {
        let Some(path) = self.sensors.get(ping.sensor_index) else { return 0.0 };
        let mut found = [0.0_f32; CHANNELS];
        let mut count = 0;
        for (channel, first_lag) in &path.channels {
            if count == CHANNELS {
                break;
            }
            if !read_start(plan, &ping.samples, *channel, &mut self.start) {
                continue;
            }
            // A dead, stuck or broken channel is found elsewhere; here it just cannot answer.
            let power = product(&self.start, &self.start);
            if !(power > 0.0 && power.is_finite()) {
                continue;
            }
            let lags = *first_lag..first_lag + LAGS;
            found[count] = lags.map(|lag| coefficient(&self.start, path, lag)).fold(0.0, f32::max);
            count += 1;
        }
        found[..count].sort_by(f32::total_cmp);
        if count == 0 { 0.0 } else { found[count / 2] }
    }
}

/// |<x, s>| / (|x| |s|) for the emission s at a lag of the start x of a channel.
fn coefficient(start: &[f32], path: &SensorPath, lag: usize) -> f32 {
    let Some(heard) = start.get(lag..lag + path.emission.len()) else { return 0.0 };
    let norm = product(heard, heard).sqrt() * path.emission_norm;
    if norm > 0.0 { product(heard, &path.emission).abs() / norm } else { 0.0 }
}

fn product(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f32 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_chunks.zip(b_chunks) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum::<f32>() + rest
}

/// Demodulates the start of one channel; `false` where the ping is too short.
fn read_start(plan: &ImagingPlan, samples: &Samples, channel: usize, start: &mut [f32]) -> bool {
    let offset = channel * plan.raw_count;
    match samples {
        Samples::PcmF32(values) => {
            let Some(row) = values.get(offset..offset + start.len()) else { return false };
            start.copy_from_slice(row);
        }
        Samples::PcmI16(values) => {
            let Some(row) = values.get(offset..offset + start.len()) else { return false };
            for (sample, value) in start.iter_mut().zip(row) {
                *sample = f32::from(*value) / 32_768.0;
            }
        }
        Samples::Pdm(words) => {
            let half = plan.demodulation_taps.len() / 2;
            if words.len() < start.len() * plan.decimation + half {
                return false;
            }
            for (index, sample) in start.iter_mut().enumerate() {
                let first = (index * plan.decimation) as i64 - half as i64;
                *sample = plan.demodulation_taps.iter().enumerate().fold(0.0, |sum, (tap_index, tap)| {
                    let word = usize::try_from(first + tap_index as i64).ok().and_then(|index| words.get(index));
                    let bit = word.map_or(0.0, |word| if (word >> channel) & 1 == 1 { *tap } else { -*tap });
                    sum + bit
                });
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::params::ImagingParams;
    use crate::imaging::steering::horizontal_directions;
    use crate::sensor::{Emission, EmissionParams, MicrophoneArray, Mount, RecordingFormat};
    use crate::signal::SampleFormat;
    use crate::time::Stamp;
    use nalgebra::Vector3;
    use std::sync::Arc;

    fn sensor() -> SensorSetup {
        let params = EmissionParams::default();
        SensorSetup {
            name: "front".to_owned(),
            mount: Mount::default(),
            array: MicrophoneArray::ertis_v3d1(),
            emission: Arc::new(Emission::new(&params, 450e3, std::path::Path::new("")).expect("sweep")),
            emitter_m: Vector3::new(0.0, 0.0, 0.06),
        }
    }

    fn plan(sensor: &SensorSetup, format: SampleFormat) -> ImagingPlan {
        let params = ImagingParams::default();
        let directions = horizontal_directions(&params.directions).expect("directions");
        let hidden = [vec![false; directions.len()]];
        let recording = RecordingFormat::of(format);
        ImagingPlan::new(std::slice::from_ref(sensor), &hidden, &recording, &params, directions, 343.0).expect("plan")
    }

    /// The emission on every channel as late as its way takes, with pseudo-random noise of the given amplitude.
    fn heard(sensor: &SensorSetup, emission: f32, noise: f32) -> Vec<f32> {
        let mut state = 1_u32;
        let mut values = vec![0.0; 32 * 16_384];
        for (row, place_m) in values.chunks_exact_mut(16_384).zip(&sensor.array.positions_m) {
            for value in row.iter_mut() {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *value = noise * ((state >> 8) as f32 / (1 << 23) as f32 - 1.0);
            }
            let lag = ((place_m - sensor.emitter_m).norm() / 343.0 * 450e3).round() as usize;
            for (value, sample) in row[lag..].iter_mut().zip(&sensor.emission.samples) {
                *value += emission * *sample as f32;
            }
        }
        values
    }

    fn correlation(values: Vec<f32>) -> f32 {
        let sensor = sensor();
        let plan = plan(&sensor, SampleFormat::PcmF32);
        let samples = Arc::new(Samples::PcmF32(values));
        let ping = RawPing { sensor_index: 0, sequence: 0, emitted_at: Stamp::default(), samples };
        DirectPath::new(&plan, &[sensor], 343.0).correlation(&plan, &ping)
    }

    #[test]
    fn a_direct_path_is_heard_in_noise_and_not_where_there_is_none() {
        let sensor = sensor();
        assert!(correlation(heard(&sensor, 0.5, 0.002)) > 0.99);
        assert!(correlation(heard(&sensor, 0.002, 0.002)) > HEARD_MIN, "as strong as the noise");
        let noise_alone = correlation(heard(&sensor, 0.0, 0.5));
        assert!(noise_alone < 0.5 * HEARD_MIN, "noise reads {noise_alone}");
        assert_eq!(correlation(vec![0.0; 32 * 16_384]), 0.0, "silence is no direct path");
    }

    #[test]
    fn dead_and_broken_channels_do_not_hide_it() {
        let sensor = sensor();
        let mut values = heard(&sensor, 0.5, 0.002);
        for channel in [0, 1, 2, 11, 12, 22, 23] {
            values[channel * 16_384..][..16_384].fill(0.0);
        }
        values[3 * 16_384 + 100] = f32::NAN;
        assert!(correlation(values) > 0.99);
    }
}
