//! From envelope to energy: the range gain that makes one reflector weigh the same at any range, and the noise floor
//! below which a cell is silent (specification, section 5, "Energy").
//!
//! Goes in: configured numbers, or quiet images to calibrate on. Comes out: a gain and a floor per range. The backends
//! apply them; this file never does.

use crate::signal::{Energyscape, PolarGrid};

/// Nearest range that the gain distinguishes: nearer reflectors keep this range's gain, so that none is multiplied by zero.
const GAIN_RANGE_MIN_M: f64 = 0.1;

/// A standard deviation in units of the median absolute deviation, for the normal distribution.
const SIGMAS_PER_MAD: f64 = 1.4826;

/// Compensation of spreading and absorption, 1 at 1 m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeGain {
    /// Exponent p of (r / 1 m)^p.
    pub spreading_exponent: f64,
    /// Absorption in dB per metre of path; the path is twice the range.
    pub absorption_db_m: f64,
}

impl RangeGain {
    /// Gain at a range. With p = 1 and no absorption a reflector at 2 m is multiplied by 2.
    #[must_use]
    pub fn at(&self, range_m: f64) -> f64 {
        let range_m = range_m.max(GAIN_RANGE_MIN_M);
        let absorption_db = 2.0 * self.absorption_db_m * (range_m - 1.0);
        range_m.powf(self.spreading_exponent) * 10f64.powf(absorption_db / 20.0)
    }
}

/// Envelope below which a cell counts as silent, over range.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseFloor {
    /// (range, dBFS), ascending in range.
    points: Vec<[f64; 2]>,
}

/// Why quiet pings gave no noise floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CalibrationError {
    /// There was no image.
    #[error("no image to calibrate the noise floor on")]
    NoImage,
    /// The images differ in their grids.
    #[error("images of different grids cannot calibrate one noise floor")]
    DifferentGrids,
    /// Fewer than half of the values at a range were finite and above zero.
    #[error("range bin {range_index}: too few finite values above zero to calibrate the noise floor")]
    TooFewValues {
        /// The bin.
        range_index: usize,
    },
}

impl NoiseFloor {
    /// A configured floor: `[range_m, dBFS]` points ascending in range, linear in dB in between, level outside. Without a
    /// point there is no floor at all.
    #[must_use]
    pub fn configured(points: Vec<[f64; 2]>) -> Self {
        Self { points }
    }

    /// A floor from images of quiet pings of one sensor: at each range the median over directions and pings plus
    /// `deviations` robust standard deviations (1.4826 times the median absolute deviation).
    ///
    /// Half of the directions may hold echoes at any one range without spoiling it. Values that are zero (hidden
    /// directions) or not finite are left out, so they can neither raise nor lower the floor.
    ///
    /// # Errors
    /// [`CalibrationError`].
    pub fn calibrate(images: &[&Energyscape], deviations: f64) -> Result<Self, CalibrationError> {
        let grid: &PolarGrid = &images.first().ok_or(CalibrationError::NoImage)?.grid;
        if images.iter().any(|image| *image.grid != *grid || image.values.len() != grid.cell_count()) {
            return Err(CalibrationError::DifferentGrids);
        }
        let mut points = Vec::with_capacity(grid.range_count());
        let mut column = Vec::with_capacity(images.len() * grid.direction_count());
        for range_index in 0..grid.range_count() {
            column.clear();
            column.extend(
                images
                    .iter()
                    .flat_map(|image| image.values.iter().skip(range_index).step_by(grid.range_count()))
                    .map(|value| f64::from(*value))
                    .filter(|value| *value > 0.0 && value.is_finite()),
            );
            if column.len() * 2 < images.len() * grid.direction_count() {
                return Err(CalibrationError::TooFewValues { range_index });
            }
            let median = median(&mut column);
            column.iter_mut().for_each(|value| *value = (*value - median).abs());
            let floor = median + deviations * SIGMAS_PER_MAD * self::median(&mut column);
            points.push([grid.range_m(range_index), 20.0 * floor.log10()]);
        }
        Ok(Self { points })
    }

    /// The points, `[range_m, dBFS]`, as the configuration writes them.
    #[must_use]
    pub fn points(&self) -> &[[f64; 2]] {
        &self.points
    }

