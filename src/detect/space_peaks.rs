//! Every reflector of an image with elevations, in space and finer than a cell.
//!
//! Goes in: the cells of one sensor's image on a grid of any directions. Comes out: up to [`PEAKS_MAX`] peaks with range, direction and
//! covariance. A peak is higher than its neighbours in range and among the eight nearest directions; above the noise floor; and above
//! what the side lobes of something louder at about its range reach, which is farther off the more the directions differ. Its range is the vertex of a parabola, its direction that of a
//! paraboloid through the logarithms of the nine crests, in the direction cosines, in which the lobe of an array is the same
//! everywhere. Its uncertainty is that paraboloid's width, shared by the signal-to-noise ratio. Never fuses sensors or pings, allocates
//! nothing after it was made.

use super::side_lobes::{Tops, keep, vertex};
use crate::signal::PolarGrid;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Most peaks of one sensor; the loudest, spreading undone, are kept.
pub const PEAKS_MAX: usize = 64;
/// Directions that a peak must exceed.
const NEIGHBOURS: usize = 8;
/// A peak stands this much above the noise floor: there are a hundred times as many cells as in a fan.
const ABOVE_FLOOR: f32 = 2.0;
/// Repeatability of a range far above the noise, and what is added at the noise floor.
const RANGE_SIGMA_M: f64 = 0.001;
const RANGE_SIGMA_AT_FLOOR_M: f64 = 0.004;
/// Standard deviation of a direction as a share of the lobe's width, far above the noise and at the noise floor.
const SHARE_SIGMA: f64 = 0.04;
const SHARE_SIGMA_AT_FLOOR: f64 = 0.5;
/// Two tops this near in direction cosines and in range are one: a lobe of an array 12 cm wide is 0.16 wide at 40 kHz.
const LOBE: f64 = 0.12;
const LOBE_REACH_M: f64 = 0.03;
/// How far from an echo in range its side lobes lie: half a pulse, and half of what microphone and emitter (11 cm together) are nearer
/// in one direction than in the other.
const PULSE_REACH_M: f64 = 0.02;
const ARM_REACH_M: f64 = 0.055;
/// The least and the most that a lobe is wide, in spacings of the grid.
const WIDTH_SPACINGS: (f64, f64) = (0.3, 3.0);

/// One peak, in its sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpacePeak {
    /// Where it is: forward, left, up.
    pub position_m: Vector3<f64>,
    /// Its covariance.
    pub covariance_m2: Matrix3<f64>,
    /// Envelope, linear amplitude in units of full scale.
    pub energy: f32,
}

/// A direction, its neighbours and the fit through them.
#[derive(Debug, Clone)]
struct Site {
    row: usize,
    cosines: Vector2<f64>,
    neighbours: [usize; NEIGHBOURS],
    /// From the nine logarithms to value, slopes and bends, in spacings.
    fit: SMatrix<f64, 6, 9>,
}

/// Finds the peaks of one sensor.
#[derive(Debug, Clone)]
pub struct SpaceFinder {
    sites: Vec<Site>,
    /// Median distance to the nearest direction, in direction cosines on boresight.
    spacing: f64,
    tops: Tops,
}

