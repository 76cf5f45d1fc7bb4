//! Drives a planned path, edge by edge: follows, stops at an obstacle and measures it, goes round it where there is room, returns.
//!
//! Goes in: a scan, the pose of odometry, the time. Comes out: an [`ObstacleReport`], with the velocity that is wished; whoever drives
//! has the last word. The *desired edge* is the piece of the path, or of a sub-route, that is to be driven now; the *actual edge*
//! leads from the robot to its end (paper 001, section 2.1). The detector is exchangeable: vector projection, or the classical one, to
//! compare. A pure state machine with injected time; allocates nothing after it was made.
//!
//! ```text
//! FOLLOW ── detected ──► MEASURE ── room ──► PASS ── past the far end ──► RETURN ── on the edge ──► FOLLOW … ARRIVED
//!    ▲                    │   └── no room ──► BLOCKED ── gone, or room now ──► FOLLOW, PASS
//!    └── not in the way ──┘
//! ```

use super::local_map::LocalMap;
use super::obstacle::{self, Measured, SubRoute};
use super::params::ProjectionParams;
use super::projection::{self, Edge, EightSonars, Projection, SONARS};
use super::virtual_sonar::SonarReading;
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::{Reading, RobotScan, Velocity};
use crate::time::Stamp;
use nalgebra::Vector2;
use std::f64::consts::{FRAC_PI_4, PI};

/// Scans in a row that must detect before the robot stops: one ping may hear a ghost.
const TRIGGER_COUNT: u32 = 2;
/// Scans in a row that do not see ahead before the robot waits: one ping may be lost.
const UNSEEN_COUNT: u32 = 5;
/// Time of standing still in which an obstacle is measured.
const MEASURE_S: f64 = 0.7;
/// Time without a detection after which a way that was blocked counts as free.
const FREE_AFTER_S: f64 = 1.0;
/// Time between two looks whether there is room by now.
const LOOK_AGAIN_S: f64 = 2.0;
/// Times that one obstacle is measured before the way counts as blocked.
const ATTEMPTS_MAX: u32 = 6;
/// Progress along the edge after which an obstacle is another one.
const PROGRESS_M: f64 = 0.5;
/// An end of an edge is reached within this distance.
const REACH_M: f64 = 0.1;
/// The point beside an obstacle must be reached nearer: what is missing there is missing from the clearance.
const ENTRY_REACH_M: f64 = 0.04;
/// On a sub-route only what stands within this share of the safe width counts: the obstacle itself stands beside it.
const SUB_ROUTE_SHARE: f64 = 0.42;
/// How far outside the safe path a reflector may be heard that is on it.
const PATH_SLACK_M: f64 = 0.02;
/// What lies within this of the way must be seen so far from the robot's middle, but for a share: shadows of echoes, one lost bearing.
const AHEAD_RAD: f64 = FRAC_PI_4;
const SIGHT_M: f64 = 0.4;
const UNSEEN_SHARE: f64 = 0.25;
/// The follower steers for a point this far ahead on its edge.
const LOOK_AHEAD_M: f64 = 0.4;
/// It turns on the spot beyond the first of these errors of heading, until below the second.
const TURN_FROM_RAD: f64 = 35.0 * PI / 180.0;
const TURN_TO_RAD: f64 = 5.0 * PI / 180.0;
/// Farthest place that odometry may tell.
const POSE_MAX_M: f64 = 1e6;
/// Turn rate per error of heading, and at most.
const TURN_GAIN_PER_S: f64 = 2.0;
const TURN_MAX_RAD_S: f64 = 0.8;
/// Speed per distance to an end at which it stops or turns, and at least.
const BRAKE_PER_S: f64 = 0.8;
const CREEP_M_S: f64 = 0.05;

/// What says that there is an obstacle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Detector {
    /// A projection on the actual edge above the threshold.
    Projection,
    /// Any reading below the limit.
    Classical {
        /// The limit, from the transducer.
        limit_m: f64,
    },
}

/// What the follower does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FollowerState {
    /// There is no path.
    #[default]
    Idle,
    /// Drives along the edge.
    Follow,
    /// Stands and measures an obstacle.
    Measure,
    /// Drives past an obstacle.
    Pass,
    /// Drives back to the edge.
    Return,
    /// Waits: there is no way round, or none is known.
    Blocked,
    /// The path is done.
    Arrived,
}

