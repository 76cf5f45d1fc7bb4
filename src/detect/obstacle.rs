//! Place and size of an obstacle on a planned edge, the free passage on either side of it, and the way round.
//!
//! Goes in: the memory of reflectors ([`LocalMap`]), the edge, the "biggest valued point" of the detector (paper 001, section 3.1, where
//! a laser scanner did this). Comes out: [`Measured`], in the frame of the edge, and a [`SubRoute`]. Sound shows the ends and corners of
//! an obstacle and hides what lies between: reflectors so close together that the robot cannot pass between them count as one. The far
//! end is hidden from in front; it is told as not seen and found while the robot passes ([`far_end_m`]). Allocates nothing.

use super::local_map::{LocalMap, MapPoint};
use super::params::ProjectionParams;
use super::projection::Edge;
use crate::geometry::Pose2;
use crate::signal::RobotScan;
use nalgebra::Vector2;
use std::f64::consts::{FRAC_PI_2, PI};

/// Reflectors of an obstacle were heard no longer ago.
const OBSTACLE_AGE_S: f64 = 4.0;
/// Walls may have been.
const WALL_AGE_S: f64 = 12.0;
/// How far before its nearest known point an obstacle may begin, and how far behind that it is looked for across, beyond the width
/// that the robot needs.
const NEAR_SLACK_M: f64 = 0.1;
const DEPTH_SLACK_M: f64 = 0.2;
/// The biggest valued point and what lies this near to it need no second hearing.
const AROUND_BIGGEST_M: f64 = 0.1;
/// Walls are taken from behind the robot up to a little ahead of it.
const WALL_BEHIND_M: f64 = 0.6;
const WALL_AHEAD_M: f64 = 0.15;
/// A line of sight within this of square to the edge sees a wall along it.
const ABEAM_RAD: f64 = 20.0 * PI / 180.0;
/// A wall is heard loud and square. What is weaker than this share of the loudest on its side is the wall again, at the end of another
/// sensor's array where bearings are poor.
const WALL_SHARE: f32 = 0.3;
/// Half the opening in which a side without any wall must be seen to be free.
const OPEN_SIDE_RAD: f64 = 30.0 * PI / 180.0;
/// Least standard deviation of an end: what one sonar hears of another's sound is off by so much. Measured: tests/detectors_scenes/projection.rs.
const PLACE_SIGMA_M: f64 = 0.015;
/// Distance kept from the obstacle beyond half of the safe width, where there is room.
const SPARE_M: f64 = 0.08;
/// The robot is beside the edge this much before the obstacle begins, and until this much behind its end.
const LEAD_M: f64 = 0.2;
/// Rounds of adding reflectors to an obstacle; each adds at least one.
const ROUNDS_MAX: usize = 64;

/// How wide a passage is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Passage {
    /// Nothing bounds it, and it was not seen to be free either: no passage.
    #[default]
    Unknown,
    /// Nothing was heard there, and it was seen.
    Open,
    /// Between the obstacle and what stands beside it, at least 0.
    Wide(f64),
}

impl Passage {
    /// Its width: infinite for an open one, `None` for an unknown one.
    #[must_use]
    pub fn width_m(self) -> Option<f64> {
        match self {
            Passage::Unknown => None,
            Passage::Open => Some(f64::INFINITY),
            Passage::Wide(width_m) => Some(width_m),
        }
    }
}

/// An obstacle in the frame of an edge: along from its start, across positive to its left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The biggest valued point, in the frame of odometry.
    pub place_m: Vector2<f64>,
    /// Where it begins along the edge.
    pub along_near_m: f64,
    /// Where it ends, as far as that was seen.
    pub along_far_m: f64,
    /// Whether the far end was seen: false until the robot is past it.
    pub far_end_seen: bool,
    /// Its right end across the edge.
    pub across_right_m: f64,
    /// Its left end.
    pub across_left_m: f64,
    /// Standard deviation of these ends.
    pub sigma_m: f64,
    /// Whether it reaches into the safe path along the edge.
    pub in_the_way: bool,
    /// Free width to its left.
    pub left: Passage,
    /// Free width to its right.
    pub right: Passage,
}

