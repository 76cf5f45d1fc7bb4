//! One rule that fits the control regions to a platform. Robot in, shapes out; robot frame, metres. Which thresholds and gains
//! go with them, and why they need no change from one sensor layout to another, is told at the end.
//!
//! R = radius, v = largest speed, a = largest deceleration, s = v Z2 + v^2 / (2 a) the way to a stop after a silent
//! fault (safety: Z2 = 0.35 s), b = 0.30 the range nearer than which a sensor is deaf, q = max(R, 0.20) how far from
//! the centre a sensor may stand. No sensor's place goes in: one rule for every layout.
//!
//! - CA reaches ahead to q + b + 0.4 s v: a sensor at the footprint's rim must see an obstacle during four ping
//!   periods before it comes so near that it is not heard any more. To the sides a specular wall is approached slowly, so
//!   max(R + s + 0.05, 0.40) is enough, and a doorway of 0.9 m still lies outside. Never less than R + s + 0.05.
//! - OA: what the robot would run into if it went straight on, R + 0.10 to either side, to 1.5 m (R + 1.3 m at least).
//! - RCF: the strips beside OA out to 1.5 m beyond R, from the axle to 1.5 m ahead: what lies behind the axle is being left, and
//!   turning on until it fell silent turned the robot by some 25 deg too far.
//! - AFF: flow lines to 2 m (R + 1.8 m at least) on either side, every 5 cm, abeam of the robot (R + 0.15 m ahead and behind):
//!   a specular wall is heard squarely abeam, and farther ahead the lines only gather the side lobes of other echoes.
//!
//! # Thresholds and gains for every layout
//!
//! An energy is the envelope times a gain over range that undoes spreading and absorption (1 at 1 m): a wall reads the same
//! wherever it stands; pillars and edges, which scatter, read a little less the farther they are. It is absolute: full scale is 1
//! and a large wall on the emitter's axis 0.1. On a robot
//! where that wall reads otherwise all thresholds, releases, the prominence and E_ref go with it, and the noise floor by as many
//! decibels. Nothing is normalised by the ping's own maximum, so an empty hall fires nothing. What a layer compares does not
//! depend on how many sensors there are, or errs towards stopping (figures from the simulator, one sensor):
//!
//! | what is compared | of several sensors | 2 cm pillar | 20 cm pillar | wall | threshold |
//! |---|---|---|---|---|---|
//! | OA, RCF: loudest cell, 1 to 1.3 m away | the loudest | 0.008 | 0.026 | 0.09 | 0.007, 0.02 |
//! | CA: sum over the region | added up: fires earlier | 0.6 to 0.8 | 0.8 to 2 | 3 to 5 | 0.3 |
//! | AFF: mean over a flow line, wall 0.8 m abeam | mean of the cells that are seen | | | 0.0058 | 0.004, both sides 0.003 |
//! | OA's slow-down: sum over the region | E_ref for each that hears | 0.4 | 1.1 | 3.6 | 12 stops |
//!
//! So OA hears the thinnest pillar from where its region begins, CA has twice the energy that it needs, since at the rim of
//! its region only part of an echo's cells are inside, and RCF leaves poles beside the way alone and keeps to walls. The
//! turn of OA and RCF is a quotient of two sums, in which the number of sensors cancels. Gains lambda and mu are 1 for the
//! simulated robot and 0.1 for a Husky of 0.6 m radius, both as in paper 000, and independent of the layout.
//!
//! Cells under the noise floor count nothing; it is given in dBFS of the envelope itself, over range, since the tail of the
//! direct path is louder near the sensor than any noise farther out. What is 8 dB below the loudest echo at its range in the
//! same sensor may be that one's side lobe (some 10 dB down) and is no echo; what such a lobe may hide is not free either: the
//! way ahead counts as seen up to there only (`flow::cues`).

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
    unseen_way_m(platform) + braking_way_m(platform)
}

/// The part of it that is driven before the output is zero.
#[must_use]
pub fn unseen_way_m(platform: &PlatformLimits) -> f64 {
    platform.max_linear_m_s * SILENT_FAULT_S
}

/// The part of it that is braked.
#[must_use]
pub fn braking_way_m(platform: &PlatformLimits) -> f64 {
    platform.max_linear_m_s * platform.max_linear_m_s / (2.0 * platform.max_linear_accel_m_s2)
}

/// Least radius of a safe CA region: the way to a stop, the robot itself and the error of a range (safety rule 27).
#[must_use]
pub fn collision_zone_min_m(platform: &PlatformLimits) -> f64 {
    platform.radius_m + silent_stop_m(platform) + RANGE_ERROR_M
}

/// Without the dust of binary sums, so that a printed configuration reads 0.3 and not 0.30000000000000004.
fn clean(length_m: f64) -> f64 {
    (length_m * 1e9).round() / 1e9
}

/// Regions of collision avoidance.
#[must_use]
pub fn collision_avoidance(platform: &PlatformLimits) -> Vec<Shape> {
    let side_m = collision_zone_min_m(platform).max(0.40);
    let sensor_m = platform.radius_m.max(SENSOR_REACH_M);
    let ahead_m = (sensor_m + DEAF_RANGE_M + 0.4 * platform.max_linear_m_s).max(side_m);
    let disc_m = side_m - 0.04;
    vec![
        Shape::HalfCircle { centre_m: [0.0, 0.0], radius_m: clean(side_m), heading_deg: 0.0 },
        Shape::Circle { centre_m: [clean(ahead_m - disc_m), 0.0], radius_m: clean(disc_m) },
    ]
}

/// Regions of obstacle avoidance.
#[must_use]
pub fn obstacle_avoidance(platform: &PlatformLimits) -> Vec<Shape> {
    let half_m = clean(platform.radius_m + 0.10);
    vec![Shape::Rectangle { x_m: [0.0, clean((platform.radius_m + 1.3).max(1.5))], y_m: [-half_m, half_m] }]
}

/// Regions of corridor following.
#[must_use]
pub fn corridor_following(platform: &PlatformLimits) -> Vec<Shape> {
    let (inner_m, outer_m) = (clean(platform.radius_m + 0.10), clean(platform.radius_m + 1.5));
    let x_m = [0.0, clean((platform.radius_m + 1.3).max(1.5))];
    vec![Shape::Rectangle { x_m, y_m: [inner_m, outer_m] }, Shape::Rectangle { x_m, y_m: [-outer_m, -inner_m] }]
}

/// Regions of flow following.
#[must_use]
pub fn flow_following(platform: &PlatformLimits) -> Vec<FlowLinesRegion> {
    let reach_m = clean(((platform.radius_m + 1.8).max(2.0) / 0.05).round() * 0.05);
    let abeam_m = clean(platform.radius_m + 0.15);
    vec![FlowLinesRegion { lateral_m: [-reach_m, reach_m], step_m: 0.05, x_m: [-abeam_m, abeam_m] }]
}