/// What detector and follower say after a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObstacleReport {
    /// What the follower does.
    pub state: FollowerState,
    /// Index of the planned edge, without a path none.
    pub edge_index: Option<usize>,
    /// Distance of the robot from the edge that is driven, that of the path or of the sub-route; not a number without one.
    pub edge_distance_m: f64,
    /// Distance beyond which the detector is blind.
    pub blind_beyond_m: f64,
    /// It is blind: that nothing is detected then means nothing.
    pub blind: bool,
    /// What lies ahead is not seen: after some scans the robot waits.
    pub cannot_see: bool,
    /// Projection of each sonar's vector on the actual edge, 0 to 10.
    pub projections: [f64; SONARS],
    /// What each sonar reads.
    pub readings: [Reading; SONARS],
    /// The sonar that detects, the one with the largest projection; with the classical detector the nearest.
    pub sonar: Option<usize>,
    /// Place of the reflector that it reads, in the frame of odometry: the paper's biggest valued point.
    pub detected_m: Option<Vector2<f64>>,
    /// The obstacle, from MEASURE until the robot is back on the edge.
    pub obstacle: Option<Measured>,
    /// Points of the sub-route.
    pub route_m: [Vector2<f64>; 4],
    /// How many there are.
    pub route_count: usize,
    /// The velocity wished.
    pub wish: Velocity,
}

/// Follows the path of its parameters.
#[derive(Debug, Clone)]
pub struct PathFollower {
    params: ProjectionParams,
    detector: Detector,
    sonars: EightSonars,
    map: LocalMap,
    state: FollowerState,
    since_s: f64,
    edge_index: usize,
    /// Piece of the sub-route that is driven.
    leg: usize,
    route: Option<SubRoute>,
    measured: Option<Measured>,
    biggest_m: Vector2<f64>,
    alarms: u32,
    alarmed_s: f64,
    unseen: u32,
    attempts: u32,
    attempted_at_m: f64,
    /// Along the edge: up to here only the safe path counts, since what was measured stands beside it.
    dismissed_to_m: f64,
    turning: bool,
}

/// What one scan says of the edge that is driven.
struct Sighting {
    readings: [SonarReading; SONARS],
    projection: Projection,
    sonar: Option<usize>,
    place_m: Option<Vector2<f64>>,
    cannot_see: bool,
}

impl PathFollower {
    /// A follower of `params.path_m`.
    #[must_use]
    pub fn new(params: &ProjectionParams, detector: Detector) -> Self {
        let range_m = match detector {
            Detector::Projection => params.range_max_m,
            Detector::Classical { limit_m } => params.range_max_m.max(limit_m),
        };
        let mut follower = Self {
            sonars: EightSonars::new(params.cone_deg, range_m),
            params: params.clone(),
            detector,
            map: LocalMap::new(),
            state: FollowerState::Idle,
            since_s: 0.0,
            edge_index: 0,
            leg: 0,
            route: None,
            measured: None,
            biggest_m: Vector2::zeros(),
            alarms: 0,
            alarmed_s: f64::NEG_INFINITY,
            unseen: 0,
            attempts: 0,
            attempted_at_m: f64::NEG_INFINITY,
            dismissed_to_m: f64::NEG_INFINITY,
            turning: false,
        };
        follower.reset();
        follower
    }

    /// Forgets what was seen and begins the path anew: the frame of odometry is another one.
    pub fn reset(&mut self) {
        self.map.clear();
        self.state = if self.edge_count() == 0 { FollowerState::Idle } else { FollowerState::Follow };
        self.edge_index = 0;
        self.forget_obstacle();
    }

    /// The memory of reflectors.
    #[must_use]
    pub fn map(&self) -> &LocalMap {
        &self.map
    }

    /// Takes a scan from `pose` at `now_s`, on any clock that never runs backward.
    pub fn update(&mut self, scan: &RobotScan, pose: &Pose2, now_s: f64) -> ObstacleReport {
        let sound = [pose.x_m, pose.y_m].iter().all(|place_m| place_m.abs() <= POSE_MAX_M);
        if !(sound && pose.heading_rad.is_finite()) {
            // Nobody knows where the robot is: what was remembered is somewhere else now.
            self.map.clear();
            let mut sighting = self.idle(scan);
            sighting.projection.blind = true;
            return self.report(None, &sighting);
        }
        self.map.add(scan, pose, now_s);
        let Some(planned) = self.planned() else { return self.report(None, &self.idle(scan)) };
        let desired = self.desired(&planned);
        let sighting = self.look(scan, pose, &planned, &desired);
        self.note(&sighting, now_s);
        if self.state != FollowerState::Arrived {
            self.step((scan, pose, now_s), &planned, &sighting);
        }
        // The state may have changed what is to be driven.
        let planned = self.planned().unwrap_or(planned);
        let desired = self.desired(&planned);
        let wish = self.wish(pose, &desired, &sighting);
        let mut report = self.report(Some(desired.distance_m(pose.position_m())), &sighting);
        report.wish = wish;
        report
    }

