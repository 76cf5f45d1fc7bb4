//! Microphone signals of one ping: world and places of the sensors in, raw samples out.
//!
//! For every emission that a sensor hears: find the paths, compose each path's waveform, add it to every microphone at its
//! exact delay; then noise, saturation and the recording's format. Single-threaded and keyed by seed, ping, sensor and
//! microphone, so the bits depend on nothing else. No allocation once the buffers have grown.
//!
//! Robot and movers move on while the sound flies: an echo is heard where the microphone is by then (at 0.3 m/s 4.4 mm of
//! range at 5 m, at 1 rad/s 1.7 degrees of bearing). What an earlier turn's emission throws back is taken as sent from where its sensor
//! is now: a centimetre or two of a ghost's place. Left out is the Doppler shift, the echo's own compression by 1 + 2 v/c: a
//! hyperbolic sweep of T, f0, f1 then only seems later by T f1/(f0 - f1) 2 v/c, for the default one 4.4 us or 0.75 mm of range
//! at 0.3 m/s, 2.5 mm for each metre per second of approach, at any range, and 0.01 dB weaker.

mod air;
mod cylinder;
mod directivity;
mod edge;
mod jammer;
mod motion;
mod noise;
mod path;
mod pdm;
mod sight;
mod solid;
mod space;
mod waveform;

use super::obstacles::Obstacles;
use super::params::{SimError, SimParams};
use crate::geometry::Pose2;
use crate::geometry::shape::Shape;
use crate::parameter::check_range;
use crate::sensor::dead_zone::{self, HOUSING_DEPTH_M, HOUSING_WIDTH_M};
use crate::sensor::{RecordingFormat, SensorSetup, per_emission};
use crate::signal::{SENSORS_MAX, SampleFormat, Samples, Velocity};
use jammer::{Jamming, Listening};
use motion::Motion;
use nalgebra::Vector2;
use noise::Noise;
use path::{Finder, Medium, Path, Station};
use pdm::PdmCoder;
use sight::Sight;
use std::sync::Arc;
use waveform::{Waveform, WaveformTable};

/// Time after which an emission is no longer heard: on 41 m of way the air alone takes 30 dB and more.
const HEARD_MAX_S: f64 = 0.12;
/// Largest amplitude that a microphone delivers.
const FULL_SCALE: f32 = 1.0;
/// What a stream of noise is for, where a microphone's index stands otherwise.
const FOR_PDM: u64 = u64::MAX;
const FOR_CLOCK: u64 = u64::MAX - 1;
/// And where a sensor's index stands otherwise: jammers are the same for all.
const FOR_JAMMERS: u64 = u64::MAX;

/// Makes the microphone signals.
#[derive(Debug, Clone)]
pub(super) struct EchoMaker {
    sensors: Vec<SensorSetup>,
    stations: Vec<Station>,
    /// One a sensor; sensors with the same emission share a table.
    tables: Vec<Arc<WaveformTable>>,
    media: Vec<Medium>,
    jammings: Vec<Jamming>,
    /// In the robot's frame.
    obstructions: Vec<Shape>,
    robot: Pose2,
    motion: Motion,
    recording: RecordingFormat,
    params: SimParams,
    speed_of_sound_m_s: f64,
    seed: u64,
    coder: PdmCoder,
    emitting: [bool; SENSORS_MAX],
    paths: Vec<Path>,
    waveform: Waveform,
    pcm: Vec<f32>,
}

