//! Sensors, emissions and signal measures of the simulator's tests, written from the specification and from geometry
//! alone: nothing here calls what it is used to test.
#![allow(dead_code)] // each test file uses its part

use nalgebra::{Vector2, Vector3};
use noctule::geometry::Pose2;
use noctule::sensor::{Emission, MicrophoneArray, Mount, RecordingFormat, SensorSetup};
use noctule::signal::{PingSet, SampleFormat, Samples};
use noctule::sim::{RobotParams, SimParams, Simulator, Wall, World};
use noctule::time::Stamp;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

pub const SPEED_M_S: f64 = 343.0;
pub const RATE_HZ: f64 = 450e3;
pub const SAMPLES: usize = 16_384;
const START_HZ: f64 = 50e3;
const END_HZ: f64 = 25e3;
const DURATION_S: f64 = 2.5e-3;
const COUNT: usize = 1126;

/// The default sweep at any time, sample or not (specification, section 2): its taper is the same cosine between samples.
pub fn sweep(time_s: f64) -> f64 {
    let x = time_s * RATE_HZ;
    let width = (0.2 * COUNT as f64).round();
    let fade_in = (width / 2.0).ceil();
    let k = if x <= fade_in - 1.0 {
        x + 1.0
    } else if x >= COUNT as f64 - (width - fade_in) - 1.0 {
        x - (COUNT as f64 - width) + 1.0
    } else {
        (width + 1.0) / 2.0
    };
    if !(0.0..=width + 1.0).contains(&k) {
        return 0.0;
    }
    let slope = 1.0 / END_HZ - 1.0 / START_HZ;
    let phase =
        TAU * DURATION_S / slope * ((1.0 / START_HZ + time_s * slope / DURATION_S).ln() - (1.0 / START_HZ).ln());
    0.5 * (1.0 - (TAU * k / (width + 1.0)).cos()) * phase.sin()
}

pub fn emission() -> Arc<Emission> {
    let samples = (0..COUNT).map(|index| sweep(index as f64 / RATE_HZ)).collect();
    Arc::new(Emission { samples, sample_rate_hz: RATE_HZ, band_hz: (END_HZ, START_HZ) })
}

/// A tone of 2.5 ms with a Hann envelope, for one frequency's sake.
pub fn tone(frequency_hz: f64) -> Arc<Emission> {
    let samples = (0..COUNT)
        .map(|index| {
            let time_s = index as f64 / RATE_HZ;
            0.5 * (1.0 - (TAU * index as f64 / (COUNT - 1) as f64).cos()) * (TAU * frequency_hz * time_s).sin()
        })
        .collect();
    Arc::new(Emission { samples, sample_rate_hz: RATE_HZ, band_hz: (frequency_hz - 1e3, frequency_hz + 1e3) })
}

pub fn array() -> MicrophoneArray {
    let text = include_str!("../../fixtures/arrays/ertis_v3d1_microphones.csv");
    let positions_m: Vec<Vector3<f64>> = text
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<f64> = line.split(',').skip(1).map(|cell| cell.trim().parse().unwrap()).collect();
            Vector3::new(cells[0], cells[1], cells[2])
        })
        .collect();
    let count = positions_m.len();
    MicrophoneArray { positions_m, enabled: vec![true; count], weights: vec![1.0; count] }
}

pub fn sensor(distance_m: f64, bearing_deg: f64, yaw_deg: f64) -> SensorSetup {
    SensorSetup {
        name: "sonar".into(),
        mount: Mount { distance_m, bearing_rad: bearing_deg.to_radians(), yaw_rad: yaw_deg.to_radians() },
        array: array(),
        emission: emission(),
        emitter_m: Vector3::new(0.0, 0.0, 0.06),
    }
}

pub fn three_sensors() -> Vec<SensorSetup> {
    vec![sensor(0.15, 0.0, 0.0), sensor(0.15, 120.0, 0.0), sensor(0.15, -120.0, 0.0)]
}

pub fn pcm() -> RecordingFormat {
    RecordingFormat { format: SampleFormat::PcmF32, sample_rate_hz: RATE_HZ, samples: SAMPLES, decimation: 1 }
}

pub fn pdm() -> RecordingFormat {
    RecordingFormat { format: SampleFormat::Pdm, sample_rate_hz: 4.5e6, samples: 163_840, decimation: 10 }
}

/// No noise, no direct path, no absorption, equal clocks, an emitter that sends the same everywhere in front: echoes alone.
pub fn bare() -> SimParams {
    SimParams {
        noise_rms: 0.0,
        direct_amplitude: 0.0,
        air: None,
        emitter_radius_m: 0.0,
        sync_jitter_s: 0.0,
        ..SimParams::default()
    }
}

pub fn open_wall(points: &[[f64; 2]]) -> Wall {
    Wall { points: points.to_vec(), closed: false }
}

pub fn walls(points: &[&[[f64; 2]]]) -> World {
    World { walls: points.iter().map(|points| open_wall(points)).collect(), ..World::default() }
}

/// A simulator whose robot starts far from everything; tests put it where they want it.
pub fn simulator(mut world: World, sensors: &[SensorSetup], params: SimParams) -> Simulator {
    world.start.corner = [0.0, -500.0];
    Simulator::new(world, sensors, &pcm(), RobotParams::default(), SPEED_M_S, params, 1).unwrap()
}

