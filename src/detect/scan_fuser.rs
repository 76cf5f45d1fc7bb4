//! The scans of all sensors, fused to one around the robot.
//!
//! Goes in: one energyscape a sensor, in any order, none from a sensor that is lost. Comes out: for each of 360 bearings around the
//! robot's origin the nearest echo, nothing within range, or unseen, each echo with its uncertainty; and the reflectors behind them
//! ([`Peak`]). A bearing is clear only if some sensor saw every piece of it beyond the stretch that no sensor ever sees. Never
//! fuses over pings. Allocates nothing after it was made.

use super::range_scan::RangeScanner;
use crate::geometry::{Pose2, cartesian_from_polar, polar_from_cartesian, wrap_angle_rad};
use crate::sensor::SensorSetup;
use crate::signal::{PEAKS_MAX, Peak, PolarGrid, RAYS, RangeScan, Ray, Reading, RobotScan};
use crate::time::Stamp;
use nalgebra::Vector2;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Length of the pieces in which a ray is looked at.
const PIECE_M: f64 = 0.1;
/// Neighbouring directions hear the same reflector if their ranges differ by no more.
const RUN_STEP_M: f64 = 0.05;
/// Between two peaks of a run the envelope falls to this share of the lower one: flat tops are one peak (near the array a main lobe is
/// as flat as that).
const DIP_SHARE: f32 = 0.7;
/// Half of a beam's width: a place within it of a direction is seen in that direction.
const BEAM_HALF_WIDTH_RAD: f64 = 4.0 * TAU / 360.0;
/// Standard deviation of a range far above the noise, and of a bearing; the air's temperature is another matter. Measured:
/// tests/detectors_scenes/scan.rs.
const RANGE_SIGMA_M: f64 = 0.0006;
const BEARING_SIGMA_RAD: f64 = 0.08 * TAU / 360.0;
/// What is added to them, quadratically, at the noise floor; it falls with the amplitude.
const RANGE_SIGMA_AT_FLOOR_M: f64 = 0.003;
const BEARING_SIGMA_AT_FLOOR_RAD: f64 = 0.4 * TAU / 360.0;
/// Bearing of a peak at the border of what a sensor sees: what is heard there may stand outside.
const BORDER_SIGMA_RAD: f64 = 10.0 * TAU / 360.0;
/// And of one of which only one flank was heard.
const FLANK_SIGMA_RAD: f64 = 4.0 * TAU / 360.0;
/// Beyond 80 degrees a lobe does not get wider any more.
const ASIDE_MIN: f64 = 0.17;
/// No direction sees the place.
const NOWHERE: u16 = u16::MAX;

/// One sensor's part.
#[derive(Debug)]
struct Ear {
    pose: Pose2,
    scanner: RangeScanner,
    scan: RangeScan,
    /// Directions within a beam of the horizontal plane, by rising azimuth.
    level: Vec<u16>,
    heard: bool,
}

/// Where a piece of a ray lies for a sensor.
#[derive(Debug, Clone, Copy)]
struct Sight {
    direction: u16,
    range_m: f32,
}

/// Fuses the scans of all sensors.
#[derive(Debug)]
pub struct ScanFuser {
    ears: Vec<Ear>,
    /// `[ray][piece][sensor]`.
    sights: Vec<Sight>,
    piece_count: usize,
    /// Per ray the first piece that any sensor sees and the one behind the last; `piece_count` and 0 for none.
    in_sight: Vec<[usize; 2]>,
    range_m: [f64; 2],
    sequence: u64,
    emitted_at: Option<Stamp>,
}

