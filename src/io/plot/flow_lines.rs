//! The ways of echoes through one sensor's image while the robot moves (paper 000, figures 4 and 5).
//!
//! Goes in: lines in bearing and range, already computed. Comes out: range over bearing, bearings to the left on the left, as
//! in every other picture. Knows nothing of motion.

use super::chrome::{self, Area, Frame, Sign};
use crate::io::canvas::{BACKGROUND, INK, PLAIN, Picture};
use crate::signal::PolarGrid;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

const WIDTH_PX: i32 = 640;
const HEIGHT_PX: i32 = 560;
const FAINT: Rgb888 = Rgb888::new(150, 150, 150);
/// Colours of the marked reflectors, in order and round again: from Okabe and Ito.
const MARKS: [Rgb888; 3] = [Rgb888::new(213, 94, 0), Rgb888::new(0, 114, 178), Rgb888::new(0, 158, 115)];

/// The way of an echo.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowCurve {
    /// `[bearing_rad, range_m]`, in the direction of the echo's motion.
    pub points: Vec<[f64; 2]>,
    /// Index of the marked reflector whose way this is.
    pub marked: Option<usize>,
}

/// A reflector that is named.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowMark {
    /// Its name.
    pub name: String,
    /// Where the sensor hears it now: `[bearing_rad, range_m]`; `None` where it does not.
    pub place: Option<[f64; 2]>,
}

/// The ways for one motion of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowPanel {
    /// The motion.
    pub title: String,
    /// The ways.
    pub curves: Vec<FlowCurve>,
}

/// Draws a panel a motion. `hidden[direction]` says which directions of `grid` the sensor cannot see.
#[must_use]
pub fn flow_lines(title: &str, panels: &[FlowPanel], marks: &[FlowMark], grid: &PolarGrid, hidden: &[bool]) -> Picture {
    let drawn: Vec<Picture> = panels.iter().map(|panel| panel_picture(panel, marks, grid, hidden)).collect();
    let mut legend = vec![(Sign::Line(FAINT), "way of an echo, arrow: its motion".to_owned())];
    legend.extend(marks.iter().enumerate().map(|(index, mark)| {
        let unheard = if mark.place.is_none() { ", not heard here now" } else { "" };
        (Sign::Line(MARKS[index % MARKS.len()]), format!("reflector {}{unheard}", mark.name))
    }));
    legend.push((Sign::Patch(chrome::UNSEEN), "too near to be heard, or hidden".to_owned()));
    chrome::tiled(&drawn, panels.len().clamp(1, 3), [title, ""], &legend)
}

/// Bearings of the grid from the right to the left end, half a step beyond the outer ones, and its farthest range.
fn extent(grid: &PolarGrid) -> ([f64; 2], f64) {
    let mut bearings: Vec<f64> = grid.directions().iter().map(|direction| direction.azimuth_rad).collect();
    bearings.sort_by(f64::total_cmp);
    let (first, last) = (bearings[0], bearings[bearings.len() - 1]);
    let half_step = 0.5 * ((last - first) / (bearings.len().max(2) - 1) as f64).max(1e-3);
    ([first - half_step, last + half_step], grid.range_m(grid.range_count() - 1))
}

