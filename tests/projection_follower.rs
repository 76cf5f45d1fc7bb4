//! Contract: the follower of a planned path drives it, stops at what is in the way, goes round it where there is room, waits where there
//! is none, tells when it is blind or cannot see, and allocates nothing. The robot here is a point with a heading, its scans are plain geometry.

mod counting;

use counting::allocations_of;
use nalgebra::Vector2;
use noctule::detect::{Detector, FollowerState, ObstacleReport, PathFollower, ProjectionParams};
use noctule::geometry::Pose2;
use noctule::signal::{Peak, Ray, Reading, RobotScan};

const PERIOD_S: f64 = 0.1;

/// A corridor of 1.2 m along x with things in it that are points.
struct Scene {
    walls: bool,
    points_m: Vec<[f64; 2]>,
    seen: bool,
}

impl Scene {
    /// What is heard at a pose: the foot of the perpendicular on either wall, and the points.
    fn hear(&self, pose: &Pose2, scan: &mut RobotScan) {
        let free =
            if self.seen { Ray { reading: Reading::Clear, free_m: 3.0, ..Ray::default() } } else { Ray::default() };
        scan.rays.fill(free);
        scan.peaks.clear();
        let walls = [[pose.x_m, 0.6], [pose.x_m, -0.6]];
        let heard = self.points_m.iter().chain(walls.iter().filter(|_| self.walls));
        for place in heard.filter(|_| self.seen) {
            let position_m = pose.local_from_parent(Vector2::from(*place));
            if position_m.norm() < 2.0 {
                let (sensor_m, energy) = (Vector2::zeros(), 0.1);
                let peak = Peak {
                    position_m,
                    sensor_m,
                    range_sigma_m: 0.003,
                    bearing_sigma_rad: 0.02,
                    energy,
                    sensor_index: 0,
                };
                scan.peaks.push(peak);
            }
        }
        scan.peaks.sort_by(|a, b| a.position_m.norm().total_cmp(&b.position_m.norm()));
    }
}

struct Drive {
    scene: Scene,
    follower: PathFollower,
    scan: RobotScan,
    pose: Pose2,
    now_s: f64,
    nearest_m: f64,
    states: Vec<FollowerState>,
}

impl Drive {
    fn new(scene: Scene, path_m: &[[f64; 2]], start: Pose2) -> Self {
        let params = ProjectionParams { path_m: path_m.to_vec(), ..ProjectionParams::default() };
        Self {
            scene,
            follower: PathFollower::new(&params, Detector::Projection),
            scan: RobotScan::unseen(),
            pose: start,
            now_s: 0.0,
            nearest_m: f64::INFINITY,
            states: Vec::with_capacity(10_000),
        }
    }

    /// One scan and a tenth of a second of what is wished, counting allocations.
    fn step(&mut self) -> (ObstacleReport, u64) {
        self.scene.hear(&self.pose, &mut self.scan);
        let (report, allocations) = allocations_of(|| self.follower.update(&self.scan, &self.pose, self.now_s));
        self.pose.heading_rad += report.wish.angular_rad_s * PERIOD_S;
        self.pose.x_m += report.wish.linear_m_s * PERIOD_S * self.pose.heading_rad.cos();
        self.pose.y_m += report.wish.linear_m_s * PERIOD_S * self.pose.heading_rad.sin();
        self.now_s += PERIOD_S;
        for point in &self.scene.points_m {
            self.nearest_m = self.nearest_m.min((self.pose.position_m() - Vector2::from(*point)).norm());
        }
        if self.states.last() != Some(&report.state) {
            self.states.push(report.state);
        }
        (report, allocations)
    }

    /// Drives until a state or for so many seconds.
    fn until(&mut self, state: FollowerState, limit_s: f64) -> ObstacleReport {
        let end_s = self.now_s + limit_s;
        loop {
            let (report, allocations) = self.step();
            assert_eq!(allocations, 0, "{report:?}");
            if report.state == state || self.now_s > end_s {
                return report;
            }
        }
    }
}

