//! Energyscapes side by side as a film, and all of one ping set together around the robot.
//!
//! Goes in: energyscapes. Comes out: pictures in decibels of full scale, all on one scale. Never scales data, only colours.

use super::chrome::{Area, Frame};
use super::robot::{PlottedRobot, RobotMap, Sight};
use crate::io::canvas::{BOLD, INK, Picture, fitted};
use crate::io::picture::{self, DYNAMIC_RANGE_DB, MARGIN_PX, decibels, heat};
use crate::signal::Energyscape;
use embedded_graphics::prelude::*;
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

const RADIUS_PX: i32 = 260;
const LABEL_PX: i32 = 24;
const BAR_PX: i32 = 90;
/// Most energyscapes of one picture.
const FRAMES_MAX: usize = 120;

/// Draws energyscapes in polar form row by row, `columns` in a row, on one scale of colours: the sensors of a robot in a row,
/// the rows following in time. At most 120 are drawn.
#[must_use]
pub fn frames(shown: &[(&str, &Energyscape)], columns: usize) -> Picture {
    let shown = &shown[..shown.len().min(FRAMES_MAX)];
    let columns = columns.clamp(1, shown.len().max(1));
    let rows = shown.len().div_ceil(columns).max(1) as i32;
    let (fan_width, fan_height) = picture::fan_size_px(RADIUS_PX);
    let (width, height) = (fan_width * columns as i32, (fan_height + LABEL_PX) * rows);
    let mut sheet = Picture::new((width + BAR_PX) as u32, height as u32);
    let top_db = picture::top_db(shown.iter().map(|(_, energyscape)| *energyscape));
    for (index, (label, energyscape)) in shown.iter().enumerate() {
        let (row, column) = ((index / columns) as i32, (index % columns) as i32);
        let corner = Point::new(column * fan_width, row * (fan_height + LABEL_PX));
        let label = fitted(label, fan_width - 2 * MARGIN_PX, BOLD);
        sheet.write(&label, corner + Point::new(fan_width / 2, 14), Alignment::Center, (BOLD, INK));
        let fan = picture::fan(RADIUS_PX, energyscape, top_db);
        sheet.paste(&fan, corner + Point::new(0, LABEL_PX));
    }
    picture::colour_bar(&mut sheet, width, RADIUS_PX, top_db);
    sheet
}

/// Draws the energyscapes of one ping set where they lie around the robot, the loudest where several sensors see a place.
/// Energyscapes of sensors that the robot lacks, or on another grid than its own, are left out.
#[must_use]
pub fn energyscapes_together(title: &str, shown: &[&Energyscape], robot: &PlottedRobot) -> Picture {
    let fits = |energyscape: &&&Energyscape| {
        energyscape.sensor_index < robot.sensors.len() && energyscape.values.len() == robot.grid.cell_count()
    };
    let shown: Vec<&Energyscape> = shown.iter().filter(fits).copied().collect();
    let top_db = picture::top_db(shown.iter().copied());
    let frame = Frame {
        titles: [title, "energyscapes of all sensors in the robot frame"],
        right_px: BAR_PX,
        legend: Vec::new(),
        axis_titles: true,
    };
    let reach = Vector2::repeat(robot.reach_m());
    let mut map = RobotMap::new(robot, (-reach, reach), &frame);
    let sight = Sight::new(robot);
    map.paint(|_, point_m| {
        let cells = |energyscape: &&Energyscape| {
            let values = &energyscape.values;
            sight
                .cells(energyscape.sensor_index, point_m)
                .filter(|(_, hidden)| !hidden)
                .map(|(cell, _)| values[cell])
                .reduce(f32::max)
        };
        let loudest = shown.iter().filter_map(cells).reduce(f32::max)?;
        Some((heat((decibels(f64::from(loudest)) - top_db) / DYNAMIC_RANGE_DB + 1.0), 1.0))
    });
    map.draw_robot(robot);
    let Area { top, right, .. } = map.area;
    let bar = Area { left: right + 24, top: top + 30, right: right + 42, bottom: top + 360 };
    let ticks: Vec<(f64, String)> = (0..=5)
        .map(|step| f64::from(step) / 5.0)
        .map(|share| (share, format!("{:.0}", top_db + (share - 1.0) * DYNAMIC_RANGE_DB)))
        .collect();
    bar.colour_bar(&mut map.picture, heat, &ticks, &["dBFS"]);
    map.picture
}