    fn edge_count(&self) -> usize {
        self.params.path_m.len().saturating_sub(1)
    }

    /// The edge of the path.
    fn planned(&self) -> Option<Edge> {
        let index = self.edge_index.min(self.edge_count().checked_sub(1)?);
        let [start_m, end_m] = [index, index + 1].map(|index| Vector2::from(self.params.path_m[index]));
        Some(Edge { start_m, end_m })
    }

    /// The edge that is driven: of the path, or of the sub-route.
    fn desired(&self, planned: &Edge) -> Edge {
        match self.route.filter(|_| matches!(self.state, FollowerState::Pass | FollowerState::Return)) {
            Some(route) => Edge { start_m: route.points_m[self.leg], end_m: route.points_m[self.leg + 1] },
            None => *planned,
        }
    }

    fn idle(&self, scan: &RobotScan) -> Sighting {
        Sighting {
            readings: self.sonars.read(scan),
            projection: Projection { projections: [0.0; SONARS], sonar: None, blind: false },
            sonar: None,
            place_m: None,
            cannot_see: false,
        }
    }

    fn look(&self, scan: &RobotScan, pose: &Pose2, planned: &Edge, desired: &Edge) -> Sighting {
        let readings = self.sonars.read(scan);
        let place_m = |reading: &SonarReading| {
            let peak = scan.peaks.get(reading.peak?)?;
            Some(pose.parent_from_local(peak.position_m))
        };
        let counts = |reading: &SonarReading| {
            let all = matches!(self.detector, Detector::Classical { .. });
            all || place_m(reading).is_none_or(|place_m| self.counts(place_m, pose, planned, desired))
        };
        let ranges_m = readings.map(|reading| reading.range_m().filter(|_| counts(&reading)));
        let projection = projection::project(&self.params, &ranges_m, pose, desired);
        let sonar = match self.detector {
            Detector::Projection => projection.sonar,
            Detector::Classical { limit_m } => projection::classical(&ranges_m, limit_m),
        };
        let cannot_see = cannot_see(scan, desired.direction_rad(pose.position_m()) - pose.heading_rad);
        Sighting { place_m: sonar.and_then(|sonar| place_m(&readings[sonar])), readings, projection, sonar, cannot_see }
    }

    /// Whether a reflector may stop the robot.
    fn counts(&self, place_m: Vector2<f64>, pose: &Pose2, planned: &Edge, desired: &Edge) -> bool {
        let safe_m = self.params.safe_width_m;
        if matches!(self.state, FollowerState::Pass | FollowerState::Return) {
            // What lies behind is left behind, however near it is.
            let ahead = desired.local_m(place_m).x > desired.local_m(pose.position_m()).x;
            return ahead && desired.distance_m(place_m) <= SUB_ROUTE_SHARE * safe_m;
        }
        let dismissed = planned.local_m(pose.position_m()).x < self.dismissed_to_m;
        !(self.params.safe_path_only || dismissed) || planned.distance_m(place_m) <= 0.5 * safe_m + PATH_SLACK_M
    }

    /// Counts detections and unseen cones.
    fn note(&mut self, sighting: &Sighting, now_s: f64) {
        self.alarms = if sighting.sonar.is_some() { self.alarms + 1 } else { 0 };
        self.unseen = if sighting.cannot_see { self.unseen + 1 } else { 0 };
        if sighting.sonar.is_some() {
            self.alarmed_s = now_s;
            if !matches!(self.state, FollowerState::Measure | FollowerState::Blocked)
                && let Some(place_m) = sighting.place_m
            {
                self.biggest_m = place_m;
            }
        }
    }