fn corridor(points_m: &[[f64; 2]]) -> Scene {
    Scene { walls: true, points_m: points_m.to_vec(), seen: true }
}

const ALONG_X: [[f64; 2]; 2] = [[0.0, 0.0], [4.0, 0.0]];

#[test]
fn without_a_path_it_idles() {
    let mut drive = Drive::new(corridor(&[]), &[], Pose2::default());
    let report = drive.step().0;
    assert_eq!((report.state, report.edge_index), (FollowerState::Idle, None));
    assert!(report.edge_distance_m.is_nan() && report.wish.linear_m_s == 0.0 && report.wish.angular_rad_s == 0.0);
}

#[test]
fn a_free_path_is_driven_edge_by_edge_to_its_end() {
    let open = Scene { walls: false, points_m: Vec::new(), seen: true };
    let mut drive = Drive::new(open, &[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [3.5, 3.5]], Pose2::default());
    let mut edges = Vec::new();
    loop {
        let (report, allocations) = drive.step();
        assert_eq!(allocations, 0);
        assert!(report.edge_distance_m < 0.2, "{report:?}");
        if edges.last() != Some(&report.edge_index) {
            edges.push(report.edge_index);
        }
        if report.state == FollowerState::Arrived || drive.now_s > 90.0 {
            break;
        }
    }
    assert_eq!(edges, [Some(0), Some(1), Some(2)]);
    assert_eq!(drive.states, [FollowerState::Follow, FollowerState::Arrived]);
    assert!((drive.pose.position_m() - Vector2::new(3.5, 3.5)).norm() <= 0.12, "{:?}", drive.pose);
}

#[test]
fn an_obstacle_with_room_beside_it_is_measured_passed_and_left_behind() {
    // The corners of a box on the right wall, and where it meets the wall.
    let obstacle = [[2.0, -0.1], [2.3, -0.1], [2.0, -0.6], [2.3, -0.6]];
    let mut drive = Drive::new(corridor(&obstacle), &ALONG_X, Pose2::default());
    let stopped = drive.until(FollowerState::Measure, 30.0);
    assert!((stopped.detected_m.expect("a place") - Vector2::new(2.0, -0.1)).norm() < 1e-6, "{stopped:?}");
    assert!(stopped.wish.linear_m_s == 0.0 && drive.pose.x_m < 1.7);
    let passes = drive.until(FollowerState::Pass, 5.0);
    let obstacle = passes.obstacle.expect("measured");
    assert!(obstacle.in_the_way && (obstacle.across_left_m + 0.1).abs() < 1e-6, "{obstacle:?}");
    assert!((obstacle.left.width_m().expect("known") - 0.7).abs() < 0.01, "{obstacle:?}");
    assert_eq!(passes.route_count, 4);
    let done = drive.until(FollowerState::Arrived, 60.0);
    assert_eq!(done.state, FollowerState::Arrived, "{:?}", drive.states);
    use FollowerState::{Arrived, Follow, Measure, Pass, Return};
    assert_eq!(drive.states, [Follow, Measure, Pass, Return, Follow, Arrived]);
    // Nothing came within half a safe width of the robot's middle, less what following a corner costs.
    assert!(drive.nearest_m > 0.27, "{}", drive.nearest_m);
}

#[test]
fn where_there_is_no_room_it_waits_and_goes_on_when_the_way_is_free() {
    let mut drive = Drive::new(corridor(&[[2.0, 0.1], [2.0, -0.1]]), &ALONG_X, Pose2::default());
    assert_eq!(drive.until(FollowerState::Blocked, 30.0).state, FollowerState::Blocked);
    let waits_m = drive.pose.x_m;
    for _ in 0..100 {
        let report = drive.step().0;
        assert_eq!((report.state, report.wish.linear_m_s), (FollowerState::Blocked, 0.0));
    }
    assert_eq!(drive.pose.x_m, waits_m);
    drive.scene.points_m.clear();
    assert_eq!(drive.until(FollowerState::Arrived, 40.0).state, FollowerState::Arrived, "{:?}", drive.states);
}

