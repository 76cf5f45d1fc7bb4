//! The twelve virtual sonars of the ring, taken all at once from the scan of the whole robot (paper 003; specification, section
//! 10).
//!
//! Goes in: a [`RobotScan`]. Comes out: what twelve plain sonars would read, and the objects that neighbours hear together. Two
//! neighbours that hear the same reflector of the scan measure it once: the triangle closes exactly, and the object's covariance
//! is that of the reflector, not that of two independent ranges. A reflector that two sensors hear is fused from both, which are
//! independent. An energyscape also tells of echoes behind the nearest: [`Echoes`] says whether they count. Never fuses over
//! pings.

use super::params::RingParams;
use super::ring::{self, RingObject, SONARS};
use super::triangulation::CHI_SQUARE_2;
use super::virtual_sonar::{SonarReading, VirtualSonar};
use crate::geometry::{Pose2, cartesian_from_polar, polar_from_cartesian, wrap_angle_rad};
use crate::signal::{PEAKS_MAX, Peak, Reading, RobotScan};
use nalgebra::{Matrix2, Rotation2, Vector2};

/// Most objects of one scan; the nearest are kept.
pub const OBJECTS_MAX: usize = 32;
/// What two sensors may differ by about one thing beside their noise: they hear two places of its surface, and each hears the
/// other's echo as well, which comes from the mean of the two ranges.
const TWO_VIEWS_SIGMA_M: f64 = 0.015;
/// Radius that a thing may well have: of what is round every sensor hears another point.
const ROUND_M: f64 = 0.05;
/// And what no reflector is known better by than: the robot shakes, sensors are mounted so well.
const PLACE_SIGMA_M: f64 = 0.001;

/// Which echoes of a virtual sonar make objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Echoes {
    /// The nearest, as of a plain sonar.
    Nearest,
    /// All that the image shows in its cone.
    #[default]
    All,
}

/// Twelve virtual sonars.
#[derive(Debug, Clone)]
pub struct VirtualRing {
    sonars: [VirtualSonar; SONARS],
    echoes: Echoes,
    /// Reflectors that became objects, in the robot frame; scratch.
    found: Vec<Found>,
}

/// A reflector on its way to an object.
#[derive(Debug, Clone, Copy)]
struct Found {
    position_m: Vector2<f64>,
    covariance_m2: Matrix2<f64>,
    pair: [usize; 2],
    /// Bit k is set when sensor k went in.
    sensors: u32,
}

impl VirtualRing {
    /// The ring of `params`.
    #[must_use]
    pub fn new(params: &RingParams, echoes: Echoes) -> Self {
        let sonar = |index: usize| {
            let heading_rad = wrap_angle_rad(ring::bearing_rad(index));
            let at_m = cartesian_from_polar(params.ring_radius_m, heading_rad);
            VirtualSonar {
                transducer: Pose2 { x_m: at_m.x, y_m: at_m.y, heading_rad },
                cone_rad: params.cone_deg.to_radians(),
                range_max_m: params.range_max_m,
            }
        };
        Self { sonars: std::array::from_fn(sonar), echoes, found: Vec::with_capacity(PEAKS_MAX) }
    }

    /// Reads all sonars.
    #[must_use]
    pub fn read(&self, scan: &RobotScan) -> [SonarReading; SONARS] {
        std::array::from_fn(|index| self.sonars[index].read(scan))
    }

