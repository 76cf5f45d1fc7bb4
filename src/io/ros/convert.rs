//! From what travels on our topics to the messages that ROS tools draw.
//!
//! Right to left: bearings of a scan rise counter-clockwise, whatever the order of the grid. A grid whose directions are not
//! equally spaced in the horizontal plane has no laser scan. Loses nothing that replay needs: that goes as it is.

use super::standard::{
    DiagnosticArray, DiagnosticStatus, Header, Image, KeyValue, LaserScan, MapMetaData, OccupancyGrid, Octets,
    PointCloud2, PointField, Pose, Quaternion, TFMessage, Time, Transform, TransformStamped, Twist, TwistStamped,
    Vector3,
};
use super::{BASE_FRAME, ODOMETRY_FRAME, sensor_frame};
use crate::geometry::Pose2;
use crate::io::wire::detections::{MAP_CELLS, Objects, Scan};
use crate::io::wire::fields_json;
use crate::io::wire::message::{Odometry, VelocityCommand};
use crate::io::wire::points::PointCloud3;
use crate::io::wire::telemetry::{Health, PlatformVelocity};
use crate::io::wire::{WireType, message::EnergyscapeHeader, message::FLAG_EQUAL_DIRECTIONS};
use crate::sensor::SensorSetup;
use crate::signal::{DaemonState, GateState, RangeScan, Reading, Velocity};
use crate::time::Stamp;

/// Levels of diagnostic_msgs/DiagnosticStatus.
const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;

/// A scan as sensor_msgs/LaserScan in its sensor's frame, `period_s` after the last; none for a grid without equal steps.
#[must_use]
pub fn laser_scan(scan: &RangeScan, sensor: &str, period_s: f64) -> Option<LaserScan> {
    let grid = EnergyscapeHeader::for_grid(&scan.grid, scan.sensor_index, 0.0);
    if grid.flags & FLAG_EQUAL_DIRECTIONS == 0 || scan.grid.direction_count() < 2 || grid.direction_step_rad == 0.0 {
        return None;
    }
    let steps = (scan.grid.direction_count() - 1) as f64;
    let last_rad = grid.direction_first_rad + steps * grid.direction_step_rad;
    let mut readings: Vec<(f32, f32)> = scan.readings.iter().copied().map(range_and_intensity).collect();
    if grid.direction_step_rad < 0.0 {
        readings.reverse();
    }
    Some(LaserScan {
        header: Header::new(scan.emitted_at.wall_ns, sensor_frame(sensor)),
        angle_min: grid.direction_first_rad.min(last_rad) as f32,
        angle_max: grid.direction_first_rad.max(last_rad) as f32,
        angle_increment: grid.direction_step_rad.abs() as f32,
        time_increment: 0.0,
        scan_time: period_s as f32,
        range_min: scan.grid.range_first_m() as f32,
        // The same in every scan: an echo in the last bin must not lie beyond it, and so half a bin is added.
        range_max: (scan.grid.range_m(scan.grid.range_count() - 1) + 0.5 * scan.grid.range_step_m()) as f32,
        ranges: readings.iter().map(|(range_m, _)| *range_m).collect(),
        intensities: readings.iter().map(|(_, energy)| *energy).collect(),
    })
}

fn range_and_intensity(reading: Reading) -> (f32, f32) {
    match reading {
        Reading::Unseen => (f32::NAN, 0.0),
        Reading::Clear => (f32::INFINITY, 0.0),
        Reading::Echo { range_m, energy } => (range_m as f32, energy),
    }
}

/// The scan of the whole robot as sensor_msgs/LaserScan in the robot's frame, `period_s` after the last.
#[must_use]
pub fn robot_laser_scan(scan: &Scan, period_s: f64) -> LaserScan {
    let last_rad = scan.bearing_first_rad + (scan.range_m.len() - 1) as f64 * scan.bearing_step_rad;
    LaserScan {
        header: Header::new(scan.t_wall_ns, BASE_FRAME),
        angle_min: scan.bearing_first_rad as f32,
        angle_max: last_rad as f32,
        angle_increment: scan.bearing_step_rad as f32,
        time_increment: 0.0,
        scan_time: period_s as f32,
        range_min: scan.range_min_m as f32,
        range_max: scan.range_max_m as f32,
        ranges: scan.range_m.to_vec(),
        intensities: scan.amplitude.to_vec(),
    }
}

/// The points in space as sensor_msgs/PointCloud2: x, y, z, intensity, and the class as a number.
#[must_use]
pub fn point_cloud(points: &PointCloud3) -> PointCloud2 {
    const FIELDS: [(&str, u8); 5] = [("x", 7), ("y", 7), ("z", 7), ("intensity", 7), ("class", 6)];
    let field = |(index, (name, datatype)): (usize, (&str, u8))| PointField {
        name: name.to_owned(),
        offset: 4 * index as u32,
        datatype,
        count: 1,
    };
    let count = (points.point_count as usize).min(points.x_m.len());
    let point_step = 4 * FIELDS.len() as u32;
    let bytes = |index: usize| {
        let place = [points.x_m[index], points.y_m[index], points.z_m[index], points.energy[index]];
        place.into_iter().map(f32::to_le_bytes).chain([points.class[index].to_le_bytes()]).flatten()
    };
    PointCloud2 {
        header: Header::new(points.t_wall_ns, BASE_FRAME),
        height: 1,
        width: count as u32,
        fields: FIELDS.into_iter().enumerate().map(field).collect(),
        is_bigendian: false,
        point_step,
        row_step: point_step * count as u32,
        data: (0..count).flat_map(bytes).collect(),
        is_dense: true,
    }
}

