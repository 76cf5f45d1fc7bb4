//! Every reflector of an energyscape, not only the nearest of each direction: what moves through the image when the robot moves.
//!
//! Goes in: the cells of one sensor's image. Comes out: up to [`REFLECTORS_MAX`] reflectors with range and bearing finer than a cell
//! and their uncertainties. A reflector is a hill of the image: highest in range and in bearing until the envelope has fallen to 70 %
//! on either side; its range is the vertex of a parabola, its bearing the middle between the two flanks, in the sine of the azimuth, in
//! which a lobe is symmetric. What may be a side lobe of something louder at about its range is none. Never fuses sensors or pings,
//! allocates nothing after it was made.

use super::side_lobes::{Tops, keep};
use crate::signal::PolarGrid;

/// Most reflectors of one sensor; the loudest, spreading undone, are kept.
pub const REFLECTORS_MAX: usize = 24;
/// A reflector stands this much above the noise floor.
const ABOVE_FLOOR: f32 = 1.5;
/// Where a hill ends.
const FLANK_SHARE: f32 = 0.7;
/// Farthest flank, in directions.
const FLANK_MAX: usize = 16;
/// The crest of a hill bends in range by no more than this from direction to direction.
const BEND_BINS: usize = 2;
/// Elevation up to which a direction counts as level.
const LEVEL_RAD: f64 = 0.07;
/// Repeatability of a range and a bearing far above the noise, and what is added at the noise floor.
const RANGE_SIGMA_M: f64 = 0.0006;
const RANGE_SIGMA_AT_FLOOR_M: f64 = 0.003;
const BEARING_SIGMA_RAD: f64 = 0.002;
const BEARING_SIGMA_AT_FLOOR_RAD: f64 = 0.007;
/// Bearing of a hill of which a flank is missing.
const FLANK_SIGMA_RAD: f64 = 0.07;
/// Beyond 80 degrees a lobe does not get wider any more.
const ASIDE_MIN: f64 = 0.17;

/// One reflector, in its sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reflector {
    /// Range.
    pub range_m: f64,
    /// Bearing.
    pub bearing_rad: f64,
    /// Standard deviation of the range.
    pub range_sigma_m: f64,
    /// Standard deviation of the bearing.
    pub bearing_sigma_rad: f64,
    /// Envelope, linear amplitude in units of full scale.
    pub energy: f32,
}

/// Finds the reflectors of one sensor.
#[derive(Debug, Clone)]
pub struct ReflectorFinder {
    /// Level directions that are seen, by rising azimuth: row and sine of the azimuth. Apart by more than a beam: a border.
    level: Vec<(usize, f64, f64)>,
    tops: Tops,
}

impl ReflectorFinder {
    /// A finder for images on `grid`; the arguments are those of [`super::RangeScanner::new`].
    #[must_use]
    pub fn new(grid: &PolarGrid, hidden: &[bool], floor_at: impl Fn(f64) -> f64, side_lobe_share: f64) -> Self {
        let seen = |index: &usize| {
            !hidden.get(*index).copied().unwrap_or(false) && grid.directions()[*index].elevation_rad.abs() <= LEVEL_RAD
        };
        let mut level: Vec<(usize, f64, f64)> = (0..grid.direction_count())
            .filter(seen)
            .map(|index| (index, grid.directions()[index].azimuth_rad, grid.directions()[index].azimuth_rad.sin()))
            .collect();
        level.sort_by(|a, b| a.1.total_cmp(&b.1));
        Self { level, tops: Tops::new(grid, floor_at, side_lobe_share, ABOVE_FLOOR) }
    }

    /// Fills `found`, by falling weight; nothing where the cells are not those of the grid.
    pub fn find(&mut self, cells: &[f32], found: &mut Vec<Reflector>) {
        found.clear();
        if !self.tops.listen(cells, self.level.iter().map(|(row, _, _)| *row)) {
            return;
        }
        for order in 0..self.level.len() {
            for bin in self.tops.of_row(self.row(cells, order)) {
                if let Some(reflector) = self.reflector(cells, order, bin) {
                    keep(found, REFLECTORS_MAX, reflector, |other| f64::from(other.energy) * other.range_m);
                }
            }
        }
    }

