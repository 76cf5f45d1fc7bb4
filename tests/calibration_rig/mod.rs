//! Worlds for the tests of the calibration: sensors that are not what the configuration says, heard by the simulator; and the direct
//! path as a closed form. Nothing here calls what it is used to test.
#![allow(dead_code)]

mod applied;
mod cross;
mod drift;

use crate::sim_support::{RATE_HZ, SAMPLES, SPEED_M_S, array, emission, pcm, pdm, sweep, walls};
use nalgebra::Vector3;
use noctule::calibration::arrival::Sweep;
use noctule::calibration::{Observer, SensorCalibration, Tolerances, measure};
use noctule::geometry::Pose2;
use noctule::imaging::params::ImagingParams;
use noctule::imaging::plan::ImagingPlan;
use noctule::imaging::steering::horizontal_directions;
use noctule::sensor::{Mount, RecordingFormat, SensorSetup};
use noctule::signal::{PingSet, SampleFormat, Samples, Velocity};
use noctule::sim::{RobotParams, SimParams, Simulator, World};
use noctule::time::Stamp;
use std::sync::Arc;

/// Speed of sound in dry air, the textbook's formula.
pub fn speed_m_s(temperature_c: f64) -> f64 {
    331.3 * (1.0 + temperature_c / 273.15).sqrt()
}

/// Numbers of a normal distribution, reproducible.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn gaussian(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// The sensor as configured.
pub fn nominal() -> SensorSetup {
    SensorSetup {
        name: "front".into(),
        mount: Mount { distance_m: 0.15, bearing_rad: 0.0, yaw_rad: 0.0 },
        array: array(),
        emission: emission(),
        emitter_m: Vector3::new(0.0, 0.0, 0.06),
    }
}

/// What the world really is.
#[derive(Clone)]
pub struct Truth {
    pub sensor: SensorSetup,
    pub speed_m_s: f64,
    /// Gain of each microphone.
    pub gains: Vec<f64>,
    pub params: SimParams,
    pub world: World,
    pub pose: Pose2,
    pub velocity: Velocity,
    pub samples: usize,
}

impl Truth {
    /// As configured, at 343 m/s, in a room.
    pub fn as_configured() -> Self {
        let wall: &[[f64; 2]] = &[[-2.0, -2.0], [2.5, -2.0], [2.5, 2.2], [-2.0, 2.2], [-2.0, -2.0]];
        Self {
            sensor: nominal(),
            speed_m_s: 343.0,
            gains: vec![1.0; 32],
            params: SimParams::default(),
            world: walls(&[wall]),
            pose: Pose2 { x_m: 0.2, y_m: -0.1, heading_rad: 0.3 },
            velocity: Velocity { linear_m_s: 0.25, angular_rad_s: 0.4 },
            samples: SHORT,
        }
    }

    pub fn simulator(&self, recording: &RecordingFormat, seed: u64) -> Simulator {
        let sensors = std::slice::from_ref(&self.sensor);
        let robot = RobotParams::default();
        Simulator::new(self.world.clone(), sensors, recording, robot, self.speed_m_s, self.params, seed).expect("world")
    }

    /// Pings of a robot that drives circles in the room, gains applied.
    pub fn pings(&self, count: usize, format: SampleFormat, seed: u64, mut each: impl FnMut(&PingSet)) {
        let recording = recording_of(format, self.samples);
        let mut simulator = self.simulator(&recording, seed);
        simulator.set_pose(self.pose);
        let mut set = simulator.empty_ping_set();
        for _ in 0..count {
            simulator.step(self.velocity, 0.1);
            simulator.ping_set(Stamp::default(), &mut set);
            if self.gains.iter().any(|gain| *gain != 1.0) {
                apply_gains(set.pings[0].samples_mut(), &self.gains, self.samples);
            }
            each(&set);
        }
    }
}

fn apply_gains(heard: &mut Samples, gains: &[f64], samples: usize) {
    match heard {
        Samples::PcmF32(values) => {
            for (row, gain) in values.chunks_exact_mut(samples).zip(gains) {
                row.iter_mut().for_each(|value| *value = (*value * *gain as f32).clamp(-1.0, 1.0));
            }
        }
        Samples::PcmI16(values) => {
            for (row, gain) in values.chunks_exact_mut(samples).zip(gains) {
                row.iter_mut().for_each(|value| *value = (f64::from(*value) * gain).round() as i16);
            }
        }
        Samples::Pdm(_) => panic!("a gain is no matter of PDM words"),
    }
}

