//! Plane geometry in the frames of the specification, section 1: robot frame x forward, y left; angles
//! counter-clockwise; a bearing is 0 on a sensor's boresight and positive to the left.
//!
//! Knows nothing of sound, sensors or robots' hardware.

pub mod flow_lines;
pub mod shape;

use nalgebra::{Rotation2, Vector2};
use std::f64::consts::PI;

/// Wraps an angle into (-pi, pi]. An angle that lies there is not changed by a bit, and opposite angles stay opposite: mirrored
/// scenes are to give mirrored commands.
#[must_use]
pub fn wrap_angle_rad(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - 2.0 * PI * (angle_rad / (2.0 * PI)).round();
    if wrapped <= -PI { PI } else { wrapped }
}

/// Position and heading of a frame in its parent frame: robot in world, sensor in robot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose2 {
    /// x of the frame's origin in the parent frame.
    pub x_m: f64,
    /// y of the frame's origin in the parent frame.
    pub y_m: f64,
    /// Direction of the frame's x axis in the parent frame, counter-clockwise from the parent's x axis.
    pub heading_rad: f64,
}

impl Pose2 {
    /// Origin in the parent frame.
    #[must_use]
    pub fn position_m(&self) -> Vector2<f64> {
        Vector2::new(self.x_m, self.y_m)
    }

    /// Point of this frame, expressed in the parent frame.
    #[must_use]
    pub fn parent_from_local(&self, point_m: Vector2<f64>) -> Vector2<f64> {
        Rotation2::new(self.heading_rad) * point_m + self.position_m()
    }

    /// Point of the parent frame, expressed in this frame.
    #[must_use]
    pub fn local_from_parent(&self, point_m: Vector2<f64>) -> Vector2<f64> {
        Rotation2::new(-self.heading_rad) * (point_m - self.position_m())
    }

    /// Pose of a frame given in this frame, expressed in the parent frame.
    #[must_use]
    pub fn compose(&self, local: &Pose2) -> Pose2 {
        let origin = self.parent_from_local(local.position_m());
        Pose2 { x_m: origin.x, y_m: origin.y, heading_rad: wrap_angle_rad(self.heading_rad + local.heading_rad) }
    }
}

/// Point at range and bearing of a frame, in that frame (x along bearing 0, y to the left).
#[must_use]
pub fn cartesian_from_polar(range_m: f64, bearing_rad: f64) -> Vector2<f64> {
    Vector2::new(range_m * bearing_rad.cos(), range_m * bearing_rad.sin())
}

/// Range and bearing of a point of a frame.
#[must_use]
pub fn polar_from_cartesian(point_m: Vector2<f64>) -> (f64, f64) {
    (point_m.norm(), point_m.y.atan2(point_m.x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapping_keeps_the_direction_and_the_half_open_interval() {
        assert_eq!(wrap_angle_rad(PI), PI);
        assert!((wrap_angle_rad(-PI) - PI).abs() < 1e-15);
        assert!((wrap_angle_rad(2.5 * PI) - 0.5 * PI).abs() < 1e-12);
        for angle_rad in [0.05, 1.6, 3.1, 4.0, 9.5, 100.0] {
            assert_eq!(wrap_angle_rad(-angle_rad), -wrap_angle_rad(angle_rad), "to the last bit");
        }
    }

    #[test]
    fn a_pose_and_its_inverse_cancel() {
        let pose = Pose2 { x_m: 0.3, y_m: -1.2, heading_rad: 2.1 };
        let point = Vector2::new(0.7, 0.4);
        assert!((pose.local_from_parent(pose.parent_from_local(point)) - point).norm() < 1e-12);
    }

    #[test]
    fn left_of_a_frame_turned_left_is_backward_in_its_parent() {
        let pose = Pose2 { x_m: 0.0, y_m: 0.0, heading_rad: PI / 2.0 };
        let left = pose.parent_from_local(Vector2::new(0.0, 1.0));
        assert!((left - Vector2::new(-1.0, 0.0)).norm() < 1e-12);
    }
}