impl SpaceFinder {
    /// A finder for images on `grid`; the arguments are those of [`super::RangeScanner::new`]. It finds nothing on a grid of fewer than
    /// nine seen directions.
    #[must_use]
    pub fn new(grid: &PolarGrid, hidden: &[bool], floor_at: impl Fn(f64) -> f64, side_lobe_share: f64) -> Self {
        let seen = |row: &usize| !hidden.get(*row).copied().unwrap_or(false);
        let rows: Vec<usize> = (0..grid.direction_count()).filter(seen).collect();
        let units: Vec<Vector3<f64>> = rows.iter().map(|row| grid.directions()[*row].unit()).collect();
        let near: Vec<Vec<(f64, usize)>> = if rows.len() > NEIGHBOURS {
            (0..rows.len()).map(|place| nearest(&units, place)).collect()
        } else {
            Vec::new()
        };
        let mut spacings: Vec<f64> = near.iter().map(|near| near[0].0.max(1e-6)).collect();
        spacings.sort_by(f64::total_cmp);
        let spacing = spacings.get(spacings.len() / 2).copied().unwrap_or(1.0);
        let site = |(place, near): (usize, &Vec<(f64, usize)>)| {
            let cosines = units[place].yz();
            let neighbours = std::array::from_fn(|index| rows[near[index].1]);
            let offsets = near.iter().map(|(_, other)| (units[*other].yz() - cosines) / spacing);
            Site { row: rows[place], cosines, neighbours, fit: fit(offsets) }
        };
        Self {
            sites: near.iter().enumerate().map(site).collect(),
            spacing,
            tops: Tops::new(grid, floor_at, side_lobe_share, ABOVE_FLOOR),
        }
    }

    /// Fills `found`, by falling weight; nothing where the cells are not those of the grid.
    pub fn find(&mut self, cells: &[f32], found: &mut Vec<SpacePeak>) {
        found.clear();
        if !self.tops.listen(cells, self.sites.iter().map(|site| site.row)) {
            return;
        }
        for site in &self.sites {
            for bin in self.tops.of_row(self.row(cells, site.row)) {
                if let Some(peak) = self.peak(cells, site, bin) {
                    keep(found, PEAKS_MAX, peak, |other| f64::from(other.energy) * other.position_m.norm());
                }
            }
        }
        for index in (0..found.len()).rev() {
            if found.iter().any(|other| self.belongs(&found[index], other)) {
                found.remove(index);
            }
        }
    }

    /// Whether a peak is part of a louder one's lobe, or may be its side lobe.
    fn belongs(&self, peak: &SpacePeak, louder: &SpacePeak) -> bool {
        let (range_m, louder_m) = (peak.position_m.norm(), louder.position_m.norm());
        let apart = (peak.position_m / range_m - louder.position_m / louder_m).yz().norm();
        let apart_m = (range_m - louder_m).abs();
        let same = apart < LOBE && apart_m < LOBE_REACH_M && peak.energy < louder.energy;
        let beside = peak.energy < self.tops.share * louder.energy && apart_m < PULSE_REACH_M + ARM_REACH_M * apart;
        same || beside
    }

    fn row<'a>(&self, cells: &'a [f32], row: usize) -> &'a [f32] {
        let count = self.tops.range_count();
        &cells[row * count..][..count]
    }

    /// The peak with this top; `None` if a neighbour is higher. Of equally high ones the first in order is the top.
    fn peak(&self, cells: &[f32], site: &Site, bin: usize) -> Option<SpacePeak> {
        let row = self.row(cells, site.row);
        let height = crest(row, bin);
        let mut logarithms = SVector::<f64, 9>::zeros();
        for (slot, other) in site.neighbours.iter().enumerate() {
            let other_row = self.row(cells, *other);
            let near = if other_row[bin - 1] > other_row[bin + 1] { bin - 1 } else { bin + 1 };
            let highest = if other_row[near] > other_row[bin] { near } else { bin };
            let other_height = crest(other_row, highest);
            if other_height > height || (other_height == height && *other < site.row) {
                return None;
            }
            // What is far below says nothing of the top's form; a zero would say it with infinite weight.
            logarithms[slot + 1] = (other_height / height).max(0.1).ln();
        }
        let noise = self.tops.noise(row, bin);
        let (offset, width) = summit(&(site.fit * logarithms));
        let share = SHARE_SIGMA.hypot(SHARE_SIGMA_AT_FLOOR * noise);
        let range_sigma_m = RANGE_SIGMA_M.hypot(RANGE_SIGMA_AT_FLOOR_M * noise);
        let cosines = site.cosines + offset * self.spacing;
        let covariance = width * (self.spacing * share).powi(2);
        Some(in_space(self.tops.range_m(row, bin), range_sigma_m, cosines, covariance, row[bin]))
    }
}

