//! The robot as the page draws it: footprint, sensors, what they cannot see, control regions and thresholds.
//!
//! Goes in: the configuration that the daemon uses. Comes out: what every reader of the page is told once, as JSON. Outlines are
//! polygons, so that whoever draws needs no geometry. Never reads a topic.

use crate::config::Config;
use crate::control::params::EnergyParams;
use crate::control::{ControlParams, PlatformLimits};
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::geometry::shape::Shape;
use crate::parameter::ParameterError;
use crate::sensor::SensorSetup;
use crate::signal::{Direction, LayerName};
use serde::Serialize;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// How far a region without an end is drawn.
const FAR_M: f64 = 50.0;
/// Angle between the corners of a drawn arc.
const ARC_STEP_DEG: f64 = 4.0;

/// A sensor.
#[derive(Debug, Clone, Serialize)]
pub struct Sensor {
    /// Its name in the configuration.
    pub name: String,
    /// Place in the robot frame.
    pub x_m: f64,
    /// Place in the robot frame.
    pub y_m: f64,
    /// Heading of its boresight in the robot frame.
    pub heading_rad: f64,
    /// Of each direction: whether something on the robot hides it.
    #[serde(skip)]
    pub hidden: Vec<bool>,
}

/// A layer's regions as closed outlines in the robot frame.
#[derive(Debug, Clone, Serialize)]
pub struct Region {
    /// The layer.
    pub layer: &'static str,
    /// Corners of each outline, `[x, y]`.
    pub outlines_m: Vec<Vec<[f64; 2]>>,
}

/// All of it.
#[derive(Debug, Clone)]
pub struct Robot {
    /// The sensors in the order of the configuration.
    pub sensors: Vec<Sensor>,
    /// The directions of interest, which all sensors share.
    pub directions: Vec<Direction>,
    /// Farthest range that is imaged.
    pub range_max_m: f64,
    /// Time between ping sets.
    pub period_s: f64,
    /// What counts as an echo.
    pub energy: EnergyParams,
    /// The sensors as they stand on the robot.
    pub setups: Vec<SensorSetup>,
    platform: PlatformLimits,
    regions: Vec<Region>,
    flow_lines: Vec<FlowLinesRegion>,
    command_max_age_ms: f64,
}

impl Robot {
    /// The robot of a configuration.
    ///
    /// # Errors
    /// What is wrong with its sensors or directions.
    pub fn new(config: &Config) -> Result<Self, ParameterError> {
        let setups = config.sensor_setups()?;
        let directions = config.directions()?;
        let zones = config.dead_zones(&setups, &directions);
        let sensor = |(setup, zone): (&SensorSetup, crate::sensor::DeadZone)| {
            let pose = setup.mount.pose();
            Sensor {
                name: setup.name.clone(),
                x_m: pose.x_m,
                y_m: pose.y_m,
                heading_rad: pose.heading_rad,
                hidden: zone.hidden,
            }
        };
        let flow = &config.control.flow_following;
        let sensors = setups.iter().zip(zones).map(sensor).collect();
        Ok(Self {
            sensors,
            directions,
            range_max_m: config.imaging.range_max_m,
            period_s: 1.0 / config.control.rate_hz,
            energy: config.control.energy.clone(),
            setups,
            platform: config.platform,
            regions: regions(&config.control),
            flow_lines: if flow.enabled { flow.regions.clone() } else { Vec::new() },
            command_max_age_ms: config.safety.max_age_ms,
        })
    }

    /// Names of the sensors, in the order of the configuration.
    #[must_use]
    pub fn sensor_names(&self) -> Vec<String> {
        self.sensors.iter().map(|sensor| sensor.name.clone()).collect()
    }

    /// The name of a sensor by its number on the wire.
    #[must_use]
    pub fn sensor_name(&self, number: u32) -> Option<&str> {
        self.sensors.get(number as usize).map(|sensor| sensor.name.as_str())
    }

    /// Fastest that the platform may drive.
    #[must_use]
    pub fn max_linear_m_s(&self) -> f64 {
        self.platform.max_linear_m_s
    }

    /// What the page is told of it.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "radius_m": self.platform.radius_m,
            "max_linear_m_s": self.platform.max_linear_m_s,
            "max_angular_rad_s": self.platform.max_angular_rad_s,
            "range_max_m": self.range_max_m,
            "command_max_age_ms": self.command_max_age_ms,
            "sensors": self.sensors,
            "regions": self.regions,
            "flow_lines": self.flow_lines,
            "layers": LayerName::ALL.map(LayerName::as_str),
        })
    }
}

fn regions(control: &ControlParams) -> Vec<Region> {
    let (oa, rcf, ca) = (&control.obstacle_avoidance, &control.corridor_following, &control.collision_avoidance);
    // The lowest priority lies lowest.
    [
        (LayerName::CorridorFollowing, rcf.enabled, &rcf.regions),
        (LayerName::ObstacleAvoidance, oa.enabled, &oa.regions),
        (LayerName::CollisionAvoidance, ca.enabled, &ca.regions),
    ]
    .into_iter()
    .filter(|(_, enabled, _)| *enabled)
    .map(|(layer, _, shapes)| Region { layer: layer.as_str(), outlines_m: shapes.iter().map(outline_m).collect() })
    .collect()
}

