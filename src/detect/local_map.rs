//! The reflectors of the last seconds, where odometry says that they are: a short memory around the robot.
//!
//! Goes in: scans and poses. Comes out: [`MapPoint`]s in the frame of odometry. A world that mirrors sound shows corners, ends and the
//! foot of the perpendicular on a wall, and no more at any one time; what is behind the robot by now was beside it before. Points heard
//! again at the same place are merged, so that the memory is a matter of places and not of pings. Fixed capacity, the oldest goes
//! first; allocates nothing after it was made. Never decides what a point belongs to.

use crate::geometry::Pose2;
use crate::signal::{Peak, RobotScan};
use nalgebra::Vector2;

/// Most points kept.
pub const MAP_POINTS_MAX: usize = 256;
/// Points nearer together than this are one.
const MERGE_M: f64 = 0.05;
/// A place is the mean of about so many of its last hearings.
const MEMORY_HITS: f64 = 8.0;
/// Points older than this are forgotten, and those that lie more way back than this.
const AGE_MAX_S: f64 = 12.0;
const WAY_MAX_M: f64 = 4.0;
/// A reflector whose bearing is less certain is not entered.
const BEARING_SIGMA_MAX_RAD: f64 = 0.14;

/// A place from which echoes came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPoint {
    /// Where it is.
    pub place_m: Vector2<f64>,
    /// Where the sensor was that heard it last.
    pub sensor_m: Vector2<f64>,
    /// Standard deviation of the place, in the worse direction.
    pub sigma_m: f64,
    /// How often it was heard.
    pub hits: u32,
    /// Loudest envelope that came from it.
    pub energy: f32,
    /// When it was heard last.
    pub heard_s: f64,
    /// The robot's way until then.
    way_m: f64,
}

impl MapPoint {
    /// Whether the line of sight on it runs within `within_rad` of being square to `along`, a unit vector: a wall parallel to that is
    /// seen so.
    #[must_use]
    pub fn is_abeam(&self, along: Vector2<f64>, within_rad: f64) -> bool {
        let sight_m = self.place_m - self.sensor_m;
        sight_m.dot(&along).abs() <= within_rad.sin() * sight_m.norm()
    }
}

/// The memory.
#[derive(Debug, Clone)]
pub struct LocalMap {
    points: Vec<MapPoint>,
    at_m: Option<Vector2<f64>>,
    way_m: f64,
    now_s: f64,
}

impl Default for LocalMap {
    fn default() -> Self {
        Self::new()
    }
}

impl LocalMap {
    /// An empty memory.
    #[must_use]
    pub fn new() -> Self {
        Self { points: Vec::with_capacity(MAP_POINTS_MAX), at_m: None, way_m: 0.0, now_s: 0.0 }
    }

    /// Forgets everything: another frame of odometry.
    pub fn clear(&mut self) {
        self.points.clear();
        self.at_m = None;
    }

    /// Adds the reflectors of a scan that was taken at `pose`. A time that runs backward, or a pose that is no number, forgets all.
    pub fn add(&mut self, scan: &RobotScan, pose: &Pose2, now_s: f64) {
        let place_m = pose.position_m();
        if !(now_s >= self.now_s && place_m.x.is_finite() && place_m.y.is_finite() && pose.heading_rad.is_finite()) {
            self.clear();
        }
        self.now_s = now_s;
        self.way_m += self.at_m.map_or(0.0, |before_m| (place_m - before_m).norm());
        self.at_m = Some(place_m);
        let (now_s, way_m) = (self.now_s, self.way_m);
        self.points.retain(|point| now_s - point.heard_s <= AGE_MAX_S && way_m - point.way_m <= WAY_MAX_M);
        // At the border of what a sensor sees nobody knows where a reflector stands: such echoes stop a robot, but are no place.
        let placed = |peak: &&Peak| peak.bearing_sigma_rad <= BEARING_SIGMA_MAX_RAD;
        for peak in scan.peaks.iter().filter(placed) {
            let range_m = (peak.position_m - peak.sensor_m).norm();
            let point = MapPoint {
                place_m: pose.parent_from_local(peak.position_m),
                sensor_m: pose.parent_from_local(peak.sensor_m),
                sigma_m: peak.range_sigma_m.max(range_m * peak.bearing_sigma_rad),
                energy: peak.energy,
                hits: 1,
                heard_s: now_s,
                way_m,
            };
            if point.place_m.x.is_finite() && point.place_m.y.is_finite() {
                self.enter(point);
            }
        }
    }

    /// Every point kept.
    pub fn points(&self) -> impl Iterator<Item = &MapPoint> + Clone {
        self.points.iter()
    }