fn panel_picture(panel: &FlowPanel, marks: &[FlowMark], grid: &PolarGrid, hidden: &[bool]) -> Picture {
    let ([right_rad, left_rad], range_max_m) = extent(grid);
    let frame = Frame { titles: [&panel.title, ""], right_px: 0, legend: Vec::new(), axis_titles: true };
    let (mut picture, area) = frame.sheet(WIDTH_PX, HEIGHT_PX);
    let place = |[bearing_rad, range_m]: [f64; 2]| {
        let across = (left_rad - bearing_rad) / (left_rad - right_rad);
        Vector2::new(across * f64::from(WIDTH_PX), (1.0 - range_m / range_max_m) * f64::from(HEIGHT_PX))
    };
    // Drawn apart, so that a way that leaves the range ends at the frame.
    let mut inner = Picture::new(WIDTH_PX as u32, HEIGHT_PX as u32);
    shade_unheard(&mut inner, grid, hidden, place);
    for marked in [false, true] {
        for curve in panel.curves.iter().filter(|curve| curve.marked.is_some() == marked) {
            let colour = curve.marked.map_or(FAINT, |index| MARKS[index % MARKS.len()]);
            draw_curve(&mut inner, curve, place, colour);
        }
    }
    for (index, mark) in marks.iter().enumerate() {
        if let Some(at) = mark.place.map(place) {
            inner.disc(at, 12.5, BACKGROUND);
            inner.disc(at, 11.0, MARKS[index % MARKS.len()]);
            inner.write(&mark.name, chrome::rounded(at) + Point::new(0, -1), Alignment::Center, (PLAIN, BACKGROUND));
        }
    }
    picture.paste(&inner, Point::new(area.left, area.top));
    draw_axes(&mut picture, area, [right_rad, left_rad], range_max_m);
    picture
}

fn shade_unheard(inner: &mut Picture, grid: &PolarGrid, hidden: &[bool], place: impl Fn([f64; 2]) -> Vector2<f64>) {
    let bottom = f64::from(HEIGHT_PX);
    let near = place([0.0, grid.range_first_m()]).y;
    inner.block(Vector2::new(0.0, near), Vector2::new(f64::from(WIDTH_PX), bottom), chrome::UNSEEN);
    let half_px = 0.5 * f64::from(WIDTH_PX) / grid.direction_count() as f64;
    for (direction, _) in grid.directions().iter().zip(hidden).filter(|(_, hidden)| **hidden) {
        let x = place([direction.azimuth_rad, 0.0]).x;
        inner.block(Vector2::new(x - half_px, 0.0), Vector2::new(x + half_px, bottom), chrome::UNSEEN);
    }
}

fn draw_curve(inner: &mut Picture, curve: &FlowCurve, place: impl Fn([f64; 2]) -> Vector2<f64>, colour: Rgb888) {
    let width_px = if curve.marked.is_some() { 3.0 } else { 1.2 };
    let places: Vec<Vector2<f64>> = curve.points.iter().map(|point| place(*point)).collect();
    inner.polyline(&places, width_px, colour);
    let shown = |place: &Vector2<f64>| {
        (0.0..f64::from(WIDTH_PX)).contains(&place.x) && (0.0..f64::from(HEIGHT_PX)).contains(&place.y)
    };
    let visible: Vec<usize> = (1..places.len()).filter(|index| shown(&places[*index])).collect();
    // A marked way has three arrows, any other one.
    let shares: &[f64] = if curve.marked.is_some() { &[0.25, 0.5, 0.8] } else { &[0.5] };
    for share in shares {
        if let Some(index) = visible.get((share * visible.len() as f64) as usize) {
            inner.arrow(places[index - 1], places[*index], width_px, colour);
        }
    }
}

fn draw_axes(picture: &mut Picture, area: Area, [right_rad, left_rad]: [f64; 2], range_max_m: f64) {
    let mut bearings = chrome::axis_ticks(right_rad.to_degrees() / 15.0, left_rad.to_degrees() / 15.0, WIDTH_PX * 2);
    bearings.iter_mut().for_each(|(share, _)| *share = 1.0 - *share);
    bearings.iter_mut().for_each(|(_, text)| {
        *text = text.parse::<f64>().map_or(String::new(), |value| chrome::number(15.0 * value, 0))
    });
    area.axis_below(picture, &bearings, "bearing (°), left of the boresight is positive");
    area.axis_left(picture, &chrome::axis_ticks(0.0, range_max_m, HEIGHT_PX), "range (m)");
    let middle = (left_rad / (left_rad - right_rad) * f64::from(WIDTH_PX)).round() as i32 + area.left;
    picture.line(Point::new(middle, area.top), Point::new(middle, area.top + 8), INK);
    area.frame(picture);
}