impl EchoMaker {
    pub(super) fn new(
        sensors: &[SensorSetup],
        recording: &RecordingFormat,
        params: &SimParams,
        speed_of_sound_m_s: f64,
        seed: u64,
    ) -> Result<Self, SimError> {
        check(sensors, recording, params)?;
        let tables = per_emission(sensors, |index| WaveformTable::new(&sensors[index].emission));
        let media = tables.iter().map(|table| Medium::new(table, params, speed_of_sound_m_s)).collect();
        let channels = sensors.iter().map(|sensor| sensor.array.channel_count()).max().unwrap_or(0);
        let (rate_hz, samples) = (recording.demodulated_rate_hz(), recording.demodulated_samples());
        let ready = |jammer| Jamming::new(jammer, params, rate_hz, samples);
        let mut maker = Self {
            stations: sensors.iter().map(|sensor| Station::new(&sensor.emitter_m, &sensor.array.positions_m)).collect(),
            waveform: tables[0].waveform(),
            tables,
            media,
            jammings: params.jammers.into_iter().flatten().map(ready).collect(),
            obstructions: Vec::new(),
            robot: Pose2::default(),
            motion: Motion::default(),
            recording: *recording,
            params: *params,
            speed_of_sound_m_s,
            seed,
            coder: PdmCoder::new(recording.decimation),
            emitting: [true; SENSORS_MAX],
            paths: Vec::with_capacity(256),
            pcm: vec![0.0; channels * samples],
            sensors: sensors.to_vec(),
        };
        maker.look_through_housings();
        Ok(maker)
    }

    /// Switches a sensor's emission on or off; its microphones go on hearing.
    pub(super) fn set_emitting(&mut self, sensor: usize, on: bool) {
        self.emitting[sensor] = on;
    }

    /// Sets what hides things on the robot itself, in its frame.
    pub(super) fn set_obstructions(&mut self, shapes: &[Shape]) {
        self.obstructions = shapes.to_vec();
    }

    /// Number of sensors.
    pub(super) fn sensor_count(&self) -> usize {
        self.sensors.len()
    }

    /// Number of values of a sensor's raw ping (see [`Samples::zeros`]).
    pub(super) fn raw_len(&self, sensor: usize) -> usize {
        match self.recording.format {
            SampleFormat::Pdm => self.recording.samples,
            SampleFormat::PcmI16 | SampleFormat::PcmF32 => {
                self.recording.samples * self.sensors[sensor].array.channel_count()
            }
        }
    }

    /// Puts all sensors where the robot is, and lets it go on at `velocity` while the sound flies.
    pub(super) fn place(&mut self, robot: &Pose2, velocity: Velocity) {
        self.robot = *robot;
        let velocity = if self.params.motion { velocity } else { Velocity::ZERO };
        self.motion = Motion::new(robot, velocity, self.speed_of_sound_m_s);
        for (station, sensor) in self.stations.iter_mut().zip(&self.sensors) {
            let pose = robot.compose(&sensor.mount.pose());
            station.place(pose, &sensor.emitter_m, &sensor.array.positions_m);
            station.housing_m = housing_corners_m(&pose);
        }
    }

    /// Makes what `sensor` hears into `out`, whose size is right.
    pub(super) fn hear(&mut self, sensor: usize, ping: u64, obstacles: &Obstacles, out: &mut Samples) {
        let samples = self.recording.demodulated_samples();
        let channels = self.sensors[sensor].array.channel_count();
        let mut pcm = std::mem::take(&mut self.pcm);
        if let Samples::PcmF32(values) = out {
            self.sound(sensor, ping, obstacles, samples, values);
        } else {
            self.sound(sensor, ping, obstacles, samples, &mut pcm[..channels * samples]);
        }
        let heard = &pcm[..channels * samples];
        match out {
            Samples::PcmF32(_) => {}
            Samples::PcmI16(values) => {
                for (value, amplitude) in values.iter_mut().zip(heard) {
                    *value = quantised(*amplitude);
                }
            }
            Samples::Pdm(words) => {
                let mut starts = Noise::new([self.seed, ping, sensor as u64, FOR_PDM]);
                self.coder.encode(heard, channels, words, &mut starts);
            }
        }
        self.pcm = pcm;
    }

