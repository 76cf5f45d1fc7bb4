//! A world as a map: x to the right, y up, axes in metres, with everything that stands and moves in it.
//!
//! Goes in: a world and whatever else has to fit. Comes out: [`Map`], a picture with its scale, for others to draw on.

use super::chrome::{self, Area, Frame, Sign};
use super::{PlottedPoint, PlottedRun};
use crate::io::canvas::{Picture, View};
use crate::signal::LayerName;
use crate::sim::{PathLoop, World};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use nalgebra::Vector2;

/// Farthest coordinate that is drawn: a world's own limit.
const COORDINATE_MAX_M: f64 = 1e4;
/// Least shares of the longer side in x and y: titles and legends need room.
const LEAST: Vector2<f64> = Vector2::new(0.6, 0.3);
const WALL: Rgb888 = Rgb888::new(20, 20, 20);
const PILLAR: Rgb888 = Rgb888::new(95, 95, 95);
const SOLID: Rgb888 = Rgb888::new(196, 180, 160);
const MOVER: Rgb888 = Rgb888::new(150, 0, 150);
const START_ZONE: Rgb888 = Rgb888::new(20, 20, 20);

/// A map under construction: drawn apart from its frame, so that nothing spills over it.
pub(super) struct Map {
    pub(super) picture: Picture,
    pub(super) view: View,
    sheet: Picture,
    area: Area,
}

/// A place that can be drawn.
pub(super) fn place_m(x_m: f64, y_m: f64) -> Option<Vector2<f64>> {
    (x_m.abs() <= COORDINATE_MAX_M && y_m.abs() <= COORDINATE_MAX_M).then(|| Vector2::new(x_m, y_m))
}

/// Stretches of a way between points that cannot be drawn.
pub(super) fn drawable(points: &[PlottedPoint]) -> impl Iterator<Item = Vec<(Vector2<f64>, LayerName)>> {
    let located = |point: &PlottedPoint| place_m(point.x_m, point.y_m).map(|place_m| (place_m, point.layer));
    let pieces = points.split(move |point| located(point).is_none()).filter(|piece| !piece.is_empty());
    pieces.map(move |piece| piece.iter().filter_map(located).collect())
}

/// Corners of the window, or of everything that has to be on the map; a square metre where there is nothing.
fn bounds_m(world: &World, runs: &[PlottedRun], window_m: Option<[[f64; 2]; 2]>) -> (Vector2<f64>, Vector2<f64>) {
    let corners = window_m.and_then(|[low, high]| Some((place_m(low[0], low[1])?, place_m(high[0], high[1])?)));
    if let Some((low, high)) = corners.filter(|(low, high)| low.x < high.x && low.y < high.y) {
        return chrome::bordered(low, high, LEAST);
    }
    let walls = world.walls.iter().flat_map(|wall| wall.points.iter().map(|point| (*point, 0.0)));
    let pillars = world.pillars.iter().map(|pillar| (pillar.centre, pillar.radius_m));
    let movers = world.movers.iter().flat_map(|mover| mover.path.iter().map(|point| (*point, mover.radius_m)));
    let waypoints = world.waypoints.iter().map(|point| (*point, 0.0));
    let [corner, size] = [world.start.corner, world.start.size];
    let start = [corner, [corner[0] + size[0], corner[1] + size[1]]].map(|point| (point, 0.0));
    let ways = runs.iter().flat_map(|run| run.points.iter().map(|point| ([point.x_m, point.y_m], 0.0)));
    let bars = world.bars.iter().flat_map(|bar| [(bar.from, bar.radius_m), (bar.to, bar.radius_m)]);
    let balls = world.balls.iter().map(|ball| (ball.centre, ball.radius_m));
    let solids = bars.chain(balls).map(|([x_m, y_m, _], radius_m)| ([x_m, y_m], radius_m));
    let discs = walls.chain(pillars).chain(solids).chain(movers).chain(waypoints).chain(start).chain(ways);
    let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for ([x_m, y_m], radius_m) in discs {
        if let (Some(place), true) = (place_m(x_m, y_m), radius_m.abs() <= COORDINATE_MAX_M) {
            (low, high) = (low.inf(&place.add_scalar(-radius_m)), high.sup(&place.add_scalar(radius_m)));
        }
    }
    if low.x > high.x {
        return (Vector2::repeat(-0.5), Vector2::repeat(0.5));
    }
    chrome::bordered(low, high, LEAST)
}

impl Map {
    /// A map of the whole world or of a window of it, with axes, titles and legend, its longer side of `long_side_px`.
    pub(super) fn new(
        world: &World,
        runs: &[PlottedRun],
        (long_side_px, window_m): (u32, Option<[[f64; 2]; 2]>),
        mut frame: Frame,
    ) -> Self {
        let (low_m, high_m) = bounds_m(world, runs, window_m);
        let extent_m = high_m - low_m;
        let pixels_per_m = f64::from(long_side_px.clamp(200, 4000)) / extent_m.max();
        let (width, height) = ((extent_m.x * pixels_per_m).round() as i32, (extent_m.y * pixels_per_m).round() as i32);
        frame.legend.splice(0..0, world_legend(world));
        let (mut sheet, area) = frame.sheet(width, height);
        let [x_title, y_title] = if frame.axis_titles { ["x (m)", "y (m)"] } else { ["", ""] };
        // The area is a whole number of pixels, which the world need not be.
        let (width_m, height_m) = (f64::from(width) / pixels_per_m, f64::from(height) / pixels_per_m);
        area.axis_below(&mut sheet, &chrome::axis_ticks(low_m.x, low_m.x + width_m, width), x_title);
        area.axis_left(&mut sheet, &chrome::axis_ticks(low_m.y, low_m.y + height_m, height), y_title);
        let picture = Picture::new(width as u32 + 1, height as u32 + 1);
        Self { picture, view: View::map(Point::new(0, height), low_m, pixels_per_m), sheet, area }
    }