impl ScanFuser {
    /// A fuser for `sensors` that share `grid`; `hidden[sensor][direction]` says what each cannot see. `floor_at` and
    /// `side_lobe_share` are those of [`RangeScanner::new`].
    #[must_use]
    pub fn new(
        grid: &Arc<PolarGrid>,
        sensors: &[SensorSetup],
        hidden: &[Vec<bool>],
        floor_at: impl Fn(f64) -> f64,
        side_lobe_share: f64,
    ) -> Self {
        let ears: Vec<Ear> = sensors
            .iter()
            .enumerate()
            .map(|(index, sensor)| Ear {
                pose: sensor.mount.pose(),
                scanner: RangeScanner::new(grid, &hidden[index], &floor_at, side_lobe_share),
                scan: RangeScan::unseen(Arc::clone(grid), index),
                level: level_directions(grid),
                heard: false,
            })
            .collect();
        let last_m = grid.range_m(grid.range_count() - 1);
        let reach_m = last_m + ears.iter().map(|ear| ear.pose.position_m().norm()).fold(0.0, f64::max);
        let piece_count = (reach_m / PIECE_M).ceil() as usize;
        let bearings: Vec<_> = ears.iter().map(Ear::bearings).collect();
        let mut sights = Vec::with_capacity(RAYS * piece_count * ears.len());
        for ray in 0..RAYS {
            for piece in 0..piece_count {
                let place_m = cartesian_from_polar(piece_middle_m(piece), RobotScan::bearing_rad(ray));
                let of_ear = |(index, ear): (usize, &Ear)| ear.sight(place_m, &hidden[index], &bearings[index]);
                sights.extend(ears.iter().enumerate().map(of_ear));
            }
        }
        let per_ray = piece_count * ears.len();
        let ends_of = |ray: usize| {
            let seen = |piece: &[Sight]| piece.iter().any(|sight| sight.direction != NOWHERE);
            let pieces = || sights[ray * per_ray..(ray + 1) * per_ray].chunks_exact(ears.len().max(1));
            [pieces().position(seen).unwrap_or(piece_count), pieces().rposition(seen).map_or(0, |last| last + 1)]
        };
        let in_sight: Vec<[usize; 2]> = (0..RAYS).map(ends_of).collect();
        let nearest = in_sight.iter().map(|[first, _]| *first).min().unwrap_or(0);
        let range_m = [nearest as f64 * PIECE_M, reach_m];
        Self { ears, sights, piece_count, in_sight, range_m, sequence: 0, emitted_at: None }
    }

    /// Takes what sensor `sensor_index` saw: the cells of its energyscape, wherever they lie. A sensor that is not there is ignored.
    pub fn hear(&mut self, sensor_index: usize, sequence: u64, emitted_at: Stamp, cells: &[f32]) {
        let Some(ear) = self.ears.get_mut(sensor_index) else { return };
        ear.scan.sequence = sequence;
        ear.scan.emitted_at = emitted_at;
        ear.scanner.scan_cells(cells, &mut ear.scan);
        ear.heard = true;
        self.pass(sequence, emitted_at);
    }

    /// Notes that a sensor emitted whose image cannot be used: the next scan has its time and not its sight.
    pub fn pass(&mut self, sequence: u64, emitted_at: Stamp) {
        self.sequence = self.sequence.max(sequence);
        let oldest = self.emitted_at.filter(|known| known.boottime_ns <= emitted_at.boottime_ns);
        self.emitted_at = Some(oldest.unwrap_or(emitted_at));
    }

    /// Fuses what was heard since the last call into `scan`. What only a sensor sees that was not heard is unseen.
    pub fn fuse(&mut self, scan: &mut RobotScan) {
        scan.sequence = std::mem::take(&mut self.sequence);
        scan.emitted_at = self.emitted_at.take().unwrap_or_default();
        scan.range_m = self.range_m;
        scan.sensors_used = 0;
        scan.rays.fill(Ray::default());
        scan.peaks.clear();
        for (index, ear) in self.ears.iter().enumerate().filter(|(_, ear)| ear.heard) {
            scan.sensors_used |= 1 << index;
            ear.add_echoes(index, scan);
        }
        let place = |peak: &Peak| peak.position_m.norm_squared();
        scan.peaks.sort_unstable_by(|a, b| place(a).total_cmp(&place(b)));
        for ray in 0..RAYS {
            let free_m = self.free_m(ray);
            let told = &mut scan.rays[ray];
            told.free_m = match told.reading {
                Reading::Echo { range_m, .. } => free_m.min(range_m),
                _ => free_m,
            };
            if told.reading == Reading::Unseen && free_m >= self.end_of_sight_m(ray) {
                told.reading = Reading::Clear;
            }
        }
        self.ears.iter_mut().for_each(|ear| ear.heard = false);
    }

