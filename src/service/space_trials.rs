//! What points in space are worth: simulated rooms with things on the floor, in the way and overhead, against the truth.
//!
//! Goes in: seeds, and robots that differ in their grid of directions only. Comes out: for each room what there was ([`Thing`]), what
//! the points say ([`Look`]), and the score ([`SpaceScore`]). A robot whose grid is a level fan is scored by the reflectors that its image
//! has in the plane: all of them are in its way. Draws nothing.

use super::wiring::{self, SensingSetup};
use super::{ServiceError, scanning, simulator};
use crate::config::Config;
use crate::detect::SpaceDetector;
use crate::detect::reflectors::{REFLECTORS_MAX, Reflector};
use crate::geometry::Pose2;
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::signal::{MaskTable, PointCloud, SpaceClass, SpacePoint};
use crate::sim::{Ball, Bar, SimParams, World};
use crate::time::Stamp;
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::sync::Arc;
use std::time::Instant;

/// Heights of the rooms above the plane of the sensors' origins, and the heights that the robot fills.
pub const FLOOR_M: f64 = -0.40;
/// Ceiling.
pub const CEILING_M: f64 = 1.90;
/// From the lowest to the highest part of the robot.
pub const BAND_M: [f64; 2] = [-0.32, 0.30];
/// A point within this distance of a thing is its echo.
const GATE_M: f64 = 0.25;
/// Things are this far apart in range: what echoes within 6 cm of something louder may be its side lobe.
const APART_M: f64 = 0.15;
/// Pings of a room: floor and ceiling are medians of at least three; the last one is scored.
const PINGS: u64 = 4;
/// Tries to place a thing.
const TRIES: usize = 60;

/// One thing of a room, where it echoes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thing {
    /// The place of its surface that is nearest to the sensor, robot frame.
    pub place_m: Vector3<f64>,
    /// What it is to this robot.
    pub class: SpaceClass,
}

/// A room with its truth.
#[derive(Debug, Clone)]
pub struct Room {
    /// The world, the robot in its origin.
    pub world: World,
    /// What is to be heard.
    pub things: Vec<Thing>,
    /// Seed of the noise.
    pub seed: u64,
}

/// What a robot made of a room.
#[derive(Debug, Clone)]
pub struct Look {
    /// The points; of a level fan its reflectors, all of them obstacles, with no height and no covariance.
    pub cloud: PointCloud,
    /// How long imaging took.
    pub imaging_ms: f64,
    /// How long finding and sorting the points took.
    pub finding_ms: f64,
}

/// Sums over rooms.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SpaceScore {
    /// Rooms.
    pub rooms: usize,
    /// Things there, and found, by class.
    pub there: [usize; 4],
    /// Of these, found.
    pub found: [usize; 4],
    /// Found things by true and by told class.
    pub confusion: [[usize; 4]; 4],
    /// Points that are no thing.
    pub ghosts: usize,
    /// Of all points called obstacles, those that are none.
    pub false_obstacles: usize,
    /// Sums of squared errors of found things that are not straight above or below: range (m), azimuth and elevation (rad).
    pub squared: [f64; 3],
    /// Sum of squared errors over their covariance, of the same; 3 each if that is honest.
    pub nees: f64,
    /// How many these are.
    pub measured: usize,
    /// Sums of the times.
    pub imaging_ms: f64,
    /// Finding.
    pub finding_ms: f64,
}

/// A robot at work.
pub struct Looker {
    config: Config,
    setup: SensingSetup,
}

impl Looker {
    /// The front sensor of `config`, with the height band of the rooms.
    ///
    /// # Errors
    /// What the configuration asks for and cannot be.
    pub fn new(mut config: Config) -> Result<Self, ServiceError> {
        config.sensor.truncate(1);
        config.platform.z_m = Some(BAND_M);
        Ok(Self { setup: wiring::sensing(&config)?, config })
    }

    /// Number of directions.
    #[must_use]
    pub fn direction_count(&self) -> usize {
        self.setup.plan.grid.direction_count()
    }

    /// Whether it sees no heights.
    #[must_use]
    pub fn is_level(&self) -> bool {
        self.setup.plan.grid.is_horizontal()
    }

    /// Where its sensor is.
    #[must_use]
    pub fn sensor_m(&self) -> Vector2<f64> {
        self.setup.sensors[0].mount.position_m()
    }

