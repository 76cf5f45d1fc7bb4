//! Contract: the direct path is found where there is one, each fault of the channels is told by its name, and neither temperature
//! nor noise nor a wall is taken for one. Pings are made of the emission as samples, shifted by whole samples.

use super::*;
use crate::imaging::params::ImagingParams;
use crate::imaging::steering::horizontal_directions;
use crate::sensor::{Emission, EmissionParams, MicrophoneArray, Mount, RecordingFormat};
use crate::signal::{SampleFormat, Samples};
use crate::time::Stamp;
use nalgebra::Vector3;
use std::sync::Arc;

const ROW: usize = 16_384;

pub(super) fn sensor() -> SensorSetup {
    let params = EmissionParams::default();
    SensorSetup {
        name: "front".to_owned(),
        mount: Mount::default(),
        array: MicrophoneArray::ertis_v3d1(),
        emission: Arc::new(Emission::new(&params, 450e3, std::path::Path::new("")).expect("sweep")),
        emitter_m: Vector3::new(0.0, 0.0, 0.06),
    }
}

pub(super) fn plan(sensor: &SensorSetup, format: SampleFormat) -> ImagingPlan {
    let params = ImagingParams::default();
    let directions = horizontal_directions(&params.directions).expect("directions");
    let hidden = [vec![false; directions.len()]];
    let recording = RecordingFormat::of(format);
    ImagingPlan::new(std::slice::from_ref(sensor), &hidden, &recording, &params, directions, 343.0).expect("plan")
}

/// What the channels of `sensor` really hear: noise, then the emission of `amplitude` on each, `late_s` later than its way at
/// `speed_m_s` takes.
struct World {
    amplitude: f32,
    noise: f32,
    speed_m_s: f64,
    late_s: f64,
}

const CLEAN: World = World { amplitude: 0.5, noise: 0.002, speed_m_s: 343.0, late_s: 0.0 };

impl World {
    fn heard(&self, sensor: &SensorSetup) -> Vec<f32> {
        let mut state = 1_u32;
        let mut values = vec![0.0; 32 * ROW];
        for (row, place_m) in values.chunks_exact_mut(ROW).zip(&sensor.array.positions_m) {
            for value in row.iter_mut() {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *value = self.noise * ((state >> 8) as f32 / (1 << 23) as f32 - 1.0);
            }
            let delay_s = (place_m - sensor.emitter_m).norm() / self.speed_m_s + self.late_s;
            let lag = (delay_s * 450e3).round() as usize;
            for (value, sample) in row[lag..].iter_mut().zip(&sensor.emission.samples) {
                *value += self.amplitude * *sample as f32;
            }
        }
        values
    }
}

/// Listens to the same ping some times over, as a sensor that is built for `sensor` would.
fn listen(values: Vec<f32>, times: usize) -> (DirectFindings, DirectPath) {
    let sensor = sensor();
    let plan = plan(&sensor, SampleFormat::PcmF32);
    let samples = Arc::new(Samples::PcmF32(values));
    let ping = RawPing { sensor_index: 0, sequence: 0, emitted_at: Stamp::default(), samples };
    let mut path = DirectPath::new(&plan, &[sensor], 343.0);
    let mut found = DirectFindings::default();
    (0..times).for_each(|_| found = path.listen(&plan, &ping));
    (found, path)
}

fn faults(path: &DirectPath) -> Vec<(usize, ChannelFinding)> {
    path.unfit(0).iter().copied().enumerate().filter(|(_, finding)| *finding != ChannelFinding::Good).collect()
}

#[test]
fn a_direct_path_is_heard_in_noise_and_not_where_there_is_none() {
    let sensor = sensor();
    let (found, path) = listen(CLEAN.heard(&sensor), 1);
    assert!(found.correlation > 0.99 && found.map == ChannelMap::Fits, "{found:?}");
    assert_eq!(faults(&path), []);
    let calibration = path.calibration(0).expect("heard");
    // Whole samples are 0.76 mm.
    assert!(calibration.residual_m < 0.3e-3 && calibration.channels == 32, "{calibration:?}");
    let faint = World { amplitude: 0.002, ..CLEAN };
    assert!(listen(faint.heard(&sensor), 1).0.correlation > HEARD_MIN, "as strong as the noise");
    let (alone, _) = listen(World { amplitude: 0.0, noise: 0.5, ..CLEAN }.heard(&sensor), 8);
    assert!(alone.correlation < 0.7 * HEARD_MIN && alone.map == ChannelMap::Unknown, "noise reads {alone:?}");
    assert_eq!(listen(vec![0.0; 32 * ROW], 1).0.correlation, 0.0, "silence is no direct path");
}

