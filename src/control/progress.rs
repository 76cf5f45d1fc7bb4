//! Stuck: no progress for a configured time while motion is asked for; and the way out.
//!
//! Goes in: what is asked for, what is commanded, and the odometry where there is one (else the commands are added up).
//! Comes out: whether the robot is stuck, and then what to do about it. Where a turn is wanted the layers below CA probably hold
//! it back, each with good reason, so the first thing is to let the wanted velocity pass for a while; CA goes on guarding it.
//! The other is a turn on the spot, which is safe wherever the robot can stand: a round footprint covers the same ground while
//! it turns. Out of a corner it goes first to the side where the places that were avoided leave the nearer way out, and ends where
//! nothing is near and driving is wanted. Each further turn without progress is half as long again as the first, up to half a turn, and to the other side.

use super::layer::is_driving;
use super::params::StuckParams;
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::Velocity;
use std::f64::consts::PI;

/// Slowest wanted speed that counts as asking for motion.
const ASKED_MIN_M_S: f64 = 0.01;
/// Slowest wanted turn that does.
const ASKED_MIN_RAD_S: f64 = 0.05;
/// A turn that CA rather goes on with than takes back.
const LONG_TURN_RAD: f64 = 1.0;
/// Times that CA may begin to turn the robot without progress in between.
const AVOIDANCES_MAX: u32 = 3;
/// Longest turn out of a corner: by then every direction was tried.
const CORNER_MAX_RAD: f64 = 2.0 * PI;
/// Time to drive off in, after CA has turned the robot.
const NEW_HEADING_S: f64 = 1.5;
/// Silent ping sets in a row that end a turn out of a corner before its time.
const CLEAR_COUNT_MIN: u32 = 3;
/// What collision avoidance may turn before it counts as stuck: what was ahead is then abeam, so something else is near.
const AVOIDING_MAX_RAD: f64 = 1.6;
/// What counts as progress while nothing but turning is asked for.
const TURNED_MIN_RAD: f64 = 0.5;

/// How long the wanted velocity passes before a turn on the spot is tried.
const LET_GO_S: f64 = 4.0;

/// The way out that is being tried.
#[derive(Debug, Clone, Copy)]
enum Escape {
    LetGo { left_s: f64 },
    Turn { turn: f64, turned_rad: f64, left_rad: f64 },
}

/// What a stuck robot does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum WayOut {
    /// What is wanted, unless CA has something against it.
    LetGo,
    /// A turn on the spot: +1 left, -1 right.
    Turn(f64),
}

