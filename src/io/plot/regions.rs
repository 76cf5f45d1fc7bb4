//! The control regions and the masks made from them, over the robot (paper 000, figures 7 and 8).
//!
//! Goes in: shapes and masks as the layers use them. Comes out: pictures from above. A region that ends nowhere is shown as
//! far as the sensors hear.

use super::chrome::{Frame, Sign};
use super::robot::{PlottedRobot, RobotMap, Sight, robot_legend};
use super::{layer_ink, layer_words};
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::geometry::shape::Shape;
use crate::io::canvas::{BACKGROUND, Picture};
use crate::io::picture::{LEFT, RIGHT};
use crate::signal::{LayerName, Mask};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use nalgebra::Vector2;

/// How much of a region's colour covers what lies below.
const TINT: f64 = 0.34;
/// Width of a region's outline.
const OUTLINE_PX: i32 = 2;

/// The regions of the layers.
#[derive(Debug, Clone, Copy)]
pub struct PlottedRegions<'a> {
    /// The shapes of each layer, robot frame; the first lies lowest.
    pub shapes: &'a [(LayerName, &'a [Shape])],
    /// The flow lines of flow following.
    pub flow_lines: &'a [FlowLinesRegion],
}

/// Draws the robot with its sensors, all control regions as translucent areas, and what the sensors cannot see.
#[must_use]
pub fn regions(title: &str, robot: &PlottedRobot, regions: &PlottedRegions) -> Picture {
    let sound = |shapes: &[Shape]| shapes.iter().filter(|shape| shape.validate("").is_ok()).cloned().collect();
    let sound: Vec<(LayerName, Vec<Shape>)> =
        regions.shapes.iter().map(|(layer, shapes)| (*layer, sound(shapes))).collect();
    let layers = || sound.iter().filter(|(_, shapes)| !shapes.is_empty());
    let mut legend: Vec<(Sign, String)> =
        layers().map(|(layer, _)| (Sign::Patch(tint(layer_ink(*layer))), layer_words(*layer).to_owned())).collect();
    if !regions.flow_lines.is_empty() {
        let lines = format!("{}: its flow lines", layer_words(LayerName::FlowFollowing));
        legend.push((Sign::Line(layer_ink(LayerName::FlowFollowing)), lines));
    }
    legend.extend(robot_legend(robot));
    let reach_m = robot.reach_m();
    let boxes = layers().flat_map(|(_, shapes)| shapes.iter().map(shape_box));
    let lines = regions
        .flow_lines
        .iter()
        .map(|lines| (Vector2::new(lines.x_m[0], lines.lateral_m[0]), Vector2::new(lines.x_m[1], lines.lateral_m[1])));
    let frame = Frame { titles: [title, "control regions from above"], right_px: 0, legend, axis_titles: true };
    let mut map = RobotMap::new(robot, joined(boxes.chain(lines), reach_m), &frame);
    let sight = Sight::new(robot);
    map.draw_sight(robot, &sight);
    for (layer, shapes) in layers() {
        draw_region(&mut map, shapes, layer_ink(*layer));
    }
    draw_flow_lines(&mut map, regions.flow_lines, reach_m);
    map.draw_robot(robot);
    map.picture
}

/// Draws the masks of one layer together: each sensor's cells in the robot frame, left of the x axis orange, right blue, the
/// darker the more sensors see them. `masks` may hold other layers too, which are left out.
#[must_use]
pub fn masks_together(title: &str, layer: LayerName, masks: &[&Mask], robot: &PlottedRobot) -> Picture {
    let cell_count = robot.grid.cell_count();
    let fits = |mask: &&&Mask| {
        mask.layer == layer && mask.sensor_index < robot.sensors.len() && mask.values.len() == cell_count
    };
    let masks: Vec<&Mask> = masks.iter().filter(fits).copied().collect();
    let sensors = |count: usize| format!("{count} sensor{}", if count == 1 { "" } else { "s" });
    let mut legend = Vec::new();
    for (colour, side) in [(LEFT, "left of the axis"), (RIGHT, "right of it")] {
        legend.extend(
            (1..=masks.len()).map(|count| (Sign::Patch(shade(colour, count)), format!("{side}, {}", sensors(count)))),
        );
    }
    legend.extend(robot_legend(robot));
    let second = format!("masks of {}: cells of all sensors in the robot frame", layer_words(layer));
    let frame = Frame { titles: [title, &second], right_px: 0, legend, axis_titles: true };
    let mut map = RobotMap::new(robot, mask_box(&masks, robot), &frame);
    let sight = Sight::new(robot);
    map.draw_sight(robot, &sight);
    map.paint(|_, point_m| {
        let side = |mask: &&Mask| sight.cells(mask.sensor_index, point_m).map(|(cell, _)| mask.values[cell]).next();
        let sides: Vec<i8> = masks.iter().filter_map(side).filter(|side| *side != 0).collect();
        let colour = if *sides.first()? > 0 { LEFT } else { RIGHT };
        Some((shade(colour, sides.len()), 1.0))
    });
    map.draw_robot(robot);
    map.picture
}