    /// What `sensor` hears as `[microphones][samples]` at the demodulated rate.
    fn sound(&mut self, sensor: usize, ping: u64, obstacles: &Obstacles, samples: usize, pcm: &mut [f32]) {
        for (microphone, row) in pcm.chunks_mut(samples).enumerate() {
            Noise::new([self.seed, ping, sensor as u64, microphone as u64]).fill(row, self.params.noise_rms);
        }
        let rate_hz = self.recording.demodulated_rate_hz();
        let clock_s = self.clock_s(sensor, ping);
        let sight = Sight {
            obstacles,
            stations: &self.stations,
            obstructions: &self.obstructions,
            robot: self.robot,
            occlusion: self.params.occlusion,
        };
        for (emitter, late_s) in self.firings(sensor, ping).into_iter().flatten() {
            let length_max_m = (samples as f64 / rate_hz - late_s) * self.speed_of_sound_m_s;
            if length_max_m <= 0.0 {
                continue;
            }
            self.paths.clear();
            let medium = &self.media[emitter];
            Finder { sight: &sight, params: &self.params, medium, length_max_m, emitter, receiver: sensor }
                .find(&mut self.paths);
            for path in &self.paths {
                self.tables[emitter].compose(&path.response, &mut self.waveform);
                for ((place, height_m), row) in self.stations[sensor].microphones_m.iter().zip(pcm.chunks_mut(samples))
                {
                    let (length_m, amplitude) = self.motion.heard(path, *place, *height_m);
                    let delay_s = length_m / self.speed_of_sound_m_s + late_s;
                    self.waveform.add_to(row, delay_s * rate_hz, amplitude);
                }
            }
        }
        let view_rad = (self.params.view_full_rad, self.params.view_zero_rad);
        let speed_of_sound_m_s = self.speed_of_sound_m_s;
        let listening = Listening { sight: &sight, sensor, clock_s, rate_hz, speed_of_sound_m_s, view_rad };
        for (index, jamming) in self.jammings.iter().enumerate() {
            jamming.add_to(pcm, &listening, Noise::new([self.seed, ping, FOR_JAMMERS, index as u64]));
        }
        for value in pcm {
            *value = value.clamp(-FULL_SCALE, FULL_SCALE);
        }
    }

    /// Who emits what a sensor may hear, and how much later than the sensor's first sample: all others of this set, and, where they take
    /// turns, of the set before.
    fn firings(&self, sensor: usize, ping: u64) -> [Option<(usize, f64)>; 2 * SENSORS_MAX] {
        let clock_s = self.clock_s(sensor, ping);
        std::array::from_fn(|index| {
            let (emitter, before) = (index % SENSORS_MAX, index >= SENSORS_MAX);
            let heard = emitter == sensor || self.params.cross_talk;
            if emitter >= self.sensors.len() || !self.emitting[emitter] || !heard {
                return None;
            }
            let late_s = match (emitter == sensor, before) {
                (true, true) => return None,
                (true, false) => 0.0,
                (false, false) => self.clock_s(emitter, ping) - clock_s,
                (false, true) => {
                    let (turns, ping) = (self.params.turns?, ping.checked_sub(1)?);
                    self.clock_s(emitter, ping) - turns.period_s - clock_s
                }
            };
            (late_s > -HEARD_MAX_S).then_some((emitter, late_s))
        })
    }

    /// When a sensor's turn is, after the first one's.
    pub(super) fn turn_s(&self, sensor: usize) -> f64 {
        self.params.turns.map_or(0.0, |turns| turns.slot_s * sensor as f64)
    }

    /// When a sensor emits and begins to record, after the first one's turn.
    fn clock_s(&self, sensor: usize, ping: u64) -> f64 {
        let jitter = Noise::new([self.seed, ping, sensor as u64, FOR_CLOCK]).gaussian();
        self.turn_s(sensor) + self.params.sync_offsets_s[sensor] + self.params.sync_jitter_s * jitter
    }

