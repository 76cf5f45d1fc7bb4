//! What the detectors found as it is published: from [`crate::detect`]'s reports to the types that lie in shared memory.
//!
//! Copies numbers, judges nothing. Readings and widths keep their three answers: +inf for nothing within range, NaN for unknown.

use crate::detect::obstacle::Passage;
use crate::detect::path_follower::{FollowerState, ObstacleReport};
use crate::detect::ring_detector::RingReport;
use crate::geometry::Pose2;
use crate::io::wire::NO_SENSOR;
use crate::io::wire::detections::{MAP_UNKNOWN, OBJECTS_MAX, Objects, Obstacle, ROUTE_POINTS, answered};
use crate::signal::{Reading, RobotScan};

/// Says "none" where the number of an edge or of a sonar stands.
const NONE: u32 = NO_SENSOR;

fn reading_m(reading: Reading) -> f64 {
    f64::from(answered(reading).0)
}

fn width_m(passage: Passage) -> f64 {
    passage.width_m().unwrap_or(f64::NAN)
}

fn number(index: Option<usize>) -> u32 {
    index.map_or(NONE, |index| index as u32)
}

/// Objects and map of a scan that was made at `pose`; without odometry in the robot's own frame.
pub fn fill_objects(wire: &mut Objects, scan: &RobotScan, report: &RingReport, pose: Option<Pose2>) {
    *wire = Objects {
        sequence: scan.sequence,
        t_monotonic_ns: scan.emitted_at.boottime_ns,
        t_wall_ns: scan.emitted_at.wall_ns,
        reading_m: report.readings.map(reading_m),
        map_x_m: report.grid.origin_m[0],
        map_y_m: report.grid.origin_m[1],
        cell_m: report.grid.cell_m,
        object_count: report.objects().len().min(OBJECTS_MAX) as u32,
        frame: u32::from(pose.is_none()),
        ..Objects::blank()
    };
    if let Some(pose) = pose {
        (wire.robot_x_m, wire.robot_y_m, wire.robot_heading_rad) = (pose.x_m, pose.y_m, pose.heading_rad);
    }
    for (index, object) in report.objects().iter().enumerate().take(OBJECTS_MAX) {
        (wire.x_m[index], wire.y_m[index]) = (object.position_m.x, object.position_m.y);
        let spread = object.covariance_m2;
        wire.variance_x_m2[index] = spread.m11;
        wire.covariance_xy_m2[index] = spread.m12;
        wire.variance_y_m2[index] = spread.m22;
        wire.score[index] = object.score as f32;
        wire.pair[index] = object.pair[0] as u32;
    }
    for (cell, percent) in wire.map.iter_mut().zip(report.grid.percent) {
        *cell = if percent > 100 { MAP_UNKNOWN } else { i16::from(percent) };
    }
}

