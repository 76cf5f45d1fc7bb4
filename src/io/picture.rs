//! Pictures of energyscapes and masks, seen from above: forward is up, left is left. For people; nothing reads them back.
//!
//! In: an image or mask on its grid. Out: an RGB picture and its PNG. Never scales data, only colours.

pub use super::canvas::{Picture, write_png};

use super::canvas::{GRID_LINE, INK, View};
use super::polar::Azimuths;
use crate::sensor::SensorSetup;
use crate::signal::{Energyscape, Mask, PolarGrid};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, PrimitiveStyle};
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

const SEEN: Rgb888 = Rgb888::new(244, 244, 240);
pub(super) const LEFT: Rgb888 = Rgb888::new(230, 126, 34);
pub(super) const RIGHT: Rgb888 = Rgb888::new(41, 121, 185);
/// Decibels between the brightest and the darkest colour.
pub(super) const DYNAMIC_RANGE_DB: f64 = 50.0;
pub(super) const MARGIN_PX: i32 = 36;

/// Draws an energyscape from above, sensor at the bottom, in decibels of full scale with a colour bar.
#[must_use]
pub fn render_energyscape(energyscape: &Energyscape) -> Picture {
    let (radius_px, bar_px) = (400, 80);
    let mut picture = Picture::new((2 * (radius_px + MARGIN_PX) + bar_px) as u32, (radius_px + 2 * MARGIN_PX) as u32);
    let top_db = top_db([energyscape]);
    picture.paste(&fan(radius_px, energyscape, top_db), Point::new(0, 0));
    colour_bar(&mut picture, 2 * (radius_px + MARGIN_PX), radius_px, top_db);
    picture
}

/// The upper end of a scale that holds the loudest cell of all.
pub(super) fn top_db<'a>(energyscapes: impl IntoIterator<Item = &'a Energyscape>) -> f64 {
    let peak = energyscapes.into_iter().map(|energyscape| f64::from(energyscape.peak().1)).fold(1e-9, f64::max);
    (decibels(peak.min(1e9)) / 5.0).ceil() * 5.0
}

/// An energyscape's half disc with its rings and numbers, a picture of [`fan_size_px`].
pub(super) fn fan(radius_px: i32, energyscape: &Energyscape, top_db: f64) -> Picture {
    let grid = &energyscape.grid;
    let range_max_m = grid.range_m(grid.range_count() - 1);
    let (width, height) = fan_size_px(radius_px);
    let mut picture = Picture::new(width as u32, height as u32);
    let origin = Point::new(radius_px + MARGIN_PX, radius_px + MARGIN_PX);
    let view = View::robot(origin, f64::from(radius_px) / range_max_m);
    let azimuths = Azimuths::new(grid);
    for y in 0..=origin.y {
        for x in 0..width {
            let values = azimuths.cells(grid, view.point_m(x, y)).map(|cell| energyscape.values[cell]);
            if let Some(value) = values.reduce(f32::max) {
                let colour = heat((decibels(f64::from(value)) - top_db) / DYNAMIC_RANGE_DB + 1.0);
                picture.shape(Pixel(Point::new(x, y), colour));
            }
        }
    }
    half_rings(&mut picture, &view, range_max_m);
    for degrees in [-60, -30, 0, 30, 60] {
        let bearing_rad = f64::from(degrees).to_radians();
        let at = view.pixel(Vector2::new(bearing_rad.cos(), bearing_rad.sin()) * (range_max_m * 1.045));
        picture.label(&format!("{degrees}"), at, Alignment::Center);
    }
    picture
}

/// Width and height that a half disc takes with its numbers.
pub(super) fn fan_size_px(radius_px: i32) -> (i32, i32) {
    (2 * (radius_px + MARGIN_PX), radius_px + 2 * MARGIN_PX)
}

/// Draws a mask over the robot, from above: left of its x axis orange, right blue, seen cells outside the region pale.
#[must_use]
pub fn render_mask(mask: &Mask, grid: &PolarGrid, sensor: &SensorSetup) -> Picture {
    let pose = sensor.mount.pose();
    let reach_m = pose.position_m().norm() + grid.range_m(grid.range_count() - 1);
    let radius_px = 300;
    let side_px = 2 * (radius_px + MARGIN_PX);
    let mut picture = Picture::new(side_px as u32, side_px as u32);
    let origin = Point::new(radius_px + MARGIN_PX, radius_px + MARGIN_PX);
    let view = View::robot(origin, f64::from(radius_px) / reach_m);
    let azimuths = Azimuths::new(grid);
    for y in 0..side_px {
        for x in 0..side_px {
            let mut cells = azimuths.cells(grid, pose.local_from_parent(view.point_m(x, y)));
            if let Some(cell) = cells.next() {
                let colour = match mask.values[cell] {
                    0 => SEEN,
                    side if side > 0 => LEFT,
                    _ => RIGHT,
                };
                picture.shape(Pixel(Point::new(x, y), colour));
            }
        }
    }
    range_rings(&mut picture, &view, reach_m);
    let place = view.pixel(pose.position_m());
    picture.shape(Circle::with_center(place, 9).into_styled(PrimitiveStyle::with_fill(INK)));
    let nose = pose.parent_from_local(Vector2::new(reach_m * 0.06, 0.0));
    picture.line(place, view.pixel(nose), INK);
    picture.line(origin, view.pixel(Vector2::new(reach_m * 0.1, 0.0)), INK);
    let title = format!("{} of {}: left orange, right blue, robot looks up", mask.layer.as_str(), sensor.name);
    picture.label(&title, Point::new(8, 16), Alignment::Left);
    picture
}