    /// Replaces `objects` by what neighbours hear together, in the frame that `pose` is given in, nearest first. Allocates
    /// nothing if `objects` has room for [`OBJECTS_MAX`].
    pub fn objects(
        &mut self,
        scan: &RobotScan,
        readings: &[SonarReading; SONARS],
        pose: &Pose2,
        objects: &mut Vec<RingObject>,
    ) {
        self.found.clear();
        for (index, peak) in scan.peaks.iter().enumerate().take(PEAKS_MAX) {
            let Some(pair) = self.pair_of(index, peak, readings) else {
                continue;
            };
            let covariance_m2 = covariance_m2(peak, cross_talk_sigma_m(scan, peak));
            let found =
                Found { position_m: peak.position_m, covariance_m2, pair, sensors: 1 << (peak.sensor_index % 32) };
            let finite = found.position_m.iter().chain(covariance_m2.iter()).all(|value| value.is_finite());
            if finite && !self.is_taken_in(&found) {
                self.found.push(found);
            }
        }
        let turn = Rotation2::new(pose.heading_rad);
        objects.clear();
        objects.extend(self.found.iter().take(OBJECTS_MAX).map(|found| RingObject {
            position_m: pose.parent_from_local(found.position_m),
            pair: found.pair,
            covariance_m2: turn.matrix() * found.covariance_m2 * turn.matrix().transpose(),
        }));
    }

    /// The pair of neighbours that hears a reflector and looks straightest at it.
    fn pair_of(&self, index: usize, peak: &Peak, readings: &[SonarReading; SONARS]) -> Option<[usize; 2]> {
        let hears = |sonar: usize| match self.echoes {
            Echoes::Nearest => readings[sonar].peak == Some(index),
            Echoes::All => self.sonars[sonar].hears(peak),
        };
        let (_, bearing_rad) = polar_from_cartesian(peak.position_m);
        let off_rad = |first: usize| {
            let axis_rad = ring::bearing_rad(first) + 0.5 * ring::bearing_rad(1);
            wrap_angle_rad(bearing_rad - axis_rad).abs()
        };
        let pairs = (0..SONARS).filter(|first| hears(*first) && hears((first + 1) % SONARS));
        let first = pairs.min_by(|a, b| off_rad(*a).total_cmp(&off_rad(*b)))?;
        Some([first, (first + 1) % SONARS])
    }

    /// Fuses a reflector with one that another sensor heard in the same place, if there is one.
    fn is_taken_in(&mut self, new: &Found) -> bool {
        let views_m2 = Matrix2::identity() * TWO_VIEWS_SIGMA_M.powi(2);
        for known in self.found.iter_mut().filter(|known| known.sensors & new.sensors == 0) {
            let apart_m = new.position_m - known.position_m;
            let sum_m2 = known.covariance_m2 + new.covariance_m2;
            let Some((inverse, wide)) = sum_m2.try_inverse().zip((sum_m2 + views_m2).try_inverse()) else { continue };
            if (apart_m.transpose() * wide * apart_m)[0] > CHI_SQUARE_2 {
                continue;
            }
            let gain = known.covariance_m2 * inverse;
            let fused_m2 = known.covariance_m2 - gain * known.covariance_m2;
            // Where the two differ by more than their noise, what they say together is no better than that.
            let stretch = (0.5 * (apart_m.transpose() * inverse * apart_m)[0]).max(1.0);
            known.position_m += gain * apart_m;
            known.covariance_m2 = 0.5 * stretch * (fused_m2 + fused_m2.transpose());
            known.sensors |= new.sensors;
            return true;
        }
        false
    }
}

impl VirtualSonar {
    /// Whether a reflector stands in the cone and within reach.
    #[must_use]
    pub fn hears(&self, peak: &Peak) -> bool {
        let (range_m, bearing_rad) = polar_from_cartesian(self.transducer.local_from_parent(peak.position_m));
        bearing_rad.abs() <= 0.5 * self.cone_rad && range_m <= self.range_max_m
    }
}

/// Three answers for every sonar, without what only this crate needs to know of them.
#[must_use]
pub fn answers(readings: &[SonarReading; SONARS]) -> [Reading; SONARS] {
    readings.map(|reading| reading.reading)
}

