//! A room from above and from the side: what a level fan takes it for, and what points in space make of it.
//!
//! Goes in: things, and points with classes. Comes out: a picture of four panels. Detects nothing.

use super::chrome::{self, Area, Frame, Sign};
use crate::io::canvas::{GRID_LINE, Picture};
use crate::signal::SpaceClass;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use nalgebra::Vector2;

const TRUTH: Rgb888 = Rgb888::new(150, 150, 150);
const ROBOT: Rgb888 = Rgb888::new(255, 236, 214);
const COLOURS: [Rgb888; 4] =
    [Rgb888::new(0, 140, 100), Rgb888::new(213, 60, 0), Rgb888::new(0, 114, 178), Rgb888::new(130, 70, 160)];
/// Pixels of a metre.
const PIXELS_PER_M: f64 = 175.0;
/// What is drawn, robot frame.
const X_M: [f64; 2] = [-0.3, 2.8];
const Y_M: [f64; 2] = [-1.5, 1.5];
const Z_M: [f64; 2] = [-0.6, 2.1];

/// A point: place, class, two standard deviations along each axis.
pub type PlottedSpacePoint = ([f64; 3], SpaceClass, [f64; 3]);

/// A room and what was made of it, robot frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlottedSpace {
    /// Where each thing echoes, and what it is.
    pub things: Vec<([f64; 3], SpaceClass)>,
    /// Bars.
    pub bars: Vec<([f64; 3], [f64; 3])>,
    /// Balls.
    pub balls: Vec<([f64; 3], f64)>,
    /// What the level fan heard.
    pub fan: Vec<PlottedSpacePoint>,
    /// What the grid heard.
    pub grid: Vec<PlottedSpacePoint>,
    /// Heights of the floor, of the lowest and highest part of the robot, of the ceiling.
    pub levels_m: [f64; 4],
}

/// Draws the room twice, from above and from the side: with the points of the fan, and with those of the grid.
#[must_use]
pub fn space_panels(plotted: &PlottedSpace, names: [&str; 2]) -> Picture {
    let mut panels = Vec::with_capacity(4);
    for (points, name) in [(&plotted.fan, names[0]), (&plotted.grid, names[1])] {
        panels.push(panel(plotted, points, 1, &format!("{name}, from above"), "y (m)"));
        panels.push(panel(plotted, points, 2, &format!("{name}, from the side"), "z (m)"));
    }
    let mut legend = vec![(Sign::Line(TRUTH), "balls, bars, floor, ceiling".to_owned())];
    legend
        .extend(SpaceClass::ALL.iter().map(|class| (Sign::Patch(COLOURS[*class as usize]), class.as_str().to_owned())));
    legend.push((Sign::Patch(ROBOT), "heights of the robot".to_owned()));
    let titles = [
        "What is in the way: a level fan, and points in space",
        "rings: two standard deviations; grey dots: where a thing echoes",
    ];
    chrome::tiled(&panels, 2, titles, &legend)
}

/// Where axis `up` (1 = y, 2 = z) of a place lies.
struct Panel {
    area: Area,
    low: Vector2<f64>,
    up: usize,
}

impl Panel {
    fn place(&self, place_m: [f64; 3]) -> Vector2<f64> {
        let offset = Vector2::new(place_m[0], place_m[self.up]) - self.low;
        Vector2::new(
            f64::from(self.area.left) + PIXELS_PER_M * offset.x,
            f64::from(self.area.bottom) - PIXELS_PER_M * offset.y,
        )
    }

    fn shows(&self, place_m: [f64; 3]) -> bool {
        let limits = if self.up == 1 { Y_M } else { Z_M };
        (X_M[0]..=X_M[1]).contains(&place_m[0]) && (limits[0]..=limits[1]).contains(&place_m[self.up])
    }
}

fn panel(plotted: &PlottedSpace, points: &[PlottedSpacePoint], up: usize, title: &str, axis: &str) -> Picture {
    let limits = if up == 1 { Y_M } else { Z_M };
    let size = [X_M, limits].map(|[low, high]| (PIXELS_PER_M * (high - low)) as i32);
    let frame = Frame { titles: [title, ""], right_px: 0, legend: Vec::new(), axis_titles: true };
    let (mut picture, area) = frame.sheet(size[0], size[1]);
    let panel = Panel { area, low: Vector2::new(X_M[0], limits[0]), up };
    if up == 2 {
        let [floor_m, low_m, high_m, ceiling_m] = plotted.levels_m;
        picture.block(panel.place([X_M[0], 0.0, high_m]), panel.place([X_M[1], 0.0, low_m]), ROBOT);
        for level_m in [floor_m, ceiling_m] {
            let ends = [panel.place([X_M[0], 0.0, level_m]), panel.place([X_M[1], 0.0, level_m])];
            picture.polyline(&ends, 3.0, TRUTH);
        }
    } else {
        for (up, _) in chrome::axis_ticks(Y_M[0], Y_M[1], size[1]) {
            let y = area.bottom - (up * f64::from(area.bottom - area.top)).round() as i32;
            picture.line(Point::new(area.left, y), Point::new(area.right, y), GRID_LINE);
        }
    }
    for (from, to) in &plotted.bars {
        picture.polyline(&[panel.place(*from), panel.place(*to)], 4.0, TRUTH);
    }
    for (centre, radius_m) in plotted.balls.iter().filter(|(centre, _)| panel.shows(*centre)) {
        picture.ring(panel.place(*centre), radius_m * PIXELS_PER_M, 2.0, TRUTH);
    }
    for (place, _) in plotted.things.iter().filter(|(place, _)| panel.shows(*place)) {
        picture.disc(panel.place(*place), 3.0, TRUTH);
    }
    for (place, class, spread) in points.iter().filter(|(place, _, _)| panel.shows(*place)) {
        let colour = COLOURS[*class as usize];
        picture.disc(panel.place(*place), 4.5, colour);
        let wide_m = spread[0].max(spread[up]);
        if wide_m.is_finite() && wide_m > 0.0 {
            picture.ring(panel.place(*place), (wide_m * PIXELS_PER_M).min(60.0), 1.2, colour);
        }
    }
    area.axis_below(&mut picture, &chrome::axis_ticks(X_M[0], X_M[1], size[0]), "x (m)");
    area.axis_left(&mut picture, &chrome::axis_ticks(limits[0], limits[1], size[1]), axis);
    area.frame(&mut picture);
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_drawn_in_the_colour_of_its_class_and_nothing_senseless_is() {
        let none = PlottedSpace { levels_m: [-0.4, -0.3, 0.3, 1.9], ..PlottedSpace::default() };
        let count = |plotted: &PlottedSpace| {
            let picture = space_panels(plotted, ["fan", "grid"]);
            let (width, height) = picture.size_px();
            let all = (0..height as i32).flat_map(|y| (0..width as i32).map(move |x| (x, y)));
            all.filter(|(x, y)| picture.pixel(*x, *y) == Some([0, 114, 178])).count()
        };
        let with = |place, spread| PlottedSpace { grid: vec![(place, SpaceClass::Overhang, spread)], ..none.clone() };
        let (empty, drawn) = (count(&none), count(&with([1.0, 0.2, 0.9], [0.02; 3])));
        // Two panels, each with a disc of radius 4.5.
        assert!(drawn > empty + 80, "{empty} {drawn}");
        assert_eq!(count(&with([f64::NAN; 3], [f64::NAN; 3])), empty);
        assert_eq!(count(&with([9.0, 0.0, 0.0], [0.1; 3])), empty);
    }
}
