//! The detector of paper 003 as it runs beside the controller: readings, objects fused over pings, occupancy grid.
//!
//! Goes in: the scan of the whole robot and where odometry says it was made. Comes out: [`RingReport`], of fixed size. What
//! odometry cannot have done in the time between two scans (the robot was carried, odometry began anew) means another frame:
//! everything known is forgotten. Allocates nothing after it was made; reads no clock, the scan's own time of emission is the
//! time.

use super::occupancy::{CELLS, OccupancyGrid, SIDE};
use super::params::RingParams;
use super::ring::{RingObject, SONARS};
use super::route::GridMap;
use super::tracks::{Motion, TRACKS_MAX, Track, Tracks};
use super::virtual_ring::{Echoes, OBJECTS_MAX, VirtualRing, answers};
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::{Reading, RobotScan};
use nalgebra::Vector2;

/// No robot of this kind is faster; odometry that says so has jumped.
const SPEED_MAX_M_S: f64 = 5.0;
const TURN_MAX_RAD_S: f64 = 10.0;
/// What a jump must exceed beside that.
const JUMP_MIN_M: f64 = 0.3;
/// A place counts as seen empty if it is free this far beyond.
const EMPTY_BEYOND_M: f64 = 0.1;

/// The occupancy grid as it is told.
#[derive(Debug, Clone, PartialEq)]
pub struct GridView {
    /// Middle of the first cell, which has the lowest x and y, in the odometry frame.
    pub origin_m: [f64; 2],
    /// Edge of a cell.
    pub cell_m: f64,
    /// 64 rows of 64 cells, x first, from the lowest x and y on: 0 free to 100 occupied, 255 unknown.
    pub percent: [u8; CELLS],
}

impl GridView {
    /// As a map to find a way on.
    #[must_use]
    pub fn map(&self) -> GridMap<'_> {
        GridMap {
            width: SIDE,
            height: SIDE,
            cell_m: self.cell_m,
            origin_m: self.origin_m.into(),
            percent: &self.percent,
        }
    }
}

/// What the detector says after a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct RingReport {
    /// Sequence of the ping set.
    pub sequence: u64,
    /// Emission of the ping set, CLOCK_BOOTTIME.
    pub emitted_ns: u64,
    /// Where odometry put the robot then.
    pub pose: Pose2,
    /// Readings of the twelve virtual sonars, measured from the ring; the three answers apart.
    pub readings: [Reading; SONARS],
    /// Number of objects.
    pub object_count: usize,
    /// Objects in the odometry frame, the most likely first; zeros beyond their number.
    pub objects: [Track; TRACKS_MAX],
    /// What stands where, in the odometry frame.
    pub grid: GridView,
}

impl RingReport {
    /// The objects that there are.
    #[must_use]
    pub fn objects(&self) -> &[Track] {
        &self.objects[..self.object_count.min(TRACKS_MAX)]
    }
}

/// The virtual sonar ring at work.
#[derive(Debug, Clone)]
pub struct RingDetector {
    ring: VirtualRing,
    tracks: Tracks,
    grid: OccupancyGrid,
    objects: Vec<RingObject>,
    last: Option<(Pose2, u64)>,
    report: Box<RingReport>,
}

impl RingDetector {
    /// A detector that knows nothing. The ring is taken for the robot's rim: inside is free.
    #[must_use]
    pub fn new(params: &RingParams) -> Self {
        let report = RingReport {
            sequence: 0,
            emitted_ns: 0,
            pose: Pose2::default(),
            readings: [Reading::Unseen; SONARS],
            object_count: 0,
            objects: [Track::default(); TRACKS_MAX],
            grid: GridView { origin_m: [0.0; 2], cell_m: params.cell_m, percent: [super::occupancy::UNKNOWN; CELLS] },
        };
        Self {
            ring: VirtualRing::new(params, Echoes::All),
            tracks: Tracks::new(),
            grid: OccupancyGrid::new(params.cell_m, params.ring_radius_m),
            objects: Vec::with_capacity(OBJECTS_MAX),
            last: None,
            report: Box::new(report),
        }
    }

