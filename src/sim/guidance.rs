//! Waypoint guidance for a differential drive, in the spirit of Boucher (Robotica 2016): turn towards the next waypoint,
//! slow down as far as the turn there and the present error of heading ask for.
//!
//! Pose and waypoints in, wanted velocity out. Knows no obstacle; avoiding them is the controller's work.

use super::params::MotionLimits;
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::Velocity;
use nalgebra::Vector2;

/// Turn rate per error of heading.
const HEADING_GAIN_PER_S: f64 = 1.5;
/// Share of the platform's highest turn rate that guidance asks for, so that avoidance has some left.
const TURN_SHARE: f64 = 0.6;
/// Decides what is left of the speed, two fifths of it, while the waypoint lies abeam: a robot that has turned away from something must
/// be able to drive past it. From 134 deg on it turns on the spot.
const SIDEWAYS_SHARE: f64 = 0.7;
/// Share of the cruising speed left for a turn of half a circle at a waypoint.
const SLOWEST_SHARE: f64 = 0.4;

/// The waypoints still to be reached.
#[derive(Debug, Clone)]
pub(super) struct Guidance {
    waypoints_m: Vec<Vector2<f64>>,
    reach_m: f64,
    cruise_m_s: f64,
    next: usize,
    repeat: bool,
    /// Waypoints reached so far, rounds included.
    pub(super) reached: usize,
}

impl Guidance {
    pub(super) fn new(waypoints: &[[f64; 2]], reach_m: f64, cruise_m_s: f64, repeat: bool) -> Self {
        let waypoints_m = waypoints.iter().map(|point| Vector2::from(*point)).collect();
        Self { waypoints_m, reach_m, cruise_m_s, next: 0, repeat, reached: 0 }
    }

    /// The waypoint meant now.
    pub(super) fn target_m(&self) -> Option<Vector2<f64>> {
        self.waypoints_m.get(self.next).copied()
    }

    /// Ticks off waypoints within reach.
    pub(super) fn update(&mut self, pose: &Pose2) {
        // At most one round a call: all waypoints may lie within reach.
        for _ in 0..self.waypoints_m.len() {
            match self.target_m() {
                Some(target_m) if (target_m - pose.position_m()).norm() <= self.reach_m => {
                    self.reached += 1;
                    self.next += 1;
                    if self.repeat && self.next == self.waypoints_m.len() {
                        self.next = 0;
                    }
                }
                _ => return,
            }
        }
    }

    /// Wanted velocity towards the next waypoint; standing still when there is none left.
    pub(super) fn wanted(&self, pose: &Pose2, limits: &MotionLimits) -> Velocity {
        let Some(target_m) = self.target_m() else { return Velocity::ZERO };
        let offset = target_m - pose.position_m();
        let distance_m = offset.norm();
        if distance_m < 1e-6 {
            return Velocity::ZERO;
        }
        let error_rad = wrap_angle_rad(offset.y.atan2(offset.x) - pose.heading_rad);
        let turn_max_rad_s = TURN_SHARE * limits.max_angular_rad_s;
        let angular_rad_s = (HEADING_GAIN_PER_S * error_rad).clamp(-turn_max_rad_s, turn_max_rad_s);
        let cruise_m_s = self.cruise_m_s.abs().min(limits.max_linear_m_s);
        let heading_share = ((error_rad.cos() + SIDEWAYS_SHARE) / (1.0 + SIDEWAYS_SHARE)).max(0.0);
        let there_m_s = cruise_m_s * self.speed_share_at(target_m, offset / distance_m);
        // Braking at half the platform's best from here reaches the waypoint's speed on its circle of reach.
        let braking_m = (distance_m - self.reach_m).max(0.0);
        let approach_m_s = (there_m_s * there_m_s + limits.max_linear_accel_m_s2 * braking_m).sqrt();
        Velocity { linear_m_s: cruise_m_s.min(approach_m_s) * heading_share, angular_rad_s }
    }

    /// How much of the cruising speed the turn at `target_m` allows, coming along `direction`.
    fn speed_share_at(&self, target_m: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        let after = if self.repeat { (self.next + 1) % self.waypoints_m.len() } else { self.next + 1 };
        let Some(after_m) = self.waypoints_m.get(after) else { return 1.0 };
        let onward = after_m - target_m;
        if onward.norm() < 1e-6 {
            return 1.0;
        }
        let straightness = 0.5 + 0.5 * direction.dot(&onward.normalize());
        SLOWEST_SHARE + (1.0 - SLOWEST_SHARE) * straightness
    }
}
