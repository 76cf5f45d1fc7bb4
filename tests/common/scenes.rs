//! Scenes with known content: sensors, an emission by its own formula, echoes at exact delays, noise, and the three raw formats.
//!
//! Shares nothing with the library but its nouns.

use super::Random;
use nalgebra::Vector3;
use noctule::imaging::params::ImagingParams;
use noctule::imaging::plan::ImagingPlan;
use noctule::sensor::{Emission, MicrophoneArray, Mount, RecordingFormat, SensorSetup};
use noctule::signal::{Direction, LayerName, MaskPurpose, MaskRow, MaskTable, PingSet, RawPing, SampleFormat, Samples};
use noctule::time::Stamp;
use std::f64::consts::PI;
use std::sync::Arc;

pub const SPEED_OF_SOUND_M_S: f64 = 343.0;

/// The hyperbolic sweep of the specification, section 2, at any time: with its taper as a function of time.
#[derive(Debug, Clone, Copy)]
pub struct Sweep {
    pub start_hz: f64,
    pub end_hz: f64,
    pub duration_s: f64,
    pub taper: f64,
    /// Rate at which the emission is given; the taper's length is a whole number of its samples.
    pub rate_hz: f64,
}

impl Sweep {
    pub fn new(start_hz: f64, end_hz: f64, rate_hz: f64) -> Self {
        Self { start_hz, end_hz, duration_s: 2.5e-3, taper: 0.1, rate_hz }
    }

    pub fn sample_count(&self) -> usize {
        (self.duration_s * self.rate_hz).round() as usize + 1
    }

    /// s(t); zero outside the emission.
    pub fn at(&self, time_s: f64) -> f64 {
        let last_s = (self.sample_count() - 1) as f64 / self.rate_hz;
        if !(0.0..=last_s).contains(&time_s) {
            return 0.0;
        }
        let slope = 1.0 / self.end_hz - 1.0 / self.start_hz;
        let phase = 2.0 * PI * self.duration_s / slope
            * ((1.0 / self.start_hz + time_s * slope / self.duration_s).ln() - (1.0 / self.start_hz).ln());
        let width = (2.0 * self.taper * self.sample_count() as f64).round();
        let from_end = (time_s.min(last_s - time_s)) * self.rate_hz + 1.0;
        let weight =
            if from_end <= 0.5 * width { 0.5 * (1.0 - (2.0 * PI * from_end / (width + 1.0)).cos()) } else { 1.0 };
        weight * phase.sin()
    }

    pub fn emission(&self) -> Emission {
        Emission {
            samples: (0..self.sample_count()).map(|n| self.at(n as f64 / self.rate_hz)).collect(),
            sample_rate_hz: self.rate_hz,
            band_hz: (self.start_hz.min(self.end_hz), self.start_hz.max(self.end_hz)),
        }
    }
}

/// Where the sensors of these scenes emit from.
pub const EMITTER_M: Vector3<f64> = Vector3::new(0.0, 0.0, 0.06);

/// One echo: a plane wave whose first sample reaches the sensor's origin at `time_s` from `direction`, or, where there is a point, what it
/// throws back from the emitter to every microphone.
#[derive(Debug, Clone, Copy)]
pub struct Echo {
    pub amplitude: f64,
    pub time_s: f64,
    pub direction: Direction,
    pub point_m: Option<Vector3<f64>>,
}

impl Echo {
    /// The echo of a point at a range and a bearing.
    pub fn of_point(amplitude: f64, range_m: f64, direction: Direction) -> Self {
        let point_m = unit(&direction) * range_m;
        Self { amplitude, time_s: 2.0 * range_m / SPEED_OF_SOUND_M_S, direction, point_m: Some(point_m) }
    }

    /// When its first sample reaches a microphone.
    fn arrives_s(&self, position_m: &Vector3<f64>) -> f64 {
        match self.point_m {
            Some(point_m) => ((point_m - EMITTER_M).norm() + (point_m - position_m).norm()) / SPEED_OF_SOUND_M_S,
            None => self.time_s - position_m.dot(&unit(&self.direction)) / SPEED_OF_SOUND_M_S,
        }
    }
}

/// What a microphone at `position_m` hears of `echoes` at a time.
pub fn heard(sweep: &Sweep, echoes: &[Echo], position_m: &Vector3<f64>, time_s: f64) -> f64 {
    let of_one = |echo: &Echo| echo.amplitude * sweep.at(time_s - echo.arrives_s(position_m));
    echoes.iter().map(of_one).sum()
}

/// Unit vector of a direction, by its own formula.
pub fn unit(direction: &Direction) -> Vector3<f64> {
    let (azimuth, elevation) = (direction.azimuth_rad, direction.elevation_rad);
    Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin())
}

