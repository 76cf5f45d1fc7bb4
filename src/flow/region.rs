//! Where the cells of a sensor's grid lie on the robot's ground plan, and which region or flow line they belong to
//! (paper 000, section 4.1).
//!
//! A cell of a grid with elevations stands for its horizontal projection, and for its height where the robot's own is known: what is
//! below or above it is in no region. This file knows no energies.

use crate::geometry::cartesian_from_polar;
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::geometry::shape::Shape;
use crate::sensor::Mount;
use crate::signal::PolarGrid;
use nalgebra::Vector2;

/// Point of a cell in the robot frame.
#[must_use]
pub fn cell_point_m(grid: &PolarGrid, mount: &Mount, direction_index: usize, range_index: usize) -> Vector2<f64> {
    let direction = grid.directions()[direction_index];
    let horizontal_m = grid.range_m(range_index) * direction.elevation_rad.cos();
    mount.pose().parent_from_local(cartesian_from_polar(horizontal_m, direction.azimuth_rad))
}

/// Height of a cell above the plane of the sensors' origins.
#[must_use]
pub fn cell_height_m(grid: &PolarGrid, direction_index: usize, range_index: usize) -> f64 {
    grid.range_m(range_index) * grid.directions()[direction_index].elevation_rad.sin()
}

/// +1 left of the robot's x axis and on it, -1 right of it.
#[must_use]
pub fn side_of(point_m: Vector2<f64>) -> i8 {
    if point_m.y >= 0.0 { 1 } else { -1 }
}

/// Distance of a point from the robot's footprint, a disc about the origin; zero inside it.
#[must_use]
pub fn footprint_distance_m(point_m: Vector2<f64>, footprint_radius_m: f64) -> f64 {
    (point_m.norm() - footprint_radius_m).max(0.0)
}

/// Whether a point lies in any of the shapes.
#[must_use]
pub fn inside_any(shapes: &[Shape], point_m: Vector2<f64>) -> bool {
    shapes.iter().any(|shape| shape.contains(point_m))
}

/// A flow line: the strip `half_step_m` to either side of a lateral distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowStrip {
    /// Its lateral distance, left positive.
    pub lateral_m: f64,
    /// Half of the distance between lines.
    pub half_step_m: f64,
    /// The stretch of it that counts.
    pub x_m: [f64; 2],
}

/// All lines of all regions, ascending in lateral distance.
#[must_use]
pub fn flow_strips(regions: &[FlowLinesRegion]) -> Vec<FlowStrip> {
    let mut strips: Vec<FlowStrip> = regions
        .iter()
        .flat_map(|region| {
            region.laterals_m().into_iter().map(|lateral_m| FlowStrip {
                lateral_m,
                half_step_m: 0.5 * region.step_m,
                x_m: region.x_m,
            })
        })
        .collect();
    strips.sort_by(|a, b| a.lateral_m.total_cmp(&b.lateral_m));
    strips
}

/// Index of the line that a point belongs to: the laterally nearest of those whose strip it lies in, the first of equals.
#[must_use]
pub fn strip_of(strips: &[FlowStrip], point_m: Vector2<f64>) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (index, strip) in strips.iter().enumerate() {
        let distance_m = (point_m.y - strip.lateral_m).abs();
        let inside = distance_m <= strip.half_step_m && point_m.x >= strip.x_m[0] && point_m.x <= strip.x_m[1];
        if inside && best.is_none_or(|(_, nearest_m)| distance_m < nearest_m) {
            best = Some((index, distance_m));
        }
    }
    best.map(|(index, _)| index)
}
