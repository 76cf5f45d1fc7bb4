//! How far along the way the sensors see: unseen is not free (specification, section 5).
//!
//! Goes in: which sensors see which points. Comes out: for every set of sensors the length of way ahead of and behind the
//! footprint, over its whole width, that is seen without a gap. Built once; energies are not looked at.
//!
//! A sensor is deaf nearer than its first range, so right at the footprint no layout sees anything. That stretch was in view
//! when the robot was farther back, and what came into it was then heard in the CA region. Up to a configured length
//! (`blind_gap_m`) it therefore counts as seen; a longer one, or one that begins farther out, ends the coverage.

use crate::geometry::{polar_from_cartesian, wrap_angle_rad};
use crate::sensor::Mount;
use crate::signal::{CoverageCue, Direction, PolarGrid, SENSORS_MAX};
use nalgebra::Vector2;

/// Distance between probed points.
const PROBE_STEP_M: f64 = 0.05;
/// Farthest that coverage is looked for from the footprint: more than any stopping distance here.
const REACH_M: f64 = 3.0;
/// Half of a beam's width: a point within it of a direction of interest is heard in that direction.
const BEAM_HALF_WIDTH_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;

/// Bit set of the sensors in use: bit k = sensor k.
pub(super) fn bits(used: [bool; SENSORS_MAX]) -> usize {
    used.iter().enumerate().fold(0, |bits, (index, used)| bits | usize::from(*used) << index)
}

/// What the sensors can see at all: whatever they hear, within range of them and in a direction that nothing hides.
pub struct View<'a> {
    grid: &'a PolarGrid,
    mounts: &'a [Mount],
    hidden: &'a [Vec<bool>],
    /// Farthest that a seen point may lie from a direction of interest.
    tolerance_rad: f64,
}

impl<'a> View<'a> {
    /// Sensors at `mounts` that share `grid`; `hidden[sensor][direction]` says what each cannot see.
    #[must_use]
    pub fn new(grid: &'a PolarGrid, mounts: &'a [Mount], hidden: &'a [Vec<bool>]) -> Self {
        // Of several rows of directions near the plane the one nearest to it says how far apart they are.
        let height = |direction: &Direction| direction.elevation_rad.abs();
        let lowest_rad = grid.directions().iter().map(height).fold(BEAM_HALF_WIDTH_RAD, f64::min);
        let row = grid.directions().iter().filter(|direction| height(direction) <= lowest_rad + 1e-9);
        let mut azimuths: Vec<f64> = row.map(|direction| direction.azimuth_rad).collect();
        azimuths.sort_by(f64::total_cmp);
        let mut gaps: Vec<f64> = azimuths.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > 0.0).collect();
        gaps.sort_by(f64::total_cmp);
        let spacing_rad = gaps.get(gaps.len() / 2).copied().unwrap_or(BEAM_HALF_WIDTH_RAD);
        // Half a spacing and a bit: points between two directions are seen, points beyond the last one are not.
        Self { grid, mounts, hidden, tolerance_rad: (0.6 * spacing_rad).min(BEAM_HALF_WIDTH_RAD) }
    }

    /// Bit set of the sensors that see a point of the robot frame: within range of, and near enough in bearing to, a
    /// direction that is not hidden. Of grids with elevations the directions within a beam of the horizontal plane count.
    pub(super) fn seen_by(&self, point_m: Vector2<f64>) -> usize {
        (0..self.mounts.len()).fold(0, |bits, sensor| bits | usize::from(self.sees(sensor, point_m)) << sensor)
    }

    fn sees(&self, sensor_index: usize, point_m: Vector2<f64>) -> bool {
        let local_m = self.mounts[sensor_index].pose().local_from_parent(point_m);
        let (range_m, bearing_rad) = polar_from_cartesian(local_m);
        let last_m = self.grid.range_m(self.grid.range_count() - 1);
        range_m >= self.grid.range_first_m() && range_m <= last_m && self.sees_bearing(sensor_index, bearing_rad)
    }

    /// Whether the direction of interest nearest to a bearing from a sensor is near enough to it, and not hidden.
    ///
    /// # Panics
    /// If there is no such sensor.
    #[must_use]
    pub fn sees_bearing(&self, sensor_index: usize, bearing_rad: f64) -> bool {
        let hidden = &self.hidden[sensor_index];
        let levels = self.grid.directions().iter().zip(hidden).filter(|(direction, _)| is_level(direction));
        levels
            .map(|(direction, hidden)| (wrap_angle_rad(direction.azimuth_rad - bearing_rad).abs(), *hidden))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .is_some_and(|(offset_rad, hidden)| offset_rad <= self.tolerance_rad && !hidden)
    }
}