    /// Looks at rooms, one after the other; `done` is told how many it has seen.
    ///
    /// # Errors
    /// When there is no backend or a ping set cannot be imaged.
    pub fn look(&self, rooms: &[Room], prefer: Prefer, done: &mut dyn FnMut()) -> Result<Vec<Look>, ServiceError> {
        let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
        let plan = Arc::clone(&self.setup.plan);
        let mut imager = Imager::open(plan, Arc::new(MaskTable::default()), prefer, options)?;
        let detector = scanning::space(&self.config, &self.setup);
        let mut looks = Vec::with_capacity(rooms.len());
        for room in rooms {
            // Every room has a floor and a ceiling of its own.
            looks.push(self.look_at(room, &mut imager, detector.clone())?);
            done();
        }
        Ok(looks)
    }

    fn look_at(
        &self,
        room: &Room,
        imager: &mut Imager,
        mut detector: Option<SpaceDetector>,
    ) -> Result<Look, ServiceError> {
        let acoustics = SimParams::default();
        let mut simulator = simulator(&self.config, &self.setup, room.world.clone(), acoustics, room.seed)?;
        simulator.set_pose(Pose2::default());
        let mut pings = simulator.empty_ping_set();
        let mut fan = scanning::reflector_finders(&self.config, &self.setup).swap_remove(0);
        let mut look = Look { cloud: PointCloud::empty(), imaging_ms: 0.0, finding_ms: 0.0 };
        for ping in 1..=PINGS {
            simulator.ping_set(Stamp { boottime_ns: ping, wall_ns: 0 }, &mut pings);
            let since = Instant::now();
            let image = imager.image(&pings)?;
            look.imaging_ms = 1e3 * since.elapsed().as_secs_f64();
            let cells = &image.energyscapes[0].values;
            let since = Instant::now();
            match &mut detector {
                Some(detector) => {
                    detector.hear(0, ping, pings.emitted_at, cells);
                    detector.update(&mut look.cloud);
                }
                None => {
                    let mut found = Vec::with_capacity(REFLECTORS_MAX);
                    fan.find(cells, &mut found);
                    look.cloud.points = found.iter().map(|reflector| self.in_plane(reflector)).collect();
                }
            }
            look.finding_ms = 1e3 * since.elapsed().as_secs_f64();
        }
        Ok(look)
    }

    fn in_plane(&self, reflector: &Reflector) -> SpacePoint {
        let place_m = Vector2::new(reflector.bearing_rad.cos(), reflector.bearing_rad.sin()) * reflector.range_m;
        let place_m = self.setup.sensors[0].mount.pose().parent_from_local(place_m);
        SpacePoint {
            position_m: Vector3::new(place_m.x, place_m.y, 0.0),
            covariance_m2: Matrix3::zeros(),
            energy: reflector.energy,
            sensor_index: 0,
            class: SpaceClass::Obstacle,
        }
    }
}

/// A room drawn by `seed`: floor, ceiling, and things at random places in front of a sensor at `sensor_m` that looks forward: a ball and
/// a sill on the floor, two balls and a bar at the robot's height, a bar and a ball overhead.
#[must_use]
pub fn room(seed: u64, sensor_m: Vector2<f64>) -> Room {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(9);
    let eye_m = Vector3::new(sensor_m.x, sensor_m.y, 0.0);
    let mut room = Room {
        world: World { floor_m: Some(FLOOR_M), ceiling_m: Some(CEILING_M), ..World::default() },
        things: vec![
            Thing { place_m: Vector3::new(eye_m.x, eye_m.y, FLOOR_M), class: SpaceClass::Floor },
            Thing { place_m: Vector3::new(eye_m.x, eye_m.y, CEILING_M), class: SpaceClass::Ceiling },
        ],
        seed,
    };
    let between = |low: f64, high: f64, random: &mut ChaCha8Rng| low + (high - low) * random.random::<f64>();
    let heights = [[-0.36, -0.36], [-0.2, 0.2], [-0.2, 0.2], [0.5, 1.1]];
    for (index, [low_m, high_m]) in heights.into_iter().enumerate() {
        let radius_m = if index == 0 { 0.04 } else { between(0.06, 0.12, &mut random) };
        room.try_place(&mut random, eye_m, |random| {
            let (range_m, bearing_rad) = (between(0.7, 2.4, random), between(-0.9, 0.9, random));
            let centre = [
                eye_m.x + range_m * bearing_rad.cos(),
                eye_m.y + range_m * bearing_rad.sin(),
                between(low_m, high_m, random),
            ];
            Placed::Ball(Ball { centre, radius_m })
        });
    }
    for (z_m, radius_m) in [(-0.38, 0.02), (0.12, 0.025), (0.75, 0.03)] {
        room.try_place(&mut random, eye_m, |random| {
            let (x_m, turn_m) = (between(1.0, 2.4, random), between(-0.3, 0.3, random));
            Placed::Bar(Bar { from: [x_m - turn_m, -1.2, z_m], to: [x_m + turn_m, 1.2, z_m], radius_m })
        });
    }
    room
}