/// Everything that a comparison needs: sensors, format, grid.
#[derive(Debug, Clone)]
pub struct Case {
    pub name: &'static str,
    pub arrays: Vec<Vec<Vector3<f64>>>,
    pub sweep: Sweep,
    pub recording: RecordingFormat,
    pub params: ImagingParams,
    pub directions: Vec<Direction>,
    /// Per sensor, directions that are hidden.
    pub hidden: Vec<Vec<bool>>,
    /// Standard deviation of the white noise at the demodulated rate.
    pub noise: f64,
    /// Amplitude of a tone outside the band.
    pub tone: f64,
}

impl Case {
    /// The default configuration of the specification with `sensors` sensors and every `stride`-th bearing.
    pub fn standard(name: &'static str, format: SampleFormat, sensors: usize, stride: usize) -> Self {
        let pdm = format == SampleFormat::Pdm;
        let recording = RecordingFormat {
            format,
            sample_rate_hz: if pdm { 4.5e6 } else { 450e3 },
            samples: if pdm { 163_840 } else { 16_384 },
            decimation: if pdm { 10 } else { 1 },
        };
        let sweep = Sweep::new(50e3, 25e3, 450e3);
        let directions =
            (0..180).step_by(stride).map(|i| Direction::horizontal((-89.5 + i as f64).to_radians())).collect();
        Self::new(name, vec![ertis_array(); sensors], sweep, recording, directions)
    }

    pub fn new(
        name: &'static str,
        arrays: Vec<Vec<Vector3<f64>>>,
        sweep: Sweep,
        recording: RecordingFormat,
        directions: Vec<Direction>,
    ) -> Self {
        let hidden = vec![vec![false; directions.len()]; arrays.len()];
        Self {
            name,
            arrays,
            sweep,
            recording,
            params: ImagingParams::default(),
            directions,
            hidden,
            noise: 3e-3,
            tone: 0.05,
        }
    }

    pub fn sensors(&self) -> Vec<SensorSetup> {
        let emission = Arc::new(self.sweep.emission());
        let sensor = |(index, positions_m): (usize, &Vec<Vector3<f64>>)| SensorSetup {
            name: format!("s{index}"),
            mount: Mount { distance_m: 0.1, bearing_rad: index as f64, yaw_rad: 0.0 },
            array: MicrophoneArray {
                positions_m: positions_m.clone(),
                enabled: vec![true; positions_m.len()],
                weights: vec![1.0; positions_m.len()],
            },
            emission: Arc::clone(&emission),
            emitter_m: EMITTER_M,
        };
        self.arrays.iter().enumerate().map(sensor).collect()
    }

    pub fn plan(&self) -> Arc<ImagingPlan> {
        let plan = ImagingPlan::new(
            &self.sensors(),
            &self.hidden,
            &self.recording,
            &self.params,
            self.directions.clone(),
            SPEED_OF_SOUND_M_S,
        );
        Arc::new(plan.unwrap_or_else(|error| panic!("{}: {error}", self.name)))
    }

    /// Rate and number of samples after demodulation.
    pub fn demodulated(&self) -> (f64, usize) {
        let decimation = self.recording.decimation;
        (self.recording.sample_rate_hz / decimation as f64, self.recording.samples / decimation)
    }

    /// Random echoes all over the ranges and directions, a strong direct path among them.
    pub fn random_echoes(&self, random: &mut Random) -> Vec<Echo> {
        let last_s = 2.0 * self.params.range_max_m / SPEED_OF_SOUND_M_S;
        let mut echoes: Vec<Echo> = (0..6)
            .map(|_| Echo {
                amplitude: random.uniform(0.02, 0.15),
                time_s: random.uniform(1e-3, last_s),
                direction: Direction {
                    azimuth_rad: random.uniform(-1.5, 1.5),
                    elevation_rad: random.uniform(-0.3, 0.3),
                },
                point_m: None,
            })
            .collect();
        let direct = Direction { azimuth_rad: 0.0, elevation_rad: 1.5 };
        echoes.push(Echo { amplitude: 0.3, time_s: 1.7e-4, direction: direct, point_m: None });
        echoes
    }

    /// Samples of one sensor in the case's raw format.
    pub fn samples(&self, sensor: usize, echoes: &[Echo], random: &mut Random) -> Samples {
        let array = &self.arrays[sensor];
        let (rate_hz, count) = (self.recording.sample_rate_hz, self.recording.samples);
        // The same noise density at every raw rate.
        let noise = self.noise * (self.recording.decimation as f64).sqrt();
        let tone_hz = 0.41 * self.demodulated().0;
        let mut signal = |position_m: &Vector3<f64>| -> Vec<f64> {
            let phase = random.uniform(0.0, 6.0);
            (0..count)
                .map(|n| {
                    let time_s = n as f64 / rate_hz;
                    let tone =
                        if self.tone > 0.0 { self.tone * (2.0 * PI * tone_hz * time_s + phase).sin() } else { 0.0 };
                    let noise = if noise > 0.0 { noise * random.normal() } else { 0.0 };
                    heard(&self.sweep, echoes, position_m, time_s) + tone + noise
                })
                .collect()
        };
        match self.recording.format {
            SampleFormat::PcmF32 => Samples::PcmF32(array.iter().flat_map(signal).map(|x| x as f32).collect()),
            SampleFormat::PcmI16 => {
                let quantised = |x: f64| (x * 32768.0).round().clamp(-32768.0, 32767.0) as i16;
                Samples::PcmI16(array.iter().flat_map(signal).map(quantised).collect())
            }
            SampleFormat::Pdm => {
                let mut words = vec![0_u32; count];
                for (channel, position_m) in array.iter().enumerate() {
                    sigma_delta(&signal(position_m), channel, &mut words);
                }
                Samples::Pdm(words)
            }
        }
    }

