//! A simulated robot that follows a planned path through corridors (paper 001, figures 8 and 9), and how it is scored.
//!
//! Goes in: a robot, a world with a path and obstacles ([`Corridor`]), a detector. Comes out: [`CorridorRun`]. The robot obeys the
//! follower's wish: no layers, no daemon states, so that what is measured is the detector. Truth (what is in the way, what can be
//! passed, how far things are) comes from the world's geometry and never from what was heard. Reads no clock.

mod programme;
mod random;

pub use programme::{CorridorProgramme, CorridorSummary, Entry};

use super::scanning::Scanning;
use super::trial::TrialRig;
use super::{ServiceError, simulator};
use crate::detect::projection::Edge;
use crate::detect::{Detector, FollowerState, PathFollower, ProjectionParams};
use crate::geometry::Pose2;
use crate::imaging::params::Prefer;
use crate::signal::Velocity;
use crate::sim::{Outline, SimParams, Simulator, World};
use crate::time::Stamp;
use nalgebra::Vector2;

/// Time from the end of a ping set to the wheels: that of the daemon and its controller.
const LATENCY_S: f64 = 0.06;
/// A robot that is blocked this long has given up.
const GIVEN_UP_S: f64 = 3.0;
/// A stop belongs to the obstacle within this distance of the reflector that caused it.
const SAME_M: f64 = 0.15;
/// The robot's centre has met an obstacle when it came this near to it.
const MET_M: f64 = 0.6;
/// An obstacle that blocks the way is this near when the robot waits for it.
const BLOCKS_M: f64 = 1.2;
/// Closed walls smaller than this across, and pillars, are obstacles; everything else is the building.
const OBSTACLE_MAX_M: f64 = 1.0;
/// Start of the simulated clock.
const CLOCK_START_NS: u64 = 1_000_000_000_000;

/// Something that stands in a corridor.
#[derive(Debug, Clone, PartialEq)]
pub struct Obstacle {
    /// Its corners, counter-clockwise or not; one point with a radius is a pillar.
    pub points_m: Vec<Vector2<f64>>,
    /// Radius of a pillar, else 0.
    pub radius_m: f64,
    /// Whether it stands on the safe path, so that the robot has to stop at it.
    pub in_the_way: bool,
    /// Whether there is a passage of the safe width beside it; only told of what was drawn, else taken for granted.
    pub passable: bool,
}

/// A world with a path through it.
#[derive(Debug, Clone, PartialEq)]
pub struct Corridor {
    /// What the robot hears and runs into.
    pub world: World,
    /// The planned path.
    pub path_m: Vec<[f64; 2]>,
    /// What stands in it beside the building.
    pub obstacles: Vec<Obstacle>,
}

/// The robot at the time of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CorridorPoint {
    /// Where it was.
    pub pose: Pose2,
    /// What the follower did.
    pub state: FollowerState,
}

/// How a run went.
#[derive(Debug, Clone, PartialEq)]
pub struct CorridorRun {
    /// Obstacles on the safe path that the robot came to.
    pub met: usize,
    /// Of these, those at which it stopped.
    pub detected: usize,
    /// Stops.
    pub stops: usize,
    /// Stops at what is not on the safe path: walls, and obstacles beside it.
    pub false_stops: usize,
    /// Of these, those at the building itself.
    pub wall_stops: usize,
    /// Whether the path was driven to its end.
    pub arrived: bool,
    /// Whether the robot gave up.
    pub blocked: bool,
    /// Whether it was right: what it stood at cannot be passed.
    pub rightly_blocked: bool,
    /// Whether it touched anything.
    pub collided: bool,
    /// Smallest gap between footprint and anything.
    pub min_clearance_m: f64,
    /// Simulated time.
    pub duration_s: f64,
    /// Way driven.
    pub way_m: f64,
    /// Drive, a point a scan.
    pub track: Vec<CorridorPoint>,
}

impl Obstacle {
    /// Distance of a point from it; 0 inside.
    #[must_use]
    pub fn distance_m(&self, point_m: Vector2<f64>) -> f64 {
        let [first_m] = self.points_m[..] else {
            let edges = || {
                (0..self.points_m.len()).map(|index| Edge {
                    start_m: self.points_m[index],
                    end_m: self.points_m[(index + 1) % self.points_m.len()],
                })
            };
            // Inside if a ray along x crosses the outline an odd number of times.
            let crosses = |edge: &Edge| {
                let [low, high] = [edge.start_m - point_m, edge.end_m - point_m];
                (low.y > 0.0) != (high.y > 0.0) && low.x + (high.x - low.x) * low.y / (low.y - high.y) > 0.0
            };
            let inside = edges().filter(crosses).count() % 2 == 1;
            return if inside {
                0.0
            } else {
                edges().map(|edge| edge.distance_m(point_m)).fold(f64::INFINITY, f64::min)
            };
        };
        ((point_m - first_m).norm() - self.radius_m).max(0.0)
    }

