//! The paper's own way: three plain sonars 120 degrees apart, turned by 30 degrees three times (paper 003, section V).
//!
//! Goes in: a scene. Comes out: twelve ranges, what odometry, gyro and filter say about how far the robot had turned at each, and
//! what neighbours triangulate to. A plain sonar is a sensor of one microphone with an image of one direction: the same
//! simulator, matched filter and first echo as the arrays', no beamforming. Its cone is the beam of its emitter (a piston), which
//! is what a threshold makes of it: there is no sharp cone. What turns is set down at the next heading; the turning itself is not
//! simulated.

use super::scene::Scene;
use super::score::Told;
use crate::config::Config;
use crate::detect::heading::{HeadingFilter, HeadingNoise};
use crate::detect::ring::{RingObject, SONARS, reading_index};
use crate::detect::triangulation::{CHI_SQUARE_2, RangeReading, triangulate};
use crate::detect::{RangeScanner, RingParams};
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::imaging::backend::BackendError;
use crate::imaging::params::Prefer;
use crate::imaging::plan::ImagingPlan;
use crate::imaging::{Imager, ImagerOptions};
use crate::sensor::MicrophoneArray;
use crate::service::wiring::SensingSetup;
use crate::service::{ServiceError, simulator};
use crate::signal::{Direction, MaskTable, RangeScan, Ray, Reading, RobotScan};
use crate::sim::SimParams;
use crate::time::Stamp;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution as _, StandardNormal};
use std::sync::Arc;

/// Headings at which the paper reads its sonars.
pub const TURNS: usize = 4;
/// Full angle of the cones, for the gates: where the beam of the emitter below has fallen by what the threshold allows.
const CONE_DEG: f64 = 64.0;
/// Radius of the emitter: neighbours 30 degrees apart hear the same things from 60 degrees of beam on.
const EMITTER_RADIUS_M: f64 = 0.008;
/// The receiver's gain rises with range so that the thinnest thing reads the same at any; what is this far below does not count.
const BELOW_THINNEST: f64 = 0.316;
const THINNEST_RADIUS_M: f64 = 0.03;
const ABSORPTION_DB_M: f64 = 1.2;
/// The paper's 19 s: four times standing, three times turning by 30 degrees.
const STAND_S: f64 = 1.5;
const TURN_S: f64 = 13.0 / 3.0;
const TURN_RAD: f64 = std::f64::consts::PI / 6.0;
/// Its gyro: 6 degrees too much in that time, give or take.
const BIAS_RAD_S: f64 = 6.0 / 19.0 * std::f64::consts::PI / 180.0;
const BIAS_SIGMA_RAD_S: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// What tells how far the robot has turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compass {
    /// The gyro, as in the paper.
    Gyro,
    /// The wheels.
    Wheels,
    /// Both, by the Kalman filter.
    Filter,
}

/// Three plain sonars.
pub struct Singles {
    config: Config,
    setup: SensingSetup,
}

/// Them at work.
pub struct Listening {
    imager: Imager,
    scanner: RangeScanner,
    scan: RangeScan,
}

/// The twelve ranges, and the headings at which they were read.
#[derive(Debug, Clone, PartialEq)]
pub struct Round {
    /// By the number of the virtual sonar.
    pub readings: [Reading; SONARS],
    /// True turn since the start at each of the four readings.
    pub truth_rad: [f64; TURNS],
    /// What the gyro, the wheels and the filter say of it, each with its standard deviation.
    pub told_rad: [[(f64, f64); TURNS]; 3],
}

