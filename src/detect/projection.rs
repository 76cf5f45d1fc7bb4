//! Vector projection: does something stand in the way along a planned edge? (paper 001; specification, section 9)
//!
//! Goes in: readings of eight virtual sonars ([`EightSonars`] takes them from a scan), the robot's pose, an edge. Comes out: the
//! projection of every reading on the way to the edge's end, and whether one says obstacle. A wall beside the way is none, however
//! near: its vectors are square to the way. Never says where the obstacle ends or how to pass it.
//!
//! What the paper prints and what is computed here; tests/detectors_worked/projection_paper.rs shows each:
//! * eq. 3 multiplies by r_i. With that factor no unit of r gives table 1 (figure 4: 1.4 in metres, 1426 in millimetres, 4.0
//!   printed); without it every printed value comes out. It would also make near things count *less*, against step 2.
//! * eq. 4 goes below zero for what lies behind, and the text then compares its *magnitude*: a wall behind would stop the robot.
//!   Here a projection ends at zero, as table 1 prints it.
//! * Step 3 takes d from "the DE". From an edge's infinite line a robot far beyond its end would not be blind; d is the distance
//!   from the segment.
//! * Section 2.1 lets sonar vectors start at the robot's centre. The printed readings are those from the transducers: from the centre,
//!   0.16 m farther back, figure 4 would detect nothing.
//! * Figure 6 prints 0 for sonar 7, "the angle is -90 deg". The way to the edge's end leads 12.8 deg to the right there, so that a
//!   robot heading along x has a small positive projection; it stays far below the threshold.

use super::params::ProjectionParams;
use super::virtual_sonar::{SonarReading, VirtualSonar};
use crate::geometry::Pose2;
use crate::signal::RobotScan;
use nalgebra::Vector2;

/// Virtual sonars of the detector: those of the Pioneer P3-DX.
pub const SONARS: usize = 8;
/// Their bearings from the robot's heading, positive to the left.
pub const BEARINGS_DEG: [f64; SONARS] = [90.0, 50.0, 30.0, 10.0, -10.0, -30.0, -50.0, -90.0];
/// Where their transducers stand in the robot frame; readings are measured from there.
pub const TRANSDUCERS_M: [[f64; 2]; SONARS] = [
    [0.069, 0.136],
    [0.114, 0.119],
    [0.148, 0.078],
    [0.166, 0.027],
    [0.166, -0.027],
    [0.148, -0.078],
    [0.114, -0.119],
    [0.069, -0.136],
];
/// Longest vector: a reading of zero on the edge itself.
const MAGNITUDE_MAX: f64 = 10.0;
/// Share of the magnitude that is lost at the farthest distance from the edge that is not blind.
const EDGE_LOSS: f64 = 0.6;

/// A planned edge, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Where it begins.
    pub start_m: Vector2<f64>,
    /// Where it ends, which is where the robot is going.
    pub end_m: Vector2<f64>,
}

impl Edge {
    /// Its length.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        (self.end_m - self.start_m).norm()
    }

    /// Unit vector along it; along x for an edge without length.
    #[must_use]
    pub fn along(&self) -> Vector2<f64> {
        let length_m = self.length_m();
        if length_m > 0.0 { (self.end_m - self.start_m) / length_m } else { Vector2::x() }
    }

    /// A point in the edge's own frame: how far along from its start (x), and how far to its left (y).
    #[must_use]
    pub fn local_m(&self, point_m: Vector2<f64>) -> Vector2<f64> {
        let (along, from_start_m) = (self.along(), point_m - self.start_m);
        Vector2::new(along.dot(&from_start_m), along.perp(&from_start_m))
    }

    /// The point of the world that lies so far along the edge (x) and to its left (y).
    #[must_use]
    pub fn point_m(&self, local_m: Vector2<f64>) -> Vector2<f64> {
        let along = self.along();
        self.start_m + along * local_m.x + Vector2::new(-along.y, along.x) * local_m.y
    }

    /// Distance of a point from the edge as a segment.
    #[must_use]
    pub fn distance_m(&self, point_m: Vector2<f64>) -> f64 {
        let along_m = self.end_m - self.start_m;
        let squared = along_m.norm_squared();
        // A point of an edge, if it is one: then the distance is that from the point.
        let share =
            if squared > 0.0 { ((point_m - self.start_m).dot(&along_m) / squared).clamp(0.0, 1.0) } else { 0.0 };
        (point_m - self.start_m - along_m * share).norm()
    }

    /// Direction of the actual edge: from where the robot is to the end; that of the edge itself once it is there.
    #[must_use]
    pub fn direction_rad(&self, position_m: Vector2<f64>) -> f64 {
        let to_end_m = self.end_m - position_m;
        let along_m = if to_end_m.norm_squared() > 0.0 { to_end_m } else { self.end_m - self.start_m };
        along_m.y.atan2(along_m.x)
    }
}

