//! The virtual sonar ring: objects between neighbouring readings of twelve virtual sonars (paper 003; specification, section 10).
//!
//! Goes in: twelve readings around the robot, 30 degrees apart. Comes out: a place and its covariance for every pair of
//! neighbours that hear the same thing. What the paper prints as (vi) and (xi) to (xiii) is inconsistent; this is the geometry:
//! two circles around two transducers that are the baseline b = 2 R sin 15 deg apart. The paper's b is a constant of 12 cm
//! "depending on the angle", which for its robot of 20 cm would be a step of 74 degrees; its last pair is (11, 1) where (11, 0)
//! is meant (table 5), its rotations 1 to 3 fill cells n, n + 1, n + 2 where n, n + 4, n + 8 are meant (table 4), and table 7
//! puts what it hears at 117.88 cm and at 23.36 cm 40 cm apart. Here all readings are of one moment; [`super::triangulation`]
//! takes them from anywhere. Never fuses over pings.

use super::params::RingParams;
use crate::geometry::Pose2;
use nalgebra::{Matrix2, Rotation2, Vector2};
use std::f64::consts::TAU;

/// Virtual sonars on the ring.
pub const SONARS: usize = 12;

/// What two neighbours hear together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RingObject {
    /// Place in the frame that the pose is given in.
    pub position_m: Vector2<f64>,
    /// The two sonars; sonar i looks along the heading + 30 i degrees.
    pub pair: [usize; 2],
    /// Covariance of the place from the noise of the two readings, square metres. Across the line of sight it is large: the
    /// baseline is short.
    pub covariance_m2: Matrix2<f64>,
}

/// Bearing of a sonar from the heading, counter-clockwise.
#[must_use]
pub fn bearing_rad(sonar: usize) -> f64 {
    sonar as f64 * TAU / SONARS as f64
}

/// The reading that rotation `turn` of sensor `sensor` fills, for three sensors 120 degrees apart that are turned by 0, 30, 60 and
/// 90 degrees (order of the paper's table 3).
#[must_use]
pub fn reading_index(sensor: usize, turn: usize) -> usize {
    (turn + 4 * sensor) % SONARS
}

/// Places of what pairs of neighbours hear. `ranges_m` are measured from the ring, `None` where there is no echo. Nothing is
/// given for a pair whose readings no one point explains, or only a point outside one of the two cones.
#[must_use]
pub fn objects(params: &RingParams, ranges_m: &[Option<f64>; SONARS], pose: &Pose2) -> Vec<RingObject> {
    (0..SONARS).filter_map(|first| object(params, ranges_m, pose, [first, (first + 1) % SONARS])).collect()
}

fn object(params: &RingParams, ranges_m: &[Option<f64>; SONARS], pose: &Pose2, pair: [usize; 2]) -> Option<RingObject> {
    let (first_m, second_m) = ranges_m[pair[0]].zip(ranges_m[pair[1]])?;
    let half_step_rad = 0.5 * TAU / SONARS as f64;
    let baseline_m = 2.0 * params.ring_radius_m * half_step_rad.sin();
    // Written so that NaN is no object; what the layers hear is not asked here.
    if !((first_m - second_m).abs() <= baseline_m && baseline_m <= first_m + second_m) {
        return None;
    }
    let across_m = (first_m * first_m - second_m * second_m) / (2.0 * baseline_m);
    let (from_first_m, from_second_m) = (across_m + 0.5 * baseline_m, across_m - 0.5 * baseline_m);
    let out_m = (first_m * first_m - from_first_m * from_first_m).max(0.0).sqrt();
    let half_cone_rad = 0.5 * params.cone_deg.to_radians();
    // Sonar i looks half a step to one side of the pair's axis, its neighbour to the other.
    let off_first_rad = from_first_m.atan2(out_m) + half_step_rad;
    let off_second_rad = from_second_m.atan2(out_m) - half_step_rad;
    if !(off_first_rad.abs() <= half_cone_rad && off_second_rad.abs() <= half_cone_rad) {
        return None;
    }
    // On the baseline's own line the distance out goes with the root of an error: a plain derivative there would be infinite.
    let squared_m2 = params.range_noise_m
        * (2.0 * first_m * (1.0 - from_first_m / baseline_m)).hypot(2.0 * second_m * from_first_m / baseline_m);
    let slope_m = out_m.max(0.5 * squared_m2.sqrt());
    // Derivatives of (out, across) by the two readings.
    let by_readings = Matrix2::new(
        first_m * (1.0 - from_first_m / baseline_m) / slope_m,
        second_m * from_first_m / baseline_m / slope_m,
        first_m / baseline_m,
        -second_m / baseline_m,
    );
    let axis = Rotation2::new(pose.heading_rad + bearing_rad(pair[0]) + half_step_rad);
    let local = by_readings * by_readings.transpose() * params.range_noise_m.powi(2);
    let covariance_m2 = axis.matrix() * local * axis.matrix().transpose();
    let place_m = Vector2::new(params.ring_radius_m * half_step_rad.cos() + out_m, across_m);
    let position_m = pose.position_m() + axis * place_m;
    let finite = position_m.iter().chain(covariance_m2.iter()).all(|value| value.is_finite());
    finite.then_some(RingObject { position_m, pair, covariance_m2 })
}