impl Singles {
    /// The robot of `config` with one microphone a sensor.
    ///
    /// # Errors
    /// What the configuration asks for and cannot be.
    pub fn new(config: &Config) -> Result<Self, ServiceError> {
        let recording = config.recording()?;
        let mut sensors = config.sensor_setups()?;
        for sensor in &mut sensors {
            sensor.array =
                MicrophoneArray { positions_m: vec![Vector3::zeros()], enabled: vec![true], weights: vec![1.0] };
            sensor.emitter_m = Vector3::new(0.0, 0.0, 0.02);
        }
        let hidden = vec![vec![false]; sensors.len()];
        let speed_of_sound_m_s = config.speed_of_sound_m_s();
        let ahead = vec![Direction::horizontal(0.0)];
        let plan = ImagingPlan::new(&sensors, &hidden, &recording, &config.imaging, ahead, speed_of_sound_m_s)?;
        let setup = SensingSetup {
            uncalibrated: sensors.clone(),
            sensors,
            plan: Arc::new(plan),
            recording,
            speed_of_sound_m_s,
            hidden: Vec::new(),
            warnings: Vec::new(),
        };
        Ok(Self { config: config.clone(), setup })
    }

    /// Opens an imager on one thread.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn listen(&self) -> Result<Listening, BackendError> {
        let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
        let plan = Arc::clone(&self.setup.plan);
        let scanner = RangeScanner::new(&plan.grid, &[false], threshold, 0.0);
        let scan = RangeScan::unseen(Arc::clone(&plan.grid), 0);
        Ok(Listening {
            imager: Imager::open(plan, Arc::new(MaskTable::default()), Prefer::Cpu, options)?,
            scanner,
            scan,
        })
    }

    /// Reads a scene: stands, reads, turns, four times.
    ///
    /// # Errors
    /// When the robot does not fit into the scene or a ping cannot be imaged.
    pub fn read(&self, listening: &mut Listening, scene: &Scene) -> Result<Round, ServiceError> {
        let acoustics = SimParams { emitter_radius_m: EMITTER_RADIUS_M, ..SimParams::default() };
        let mut simulator = simulator(&self.config, &self.setup, scene.world.clone(), acoustics, scene.seed)?;
        let mut pings = simulator.empty_ping_set();
        let mut round = turn(scene.seed);
        for turn in 0..TURNS {
            let heading_rad = wrap_angle_rad(scene.start.heading_rad + round.truth_rad[turn]);
            simulator.set_pose(Pose2 { heading_rad, ..scene.start });
            simulator.ping_set(Stamp { boottime_ns: 1 + turn as u64, wall_ns: 0 }, &mut pings);
            let image = listening.imager.image(&pings)?;
            for (sensor, energyscape) in image.energyscapes.iter().enumerate() {
                listening.scanner.scan(energyscape, &mut listening.scan);
                let reading = listening.scan.readings.first().copied().unwrap_or_default();
                round.readings[reading_index(sensor, turn)] = reading;
            }
        }
        Ok(round)
    }
}

/// Envelope that an echo must have to count, over range.
fn threshold(range_m: f64) -> f64 {
    let plane = SimParams::default().plane_at_1_m / range_m.max(0.05);
    let round = (THINNEST_RADIUS_M / (THINNEST_RADIUS_M + range_m)).sqrt();
    let absorbed = 10f64.powf(-2.0 * ABSORPTION_DB_M * (range_m - 1.0) / 20.0);
    BELOW_THINNEST * plane * round * absorbed
}