/// Frame of objects and map.
#[must_use]
pub fn objects_frame(objects: &Objects) -> &'static str {
    if objects.frame == 0 { ODOMETRY_FRAME } else { BASE_FRAME }
}

/// The occupancy map as nav_msgs/OccupancyGrid.
#[must_use]
pub fn occupancy_grid(objects: &Objects) -> OccupancyGrid {
    let corner_m = |middle_m: f64| middle_m - 0.5 * objects.cell_m;
    let corner = Vector3 { x: corner_m(objects.map_x_m), y: corner_m(objects.map_y_m), z: 0.0 };
    OccupancyGrid {
        header: Header::new(objects.t_wall_ns, objects_frame(objects)),
        info: MapMetaData {
            map_load_time: Time::from_wall_ns(objects.t_wall_ns),
            resolution: objects.cell_m as f32,
            width: MAP_CELLS as u32,
            height: MAP_CELLS as u32,
            origin: Pose { position: corner, orientation: Quaternion::from_yaw_rad(0.0) },
        },
        data: objects.map.iter().map(|cell| (*cell).clamp(-1, 100) as i8).collect(),
    }
}

/// An energyscape as sensor_msgs/Image, 32FC1: a row a direction, a column a range. `values` is row-major as `header` says.
#[must_use]
pub fn energyscape_image<'a>(header: &EnergyscapeHeader, values: &'a [f32], sensor: &str) -> Image<'a> {
    Image {
        header: Header::new(header.t_wall_ns, sensor_frame(sensor)),
        height: header.direction_count,
        width: header.range_count,
        encoding: "32FC1".to_owned(),
        is_bigendian: u8::from(cfg!(target_endian = "big")),
        step: header.range_count.saturating_mul(4),
        data: Octets(bytemuck::cast_slice(values)),
    }
}

/// Where the sensors stand: the transforms from each sensor's frame to the robot's.
#[must_use]
pub fn mount_transforms(sensors: &[SensorSetup], at: Stamp) -> TFMessage {
    let transform = |sensor: &SensorSetup| transform(at, BASE_FRAME, sensor_frame(&sensor.name), sensor.mount.pose());
    TFMessage { transforms: sensors.iter().map(transform).collect() }
}

/// Where the robot is, by odometry.
#[must_use]
pub fn odometry_transform(odometry: &Odometry) -> TFMessage {
    let at = Stamp { boottime_ns: odometry.t_monotonic_ns, wall_ns: odometry.t_wall_ns };
    TFMessage { transforms: vec![transform(at, ODOMETRY_FRAME, BASE_FRAME.to_owned(), odometry.pose())] }
}

fn transform(at: Stamp, parent: &str, child_frame_id: String, pose: Pose2) -> TransformStamped {
    TransformStamped {
        header: Header::new(at.wall_ns, parent),
        child_frame_id,
        transform: Transform {
            translation: Vector3 { x: pose.x_m, y: pose.y_m, z: 0.0 },
            rotation: Quaternion::from_yaw_rad(pose.heading_rad),
        },
    }
}

fn twist(wall_ns: u64, velocity: Velocity) -> TwistStamped {
    TwistStamped {
        header: Header::new(wall_ns, BASE_FRAME),
        twist: Twist {
            linear: Vector3 { x: velocity.linear_m_s, ..Vector3::default() },
            angular: Vector3 { z: velocity.angular_rad_s, ..Vector3::default() },
        },
    }
}

/// What the daemon commands, stamped with the emission that it answers.
#[must_use]
pub fn command_twist(command: &VelocityCommand) -> TwistStamped {
    twist(command.t_wall_ns, command.velocity())
}

/// What the controller really commands.
#[must_use]
pub fn platform_twist(platform: &PlatformVelocity) -> TwistStamped {
    let velocity = Velocity { linear_m_s: platform.linear_m_s, angular_rad_s: platform.angular_rad_s };
    twist(platform.t_wall_ns, velocity)
}

/// The daemon's health as diagnostic_msgs/DiagnosticArray: DEGRADED warns, STOPPED and FAULT are errors.
#[must_use]
pub fn health_diagnostics(health: &Health) -> DiagnosticArray {
    let level = match DaemonState::from_number(health.state) {
        Some(DaemonState::Stopped | DaemonState::Fault) | None => ERROR,
        Some(DaemonState::Degraded) => WARN,
        Some(_) => OK,
    };
    diagnostics(health.t_wall_ns, "noctule: daemon", level, health)
}

/// The controller's state as diagnostic_msgs/DiagnosticArray: HOLD warns, LATCHED is an error.
#[must_use]
pub fn platform_diagnostics(platform: &PlatformVelocity) -> DiagnosticArray {
    let level = match GateState::from_number(platform.state) {
        Some(GateState::Latched) | None => ERROR,
        Some(GateState::Hold) => WARN,
        Some(_) => OK,
    };
    diagnostics(platform.t_wall_ns, "noctule: controller", level, platform)
}

fn diagnostics<T: WireType>(wall_ns: u64, name: &str, level: u8, wire: &T) -> DiagnosticArray {
    let fields = fields_json(T::FIELDS, bytemuck::bytes_of(wire));
    let text = |value: &serde_json::Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let named = |key: &str| fields.get(key).map(text).unwrap_or_default();
    DiagnosticArray {
        header: Header::new(wall_ns, ""),
        status: vec![DiagnosticStatus {
            level,
            name: name.to_owned(),
            message: format!("{} ({})", named("state"), named("reason")),
            hardware_id: "noctule".to_owned(),
            values: fields.iter().map(|(key, value)| KeyValue { key: key.clone(), value: text(value) }).collect(),
        }],
    }
}