    /// Envelope of the floor at a range, linear amplitude.
    #[must_use]
    pub fn at(&self, range_m: f64) -> f64 {
        let after = self.points.partition_point(|point| point[0] < range_m);
        let dbfs = match (after.checked_sub(1).and_then(|before| self.points.get(before)), self.points.get(after)) {
            (None, None) => return 0.0,
            (None, Some(point)) | (Some(point), None) => point[1],
            (Some(before), Some(next)) => {
                let share = (range_m - before[0]) / (next[0] - before[0]);
                before[1] + share * (next[1] - before[1])
            }
        };
        10f64.powf(dbfs / 20.0)
    }
}

/// Median; the upper of the two middle ones for an even count. `values` is not empty.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Direction;
    use std::sync::Arc;

    #[test]
    fn the_gain_is_one_at_a_metre_and_undoes_spreading_and_absorption() {
        let gain = RangeGain { spreading_exponent: 1.5, absorption_db_m: 1.2 };
        assert!((gain.at(1.0) - 1.0).abs() < 1e-12);
        for range_m in [0.3, 0.7, 2.0, 4.9] {
            let heard = f64::powf(range_m, -1.5) * 10f64.powf(-1.2 * 2.0 * (range_m - 1.0) / 20.0);
            assert!((gain.at(range_m) * heard - 1.0).abs() < 1e-12);
        }
        assert!(gain.at(0.0) > 0.0, "an obstacle at the sensor must not be multiplied by zero");
    }

    #[test]
    fn a_configured_floor_is_linear_in_db_between_its_points_and_level_outside() {
        let floor = NoiseFloor::configured(vec![[0.5, -60.0], [1.0, -80.0]]);
        assert!((floor.at(0.1) - 1e-3).abs() < 1e-12);
        assert!((floor.at(0.75) - 10f64.powf(-70.0 / 20.0)).abs() < 1e-12);
        assert!((floor.at(9.0) - 1e-4).abs() < 1e-12);
        assert_eq!(NoiseFloor::configured(Vec::new()).at(1.0), 0.0);
    }

    fn image(value: impl Fn(usize, usize) -> f32) -> Energyscape {
        let directions = (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect();
        let mut image = Energyscape::zeros(Arc::new(PolarGrid::new(directions, 0.3, 0.01, 50)), 0);
        for direction in 0..180 {
            for range in 0..50 {
                image.values[direction * 50 + range] = value(direction, range);
            }
        }
        image
    }

    #[test]
    fn a_calibrated_floor_follows_the_noise_and_ignores_a_wall_in_a_third_of_the_directions() {
        let noise = |direction: usize, range: usize| 1e-4 * (1.0 + ((direction * 37 + range * 11) % 17) as f32 / 17.0);
        let quiet = image(noise);
        let wall = image(|direction, range| if direction < 60 { 0.5 } else { noise(direction, range) });
        let clean = NoiseFloor::calibrate(&[&quiet], 5.0).unwrap();
        let spoiled = NoiseFloor::calibrate(&[&quiet, &wall], 5.0).unwrap();
        for index in 0..50 {
            let range_m = quiet.grid.range_m(index);
            assert!(clean.at(range_m) > 2e-4 && clean.at(range_m) < 5e-4, "{}", clean.at(range_m));
            assert!(spoiled.at(range_m) < 1.3 * clean.at(range_m));
        }
    }

    #[test]
    fn values_that_are_not_finite_cannot_raise_the_floor_and_too_few_are_an_error() {
        let some = image(|direction, _| if direction < 60 { f32::NAN } else { 1e-4 });
        assert!((NoiseFloor::calibrate(&[&some], 5.0).unwrap().at(0.4) - 1e-4).abs() < 1e-9);
        let most = image(|direction, _| if direction < 100 { f32::INFINITY } else { 1e-4 });
        assert_eq!(NoiseFloor::calibrate(&[&most], 5.0), Err(CalibrationError::TooFewValues { range_index: 0 }));
        assert_eq!(NoiseFloor::calibrate(&[], 5.0), Err(CalibrationError::NoImage));
    }
}