/// How the robot turned, and what its instruments say: drawn, no sonar involved.
fn turn(seed: u64) -> Round {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(7);
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let noise = HeadingNoise::default();
    let bias_rad_s = BIAS_RAD_S + BIAS_SIGMA_RAD_S * normal();
    // Nobody tells the filter the bias; that it may be as large it does know.
    let mut filter = HeadingFilter::new(noise, 0.0, 2.0 * BIAS_RAD_S);
    let (mut truth_rad, mut gyro_rad, mut wheels_rad, mut wheels_rad2, mut time_s) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let mut round =
        Round { readings: [Reading::Unseen; SONARS], truth_rad: [0.0; TURNS], told_rad: [[(0.0, 0.0); TURNS]; 3] };
    for index in 0..TURNS {
        let stretches = [(TURN_RAD, TURN_S), (0.0, STAND_S)];
        for (wanted_rad, dt_s) in stretches.into_iter().skip(usize::from(index == 0)) {
            let slip = (noise.odometry_share * wanted_rad).hypot(noise.odometry_floor_rad);
            let turned_rad = wanted_rad + slip * normal();
            let felt_rad = turned_rad + bias_rad_s * dt_s + noise.gyro_rad * f64::sqrt(dt_s) * normal();
            filter.advance(wanted_rad, Some(felt_rad), dt_s);
            truth_rad += turned_rad;
            gyro_rad += felt_rad;
            wheels_rad += wanted_rad;
            wheels_rad2 += slip * slip;
            time_s += dt_s;
        }
        round.truth_rad[index] = truth_rad;
        // The paper trusts its gyro: no bias, only noise.
        round.told_rad[0][index] = (gyro_rad, noise.gyro_rad * f64::sqrt(time_s));
        round.told_rad[1][index] = (wheels_rad, f64::sqrt(wheels_rad2));
        round.told_rad[2][index] = (filter.heading_rad(), filter.heading_sigma_rad());
    }
    round
}

/// What neighbours hear together, with the robot's middle at `start` and headings as a compass tells them; of several that mean one
/// thing the best known.
#[must_use]
pub fn objects(params: &RingParams, round: &Round, start: &Pose2, compass: Compass) -> Vec<RingObject> {
    let readings: Vec<Option<RangeReading>> =
        (0..SONARS).map(|sonar| reading(params, round, start, compass, sonar)).collect();
    let mut all: Vec<RingObject> = Vec::new();
    for first in 0..SONARS {
        let second = (first + 1) % SONARS;
        let Some((one, other)) = readings[first].zip(readings[second]) else { continue };
        let Some(fix) = triangulate(&one, &other, CONE_DEG.to_radians()) else { continue };
        // Both headings are off together by what the later of them is.
        let sigma_rad = told(round, compass, first).1.max(told(round, compass, second).1);
        let away_m = fix.position_m - start.position_m();
        let across = nalgebra::Vector2::new(-away_m.y, away_m.x) * sigma_rad;
        let covariance_m2 = fix.covariance_m2 + across * across.transpose();
        all.push(RingObject { position_m: fix.position_m, pair: [first, second], covariance_m2 });
    }
    all.sort_by(|a, b| a.covariance_m2.determinant().total_cmp(&b.covariance_m2.determinant()));
    let mut kept: Vec<RingObject> = Vec::new();
    for object in all {
        let same = |known: &RingObject| {
            let apart_m = object.position_m - known.position_m;
            let inverse = (object.covariance_m2 + known.covariance_m2).try_inverse();
            inverse.is_none_or(|inverse| (apart_m.transpose() * inverse * apart_m)[0] <= CHI_SQUARE_2)
        };
        if !kept.iter().any(same) {
            kept.push(object);
        }
    }
    kept
}

fn told(round: &Round, compass: Compass, sonar: usize) -> (f64, f64) {
    round.told_rad[compass as usize][sonar % 4]
}

fn reading(params: &RingParams, round: &Round, start: &Pose2, compass: Compass, sonar: usize) -> Option<RangeReading> {
    let Reading::Echo { range_m, .. } = round.readings[sonar] else { return None };
    if range_m > params.range_max_m {
        return None;
    }
    let transducer = transducer(params, round, start, compass, sonar);
    Some(RangeReading { transducer, range_m, range_sigma_m: params.range_noise_m })
}

/// Where a sonar of the ring stood when it was read, as a compass tells it: sensor s at turn k is sonar k + 4 s.
fn transducer(params: &RingParams, round: &Round, start: &Pose2, compass: Compass, sonar: usize) -> Pose2 {
    let mount_rad = (120.0 * (sonar / 4) as f64).to_radians();
    let robot = Pose2 { heading_rad: wrap_angle_rad(start.heading_rad + told(round, compass, sonar).0), ..*start };
    let [x_m, y_m] = [mount_rad.cos(), mount_rad.sin()].map(|share| share * params.ring_radius_m);
    robot.compose(&Pose2 { x_m, y_m, heading_rad: wrap_angle_rad(mount_rad) })
}

