//! Bearings that other sensors' housings and configured obstructions hide from a sensor.
//!
//! Goes in: all sensors, the obstructions in the robot frame, the directions of interest. Comes out: which directions are
//! hidden, by what, and what is odd about the mounts. The robot's body hides nothing: sensors stand on its deck. A
//! housing is a rectangle whose front face is centred on the sensor's origin, since the microphones sit on that face; its
//! body lies behind it, against the sensor's heading. Everything reaches from floor to ceiling: only azimuth counts.

use super::SensorSetup;
use crate::geometry::shape::Shape;
use crate::signal::Direction;
use nalgebra::Vector2;

/// Width of a housing, across its heading.
pub const HOUSING_WIDTH_M: f64 = 0.116;
/// Depth of a housing, along its heading.
pub const HOUSING_DEPTH_M: f64 = 0.05;

/// What one sensor cannot see.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DeadZone {
    /// One entry a direction: whether it is hidden.
    pub hidden: Vec<bool>,
    /// One sentence for each thing that hides a direction: what, and which bearings.
    pub listed: Vec<String>,
    /// One sentence for each thing that makes no sense and was ignored, or that blinds the sensor.
    pub warnings: Vec<String>,
}

impl DeadZone {
    /// Number of hidden directions.
    #[must_use]
    pub fn hidden_count(&self) -> usize {
        self.hidden.iter().filter(|hidden| **hidden).count()
    }
}

/// The rectangle of a sensor's housing in its own frame.
#[must_use]
pub fn housing() -> Shape {
    let half_width_m = 0.5 * HOUSING_WIDTH_M;
    Shape::Rectangle { x_m: [-HOUSING_DEPTH_M, 0.0], y_m: [-half_width_m, half_width_m] }
}

/// What the housings of the other sensors and the `obstructions` (robot frame) hide from sensor `sensor_index`.
///
/// A direction is hidden when its horizontal ray from the sensor's origin meets one of them. A housing that contains the
/// origin is ignored with a warning; an obstruction that does hides everything, with a warning.
///
/// # Panics
/// If there is no such sensor.
#[must_use]
pub fn hidden_directions(
    sensors: &[SensorSetup],
    sensor_index: usize,
    obstructions: &[Shape],
    directions: &[Direction],
) -> DeadZone {
    let this = &sensors[sensor_index];
    let origin_m = this.mount.position_m();
    let mut zone = DeadZone { hidden: vec![false; directions.len()], ..DeadZone::default() };
    for other in sensors.iter().enumerate().filter(|(index, _)| *index != sensor_index).map(|(_, other)| other) {
        let (pose, shape) = (other.mount.pose(), housing());
        if shape.contains(pose.local_from_parent(origin_m)) {
            let warning =
                "the housing of sensor `{}` contains the origin of sensor `{}`: taken to hide nothing from it";
            zone.warnings.push(warning.replacen("{}", &other.name, 1).replacen("{}", &this.name, 1));
            continue;
        }
        let turn_rad = this.mount.heading_rad() - pose.heading_rad;
        let hits = rays_that_hit(&shape, pose.local_from_parent(origin_m), turn_rad, directions);
        zone.add(hits, &format!("the housing of sensor `{}`", other.name), &this.name, directions);
    }
    for (index, shape) in obstructions.iter().enumerate() {
        if shape.contains(origin_m) {
            let warning =
                format!("obstruction[{index}] contains the origin of sensor `{}`: it sees nothing", this.name);
            zone.warnings.push(warning);
        }
        let hits = rays_that_hit(shape, origin_m, this.mount.heading_rad(), directions);
        zone.add(hits, &format!("obstruction[{index}]"), &this.name, directions);
    }
    zone
}

/// Which directions, turned by `turn_rad` into the shape's frame, meet the shape.
fn rays_that_hit(shape: &Shape, origin_m: Vector2<f64>, turn_rad: f64, directions: &[Direction]) -> Vec<bool> {
    let hits = |direction: &Direction| {
        let (sin, cos) = (direction.azimuth_rad + turn_rad).sin_cos();
        shape.first_hit_m(origin_m, Vector2::new(cos, sin)).is_some()
    };
    directions.iter().map(hits).collect()
}

impl DeadZone {
    fn add(&mut self, hits: Vec<bool>, what: &str, sensor: &str, directions: &[Direction]) {
        let bearings_deg =
            || hits.iter().zip(directions).filter(|(hit, _)| **hit).map(|(_, d)| d.azimuth_rad.to_degrees());
        let count = bearings_deg().count();
        if count > 0 {
            let (first, last) = (bearings_deg().fold(f64::MAX, f64::min), bearings_deg().fold(f64::MIN, f64::max));
            let sentence = format!(
                "{what} hides {count} of {} directions from sensor `{sensor}`, bearings {first:.1} to {last:.1} deg",
                directions.len()
            );
            self.listed.push(sentence);
        }
        for (hidden, hit) in self.hidden.iter_mut().zip(hits) {
            *hidden |= hit;
        }
    }
}