/// What collision avoidance did on the last ping set, and hears on this one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Avoidance {
    /// +1 or -1: the side it turned to; `None` if it did not act.
    pub(super) turn: Option<f64>,
    /// Whether its region is silent, and whether it is loud enough to fire.
    pub(super) is_clear: bool,
    pub(super) is_loud: bool,
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
    /// The side to which CA turned on the last ping set, if it acted; how often it began to since the last progress, and to which
    /// side.
    avoided: Option<f64>,
    avoidance_count: u32,
    avoidance_turn: f64,
    /// Heading when CA began to turn the robot, how far it has turned since, and whether it may go on undisturbed.
    avoided_from_rad: f64,
    turned_away_rad: f64,
    turns_away: bool,
    /// Ping sets in a row in which the CA region was silent during an escape.
    clear_count: u32,
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
            avoided: None,
            avoidance_count: 0,
            avoidance_turn: 1.0,
            avoided_from_rad: 0.0,
            turned_away_rad: 0.0,
            turns_away: false,
            clear_count: 0,
        }
    }

    /// Takes note of one ping set: what was commanded since the last one, what is asked for now, and what CA did and hears.
    ///
    /// The first time that CA turns the robot away from something counts as progress, up to [`AVOIDING_MAX_RAD`]; a later such turn is
    /// not disturbed, but counts as time without progress.
    pub(super) fn observe(
        &mut self,
        odometry: Option<Pose2>,
        last: Velocity,
        wanted: Velocity,
        avoidance: &Avoidance,
        elapsed_s: f64,
    ) {
        let heading_rad = self.pose.heading_rad;
        self.advance(odometry, last, elapsed_s);
        let begins = avoidance.turn.is_some() && self.avoided.is_none();
        let ends = avoidance.turn.is_none() && self.avoided.is_some();
        self.avoided = avoidance.turn;
        if begins {
            self.avoided_from_rad = heading_rad;
        }
        self.turned_away_rad = wrap_angle_rad(self.pose.heading_rad - self.avoided_from_rad).abs();
        self.turns_away = avoidance.turn.is_some() && self.turned_away_rad < AVOIDING_MAX_RAD;
        if let Some(Escape::Turn { turn, turned_rad, left_rad }) = &mut self.escape {
            let step_rad = *turn * wrap_angle_rad(self.pose.heading_rad - heading_rad);
            *turned_rad += step_rad;
            *left_rad -= step_rad;
            // In a doorway nothing is ever silent: from half a turn on, what would not fire is good enough.
            let quiet = avoidance.is_clear || (!avoidance.is_loud && *turned_rad >= PI);
            self.clear_count = if quiet { self.clear_count.saturating_add(1) } else { 0 };
            let silent = self.avoidance_count > 0 && self.clear_count >= CLEAR_COUNT_MIN;
            // Where no driving is wanted the robot would only be turned back.
            let found = silent && *turned_rad >= TURNED_MIN_RAD && is_driving(wanted);
            if found || !(*left_rad > 0.0) {
                self.escape = None;
                self.restart();
            }
            return;
        }
        if begins {
            self.avoidance_count = self.avoidance_count.saturating_add(1);
        }
        self.avoidance_turn = avoidance.turn.unwrap_or(self.avoidance_turn);
        if ends && self.turned_away_rad >= TURNED_MIN_RAD {
            // A new heading is given the time to prove itself.
            self.since_progress_s = self.since_progress_s.min(self.params.time_s - NEW_HEADING_S);
        }
        let turned_rad = wrap_angle_rad(self.pose.heading_rad - self.anchor.heading_rad).abs();
        let moved_m = (self.pose.position_m() - self.anchor.position_m()).norm();
        let driving = wanted.linear_m_s.abs() >= ASKED_MIN_M_S;
        self.driving_asked |= driving;
        let nothing_asked = !driving && !(wanted.angular_rad_s.abs() >= ASKED_MIN_RAD_S);
        let turned_as_asked = !self.driving_asked && turned_rad >= TURNED_MIN_RAD;
        if nothing_asked || turned_as_asked {
            self.restart();
        } else if moved_m >= self.params.distance_m {
            self.restart();
            (self.escape_count, self.turn_count) = (0, 0);
        } else if !(self.turns_away && self.avoidance_count <= 1) {
            self.since_progress_s += elapsed_s;
        }
        if let Some(Escape::LetGo { left_s }) = &mut self.escape {
            *left_s -= elapsed_s;
            if self.since_progress_s == 0.0 || !(*left_s > 0.0) {
                self.escape = None;
            }
        }
    }

    /// Where the robot is: odometry, or the commands added up.
    pub(super) fn pose(&self) -> Pose2 {
        self.pose
    }

    /// Whether the robot is stuck or on its way out.
    pub(super) fn is_stuck(&self) -> bool {
        self.escape.is_some() || (self.params.enabled && (self.is_cornered() || self.is_late()))
    }

    /// Turned away again and again, and each time back into it; or so far that there is more than what was turned away from.
    fn is_cornered(&self) -> bool {
        let turned_far = self.avoided.is_some() && self.turned_away_rad >= AVOIDING_MAX_RAD;
        self.avoidance_count >= AVOIDANCES_MAX || turned_far
    }

    fn is_late(&self) -> bool {
        !self.turns_away && self.since_progress_s >= self.params.time_s
    }

    /// Whether a turn on the spot out of it is under way.
    pub(super) fn turns_out(&self) -> bool {
        matches!(self.escape, Some(Escape::Turn { .. }))
    }

    /// What a stuck robot does now. `known` is the side, +1 or -1, on which the places that were avoided leave a way out, `quieter`
    /// that of the first turn after progress where there is none.
    pub(super) fn way_out(&mut self, wanted: Velocity, known: Option<f64>, quieter: f64) -> WayOut {
        match self.escape {
            Some(Escape::LetGo { .. }) => return WayOut::LetGo,
            Some(Escape::Turn { turn, .. }) => return WayOut::Turn(turn),
            None => {}
        }
        self.escape_count = self.escape_count.saturating_add(1);
        // Where CA itself holds the robot there is nothing to let go of.
        if self.escape_count == 1 && self.avoidance_count == 0 && wanted.angular_rad_s.abs() >= ASKED_MIN_RAD_S {
            self.escape = Some(Escape::LetGo { left_s: LET_GO_S });
            return WayOut::LetGo;
        }
        let known = known.filter(|_| self.turn_count == 0 && self.avoidance_count > 0);
        let turn = known.unwrap_or(match (self.turn_count, self.avoidance_count) {
            (0, 0 | 1) => quieter,
            // A long turn is not taken back.
            (0, _) if self.turned_away_rad >= LONG_TURN_RAD => self.avoidance_turn,
            // Away from the nearest reflection did not help, however often.
            (0, _) => -self.avoidance_turn,
            _ => -self.last_turn,
        });
        let first_rad = self.params.escape_turn_deg.to_radians();
        let longer = 1.0 + 0.5 * f64::from(self.turn_count.min(4));
        // Out of a corner the turn ends where nothing is near; else where its angle ends.
        let left_rad = if self.avoidance_count > 0 { CORNER_MAX_RAD } else { (first_rad * longer).min(PI) };
        self.clear_count = 0;
        (self.escape, self.last_turn) = (Some(Escape::Turn { turn, turned_rad: 0.0, left_rad }), turn);
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
        // What CA has begun goes on.
        self.avoidance_count = u32::from(self.avoided.is_some());
        self.driving_asked = false;
    }
}
