//! How a robot moved by its echoes, by its wheels and in truth, and what moved beside it.
//!
//! Goes in: numbers over time and places. Comes out: a picture of three panels: V, omega, the map. Estimates nothing.

use super::chrome::{self, Frame, Sign};
use super::world::{Map, place_m};
use crate::io::canvas::{GRID_LINE, Picture};
use crate::sim::World;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use nalgebra::Vector2;

const TRUTH: Rgb888 = Rgb888::new(150, 150, 150);
const ECHOES: Rgb888 = Rgb888::new(0, 114, 178);
const WHEELS: Rgb888 = Rgb888::new(213, 94, 0);
const ALARM: Rgb888 = Rgb888::new(250, 215, 215);
const REAL: Rgb888 = Rgb888::new(150, 0, 150);
/// Pixels of a panel over time, and of the map's longer side.
const WIDTH_PX: i32 = 560;
const HEIGHT_PX: i32 = 380;
const MAP_PX: u32 = 560;
/// An arrow is as long as the way of one second.
const ARROW_S: f64 = 1.0;

/// Something that moved, at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlottedMover {
    /// Its middle in the world.
    pub position_m: [f64; 2],
    /// Its velocity in the world.
    pub velocity_m_s: [f64; 2],
    /// Its radius.
    pub radius_m: f64,
}

/// One drive; all lists over time are as long as `times_s`, velocities are V in m/s and omega in rad/s, NaN for unknown.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlottedMotion {
    /// Time of each ping set.
    pub times_s: Vec<f64>,
    /// True velocity.
    pub truth: Vec<[f64; 2]>,
    /// Velocity by the echoes.
    pub echoes: Vec<[f64; 2]>,
    /// Velocity by the wheels.
    pub odometry: Vec<[f64; 2]>,
    /// Whether the alarm was raised.
    pub slip: Vec<bool>,
    /// The way through the world.
    pub way_m: Vec<[f64; 2]>,
    /// Movers told.
    pub told: Vec<PlottedMover>,
    /// Movers that there were at the same moments.
    pub real: Vec<PlottedMover>,
}

/// Draws a drive through a world.
#[must_use]
pub fn motion_panels(world: &World, plotted: &PlottedMotion, title: &str) -> Picture {
    let panels = [over_time(plotted, 0, "V (m/s)"), over_time(plotted, 1, "omega (rad/s)"), map(world, plotted)];
    let legend = [
        (Sign::Line(TRUTH), "truth"),
        (Sign::Line(ECHOES), "by the echoes"),
        (Sign::Dashes(WHEELS), "by the wheels"),
        (Sign::Patch(ALARM), "slip alarm"),
        (Sign::Line(REAL), "movers and their velocity, truth"),
    ];
    let legend = legend.map(|(sign, words)| (sign, words.to_owned()));
    let below = "arrows: the way of one second, every tenth ping set; blue: movers told";
    chrome::tiled(&panels, 3, [title, below], &legend)
}

fn over_time(plotted: &PlottedMotion, axis: usize, title: &str) -> Picture {
    let frame = Frame { titles: ["", ""], right_px: 0, legend: Vec::new(), axis_titles: true };
    let (mut picture, area) = frame.sheet(WIDTH_PX, HEIGHT_PX);
    let lists = [&plotted.truth, &plotted.odometry, &plotted.echoes];
    let values = || lists.iter().flat_map(|list| list.iter().map(|pair| pair[axis])).filter(|value| value.is_finite());
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.1, f64::max));
    let (low, high) = (low - 0.05 * (high - low), high + 0.05 * (high - low));
    let first_s = plotted.times_s.first().copied().unwrap_or(0.0);
    let last_s = plotted.times_s.last().copied().filter(|last_s| *last_s > first_s).unwrap_or(first_s + 1.0);
    let place = |time_s: f64, value: f64| {
        let across = (time_s - first_s) / (last_s - first_s);
        let up = (value - low) / (high - low);
        Vector2::new(
            f64::from(area.left) + across * f64::from(area.right - area.left),
            f64::from(area.bottom) - up * f64::from(area.bottom - area.top),
        )
    };
    for (pair, _) in plotted.times_s.windows(2).zip(&plotted.slip).filter(|(_, slip)| **slip) {
        picture.block(place(pair[0], high), place(pair[1], low), ALARM);
    }
    let ups = chrome::axis_ticks(low, high, HEIGHT_PX);
    for (up, _) in &ups {
        let y = area.bottom - (up * f64::from(area.bottom - area.top)).round() as i32;
        picture.line(Point::new(area.left, y), Point::new(area.right, y), GRID_LINE);
    }
    area.axis_below(&mut picture, &chrome::axis_ticks(first_s, last_s, WIDTH_PX), "time (s)");
    area.axis_left(&mut picture, &ups, title);
    let pieces = |list: &[[f64; 2]]| -> Vec<Vec<Vector2<f64>>> {
        let points: Vec<(f64, f64)> =
            plotted.times_s.iter().zip(list).map(|(time_s, pair)| (*time_s, pair[axis])).collect();
        let known = points.split(|(_, value)| !value.is_finite()).filter(|piece| !piece.is_empty());
        known.map(|piece| piece.iter().map(|(time_s, value)| place(*time_s, *value)).collect()).collect()
    };
    pieces(&plotted.truth).iter().for_each(|piece| picture.polyline(piece, 5.0, TRUTH));
    pieces(&plotted.odometry).iter().for_each(|piece| picture.dashes(piece, 2.0, WHEELS));
    pieces(&plotted.echoes).iter().for_each(|piece| picture.polyline(piece, 1.6, ECHOES));
    area.frame(&mut picture);
    picture
}