#[test]
fn another_temperature_is_no_fault_and_another_sample_rate_is() {
    let sensor = sensor();
    for speed_m_s in [343.0 * 0.97, 343.0 * 1.03] {
        let (found, path) = listen(World { speed_m_s, ..CLEAN }.heard(&sensor), 4);
        assert_eq!((found.map, faults(&path)), (ChannelMap::Fits, vec![]), "{speed_m_s}");
        // Whole samples leave a percent.
        let calibration = path.calibration(0).expect("heard");
        assert!((calibration.speed_of_sound_m_s / speed_m_s - 1.0).abs() < 0.02, "{calibration:?}");
    }
    // A sampler 1 % off, and a trigger as late as that seems.
    for rate in [1.01, 0.99] {
        let mut fast = sensor.clone();
        fast.emission = Arc::new(Emission::hyperbolic(50e3 / rate, 25e3 / rate, 2.5e-3 * rate, 0.1, 450e3));
        let (found, _) = listen(World { speed_m_s: 343.0 / rate, ..CLEAN }.heard(&fast), 1);
        assert_eq!(found.map, ChannelMap::Doubted, "{rate}");
        let (found, _) = listen(World { speed_m_s: 343.0 / rate, ..CLEAN }.heard(&fast), 3);
        assert!(found.map == ChannelMap::Wrong && found.correlation > HEARD_MIN, "{rate}: {found:?}");
    }
    let late = World { late_s: 60e-6, ..CLEAN };
    let (found, _) = listen(late.heard(&sensor), 8);
    assert!(found.correlation > 0.9 && found.map == ChannelMap::Wrong, "{found:?}");
}

#[test]
fn exchanged_channels_and_another_array_are_a_wrong_map() {
    let sensor = sensor();
    let mut values = CLEAN.heard(&sensor);
    let (front, back) = values.split_at_mut(8 * ROW);
    front[3 * ROW..4 * ROW].swap_with_slice(&mut back[..ROW]);
    let (found, path) = listen(values.clone(), 3);
    assert_eq!((found.map, faults(&path).len()), (ChannelMap::Wrong, 2), "{:?}", faults(&path));
    let mut turned = sensor.clone();
    turned.array.positions_m.iter_mut().for_each(|place_m| *place_m = -*place_m);
    let (found, _) = listen(CLEAN.heard(&turned), 30);
    assert_eq!(found.map, ChannelMap::Wrong, "upside down");
    // And it is believed again when it fits again.
    let (_, mut path) = listen(values, 3);
    let plan = plan(&sensor, SampleFormat::PcmF32);
    let samples = Arc::new(Samples::PcmF32(CLEAN.heard(&sensor)));
    let good = RawPing { sensor_index: 0, sequence: 0, emitted_at: Stamp::default(), samples };
    assert_eq!(path.listen(&plan, &good).map, ChannelMap::Fits);
}

#[test]
fn deaf_and_noisy_channels_are_told_and_do_not_hide_the_direct_path() {
    let sensor = sensor();
    let mut values = CLEAN.heard(&sensor);
    for channel in [0, 1, 2, 11, 12, 22, 23] {
        values[channel * ROW..][..ROW].fill(0.0);
    }
    values[3 * ROW + 99] = f32::NAN;
    // Ten times the noise, and a port that is blocked.
    let noisy = World { noise: 0.02, ..CLEAN }.heard(&sensor);
    values[5 * ROW..6 * ROW].copy_from_slice(&noisy[5 * ROW..6 * ROW]);
    let blocked = World { amplitude: 0.02, ..CLEAN }.heard(&sensor);
    values[6 * ROW..7 * ROW].copy_from_slice(&blocked[6 * ROW..7 * ROW]);
    let (found, path) = listen(values, 4);
    assert!(found.correlation > 0.99 && found.map == ChannelMap::Fits, "{found:?}");
    let told: Vec<usize> = faults(&path).iter().map(|(channel, _)| *channel).collect();
    assert_eq!(told, [0, 1, 2, 3, 5, 6, 11, 12, 22, 23]);
    assert_eq!((path.unfit(0)[5], path.unfit(0)[6]), (ChannelFinding::Noisy, ChannelFinding::Deaf));
}

#[test]
fn a_ping_of_nothing_or_of_no_sensor_is_harmless() {
    let sensor = sensor();
    let plan = plan(&sensor, SampleFormat::PcmF32);
    let mut path = DirectPath::new(&plan, &[sensor], 343.0);
    for (sensor_index, samples) in
        [(0, Samples::PcmF32(vec![])), (7, Samples::PcmF32(vec![])), (0, Samples::Pdm(vec![1]))]
    {
        let ping = RawPing { sensor_index, sequence: 0, emitted_at: Stamp::default(), samples: Arc::new(samples) };
        assert_eq!(path.listen(&plan, &ping), DirectFindings::default());
    }
    assert!(path.unfit(7).is_empty() && path.calibration(7).is_none() && path.calibration(0).is_none());
    path.disregard(7);
}
