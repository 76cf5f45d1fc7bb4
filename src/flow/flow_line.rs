//! Lines that an echo keeps to while the robot's velocity is constant (paper 000, eq. 9, and the closed form that it
//! could not find for rotation).
//!
//! Straight on: the lateral distance from the robot's x axis. Turning on the spot: the distance from the robot's centre. Any
//! constant velocity: the distance from the instant centre of rotation. All in a sensor's own range and bearing; never
//! reads an image.

use crate::geometry::cartesian_from_polar;
use crate::sensor::Mount;
use crate::signal::Velocity;
use nalgebra::Vector2;

/// Lateral distance d = l sin(alpha) + r sin(theta + delta) of a reflector from the robot's x axis, left positive.
#[must_use]
pub fn lateral_m(mount: &Mount, range_m: f64, bearing_rad: f64) -> f64 {
    mount.distance_m * mount.bearing_rad.sin() + range_m * (bearing_rad + mount.bearing_rad + mount.yaw_rad).sin()
}

/// Range at which the flow line F_d of lateral distance `lateral_m` crosses a bearing: (d - l sin(alpha)) / sin(theta +
/// delta). `None` where it never does.
#[must_use]
pub fn flow_line_range_m(mount: &Mount, lateral_m: f64, bearing_rad: f64) -> Option<f64> {
    let offset_m = lateral_m - mount.distance_m * mount.bearing_rad.sin();
    let range_m = offset_m / (bearing_rad + mount.bearing_rad + mount.yaw_rad).sin();
    (range_m.is_finite() && range_m >= 0.0).then_some(range_m)
}

/// Distance rho of a reflector from the robot's centre: rho^2 = r^2 + 2 l r cos(theta + beta) + l^2.
#[must_use]
pub fn rotation_radius_m(mount: &Mount, range_m: f64, bearing_rad: f64) -> f64 {
    let cross_m2 = 2.0 * mount.distance_m * range_m * (bearing_rad + mount.yaw_rad).cos();
    (range_m * range_m + cross_m2 + mount.distance_m * mount.distance_m).max(0.0).sqrt()
}

/// Ranges at which the rotation circle of radius `rotation_radius_m` crosses a bearing, nearer first: none when the ray
/// misses it, one from inside it, two from outside.
#[must_use]
pub fn rotation_circle_ranges_m(mount: &Mount, rotation_radius_m: f64, bearing_rad: f64) -> [Option<f64>; 2] {
    let (sin, cos) = (bearing_rad + mount.yaw_rad).sin_cos();
    let (along_m, across_m) = (-mount.distance_m * cos, mount.distance_m * sin);
    let half_chord_m = (rotation_radius_m * rotation_radius_m - across_m * across_m).sqrt();
    let (near_m, far_m) = (along_m - half_chord_m, along_m + half_chord_m);
    let ahead = |range_m: f64| (range_m >= 0.0).then_some(range_m);
    match ahead(near_m) {
        Some(near_m) => [Some(near_m), ahead(far_m)],
        None => [ahead(far_m), None],
    }
}

/// Distance of a reflector from the instant centre of rotation (0, V / omega), which a constant velocity keeps. `None`
/// for straight motion, whose centre is at infinity: see [`lateral_m`].
#[must_use]
pub fn turn_centre_distance_m(mount: &Mount, velocity: Velocity, range_m: f64, bearing_rad: f64) -> Option<f64> {
    let centre_m = Vector2::new(0.0, velocity.linear_m_s / velocity.angular_rad_s);
    let point_m = mount.pose().parent_from_local(cartesian_from_polar(range_m, bearing_rad));
    centre_m.y.is_finite().then(|| (point_m - centre_m).norm())
}