    /// Points that were heard at least twice, the last time at most `age_s` ago: what was heard once may be a ghost.
    pub fn firm(&self, age_s: f64) -> impl Iterator<Item = &MapPoint> + Clone {
        let since_s = self.now_s - age_s;
        self.points.iter().filter(move |point| point.hits >= 2 && point.heard_s >= since_s)
    }

    /// Time since a point was heard.
    #[must_use]
    pub fn age_s(&self, point: &MapPoint) -> f64 {
        self.now_s - point.heard_s
    }

    fn enter(&mut self, new: MapPoint) {
        let apart_m = |point: &MapPoint| (point.place_m - new.place_m).norm();
        let nearest = self.points.iter_mut().min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)));
        if let Some(known) = nearest.filter(|known| apart_m(known) <= MERGE_M) {
            let before = f64::from(known.hits).min(MEMORY_HITS);
            let mean_m = (known.place_m * before + new.place_m) / (before + 1.0);
            // Two sensors that hear the same thing in one ping are one hearing.
            let hits = known.hits.saturating_add(u32::from(new.heard_s > known.heard_s));
            let (sigma_m, energy) = (known.sigma_m.min(new.sigma_m), known.energy.max(new.energy));
            *known = MapPoint { place_m: mean_m, hits, sigma_m, energy, ..new };
            return;
        }
        if self.points.len() == MAP_POINTS_MAX {
            let oldest = (0..self.points.len()).min_by(|a, b| {
                let heard_s = |index: &usize| self.points[*index].heard_s;
                heard_s(a).total_cmp(&heard_s(b))
            });
            oldest.map(|oldest| self.points.swap_remove(oldest));
        }
        self.points.push(new);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(places: &[[f64; 2]]) -> RobotScan {
        let mut scan = RobotScan::unseen();
        scan.peaks.extend(places.iter().map(|place| Peak {
            position_m: Vector2::from(*place),
            sensor_m: Vector2::zeros(),
            range_sigma_m: 0.003,
            bearing_sigma_rad: 0.02,
            energy: 0.1,
            sensor_index: 0,
        }));
        scan
    }

    #[test]
    fn a_corner_stays_one_point_and_a_wall_leaves_a_trail() {
        let mut map = LocalMap::new();
        for step in 0..30 {
            let x_m = 0.03 * f64::from(step);
            let pose = Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 };
            map.add(&scan(&[[2.0 - x_m, 0.3], [0.0, -0.6]]), &pose, 0.1 * f64::from(step));
        }
        let corners: Vec<_> = map.points().filter(|point| point.place_m.y > 0.0).collect();
        assert_eq!(corners.len(), 1);
        assert!(corners[0].hits == 30 && (corners[0].place_m - Vector2::new(2.0, 0.3)).norm() < 1e-9);
        let wall = map.firm(12.0).filter(|point| point.place_m.y < 0.0);
        assert!(wall.clone().all(|point| point.is_abeam(Vector2::x(), 0.1)));
        let span_m = wall.clone().map(|point| point.place_m.x).fold(0.0, f64::max);
        assert!(wall.count() > 6 && span_m > 0.75, "{span_m}");
        assert!(!corners[0].is_abeam(Vector2::x(), 0.1));
    }

    #[test]
    fn the_memory_is_bounded_in_number_age_and_way() {
        let mut map = LocalMap::new();
        let many: Vec<[f64; 2]> = (0..64).map(|index| [1.0, 0.1 * f64::from(index)]).collect();
        for step in 0..8 {
            map.add(&scan(&many), &Pose2 { x_m: 0.1 * f64::from(step), ..Pose2::default() }, f64::from(step));
        }
        assert!(map.points().count() <= MAP_POINTS_MAX && map.points.capacity() == MAP_POINTS_MAX);
        map.add(&scan(&[]), &Pose2::default(), 7.5 + AGE_MAX_S);
        assert_eq!(map.points().count(), 0, "too old");
        map.add(&scan(&[[1.0, 0.0]]), &Pose2::default(), 20.0);
        map.add(&scan(&[]), &Pose2 { x_m: WAY_MAX_M + 0.1, ..Pose2::default() }, 21.0);
        assert_eq!(map.points().count(), 0, "too far back");
    }

    #[test]
    fn a_clock_that_runs_backward_or_a_pose_that_is_none_forgets_all() {
        let mut map = LocalMap::new();
        map.add(&scan(&[[1.0, 0.0]]), &Pose2::default(), 20.0);
        map.add(&scan(&[]), &Pose2::default(), 19.0);
        assert_eq!(map.points().count(), 0);
        map.add(&scan(&[[1.0, 0.0]]), &Pose2 { x_m: f64::NAN, ..Pose2::default() }, 21.0);
        assert_eq!(map.points().count(), 0);
    }
}