/// A channel's start in closed form: the sweep `delay_s` late, times `amplitude`, noise on it, cut off at 1.
pub fn channel(delay_s: f64, amplitude: f64, noise: f64, len: usize, random: &mut Random) -> Vec<f32> {
    let sample = |index: usize| {
        let heard = amplitude * sweep(index as f64 / RATE_HZ - delay_s) + noise * random.gaussian();
        heard.clamp(-1.0, 1.0) as f32
    };
    (0..len).map(sample).collect()
}

/// Samples of a short recording: all that the direct path needs, and cheaper to make.
pub const SHORT: usize = 4_096;

pub fn recording_of(format: SampleFormat, samples: usize) -> RecordingFormat {
    match format {
        SampleFormat::Pdm => RecordingFormat { samples: 10 * samples, ..pdm() },
        _ => RecordingFormat { format, samples, ..pcm() },
    }
}

/// The plan of a short recording, or of a whole one with an image to 5 m.
pub fn plan_of(sensor: &SensorSetup, format: SampleFormat, samples: usize) -> ImagingPlan {
    let params = ImagingParams { range_max_m: if samples < SAMPLES { 1.0 } else { 5.0 }, ..ImagingParams::default() };
    let directions = horizontal_directions(&params.directions).expect("directions");
    let hidden = [vec![false; directions.len()]];
    let recording = recording_of(format, samples);
    ImagingPlan::new(std::slice::from_ref(sensor), &hidden, &recording, &params, directions, SPEED_M_S).expect("plan")
}

/// A world whose sensor is not as configured: emitter, microphones, gains.
pub fn crooked(temperature_c: f64, seed: u64) -> Truth {
    let mut random = Random(seed);
    let mut truth = Truth::as_configured();
    truth.speed_m_s = speed_m_s(temperature_c);
    // Room for gains of 4 dB below full scale.
    truth.params.direct_amplitude = 0.4;
    truth.sensor.emitter_m += Vector3::new(0.0, 1.2e-3 * random.gaussian(), 0.8e-3 * random.gaussian());
    for place_m in &mut truth.sensor.array.positions_m {
        *place_m += Vector3::new(0.0, 0.4e-3 * random.gaussian(), 0.4e-3 * random.gaussian());
    }
    truth.gains = (0..32).map(|_| 10f64.powf(random.gaussian() / 20.0)).collect();
    truth
}

pub fn observe(truth: &Truth, format: SampleFormat, count: usize, seed: u64) -> Observer {
    let sensor = nominal();
    let plan = plan_of(&sensor, format, truth.samples);
    let template = Arc::new(Sweep::new(&sensor.emission));
    let mut observer = Observer::new(&plan, &sensor, &template, SPEED_M_S, (32, f64::INFINITY), None);
    truth.pings(count, format, seed, |set| observer.listen(&plan, &set.pings[0].samples));
    observer
}

/// With a thermometer of half a degree, or with nothing but the configuration.
pub fn measured(observer: &Observer, truth: &Truth, thermometer: bool) -> SensorCalibration {
    let tolerances = Tolerances { speed_m_s: if thermometer { 0.3 } else { 10.0 }, ..Tolerances::default() };
    let speed_m_s = if thermometer { truth.speed_m_s } else { SPEED_M_S };
    measure(observer, &nominal(), speed_m_s, &tolerances).expect("measured")
}

/// By how much each microphone's way is longer than nominal place and true emitter say.
pub fn longer_m(truth: &Truth) -> Vec<f64> {
    let pairs = truth
        .sensor
        .array
        .positions_m
        .iter()
        .zip(&nominal().array.positions_m)
        .map(|(p, q)| (*p, *q))
        .collect::<Vec<_>>();
    pairs.iter().map(|(p, q)| (p - truth.sensor.emitter_m).norm() - (q - truth.sensor.emitter_m).norm()).collect()
}