/// What stands on the planned way; without odometry the robot is nowhere on it, and the detector blind.
pub fn fill_obstacle(wire: &mut Obstacle, scan: &RobotScan, report: Option<&ObstacleReport>) {
    *wire = Obstacle {
        sequence: scan.sequence,
        t_monotonic_ns: scan.emitted_at.boottime_ns,
        t_wall_ns: scan.emitted_at.wall_ns,
        sensors_used: scan.sensors_used,
        edge_index: NONE,
        sonar: NONE,
        blind: 1,
        reading_m: [f64::NAN; 8],
        edge_distance_m: f64::NAN,
        ..no_obstacle()
    };
    let Some(report) = report else { return };
    wire.projection = report.projections;
    wire.reading_m = report.readings.map(reading_m);
    wire.edge_distance_m = report.edge_distance_m;
    wire.blind_beyond_m = report.blind_beyond_m;
    wire.edge_index = number(report.edge_index);
    wire.sonar = number(report.sonar);
    wire.detected = u32::from(report.sonar.is_some());
    wire.blind = u32::from(report.blind);
    wire.cannot_see = u32::from(report.cannot_see);
    wire.follower = follower_number(report.state);
    (wire.wish_linear_m_s, wire.wish_angular_rad_s) = (report.wish.linear_m_s, report.wish.angular_rad_s);
    wire.route_count = report.route_count.min(ROUTE_POINTS) as u32;
    for (index, point_m) in report.route_m.iter().enumerate().take(ROUTE_POINTS) {
        (wire.route_x_m[index], wire.route_y_m[index]) = (point_m.x, point_m.y);
    }
    if let Some(detected_m) = report.detected_m {
        (wire.x_m, wire.y_m) = (detected_m.x, detected_m.y);
    }
    let Some(measured) = &report.obstacle else { return };
    (wire.x_m, wire.y_m) = (measured.place_m.x, measured.place_m.y);
    (wire.along_near_m, wire.along_far_m) = (measured.along_near_m, measured.along_far_m);
    (wire.across_right_m, wire.across_left_m) = (measured.across_right_m, measured.across_left_m);
    wire.extent_sigma_m = measured.sigma_m;
    (wire.passage_left_m, wire.passage_right_m) = (width_m(measured.left), width_m(measured.right));
    wire.far_end_seen = u32::from(measured.far_end_seen);
    wire.in_the_way = u32::from(measured.in_the_way);
}

/// An obstacle of which nothing is known.
fn no_obstacle() -> Obstacle {
    let unknown = f64::NAN;
    Obstacle {
        x_m: unknown,
        y_m: unknown,
        along_near_m: unknown,
        along_far_m: unknown,
        across_right_m: unknown,
        across_left_m: unknown,
        extent_sigma_m: unknown,
        passage_left_m: unknown,
        passage_right_m: unknown,
        ..Obstacle::blank()
    }
}

fn follower_number(state: FollowerState) -> u32 {
    match state {
        FollowerState::Idle => 0,
        FollowerState::Follow => 1,
        FollowerState::Measure => 2,
        FollowerState::Pass => 3,
        FollowerState::Return => 4,
        FollowerState::Blocked => 5,
        FollowerState::Arrived => 6,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::wire::detections::follower_name;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn every_state_of_the_follower_has_its_name_on_the_wire() {
        for (state, name) in [
            (FollowerState::Idle, "IDLE"),
            (FollowerState::Follow, "FOLLOW"),
            (FollowerState::Measure, "MEASURE"),
            (FollowerState::Pass, "PASS"),
            (FollowerState::Return, "RETURN"),
            (FollowerState::Blocked, "BLOCKED"),
            (FollowerState::Arrived, "ARRIVED"),
        ] {
            assert_eq!(follower_name(follower_number(state)), Some(name));
        }
    }

    #[test]
    fn without_odometry_the_detector_is_blind_and_names_no_edge() {
        let mut wire = Obstacle::blank();
        fill_obstacle(&mut wire, &RobotScan::unseen(), None);
        assert_eq!((wire.blind, wire.detected, wire.edge_index, wire.follower), (1, 0, NONE, 0));
        assert!(wire.edge_distance_m.is_nan() && wire.reading_m.iter().all(|reading| reading.is_nan()));
    }

    #[test]
    fn objects_carry_the_frame_they_are_in() {
        let detector = crate::detect::RingDetector::new(&crate::detect::RingParams::default());
        let mut wire = Objects::blank();
        let pose = Pose2 { x_m: 1.0, y_m: 2.0, heading_rad: FRAC_PI_2 };
        fill_objects(&mut wire, &RobotScan::unseen(), detector.report(), Some(pose));
        assert_eq!((wire.frame, wire.robot_x_m, wire.robot_heading_rad), (0, 1.0, FRAC_PI_2));
        assert!(wire.map.iter().all(|cell| *cell == MAP_UNKNOWN), "nothing is known of any cell");
        fill_objects(&mut wire, &RobotScan::unseen(), detector.report(), None);
        assert_eq!((wire.frame, wire.robot_x_m), (1, 0.0));
    }
}