    /// Forgets everything: what comes next is in another frame.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.grid.clear();
        self.last = None;
    }

    /// Takes in a scan made at `pose` of the odometry frame and says what is known after it. A pose that is none (not finite)
    /// tells nothing of where things are: then only the readings are new.
    pub fn update(&mut self, scan: &RobotScan, pose: &Pose2) -> &RingReport {
        let readings = self.ring.read(scan);
        let emitted_ns = scan.emitted_at.boottime_ns;
        self.report.sequence = scan.sequence;
        self.report.emitted_ns = emitted_ns;
        self.report.readings = answers(&readings);
        if !(pose.x_m.is_finite() && pose.y_m.is_finite() && pose.heading_rad.is_finite()) {
            return &self.report;
        }
        let mut objects = std::mem::take(&mut self.objects);
        self.ring.objects(scan, &readings, pose, &mut objects);
        self.fuse(scan, pose, &objects);
        self.objects = objects;
        &self.report
    }

    /// As [`RingDetector::update`], with objects that were found elsewhere, in the frame of the pose: of the scan only the rays
    /// count.
    pub fn fuse(&mut self, scan: &RobotScan, pose: &Pose2, objects: &[RingObject]) {
        let motion = self.motion(pose, scan.emitted_at.boottime_ns);
        self.tracks.update(&motion, objects, |place_m, spread_m| is_empty(scan, pose, place_m, spread_m));
        let places = objects.iter().map(|object| (object.position_m, object.covariance_m2));
        self.grid.update(scan, pose, places, (motion.dt_s, motion.way_m, motion.turn_rad));
        let report = &mut *self.report;
        report.pose = *pose;
        report.objects = [Track::default(); TRACKS_MAX];
        report.object_count = 0;
        for (told, track) in report.objects.iter_mut().zip(self.tracks.tell(pose.position_m())) {
            *told = track;
            report.object_count += 1;
        }
        report.grid.origin_m = self.grid.origin_m().into();
        self.grid.tell(&mut report.grid.percent);
    }

    /// What was said last.
    #[must_use]
    pub fn report(&self) -> &RingReport {
        &self.report
    }

    /// How the robot moved since the last scan. Forgets everything if nothing moves like that.
    fn motion(&mut self, pose: &Pose2, emitted_ns: u64) -> Motion {
        let (before, before_ns) = self.last.replace((*pose, emitted_ns)).unwrap_or((*pose, emitted_ns));
        let dt_s = emitted_ns.saturating_sub(before_ns) as f64 * 1e-9;
        let way_m = (pose.position_m() - before.position_m()).norm();
        let turn_rad = wrap_angle_rad(pose.heading_rad - before.heading_rad).abs();
        if way_m > JUMP_MIN_M + SPEED_MAX_M_S * dt_s || turn_rad > JUMP_MIN_M + TURN_MAX_RAD_S * dt_s {
            self.tracks.clear();
            self.grid.clear();
            return Motion { position_m: pose.position_m(), ..Motion::default() };
        }
        Motion { position_m: pose.position_m(), way_m, turn_rad, dt_s }
    }
}