    /// Distance from a path, looked at in steps of 1 cm.
    #[must_use]
    pub fn path_distance_m(&self, path_m: &[[f64; 2]]) -> f64 {
        let steps = |pair: &[[f64; 2]]| {
            let [from_m, to_m] = [Vector2::from(pair[0]), Vector2::from(pair[1])];
            let count = ((to_m - from_m).norm() / 0.01).ceil().max(1.0) as usize;
            (0..=count).map(move |step| from_m + (to_m - from_m) * (step as f64 / count as f64))
        };
        path_m.windows(2).flat_map(steps).map(|point_m| self.distance_m(point_m)).fold(f64::INFINITY, f64::min)
    }
}

impl Corridor {
    /// The path from a world's start over its waypoints, its small closed walls and pillars being the obstacles.
    #[must_use]
    pub fn of_world(world: &World, safe_width_m: f64) -> Self {
        let start = &world.start;
        let first = [start.corner[0] + 0.5 * start.size[0], start.corner[1] + 0.5 * start.size[1]];
        let path_m: Vec<[f64; 2]> = std::iter::once(first).chain(world.waypoints.iter().copied()).collect();
        let boxes = world.walls.iter().filter(|wall| wall.closed).map(|wall| Obstacle {
            points_m: wall.points.iter().map(|point| Vector2::from(*point)).collect(),
            radius_m: 0.0,
            in_the_way: false,
            passable: true,
        });
        let pillars = world.pillars.iter().map(|pillar| Obstacle {
            points_m: vec![Vector2::from(pillar.centre)],
            radius_m: pillar.radius_m,
            in_the_way: false,
            passable: true,
        });
        let small = |obstacle: &Obstacle| {
            let from_first = obstacle.points_m.iter().map(|point| (point - obstacle.points_m[0]).norm());
            from_first.fold(0.0, f64::max) <= OBSTACLE_MAX_M
        };
        let mut obstacles: Vec<Obstacle> = boxes.filter(small).chain(pillars).collect();
        for obstacle in &mut obstacles {
            obstacle.in_the_way = obstacle.path_distance_m(&path_m) < 0.5 * safe_width_m;
        }
        // The end of the path ends the run, not a waypoint's circle.
        let world = World { waypoints: Vec::new(), time_limit_s: world.time_limit_s, ..world.clone() };
        Self { world, path_m, obstacles }
    }

    /// A random corridor of 1.2 m with bends and 0 to 3 obstacles, for a robot that needs `safe_width_m`; the same seed gives the same.
    #[must_use]
    pub fn random(seed: u64, safe_width_m: f64) -> Self {
        random::corridor(seed, safe_width_m)
    }

    /// Drives it. `watch` sees every point and ends the run early by returning false.
    ///
    /// # Errors
    /// When the robot does not fit into the start, there is no backend, or a ping set cannot be imaged.
    pub fn drive(
        &self,
        rig: &TrialRig,
        detector: Detector,
        params: &ProjectionParams,
        seed: u64,
        watch: &mut dyn FnMut(&CorridorPoint) -> bool,
    ) -> Result<CorridorRun, ServiceError> {
        let simulator = simulator(rig.config(), rig.setup(), self.world.clone(), SimParams::default(), seed)?;
        let params = ProjectionParams { path_m: self.path_m.clone(), ..params.clone() };
        let mut drive = Drive {
            corridor: self,
            scanning: Scanning::open(rig, Prefer::Cpu)?,
            follower: PathFollower::new(&params, detector),
            met: vec![false; self.obstacles.len()],
            detected: vec![false; self.obstacles.len()],
            blocked_since_s: None,
            run: CorridorRun::begun(&simulator),
            simulator,
        };
        let mut pings = drive.simulator.empty_ping_set();
        let period_s = 1.0 / rig.config().control.rate_hz;
        let mut wish = Velocity::ZERO;
        while !drive.is_over() {
            let now_s = drive.simulator.time_s();
            let now = CLOCK_START_NS + (now_s * 1e9) as u64;
            drive.simulator.ping_set(Stamp { boottime_ns: now, wall_ns: now }, &mut pings);
            let next_wish = drive.look(&pings)?;
            let latency_s = LATENCY_S.min(period_s);
            drive.simulator.step(wish, latency_s);
            drive.simulator.step(next_wish, period_s - latency_s);
            wish = next_wish;
            if !drive.note(watch) {
                break;
            }
        }
        Ok(drive.finish())
    }
}

impl CorridorRun {
    fn begun(simulator: &Simulator) -> Self {
        Self {
            met: 0,
            detected: 0,
            stops: 0,
            false_stops: 0,
            wall_stops: 0,
            arrived: false,
            blocked: false,
            rightly_blocked: false,
            collided: false,
            min_clearance_m: simulator.clearance_m(),
            duration_s: 0.0,
            way_m: 0.0,
            track: Vec::new(),
        }
    }
}