    /// Distance up to which a ray is known to be free of echoes.
    fn free_m(&self, ray: usize) -> f64 {
        let [first, _] = self.in_sight[ray];
        let free = (first..self.piece_count).take_while(|piece| self.is_free(ray, *piece)).count();
        if free == 0 { 0.0 } else { (first + free) as f64 * PIECE_M }
    }

    /// Distance from which on no sensor could see the ray at all; what lies beyond does not make it unseen.
    fn end_of_sight_m(&self, ray: usize) -> f64 {
        match self.in_sight[ray] {
            [_, 0] => f64::INFINITY,
            [_, end] => end as f64 * PIECE_M,
        }
    }

    fn sights_of(&self, ray: usize, piece: usize) -> &[Sight] {
        let count = self.ears.len();
        let at = (ray * self.piece_count + piece) * count;
        &self.sights[at..at + count]
    }

    fn is_free(&self, ray: usize, piece: usize) -> bool {
        let beyond_m = 0.5 * PIECE_M;
        self.sights_of(ray, piece).iter().zip(&self.ears).any(|(sight, ear)| {
            ear.heard
                && match ear.scan.readings.get(usize::from(sight.direction)) {
                    Some(Reading::Clear) => true,
                    Some(Reading::Echo { range_m, .. }) => f64::from(sight.range_m) + beyond_m < *range_m,
                    Some(Reading::Unseen) | None => false,
                }
        })
    }
}

impl Ear {
    fn azimuth_rad(&self, order: usize) -> f64 {
        self.scan.grid.directions()[usize::from(self.level[order])].azimuth_rad
    }

    fn reading(&self, order: usize) -> Reading {
        self.scan.readings[usize::from(self.level[order])]
    }

    fn echo(&self, order: usize) -> Option<(f64, f32)> {
        match self.reading(order) {
            Reading::Echo { range_m, energy } => Some((range_m, energy)),
            Reading::Clear | Reading::Unseen => None,
        }
    }

    /// Bearing and place in the order of every level direction, by rising bearing.
    fn bearings(&self) -> Vec<(f64, usize)> {
        let of = |order: usize| (wrap_angle_rad(self.azimuth_rad(order)), order);
        let mut bearings: Vec<(f64, usize)> = (0..self.level.len()).map(of).collect();
        bearings.sort_by(|a, b| a.0.total_cmp(&b.0));
        bearings
    }

    /// Which direction sees a place of the robot frame, and how far off; `bearings` are those of [`Ear::bearings`].
    fn sight(&self, place_m: Vector2<f64>, hidden: &[bool], bearings: &[(f64, usize)]) -> Sight {
        let grid = &self.scan.grid;
        let (range_m, bearing_rad) = polar_from_cartesian(self.pose.local_from_parent(place_m));
        let nowhere = Sight { direction: NOWHERE, range_m: range_m as f32 };
        if range_m < grid.range_first_m() || range_m > grid.range_m(grid.range_count() - 1) {
            return nowhere;
        }
        // The neighbours on either side, or across the seam behind the sensor.
        let above = bearings.partition_point(|(direction_rad, _)| *direction_rad < bearing_rad);
        let near = [above.checked_sub(1), Some(above), Some(0), bearings.len().checked_sub(1)];
        let off = |index: usize| {
            bearings.get(index).map(|(at_rad, order)| (wrap_angle_rad(at_rad - bearing_rad).abs(), *order))
        };
        let nearest = near.into_iter().flatten().filter_map(off).min_by(|a, b| a.0.total_cmp(&b.0));
        let seen = nearest
            .filter(|(off_rad, order)| *off_rad <= BEAM_HALF_WIDTH_RAD && !hidden[usize::from(self.level[*order])]);
        seen.map_or(nowhere, |(_, order)| Sight { direction: self.level[order], range_m: range_m as f32 })
    }