/// Whether a scan knows that nothing is at a place: its ray and those beside it, as far as the place is uncertain, are free beyond.
fn is_empty(scan: &RobotScan, pose: &Pose2, place_m: Vector2<f64>, spread_m: f64) -> bool {
    let local_m = pose.local_from_parent(place_m);
    let (range_m, bearing_rad) = (local_m.norm(), local_m.y.atan2(local_m.x));
    let beyond_m = range_m + EMPTY_BEYOND_M + spread_m;
    if range_m < scan.range_m[0] + EMPTY_BEYOND_M || !beyond_m.is_finite() {
        return false;
    }
    let half_rad = (spread_m / range_m).min(0.5) + 1f64.to_radians();
    [-1.0, -0.5, 0.0, 0.5, 1.0].iter().all(|share| {
        let ray = &scan.rays[RobotScan::ray_at(bearing_rad + share * half_rad)];
        ray.free_m >= beyond_m
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::route::{RouteOptions, route};
    use crate::signal::{Peak, Ray};
    use crate::time::Stamp;

    const PARAMS: RingParams =
        RingParams { ring_radius_m: 0.1, cone_deg: 90.0, cell_m: 0.2, range_noise_m: 0.005, range_max_m: 1.5 };

    /// What a robot at `pose` hears of `places_m` of the world, `tenths` tenths of a second after it began.
    fn scan(pose: &Pose2, places_m: &[[f64; 2]], tenths: u64) -> RobotScan {
        let mut scan = RobotScan::unseen();
        scan.sequence = tenths;
        scan.range_m = [0.2, 2.0];
        scan.emitted_at = Stamp { boottime_ns: 1_000_000_000 + tenths * 100_000_000, wall_ns: 0 };
        for ray in scan.rays.iter_mut() {
            *ray = Ray { reading: Reading::Clear, free_m: 2.0, ..Ray::default() };
        }
        for place_m in places_m {
            let position_m = pose.local_from_parent(Vector2::from(*place_m));
            let (range_m, bearing_rad) = (position_m.norm(), position_m.y.atan2(position_m.x));
            let sensor_m = Vector2::zeros();
            let (range_sigma_m, bearing_sigma_rad) = (0.004, 0.02);
            scan.peaks.push(Peak {
                position_m,
                sensor_m,
                range_sigma_m,
                bearing_sigma_rad,
                energy: 0.1,
                sensor_index: 0,
            });
            for step in -6..=6 {
                let index = RobotScan::ray_at(bearing_rad + f64::from(step).to_radians());
                let reading = Reading::Echo { range_m, energy: 0.1 };
                scan.rays[index] = Ray { reading, range_sigma_m, bearing_sigma_rad, free_m: range_m - 0.1 };
            }
        }
        scan
    }

    #[test]
    fn a_thing_heard_while_driving_is_one_certain_object_where_it_stands() {
        let mut detector = RingDetector::new(&PARAMS);
        let place_m = [1.2, 0.5];
        for tenths in 0..10 {
            let pose = Pose2 { x_m: 0.02 * tenths as f64, y_m: 0.0, heading_rad: 0.05 * tenths as f64 };
            detector.update(&scan(&pose, &[place_m], tenths), &pose);
        }
        let report = detector.report();
        assert_eq!((report.object_count, report.sequence), (1, 9));
        let object = &report.objects()[0];
        assert!(object.score > 0.95 && (object.position_m - Vector2::from(place_m)).norm() < 1e-6, "{object:?}");
        let map = report.grid.map();
        assert!(map.percent_at(Vector2::from(place_m)).is_some_and(|percent| percent > 90));
        assert!(report.readings.iter().any(|reading| matches!(reading, Reading::Echo { .. })));
    }

    #[test]
    fn a_thing_that_is_carried_away_leaves_objects_and_grid() {
        let mut detector = RingDetector::new(&PARAMS);
        let pose = Pose2::default();
        for tenths in 0..10 {
            detector.update(&scan(&pose, &[[1.0, 0.0]], tenths), &pose);
        }
        for tenths in 10..20 {
            detector.update(&scan(&pose, &[[0.0, 1.0]], tenths), &pose);
        }
        let report = detector.report();
        assert_eq!(report.object_count, 1, "{:?}", report.objects());
        assert!((report.objects()[0].position_m - Vector2::new(0.0, 1.0)).norm() < 1e-6);
        assert!(report.grid.map().percent_at(Vector2::new(1.0, 0.0)).is_some_and(|percent| percent < 50));
    }

    #[test]
    fn a_jump_of_odometry_is_another_frame_and_no_number_is_none() {
        let mut detector = RingDetector::new(&PARAMS);
        let pose = Pose2::default();
        for tenths in 0..5 {
            detector.update(&scan(&pose, &[[1.0, 0.0]], tenths), &pose);
        }
        let lost = Pose2 { x_m: f64::NAN, ..pose };
        assert_eq!(detector.update(&scan(&pose, &[[1.0, 0.0]], 5), &lost).object_count, 1, "what was known stays");
        let jumped = Pose2 { x_m: 3.0, ..pose };
        detector.update(&scan(&jumped, &[], 6), &jumped);
        assert_eq!(detector.report().object_count, 0);
        assert!(detector.report().grid.percent.iter().all(|percent| *percent == 255 || *percent <= 50));
    }

    #[test]
    fn a_lost_sensor_set_leaves_everything_as_it_was() {
        let mut detector = RingDetector::new(&PARAMS);
        let pose = Pose2::default();
        for tenths in 0..5 {
            detector.update(&scan(&pose, &[[1.0, 0.0]], tenths), &pose);
        }
        let before = detector.report().objects()[0];
        let mut unseen = RobotScan::unseen();
        unseen.emitted_at = Stamp { boottime_ns: 1_500_000_000, wall_ns: 0 };
        let report = detector.update(&unseen, &pose);
        assert!(report.readings.iter().all(|reading| *reading == Reading::Unseen));
        assert_eq!(report.objects()[0].position_m, before.position_m);
        assert!(report.objects()[0].score > before.score - 0.01);
    }

    #[test]
    fn the_way_leads_around_what_was_heard() {
        let mut detector = RingDetector::new(&PARAMS);
        let pose = Pose2::default();
        for tenths in 0..3 {
            detector.update(&scan(&pose, &[[0.6, 0.0]], tenths), &pose);
        }
        let map = detector.report().grid.map();
        let found = route(&map, Vector2::zeros(), Vector2::new(1.2, 0.0), &RouteOptions::default()).expect("a way");
        assert!(found.length_m > 1.3, "not straight through: {}", found.length_m);
        assert!(found.points_m.iter().all(|point_m| (point_m - Vector2::new(0.6, 0.0)).norm() > 0.15));
    }
}