/// Height of the envelope between its bins, of the parabola through three logarithms: a top that lies between two bins reads up to a
/// tenth low at either, which would tilt the fit over directions, in which ranges differ a little.
fn crest(row: &[f32], bin: usize) -> f64 {
    let (Some(before), Some(after)) = (bin.checked_sub(1).map(|bin| row[bin]), row.get(bin + 1)) else {
        return f64::from(row[bin]);
    };
    let [before, top, after] = [before, row[bin], *after].map(|value| f64::from(value.max(1e-12)).ln());
    (top - 0.25 * (before - after) * vertex(before, top, after)).exp()
}

/// The nearest directions by angle, nearest first.
fn nearest(units: &[Vector3<f64>], place: usize) -> Vec<(f64, usize)> {
    let mut near: Vec<(f64, usize)> = Vec::with_capacity(NEIGHBOURS + 1);
    for (other, unit) in units.iter().enumerate().filter(|(other, _)| *other != place) {
        let apart = (unit - units[place]).norm();
        if near.len() == NEIGHBOURS && apart >= near[NEIGHBOURS - 1].0 {
            continue;
        }
        let at = near.iter().position(|(distance, _)| *distance > apart).unwrap_or(near.len());
        near.insert(at, (apart, other));
        near.truncate(NEIGHBOURS);
    }
    near
}

/// Least squares of value, slopes and bends through a place and its neighbours at `offsets`.
fn fit(offsets: impl Iterator<Item = Vector2<f64>>) -> SMatrix<f64, 6, 9> {
    let mut rows = SMatrix::<f64, 9, 6>::zeros();
    rows[(0, 0)] = 1.0;
    for (index, at) in offsets.enumerate() {
        let terms = [1.0, at.x, at.y, 0.5 * at.x * at.x, at.x * at.y, 0.5 * at.y * at.y];
        for (column, term) in terms.into_iter().enumerate() {
            rows[(index + 1, column)] = term;
        }
    }
    // Only a negative tolerance is refused.
    rows.pseudo_inverse(1e-4).unwrap_or_else(|_| SMatrix::zeros())
}

/// Where the paraboloid is highest, and its width (inverse bend); where it has no top, the place itself and the widest.
fn summit(terms: &SVector<f64, 6>) -> (Vector2<f64>, Matrix2<f64>) {
    let (least, most) = WIDTH_SPACINGS;
    let bend = Matrix2::new(-terms[3], -terms[4], -terms[4], -terms[5]);
    let eigen = bend.symmetric_eigen();
    if !(eigen.eigenvalues.min() > 0.0) {
        return (Vector2::zeros(), Matrix2::identity() * (most * most));
    }
    let widths = eigen.eigenvalues.map(|bend| (1.0 / bend).clamp(least * least, most * most));
    let width = eigen.eigenvectors * Matrix2::from_diagonal(&widths) * eigen.eigenvectors.transpose();
    let offset = width * Vector2::new(terms[1], terms[2]);
    (offset / offset.norm().max(1.0), width)
}

