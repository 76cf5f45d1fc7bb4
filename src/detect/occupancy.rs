//! The occupancy grid: what stands where around the robot, in log-odds, on a window of 64 x 64 cells that rolls along with it.
//!
//! Goes in: scans with the robot's pose in the odometry frame, and objects with their covariance. Comes out: for every cell
//! occupied, free or unknown. cell = round(position / cell_m), as the paper's map has it. A cell is free where every ray across
//! it is known to be free beyond it; unseen changes nothing. An object weighs in every cell by the probability that it lies
//! there. Evidence is clamped, so that what is carried away is forgotten, and fades with time and way, because odometry drifts.
//! Allocates nothing after it was made.

use crate::geometry::{Pose2, polar_from_cartesian};
use crate::signal::{RAYS, RobotScan};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::TAU;

/// Cells along a side of the window.
pub const SIDE: usize = 64;
/// Cells of the window.
pub const CELLS: usize = SIDE * SIDE;
/// A cell of which nothing is known, where others are 0 to 100 percent occupied.
pub const UNKNOWN: u8 = 255;
/// From this percentage on a cell counts as occupied.
pub const OCCUPIED_PERCENT: u8 = 65;

/// Log-odds that one scan adds: for an object that is certainly in the cell (one gives 71 %), and for a cell seen to be free.
const OCCUPIED: f32 = 0.9;
const FREE: f32 = -0.5;
/// Log-odds never leave this: 2 % to 98 %.
const CLAMP: f32 = 4.0;
/// Below this a cell is unknown: 47 % to 53 %.
const KNOWN: f32 = 0.1;
/// Time, way and turn in which all but 37 % of the evidence fades.
const FADES_S: f64 = 120.0;
const FADES_M: f64 = 10.0;
const FADES_RAD: f64 = 30.0;
/// Places and weights that stand for a normal distribution (Gauss-Hermite, five points).
const NODES: [(f64, f32); 5] = [
    (-2.856_970, 0.011_257),
    (-1.355_626, 0.222_076),
    (0.0, 0.533_333),
    (1.355_626, 0.222_076),
    (2.856_970, 0.011_257),
];
/// Rays that are looked at beyond the edges of a cell.
const RAY_MARGIN_RAD: f64 = 0.5 * TAU / RAYS as f64;

/// The grid.
#[derive(Debug, Clone)]
pub struct OccupancyGrid {
    cell_m: f64,
    /// The robot itself keeps this free.
    footprint_m: f64,
    /// Lowest cell of the window.
    low: [i64; 2],
    /// Stored by cell modulo 64, so that rolling moves nothing.
    log_odds: Box<[f32; CELLS]>,
    /// What objects of the present scan weigh in each cell; scratch.
    weights: Box<[f32; CELLS]>,
    empty: bool,
}

impl OccupancyGrid {
    /// A grid that knows nothing. `footprint_m` is the radius of the robot: where it stands is free.
    #[must_use]
    pub fn new(cell_m: f64, footprint_m: f64) -> Self {
        let blank = || Box::new([0.0; CELLS]);
        Self { cell_m, footprint_m, low: [0, 0], log_odds: blank(), weights: blank(), empty: true }
    }

    /// The cell of a place.
    #[must_use]
    pub fn cell_of(&self, place_m: Vector2<f64>) -> [i64; 2] {
        [place_m.x, place_m.y].map(|coordinate_m| (coordinate_m / self.cell_m).round() as i64)
    }

    /// Middle of the cell with the lowest x and y.
    #[must_use]
    pub fn origin_m(&self) -> Vector2<f64> {
        self.middle_m(self.low)
    }

