//! The robot's body: differential drive within the platform's limits, contact with the world, wheel odometry.
//!
//! Commanded velocity and time in, pose and clearance out. This file neither hears nor decides anything.

use super::echo::housing_corners_m;
use super::obstacles::{Obstacles, distance_to_segment_m, segments_cross};
use super::params::{MotionLimits, RobotParams};
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::Velocity;
use nalgebra::Vector2;

/// Clearance is never given as more than this, so that it stays a number in an empty world.
pub(super) const CLEARANCE_MAX_M: f64 = 100.0;
/// Share of the body's diameter between the wheels.
const TRACK_SHARE: f64 = 0.8;

/// Where odometry believes the robot to be, and how fast.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Odometry {
    /// Pose; the true one at the start, drifting from then on if drift is configured.
    pub pose: Pose2,
    /// Twist as the wheels report it.
    pub twist: Velocity,
}

/// Body and motion.
#[derive(Debug, Clone)]
pub(super) struct Robot {
    pub(super) params: RobotParams,
    pub(super) pose: Pose2,
    /// As the wheels turn; the body moves like that unless they slip.
    pub(super) velocity: Velocity,
    pub(super) odometry: Odometry,
    /// Share of its turning that each wheel brings to the floor: left, right.
    pub(super) grip: [f64; 2],
    /// What each wheel's diameter is taken for, relative to the truth: left, right.
    wheel_scale: [f64; 2],
    /// Mounts of the sensors whose housings stick out of the disc.
    outside: Vec<Pose2>,
}

impl Robot {
    pub(super) fn new(params: &RobotParams, mounts: impl Iterator<Item = Pose2>, wheel_scale: [f64; 2]) -> Self {
        let outside = mounts
            .filter(|mount| housing_corners_m(mount).iter().any(|corner| corner.norm() > params.radius_m))
            .collect();
        Self {
            params: *params,
            pose: Pose2::default(),
            velocity: Velocity::ZERO,
            odometry: Odometry::default(),
            grip: [1.0; 2],
            wheel_scale,
            outside,
        }
    }

    /// Sets the robot down at rest.
    pub(super) fn put(&mut self, pose: Pose2) {
        self.pose = pose;
        self.velocity = Velocity::ZERO;
        self.odometry = Odometry { pose, twist: Velocity::ZERO };
    }

    /// The velocity after `dt_s` of obeying `commanded`; a command that is not finite means standing still.
    pub(super) fn velocity_after(&self, commanded: Velocity, dt_s: f64) -> Velocity {
        let commanded = if commanded.is_finite() { commanded } else { Velocity::ZERO };
        let MotionLimits { max_linear_m_s, max_angular_rad_s, max_linear_accel_m_s2, max_angular_accel_rad_s2 } =
            self.params.limits;
        let approach = |present: f64, wanted: f64, max: f64, max_change: f64| {
            present + (wanted.clamp(-max, max) - present).clamp(-max_change * dt_s, max_change * dt_s)
        };
        Velocity {
            linear_m_s: approach(self.velocity.linear_m_s, commanded.linear_m_s, max_linear_m_s, max_linear_accel_m_s2),
            angular_rad_s: approach(
                self.velocity.angular_rad_s,
                commanded.angular_rad_s,
                max_angular_rad_s,
                max_angular_accel_rad_s2,
            ),
        }
    }

    /// Moves along the present velocity's arc, unless that ends in contact with something.
    ///
    /// Returns the clearance of the pose that was tried; zero or less means contact. Out of a contact (a mover may have
    /// run into the robot) every motion that widens the gap is free.
    pub(super) fn advance(&mut self, dt_s: f64, obstacles: &Obstacles) -> f64 {
        let tried = moved(&self.pose, self.body_velocity(), dt_s);
        let clearance_m = self.clearance_m(&tried, obstacles);
        if clearance_m > 0.0 || clearance_m > self.clearance_m(&self.pose, obstacles) {
            self.pose = tried;
        } else {
            self.velocity = Velocity::ZERO;
        }
        self.odometry.twist = self.as_wheels_report(self.velocity);
        self.odometry.pose = moved(&self.odometry.pose, self.odometry.twist, dt_s);
        clearance_m
    }

    /// How the body moves: that of the wheels, as far as they grip.
    pub(super) fn body_velocity(&self) -> Velocity {
        // Not a bit is to change while nothing slips.
        if self.grip == [1.0; 2] { self.velocity } else { self.of_wheels(self.velocity, self.grip) }
    }

