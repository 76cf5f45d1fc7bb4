//! Reflectors by plain geometry: where points, walls and pillars are heard, with homogeneous transforms and no formula of the flow field.

use nalgebra::{Matrix3, Vector2, Vector3};
use noctule::detect::reflectors::Reflector;
use noctule::sensor::Mount;
use noctule::signal::Velocity;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Something that reflects.
#[derive(Debug, Clone, Copy)]
pub enum Thing {
    /// An edge or a corner.
    Point(Vector2<f64>),
    /// A wall: all x with normal . x = offset.
    Wall(Vector2<f64>, f64),
    /// A pillar: middle, radius, velocity.
    Pillar(Vector2<f64>, f64, Vector2<f64>),
}

/// Transform of a frame at (x, y), turned by `heading`, into its parent.
pub fn frame(x: f64, y: f64, heading: f64) -> Matrix3<f64> {
    let (s, c) = heading.sin_cos();
    Matrix3::new(c, -s, x, s, c, y, 0.0, 0.0, 1.0)
}

/// World from robot after a time at a constant velocity.
pub fn driven(velocity: Velocity, time_s: f64) -> Matrix3<f64> {
    let (v, w) = (velocity.linear_m_s, velocity.angular_rad_s);
    let turned = w * time_s;
    if w.abs() < 1e-9 {
        return frame(v * time_s, 0.0, turned);
    }
    frame(v / w * turned.sin(), v / w * 2.0 * (0.5 * turned).sin().powi(2), turned)
}

pub fn robot_from_sensor(mount: &Mount) -> Matrix3<f64> {
    frame(0.0, 0.0, mount.bearing_rad) * frame(mount.distance_m, 0.0, 0.0) * frame(0.0, 0.0, mount.yaw_rad)
}

impl Thing {
    /// Range and bearing at which a sensor hears it: the place of it that is nearest to the sensor.
    pub fn heard(&self, world_from_sensor: &Matrix3<f64>, time_s: f64) -> (f64, f64) {
        let sensor = Vector2::new(world_from_sensor.m13, world_from_sensor.m23);
        let place = match self {
            Thing::Point(at) => *at,
            Thing::Wall(normal, offset) => sensor + normal * (offset - normal.dot(&sensor)),
            Thing::Pillar(middle, radius_m, velocity) => {
                let middle = middle + velocity * time_s;
                middle + (sensor - middle).normalize() * *radius_m
            }
        };
        let local = world_from_sensor.try_inverse().expect("rigid") * Vector3::new(place.x, place.y, 1.0);
        (local.x.hypot(local.y), local.y.atan2(local.x))
    }
}

/// A number of mean 0 and standard deviation 1.
pub fn noise(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// What a sensor on a robot at `world_from_robot` hears of `things`, with noise as it is told.
pub fn reflectors(
    things: &[Thing],
    mount: &Mount,
    world_from_robot: &Matrix3<f64>,
    time_s: f64,
    random: &mut ChaCha8Rng,
) -> Vec<Reflector> {
    let sensor = world_from_robot * robot_from_sensor(mount);
    let mut found = Vec::new();
    for (index, thing) in things.iter().enumerate() {
        let (range_m, bearing_rad) = thing.heard(&sensor, time_s);
        let (range_sigma_m, bearing_sigma_rad) = (0.0006, 0.002);
        if (0.3..5.0).contains(&range_m) && bearing_rad.abs() < 1.4 {
            found.push(Reflector {
                range_m: range_m + range_sigma_m * noise(random),
                bearing_rad: bearing_rad + bearing_sigma_rad * noise(random),
                range_sigma_m,
                bearing_sigma_rad,
                // Amplitudes tell things apart; the place matters more.
                energy: 0.05 / range_m as f32 * (1.0 + 0.05 * (index % 5) as f32),
            });
        }
    }
    found
}
