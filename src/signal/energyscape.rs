//! The sonar image and the polar grid it stands on. All index arithmetic between range, direction and cell is here
//! and nowhere else.

use crate::time::Stamp;
use nalgebra::Vector3;
use std::sync::Arc;

/// A direction of interest in a sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Direction {
    /// Angle in the horizontal plane, 0 on boresight, positive to the left. The bearing of a horizontal direction.
    pub azimuth_rad: f64,
    /// Angle above the horizontal plane.
    pub elevation_rad: f64,
}

impl Direction {
    /// A direction in the horizontal plane.
    #[must_use]
    pub fn horizontal(bearing_rad: f64) -> Self {
        Self { azimuth_rad: bearing_rad, elevation_rad: 0.0 }
    }

    /// Unit vector in the sensor frame: x = boresight, y = left, z = up.
    #[must_use]
    pub fn unit(&self) -> Vector3<f64> {
        let (sin_az, cos_az) = self.azimuth_rad.sin_cos();
        let (sin_el, cos_el) = self.elevation_rad.sin_cos();
        Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
    }
}

/// Directions by equal range bins. Cell `direction * range_count + range` is row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct PolarGrid {
    directions: Vec<Direction>,
    range_first_m: f64,
    range_step_m: f64,
    range_count: usize,
}

impl PolarGrid {
    /// Makes a grid.
    ///
    /// # Panics
    /// If there is no direction, no range bin, a negative first range or a step that is not above zero.
    #[must_use]
    pub fn new(directions: Vec<Direction>, range_first_m: f64, range_step_m: f64, range_count: usize) -> Self {
        assert!(!directions.is_empty() && range_count > 0, "a grid has cells");
        assert!(range_first_m >= 0.0 && range_step_m > 0.0, "ranges go outward");
        Self { directions, range_first_m, range_step_m, range_count }
    }

    /// The directions, in row order.
    #[must_use]
    pub fn directions(&self) -> &[Direction] {
        &self.directions
    }

    /// Number of directions (rows).
    #[must_use]
    pub fn direction_count(&self) -> usize {
        self.directions.len()
    }

    /// Number of range bins (columns).
    #[must_use]
    pub fn range_count(&self) -> usize {
        self.range_count
    }

    /// Number of cells.
    #[must_use]
    pub fn cell_count(&self) -> usize {
        self.directions.len() * self.range_count
    }

    /// Range of the first bin.
    #[must_use]
    pub fn range_first_m(&self) -> f64 {
        self.range_first_m
    }

    /// Distance between bins.
    #[must_use]
    pub fn range_step_m(&self) -> f64 {
        self.range_step_m
    }

    /// Range of a bin: the envelope is sampled at exactly this range.
    #[must_use]
    pub fn range_m(&self, range_index: usize) -> f64 {
        self.range_first_m + range_index as f64 * self.range_step_m
    }

    /// Ranges of all bins.
    #[must_use]
    pub fn ranges_m(&self) -> Vec<f64> {
        (0..self.range_count).map(|index| self.range_m(index)).collect()
    }

    /// Whether all directions lie in the horizontal plane.
    #[must_use]
    pub fn is_horizontal(&self) -> bool {
        self.directions.iter().all(|direction| direction.elevation_rad == 0.0)
    }

    /// Cell of a direction and a range bin.
    #[must_use]
    pub fn cell(&self, direction_index: usize, range_index: usize) -> usize {
        debug_assert!(range_index < self.range_count && direction_index < self.directions.len());
        direction_index * self.range_count + range_index
    }

    /// Direction index and range index of a cell.
    #[must_use]
    pub fn direction_and_range(&self, cell: usize) -> (usize, usize) {
        (cell / self.range_count, cell % self.range_count)
    }

    /// The bin nearest to a range, or `None` where the range lies more than half a step outside the grid.
    #[must_use]
    pub fn nearest_range_index(&self, range_m: f64) -> Option<usize> {
        let index = ((range_m - self.range_first_m) / self.range_step_m).round();
        (index >= 0.0 && index < self.range_count as f64).then_some(index as usize)
    }
}

/// Energy on a polar grid: the envelope of the beam of every direction, linear amplitude in units of full scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Energyscape {
    /// The grid, shared by all pings of a sensor.
    pub grid: Arc<PolarGrid>,
    /// Index of the sensor in the configuration.
    pub sensor_index: usize,
    /// Sequence of the raw ping.
    pub sequence: u64,
    /// Emission time of the raw ping, unchanged.
    pub emitted_at: Stamp,
    /// `[direction][range]`, row-major.
    pub values: Vec<f32>,
}

impl Energyscape {
    /// A zero image on `grid`.
    #[must_use]
    pub fn zeros(grid: Arc<PolarGrid>, sensor_index: usize) -> Self {
        let values = vec![0.0; grid.cell_count()];
        Self { grid, sensor_index, sequence: 0, emitted_at: Stamp::default(), values }
    }

    /// Cell and value of the largest energy; the first of equals.
    #[must_use]
    pub fn peak(&self) -> (usize, f32) {
        self.values.iter().copied().enumerate().fold(
            (0, f32::MIN),
            |best, (cell, value)| {
                if value > best.1 { (cell, value) } else { best }
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> PolarGrid {
        PolarGrid::new(vec![Direction::horizontal(-0.5), Direction::horizontal(0.5)], 0.3, 0.005, 941)
    }

    #[test]
    fn cells_and_indices_are_inverse_to_each_other() {
        let grid = grid();
        for cell in 0..grid.cell_count() {
            let (direction, range) = grid.direction_and_range(cell);
            assert_eq!(grid.cell(direction, range), cell);
        }
    }

    #[test]
    fn every_bin_is_the_nearest_to_its_own_range_and_none_lies_outside() {
        let grid = grid();
        for index in 0..grid.range_count() {
            assert_eq!(grid.nearest_range_index(grid.range_m(index)), Some(index));
        }
        assert_eq!(grid.nearest_range_index(0.29), None);
        assert_eq!(grid.nearest_range_index(5.01), None);
        assert_eq!(grid.nearest_range_index(f64::NAN), None);
    }

    #[test]
    fn left_and_up_are_positive() {
        let left = Direction::horizontal(std::f64::consts::FRAC_PI_2).unit();
        assert!((left - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-15);
        let up = Direction { azimuth_rad: 0.0, elevation_rad: std::f64::consts::FRAC_PI_2 }.unit();
        assert!((up - Vector3::new(0.0, 0.0, 1.0)).norm() < 1e-15);
    }
}