    fn step(&mut self, (scan, pose, now_s): (&RobotScan, &Pose2, f64), planned: &Edge, sighting: &Sighting) {
        let along_m = planned.local_m(pose.position_m()).x;
        match self.state {
            FollowerState::Idle | FollowerState::Arrived => {}
            FollowerState::Follow | FollowerState::Pass | FollowerState::Return if self.alarms >= TRIGGER_COUNT => {
                if (along_m - self.attempted_at_m).abs() > PROGRESS_M {
                    self.attempts = 0;
                }
                self.attempts += 1;
                self.attempted_at_m = along_m;
                self.enter(FollowerState::Measure, now_s);
            }
            FollowerState::Follow => self.follow(pose, planned, sighting, now_s),
            FollowerState::Measure if now_s - self.since_s >= MEASURE_S => self.judge((scan, pose, now_s), planned),
            FollowerState::Measure => {}
            FollowerState::Pass => self.pass(pose, planned, now_s),
            FollowerState::Return => {
                if self.is_reached(pose, &self.desired(planned)) {
                    self.forget_obstacle();
                    self.enter(FollowerState::Follow, now_s);
                }
            }
            FollowerState::Blocked if now_s - self.alarmed_s >= FREE_AFTER_S => {
                self.forget_obstacle();
                self.enter(FollowerState::Follow, now_s);
            }
            FollowerState::Blocked if now_s - self.since_s >= LOOK_AGAIN_S && self.attempts <= ATTEMPTS_MAX => {
                self.judge((scan, pose, now_s), planned);
            }
            FollowerState::Blocked => {}
        }
    }

    fn follow(&mut self, pose: &Pose2, planned: &Edge, sighting: &Sighting, now_s: f64) {
        if self.is_reached(pose, planned) {
            self.dismissed_to_m = f64::NEG_INFINITY;
            if self.edge_index + 1 < self.edge_count() {
                self.edge_index += 1;
            } else {
                self.enter(FollowerState::Arrived, now_s);
            }
        } else if sighting.projection.blind {
            // Off the edge the detector is blind: the way back is an edge of its own, on which it is not.
            let at_m = planned.local_m(pose.position_m());
            let foot_m = Vector2::new((at_m.x + at_m.y.abs()).clamp(0.0, planned.length_m()), 0.0);
            let (here_m, there_m) = (pose.position_m(), planned.point_m(foot_m));
            self.route = Some(SubRoute { points_m: [here_m, here_m, here_m, there_m], across_m: at_m.y });
            self.leg = 2;
            self.enter(FollowerState::Return, now_s);
        }
    }

    /// What is to be done about the obstacle that was just measured.
    fn judge(&mut self, (scan, pose, now_s): (&RobotScan, &Pose2, f64), planned: &Edge) {
        let measured = obstacle::measure(&self.map, scan, pose, planned, self.biggest_m, &self.params);
        self.measured = Some(measured);
        if self.detector == Detector::Projection && !measured.in_the_way {
            self.dismissed_to_m = measured.along_far_m.max(planned.local_m(pose.position_m()).x) + PROGRESS_M;
            (self.route, self.measured) = (None, None);
            self.enter(FollowerState::Follow, now_s);
            return;
        }
        self.route = obstacle::sub_route(&measured, pose, planned, &self.params);
        self.leg = 0;
        let goes = self.route.is_some() && self.attempts <= ATTEMPTS_MAX;
        self.enter(if goes { FollowerState::Pass } else { FollowerState::Blocked }, now_s);
    }

    fn pass(&mut self, pose: &Pose2, planned: &Edge, now_s: f64) {
        let (Some(mut route), Some(mut measured)) = (self.route, self.measured) else {
            self.enter(FollowerState::Follow, now_s);
            return;
        };
        measured.along_far_m = obstacle::far_end_m(&self.map, planned, &measured, &self.params);
        route.end_behind(measured.along_far_m, planned);
        let robot_m = planned.local_m(pose.position_m());
        measured.far_end_seen = self.leg > 0 && robot_m.x > measured.along_far_m;
        (self.route, self.measured) = (Some(route), Some(measured));
        if self.leg == 0 {
            if (route.points_m[1] - pose.position_m()).norm() <= ENTRY_REACH_M {
                self.leg = 1;
            }
        } else if robot_m.x >= planned.local_m(route.points_m[2]).x - 0.5 * REACH_M {
            self.leg = 2;
            self.enter(FollowerState::Return, now_s);
        }
    }

