//! From the peaks of all sensors to a cloud of points in the robot frame: what is floor, in the way, overhead or ceiling.
//!
//! Goes in: images on a grid with elevations, sensor by sensor. Comes out: a [`PointCloud`] with classes by height, the slice of it that
//! the robot drives in, and the heights of floor and ceiling: medians of what echoed from straight below and above. Heights are those
//! above the plane of the sensors' origins; without a height band of the robot everything is an obstacle. Allocates nothing after it
//! was made.

use super::space_peaks::{PEAKS_MAX, SpaceFinder, SpacePeak};
use crate::geometry::Pose2;
use crate::sensor::SensorSetup;
use crate::signal::{POINTS_MAX, PointCloud, PolarGrid, SLICE_BEARINGS, SpaceClass, SpacePoint};
use crate::time::Stamp;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;

/// Sine of the elevation from which an echo comes from straight below or above.
const UPRIGHT_SINE: f64 = 0.95;
/// Heights that a median is taken of, and the fewest.
const HEIGHTS: usize = 15;
const HEIGHTS_MIN: usize = 3;
/// What is no lower than this below the ceiling is part of it.
const CEILING_MARGIN_M: f64 = 0.15;

/// Makes the clouds of a robot.
#[derive(Debug, Clone)]
pub struct SpaceDetector {
    finders: Vec<SpaceFinder>,
    poses: Vec<Pose2>,
    /// From the lowest to the highest part of the robot.
    band_m: Option<[f64; 2]>,
    /// Peaks of each sensor since the last cloud.
    peaks: Vec<Vec<SpacePeak>>,
    sequence: u64,
    emitted_at: Stamp,
    floor: Heights,
    ceiling: Heights,
}

/// The last heights heard from straight below or above.
#[derive(Debug, Clone, Copy, Default)]
struct Heights {
    ring_m: [f64; HEIGHTS],
    count: usize,
}

impl Heights {
    fn note(&mut self, height_m: f64) {
        self.ring_m[self.count % HEIGHTS] = height_m;
        self.count += 1;
    }

    fn median_m(&self) -> Option<f64> {
        let count = self.count.min(HEIGHTS);
        let mut sorted_m = self.ring_m;
        sorted_m[..count].sort_unstable_by(f64::total_cmp);
        (count >= HEIGHTS_MIN).then(|| sorted_m[count / 2])
    }
}

impl SpaceDetector {
    /// A detector for sensors that share `grid`; `None` where the grid is level: it tells no heights. `band_m` is what of the heights
    /// the robot fills, the other arguments are those of [`super::ScanFuser::new`].
    #[must_use]
    pub fn new(
        grid: &PolarGrid,
        sensors: &[SensorSetup],
        hidden: &[Vec<bool>],
        floor_at: impl Fn(f64) -> f64,
        side_lobe_share: f64,
        band_m: Option<[f64; 2]>,
    ) -> Option<Self> {
        if grid.is_horizontal() {
            return None;
        }
        let none = Vec::new();
        let finder =
            |sensor: usize| SpaceFinder::new(grid, hidden.get(sensor).unwrap_or(&none), &floor_at, side_lobe_share);
        Some(Self {
            finders: (0..sensors.len()).map(finder).collect(),
            poses: sensors.iter().map(|sensor| sensor.mount.pose()).collect(),
            band_m,
            peaks: vec![Vec::with_capacity(PEAKS_MAX); sensors.len()],
            sequence: 0,
            emitted_at: Stamp::default(),
            floor: Heights::default(),
            ceiling: Heights::default(),
        })
    }

    /// Takes the image of a sensor; one that is not there is passed over.
    pub fn hear(&mut self, sensor_index: usize, sequence: u64, emitted_at: Stamp, cells: &[f32]) {
        let Some(finder) = self.finders.get_mut(sensor_index) else { return };
        if sequence != self.sequence {
            self.peaks.iter_mut().for_each(Vec::clear);
            (self.sequence, self.emitted_at) = (sequence, emitted_at);
        }
        if emitted_at.boottime_ns < self.emitted_at.boottime_ns {
            self.emitted_at = emitted_at;
        }
        finder.find(cells, &mut self.peaks[sensor_index]);
    }

    /// Makes the cloud of what was heard of the newest ping set, into `cloud`.
    pub fn update(&mut self, cloud: &mut PointCloud) {
        (cloud.sequence, cloud.emitted_at) = (self.sequence, self.emitted_at);
        cloud.points.clear();
        cloud.slice_m = [f64::INFINITY; SLICE_BEARINGS];
        for sensor_index in 0..self.peaks.len() {
            self.note_levels(sensor_index);
        }
        (cloud.floor_m, cloud.ceiling_m) = (self.floor.median_m(), self.ceiling.median_m());
        for (sensor_index, peaks) in self.peaks.iter_mut().enumerate() {
            let pose = self.poses[sensor_index];
            for peak in peaks.drain(..) {
                let class = class(self.band_m, cloud.ceiling_m, peak.position_m.z);
                let point = point(&pose, &peak, sensor_index, class);
                if class == SpaceClass::Obstacle {
                    enter(&mut cloud.slice_m, &point);
                }
                if cloud.points.len() < POINTS_MAX {
                    cloud.points.push(point);
                }
            }
        }
    }

