//! An energyscape as a screen can show it: a byte a cell in half decibels, fewer cells than were measured.
//!
//! Goes in: the directions of the configuration, what is hidden, and a published image. Comes out: the bytes of one binary
//! message. Of the cells that share one on the screen the loudest is shown, so that no echo disappears between pixels. Never
//! changes what is published.

use crate::io::wire::message::{EnergyscapeHeader, FLAG_EQUAL_DIRECTIONS};
use crate::signal::Direction;

/// Code of a cell that the sensor cannot see.
pub const UNSEEN: u8 = 0;
/// Code of a cell that holds no number.
pub const BROKEN: u8 = 255;
/// Decibels of full scale that code 1 and everything softer stands for; each further code is half a decibel louder.
pub const FLOOR_DBFS: f64 = -120.0;
/// Codes to a decibel.
const CODES_PER_DB: f64 = 2.0;
/// Most columns (bearings) and rows (ranges) that are sent.
const BEARINGS_MAX: usize = 181;
const RANGES_MAX: usize = 240;
/// Bytes before the cells.
pub const HEADER_BYTES: usize = 48;
/// Bits of a float that are dropped before the table is asked: what is left tells 0.07 dB apart.
const DROPPED_BITS: u32 = 16;

/// Amplitude to code, for all floats at once.
#[derive(Debug)]
pub struct Codes(Vec<u8>);

impl Default for Codes {
    fn default() -> Self {
        Self((0..=u32::from(u16::MAX)).map(|high| code(f32::from_bits(high << DROPPED_BITS))).collect())
    }
}

impl Codes {
    /// The code of an amplitude.
    #[must_use]
    pub fn of(&self, amplitude: f32) -> u8 {
        self.0.get((amplitude.to_bits() >> DROPPED_BITS) as usize).copied().unwrap_or(BROKEN)
    }
}

fn code(amplitude: f32) -> u8 {
    if !amplitude.is_finite() {
        return BROKEN;
    }
    let dbfs = 20.0 * f64::from(amplitude.max(1e-9)).log10();
    (1.0 + (dbfs - FLOOR_DBFS) * CODES_PER_DB).round().clamp(1.0, 254.0) as u8
}

/// Where the cells of one grid go on the screen.
#[derive(Debug, Clone, PartialEq)]
pub struct ScreenMap {
    direction_count: usize,
    range_count: usize,
    bearings: usize,
    ranges: usize,
    bearing_first_rad: f64,
    bearing_step_rad: f64,
    /// Measured range bins that share one on the screen.
    share: usize,
    /// Of each direction: its bearing on the screen, and the share of its range that lies in the horizontal plane.
    columns: Vec<(usize, f64)>,
    /// Of each bearing on the screen: whether any direction that is seen goes there.
    seen: Vec<bool>,
}

impl ScreenMap {
    /// Maps the grid that `header` describes. `directions` and `hidden` are those of the configuration; where the header tells
    /// other directions, the header is believed and nothing counts as hidden.
    #[must_use]
    pub fn new(header: &EnergyscapeHeader, directions: &[Direction], hidden: &[bool]) -> Self {
        let (direction_count, range_count) = (header.direction_count as usize, header.range_count as usize);
        let told = header.flags & FLAG_EQUAL_DIRECTIONS != 0;
        let told_rad = |index: usize| header.direction_first_rad + index as f64 * header.direction_step_rad;
        let known = directions.len() == direction_count;
        let agree =
            known && (!told || directions.iter().enumerate().all(|(i, d)| (d.azimuth_rad - told_rad(i)).abs() < 1e-6));
        let of = |index: usize| match directions.get(index) {
            Some(direction) if agree => (direction.azimuth_rad, direction.elevation_rad.cos()),
            _ => (told_rad(index), 1.0),
        };
        let all: Vec<(f64, f64)> = (0..direction_count).map(of).collect();
        let (low, high) = all.iter().fold((f64::MAX, f64::MIN), |(low, high), (az, _)| (low.min(*az), high.max(*az)));
        let bearings = direction_count.clamp(1, BEARINGS_MAX);
        let step = if bearings > 1 && high > low { (high - low) / (bearings - 1) as f64 } else { 0.01 };
        let place = |az: f64| (((az - low) / step).round().max(0.0) as usize).min(bearings - 1);
        let columns: Vec<(usize, f64)> = all.iter().map(|(az, level)| (place(*az), *level)).collect();
        let mut seen = vec![false; bearings];
        for (index, (column, _)) in columns.iter().enumerate() {
            seen[*column] |= !(agree && hidden.get(index).copied().unwrap_or(false));
        }
        let share = range_count.div_ceil(RANGES_MAX).max(1);
        Self {
            direction_count,
            range_count,
            bearings,
            ranges: range_count.div_ceil(share).max(1),
            bearing_first_rad: if high >= low { low } else { 0.0 },
            bearing_step_rad: step,
            share,
            columns,
            seen,
        }
    }

    /// Whether an image with this header lies on the same grid.
    #[must_use]
    pub fn fits(&self, header: &EnergyscapeHeader) -> bool {
        (self.direction_count, self.range_count) == (header.direction_count as usize, header.range_count as usize)
    }

