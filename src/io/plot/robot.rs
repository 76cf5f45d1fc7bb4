//! A robot and its sensors from above: x (forward) up, y to the left, axes in metres.
//!
//! Goes in: footprint, sensors, what each of them sees. Comes out: [`RobotMap`], a picture with its scale, for others to
//! draw on, and which cell of which sensor lies at a place.

use super::chrome::{self, Area, Frame, Sign, UNSEEN};
use crate::geometry::Pose2;
use crate::io::canvas::{BACKGROUND, INK, PLAIN, Picture, View, text_width_px};
use crate::io::polar::Azimuths;
use crate::sensor::SensorSetup;
use crate::sensor::dead_zone::{self, HOUSING_DEPTH_M, HOUSING_WIDTH_M};
use crate::signal::PolarGrid;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

const LONG_SIDE_PX: f64 = 900.0;
/// Least shares of the longer side in x (up) and y (across): titles and legends need room.
const LEAST: Vector2<f64> = Vector2::new(0.4, 0.75);
/// Length of a sensor's arrow.
const BORESIGHT_PX: f64 = 60.0;
/// Nothing farther from the robot is shown: sensors hear some metres.
const REACH_MAX_M: f64 = 100.0;

/// A robot as plots show it.
#[derive(Debug, Clone, Copy)]
pub struct PlottedRobot<'a> {
    /// Radius of the footprint about the origin.
    pub footprint_radius_m: f64,
    /// The sensors, in the order of the configuration.
    pub sensors: &'a [SensorSetup],
    /// The grid that all sensors share.
    pub grid: &'a PolarGrid,
    /// `[sensor][direction]`: whether something on the robot hides the direction from the sensor; missing rows hide nothing.
    pub hidden: &'a [Vec<bool>],
}

impl PlottedRobot<'_> {
    /// The footprint's radius; 0 for one that is not a radius.
    fn radius_m(&self) -> f64 {
        if (0.0..=REACH_MAX_M).contains(&self.footprint_radius_m) { self.footprint_radius_m } else { 0.0 }
    }

    /// How far from the origin the farthest sensor hears.
    pub(super) fn reach_m(&self) -> f64 {
        let range_m = self.grid.range_m(self.grid.range_count() - 1);
        let mounts = self.sensors.iter().map(|sensor| sensor.mount.distance_m.abs() + range_m);
        mounts.fold(self.radius_m(), f64::max).clamp(0.1, REACH_MAX_M)
    }
}

/// Which cells lie at a place of the robot frame.
pub(super) struct Sight<'a> {
    robot: &'a PlottedRobot<'a>,
    azimuths: Azimuths,
}

impl<'a> Sight<'a> {
    pub(super) fn new(robot: &'a PlottedRobot<'a>) -> Self {
        Self { robot, azimuths: Azimuths::new(robot.grid) }
    }

    /// A sensor's cells at a place, and whether they are hidden from it.
    pub(super) fn cells(&self, sensor_index: usize, point_m: Vector2<f64>) -> impl Iterator<Item = (usize, bool)> {
        let pose = self.robot.sensors[sensor_index].mount.pose();
        let cells = self.azimuths.cells(self.robot.grid, pose.local_from_parent(point_m));
        let hidden = self.robot.hidden.get(sensor_index).map_or(&[][..], Vec::as_slice);
        cells.map(move |cell| {
            let direction = self.robot.grid.direction_and_range(cell).0;
            (cell, hidden.get(direction).copied().unwrap_or(false))
        })
    }

    /// Whether any sensor sees a place.
    pub(super) fn seen(&self, point_m: Vector2<f64>) -> bool {
        (0..self.robot.sensors.len()).any(|index| self.cells(index, point_m).any(|(_, hidden)| !hidden))
    }
}

/// A picture of the robot's surroundings under construction.
pub(super) struct RobotMap {
    pub(super) picture: Picture,
    pub(super) view: View,
    pub(super) area: Area,
}

impl RobotMap {
    /// A map from `low_m` to `high_m` with axes, titles and legend; the robot and some room about it are always on it.
    pub(super) fn new(robot: &PlottedRobot, (low_m, high_m): (Vector2<f64>, Vector2<f64>), frame: &Frame) -> Self {
        let about_m = robot.radius_m() + 0.4;
        let reach_m = robot.reach_m();
        let low_m = low_m.inf(&Vector2::repeat(-about_m)).sup(&Vector2::repeat(-reach_m));
        let high_m = high_m.sup(&Vector2::repeat(about_m)).inf(&Vector2::repeat(reach_m));
        let (low_m, high_m) = chrome::bordered(low_m, high_m, LEAST);
        let extent_m = high_m - low_m;
        let pixels_per_m = LONG_SIDE_PX / extent_m.max();
        let (width, height) = ((extent_m.y * pixels_per_m).round() as i32, (extent_m.x * pixels_per_m).round() as i32);
        let (mut picture, area) = frame.sheet(width, height);
        let mut below = chrome::axis_ticks(low_m.y, low_m.y + f64::from(width) / pixels_per_m, width);
        below.iter_mut().for_each(|(share, _)| *share = 1.0 - *share);
        let beside = chrome::axis_ticks(low_m.x, low_m.x + f64::from(height) / pixels_per_m, height);
        area.axis_below(&mut picture, &below, "y (m), left of the robot is positive");
        area.axis_left(&mut picture, &beside, "x (m), ahead of the robot is positive");
        let right = Vector2::new(f64::from(area.right), f64::from(area.bottom));
        let origin = right + Vector2::new(low_m.y, low_m.x) * pixels_per_m;
        Self { picture, view: View::robot_at(origin, pixels_per_m), area }
    }