/// Rings of round ranges about the origin and their numbers to its right.
fn range_rings(picture: &mut Picture, view: &View, reach_m: f64) {
    for ring_m in ring_radii_m(reach_m) {
        let diameter = (2.0 * ring_m * view.pixels_per_m()).round() as u32;
        let ring = Circle::with_center(view.pixel(Vector2::zeros()), diameter);
        picture.shape(ring.into_styled(PrimitiveStyle::with_stroke(GRID_LINE, 1)));
        range_number(picture, view, ring_m);
    }
}

/// The upper halves of the same rings: below there is nothing that they could measure.
fn half_rings(picture: &mut Picture, view: &View, reach_m: f64) {
    for ring_m in ring_radii_m(reach_m) {
        let radius_px = ring_m * view.pixels_per_m();
        let (centre, reach) = (view.place(Vector2::zeros()), Vector2::new(radius_px + 1.0, radius_px + 1.0));
        let on_ring = |place: Vector2<f64>| f64::from(u8::from(((place - centre).norm() - radius_px).abs() <= 0.5));
        picture.cover((centre - reach, centre + Vector2::new(reach.x, 0.0)), GRID_LINE, on_ring);
        range_number(picture, view, ring_m);
    }
}

fn range_number(picture: &mut Picture, view: &View, ring_m: f64) {
    let at = view.pixel(Vector2::new(0.0, -ring_m));
    picture.label(&format!("{ring_m} m"), at + Point::new(0, 14), Alignment::Center);
}

fn ring_radii_m(reach_m: f64) -> impl Iterator<Item = f64> {
    let step_m = [0.5, 1.0, 2.0, 5.0, 10.0].into_iter().find(|step| reach_m / step <= 6.0).unwrap_or(20.0);
    (1..=(reach_m / step_m).clamp(0.0, 100.0) as u32).map(move |index| f64::from(index) * step_m)
}

pub(super) fn colour_bar(picture: &mut Picture, left: i32, height: i32, top_db: f64) {
    for y in 0..height {
        let colour = heat(1.0 - f64::from(y) / f64::from(height));
        picture.line(Point::new(left, MARGIN_PX + y), Point::new(left + 16, MARGIN_PX + y), colour);
    }
    for step in 0..=5 {
        let share = f64::from(step) / 5.0;
        let y = MARGIN_PX + (share * f64::from(height)) as i32;
        let text = format!("{:.0}", top_db - share * DYNAMIC_RANGE_DB);
        picture.label(&text, Point::new(left + 20, y + 4), Alignment::Left);
    }
    picture.label("dBFS", Point::new(left, MARGIN_PX - 12), Alignment::Left);
}

pub(super) fn decibels(amplitude: f64) -> f64 {
    20.0 * amplitude.max(1e-12).log10()
}

pub(super) fn heat(share: f64) -> Rgb888 {
    let colour = colorous::INFERNO.eval_continuous(share.clamp(0.0, 1.0));
    Rgb888::new(colour.r, colour.g, colour.b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Direction;
    use std::sync::Arc;

    fn grid() -> Arc<PolarGrid> {
        let directions = (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect();
        Arc::new(PolarGrid::new(directions, 0.3, 0.05, 95))
    }

    #[test]
    fn an_echo_ahead_on_the_left_is_drawn_up_and_left() {
        let mut energyscape = Energyscape::zeros(grid(), 0);
        let cell = energyscape.grid.cell(120, 48); // +30.5 deg, 2.7 m: between the range rings
        energyscape.values[cell] = 0.1;
        let picture = render_energyscape(&energyscape);
        let (radius_px, range_max_m) = (400.0, energyscape.grid.range_m(94));
        let bearing_rad = 30.5_f64.to_radians();
        let x = 436.0 - 2.7 * bearing_rad.sin() * radius_px / range_max_m;
        let y = 436.0 - 2.7 * bearing_rad.cos() * radius_px / range_max_m;
        let bright = |x: f64, y: f64| picture.pixel(x as i32, y as i32).map_or(0, |pixel| u32::from(pixel[0]));
        assert!(bright(x, y) > 200, "{}", bright(x, y));
        assert!(bright(872.0 - x, y) < 100, "the mirrored place is dark");
    }
}
