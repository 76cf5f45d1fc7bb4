//! Where emission plans are tried: rooms from the fixtures, a corner, and another robot that looks this way.
//!
//! In: a configuration that follows a plan. Out: [`Scene`]s, each drawn by its own seed: a world, a place, the acoustics. Makes no sound.

use crate::config::Config;
use crate::geometry::Pose2;
use crate::sensor::dead_zone::HOUSING_DEPTH_M;
use crate::sensor::{EmissionPlan, MountParams, SensorParams};
use crate::service::ServiceError;
use crate::service::{simulator, wiring};
use crate::sim::{Outline, Pillar, SimParams, Wall, World};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::path::Path;

/// A room under a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Room {
    /// For tables.
    pub name: &'static str,
    text: &'static str,
}

/// The rooms that plans are tried in.
pub const ROOMS: [Room; 4] = [
    Room { name: "corridor", text: include_str!("../../../fixtures/worlds/corridor.toml") },
    Room { name: "t-junction", text: include_str!("../../../fixtures/worlds/t_junction.toml") },
    Room { name: "apartment", text: include_str!("../../../fixtures/worlds/apartment.toml") },
    Room { name: "warehouse", text: include_str!("../../../fixtures/worlds/warehouse.toml") },
];

/// Gap to whatever stands there at a place that is drawn, and how far from the way through the room it lies at most.
const GAP_MIN_M: f64 = 0.1;
const ASIDE_MAX_M: f64 = 0.6;
/// Places drawn before a room counts as full.
const TRIES: usize = 1000;
/// Bearings of the sensors that all look ahead.
const FAN_DEG: f64 = 40.0;
/// Where another robot stands, by how much it looks past this one, when it fires, and its radius.
const OTHER_M: [f64; 2] = [1.5, 4.5];
const OTHER_BEARING_DEG: f64 = 25.0;
const OTHER_YAW_DEG: f64 = 20.0;
const OTHER_LATE_S: f64 = 0.025;
const OTHER_RADIUS_M: f64 = 0.2;
/// Between the back of its sensor and its body.
const OTHER_GAP_M: f64 = 0.02;

/// Where the robot stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// Here.
    At(Pose2),
    /// Where the world has it start.
    AtStart,
}

/// One ping set to be heard.
#[derive(Debug, Clone)]
pub struct Scene {
    /// For pictures.
    pub name: &'static str,
    pub(super) config: Config,
    pub(super) world: World,
    pub(super) place: Place,
    pub(super) seed: u64,
    /// How late each sensor fires.
    late_s: [f64; 3],
    /// The first so many sensors are judged; what comes behind belongs to somebody else.
    pub(super) judged: usize,
}

impl Scene {
    /// The acoustics of the scene, with or without the others' sound.
    pub(super) fn acoustics(&self, cross_talk: bool) -> SimParams {
        SimParams { cross_talk, multipath: true, sync_offsets_s: self.late_s, ..SimParams::default() }
    }

    fn pose(&self) -> Pose2 {
        match self.place {
            Place::At(pose) => pose,
            Place::AtStart => Pose2::default(),
        }
    }
}

/// The same robot with three sensors that all look ahead, so that their fields of view overlap.
#[must_use]
pub fn fan(config: &Config) -> Config {
    let mut config = config.clone();
    let count = config.sensor.len();
    for (index, sensor) in config.sensor.iter_mut().enumerate() {
        let bearing_deg = FAN_DEG * (index as f64 - 0.5 * (count - 1) as f64);
        sensor.mount = MountParams { distance_m: config.platform.radius_m, bearing_deg, yaw_deg: 0.0 };
    }
    config
}

/// `places` places of every room, the same for every plan and robot.
///
/// # Errors
/// When a room cannot be read, or leaves no place free.
pub fn rooms(config: &Config, places: usize) -> Result<Vec<Scene>, ServiceError> {
    let mut scenes = Vec::new();
    let setup = wiring::sensing(config)?;
    for (index, room) in ROOMS.iter().enumerate() {
        let world = World::parse(Path::new(room.name), room.text)
            .map_err(|error| ServiceError::Internal(format!("{}: {error}", room.name)))?;
        let mut probe = simulator(config, &setup, world.clone(), SimParams::default(), 1)?;
        let mut random = ChaCha8Rng::seed_from_u64(index as u64);
        for place in 0..places {
            let mut free = (0..TRIES).map(|_| drawn(&world, &mut random)).filter(|pose| {
                probe.set_pose(*pose);
                probe.clearance_m() > GAP_MIN_M
            });
            let pose = free.next().ok_or_else(|| ServiceError::Internal(format!("no place in {}", room.name)))?;
            scenes.push(Scene {
                name: room.name,
                config: config.clone(),
                world: world.clone(),
                place: Place::At(pose),
                seed: (1000 * index + place) as u64,
                late_s: [0.0; 3],
                judged: config.sensor.len(),
            });
        }
    }
    Ok(scenes)
}

/// A place beside the way from the start through the waypoints, any heading.
fn drawn(world: &World, random: &mut ChaCha8Rng) -> Pose2 {
    let start = &world.start;
    let first = Vector2::new(start.corner[0] + 0.5 * start.size[0], start.corner[1] + 0.5 * start.size[1]);
    let points: Vec<Vector2<f64>> =
        std::iter::once(first).chain(world.waypoints.iter().map(|point| Vector2::from(*point))).collect();
    let legs: Vec<&[Vector2<f64>]> = points.windows(2).collect();
    let mut unit = || random.random::<f64>();
    let on_way = match legs.as_slice() {
        [] => first,
        legs => {
            let leg = legs[((unit() * legs.len() as f64) as usize).min(legs.len() - 1)];
            leg[0] + (leg[1] - leg[0]) * unit()
        }
    };
    let mut aside = || ASIDE_MAX_M * (2.0 * unit() - 1.0);
    let at = on_way + Vector2::new(aside(), aside());
    Pose2 { x_m: at.x, y_m: at.y, heading_rad: std::f64::consts::TAU * random.random::<f64>() }
}