pub fn ping(simulator: &mut Simulator) -> PingSet {
    let mut set = simulator.empty_ping_set();
    simulator.ping_set(Stamp::default(), &mut set);
    set
}

/// One microphone's samples of a PCM ping.
pub fn row(set: &PingSet, sensor: usize, microphone: usize) -> &[f32] {
    let Samples::PcmF32(values) = &*set.pings[sensor].samples else { panic!("not f32") };
    &values[microphone * SAMPLES..(microphone + 1) * SAMPLES]
}

/// Place in the world, and height, of a point of a sensor's frame.
pub fn in_world(robot: &Pose2, sensor: &SensorSetup, local: &Vector3<f64>) -> Vector3<f64> {
    // Written out as rotations, apart from the library's own composition of poses.
    let heading = robot.heading_rad + sensor.mount.bearing_rad + sensor.mount.yaw_rad;
    let towards = robot.heading_rad + sensor.mount.bearing_rad;
    Vector3::new(
        robot.x_m + sensor.mount.distance_m * towards.cos() + local.x * heading.cos() - local.y * heading.sin(),
        robot.y_m + sensor.mount.distance_m * towards.sin() + local.x * heading.sin() + local.y * heading.cos(),
        local.z,
    )
}

/// Mirror image in the upright plane through two points.
pub fn mirrored(place: &Vector3<f64>, from: [f64; 2], to: [f64; 2]) -> Vector3<f64> {
    let normal = Vector2::new(from[1] - to[1], to[0] - from[0]).normalize();
    let distance = normal.dot(&(place.xy() - Vector2::from(from)));
    let image = place.xy() - normal * (2.0 * distance);
    Vector3::new(image.x, image.y, place.z)
}

/// Largest difference between samples and `amplitude` times the sweep delayed by `delay_s`, over the whole ping.
pub fn misfit(samples: &[f32], delay_s: f64, amplitude: f64) -> f64 {
    samples
        .iter()
        .enumerate()
        .map(|(index, value)| (f64::from(*value) - amplitude * sweep(index as f64 / RATE_HZ - delay_s)).abs())
        .fold(0.0, f64::max)
}

/// Matched-filter reading of an echo that begins at `delay_s`: envelope at that time, 1 for the emission itself.
///
/// The quadrature partner is the sweep with its phase turned by a right angle.
pub fn reading(samples: &[f32], delay_s: f64) -> f64 {
    let (mut in_phase, mut quadrature, mut energy) = (0.0, 0.0, 0.0);
    for (index, value) in samples.iter().enumerate() {
        let (s, c) = sweep_pair(index as f64 / RATE_HZ - delay_s);
        in_phase += f64::from(*value) * s;
        quadrature += f64::from(*value) * c;
        energy += s * s;
    }
    in_phase.hypot(quadrature) / energy
}

/// The sweep and its quadrature.
fn sweep_pair(time_s: f64) -> (f64, f64) {
    // A quarter period earlier in phase: the hyperbolic sweep's phase is slow enough for the analytic signal to be this.
    let s = sweep(time_s);
    let slope = 1.0 / END_HZ - 1.0 / START_HZ;
    let argument = 1.0 / START_HZ + time_s * slope / DURATION_S;
    if s == 0.0 || argument <= 0.0 {
        return (s, 0.0);
    }
    let phase = TAU * DURATION_S / slope * (argument.ln() - (1.0 / START_HZ).ln());
    let envelope = if phase.sin().abs() > 1e-6 { s / phase.sin() } else { 0.0 };
    (s, envelope * phase.cos())
}

/// Largest [`reading`] within a window around `delay_s`.
pub fn peak_near(samples: &[f32], delay_s: f64, half_width_s: f64) -> f64 {
    let count = (half_width_s * RATE_HZ).round() as i32;
    (-count..=count).map(|step| reading(samples, delay_s + f64::from(step) / RATE_HZ)).fold(0.0, f64::max)
}

pub fn rms(samples: &[f32]) -> f64 {
    (samples.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>() / samples.len() as f64).sqrt()
}

pub fn largest(samples: &[f32]) -> f64 {
    samples.iter().map(|value| f64::from(value.abs())).fold(0.0, f64::max)
}

/// Low-pass of `taps` samples (Hann windowed sinc), delay removed, keeping every `keep`th value.
pub fn low_pass(bits: impl Fn(i64) -> f64, count: usize, cut: f64, taps: i64, keep: usize) -> Vec<f64> {
    let half = taps / 2;
    let kernel: Vec<f64> = (-half..=half)
        .map(|offset| {
            let x = offset as f64;
            let sinc = if offset == 0 { 2.0 * cut } else { (TAU * cut * x).sin() / (PI * x) };
            sinc * (0.5 + 0.5 * (PI * x / (half as f64 + 1.0)).cos())
        })
        .collect();
    (0..count / keep)
        .map(|index| {
            let centre = (index * keep) as i64;
            kernel.iter().enumerate().map(|(tap, weight)| weight * bits(centre + tap as i64 - half)).sum()
        })
        .collect()
}