    fn row<'a>(&self, cells: &'a [f32], order: usize) -> &'a [f32] {
        let (row, count) = (self.level[order].0, self.tops.range_count());
        &cells[row * count..(row + 1) * count]
    }

    /// The hill with this top; `None` if there is a higher place on it.
    fn reflector(&self, cells: &[f32], order: usize, bin: usize) -> Option<Reflector> {
        let row = self.row(cells, order);
        let mut right = (0..order).rev();
        let mut left = order + 1..self.level.len();
        let right = self.flank(cells, &mut right, (order, bin), true)?;
        let left = self.flank(cells, &mut left, (order, bin), false)?;
        let noise = self.tops.noise(row, bin);
        let fine_rad = BEARING_SIGMA_RAD.hypot(BEARING_SIGMA_AT_FLOOR_RAD * noise);
        let azimuth_rad = self.level[order].1;
        let aside = azimuth_rad.cos().max(ASIDE_MIN);
        let (bearing_rad, bearing_sigma_rad) = match (right, left) {
            (Some(right), Some(left)) => {
                let middle_rad = (0.5 * (right + left)).asin();
                // The arcsine is that of the half in front.
                let behind = azimuth_rad.cos() < 0.0;
                let bearing_rad =
                    if behind { azimuth_rad.signum() * std::f64::consts::PI - middle_rad } else { middle_rad };
                (bearing_rad, fine_rad / aside)
            }
            _ => (azimuth_rad, FLANK_SIGMA_RAD),
        };
        Some(Reflector {
            range_m: self.tops.range_m(row, bin),
            bearing_rad,
            range_sigma_m: RANGE_SIGMA_M.hypot(RANGE_SIGMA_AT_FLOOR_M * noise),
            bearing_sigma_rad,
            energy: row[bin],
        })
    }

    /// Sine of the azimuth where the crest has fallen to [`FLANK_SHARE`]: `None` inside if it does not before the view ends, `None`
    /// outside if it rises above the top. Of equally high places only the first in order is a top.
    fn flank(
        &self,
        cells: &[f32],
        others: &mut dyn Iterator<Item = usize>,
        (order, bin): (usize, usize),
        ties: bool,
    ) -> Option<Option<f64>> {
        let top = self.row(cells, order)[bin];
        let wanted = FLANK_SHARE * top;
        let (mut before, mut bin) = ((order, top), bin);
        for other in others.take(FLANK_MAX) {
            if (self.level[other].1 - self.level[before.0].1).abs() > LEVEL_RAD {
                return Some(None);
            }
            let row = self.row(cells, other);
            let (first, last) = (bin.saturating_sub(BEND_BINS), (bin + BEND_BINS).min(row.len() - 1));
            let crest = (first..=last).max_by(|a, b| row[*a].total_cmp(&row[*b])).unwrap_or(bin);
            let value = row[crest];
            if value > top || (ties && value == top) {
                return None;
            }
            if !(value >= wanted) {
                let share = f64::from((before.1 - wanted) / (before.1 - value));
                let (near, far) = (self.level[before.0].2, self.level[other].2);
                return Some(Some(near + share * (far - near)));
            }
            (before, bin) = ((other, value), crest);
        }
        Some(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Direction;

    fn grid() -> PolarGrid {
        let directions = (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect();
        PolarGrid::new(directions, 0.3, 0.005, 400)
    }

    fn image(grid: &PolarGrid, hills: &[(f64, f64, f32)]) -> Vec<f32> {
        let mut cells = vec![0.0; grid.cell_count()];
        for direction in 0..grid.direction_count() {
            for bin in 0..grid.range_count() {
                let at = &mut cells[grid.cell(direction, bin)];
                for (range_m, bearing_deg, height) in hills {
                    let far = (grid.range_m(bin) - range_m) / 0.012;
                    let aside =
                        (grid.directions()[direction].azimuth_rad.sin() - bearing_deg.to_radians().sin()) / 0.09;
                    *at += height * (-far * far - aside * aside).exp() as f32;
                }
            }
        }
        cells
    }

    fn find(hills: &[(f64, f64, f32)]) -> Vec<Reflector> {
        let grid = grid();
        let mut finder = ReflectorFinder::new(&grid, &[], |_| 1e-3, 0.4);
        let mut found = Vec::with_capacity(REFLECTORS_MAX);
        finder.find(&image(&grid, hills), &mut found);
        found
    }

    #[test]
    fn two_reflectors_of_one_direction_are_both_found_finer_than_a_cell() {
        let found = find(&[(0.8137, 20.3, 0.05), (1.6281, 20.3, 0.2)]);
        assert_eq!(found.len(), 2, "{found:?}");
        for (reflector, range_m) in found.iter().zip([1.6281, 0.8137]) {
            assert!((reflector.range_m - range_m).abs() < 3e-4, "{reflector:?}");
            assert!((reflector.bearing_rad.to_degrees() - 20.3).abs() < 0.05, "{reflector:?}");
        }
    }

    #[test]
    fn side_lobes_and_noise_are_none_and_the_view_ends_without_a_flank() {
        assert_eq!(find(&[(1.0, 0.0, 0.1), (1.02, 50.0, 0.03)]).len(), 1, "10 dB below at the same range");
        assert_eq!(find(&[(1.0, 0.0, 0.1), (1.2, 50.0, 0.03)]).len(), 2);
        assert!(find(&[(1.0, 0.0, 1.4e-3)]).is_empty());
        let border = find(&[(1.0, 88.0, 0.1)]);
        assert!(border.len() == 1 && border[0].bearing_sigma_rad >= FLANK_SIGMA_RAD, "{border:?}");
    }

    #[test]
    fn no_numbers_and_wrong_sizes_give_no_reflectors() {
        let grid = grid();
        let mut finder = ReflectorFinder::new(&grid, &[], |_| 1e-3, 0.4);
        let mut found = Vec::new();
        finder.find(&[0.1; 7], &mut found);
        assert!(found.is_empty());
        finder.find(&vec![f32::NAN; grid.cell_count()], &mut found);
        assert!(found.is_empty());
    }
}
