//! The nearest echo of every direction of an energyscape.
//!
//! Goes in: an image, with the floor and gain that the layers use, and which directions are hidden. Comes out: per direction an
//! echo, nothing within range, or unseen. An echo lies where the envelope, having risen above the noise floor, peaks; the
//! place is refined by a parabola through the three bins around it. A loud reflector's side lobes show at about its own range in every
//! direction and are not taken for echoes. Never fuses sensors or pings.

use super::side_lobes::{Loudness, vertex};
use crate::signal::{Energyscape, PolarGrid, RangeScan, Reading};

/// Finds the nearest echoes of one sensor.
#[derive(Debug, Clone)]
pub struct RangeScanner {
    hidden: Vec<bool>,
    /// Per range bin: envelope below which a cell is silent.
    floors: Vec<f32>,
    side_lobe_share: f32,
    loudness: Loudness,
}

impl RangeScanner {
    /// A scanner for images on `grid`. `hidden` has one entry a direction, `floor_at` gives the envelope of the noise floor at a
    /// range, and a cell below `side_lobe_share` of the loudest at about its range is taken for that one's side lobe (0: none is).
    #[must_use]
    pub fn new(grid: &PolarGrid, hidden: &[bool], floor_at: impl Fn(f64) -> f64, side_lobe_share: f64) -> Self {
        Self {
            hidden: (0..grid.direction_count()).map(|index| hidden.get(index).copied().unwrap_or(false)).collect(),
            floors: (0..grid.range_count()).map(|index| floor_at(grid.range_m(index)) as f32).collect(),
            side_lobe_share: side_lobe_share as f32,
            loudness: Loudness::new(grid),
        }
    }

    /// Fills `scan` from `image`. Allocates nothing. An image on another grid than the scanner's leaves everything unseen.
    pub fn scan(&mut self, image: &Energyscape, scan: &mut RangeScan) {
        scan.sensor_index = image.sensor_index;
        scan.sequence = image.sequence;
        scan.emitted_at = image.emitted_at;
        self.scan_cells(&image.values, scan);
    }

    /// Fills the readings of `scan` from the cells of an image on its grid, row-major `[direction][range]`, wherever they lie.
    /// Allocates nothing.
    pub fn scan_cells(&mut self, cells: &[f32], scan: &mut RangeScan) {
        let range_count = self.floors.len();
        let RangeScan { readings, grid, .. } = scan;
        let fits = cells.len() == self.hidden.len() * range_count && readings.len() == self.hidden.len();
        if !fits {
            readings.fill(Reading::Unseen);
            return;
        }
        self.loudness.listen(cells.chunks_exact(range_count));
        let rows = cells.chunks_exact(range_count).zip(&self.hidden);
        for (reading, (row, hidden)) in readings.iter_mut().zip(rows) {
            let unseen = *hidden || !row.iter().all(|value| value.is_finite());
            *reading = if unseen { Reading::Unseen } else { self.first_echo(row, grid) };
        }
    }

    /// Envelope of the noise floor at the range bin nearest to `range_m`.
    #[must_use]
    pub fn floor_at(&self, grid: &PolarGrid, range_m: f64) -> f32 {
        let bin = ((range_m - grid.range_first_m()) / grid.range_step_m()).round().max(0.0) as usize;
        self.floors.get(bin).or(self.floors.last()).copied().unwrap_or(f32::INFINITY)
    }

    fn first_echo(&self, row: &[f32], grid: &PolarGrid) -> Reading {
        let around = self.loudness.around();
        let heard =
            |index: &usize| row[*index] > self.floors[*index] && row[*index] >= self.side_lobe_share * around[*index];
        let Some(rise) = (0..row.len()).find(heard) else { return Reading::Clear };
        let mut peak = rise;
        while peak + 1 < row.len() && row[peak + 1] > row[peak] {
            peak += 1;
        }
        let offset = match (peak.checked_sub(1).map(|before| row[before]), row.get(peak + 1)) {
            (Some(before), Some(&after)) => vertex(before, row[peak], after),
            _ => 0.0,
        };
        Reading::Echo { range_m: grid.range_m(peak) + offset * grid.range_step_m(), energy: row[peak] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Direction;
    use std::sync::Arc;

    fn grid() -> Arc<PolarGrid> {
        let directions = (0..4).map(|index| Direction::horizontal(0.1 * f64::from(index))).collect();
        Arc::new(PolarGrid::new(directions, 0.5, 0.01, 200))
    }

    fn bump(image: &mut Energyscape, direction: usize, range_m: f64, height: f32) {
        for index in 0..image.grid.range_count() {
            let far = ((image.grid.range_m(index) - range_m) / 0.02) as f32;
            let cell = image.grid.cell(direction, index);
            image.values[cell] = image.values[cell].max(height * (-far * far).exp());
        }
    }

    fn scan(image: &Energyscape, hidden: &[bool]) -> Vec<Reading> {
        let mut scanner = RangeScanner::new(&image.grid, hidden, |_| 1e-3, 0.4);
        let mut scan = RangeScan::unseen(Arc::clone(&image.grid), 0);
        scanner.scan(image, &mut scan);
        scan.readings
    }

    #[test]
    fn the_nearest_of_two_echoes_counts_and_its_range_is_finer_than_a_bin() {
        let mut image = Energyscape::zeros(grid(), 0);
        bump(&mut image, 1, 1.2034, 0.01);
        bump(&mut image, 1, 2.0, 0.5);
        let readings = scan(&image, &[]);
        let Reading::Echo { range_m, energy } = readings[1] else { panic!("{readings:?}") };
        assert!((range_m - 1.2034).abs() < 1e-3 && energy > 0.0095, "{range_m} {energy}");
        assert_eq!(readings[0], Reading::Clear);
    }

    #[test]
    fn a_side_lobe_at_the_range_of_something_loud_is_no_echo() {
        let mut image = Energyscape::zeros(grid(), 0);
        bump(&mut image, 1, 1.2, 0.5);
        bump(&mut image, 2, 1.2, 0.1);
        assert_eq!(scan(&image, &[])[2], Reading::Clear);
        bump(&mut image, 2, 1.2, 0.3);
        assert!(matches!(scan(&image, &[])[2], Reading::Echo { .. }), "as loud as another reflector would be");
    }

    #[test]
    fn hidden_and_spoilt_directions_are_unseen_not_clear() {
        let mut image = Energyscape::zeros(grid(), 0);
        let spoilt = image.grid.cell(3, 100);
        image.values[spoilt] = f32::NAN;
        let readings = scan(&image, &[true, false, false, false]);
        assert_eq!(readings, [Reading::Unseen, Reading::Clear, Reading::Clear, Reading::Unseen]);
    }
}