    /// The map in its frame, and where in the picture it is.
    pub(super) fn finished(mut self) -> (Picture, Area) {
        self.sheet.paste(&self.picture, Point::new(self.area.left, self.area.top));
        self.area.frame(&mut self.sheet);
        (self.sheet, self.area)
    }

    /// Draws what lies under the ways: bars and balls, which may be overhead or low enough to be driven over, and the movers' paths.
    pub(super) fn draw_floor(&mut self, world: &World) {
        let balls = world.balls.iter().map(|ball| (ball.centre, ball.centre, ball.radius_m));
        let bars = world.bars.iter().map(|bar| (bar.from, bar.to, bar.radius_m));
        for (from, to, radius_m) in balls.chain(bars).filter(|(_, _, radius_m)| radius_m.abs() <= COORDINATE_MAX_M) {
            if let (Some(from), Some(to)) = (place_m(from[0], from[1]), place_m(to[0], to[1])) {
                let (from, to) = (self.view.place(from), self.view.place(to));
                let radius_px = (radius_m * self.view.pixels_per_m()).max(2.0);
                self.picture.stroke(from, to, 2.0 * radius_px, SOLID);
                [from, to].into_iter().for_each(|end| self.picture.disc(end, radius_px, SOLID));
            }
        }
        for mover in &world.movers {
            let closing = (mover.repeat == PathLoop::Cycle).then(|| mover.path.first()).flatten();
            let path = mover.path.iter().chain(closing);
            let places: Vec<_> =
                path.filter_map(|point| place_m(point[0], point[1])).map(|point| self.view.place(point)).collect();
            self.picture.dashes(&places, 2.0, MOVER);
            if let (Some(first), true) = (places.first(), mover.radius_m.abs() <= COORDINATE_MAX_M) {
                self.picture.ring(*first, mover.radius_m * self.view.pixels_per_m(), 2.0, MOVER);
            }
        }
    }

    /// Draws what stands in the world and where the run begins.
    pub(super) fn draw_world(&mut self, world: &World) {
        for wall in &world.walls {
            for (from, to) in wall.pieces() {
                if let (Some(from), Some(to)) = (place_m(from.x, from.y), place_m(to.x, to.y)) {
                    self.picture.stroke(self.view.place(from), self.view.place(to), 3.0, WALL);
                }
            }
        }
        for pillar in &world.pillars {
            if let (Some(centre), true) =
                (place_m(pillar.centre[0], pillar.centre[1]), pillar.radius_m.abs() <= COORDINATE_MAX_M)
            {
                // A pillar of 2 cm must be seen in a world of 20 m.
                let radius_px = (pillar.radius_m * self.view.pixels_per_m()).max(2.5);
                self.picture.disc(self.view.place(centre), radius_px, PILLAR);
            }
        }
        let ([x_m, y_m], size_m) = (world.start.corner, world.start.size);
        if let (Some(low), Some(high)) = (place_m(x_m, y_m), place_m(x_m + size_m[0], y_m + size_m[1])) {
            chrome::dashed_frame(&mut self.picture, self.view.place(low), self.view.place(high), START_ZONE);
        }
    }

    /// Draws where the run leads to.
    pub(super) fn draw_waypoints(&mut self, world: &World) {
        for (index, waypoint) in world.waypoints.iter().enumerate() {
            if let Some(place) = place_m(waypoint[0], waypoint[1]) {
                let place = self.view.place(place);
                self.picture.ring(place, world.reach_m * self.view.pixels_per_m(), 1.0, chrome::WAYPOINT);
                chrome::waypoint(&mut self.picture, place, &(index + 1).to_string());
            }
        }
    }

    /// Marks the last place of every run that ended with a contact.
    pub(super) fn draw_contacts(&mut self, runs: &[PlottedRun]) {
        let ends = runs.iter().filter(|run| run.collided).filter_map(|run| run.points.last());
        for place in ends.filter_map(|point| place_m(point.x_m, point.y_m)) {
            chrome::contact(&mut self.picture, self.view.place(place));
        }
    }
}

/// Signs for what the world has.
pub(super) fn world_legend(world: &World) -> Vec<(Sign, String)> {
    let entries = [
        (!world.walls.is_empty(), Sign::Line(WALL), "wall"),
        (!world.pillars.is_empty(), Sign::Disc(PILLAR), "pillar"),
        (!(world.bars.is_empty() && world.balls.is_empty()), Sign::Disc(SOLID), "bar or ball, at any height"),
        (!world.movers.is_empty(), Sign::Dashes(MOVER), "mover's path"),
        (true, Sign::Frame(START_ZONE), "start zone"),
        (!world.waypoints.is_empty(), Sign::Waypoint, "waypoint, reached within the circle"),
    ];
    entries.into_iter().filter(|entry| entry.0).map(|(_, sign, words)| (sign, words.to_owned())).collect()
}

/// "150 runs, 10 layouts, 0 contacts, 150 goals".
pub(super) fn counts(runs: &[PlottedRun]) -> String {
    let layouts: std::collections::BTreeSet<&str> = runs.iter().map(|run| run.layout).collect();
    let contacts = runs.iter().filter(|run| run.collided).count();
    let goals = runs.iter().filter(|run| run.reached_goal).count();
    let many = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    [many(runs.len(), "run"), many(layouts.len(), "layout"), many(contacts, "contact"), many(goals, "goal")].join(", ")
}
