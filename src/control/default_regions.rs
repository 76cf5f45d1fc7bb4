//! One rule that fits the control regions to a platform. Robot in, shapes out; robot frame, metres.
//!
//! R = radius, v = largest speed, a = largest deceleration, s = v Z2 + v^2 / (2 a) the way to a stop after a silent
//! fault (safety: Z2 = 0.35 s), b = 0.30 the range nearer than which a sensor is deaf, q = max(R, 0.20) how far from
//! the centre a sensor may stand.
//!
//! - CA reaches ahead to q + b + 0.4 s v: a sensor at the footprint's rim must see an obstacle during four ping
//!   periods before it comes so near that it is not heard any more. To the sides a specular wall is approached slowly, so
//!   max(R + s + 0.05, 0.40) is enough, and a doorway of 0.9 m still lies outside. Never less than R + s + 0.05.
//! - OA: what the robot would run into if it went straight on, R + 0.10 to either side, to 1.5 m (R + 1.3 m at least).
//! - RCF: the strips beside OA out to 1.5 m beyond R, from the axle to 1.5 m ahead: what lies behind the axle is being left, and
//!   turning on until it fell silent turned the robot by some 25 deg too far.
//! - AFF: flow lines to 2 m (R + 1.8 m at least) on either side, every 5 cm, abeam of the robot (R + 0.15 m ahead and behind):
//!   a specular wall is heard squarely abeam, and farther ahead the lines only gather the side lobes of other echoes.

use super::platform::PlatformLimits;
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::geometry::shape::Shape;

/// Last good capture to zero at the output, seconds (the time budget's Z2).
const SILENT_FAULT_S: f64 = 0.35;
/// Allowance for the error of a range.
const RANGE_ERROR_M: f64 = 0.05;
/// Range nearer than which a sensor hears only its own emission.
pub(super) const DEAF_RANGE_M: f64 = 0.30;
/// Farthest that a sensor of a small robot stands from the centre.
const SENSOR_REACH_M: f64 = 0.20;

/// Way from the last good capture to standstill after a silent fault, at full speed.
#[must_use]
pub fn silent_stop_m(platform: &PlatformLimits) -> f64 {
    let speed_m_s = platform.max_linear_m_s;
    speed_m_s * SILENT_FAULT_S + speed_m_s * speed_m_s / (2.0 * platform.max_linear_accel_m_s2)
}

/// Least radius of a safe CA region: the way to a stop, the robot itself and the error of a range (safety rule 27).
#[must_use]
pub fn collision_zone_min_m(platform: &PlatformLimits) -> f64 {
    platform.radius_m + silent_stop_m(platform) + RANGE_ERROR_M
}

/// Regions of collision avoidance.
#[must_use]
pub fn collision_avoidance(platform: &PlatformLimits) -> Vec<Shape> {
    let side_m = collision_zone_min_m(platform).max(0.40);
    let sensor_m = platform.radius_m.max(SENSOR_REACH_M);
    let ahead_m = (sensor_m + DEAF_RANGE_M + 0.4 * platform.max_linear_m_s).max(side_m);
    let disc_m = side_m - 0.04;
    vec![
        Shape::HalfCircle { centre_m: [0.0, 0.0], radius_m: side_m, heading_deg: 0.0 },
        Shape::Circle { centre_m: [ahead_m - disc_m, 0.0], radius_m: disc_m },
    ]
}

/// Regions of obstacle avoidance.
#[must_use]
pub fn obstacle_avoidance(platform: &PlatformLimits) -> Vec<Shape> {
    let half_m = platform.radius_m + 0.10;
    vec![Shape::Rectangle { x_m: [0.0, (platform.radius_m + 1.3).max(1.5)], y_m: [-half_m, half_m] }]
}

/// Regions of corridor following.
#[must_use]
pub fn corridor_following(platform: &PlatformLimits) -> Vec<Shape> {
    let (inner_m, outer_m) = (platform.radius_m + 0.10, platform.radius_m + 1.5);
    let x_m = [0.0, (platform.radius_m + 1.3).max(1.5)];
    vec![Shape::Rectangle { x_m, y_m: [inner_m, outer_m] }, Shape::Rectangle { x_m, y_m: [-outer_m, -inner_m] }]
}

/// Regions of flow following.
#[must_use]
pub fn flow_following(platform: &PlatformLimits) -> Vec<FlowLinesRegion> {
    let reach_m = ((platform.radius_m + 1.8).max(2.0) / 0.05).round() * 0.05;
    let abeam_m = platform.radius_m + 0.15;
    vec![FlowLinesRegion { lateral_m: [-reach_m, reach_m], step_m: 0.05, x_m: [-abeam_m, abeam_m] }]
}