    /// The message of one image: header, then `[bearing][range]` codes, little-endian throughout.
    #[must_use]
    pub fn message(&self, header: &EnergyscapeHeader, values: &[f32], codes: &Codes) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.bearings * self.ranges);
        bytes.extend([1, header.sensor_index as u8, header.flags as u8, header.backend as u8]);
        bytes.extend((self.bearings as u16).to_le_bytes());
        bytes.extend((self.ranges as u16).to_le_bytes());
        bytes.extend((header.sequence as f64).to_le_bytes());
        bytes.extend((header.t_monotonic_ns as f64 * 1e-6).to_le_bytes());
        let last_offset_m = 0.5 * (self.share - 1) as f64 * header.range_step_m;
        for number in [
            self.bearing_first_rad,
            self.bearing_step_rad,
            header.range_first_m + last_offset_m,
            header.range_step_m * self.share as f64,
            FLOOR_DBFS,
            1.0 / CODES_PER_DB,
        ] {
            bytes.extend((number as f32).to_le_bytes());
        }
        debug_assert_eq!(bytes.len(), HEADER_BYTES);
        let empty = |seen: &bool| if *seen { 1 } else { UNSEEN };
        bytes.extend(self.seen.iter().flat_map(|seen| std::iter::repeat_n(empty(seen), self.ranges)));
        let cells = &mut bytes[HEADER_BYTES..];
        for (row, (column, level)) in values.chunks_exact(self.range_count.max(1)).zip(&self.columns) {
            if !self.seen[*column] {
                continue;
            }
            let target = &mut cells[column * self.ranges..(column + 1) * self.ranges];
            if *level > 0.999_999 {
                for (cell, group) in target.iter_mut().zip(row.chunks(self.share)) {
                    *cell = group.iter().fold(*cell, |most, value| most.max(codes.of(*value)));
                }
                continue;
            }
            // A slanted direction stands for its projection: the robot cannot fly over what it hears.
            for (index, value) in row.iter().enumerate() {
                let range_m = (header.range_first_m + index as f64 * header.range_step_m) * level;
                let bin = ((range_m - header.range_first_m) / header.range_step_m).round();
                if bin >= 0.0
                    && let Some(cell) = target.get_mut(bin as usize / self.share)
                {
                    *cell = (*cell).max(codes.of(*value));
                }
            }
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::PolarGrid;

    fn grid(directions: usize, ranges: usize) -> (Vec<Direction>, EnergyscapeHeader) {
        let directions: Vec<Direction> =
            (0..directions).map(|index| Direction::horizontal((index as f64 - 89.5).to_radians())).collect();
        let grid = PolarGrid::new(directions.clone(), 0.3, 0.005, ranges);
        (directions, EnergyscapeHeader::for_grid(&grid, 1, 343.0))
    }

    #[test]
    fn codes_are_half_decibels_within_a_code_and_no_number_is_its_own_code() {
        let codes = Codes::default();
        for amplitude in [1.0f32, 0.1, 0.0316, 3.3e-4, 5e-6] {
            let expected = 1.0 + (20.0 * f64::from(amplitude).log10() + 120.0) * 2.0;
            assert!((f64::from(codes.of(amplitude)) - expected).abs() <= 0.7, "{amplitude}");
        }
        assert_eq!((codes.of(0.0), codes.of(-1.0), codes.of(1e30)), (1, 1, 254));
        assert_eq!([f32::NAN, f32::INFINITY].map(|broken| codes.of(broken)), [BROKEN; 2]);
    }

    #[test]
    fn the_loudest_of_the_cells_that_share_one_is_shown_and_hidden_ones_are_unseen() {
        let (directions, header) = grid(180, 941);
        let mut hidden = vec![false; 180];
        hidden[7] = true;
        let map = ScreenMap::new(&header, &directions, &hidden);
        let mut values = vec![0.0f32; 180 * 941];
        values[120 * 941 + 402] = 0.1;
        values[7 * 941 + 402] = 0.1;
        values[9 * 941 + 3] = f32::NAN;
        let bytes = map.message(&header, &values, &Codes::default());
        let (bearings, ranges) = (180, 941usize.div_ceil(4));
        assert_eq!(bytes.len(), HEADER_BYTES + bearings * ranges);
        let cell = |bearing: usize, range: usize| bytes[HEADER_BYTES + bearing * ranges + range];
        assert_eq!(cell(120, 100), 201, "-20 dBFS");
        assert_eq!((cell(120, 99), cell(120, 101)), (1, 1));
        assert!((0..ranges).all(|range| cell(7, range) == UNSEEN));
        assert_eq!(cell(9, 0), BROKEN);
    }

    #[test]
    fn a_grid_that_is_not_the_configurations_is_shown_as_its_header_tells() {
        let (_, header) = grid(90, 100);
        let map = ScreenMap::new(&header, &grid(180, 100).0, &[true; 180]);
        assert!(map.seen.iter().all(|seen| *seen));
        assert!((map.bearing_first_rad - header.direction_first_rad).abs() < 1e-12);
        assert!(!map.fits(&grid(180, 100).1) && map.fits(&header));
    }

    #[test]
    fn slanted_directions_are_projected_onto_the_ground() {
        let direction = Direction { azimuth_rad: 0.0, elevation_rad: 60f64.to_radians() };
        let grid = PolarGrid::new(vec![direction], 0.0, 0.01, 200);
        let header = EnergyscapeHeader::for_grid(&grid, 0, 343.0);
        let map = ScreenMap::new(&header, grid.directions(), &[false]);
        let mut values = vec![0.0f32; 200];
        values[100] = 1.0;
        let bytes = map.message(&header, &values, &Codes::default());
        assert_eq!(bytes[HEADER_BYTES + 50], 241);
    }
}