/// `count` scenes in a hall: before the robot, whose first sensor is judged, stands another one that fires when it likes. With sweeps
/// of their own the other one sends the second sensor's.
#[must_use]
pub fn facing(config: &Config, count: usize) -> Vec<Scene> {
    (0..count as u64).map(|seed| face_to_face(config, seed)).collect()
}

fn face_to_face(config: &Config, seed: u64) -> Scene {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(3);
    let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let distance_m = between(OTHER_M[0], OTHER_M[1]);
    let bearing_deg = between(-OTHER_BEARING_DEG, OTHER_BEARING_DEG);
    let yaw_deg = 180.0 + between(-OTHER_YAW_DEG, OTHER_YAW_DEG);
    let late_s = between(-OTHER_LATE_S, OTHER_LATE_S);
    let mut config = config.clone();
    config.emission.plan = EmissionPlan::Together;
    config.obstruction.clear();
    let own = SensorParams {
        mount: MountParams { distance_m: config.platform.radius_m, ..MountParams::default() },
        ..config.sensor[0].clone()
    };
    let others = MountParams { distance_m, bearing_deg, yaw_deg };
    // In a plan of three the band is cut in three, whoever sends the parts.
    let sweeps: Vec<_> = (0..config.sensor.len()).map(|index| config.emission_of(index)).collect();
    let other = SensorParams { name: "other".to_owned(), mount: others, ..own.clone() };
    config.sensor = vec![own, other];
    for (sensor, sweep) in config.sensor.iter_mut().zip(sweeps) {
        sensor.emission = Some(super::whole(&sweep));
    }
    let (sin, cos) = bearing_deg.to_radians().sin_cos();
    // Its body begins just behind its sensor.
    let body_m = distance_m + OTHER_RADIUS_M + HOUSING_DEPTH_M + OTHER_GAP_M;
    let pillar = Pillar { centre: [body_m * cos, body_m * sin], radius_m: OTHER_RADIUS_M };
    let hall = Wall { points: vec![[-3.0, -4.0], [8.0, -4.0], [8.0, 4.0], [-3.0, 4.0]], closed: true };
    let world = World { walls: vec![hall], pillars: vec![pillar], ..World::default() };
    let late_s = [0.0, late_s, 0.0];
    Scene { name: "another robot", config, world, place: Place::AtStart, seed, late_s, judged: 1 }
}

/// How far it is from a sensor to whatever stands in a direction; infinite where nothing does.
pub(super) fn free_way_m(scene: &Scene, sensor: usize, bearing_rad: f64) -> f64 {
    let mount = &scene.config.sensor[sensor].mount;
    let bearing = mount.bearing_deg.to_radians();
    let mounted = Pose2 {
        x_m: mount.distance_m * bearing.cos(),
        y_m: mount.distance_m * bearing.sin(),
        heading_rad: bearing + mount.yaw_deg.to_radians(),
    };
    let pose = scene.pose().compose(&mounted);
    let (sin, cos) = (pose.heading_rad + bearing_rad).sin_cos();
    let (from_m, along) = (pose.position_m(), Vector2::new(cos, sin));
    let ways_m = scene.world.outline(0.0).filter_map(|outline| match outline {
        Outline::Segment { from_m: start_m, to_m } => to_segment_m(from_m, along, start_m, to_m),
        Outline::Circle { centre_m, radius_m, .. } => to_circle_m(from_m, along, centre_m, radius_m),
    });
    ways_m.fold(f64::INFINITY, f64::min)
}

fn to_segment_m(from_m: Vector2<f64>, along: Vector2<f64>, start_m: Vector2<f64>, end_m: Vector2<f64>) -> Option<f64> {
    let (piece, to_start) = (end_m - start_m, start_m - from_m);
    let scale = along.perp(&piece);
    let (way_m, share) = (to_start.perp(&piece) / scale, to_start.perp(&along) / scale);
    (way_m > 0.0 && (0.0..=1.0).contains(&share)).then_some(way_m)
}

fn to_circle_m(from_m: Vector2<f64>, along: Vector2<f64>, centre_m: Vector2<f64>, radius_m: f64) -> Option<f64> {
    let to_centre = centre_m - from_m;
    let ahead_m = to_centre.dot(&along);
    let square_m2 = radius_m * radius_m - to_centre.perp(&along).powi(2);
    (square_m2 >= 0.0 && ahead_m > 0.0).then(|| ahead_m - square_m2.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_free_way_ends_at_the_wall_or_the_pillar_that_is_nearer() {
        let mut scene = face_to_face(&Config::default(), 1);
        scene.world.pillars[0].centre = [3.0, 0.0];
        let ahead_m = free_way_m(&scene, 0, 0.0);
        let radius_m = scene.config.platform.radius_m;
        assert!((ahead_m - (3.0 - OTHER_RADIUS_M - radius_m)).abs() < 1e-9, "{ahead_m}");
        let left_m = free_way_m(&scene, 0, std::f64::consts::FRAC_PI_2);
        assert!((left_m - 4.0).abs() < 1e-9, "{left_m}");
        // Beside the pillar it is the hall's end.
        let past_m = free_way_m(&scene, 0, 0.1);
        assert!((past_m - (8.0 - radius_m) / 0.1_f64.cos()).abs() < 1e-9, "{past_m}");
    }
}