    /// Enters this sensor's echoes as rays, the nearest of all sensors counting, and its reflectors as peaks.
    fn add_echoes(&self, sensor_index: usize, scan: &mut RobotScan) {
        let mut last: Option<(Vector2<f64>, f64)> = None;
        let mut peak_azimuth_rad = f64::NEG_INFINITY;
        for order in 0..self.level.len() {
            let Some((range_m, energy)) = self.echo(order) else {
                (last, peak_azimuth_rad) = (None, f64::NEG_INFINITY);
                continue;
            };
            let (range_sigma_m, fine_rad) = self.sigmas(range_m, energy);
            let place_m = self.pose.parent_from_local(cartesian_from_polar(range_m, self.azimuth_rad(order)));
            let same_run = last.filter(|(_, before_m)| (before_m - range_m).abs() <= RUN_STEP_M);
            if same_run.is_none() {
                peak_azimuth_rad = f64::NEG_INFINITY;
            }
            let mut bearing_sigma_rad = fine_rad;
            if self.is_peak(order, range_m, energy) {
                let peak = self.peak(order, sensor_index, (range_m, energy));
                bearing_sigma_rad = peak.bearing_sigma_rad;
                peak_azimuth_rad = self.azimuth_rad(order);
                push_nearest(&mut scan.peaks, peak);
            } else {
                let after_rad = self.next_peak_rad(order, range_m) - self.azimuth_rad(order);
                let before_rad = self.azimuth_rad(order) - peak_azimuth_rad;
                bearing_sigma_rad += after_rad.min(before_rad).min(BORDER_SIGMA_RAD);
            }
            let ray = Ray { reading: Reading::Echo { range_m, energy }, range_sigma_m, bearing_sigma_rad, free_m: 0.0 };
            enter(scan, place_m, ray);
            if let Some((before_m, _)) = same_run {
                // Directions of a sensor off the origin fan out: no gap between two that hear the same thing.
                for share in [0.25, 0.5, 0.75] {
                    enter(scan, before_m + (place_m - before_m) * share, ray);
                }
            }
            last = Some((place_m, range_m));
        }
    }

    /// Azimuth of the next peak of the same run; infinite without one.
    fn next_peak_rad(&self, order: usize, range_m: f64) -> f64 {
        let mut last_m = range_m;
        for next in order + 1..self.level.len() {
            let Some((range_m, energy)) = self.echo(next) else { break };
            let near = self.azimuth_rad(next) - self.azimuth_rad(order) <= BORDER_SIGMA_RAD;
            if !near || (range_m - last_m).abs() > RUN_STEP_M {
                break;
            }
            if self.is_peak(next, range_m, energy) {
                return self.azimuth_rad(next);
            }
            last_m = range_m;
        }
        f64::INFINITY
    }

    /// Whether a direction is the loudest of its run up to where the envelope has clearly fallen on either side; of equals the first.
    fn is_peak(&self, order: usize, range_m: f64, energy: f32) -> bool {
        let stands = |others: &mut dyn Iterator<Item = usize>, ties: bool| {
            for (_, other_energy) in self.same_run(others, range_m) {
                if other_energy > energy || (ties && other_energy == energy) {
                    return false;
                }
                if other_energy < DIP_SHARE * energy {
                    return true;
                }
            }
            true
        };
        stands(&mut (0..order).rev(), true) && stands(&mut (order + 1..self.level.len()), false)
    }