#[test]
fn what_stands_beside_the_safe_path_is_passed_without_a_stop_and_the_paper_would_stop() {
    let beside = [[2.0, -0.36]];
    let mut drive = Drive::new(corridor(&beside), &ALONG_X, Pose2::default());
    drive.until(FollowerState::Arrived, 40.0);
    assert_eq!(drive.states, [FollowerState::Follow, FollowerState::Arrived]);
    let mut drive = Drive::new(corridor(&beside), &ALONG_X, Pose2::default());
    let params = ProjectionParams { path_m: ALONG_X.to_vec(), safe_path_only: false, ..ProjectionParams::default() };
    drive.follower = PathFollower::new(&params, Detector::Projection);
    drive.until(FollowerState::Arrived, 40.0);
    use FollowerState::{Arrived, Follow, Measure};
    assert_eq!(drive.states, [Follow, Measure, Follow, Arrived], "and goes on when it has measured");
}

#[test]
fn off_the_edge_it_says_blind_and_drives_back_on_an_edge_of_its_own() {
    let open = Scene { walls: false, points_m: Vec::new(), seen: true };
    let mut drive = Drive::new(open, &ALONG_X, Pose2 { x_m: 1.0, y_m: 0.6, heading_rad: 0.0 });
    let first = drive.step().0;
    assert!(first.blind && first.blind_beyond_m == 0.3 && first.state == FollowerState::Return, "{first:?}");
    assert!(!drive.step().0.blind, "not blind on the way back");
    drive.until(FollowerState::Arrived, 40.0);
    assert_eq!(drive.states, [FollowerState::Return, FollowerState::Follow, FollowerState::Arrived]);
}

#[test]
fn unseen_is_not_free() {
    let unseen = Scene { walls: true, points_m: Vec::new(), seen: false };
    let mut drive = Drive::new(unseen, &ALONG_X, Pose2::default());
    for _ in 0..10 {
        drive.step();
    }
    let report = drive.step().0;
    assert!(report.cannot_see && report.wish.linear_m_s == 0.0, "{report:?}");
    assert!(report.readings.iter().all(|reading| *reading == Reading::Unseen));
}

#[test]
fn a_pose_that_is_none_moves_nobody() {
    let mut drive = Drive::new(corridor(&[[1.0, 0.0]]), &ALONG_X, Pose2::default());
    for pose in [f64::NAN, f64::INFINITY, 1e300] {
        drive.pose = Pose2 { x_m: pose, y_m: 0.0, heading_rad: 0.0 };
        let (report, allocations) = drive.step();
        assert!(report.wish.is_finite() && allocations == 0, "{report:?}");
        assert!(report.blind || report.wish.linear_m_s == 0.0, "{report:?}");
    }
}

#[test]
fn a_path_that_is_none_is_refused_by_name() {
    let sound = ProjectionParams { path_m: ALONG_X.to_vec(), ..ProjectionParams::default() };
    sound.validate().expect("a path");
    let with = |path_m: &[[f64; 2]]| ProjectionParams { path_m: path_m.to_vec(), ..sound.clone() }.validate();
    for (params, key) in [
        (with(&[[0.0, 0.0]]), "path_m"),
        (with(&[[0.0, 0.0]; 65]), "path_m"),
        (with(&[[0.0, 0.0], [0.0, 0.001]]), "path_m[1]"),
        (with(&[[0.0, 0.0], [0.0, f64::NAN]]), "path_m[1][1]"),
        (ProjectionParams { safe_width_m: 0.0, ..sound.clone() }.validate(), "safe_width_m"),
        (ProjectionParams { speed_m_s: f64::INFINITY, ..sound.clone() }.validate(), "speed_m_s"),
    ] {
        assert_eq!(params.expect_err(key).key, key);
    }
}