/// A run under way.
struct Drive<'a> {
    corridor: &'a Corridor,
    simulator: Simulator,
    scanning: Scanning,
    follower: PathFollower,
    met: Vec<bool>,
    detected: Vec<bool>,
    blocked_since_s: Option<f64>,
    run: CorridorRun,
}

impl Drive<'_> {
    fn is_over(&self) -> bool {
        let now_s = self.simulator.time_s();
        self.run.collided
            || self.run.arrived
            || self.blocked_since_s.is_some_and(|since_s| now_s - since_s >= GIVEN_UP_S)
            || now_s >= self.corridor.world.time_limit_s
    }

    /// Scans, asks the follower and books its stops.
    fn look(&mut self, pings: &crate::signal::PingSet) -> Result<Velocity, ServiceError> {
        let (pose, now_s) = (self.simulator.odometry().pose, self.simulator.time_s());
        let before = self.run.track.last().map(|point| point.state);
        let scan = self.scanning.look(pings)?;
        let report = self.follower.update(scan, &pose, now_s);
        let stopped = report.state == FollowerState::Measure && before != Some(FollowerState::Measure);
        if let Some(place_m) = report.detected_m.filter(|_| stopped) {
            self.stopped_at(place_m);
        }
        self.run.arrived = report.state == FollowerState::Arrived;
        let blocked = report.state == FollowerState::Blocked;
        self.blocked_since_s = blocked.then(|| self.blocked_since_s.unwrap_or(now_s));
        self.run.track.push(CorridorPoint { pose: self.simulator.pose(), state: report.state });
        Ok(report.wish)
    }

    fn stopped_at(&mut self, place_m: Vector2<f64>) {
        self.run.stops += 1;
        let obstacles = &self.corridor.obstacles;
        let distance_m = |index: &usize| obstacles[*index].distance_m(place_m);
        let nearest = (0..obstacles.len()).min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
        match nearest.filter(|index| distance_m(index) <= SAME_M) {
            Some(index) if obstacles[index].in_the_way => self.detected[index] = true,
            Some(_) => self.run.false_stops += 1,
            None => {
                self.run.false_stops += 1;
                self.run.wall_stops += 1;
            }
        }
    }

    /// Keeps the score after a period; whether the watcher wants more.
    fn note(&mut self, watch: &mut dyn FnMut(&CorridorPoint) -> bool) -> bool {
        let (before, place_m) = (self.run.track.last().copied(), self.simulator.pose().position_m());
        self.run.way_m += before.map_or(0.0, |point| (place_m - point.pose.position_m()).norm());
        self.run.min_clearance_m = self.run.min_clearance_m.min(self.simulator.clearance_m());
        self.run.collided |= self.simulator.contact();
        for (met, obstacle) in self.met.iter_mut().zip(&self.corridor.obstacles) {
            *met |= obstacle.distance_m(place_m) <= MET_M;
        }
        before.is_none_or(|point| watch(&point))
    }

    fn finish(mut self) -> CorridorRun {
        let place_m = self.simulator.pose().position_m();
        let in_the_way = |index: &usize| self.corridor.obstacles[*index].in_the_way;
        let on_path: Vec<usize> = (0..self.corridor.obstacles.len()).filter(in_the_way).collect();
        self.run.met = on_path.iter().filter(|index| self.met[**index] || self.detected[**index]).count();
        self.run.detected = on_path.iter().filter(|index| self.detected[**index]).count();
        self.run.blocked = self.blocked_since_s.is_some() && !self.run.collided;
        let stands_at =
            |obstacle: &Obstacle| obstacle.in_the_way && !obstacle.passable && obstacle.distance_m(place_m) <= BLOCKS_M;
        self.run.rightly_blocked = self.run.blocked && self.corridor.obstacles.iter().any(stands_at);
        self.run.duration_s = self.simulator.time_s();
        self.run
    }
}

/// Straight pieces of everything that stands in a world, circles as polygons of `corners` corners around them: what edges are drawn
/// between.
#[must_use]
pub fn wall_pieces(world: &World, corners: usize) -> Vec<[Vector2<f64>; 2]> {
    let mut pieces = Vec::new();
    for outline in world.outline(0.0) {
        match outline {
            Outline::Segment { from_m, to_m } => pieces.push([from_m, to_m]),
            Outline::Circle { centre_m, radius_m, moving: false } => {
                // Around the circle: what stands in a corridor must not look smaller than it is.
                let reach_m = radius_m / (std::f64::consts::PI / corners as f64).cos();
                let corner = |index: usize| {
                    let turn = std::f64::consts::TAU * index as f64 / corners as f64;
                    centre_m + reach_m * Vector2::new(turn.cos(), turn.sin())
                };
                pieces.extend((0..corners).map(|index| [corner(index), corner((index + 1) % corners)]));
            }
            Outline::Circle { .. } => {}
        }
    }
    pieces
}