    fn is_reached(&self, pose: &Pose2, edge: &Edge) -> bool {
        let at_m = pose.position_m();
        let beyond = edge.local_m(at_m).x >= edge.length_m() && edge.distance_m(at_m) <= 2.0 * REACH_M;
        (edge.end_m - at_m).norm() <= REACH_M || beyond
    }

    fn enter(&mut self, state: FollowerState, now_s: f64) {
        self.state = state;
        self.since_s = now_s;
        self.alarms = 0;
        self.turning = false;
    }

    fn forget_obstacle(&mut self) {
        (self.route, self.measured, self.leg) = (None, None, 0);
        (self.alarms, self.unseen, self.turning) = (0, 0, false);
    }

    /// The velocity that leads along an edge.
    fn wish(&mut self, pose: &Pose2, desired: &Edge, sighting: &Sighting) -> Velocity {
        let drives = matches!(self.state, FollowerState::Follow | FollowerState::Pass | FollowerState::Return);
        // A detection holds the robot from the first scan on.
        if !drives || self.unseen >= UNSEEN_COUNT || sighting.sonar.is_some() {
            return Velocity::ZERO;
        }
        let at_m = pose.position_m();
        let along_m = (desired.local_m(at_m).x + LOOK_AHEAD_M).clamp(0.0, desired.length_m());
        let to_m = desired.point_m(Vector2::new(along_m, 0.0)) - at_m;
        let error_rad = wrap_angle_rad(to_m.y.atan2(to_m.x) - pose.heading_rad);
        self.turning = error_rad.abs() > if self.turning { TURN_TO_RAD } else { TURN_FROM_RAD };
        let angular_rad_s = (TURN_GAIN_PER_S * error_rad).clamp(-TURN_MAX_RAD_S, TURN_MAX_RAD_S);
        let end_m_s = BRAKE_PER_S * (desired.end_m - at_m).norm() + CREEP_M_S;
        let linear_m_s = if self.turning { 0.0 } else { self.params.speed_m_s.min(end_m_s) * error_rad.cos().max(0.0) };
        Velocity { linear_m_s, angular_rad_s }
    }

    fn report(&self, edge_distance_m: Option<f64>, sighting: &Sighting) -> ObstacleReport {
        let route = self.route.filter(|_| self.measured.is_some());
        ObstacleReport {
            state: self.state,
            edge_index: edge_distance_m.map(|_| self.edge_index),
            edge_distance_m: edge_distance_m.unwrap_or(f64::NAN),
            blind_beyond_m: self.params.edge_distance_max_m,
            blind: sighting.projection.blind,
            cannot_see: sighting.cannot_see,
            projections: sighting.projection.projections,
            readings: sighting.readings.map(|reading| reading.reading),
            sonar: sighting.sonar,
            detected_m: sighting.place_m,
            obstacle: self.measured,
            route_m: route.map_or([Vector2::zeros(); 4], |route| route.points_m),
            route_count: if route.is_some() { 4 } else { 0 },
            wish: Velocity::ZERO,
        }
    }
}

/// Whether too much of what lies ahead is not seen, to drive there. Where an echo is heard is seen; what is behind it does not matter.
fn cannot_see(scan: &RobotScan, way_rad: f64) -> bool {
    let steps = (AHEAD_RAD.to_degrees()) as i32;
    let known = |step: &i32| {
        let ray = &scan.rays[RobotScan::ray_at(way_rad + f64::from(*step).to_radians())];
        matches!(ray.reading, Reading::Echo { .. }) || ray.free_m >= SIGHT_M
    };
    let unknown = (-steps..=steps).filter(|step| !known(step)).count();
    unknown as f64 > UNSEEN_SHARE * f64::from(2 * steps + 1)
}

/// Vector projection along the configured path, as the daemon runs it.
#[derive(Debug, Clone)]
pub struct ProjectionDetector {
    follower: PathFollower,
}

impl ProjectionDetector {
    /// A detector for the path of `params`; it idles without one.
    #[must_use]
    pub fn new(params: &ProjectionParams) -> Self {
        Self { follower: PathFollower::new(params, Detector::Projection) }
    }

    /// Forgets what was seen: the frame of odometry is another one.
    pub fn reset(&mut self) {
        self.follower.reset();
    }

    /// Takes a scan of the moment `at`, and where odometry says that the robot was.
    pub fn update(&mut self, scan: &RobotScan, pose: &Pose2, at: Stamp) -> ObstacleReport {
        self.follower.update(scan, pose, at.boottime_ns as f64 * 1e-9)
    }
}