/// Corners of a shape's outline in order; arcs in steps of some degrees, endless sides cut far away.
#[must_use]
pub fn outline_m(shape: &Shape) -> Vec<[f64; 2]> {
    let arc = |centre: &[f64; 2], radius_m: f64, from_deg: f64, span_deg: f64| -> Vec<[f64; 2]> {
        let steps = (span_deg.abs() / ARC_STEP_DEG).ceil().max(1.0) as usize;
        let point = |index: usize| {
            let angle = (from_deg + span_deg * index as f64 / steps as f64) * PI / 180.0;
            [centre[0] + radius_m * angle.cos(), centre[1] + radius_m * angle.sin()]
        };
        (0..=steps).map(point).collect()
    };
    let near = |value: f64| value.clamp(-FAR_M, FAR_M);
    match shape {
        Shape::Rectangle { x_m, y_m } => {
            let ([back, front], [right, left]) = (x_m.map(near), y_m.map(near));
            vec![[back, right], [front, right], [front, left], [back, left]]
        }
        Shape::Circle { centre_m, radius_m } => arc(centre_m, *radius_m, 0.0, 360.0),
        Shape::HalfCircle { centre_m, radius_m, heading_deg } => arc(centre_m, *radius_m, heading_deg - 90.0, 180.0),
        Shape::Sector { centre_m, radius_m, bearing_deg } => {
            let turn = (bearing_deg[1] - bearing_deg[0]).rem_euclid(360.0);
            let span_deg = if turn == 0.0 && bearing_deg[0] != bearing_deg[1] { 360.0 } else { turn };
            let mut corners = arc(centre_m, radius_m[1], bearing_deg[0], span_deg);
            corners.extend(arc(centre_m, radius_m[0], bearing_deg[0] + span_deg, -span_deg));
            corners
        }
        Shape::Trapezoid { x_m, half_width_m: [first, last] } => {
            vec![[x_m[0], -first], [x_m[1], -last], [x_m[1], *last], [x_m[0], *first]]
        }
        Shape::Polygon { points_m } => points_m.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// Even-odd test, written out here: shares nothing with the outline's making.
    fn inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
        let mut odd = false;
        for (index, a) in corners.iter().enumerate() {
            let b = corners[(index + 1) % corners.len()];
            if (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
                odd = !odd;
            }
        }
        odd
    }

    #[test]
    fn outlines_hold_what_the_shapes_hold() {
        let shapes = [
            Shape::Rectangle { x_m: [0.0, 1.5], y_m: [-0.3, 0.4] },
            Shape::Rectangle { x_m: [0.2, f64::INFINITY], y_m: [-1.0, 1.0] },
            Shape::Circle { centre_m: [0.3, 0.1], radius_m: 0.8 },
            Shape::HalfCircle { centre_m: [0.0, 0.2], radius_m: 1.0, heading_deg: 40.0 },
            Shape::Sector { centre_m: [0.0, 0.0], radius_m: [0.4, 1.3], bearing_deg: [-50.0, 160.0] },
            Shape::Trapezoid { x_m: [0.1, 1.4], half_width_m: [0.2, 0.9] },
            Shape::Polygon { points_m: vec![[0.0, 0.0], [1.0, 0.2], [0.4, 1.0]] },
        ];
        for shape in &shapes {
            let corners = outline_m(shape);
            let points =
                (-40..=40).flat_map(|x| (-40..=40).map(move |y| [0.05 * x as f64 + 0.013, 0.05 * y as f64 + 0.017]));
            // What lies within a hand's breadth of the edge may go either way: arcs are drawn as chords.
            let wrong = points
                .filter(|&[x, y]| {
                    let point = Vector2::new(x, y);
                    let moved = |dx: f64, dy: f64| shape.contains(point + Vector2::new(dx, dy));
                    let sure = [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.02), (0.0, -0.02)];
                    let truth = shape.contains(point);
                    sure.iter().all(|(dx, dy)| moved(*dx, *dy) == truth) && inside(&corners, [x, y]) != truth
                })
                .count();
            assert_eq!(wrong, 0, "{shape:?}");
        }
    }

    #[test]
    fn the_built_in_robot_has_its_sensors_regions_and_dead_zones() {
        let robot = Robot::new(&Config::default()).expect("robot");
        assert_eq!(robot.sensor_names(), ["front", "left", "right"]);
        assert!(robot.sensors.iter().all(|sensor| sensor.hidden.len() == robot.directions.len()));
        let json = robot.json();
        assert_eq!(json["regions"].as_array().map(Vec::len), Some(3));
        assert_eq!(json["sensors"][1]["name"], "left");
        let mut config = Config::default();
        config.control.obstacle_avoidance.enabled = false;
        let json = Robot::new(&config).expect("robot").json();
        assert_eq!(json["regions"].as_array().map(Vec::len), Some(2), "a layer that is off has no region");
    }
}