/// What a range may be too short by because another sensor stands nearer: its emission comes over the reflector first, and seems
/// to come from the mean of the two ranges. Standard deviation of anything between nothing and that.
fn cross_talk_sigma_m(scan: &RobotScan, peak: &Peak) -> f64 {
    let range_m = |sensor_m: Vector2<f64>| (peak.position_m - sensor_m).norm();
    let others = scan.peaks.iter().filter(|other| other.sensor_index != peak.sensor_index);
    // Half of the difference is left of it in a range that is too short by the other half already.
    let short_m = others.map(|other| range_m(peak.sensor_m) - range_m(other.sensor_m)).fold(0.0, f64::max);
    short_m / 3f64.sqrt()
}

/// Covariance of a reflector in the robot frame: along and across the line of sight of the sensor that heard it.
fn covariance_m2(peak: &Peak, cross_talk_sigma_m: f64) -> Matrix2<f64> {
    let (range_m, bearing_rad) = polar_from_cartesian(peak.position_m - peak.sensor_m);
    let (_, from_middle_rad) = polar_from_cartesian(peak.position_m);
    let turn = Rotation2::new(bearing_rad);
    // What is told is the place as seen from the robot's middle; the sensor looks from beside it.
    let round_m = ROUND_M * wrap_angle_rad(bearing_rad - from_middle_rad);
    let across_m2 = (range_m * peak.bearing_sigma_rad).powi(2) + round_m * round_m + PLACE_SIGMA_M.powi(2);
    let along_m2 = peak.range_sigma_m.powi(2) + cross_talk_sigma_m.powi(2) + PLACE_SIGMA_M.powi(2);
    turn.matrix() * Matrix2::new(along_m2, 0.0, 0.0, across_m2) * turn.matrix().transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peak(x_m: f64, y_m: f64, sensor_index: usize) -> Peak {
        let sensor_m = cartesian_from_polar(0.1, (120.0 * sensor_index as f64).to_radians());
        let position_m = Vector2::new(x_m, y_m);
        Peak { position_m, sensor_m, range_sigma_m: 0.004, bearing_sigma_rad: 0.02, energy: 0.01, sensor_index }
    }

    fn scan(peaks: &[Peak]) -> RobotScan {
        let mut scan = RobotScan::unseen();
        scan.peaks.extend_from_slice(peaks);
        scan
    }

    fn found(params: &RingParams, peaks: &[Peak], pose: &Pose2, echoes: Echoes) -> Vec<RingObject> {
        let (scan, mut ring) = (scan(peaks), VirtualRing::new(params, echoes));
        let (readings, mut objects) = (ring.read(&scan), Vec::new());
        ring.objects(&scan, &readings, pose, &mut objects);
        objects
    }

    const PARAMS: RingParams =
        RingParams { ring_radius_m: 0.1, cone_deg: 90.0, cell_m: 0.2, range_noise_m: 0.005, range_max_m: 1.5 };

    #[test]
    fn readings_of_one_reflector_triangulate_to_the_reflector_itself() {
        let place = peak(0.55, 0.2, 0);
        let wide = RingParams { cone_deg: 120.0, ..PARAMS };
        let ring = VirtualRing::new(&wide, Echoes::Nearest);
        let readings = ring.read(&scan(&[place]));
        let ranges_m: [Option<f64>; SONARS] = readings.map(|reading| reading.range_m());
        assert!(ranges_m.iter().flatten().count() >= 3, "{ranges_m:?}");
        let pose = Pose2 { x_m: 1.0, y_m: -2.0, heading_rad: 0.7 };
        let objects = found(&wide, &[place], &pose, Echoes::Nearest);
        let by_circles = ring::objects(&wide, &ranges_m, &pose);
        assert_eq!(objects.len(), 1, "{objects:?}");
        assert!(by_circles.len() >= 2, "every pair of plain sonars that hears it gives one");
        for object in by_circles {
            assert!((object.position_m - objects[0].position_m).norm() < 1e-9);
        }
        assert_eq!(objects[0].pair, [0, 1]);
    }

    #[test]
    fn the_covariance_is_the_reflectors_and_turns_with_the_robot() {
        // Straight ahead of the front sensor: 4 mm along, 0.02 rad of 0.9 m across.
        let ahead = found(&PARAMS, &[peak(1.0, 0.0, 0)], &Pose2::default(), Echoes::All)[0].covariance_m2;
        assert!((ahead.m11.sqrt() - 0.004).abs() < 2e-4 && (ahead.m22.sqrt() - 0.018).abs() < 2e-4, "{ahead}");
        let turned = Pose2 { heading_rad: std::f64::consts::FRAC_PI_2, ..Pose2::default() };
        let left = found(&PARAMS, &[peak(1.0, 0.0, 0)], &turned, Echoes::All)[0].covariance_m2;
        assert!((left.m22.sqrt() - 0.004).abs() < 2e-4 && (left.m11.sqrt() - 0.018).abs() < 2e-4, "{left}");
    }

    #[test]
    fn what_two_sensors_hear_in_one_place_is_one_object_and_better_known() {
        let pose = Pose2::default();
        let one = found(&PARAMS, &[peak(0.4, 0.6, 0)], &pose, Echoes::All);
        let two = found(&PARAMS, &[peak(0.4, 0.6, 0), peak(0.405, 0.598, 1)], &pose, Echoes::All);
        assert_eq!((one.len(), two.len()), (1, 1));
        assert!(two[0].covariance_m2.determinant() < 0.8 * one[0].covariance_m2.determinant());
        let apart = found(&PARAMS, &[peak(0.4, 0.6, 0), peak(0.6, 0.4, 1)], &pose, Echoes::All);
        assert_eq!(apart.len(), 2, "28 cm apart are two things");
        let same = found(&PARAMS, &[peak(0.4, 0.6, 0), peak(0.405, 0.598, 0)], &pose, Echoes::All);
        assert_eq!(same.len(), 2, "one sensor does not hear one thing twice");
    }

    #[test]
    fn a_range_that_cross_talk_may_have_shortened_counts_less_than_one_that_it_cannot() {
        // Heard well by the front sensor, and 3 cm too near by the left one, to which it is farther.
        let place = peak(0.9, 0.3, 0);
        let towards = (place.position_m - peak(0.0, 0.0, 1).sensor_m).normalize();
        let near_m = place.position_m - towards * 0.03;
        let pose = Pose2::default();
        let both = found(&PARAMS, &[place, peak(near_m.x, near_m.y, 1)], &pose, Echoes::All);
        assert_eq!(both.len(), 1, "{both:?}");
        assert!((both[0].position_m - place.position_m).norm() < 0.01, "{}", both[0].position_m - place.position_m);
    }

    #[test]
    fn what_stands_behind_is_told_by_the_image_and_not_by_the_nearest_echo() {
        let peaks = [peak(0.5, 0.15, 0), peak(1.0, 0.1, 0)];
        let pose = Pose2::default();
        assert_eq!(found(&PARAMS, &peaks, &pose, Echoes::Nearest).len(), 1);
        assert_eq!(found(&PARAMS, &peaks, &pose, Echoes::All).len(), 2);
    }

    #[test]
    fn two_things_that_two_neighbours_hear_make_no_third() {
        // Readings that a pair of plain sonars would take for one thing between them.
        let peaks = [peak(0.75, -0.18, 0), peak(0.75, 0.55, 1)];
        let narrow = RingParams { cone_deg: 60.0, ..PARAMS };
        let objects = found(&narrow, &peaks, &Pose2::default(), Echoes::Nearest);
        for object in &objects {
            assert!(peaks.iter().any(|peak| (peak.position_m - object.position_m).norm() < 1e-9), "{object:?}");
        }
    }

    #[test]
    fn a_crowd_is_cut_at_what_there_is_room_for() {
        let crowd: Vec<Peak> = (0..PEAKS_MAX)
            .map(|index| {
                let at_m = cartesian_from_polar(0.4 + 0.01 * index as f64, 0.7 * index as f64);
                peak(at_m.x, at_m.y, 0)
            })
            .collect();
        assert_eq!(found(&PARAMS, &crowd, &Pose2::default(), Echoes::All).len(), OBJECTS_MAX);
    }
}