enum Placed {
    Ball(Ball),
    Bar(Bar),
}

impl Placed {
    /// The place of its surface that is nearest to `eye_m`.
    fn nearest_m(&self, eye_m: Vector3<f64>) -> Vector3<f64> {
        let (axis_m, radius_m) = match self {
            Self::Ball(ball) => (Vector3::from(ball.centre), ball.radius_m),
            Self::Bar(bar) => {
                let (from_m, to_m) = (Vector3::from(bar.from), Vector3::from(bar.to));
                let along = to_m - from_m;
                let share = ((eye_m - from_m).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                (from_m + along * share, bar.radius_m)
            }
        };
        axis_m + (eye_m - axis_m).normalize() * radius_m
    }
}

impl Room {
    fn try_place(
        &mut self,
        random: &mut ChaCha8Rng,
        eye_m: Vector3<f64>,
        mut draw: impl FnMut(&mut ChaCha8Rng) -> Placed,
    ) {
        for _ in 0..TRIES {
            let placed = draw(random);
            let place_m = placed.nearest_m(eye_m);
            let range_m = (place_m - eye_m).norm();
            let crowded = self.things.iter().any(|thing| ((thing.place_m - eye_m).norm() - range_m).abs() < APART_M);
            if crowded || !(0.5..2.6).contains(&range_m) {
                continue;
            }
            let class = match place_m.z {
                z_m if z_m < BAND_M[0] => SpaceClass::Floor,
                z_m if z_m > BAND_M[1] => SpaceClass::Overhang,
                _ => SpaceClass::Obstacle,
            };
            self.things.push(Thing { place_m, class });
            match placed {
                Placed::Ball(ball) => self.world.balls.push(ball),
                Placed::Bar(bar) => self.world.bars.push(bar),
            }
            return;
        }
    }
}

impl SpaceScore {
    /// Enters what a robot made of a room; of a robot that `is_level` only places in the plane are held against the truth.
    pub fn add(&mut self, room: &Room, look: &Look, sensor_m: Vector2<f64>, is_level: bool) {
        self.rooms += 1;
        self.imaging_ms += look.imaging_ms;
        self.finding_ms += look.finding_ms;
        let flat = |place_m: Vector3<f64>| if is_level { Vector3::new(place_m.x, place_m.y, 0.0) } else { place_m };
        let mut taken = vec![false; look.cloud.points.len()];
        for thing in &room.things {
            self.there[thing.class as usize] += 1;
            // A level fan is asked for obstacles only: it says nothing of the rest.
            let apart_m = |point: &SpacePoint| apart_m(point, flat(thing.place_m));
            let free = look.cloud.points.iter().enumerate().filter(|(index, _)| !taken[*index]);
            let nearest = free.min_by(|a, b| apart_m(a.1).total_cmp(&apart_m(b.1)));
            let asked = !is_level || thing.class == SpaceClass::Obstacle;
            let Some((index, point)) = nearest.filter(|(_, point)| asked && apart_m(point) < GATE_M) else { continue };
            taken[index] = true;
            self.found[thing.class as usize] += 1;
            self.confusion[thing.class as usize][point.class as usize] += 1;
            self.false_obstacles +=
                usize::from(point.class == SpaceClass::Obstacle && thing.class != SpaceClass::Obstacle);
            self.measure(thing, point, sensor_m, is_level);
        }
        for (point, _) in look.cloud.points.iter().zip(&taken).filter(|(_, taken)| !**taken) {
            self.ghosts += 1;
            self.false_obstacles += usize::from(point.class == SpaceClass::Obstacle);
        }
    }

