//! Stuck: no progress for a configured time while motion is asked for; and the way out.
//!
//! Goes in: what is asked for, what is commanded, and the odometry where there is one (else the commands are added up).
//! Comes out: whether the robot is stuck, and then what to do about it. Where a turn is wanted the layers below CA probably hold
//! it back, each with good reason, so the first thing is to let the wanted velocity pass for a while; CA goes on guarding it.
//! The other is a turn on the spot, which is safe wherever the robot can stand: a round footprint covers the same ground while
//! it turns. Each further turn without progress is half as long again as the first, up to half a turn, and to the other side.

use super::params::StuckParams;
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::Velocity;
use std::f64::consts::PI;

/// Slowest wanted speed that counts as asking for motion.
const ASKED_MIN_M_S: f64 = 0.01;
/// Slowest wanted turn that does.
const ASKED_MIN_RAD_S: f64 = 0.05;
/// What counts as progress while nothing but turning is asked for.
const TURNED_MIN_RAD: f64 = 0.5;

/// How long the wanted velocity passes before a turn on the spot is tried.
const LET_GO_S: f64 = 4.0;

/// The way out that is being tried.
#[derive(Debug, Clone, Copy)]
enum Escape {
    LetGo { left_s: f64 },
    Turn { turn: f64, left_rad: f64 },
}

/// What a stuck robot does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum WayOut {
    /// What is wanted, unless CA has something against it.
    LetGo,
    /// A turn on the spot: +1 left, -1 right.
    Turn(f64),
}

/// Watches the robot's progress.
#[derive(Debug, Clone)]
pub(super) struct Progress {
    params: StuckParams,
    /// Where the robot is: odometry, or the commands added up.
    pose: Pose2,
    uses_odometry: bool,
    anchor: Pose2,
    since_progress_s: f64,
    /// Whether driving, not only turning, was asked for since the last progress.
    driving_asked: bool,
    escape: Option<Escape>,
    /// Ways out that were tried since the last progress, the turns among them, and the side of the last turn.
    escape_count: u32,
    turn_count: u32,
    last_turn: f64,
}

impl Progress {
    pub(super) fn new(params: &StuckParams) -> Self {
        Self {
            params: params.clone(),
            pose: Pose2::default(),
            uses_odometry: false,
            anchor: Pose2::default(),
            since_progress_s: 0.0,
            driving_asked: false,
            escape: None,
            escape_count: 0,
            turn_count: 0,
            last_turn: 1.0,
        }
    }

    /// Takes note of one ping set: what was commanded since the last one, and what is asked for now.
    pub(super) fn observe(&mut self, odometry: Option<Pose2>, last: Velocity, wanted: Velocity, elapsed_s: f64) {
        let heading_rad = self.pose.heading_rad;
        self.advance(odometry, last, elapsed_s);
        if let Some(Escape::Turn { turn, left_rad }) = &mut self.escape {
            *left_rad -= *turn * wrap_angle_rad(self.pose.heading_rad - heading_rad);
            if !(*left_rad > 0.0) {
                self.escape = None;
                self.restart();
            }
            return;
        }
        let moved_m = (self.pose.position_m() - self.anchor.position_m()).norm();
        let turned_rad = wrap_angle_rad(self.pose.heading_rad - self.anchor.heading_rad).abs();
        let driving = wanted.linear_m_s.abs() >= ASKED_MIN_M_S;
        self.driving_asked |= driving;
        let nothing_asked = !driving && !(wanted.angular_rad_s.abs() >= ASKED_MIN_RAD_S);
        let turned_as_asked = !self.driving_asked && turned_rad >= TURNED_MIN_RAD;
        if nothing_asked || turned_as_asked {
            self.restart();
        } else if moved_m >= self.params.distance_m {
            self.restart();
            (self.escape_count, self.turn_count) = (0, 0);
        } else {
            self.since_progress_s += elapsed_s;
        }
        if let Some(Escape::LetGo { left_s }) = &mut self.escape {
            *left_s -= elapsed_s;
            if self.since_progress_s == 0.0 || !(*left_s > 0.0) {
                self.escape = None;
            }
        }
    }

    /// Whether the robot is stuck or on its way out.
    pub(super) fn is_stuck(&self) -> bool {
        self.escape.is_some() || (self.params.enabled && self.since_progress_s >= self.params.time_s)
    }

    /// What a stuck robot does now. `preferred` is the side of the first turn after progress, +1 or -1.
    pub(super) fn way_out(&mut self, wanted: Velocity, preferred: f64) -> WayOut {
        match self.escape {
            Some(Escape::LetGo { .. }) => return WayOut::LetGo,
            Some(Escape::Turn { turn, .. }) => return WayOut::Turn(turn),
            None => {}
        }
        self.escape_count = self.escape_count.saturating_add(1);
        if self.escape_count == 1 && wanted.angular_rad_s.abs() >= ASKED_MIN_RAD_S {
            self.escape = Some(Escape::LetGo { left_s: LET_GO_S });
            return WayOut::LetGo;
        }
        let turn = if self.turn_count == 0 { preferred } else { -self.last_turn };
        let first_rad = self.params.escape_turn_deg.to_radians();
        let left_rad = (first_rad * (1.0 + 0.5 * f64::from(self.turn_count.min(4)))).min(PI);
        (self.escape, self.last_turn) = (Some(Escape::Turn { turn, left_rad }), turn);
        self.turn_count = self.turn_count.saturating_add(1);
        WayOut::Turn(turn)
    }

    fn advance(&mut self, odometry: Option<Pose2>, last: Velocity, elapsed_s: f64) {
        let finite = |pose: &Pose2| pose.x_m.is_finite() && pose.y_m.is_finite() && pose.heading_rad.is_finite();
        match odometry.filter(finite) {
            Some(pose) => {
                if !self.uses_odometry {
                    self.uses_odometry = true;
                    self.anchor = pose;
                }
                self.pose = pose;
            }
            None => {
                let turned_rad = last.angular_rad_s * elapsed_s;
                let (sin, cos) = (self.pose.heading_rad + 0.5 * turned_rad).sin_cos();
                self.pose.x_m += last.linear_m_s * elapsed_s * cos;
                self.pose.y_m += last.linear_m_s * elapsed_s * sin;
                self.pose.heading_rad = wrap_angle_rad(self.pose.heading_rad + turned_rad);
            }
        }
    }

    fn restart(&mut self) {
        self.anchor = self.pose;
        self.since_progress_s = 0.0;
        self.driving_asked = false;
    }
}