    /// Colours every pixel of the map by its place in the robot frame.
    pub(super) fn paint(&mut self, colour: impl Fn(Point, Vector2<f64>) -> Option<(Rgb888, f64)>) {
        for y in self.area.top..=self.area.bottom {
            for x in self.area.left..=self.area.right {
                if let Some((colour, share)) = colour(Point::new(x, y), self.view.point_m(x, y)) {
                    self.picture.blend(x, y, colour, share);
                }
            }
        }
    }

    /// Draws what no sensor sees and, hatched, what is hidden from each.
    pub(super) fn draw_sight(&mut self, robot: &PlottedRobot, sight: &Sight) {
        self.paint(|at, point_m| {
            let hidden_from = |index: &usize| sight.cells(*index, point_m).any(|(_, hidden)| hidden);
            let mut hatches = (0..robot.sensors.len()).filter(hidden_from);
            if hatches.any(|index| chrome::hatched(at, index)) {
                return Some((chrome::HIDDEN, 1.0));
            }
            (!sight.seen(point_m)).then_some((UNSEEN, 1.0))
        });
    }

    /// Draws the footprint, the sensors with housing, boresight and name, and the frame.
    pub(super) fn draw_robot(&mut self, robot: &PlottedRobot) {
        let (view, picture) = (self.view, &mut self.picture);
        let origin = view.place(Vector2::zeros());
        picture.ring(origin, robot.radius_m() * view.pixels_per_m(), 2.5, INK);
        picture.arrow(origin, view.place(Vector2::new(0.7 * robot.radius_m(), 0.0)), 2.0, INK);
        let housing = dead_zone::housing();
        let tip_px = |pose: &Pose2, length_px: f64| {
            view.place(pose.parent_from_local(Vector2::new(length_px / view.pixels_per_m(), 0.0)))
        };
        for sensor in robot.sensors {
            let pose = sensor.mount.pose();
            let origin = view.place(pose.position_m());
            let reach = Vector2::repeat((HOUSING_WIDTH_M + HOUSING_DEPTH_M) * view.pixels_per_m());
            picture.cover((origin - reach, origin + reach), INK, |place| {
                let at = chrome::rounded(place);
                f64::from(u8::from(housing.contains(pose.local_from_parent(view.point_m(at.x, at.y)))))
            });
            picture.arrow(origin, tip_px(&pose, BORESIGHT_PX), 2.0, INK);
        }
        let mut labelled: Vec<(Vector2<f64>, Vector2<f64>)> = Vec::new();
        for sensor in robot.sensors {
            let half = Vector2::new(0.5 * f64::from(text_width_px(&sensor.name, PLAIN)) + 2.0, 8.0);
            let pose = sensor.mount.pose();
            // Beyond the arrow's tip, whichever way the arrow points; past other names on the side away from the robot.
            let (sin, cos) = pose.heading_rad.sin_cos();
            let mut at = tip_px(&pose, BORESIGHT_PX + 6.0 + half.x * sin.abs() + half.y * cos.abs());
            let outward = if pose.local_from_parent(Vector2::zeros()).y < 0.0 { 1.0 } else { -1.0 };
            let aside = view.place(pose.parent_from_local(Vector2::new(0.0, outward))) - view.place(pose.position_m());
            for _ in 0..40 {
                let meets = |(other, wide): &(Vector2<f64>, Vector2<f64>)| {
                    let (gap, reach) = ((at - other).abs(), half + wide);
                    gap.x < reach.x && gap.y < reach.y
                };
                if !labelled.iter().any(meets) {
                    break;
                }
                at += aside * (4.0 / view.pixels_per_m());
            }
            labelled.push((at, half));
            picture.block(at - half, at + half, BACKGROUND);
            picture.write(&sensor.name, chrome::rounded(at), Alignment::Center, (PLAIN, INK));
        }
        self.area.frame(&mut self.picture);
    }
}

/// Signs for what every map of a robot shows.
pub(super) fn robot_legend(robot: &PlottedRobot) -> Vec<(Sign, String)> {
    let hides = robot.hidden.iter().flatten().any(|hidden| *hidden);
    let entries = [
        (true, Sign::Sensor, "sensor and its boresight"),
        (true, Sign::Patch(UNSEEN), "seen by no sensor"),
        (hides, Sign::Hatch, "hidden from one sensor by a housing or obstruction"),
    ];
    entries.into_iter().filter(|entry| entry.0).map(|(_, sign, words)| (sign, words.to_owned())).collect()
}