    fn measure(&mut self, thing: &Thing, point: &SpacePoint, sensor_m: Vector2<f64>, is_level: bool) {
        let eye_m = Vector3::new(sensor_m.x, sensor_m.y, 0.0);
        let (truth, told) = (thing.place_m - eye_m, point.position_m - eye_m);
        // Straight up and down there is no azimuth.
        if is_level || truth.xy().norm() < 0.1 {
            return;
        }
        let angles = |place: Vector3<f64>| (place.y.atan2(place.x), place.z.atan2(place.xy().norm()));
        let ((azimuth, elevation), (told_azimuth, told_elevation)) = (angles(truth), angles(told));
        self.squared[0] += (truth.norm() - told.norm()).powi(2);
        self.squared[1] += (azimuth - told_azimuth).powi(2);
        self.squared[2] += (elevation - told_elevation).powi(2);
        let error = told - truth;
        if let Some(inverse) = point.covariance_m2.try_inverse() {
            self.nees += error.dot(&(inverse * error));
            self.measured += 1;
        }
    }

    /// Root mean square errors of range (m), azimuth and elevation (rad); `None` without any.
    #[must_use]
    pub fn rms(&self) -> Option<[f64; 3]> {
        (self.measured > 0).then(|| self.squared.map(|sum| (sum / self.measured as f64).sqrt()))
    }

    /// Mean squared error over the covariance, 3 if that is honest.
    #[must_use]
    pub fn mean_nees(&self) -> Option<f64> {
        (self.measured > 0).then(|| self.nees / self.measured as f64)
    }
}

/// Distance of a point from a place; straight below and above, where an upright array hardly tells which way is forward, in height.
fn apart_m(point: &SpacePoint, place_m: Vector3<f64>) -> f64 {
    let offset_m = point.position_m - place_m;
    if point.covariance_m2.m11 > GATE_M.powi(2) / 9.0 { offset_m.yz().norm() } else { offset_m.norm() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_are_full_of_things_of_every_class_and_drawn_by_their_seed() {
        let sensor_m = Vector2::new(0.15, 0.0);
        let mut classes = [0; 4];
        for seed in 1..30 {
            let drawn = room(seed, sensor_m);
            assert!(drawn.things.len() >= 7, "{seed}: {}", drawn.things.len());
            assert_eq!(drawn.things, room(seed, sensor_m).things);
            assert!(drawn.world.validate().is_ok());
            drawn.things.iter().for_each(|thing| classes[thing.class as usize] += 1);
        }
        assert!(classes.iter().all(|count| *count >= 29), "{classes:?}");
    }

    #[test]
    fn a_point_where_there_is_nothing_is_a_ghost_and_one_of_the_wrong_class_a_false_obstacle() {
        let thing = Thing { place_m: Vector3::new(1.0, 0.0, 0.9), class: SpaceClass::Overhang };
        let room = Room { world: World::default(), things: vec![thing], seed: 1 };
        let mut look = Look { cloud: PointCloud::empty(), imaging_ms: 0.0, finding_ms: 0.0 };
        let at = |x_m: f64, z_m: f64, class| SpacePoint {
            position_m: Vector3::new(x_m, 0.0, z_m),
            covariance_m2: Matrix3::identity() * 1e-4,
            class,
            ..SpacePoint::default()
        };
        look.cloud.points = vec![at(1.0, 0.91, SpaceClass::Overhang), at(2.0, 0.0, SpaceClass::Obstacle)];
        let mut score = SpaceScore::default();
        score.add(&room, &look, Vector2::zeros(), false);
        assert_eq!((score.found[2], score.ghosts, score.false_obstacles), (1, 1, 1));
        assert!((score.mean_nees().unwrap() - 1.0).abs() < 1e-9);
        // A level fan puts the same bar into the plane, in the way: what it says of it is false.
        look.cloud.points = vec![at(1.0, 0.0, SpaceClass::Obstacle)];
        let mut score = SpaceScore::default();
        score.add(&room, &look, Vector2::zeros(), true);
        assert_eq!((score.found, score.false_obstacles), ([0; 4], 1));
    }
}