/// A way round an obstacle: from where the robot stands, to beside its near end, to behind its far end, back to the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SubRoute {
    /// The four points, in the frame of odometry.
    pub points_m: [Vector2<f64>; 4],
    /// Distance of the way past the obstacle from the edge, positive to its left.
    pub across_m: f64,
}

/// Measures the obstacle to which `biggest_m` belongs.
#[must_use]
pub fn measure(
    map: &LocalMap,
    scan: &RobotScan,
    pose: &Pose2,
    edge: &Edge,
    biggest_m: Vector2<f64>,
    params: &ProjectionParams,
) -> Measured {
    let safe_m = params.safe_width_m;
    let robot_m = edge.local_m(pose.position_m());
    let biggest = edge.local_m(biggest_m);
    let (mut low, mut high) = (biggest, biggest);
    let mut sigma_m = PLACE_SIGMA_M;
    let candidates = || {
        map.points().filter(move |point| {
            (point.hits >= 2 && map.age_s(point) <= OBSTACLE_AGE_S)
                || (point.place_m - biggest_m).norm() <= AROUND_BIGGEST_M
        })
    };
    let ahead = |local_m: &Vector2<f64>, low: &Vector2<f64>| {
        local_m.x >= low.x - NEAR_SLACK_M && local_m.x <= low.x + safe_m + DEPTH_SLACK_M
    };
    for _ in 0..ROUNDS_MAX {
        let before = (low, high);
        for point in candidates() {
            let local_m = edge.local_m(point.place_m);
            let near = local_m.y > low.y - safe_m && local_m.y < high.y + safe_m;
            if near && ahead(&local_m, &low) {
                (low.y, high.y) = (low.y.min(local_m.y), high.y.max(local_m.y));
                // Where it begins and ends counts only beside the way.
                if local_m.y.abs() <= 0.5 * safe_m + NEAR_SLACK_M {
                    (low.x, high.x) = (low.x.min(local_m.x), high.x.max(local_m.x));
                }
                sigma_m = sigma_m.max(point.sigma_m);
            }
        }
        if before == (low, high) {
            break;
        }
    }
    let beside = |side: f64| {
        let next_m = candidates()
            .map(|point| edge.local_m(point.place_m))
            .filter(|local_m| ahead(local_m, &low) && side * local_m.y > side * if side > 0.0 { high.y } else { low.y })
            .map(|local_m| side * local_m.y)
            .fold(f64::INFINITY, f64::min);
        next_m.min(wall_m(map, edge, robot_m, side).unwrap_or(f64::INFINITY))
    };
    let passage = |side: f64, end_m: f64| match beside(side) {
        bound_m if bound_m.is_finite() => Passage::Wide((bound_m - side * end_m).max(0.0)),
        _ if is_open(scan, pose, edge, side, side * (end_m - robot_m.y) + safe_m) => Passage::Open,
        _ => Passage::Unknown,
    };
    Measured {
        place_m: biggest_m,
        along_near_m: low.x,
        along_far_m: high.x,
        far_end_seen: false,
        across_right_m: low.y,
        across_left_m: high.y,
        sigma_m,
        in_the_way: low.y < 0.5 * safe_m && high.y > -0.5 * safe_m,
        left: passage(1.0, high.y),
        right: passage(-1.0, low.y),
    }
}