    /// Edge of a cell.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.log_odds.fill(0.0);
        self.empty = true;
    }

    /// How occupied the cell of a place is, in percent; [`UNKNOWN`] also outside the window.
    #[must_use]
    pub fn percent(&self, place_m: Vector2<f64>) -> u8 {
        let cell = self.cell_of(place_m);
        if self.holds(cell) { told(self.log_odds[slot(cell)]) } else { UNKNOWN }
    }

    /// Writes the window row by row, from the lowest x and y on, x first.
    pub fn tell(&self, percent: &mut [u8; CELLS]) {
        for (index, percent) in percent.iter_mut().enumerate() {
            *percent = told(self.log_odds[slot(self.cell_at(index))]);
        }
    }

    /// Takes in a scan made at `pose`, with the objects in it as places and covariances in the frame of the pose, `dt_s`, `way_m`
    /// and `turn_rad` after the last. A pose that is no place is left out.
    pub fn update(
        &mut self,
        scan: &RobotScan,
        pose: &Pose2,
        objects: impl Iterator<Item = (Vector2<f64>, Matrix2<f64>)>,
        (dt_s, way_m, turn_rad): (f64, f64, f64),
    ) {
        let place_m = pose.position_m();
        if !(is_place(place_m) && pose.heading_rad.is_finite()) {
            return;
        }
        self.roll(place_m);
        let faded = dt_s.max(0.0) / FADES_S + way_m.abs() / FADES_M + turn_rad.abs() / FADES_RAD;
        let kept = if faded.is_finite() { (-faded).exp() as f32 } else { 0.0 };
        self.weights.fill(0.0);
        for (at_m, covariance_m2) in objects {
            self.weigh(at_m, &covariance_m2);
        }
        for index in 0..CELLS {
            let cell = self.cell_at(index);
            let slot = slot(cell);
            let weight = self.weights[slot].min(1.0);
            let seen_free = weight < 0.05 && self.is_free(cell, scan, pose);
            let change = if seen_free { FREE } else { OCCUPIED * weight };
            self.log_odds[slot] = (self.log_odds[slot] * kept + change).clamp(-CLAMP, CLAMP);
        }
    }

    /// Lets the window follow the robot; what comes into it is unknown.
    fn roll(&mut self, place_m: Vector2<f64>) {
        let low = self.cell_of(place_m).map(|cell| cell - SIDE as i64 / 2);
        let before = std::mem::replace(&mut self.low, low);
        if std::mem::take(&mut self.empty) || low == before {
            return;
        }
        let held = |cell: [i64; 2]| (0..2).all(|axis| (0..SIDE as i64).contains(&(cell[axis] - before[axis])));
        for index in 0..CELLS {
            let cell = self.cell_at(index);
            if !held(cell) {
                self.log_odds[slot(cell)] = 0.0;
            }
        }
    }

    /// Adds the probability that an object lies in each cell.
    fn weigh(&mut self, at_m: Vector2<f64>, covariance_m2: &Matrix2<f64>) {
        // Its root by Cholesky.
        let first = covariance_m2.m11.max(0.0).sqrt();
        let lower = if first > 0.0 { covariance_m2.m21 / first } else { 0.0 };
        let second = (covariance_m2.m22 - lower * lower).max(0.0).sqrt();
        for (along, along_weight) in NODES {
            for (across, across_weight) in NODES {
                let there_m = at_m + Vector2::new(first * along, lower * along + second * across);
                let cell = self.cell_of(there_m);
                if is_place(there_m) && self.holds(cell) {
                    self.weights[slot(cell)] += along_weight * across_weight;
                }
            }
        }
    }

    /// Whether a scan knows a cell to be free: the robot stands on it, or every ray across it is free beyond it.
    fn is_free(&self, cell: [i64; 2], scan: &RobotScan, pose: &Pose2) -> bool {
        let (range_m, bearing_rad) = polar_from_cartesian(pose.local_from_parent(self.middle_m(cell)));
        if range_m <= self.footprint_m {
            return true;
        }
        let reach_m = std::f64::consts::FRAC_1_SQRT_2 * self.cell_m;
        // What no sensor ever sees, right at the robot, is not free because what lies beyond is.
        if range_m - reach_m < scan.range_m[0] || range_m + reach_m > scan.range_m[1] {
            return false;
        }
        let half_rad = (reach_m / range_m).min(1.0).asin() + RAY_MARGIN_RAD;
        let count = ((2.0 * half_rad) * RAYS as f64 / TAU).ceil() as usize;
        let first = RobotScan::ray_at(bearing_rad - half_rad);
        (0..=count).all(|step| scan.rays[(first + step) % RAYS].free_m >= range_m + 0.5 * self.cell_m)
    }

    fn middle_m(&self, cell: [i64; 2]) -> Vector2<f64> {
        Vector2::new(cell[0] as f64, cell[1] as f64) * self.cell_m
    }

    fn cell_at(&self, index: usize) -> [i64; 2] {
        [self.low[0] + (index % SIDE) as i64, self.low[1] + (index / SIDE) as i64]
    }

    fn holds(&self, cell: [i64; 2]) -> bool {
        (0..2).all(|axis| (0..SIDE as i64).contains(&(cell[axis].saturating_sub(self.low[axis]))))
    }
}

