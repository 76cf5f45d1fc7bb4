//! An occupancy grid over the world it was made of, with the objects found, what really stands there, and a way between them.
//!
//! Goes in: numbers. Comes out: a picture. Finds no objects and no ways.

use super::chrome::{self, Frame, Sign};
use super::world::{self, Map};
use crate::io::canvas::{INK, Picture};
use crate::sim::World;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

/// Most cells that are drawn.
const CELLS_MAX: usize = 1 << 20;
/// Points of an ellipse.
const ELLIPSE_POINTS: usize = 48;
/// Deviations that an ellipse stands for: 99 of 100.
const ELLIPSE_SIGMAS: f64 = 3.0;
const OBJECT: Rgb888 = Rgb888::new(213, 94, 0);
const ROUTE: Rgb888 = Rgb888::new(0, 114, 178);
const ROBOT: Rgb888 = Rgb888::new(0, 158, 115);
const FREE: Rgb888 = Rgb888::new(250, 250, 245);
const OCCUPIED: Rgb888 = Rgb888::new(120, 70, 160);

/// A grid as it is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct PlottedGrid {
    /// Middle of the first cell, which has the lowest x and y.
    pub origin_m: [f64; 2],
    /// Edge of a cell.
    pub cell_m: f64,
    /// Cells along x.
    pub width: usize,
    /// Row by row, x first: 0 free to 100 occupied, 255 unknown.
    pub percent: Vec<u8>,
    /// What was found.
    pub objects: Vec<PlottedObject>,
    /// A way.
    pub route_m: Vec<[f64; 2]>,
    /// Place and radius of the robot.
    pub robot: ([f64; 2], f64),
}

/// An object as it is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlottedObject {
    /// Its place.
    pub position_m: [f64; 2],
    /// Covariance xx, xy, yy of the place.
    pub covariance_m2: [f64; 3],
}

/// Draws the part of `grid` between the corners of `window_m`, low x and y first.
#[must_use]
pub fn grid_map(world: &World, grid: &PlottedGrid, titles: [&str; 2], window_m: [[f64; 2]; 2]) -> Picture {
    let legend = [
        (Sign::Patch(OCCUPIED), "occupied"),
        (Sign::Patch(FREE), "free"),
        (Sign::Patch(chrome::UNSEEN), "unknown"),
        (Sign::Disc(OBJECT), "object found, with 3 deviations"),
        (Sign::Disc(ROBOT), "robot"),
        (Sign::Line(ROUTE), "way by A*"),
    ];
    let legend = legend.map(|(sign, words)| (sign, words.to_owned())).to_vec();
    let frame = Frame { titles, right_px: 0, legend, axis_titles: true };
    let mut map = Map::new(world, &[], (800, Some(window_m)), frame);
    draw_cells(&mut map, grid);
    map.draw_world(world);
    let ([x_m, y_m], radius_m) = grid.robot;
    if let (Some(place_m), true) = (world::place_m(x_m, y_m), radius_m.abs() < 100.0) {
        let (at, radius_px) = (map.view.place(place_m), radius_m * map.view.pixels_per_m());
        map.picture.ring(at, radius_px, 3.0, ROBOT);
        map.picture.disc(at, 4.0, ROBOT);
    }
    let places: Vec<_> = grid
        .route_m
        .iter()
        .filter_map(|point| world::place_m(point[0], point[1]))
        .map(|at| map.view.place(at))
        .collect();
    map.picture.polyline(&places, 3.0, ROUTE);
    for object in &grid.objects {
        draw_object(&mut map, object);
    }
    map.finished().0
}

fn draw_cells(map: &mut Map, grid: &PlottedGrid) {
    if !(grid.width > 0 && grid.cell_m > 0.0 && grid.percent.len() <= CELLS_MAX) {
        return;
    }
    let half = Vector2::repeat(0.5 * grid.cell_m);
    for (index, percent) in grid.percent.iter().enumerate() {
        let [x, y] = [index % grid.width, index / grid.width].map(|cell| cell as f64 * grid.cell_m);
        let Some(middle_m) = world::place_m(grid.origin_m[0] + x, grid.origin_m[1] + y) else { continue };
        let (first, last) = (map.view.place(middle_m - half), map.view.place(middle_m + half));
        let (low, high) = (first.inf(&last), first.sup(&last));
        map.picture.block(low, high, colour(*percent));
        map.picture.stroke(low, Vector2::new(high.x, low.y), 1.0, chrome::UNSEEN);
        map.picture.stroke(low, Vector2::new(low.x, high.y), 1.0, chrome::UNSEEN);
        if *percent <= 100 {
            let at = chrome::rounded(0.5 * (low + high)) + Point::new(0, 4);
            map.picture.label(&percent.to_string(), at, Alignment::Center);
        }
    }
}

fn colour(percent: u8) -> Rgb888 {
    if percent > 100 {
        return chrome::UNSEEN;
    }
    let share = f64::from(percent) / 100.0;
    let mix =
        |free: u8, occupied: u8| (f64::from(free) + (f64::from(occupied) - f64::from(free)) * share).round() as u8;
    Rgb888::new(mix(FREE.r(), OCCUPIED.r()), mix(FREE.g(), OCCUPIED.g()), mix(FREE.b(), OCCUPIED.b()))
}

fn draw_object(map: &mut Map, object: &PlottedObject) {
    let Some(place_m) = world::place_m(object.position_m[0], object.position_m[1]) else { return };
    let [xx, xy, yy] = object.covariance_m2;
    // The root of the covariance by Cholesky; its circle is the ellipse.
    let first = xx.max(0.0).sqrt();
    let lower = if first > 0.0 { xy / first } else { 0.0 };
    let second = (yy - lower * lower).max(0.0).sqrt();
    let point = |index: usize| {
        let (sine, cosine) = (index as f64 * std::f64::consts::TAU / ELLIPSE_POINTS as f64).sin_cos();
        let offset_m = Vector2::new(first * cosine, lower * cosine + second * sine) * ELLIPSE_SIGMAS;
        map.view.place(place_m + offset_m)
    };
    let points: Vec<Vector2<f64>> = (0..=ELLIPSE_POINTS).map(point).collect();
    map.picture.polyline(&points, 2.0, OBJECT);
    let at = map.view.place(place_m);
    map.picture.disc(at, 4.0, OBJECT);
    map.picture.disc(at, 1.5, INK);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_occupied_cell_is_dark_an_unknown_one_grey_and_no_number_is_harmless() {
        let mut percent = vec![255; 25];
        percent[12] = 100;
        let object = |x_m: f64| PlottedObject { position_m: [x_m, 0.5], covariance_m2: [1e-4, f64::NAN, 1e-4] };
        let grid = PlottedGrid {
            origin_m: [0.0, 0.0],
            cell_m: 0.2,
            width: 5,
            percent,
            objects: vec![object(0.8), object(f64::NAN)],
            route_m: vec![[0.0, 0.0], [f64::INFINITY, 1.0]],
            robot: ([f64::NAN, 0.0], 0.1),
        };
        let picture = grid_map(&World::default(), &grid, ["a grid", ""], [[-0.1, -0.1], [0.9, 0.9]]);
        let (width, height) = picture.size_px();
        let mut seen = std::collections::BTreeSet::new();
        for y in 0..height.cast_signed() {
            for x in 0..width.cast_signed() {
                seen.extend(picture.pixel(x, y));
            }
        }
        for colour in [OCCUPIED, chrome::UNSEEN, OBJECT] {
            assert!(seen.contains(&[colour.r(), colour.g(), colour.b()]), "{colour:?}");
        }
    }
}