/// Colour of a place that `count` sensors see.
fn shade(colour: Rgb888, count: usize) -> Rgb888 {
    mixed(colour, [0.0, 0.35, 0.68, 1.0][count.min(3)])
}

fn tint(colour: Rgb888) -> Rgb888 {
    mixed(colour, TINT)
}

/// `colour` laid over the background.
fn mixed(colour: Rgb888, share: f64) -> Rgb888 {
    let mix = |below: u8, above: u8| (f64::from(below) + (f64::from(above) - f64::from(below)) * share).round() as u8;
    let below = BACKGROUND;
    Rgb888::new(mix(below.r(), colour.r()), mix(below.g(), colour.g()), mix(below.b(), colour.b()))
}

fn draw_region(map: &mut RobotMap, shapes: &[Shape], colour: Rgb888) {
    let (area, view) = (map.area, map.view);
    let (columns, rows) = (area.right - area.left + 1, area.bottom - area.top + 1);
    let inside: Vec<bool> = (0..columns * rows)
        .map(|index| {
            let point_m = view.point_m(area.left + index % columns, area.top + index / columns);
            shapes.iter().any(|shape| shape.contains(point_m))
        })
        .collect();
    let at = |x: i32, y: i32| {
        let index = y.clamp(0, rows - 1) * columns + x.clamp(0, columns - 1);
        inside[index as usize]
    };
    for y in 0..rows {
        for x in 0..columns {
            let near = [(1, 0), (-1, 0), (0, 1), (0, -1)];
            let edge = near.iter().any(|(right, down)| !at(x + right * OUTLINE_PX, y + down * OUTLINE_PX));
            if at(x, y) {
                map.picture.blend(area.left + x, area.top + y, colour, if edge { 1.0 } else { TINT });
            }
        }
    }
}

fn draw_flow_lines(map: &mut RobotMap, regions: &[FlowLinesRegion], reach_m: f64) {
    let sound = |region: &&FlowLinesRegion| region.validate("").is_ok();
    for region in regions.iter().filter(sound) {
        let x_m = region.x_m.map(|x_m| x_m.clamp(-reach_m, reach_m));
        for lateral_m in region.laterals_m().into_iter().filter(|lateral_m| lateral_m.abs() <= reach_m) {
            let ends = x_m.map(|x_m| map.view.place(Vector2::new(x_m, lateral_m)));
            map.picture.stroke(ends[0], ends[1], 1.2, layer_ink(LayerName::FlowFollowing));
        }
    }
}

/// Corners of a box about a shape; may be infinite.
fn shape_box(shape: &Shape) -> (Vector2<f64>, Vector2<f64>) {
    let disc = |centre_m: &[f64; 2], radius_m: f64| {
        let centre_m = Vector2::from(*centre_m);
        (centre_m.add_scalar(-radius_m), centre_m.add_scalar(radius_m))
    };
    match shape {
        Shape::Rectangle { x_m, y_m } => (Vector2::new(x_m[0], y_m[0]), Vector2::new(x_m[1], y_m[1])),
        Shape::Circle { centre_m, radius_m } | Shape::HalfCircle { centre_m, radius_m, .. } => {
            disc(centre_m, *radius_m)
        }
        Shape::Sector { centre_m, radius_m, .. } => disc(centre_m, radius_m[1]),
        Shape::Trapezoid { x_m, half_width_m } => {
            let half_m = half_width_m[0].max(half_width_m[1]);
            (Vector2::new(x_m[0], -half_m), Vector2::new(x_m[1], half_m))
        }
        Shape::Polygon { points_m } => points_m
            .iter()
            .map(|point| (Vector2::from(*point), Vector2::from(*point)))
            .fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |all, one| {
                (all.0.inf(&one.0), all.1.sup(&one.1))
            }),
    }
}

/// The box about all boxes, as far as the sensors hear.
fn joined(boxes: impl Iterator<Item = (Vector2<f64>, Vector2<f64>)>, reach_m: f64) -> (Vector2<f64>, Vector2<f64>) {
    let within = |value: f64| if value.is_nan() { 0.0 } else { value.clamp(-reach_m, reach_m) };
    boxes.fold((Vector2::zeros(), Vector2::zeros()), |all, one| {
        (all.0.inf(&one.0.map(within)), all.1.sup(&one.1.map(within)))
    })
}

/// The box about all cells of the masks.
fn mask_box(masks: &[&Mask], robot: &PlottedRobot) -> (Vector2<f64>, Vector2<f64>) {
    let points = masks.iter().flat_map(|mask| {
        let pose = robot.sensors[mask.sensor_index].mount.pose();
        let set = mask.values.iter().enumerate().filter(|(_, side)| **side != 0);
        set.map(move |(cell, _)| {
            let (direction, range) = robot.grid.direction_and_range(cell);
            let direction = robot.grid.directions()[direction];
            let unit = Vector2::new(direction.azimuth_rad.cos(), direction.azimuth_rad.sin());
            let point_m = pose.parent_from_local(unit * robot.grid.range_m(range) * direction.elevation_rad.cos());
            (point_m, point_m)
        })
    });
    joined(points, robot.reach_m())
}