    /// Orders and envelopes of the neighbours in `others` that hear the same reflector, up to the first that does not.
    fn same_run<'a>(
        &'a self,
        others: &'a mut dyn Iterator<Item = usize>,
        range_m: f64,
    ) -> impl Iterator<Item = (usize, f32)> + 'a {
        let mut last_m = range_m;
        others.map_while(move |other| {
            let (other_m, energy) = self.echo(other)?;
            let same = (other_m - last_m).abs() <= RUN_STEP_M;
            last_m = other_m;
            same.then_some((other, energy))
        })
    }

    /// Where the envelope has fallen to [`DIP_SHARE`] of the peak's on one side: sine of the azimuth, in which a lobe is symmetric. `None`
    /// where the run ends before.
    fn flank(
        &self,
        others: &mut dyn Iterator<Item = usize>,
        order: usize,
        (range_m, energy): (f64, f32),
    ) -> Option<f64> {
        let wanted = DIP_SHARE * energy;
        let mut before = (order, energy);
        for (other, other_energy) in self.same_run(others, range_m) {
            if other_energy < wanted {
                let share = f64::from((before.1 - wanted) / (before.1 - other_energy));
                let (near, far) = (self.azimuth_rad(before.0).sin(), self.azimuth_rad(other).sin());
                return Some(near + share * (far - near));
            }
            before = (other, other_energy);
        }
        None
    }

    fn peak(&self, order: usize, sensor_index: usize, echo: (f64, f32)) -> Peak {
        let (range_m, energy) = echo;
        let (range_sigma_m, fine_rad) = self.sigmas(range_m, energy);
        let azimuth_rad = self.azimuth_rad(order);
        let right = self.flank(&mut (0..order).rev(), order, echo);
        let left = self.flank(&mut (order + 1..self.level.len()), order, echo);
        // A lobe is the wider the farther it looks aside.
        let aside = azimuth_rad.cos().max(ASIDE_MIN);
        let (bearing_rad, bearing_sigma_rad) = match (right, left) {
            (Some(right), Some(left)) => ((0.5 * (right + left)).asin(), fine_rad / aside),
            // A flank is missing: another reflector takes over there, or the sensor sees no farther.
            _ if self.is_border(order) => (azimuth_rad, BORDER_SIGMA_RAD),
            _ => (azimuth_rad, (fine_rad / aside).max(FLANK_SIGMA_RAD)),
        };
        Peak {
            position_m: self.pose.parent_from_local(cartesian_from_polar(range_m, bearing_rad)),
            sensor_m: self.pose.position_m(),
            range_sigma_m,
            bearing_sigma_rad,
            energy,
            sensor_index,
        }
    }

    /// Whether a sensor sees nothing beside this direction on one side.
    fn is_border(&self, order: usize) -> bool {
        let unseen = |other: Option<usize>| {
            other.filter(|other| *other < self.level.len()).is_none_or(|other| self.reading(other) == Reading::Unseen)
        };
        unseen(order.checked_sub(1)) || unseen(Some(order + 1))
    }

    fn sigmas(&self, range_m: f64, energy: f32) -> (f64, f64) {
        let floor = f64::from(self.scanner.floor_at(&self.scan.grid, range_m));
        let noise = (floor / f64::from(energy).max(1e-30)).min(1.0);
        (
            RANGE_SIGMA_M.hypot(RANGE_SIGMA_AT_FLOOR_M * noise),
            BEARING_SIGMA_RAD.hypot(BEARING_SIGMA_AT_FLOOR_RAD * noise),
        )
    }
}

fn piece_middle_m(piece: usize) -> f64 {
    (piece as f64 + 0.5) * PIECE_M
}

fn level_directions(grid: &PolarGrid) -> Vec<u16> {
    let directions = grid.directions();
    let level = |index: &u16| directions[usize::from(*index)].elevation_rad.abs() <= BEAM_HALF_WIDTH_RAD;
    let mut found: Vec<u16> = (0..directions.len().min(usize::from(NOWHERE)) as u16).filter(level).collect();
    let azimuth_rad = |index: &u16| directions[usize::from(*index)].azimuth_rad;
    found.sort_by(|a, b| azimuth_rad(a).total_cmp(&azimuth_rad(b)));
    found
}

/// Enters an echo at a place of the robot frame unless a nearer one stands on its ray.
fn enter(scan: &mut RobotScan, place_m: Vector2<f64>, ray: Ray) {
    let (range_m, bearing_rad) = polar_from_cartesian(place_m);
    let Reading::Echo { energy, .. } = ray.reading else { return };
    let known = &mut scan.rays[RobotScan::ray_at(bearing_rad)];
    if matches!(known.reading, Reading::Echo { range_m: known_m, .. } if known_m <= range_m) {
        return;
    }
    *known = Ray { reading: Reading::Echo { range_m, energy }, ..ray };
}

/// Keeps the nearest [`PEAKS_MAX`] reflectors.
fn push_nearest(peaks: &mut Vec<Peak>, peak: Peak) {
    if peaks.len() < PEAKS_MAX {
        peaks.push(peak);
        return;
    }
    let far_m2 = |peak: &Peak| peak.position_m.norm_squared();
    let farthest = (0..peaks.len()).max_by(|a, b| far_m2(&peaks[*a]).total_cmp(&far_m2(&peaks[*b])));
    if let Some(farthest) = farthest.filter(|index| far_m2(&peaks[*index]) > far_m2(&peak)) {
        peaks[farthest] = peak;
    }
}