fn is_level(direction: &Direction) -> bool {
    direction.elevation_rad.abs() <= BEAM_HALF_WIDTH_RAD
}

/// Coverage of every set of sensors, indexed by [`bits`]. `seen_by` gives the sensors that see a point.
pub(super) fn of_all_sensor_sets(
    footprint_radius_m: f64,
    blind_gap_m: f64,
    seen_by: impl Fn(Vector2<f64>) -> usize,
) -> [CoverageCue; 1 << SENSORS_MAX] {
    let ahead = probe(footprint_radius_m, 1.0, &seen_by);
    let behind = probe(footprint_radius_m, -1.0, &seen_by);
    std::array::from_fn(|used| CoverageCue {
        ahead_m: covered_m(&ahead, used, blind_gap_m),
        behind_m: covered_m(&behind, used, blind_gap_m),
    })
}

/// Sensors that see each probed point: rows going outward from the footprint's front, points across its width.
fn probe(footprint_radius_m: f64, sign: f64, seen_by: impl Fn(Vector2<f64>) -> usize) -> Vec<Vec<usize>> {
    let row_count = (REACH_M / PROBE_STEP_M).round() as usize;
    let half_count = (footprint_radius_m / PROBE_STEP_M).ceil() as i64;
    let row = |index: usize| {
        let outward_m = (index as f64 + 0.5) * PROBE_STEP_M;
        (-half_count..=half_count)
            .map(|across| {
                let y_m = (across as f64 * PROBE_STEP_M).clamp(-footprint_radius_m, footprint_radius_m);
                seen_by(Vector2::new(sign * (footprint_radius_m + outward_m), y_m))
            })
            .collect()
    };
    (0..row_count).map(row).collect()
}

fn covered_m(rows: &[Vec<usize>], used: usize, blind_gap_m: f64) -> f64 {
    let seen = |row: &Vec<usize>| row.iter().all(|sees| sees & used != 0);
    let Some(first) = rows.iter().position(seen) else { return 0.0 };
    if !(first as f64 * PROBE_STEP_M <= blind_gap_m + 1e-9) {
        return 0.0;
    }
    let count = rows[first..].iter().take_while(|row| seen(row)).count();
    (first + count) as f64 * PROBE_STEP_M
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ahead_m(seen: impl Fn(Vector2<f64>) -> bool) -> f64 {
        of_all_sensor_sets(0.2, 0.4, |point_m| usize::from(seen(point_m)))[1].ahead_m
    }

    #[test]
    fn a_deaf_stretch_at_the_footprint_is_forgiven_up_to_its_limit_only() {
        assert!((ahead_m(|point_m| point_m.norm() > 0.5) - 3.0).abs() < 1e-9);
        assert_eq!(ahead_m(|point_m| point_m.x > 0.75), 0.0);
    }

    #[test]
    fn a_gap_farther_out_or_at_one_side_ends_the_coverage() {
        assert!((ahead_m(|point_m| point_m.x < 1.2 || point_m.x > 1.3) - 1.0).abs() < 0.1);
        assert_eq!(ahead_m(|point_m| point_m.y < 0.1), 0.0);
    }

    #[test]
    fn without_sensors_nothing_is_covered() {
        assert_eq!(of_all_sensor_sets(0.2, 0.4, |_| 7)[0], CoverageCue::default());
    }
}