    /// The loudest from straight below and above, where no part of the robot is.
    fn note_levels(&mut self, sensor_index: usize) {
        let Some([low_m, high_m]) = self.band_m else { return };
        let peaks = &self.peaks[sensor_index];
        let loudest = |upright: &dyn Fn(f64) -> bool| {
            let there = peaks.iter().filter(|peak| {
                peak.position_m.z.abs() >= UPRIGHT_SINE * peak.position_m.norm() && upright(peak.position_m.z)
            });
            there.max_by(|a, b| a.energy.total_cmp(&b.energy)).map(|peak| peak.position_m.z)
        };
        let (below_m, above_m) = (loudest(&|z_m| z_m < low_m), loudest(&|z_m| z_m > high_m));
        below_m.into_iter().for_each(|z_m| self.floor.note(z_m));
        above_m.into_iter().for_each(|z_m| self.ceiling.note(z_m));
    }
}

fn class(band_m: Option<[f64; 2]>, ceiling_m: Option<f64>, z_m: f64) -> SpaceClass {
    match band_m {
        Some([low_m, _]) if z_m < low_m => SpaceClass::Floor,
        Some([_, high_m]) if z_m > high_m => {
            let part_of_it = ceiling_m.is_some_and(|ceiling_m| z_m >= ceiling_m - CEILING_MARGIN_M);
            if part_of_it { SpaceClass::Ceiling } else { SpaceClass::Overhang }
        }
        _ => SpaceClass::Obstacle,
    }
}

fn point(pose: &Pose2, peak: &SpacePeak, sensor_index: usize, class: SpaceClass) -> SpacePoint {
    let (sin, cos) = pose.heading_rad.sin_cos();
    let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    SpacePoint {
        position_m: turn * peak.position_m + Vector3::new(pose.x_m, pose.y_m, 0.0),
        covariance_m2: turn * peak.covariance_m2 * turn.transpose(),
        energy: peak.energy,
        sensor_index,
        class,
    }
}

/// Enters a point into the bearings that it may lie in, a standard deviation to either side.
fn enter(slice_m: &mut [f64; SLICE_BEARINGS], point: &SpacePoint) {
    let place_m = point.position_m.xy();
    let range_m = place_m.norm();
    if !(range_m > 1e-6) {
        return;
    }
    let across = Vector3::new(-place_m.y, place_m.x, 0.0) / range_m;
    let sigma_rad = (across.dot(&(point.covariance_m2 * across))).max(0.0).sqrt() / range_m;
    let width_rad = TAU / SLICE_BEARINGS as f64;
    let middle = (place_m.y.atan2(place_m.x) + 0.5 * TAU) / width_rad;
    let half = (sigma_rad / width_rad).min(0.25 * SLICE_BEARINGS as f64);
    for bearing in (middle - half).floor() as i64..=(middle + half).floor() as i64 {
        let slot = &mut slice_m[bearing.rem_euclid(SLICE_BEARINGS as i64) as usize];
        *slot = slot.min(range_m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_class_is_a_matter_of_height() {
        let band_m = Some([-0.3, 0.4]);
        assert_eq!(class(band_m, None, -0.31), SpaceClass::Floor);
        assert_eq!(class(band_m, None, -0.29), SpaceClass::Obstacle);
        assert_eq!(class(band_m, None, 0.39), SpaceClass::Obstacle);
        assert_eq!(class(band_m, None, 2.0), SpaceClass::Overhang);
        assert_eq!(class(band_m, Some(2.1), 2.0), SpaceClass::Ceiling);
        assert_eq!(class(band_m, Some(2.1), 1.0), SpaceClass::Overhang);
        assert_eq!(class(None, Some(2.1), 5.0), SpaceClass::Obstacle);
    }

    #[test]
    fn a_height_is_a_median_that_one_wrong_echo_does_not_move() {
        let mut heights = Heights::default();
        [-0.4, -0.41].into_iter().for_each(|height_m| heights.note(height_m));
        assert_eq!(heights.median_m(), None);
        [-3.0, -0.4, -0.39].into_iter().for_each(|height_m| heights.note(height_m));
        assert_eq!(heights.median_m(), Some(-0.4));
        (0..HEIGHTS).for_each(|_| heights.note(-0.6));
        assert_eq!(heights.median_m(), Some(-0.6), "what is long past is forgotten");
    }

    #[test]
    fn a_point_enters_the_slice_at_its_bearing_and_the_nearest_stays() {
        let mut slice_m = [f64::INFINITY; SLICE_BEARINGS];
        let at = |x_m: f64, y_m: f64, z_m: f64| SpacePoint {
            position_m: Vector3::new(x_m, y_m, z_m),
            covariance_m2: Matrix3::identity() * 1e-6,
            ..SpacePoint::default()
        };
        enter(&mut slice_m, &at(0.0, 1.5, 0.2));
        enter(&mut slice_m, &at(0.0, 2.5, 0.0));
        // Behind is the first bearing, the left three quarters on.
        let left = SLICE_BEARINGS * 3 / 4;
        assert_eq!(slice_m[left], 1.5);
        assert!(slice_m[left + 2].is_infinite() && slice_m[left - 2].is_infinite());
        let wide = SpacePoint { covariance_m2: Matrix3::identity() * 0.04, ..at(-1.0, 0.0, 0.0) };
        enter(&mut slice_m, &wide);
        assert_eq!((slice_m[0], slice_m[3], slice_m[SLICE_BEARINGS - 3]), (1.0, 1.0, 1.0));
    }
}