    /// A set with random echoes at every sensor.
    pub fn random_pings(&self, seed: u64) -> PingSet {
        let mut random = Random(seed);
        let samples = (0..self.arrays.len())
            .map(|sensor| {
                let echoes = self.random_echoes(&mut random);
                self.samples(sensor, &echoes, &mut random)
            })
            .collect();
        ping_set(seed, samples)
    }
}

/// A set of pings, all present.
pub fn ping_set(sequence: u64, samples: Vec<Samples>) -> PingSet {
    let mut present = [false; noctule::signal::SENSORS_MAX];
    present[..samples.len()].fill(true);
    let ping = |(sensor_index, samples)| RawPing {
        sensor_index,
        sequence: sequence + sensor_index as u64,
        emitted_at: Stamp::default(),
        samples: Arc::new(samples),
    };
    let pings = samples.into_iter().enumerate().map(ping).collect();
    PingSet { sequence, emitted_at: Stamp::default(), pings, present }
}

/// Second-order sigma-delta modulator, its bits into bit `channel` of `words`.
fn sigma_delta(signal: &[f64], channel: usize, words: &mut [u32]) {
    let (mut first, mut second) = (0.0, 0.0);
    for (x, word) in signal.iter().zip(words) {
        let y = if second >= 0.0 { 1.0 } else { -1.0 };
        first += 0.5 * (x - y);
        second += 0.5 * (first - y);
        if y > 0.0 {
            *word |= 1 << channel;
        }
    }
}

/// The 32 microphones of the eRTIS v3D1 array, from the file that ships with the project.
pub fn ertis_array() -> Vec<Vector3<f64>> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/arrays/ertis_v3d1_microphones.csv");
    let text = std::fs::read_to_string(path).expect("the array's file is part of the project");
    let row = |line: &str| {
        let fields: Vec<f64> = line.split(',').skip(1).map(|field| field.parse().expect("a number")).collect();
        Vector3::new(fields[0], fields[1], fields[2])
    };
    text.lines().skip(1).map(row).collect()
}

/// Microphones at random places in a cube of `size_m`, or in the plane x = 0.
pub fn random_array(count: usize, size_m: f64, planar: bool, seed: u64) -> Vec<Vector3<f64>> {
    let mut random = Random(seed);
    let mut place = || random.uniform(-0.5 * size_m, 0.5 * size_m);
    (0..count).map(|_| Vector3::new(if planar { 0.0 } else { place() }, place(), place())).collect()
}

/// A table of random regions and lines on every sensor, with range gains and floors that some cells fall below.
pub fn random_masks(plan: &ImagingPlan, seed: u64) -> Arc<MaskTable> {
    let mut random = Random(seed);
    let mut table = MaskTable::default();
    let ranges = plan.grid.range_count();
    for sensor_index in 0..plan.sensors.len() {
        for index in 0..5 {
            let first = table.cells.len();
            let count = if index == 4 { 0 } else { 1 + random.index(plan.grid.cell_count().min(3000)) };
            for _ in 0..count {
                table.cells.push(random.index(plan.grid.cell_count()) as u32);
                table.sides.push(if random.index(2) == 0 { 1.0 } else { -1.0 });
                table.distances_m.push(random.uniform(0.0, 4.0) as f32);
            }
            let purpose = match index {
                0 => MaskPurpose::Region(LayerName::CollisionAvoidance),
                1 => MaskPurpose::Region(LayerName::ObstacleAvoidance),
                _ => MaskPurpose::FlowLine { index, lateral_m: index as f64 },
            };
            table.rows.push(MaskRow { purpose, sensor_index, first, count });
        }
        table.gains.push((0..ranges).map(|_| random.uniform(0.5, 3.0) as f32).collect());
        table.floors.push((0..ranges).map(|_| random.uniform(0.0, 2e-3) as f32).collect());
    }
    Arc::new(table)
}

/// Work that takes any software adapter far longer than a deadline: 1800 directions of three sensors.
pub fn heavy() -> (Arc<ImagingPlan>, Arc<MaskTable>, PingSet) {
    let mut case = Case::standard("late", SampleFormat::PcmF32, 3, 180);
    case.directions = (0..1800).map(|i| Direction::horizontal((-89.95 + 0.1 * f64::from(i)).to_radians())).collect();
    case.hidden = vec![vec![false; 1800]; 3];
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let pings = PingSet::empty(3, SampleFormat::PcmF32, &[plan.raw_len(0); 3]);
    (plan, masks, PingSet { present: [true; 3], ..pings })
}