/// From range and direction cosines to a place. Near the rim, where the array looks along itself, the way forward is what a cosine
/// hardly tells: its deviation grows to the square root of twice the cosine's.
fn in_space(
    range_m: f64,
    range_sigma_m: f64,
    cosines: Vector2<f64>,
    covariance: Matrix2<f64>,
    energy: f32,
) -> SpacePeak {
    let cosines = cosines / cosines.norm().max(1.0);
    let ahead = (1.0 - cosines.norm_squared()).max(0.0).sqrt();
    let sigma = covariance.trace().sqrt();
    let slope = cosines / ahead.max((0.5 * sigma).sqrt()).max(1e-3);
    let unit = Vector3::new(ahead, cosines.x, cosines.y);
    let turn = SMatrix::<f64, 3, 2>::new(-slope.x, -slope.y, 1.0, 0.0, 0.0, 1.0) * range_m;
    SpacePeak {
        position_m: unit * range_m,
        covariance_m2: turn * covariance * turn.transpose() + unit * unit.transpose() * range_sigma_m.powi(2),
        energy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Direction;

    /// Rows of a tilted net, as even as an equal-area grid and made otherwise.
    fn grid() -> PolarGrid {
        let mut directions = Vec::new();
        for row in -24i32..=24 {
            let elevation_rad = f64::from(row) * 0.06;
            let count = (50.0 * elevation_rad.cos()) as i32;
            directions.extend((-count / 2..=count / 2).map(|column| Direction {
                azimuth_rad: f64::from(column) * 0.06 / elevation_rad.cos(),
                elevation_rad,
            }));
        }
        PolarGrid::new(directions, 0.3, 0.005, 300)
    }

    fn image(grid: &PolarGrid, hills: &[(Vector3<f64>, f32)]) -> Vec<f32> {
        let mut cells = vec![0.0; grid.cell_count()];
        for (row, direction) in grid.directions().iter().enumerate() {
            for bin in 0..grid.range_count() {
                for (place, height) in hills {
                    let far = (grid.range_m(bin) - place.norm()) / 0.012;
                    let aside = (direction.unit() - place.normalize()).yz().norm() / 0.09;
                    cells[grid.cell(row, bin)] += height * (-far * far - aside * aside).exp() as f32;
                }
            }
        }
        cells
    }

    fn find(hills: &[(Vector3<f64>, f32)]) -> Vec<SpacePeak> {
        let grid = grid();
        let mut found = Vec::with_capacity(PEAKS_MAX);
        SpaceFinder::new(&grid, &[], |_| 1e-3, 0.4).find(&image(&grid, hills), &mut found);
        found
    }

    #[test]
    fn hills_are_found_in_space_finer_than_a_cell() {
        let places = [Vector3::new(1.0, 0.31, -0.42), Vector3::new(0.7, -0.2, 0.55), Vector3::new(1.2, 0.0, 0.02)];
        let found = find(&places.map(|place| (place, 0.1)));
        assert_eq!(found.len(), 3, "{found:?}");
        for place in places {
            let near = found.iter().map(|peak| (peak.position_m - place).norm()).fold(f64::INFINITY, f64::min);
            // A cell is 6 cm wide at 1 m.
            assert!(near < 4e-3, "{place:?}: {near}");
        }
    }

    #[test]
    fn side_lobes_noise_nonsense_and_wrong_sizes_give_nothing() {
        let loud = Vector3::new(1.0, 0.0, 0.0);
        assert_eq!(find(&[(loud, 0.1), (Vector3::new(0.6, 0.0, 0.8), 0.03)]).len(), 1, "10 dB below at its range");
        assert_eq!(find(&[(loud, 0.1), (Vector3::new(0.8, 0.0, 1.0), 0.03)]).len(), 2);
        assert!(find(&[(loud, 1.9e-3)]).is_empty());
        let grid = grid();
        let mut finder = SpaceFinder::new(&grid, &[], |_| 1e-3, 0.4);
        let mut found = Vec::new();
        for cells in [vec![0.1; 7], vec![f32::NAN; grid.cell_count()], vec![f32::INFINITY; grid.cell_count()]] {
            finder.find(&cells, &mut found);
            assert!(found.is_empty());
        }
    }

    #[test]
    fn a_hidden_direction_is_not_looked_at_and_too_few_find_nothing() {
        let grid = grid();
        let cells = image(&grid, &[(Vector3::new(1.0, 0.0, 0.0), 0.1)]);
        let mut found = Vec::new();
        SpaceFinder::new(&grid, &vec![true; grid.direction_count()], |_| 1e-3, 0.4).find(&cells, &mut found);
        assert!(found.is_empty());
        let ahead = |direction: &Direction| direction.unit().x > 0.9;
        let hidden: Vec<bool> = grid.directions().iter().map(ahead).collect();
        SpaceFinder::new(&grid, &hidden, |_| 1e-3, 0.4).find(&cells, &mut found);
        assert!(found.iter().all(|peak| peak.position_m.x / peak.position_m.norm() <= 0.91));
    }
}