fn map(world: &World, plotted: &PlottedMotion) -> Picture {
    let frame = Frame { titles: ["", ""], right_px: 0, legend: Vec::new(), axis_titles: true };
    let mut map = Map::new(world, &[], (MAP_PX, None), frame);
    map.draw_world(world);
    let way: Vec<Vector2<f64>> =
        plotted.way_m.iter().filter_map(|[x_m, y_m]| place_m(*x_m, *y_m)).map(|at| map.view.place(at)).collect();
    map.picture.polyline(&way, 3.0, TRUTH);
    for (movers, colour, width_px) in [(&plotted.real, REAL, 1.5), (&plotted.told, ECHOES, 2.5)] {
        for mover in movers {
            let [[x_m, y_m], [vx, vy]] = [mover.position_m, mover.velocity_m_s];
            let tip = place_m(x_m + ARROW_S * vx, y_m + ARROW_S * vy);
            if let (Some(at), Some(tip), true) = (place_m(x_m, y_m), tip, mover.radius_m.is_finite()) {
                let (at, tip) = (map.view.place(at), map.view.place(tip));
                map.picture.ring(at, mover.radius_m * map.view.pixels_per_m(), width_px, colour);
                map.picture.arrow(at, tip, width_px, colour);
            }
        }
    }
    map.finished().0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_is_drawn_where_it_is_known_and_nothing_senseless_is() {
        let world = World::default_world().expect("built in");
        let mover = PlottedMover { position_m: [2.0, 1.0], velocity_m_s: [0.3, 0.0], radius_m: 0.2 };
        let plotted = PlottedMotion {
            times_s: vec![0.0, 0.1, 0.2],
            truth: vec![[0.3, 0.0]; 3],
            echoes: vec![[0.2, 0.1], [0.2, 0.1], [f64::NAN; 2]],
            odometry: vec![[f64::NAN; 2]; 3],
            slip: vec![false, true, true],
            way_m: vec![[1.0, 1.0], [1.1, 1.0]],
            told: vec![mover],
            real: Vec::new(),
        };
        let blue = [ECHOES.r(), ECHOES.g(), ECHOES.b()];
        let count = |picture: &Picture| {
            let (width, height) = picture.size_px();
            let all = (0..width as i32).flat_map(|x| (0..height as i32 - 60).map(move |y| (x, y)));
            all.filter(|(x, y)| picture.pixel(*x, *y) == Some(blue)).count()
        };
        let whole = motion_panels(&world, &plotted, "title");
        let without = motion_panels(&world, &PlottedMotion { told: Vec::new(), ..plotted.clone() }, "title");
        assert!(count(&whole) > count(&without) && count(&without) > 0);
        let lost = PlottedMover { position_m: [f64::NAN, 1.0], ..mover };
        let clean = motion_panels(&world, &PlottedMotion { told: vec![mover, lost], ..plotted.clone() }, "title");
        assert!(clean == whole);
        let _ = motion_panels(&world, &PlottedMotion::default(), "");
    }
}