/// The twelve readings as a scan of the whole robot at the start, for the grid: every cone is free up to what its sonar heard.
#[must_use]
pub fn as_scan(params: &RingParams, round: &Round, start: &Pose2, compass: Compass, range_min_m: f64) -> RobotScan {
    let mut scan = RobotScan::unseen();
    scan.emitted_at = Stamp { boottime_ns: 1, wall_ns: 0 };
    scan.sensors_used = 0b111;
    scan.range_m = [params.ring_radius_m + range_min_m, params.ring_radius_m + params.range_max_m];
    for (index, ray) in scan.rays.iter_mut().enumerate() {
        let bearing_rad = start.heading_rad + RobotScan::bearing_rad(index);
        for sonar in 0..SONARS {
            let axis_rad = transducer(params, round, start, compass, sonar).heading_rad;
            if wrap_angle_rad(bearing_rad - axis_rad).abs() > 0.25 * CONE_DEG.to_radians() {
                continue;
            }
            let free_m = params.ring_radius_m
                + match round.readings[sonar] {
                    Reading::Echo { range_m, .. } => range_m.min(params.range_max_m),
                    Reading::Clear => params.range_max_m,
                    Reading::Unseen => continue,
                };
            if free_m > ray.free_m {
                *ray = Ray { reading: round.readings[sonar], free_m, ..Ray::default() };
            }
        }
    }
    scan
}

/// Objects as the score wants them.
#[must_use]
pub fn as_told(objects: &[RingObject]) -> Vec<Told> {
    let told = |object: &RingObject| Told { position_m: object.position_m, covariance_m2: object.covariance_m2 };
    objects.iter().map(told).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gyro_says_96_the_wheels_90_and_the_filter_is_nearest_to_the_truth() {
        let mut squares = [0.0; 3];
        let mut gyro_rad = 0.0;
        for seed in 0..400 {
            let round = turn(seed);
            for (compass, square) in squares.iter_mut().enumerate() {
                *square += (round.told_rad[compass][3].0 - round.truth_rad[3]).powi(2) / 400.0;
            }
            gyro_rad += round.told_rad[0][3].0 / 400.0;
            assert!((round.told_rad[1][3].0 - 90f64.to_radians()).abs() < 1e-12);
        }
        let [gyro, wheels, filter] = squares.map(|square| f64::sqrt(square).to_degrees());
        assert!((gyro_rad.to_degrees() - 96.0).abs() < 0.5, "{}", gyro_rad.to_degrees());
        assert!(filter < wheels && wheels < gyro, "{gyro} {wheels} {filter} degrees");
    }

    #[test]
    fn perfect_readings_of_one_thing_triangulate_to_it() {
        let params = RingParams { ring_radius_m: 0.1, range_noise_m: 1e-5, range_max_m: 1.5, ..RingParams::default() };
        let start = Pose2 { x_m: 1.0, y_m: 1.0, heading_rad: 0.4 };
        let place_m = nalgebra::Vector2::new(1.5, 1.6);
        let mut round = turn(3);
        // As if the wheels were right.
        for sonar in 0..SONARS {
            let local_m = transducer(&params, &round, &start, Compass::Wheels, sonar).local_from_parent(place_m);
            let heard = local_m.y.atan2(local_m.x).abs() <= 0.5 * CONE_DEG.to_radians();
            round.readings[sonar] =
                if heard { Reading::Echo { range_m: local_m.norm(), energy: 1.0 } } else { Reading::Clear };
        }
        let found = objects(&params, &round, &start, Compass::Wheels);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].position_m - place_m).norm() < 1e-3);
    }
}