/// Whether coordinates are numbers, and near enough for cells to be counted.
fn is_place(place_m: Vector2<f64>) -> bool {
    place_m.iter().all(|coordinate_m| coordinate_m.abs() < 1e9)
}

fn slot(cell: [i64; 2]) -> usize {
    let [x, y] = cell.map(|coordinate| coordinate.rem_euclid(SIDE as i64) as usize);
    y * SIDE + x
}

fn told(log_odds: f32) -> u8 {
    if log_odds.abs() < KNOWN { UNKNOWN } else { (100.0 / (1.0 + (-log_odds).exp())).round() as u8 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Ray, Reading};

    /// A scan that is clear out to 2 m, but for a sector that nobody sees and a skirt of echoes about a bearing.
    fn scan(echo: Option<(f64, f64)>) -> RobotScan {
        let mut scan = RobotScan::unseen();
        scan.range_m = [0.2, 2.0];
        for (index, ray) in scan.rays.iter_mut().enumerate() {
            let bearing_rad = RobotScan::bearing_rad(index);
            *ray = Ray { reading: Reading::Clear, free_m: 2.0, ..Ray::default() };
            if bearing_rad.abs() > 2.5 {
                *ray = Ray::default();
            }
            if let Some((range_m, _)) = echo.filter(|(_, echo_rad)| (bearing_rad - echo_rad).abs() < 0.1) {
                *ray = Ray { reading: Reading::Echo { range_m, energy: 0.1 }, free_m: range_m - 0.1, ..Ray::default() };
            }
        }
        scan
    }

    fn object(x_m: f64, y_m: f64, sigma_m: f64) -> (Vector2<f64>, Matrix2<f64>) {
        (Vector2::new(x_m, y_m), Matrix2::identity() * sigma_m * sigma_m)
    }

    const ONE_SCAN: (f64, f64, f64) = (0.1, 0.0, 0.0);

    #[test]
    fn an_echo_is_occupied_what_lies_before_it_free_and_what_lies_behind_unknown() {
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        let at = |x_m: f64, y_m: f64| Vector2::new(x_m, y_m);
        grid.update(&scan(Some((1.0, 0.0))), &Pose2::default(), [object(1.0, 0.0, 0.01)].into_iter(), ONE_SCAN);
        assert!(grid.percent(at(1.0, 0.0)) >= OCCUPIED_PERCENT, "one ping says it: {}", grid.percent(at(1.0, 0.0)));
        assert!(grid.percent(at(0.6, 0.0)) < 50, "before it");
        assert_eq!(grid.percent(at(1.4, 0.0)), UNKNOWN, "behind it");
        assert!(grid.percent(at(0.0, 1.2)) < 50, "beside it");
        assert_eq!(grid.percent(at(-1.0, 0.0)), UNKNOWN, "where nobody sees");
        assert_eq!(grid.percent(at(0.2, 0.0)), UNKNOWN, "too near for any sensor");
        assert!(grid.percent(at(0.0, 0.0)) < 50, "the robot stands there");
        assert_eq!(grid.percent(at(50.0, 0.0)), UNKNOWN, "far outside the window");
    }

    #[test]
    fn unseen_changes_nothing_and_seen_free_takes_an_object_away() {
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        let (place_m, nothing) = (Vector2::new(1.0, 0.0), std::iter::empty);
        for _ in 0..20 {
            grid.update(&scan(Some((1.0, 0.0))), &Pose2::default(), [object(1.0, 0.0, 0.01)].into_iter(), ONE_SCAN);
        }
        assert_eq!(grid.percent(place_m), 98, "clamped");
        let unseen = RobotScan::unseen();
        grid.update(&unseen, &Pose2::default(), nothing(), (0.0, 0.0, 0.0));
        assert_eq!(grid.percent(place_m), 98);
        for _ in 0..16 {
            grid.update(&scan(None), &Pose2::default(), nothing(), ONE_SCAN);
        }
        assert!(grid.percent(place_m) < 10, "carried away: {}", grid.percent(place_m));
    }

    #[test]
    fn an_uncertain_object_is_spread_over_cells_and_its_weights_sum_to_one() {
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        let covariance_m2 = Matrix2::new(0.04, 0.03, 0.03, 0.04);
        grid.weigh(Vector2::new(1.0, 1.0), &covariance_m2);
        assert!((grid.weights.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        grid.update(
            &RobotScan::unseen(),
            &Pose2::default(),
            [(Vector2::new(1.0, 1.0), covariance_m2)].into_iter(),
            ONE_SCAN,
        );
        let percent = |x_m: f64, y_m: f64| grid.percent(Vector2::new(x_m, y_m));
        assert!(percent(1.0, 1.0) > 55 && percent(1.2, 1.2) > 52 && percent(0.8, 0.8) > 52);
        assert_eq!(percent(1.2, 0.8), UNKNOWN, "not across the correlation");
    }

    #[test]
    fn the_window_rolls_with_the_robot_and_keeps_what_stays_in_it() {
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        grid.update(&RobotScan::unseen(), &Pose2::default(), [object(1.0, 0.4, 0.01)].into_iter(), ONE_SCAN);
        let there_m = Vector2::new(1.0, 0.4);
        let first = grid.percent(there_m);
        let moved = Pose2 { x_m: 3.0, y_m: -1.0, heading_rad: 0.5 };
        grid.update(&RobotScan::unseen(), &moved, std::iter::empty(), (0.0, 0.0, 0.0));
        assert_eq!(grid.percent(there_m), first);
        assert!((grid.origin_m() - Vector2::new(3.0 - 6.4, -1.0 - 6.4)).norm() < 1e-9);
        let mut percent = [0; CELLS];
        grid.tell(&mut percent);
        let occupied: Vec<usize> = (0..CELLS).filter(|index| (60..=100).contains(&percent[*index])).collect();
        let at_m = grid.origin_m() + Vector2::new((occupied[0] % SIDE) as f64, (occupied[0] / SIDE) as f64) * 0.2;
        assert!(occupied.len() == 1 && (at_m - there_m).norm() < 1e-9, "{at_m}");
        let away = Pose2 { x_m: 30.0, ..Pose2::default() };
        grid.update(&RobotScan::unseen(), &away, std::iter::empty(), (0.0, 0.0, 0.0));
        grid.update(&RobotScan::unseen(), &Pose2::default(), std::iter::empty(), (0.0, 0.0, 0.0));
        assert_eq!(grid.percent(there_m), UNKNOWN, "what left the window is forgotten");
    }

    #[test]
    fn evidence_fades_with_the_way_because_odometry_drifts() {
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        let put = |grid: &mut OccupancyGrid| {
            grid.update(&RobotScan::unseen(), &Pose2::default(), [object(1.0, 0.0, 0.01)].into_iter(), ONE_SCAN);
        };
        put(&mut grid);
        put(&mut grid);
        let before = grid.percent(Vector2::new(1.0, 0.0));
        grid.update(&RobotScan::unseen(), &Pose2::default(), std::iter::empty(), (0.0, 50.0, 0.0));
        assert!(before > 80);
        assert_eq!(grid.percent(Vector2::new(1.0, 0.0)), UNKNOWN);
    }

    #[test]
    fn values_that_are_no_numbers_change_nothing() {
        let mut grid = OccupancyGrid::new(0.2, 0.1);
        grid.update(&scan(None), &Pose2 { x_m: f64::NAN, ..Pose2::default() }, std::iter::empty(), ONE_SCAN);
        let bad = [object(f64::NAN, 0.0, 0.1), object(f64::INFINITY, 0.0, 0.1), object(1.0, 0.0, f64::NAN)];
        grid.update(&RobotScan::unseen(), &Pose2::default(), bad.into_iter(), ONE_SCAN);
        let mut percent = [0; CELLS];
        grid.tell(&mut percent);
        // An object without a spread is a point; the others are nowhere.
        let known = percent.iter().filter(|percent| **percent != UNKNOWN).count();
        assert!(known <= 2, "{known} cells: the robot's own and the point");
    }
}