    /// A housing hides nothing from its own sensor, nor from one whose origin is inside it.
    fn look_through_housings(&mut self) {
        for (own, sensor) in self.sensors.iter().enumerate() {
            let origin_m = sensor.mount.position_m();
            for (other, host) in self.sensors.iter().enumerate() {
                let local_m = host.mount.pose().local_from_parent(origin_m);
                if own == other || dead_zone::housing().contains(local_m) {
                    self.stations[own].looks_through |= 1 << other;
                }
            }
        }
    }
}

/// Nearest 16-bit value, ties to even.
fn quantised(amplitude: f32) -> i16 {
    // Adding 1.5 * 2^23 rounds to an integer in the mantissa's low bits; `round` is a call a sample where the processor's
    // baseline has no such instruction, and five times as slow.
    const ROUNDER: f32 = 12_582_912.0;
    let rounded = (amplitude * 32768.0).clamp(-32768.0, 32767.0) + ROUNDER;
    (rounded.to_bits().wrapping_sub(ROUNDER.to_bits())).cast_signed() as i16
}

/// Corners of the housing of a sensor at `pose`, counter-clockwise: the front face is centred on the sensor's origin.
pub(super) fn housing_corners_m(pose: &Pose2) -> [Vector2<f64>; 4] {
    let half_width_m = 0.5 * HOUSING_WIDTH_M;
    [(0.0, half_width_m), (-HOUSING_DEPTH_M, half_width_m), (-HOUSING_DEPTH_M, -half_width_m), (0.0, -half_width_m)]
        .map(|(x_m, y_m)| pose.parent_from_local(Vector2::new(x_m, y_m)))
}

fn check(sensors: &[SensorSetup], recording: &RecordingFormat, params: &SimParams) -> Result<(), SimError> {
    let refuse = |sensor: &str, what, found: String, allowed: String| {
        Err(SimError::Sensor { sensor: sensor.to_owned(), what, found, allowed })
    };
    if !(1..=SENSORS_MAX).contains(&sensors.len()) {
        return refuse("all", "number of sensors", sensors.len().to_string(), format!("1 to {SENSORS_MAX}"));
    }
    if recording.decimation == 0 || recording.demodulated_samples() == 0 {
        let found = format!("{} samples, decimation {}", recording.samples, recording.decimation);
        return refuse("all", "length of the recording", found, "at least one sample after decimation".into());
    }
    if recording.format != SampleFormat::Pdm && recording.decimation != 1 {
        return refuse("all", "decimation", recording.decimation.to_string(), "1, unless the format is pdm".into());
    }
    let rate_hz = recording.demodulated_rate_hz();
    for (index, jammer) in params.jammers.iter().enumerate() {
        if let Some(jammer) = jammer {
            check_range(&format!("jammers[{index}].frequency_hz"), jammer.frequency_hz, 0.0, 0.4 * rate_hz)?;
        }
    }
    for sensor in sensors {
        let channels = sensor.array.channel_count();
        let channels_max = if recording.format == SampleFormat::Pdm { pdm::CHANNELS } else { 1024 };
        if !(1..=channels_max).contains(&channels) {
            return refuse(&sensor.name, "number of microphones", channels.to_string(), format!("1 to {channels_max}"));
        }
        let emission = &sensor.emission;
        let same_rate = (emission.sample_rate_hz / rate_hz - 1.0).abs() < 1e-9;
        if !same_rate {
            let found = format!("{} Hz", emission.sample_rate_hz);
            return refuse(
                &sensor.name,
                "sample rate of the emission",
                found,
                format!("the demodulated rate, {rate_hz} Hz"),
            );
        }
        let (low_hz, high_hz) = emission.band_hz;
        if emission.samples.is_empty() || !(low_hz > 0.0 && low_hz < high_hz && high_hz < 0.4 * rate_hz) {
            let found = format!("{} samples, {low_hz} to {high_hz} Hz", emission.samples.len());
            let allowed = format!("at least one sample, a band between 0 and 0.4 of the rate, {} Hz", 0.4 * rate_hz);
            return refuse(&sensor.name, "emission", found, allowed);
        }
    }
    Ok(())
}