/// The eight sonars of a P3-DX, as a scan of the whole robot lets them read.
#[derive(Debug, Clone)]
pub struct EightSonars {
    sonars: [VirtualSonar; SONARS],
}

impl EightSonars {
    /// Sonars with cones of `cone_deg` that read up to `range_max_m` from their transducers.
    #[must_use]
    pub fn new(cone_deg: f64, range_max_m: f64) -> Self {
        let sonars = std::array::from_fn(|sonar| {
            let ([x_m, y_m], bearing_deg) = (TRANSDUCERS_M[sonar], BEARINGS_DEG[sonar]);
            let transducer = Pose2 { x_m, y_m, heading_rad: bearing_deg.to_radians() };
            VirtualSonar { transducer, cone_rad: cone_deg.to_radians(), range_max_m }
        });
        Self { sonars }
    }

    /// What they read. A cone that is not seen says so: it is not free.
    #[must_use]
    pub fn read(&self, scan: &RobotScan) -> [SonarReading; SONARS] {
        std::array::from_fn(|sonar| self.sonars[sonar].read(scan))
    }
}

/// What the detector says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Projection of each sonar's vector on the way, 0 to 10.
    pub projections: [f64; SONARS],
    /// The sonar with the largest projection, where that is above the threshold.
    pub sonar: Option<usize>,
    /// The robot is farther from the edge than the detector can judge: that nothing is detected then means nothing.
    pub blind: bool,
}

/// Projects readings on the way to the edge's end. `ranges_m` are measured from the transducers, `None` where there is no
/// echo. A reading that is not a number counts as touching: it can only stop the robot.
#[must_use]
pub fn project(params: &ProjectionParams, ranges_m: &[Option<f64>; SONARS], pose: &Pose2, edge: &Edge) -> Projection {
    let position_m = pose.position_m();
    let distance_m = edge.distance_m(position_m);
    let blind = !(distance_m <= params.edge_distance_max_m);
    let on_edge = if blind { 0.0 } else { 1.0 - EDGE_LOSS * distance_m / params.edge_distance_max_m };
    let direction_rad = edge.direction_rad(position_m);
    let projections = std::array::from_fn(|sonar| {
        let near = match ranges_m[sonar] {
            None => 0.0,
            Some(range_m) if range_m > params.range_max_m => 0.0,
            Some(range_m) => MAGNITUDE_MAX * (1.0 - range_m.max(0.0) / params.range_max_m),
        };
        let angle_rad = BEARINGS_DEG[sonar].to_radians() + pose.heading_rad - direction_rad;
        (near * on_edge * angle_rad.cos()).max(0.0)
    });
    let largest = (0..SONARS).max_by(|a, b| f64::total_cmp(&projections[*a], &projections[*b]));
    let sonar = largest.filter(|sonar| projections[*sonar] > params.threshold);
    Projection { projections, sonar, blind }
}

/// The classical detector that the paper compares with: an obstacle is any reading below `limit_m`, wall or not.
#[must_use]
pub fn classical(ranges_m: &[Option<f64>; SONARS], limit_m: f64) -> Option<usize> {
    let near = |sonar: &usize| ranges_m[*sonar].is_some_and(|range_m| !(range_m >= limit_m));
    let range_m = |sonar: &usize| ranges_m[*sonar].unwrap_or(f64::INFINITY);
    (0..SONARS).filter(near).min_by(|a, b| range_m(a).total_cmp(&range_m(b)))
}