/// Distance from the edge, on one side of it, of the wall that the robot drives along.
fn wall_m(map: &LocalMap, edge: &Edge, robot_m: Vector2<f64>, side: f64) -> Option<f64> {
    let along = edge.along();
    let beside = |point: &&MapPoint| {
        let local_m = edge.local_m(point.place_m);
        point.is_abeam(along, ABEAM_RAD)
            && (-WALL_BEHIND_M..=WALL_AHEAD_M).contains(&(local_m.x - robot_m.x))
            && side * (local_m.y - robot_m.y) > 0.0
    };
    let abeam = || map.firm(WALL_AGE_S).filter(beside);
    let loudest = abeam().map(|point| point.energy).fold(0.0, f32::max);
    let loud = abeam().filter(|point| point.energy >= WALL_SHARE * loudest);
    loud.map(|point| side * edge.local_m(point.place_m).y).reduce(f64::min)
}

/// Whether everything square to the edge on one side is seen and free for at least `needed_m` from the robot.
fn is_open(scan: &RobotScan, pose: &Pose2, edge: &Edge, side: f64, needed_m: f64) -> bool {
    let along = edge.along();
    let square_rad = along.y.atan2(along.x) + side * FRAC_PI_2 - pose.heading_rad;
    (-6..=6).all(|step| {
        let bearing_rad = square_rad + f64::from(step) / 6.0 * OPEN_SIDE_RAD;
        scan.rays[RobotScan::ray_at(bearing_rad)].free_m >= needed_m
    })
}

/// The way round an obstacle on the side where less is to be gone, if either side has a passage of the safe width.
#[must_use]
pub fn sub_route(measured: &Measured, pose: &Pose2, edge: &Edge, params: &ProjectionParams) -> Option<SubRoute> {
    let safe_m = params.safe_width_m;
    let across = |side: f64, end_m: f64, passage: Passage| {
        let width_m = passage.width_m().filter(|width_m| *width_m >= safe_m)?;
        Some(end_m + side * (0.5 * safe_m + SPARE_M.min(0.5 * (width_m - safe_m))))
    };
    let left = across(1.0, measured.across_left_m, measured.left);
    let right = across(-1.0, measured.across_right_m, measured.right);
    let across_m = match (left, right) {
        (Some(left), Some(right)) => Some(if left.abs() <= right.abs() { left } else { right }),
        (left, right) => left.or(right),
    }?;
    let robot_m = edge.local_m(pose.position_m());
    let entry_m = (measured.along_near_m - LEAD_M).max(robot_m.x);
    let mut route = SubRoute {
        points_m: [pose.position_m(), edge.point_m(Vector2::new(entry_m, across_m)), edge.end_m, edge.end_m],
        across_m,
    };
    route.end_behind(measured.along_far_m, edge);
    Some(route)
}

impl SubRoute {
    /// Leads the way to behind `far_m` along the edge, and back.
    pub fn end_behind(&mut self, far_m: f64, edge: &Edge) {
        let length_m = edge.length_m();
        let exit_m = (far_m + LEAD_M).min(length_m);
        // Back at 45 degrees.
        let back_m = (exit_m + self.across_m.abs()).min(length_m);
        self.points_m[2] = edge.point_m(Vector2::new(exit_m, self.across_m));
        self.points_m[3] = edge.point_m(Vector2::new(back_m, 0.0));
    }
}

/// Where the obstacle ends along the edge as far as is known by now: the robot beside it hears its flank, and behind it the far corner.
#[must_use]
pub fn far_end_m(map: &LocalMap, edge: &Edge, measured: &Measured, params: &ProjectionParams) -> f64 {
    let safe_m = params.safe_width_m;
    let mut far_m = measured.along_far_m;
    for _ in 0..ROUNDS_MAX {
        let before_m = far_m;
        for point in map.firm(OBSTACLE_AGE_S) {
            let local_m = edge.local_m(point.place_m);
            let abreast = local_m.y > measured.across_right_m - NEAR_SLACK_M
                && local_m.y < measured.across_left_m + NEAR_SLACK_M
                && local_m.y.abs() < 0.5 * safe_m + NEAR_SLACK_M;
            if abreast && local_m.x > far_m && local_m.x < far_m + safe_m {
                far_m = local_m.x;
            }
        }
        if before_m == far_m {
            break;
        }
    }
    far_m
}

#[cfg(test)]
mod tests;
