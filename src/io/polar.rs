//! From a place in a sensor's plane to the cells of its grid, for pictures.
//!
//! Goes in: a grid and a place. Comes out: the cells to look at. Never looks at a value.

use crate::geometry::polar_from_cartesian;
use crate::signal::PolarGrid;
use nalgebra::Vector2;

/// For every degree of azimuth the directions to look at: the nearest one, and in a grid with elevations all that are
/// as near, so that the picture shows the largest value over elevation.
pub(super) struct Azimuths {
    first_deg: i32,
    directions: Vec<Vec<usize>>,
}

impl Azimuths {
    pub(super) fn new(grid: &PolarGrid) -> Self {
        let azimuths: Vec<f64> = grid.directions().iter().map(|direction| direction.azimuth_rad.to_degrees()).collect();
        let mut sorted = azimuths.clone();
        sorted.sort_by(f64::total_cmp);
        let gaps = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > 1e-6);
        let reach_deg = gaps.fold(0.0, f64::max).clamp(1.0, 10.0) * 0.75;
        let nearest = |degree: i32| {
            let distance = |azimuth: f64| (azimuth - f64::from(degree) / 4.0).abs();
            let best = azimuths.iter().copied().map(distance).fold(f64::INFINITY, f64::min);
            let near = azimuths.iter().enumerate().filter(|(_, azimuth)| distance(**azimuth) <= best + 1e-6);
            if best <= reach_deg { near.map(|(index, _)| index).collect() } else { Vec::new() }
        };
        Self { first_deg: -720, directions: (-720..=720).map(nearest).collect() }
    }

    /// Cells at a point of the sensor frame; none outside the grid.
    pub(super) fn cells<'a>(&'a self, grid: &'a PolarGrid, point_m: Vector2<f64>) -> impl Iterator<Item = usize> + 'a {
        let (range_m, bearing_rad) = polar_from_cartesian(point_m);
        let quarter_degree = (bearing_rad.to_degrees() * 4.0).round() as i32;
        let directions = self.directions.get((quarter_degree - self.first_deg) as usize).map_or(&[][..], Vec::as_slice);
        let range = grid.nearest_range_index(range_m);
        range.into_iter().flat_map(move |range| directions.iter().map(move |direction| grid.cell(*direction, range)))
    }
}