    fn as_wheels_report(&self, velocity: Velocity) -> Velocity {
        self.of_wheels(velocity, self.wheel_scale)
    }

    fn of_wheels(&self, velocity: Velocity, scale: [f64; 2]) -> Velocity {
        let half_track_m = TRACK_SHARE * self.params.radius_m;
        let left = (velocity.linear_m_s - half_track_m * velocity.angular_rad_s) * scale[0];
        let right = (velocity.linear_m_s + half_track_m * velocity.angular_rad_s) * scale[1];
        Velocity { linear_m_s: 0.5 * (left + right), angular_rad_s: 0.5 * (right - left) / half_track_m }
    }

    /// Gap between the footprint at `pose` (disc and the housings that stick out) and whatever is nearest.
    pub(super) fn clearance_m(&self, pose: &Pose2, obstacles: &Obstacles) -> f64 {
        let centre_m = pose.position_m();
        let mut clearance_m = CLEARANCE_MAX_M;
        for segment in &obstacles.segments {
            clearance_m =
                clearance_m.min(distance_to_segment_m(centre_m, segment.from_m, segment.to_m) - self.params.radius_m);
        }
        for circle in &obstacles.circles {
            clearance_m = clearance_m.min((circle.centre_m - centre_m).norm() - circle.radius_m - self.params.radius_m);
        }
        let z_m = self.params.z_m.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        let from_disc_m = |point_m: Vector2<f64>| (point_m - centre_m).norm() - self.params.radius_m;
        clearance_m = clearance_m.min(obstacles.solids.gap_m(z_m, from_disc_m));
        for mount in &self.outside {
            clearance_m = clearance_m.min(housing_clearance_m(&pose.compose(mount), z_m, obstacles));
        }
        clearance_m
    }
}

fn housing_clearance_m(pose: &Pose2, z_m: [f64; 2], obstacles: &Obstacles) -> f64 {
    let corners = housing_corners_m(pose);
    let edges: [_; 4] = std::array::from_fn(|index| (corners[index], corners[(index + 1) % 4]));
    let inside = |point: Vector2<f64>| edges.iter().all(|&(from, to)| (to - from).perp(&(point - from)) >= 0.0);
    let mut clearance_m = CLEARANCE_MAX_M;
    for segment in &obstacles.segments {
        let (from, to) = (segment.from_m, segment.to_m);
        if inside(from) || edges.iter().any(|edge| segments_cross(edge.0, edge.1, from, to)) {
            return 0.0;
        }
        for (edge_from, edge_to) in edges {
            let nearest_m = distance_to_segment_m(edge_from, from, to)
                .min(distance_to_segment_m(from, edge_from, edge_to))
                .min(distance_to_segment_m(to, edge_from, edge_to));
            clearance_m = clearance_m.min(nearest_m);
        }
    }
    let signed_m = |point_m: Vector2<f64>| {
        let edge_m = edges.iter().map(|&(from, to)| distance_to_segment_m(point_m, from, to));
        let nearest_m = edge_m.fold(f64::INFINITY, f64::min);
        if inside(point_m) { -nearest_m } else { nearest_m }
    };
    for circle in &obstacles.circles {
        clearance_m = clearance_m.min(signed_m(circle.centre_m) - circle.radius_m);
    }
    clearance_m.min(obstacles.solids.gap_m(z_m, signed_m))
}

/// The pose after moving at constant `velocity` for `dt_s`: an arc, exactly.
pub(super) fn moved(pose: &Pose2, velocity: Velocity, dt_s: f64) -> Pose2 {
    let turn_rad = velocity.angular_rad_s * dt_s;
    let way_m = velocity.linear_m_s * dt_s;
    let half_rad = 0.5 * turn_rad;
    // The chord of the arc; its direction is half the turn off the heading.
    let chord_m = if half_rad.abs() < 1e-9 { way_m } else { way_m * half_rad.sin() / half_rad };
    let direction_rad = pose.heading_rad + half_rad;
    Pose2 {
        x_m: pose.x_m + chord_m * direction_rad.cos(),
        y_m: pose.y_m + chord_m * direction_rad.sin(),
        heading_rad: wrap_angle_rad(pose.heading_rad + turn_rad),
    }
}
