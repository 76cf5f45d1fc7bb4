//! What stands around a plot: axes with ticks, legends, colour bars. Numbers in, ink out; knows nothing of what is plotted.

use crate::io::canvas::{BACKGROUND, BOLD, INK, PLAIN, Picture, SMALL, fitted, text_width_px};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Rectangle};
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

/// Height of a row of a legend.
pub(super) const LEGEND_ROW_PX: i32 = 26;
/// Room for the sign before a legend's words.
const SIGN_PX: i32 = 34;
/// Room after them.
const GAP_PX: i32 = 22;
/// What no sensor sees.
pub(super) const UNSEEN: Rgb888 = Rgb888::new(222, 222, 222);
/// What one sensor's housing hides from another.
pub(super) const HIDDEN: Rgb888 = Rgb888::new(140, 140, 140);
const CONTACT: Rgb888 = Rgb888::new(214, 0, 0);
pub(super) const WAYPOINT: Rgb888 = Rgb888::new(20, 70, 220);

/// A sign of a legend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Sign {
    Line(Rgb888),
    Dashes(Rgb888),
    Disc(Rgb888),
    Patch(Rgb888),
    Hatch,
    Sensor,
    Frame(Rgb888),
    Waypoint,
    Contact,
    Start,
    End,
}

impl Sign {
    /// Draws the sign about a place.
    pub(super) fn draw(self, picture: &mut Picture, at: Vector2<f64>) {
        let half = Vector2::new(12.0, 0.0);
        match self {
            Sign::Line(colour) => picture.stroke(at - half, at + half, 3.0, colour),
            Sign::Dashes(colour) => picture.dashes(&[at - half * 1.2, at + half], 2.0, colour),
            Sign::Disc(colour) => picture.disc(at, 7.0, colour),
            Sign::Patch(colour) => picture.block(at - Vector2::new(10.0, 7.0), at + Vector2::new(10.0, 7.0), colour),
            Sign::Hatch => {
                let reach = Vector2::new(10.0, 7.0);
                picture
                    .cover((at - reach, at + reach), HIDDEN, |place| f64::from(u8::from(hatched(rounded(place), 0))));
            }
            Sign::Sensor => {
                picture.block(at - Vector2::new(12.0, 5.0), at - Vector2::new(7.0, -5.0), INK);
                picture.arrow(at - Vector2::new(7.0, 0.0), at + half, 1.6, INK);
            }
            Sign::Frame(colour) => {
                dashed_frame(picture, at - Vector2::new(12.0, 8.0), at + Vector2::new(12.0, 8.0), colour)
            }
            Sign::Waypoint => waypoint(picture, at, "1"),
            Sign::Contact => contact(picture, at),
            Sign::Start => start(picture, at),
            Sign::End => end(picture, at),
        }
    }
}

/// Whether a pixel belongs to the hatching of a sensor's hidden bearings: each sensor has a slope of its own.
pub(super) fn hatched(at: Point, sensor_index: usize) -> bool {
    let across = match sensor_index % 3 {
        0 => at.x + at.y,
        1 => at.x - at.y,
        _ => at.x,
    };
    across.rem_euclid(8) < 2
}

pub(super) fn dashed_frame(picture: &mut Picture, low: Vector2<f64>, high: Vector2<f64>, colour: Rgb888) {
    let corner = Vector2::new;
    let corners = [low, corner(high.x, low.y), high, corner(low.x, high.y), low];
    picture.dashes(&corners, 2.0, colour);
}

/// A numbered blue circle.
pub(super) fn waypoint(picture: &mut Picture, at: Vector2<f64>, number: &str) {
    picture.disc(at, 12.5, BACKGROUND);
    picture.disc(at, 11.0, WAYPOINT);
    picture.write(number, rounded(at) + Point::new(0, -1), Alignment::Center, (PLAIN, BACKGROUND));
}

/// A red cross on white, to be seen on any colour.
pub(super) fn contact(picture: &mut Picture, at: Vector2<f64>) {
    for (width_px, colour) in [(7.0, BACKGROUND), (3.5, CONTACT)] {
        for across in [Vector2::new(7.0, 7.0), Vector2::new(7.0, -7.0)] {
            picture.stroke(at - across, at + across, width_px, colour);
        }
    }
}

/// An open circle.
pub(super) fn start(picture: &mut Picture, at: Vector2<f64>) {
    picture.disc(at, 5.5, INK);
    picture.disc(at, 3.5, BACKGROUND);
}

/// A full square.
pub(super) fn end(picture: &mut Picture, at: Vector2<f64>) {
    let half = Vector2::new(5.0, 5.0);
    picture.block(at - half - Vector2::new(1.0, 1.0), at + half + Vector2::new(1.0, 1.0), BACKGROUND);
    picture.block(at - half, at + half, INK);
}

pub(super) fn rounded(place: Vector2<f64>) -> Point {
    Point::new(place.x.round() as i32, place.y.round() as i32)
}

/// Places of a legend's entries within a width, row by row, and the number of rows.
fn legend_places(entries: &[(Sign, String)], width_px: i32) -> (Vec<Point>, i32) {
    let (mut x, mut row) = (0, 0);
    let mut places = Vec::new();
    for (_, words) in entries {
        let entry_px = SIGN_PX + text_width_px(words, PLAIN);
        if x > 0 && x + entry_px > width_px {
            (x, row) = (0, row + 1);
        }
        places.push(Point::new(x, row * LEGEND_ROW_PX));
        x += entry_px + GAP_PX;
    }
    (places, if entries.is_empty() { 0 } else { row + 1 })
}

/// Height that a legend takes.
pub(super) fn legend_height_px(entries: &[(Sign, String)], width_px: i32) -> i32 {
    legend_places(entries, width_px).1 * LEGEND_ROW_PX
}

/// Draws a legend from its top left corner on.
pub(super) fn legend(picture: &mut Picture, entries: &[(Sign, String)], corner: Point, width_px: i32) {
    for ((sign, words), place) in entries.iter().zip(legend_places(entries, width_px).0) {
        let middle = corner + place + Point::new(0, LEGEND_ROW_PX / 2);
        sign.draw(picture, Vector2::new(f64::from(middle.x + 14), f64::from(middle.y)));
        picture.write(words, middle + Point::new(SIGN_PX, 0), Alignment::Left, (PLAIN, INK));
    }
}

/// Round numbers within an interval, about `count` of them, and how many decimals they have.
pub(super) fn ticks(low: f64, high: f64, count: f64) -> (Vec<f64>, usize) {
    let rough = (high - low) / count.max(1.0);
    if !(rough.is_finite() && rough > 0.0) {
        return (Vec::new(), 0);
    }
    let magnitude = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0].into_iter().map(|part| part * magnitude).find(|step| *step >= rough * 0.999);
    let step = step.unwrap_or(10.0 * magnitude);
    let (first, last) = ((low / step - 1e-6).ceil(), (high / step + 1e-6).floor());
    let inside = (0..=(last - first).clamp(0.0, 1000.0) as usize).map(|index| (first + index as f64) * step);
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    (inside.filter(|value| *value <= high + 1e-6 * step).collect(), decimals)
}

/// The box with some room about it, and grown so that it is at least `least` of its longer side in x and y.
pub(super) fn bordered(low: Vector2<f64>, high: Vector2<f64>, least: Vector2<f64>) -> (Vector2<f64>, Vector2<f64>) {
    const BORDER_SHARE: f64 = 0.025;
    let long = (high - low).max().max(0.1);
    let missing = (least * long - (high - low)).sup(&Vector2::zeros()) * 0.5 + Vector2::repeat(BORDER_SHARE * long);
    (low - missing, high + missing)
}

/// A number without the sign of a zero.
pub(super) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').to_owned() } else { text }
}

/// Round numbers along an axis from `low` to `high` of `length_px` pixels, with their places from 0 to 1.
pub(super) fn axis_ticks(low: f64, high: f64, length_px: i32) -> Vec<(f64, String)> {
    let (values, decimals) = ticks(low, high, (f64::from(length_px) / 70.0).max(2.0));
    values.into_iter().map(|value| ((value - low) / (high - low), number(value, decimals))).collect()
}

/// A rectangle of pixels, edges included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Area {
    pub(super) left: i32,
    pub(super) top: i32,
    pub(super) right: i32,
    pub(super) bottom: i32,
}

impl Area {
    pub(super) fn frame(&self, picture: &mut Picture) {
        let (low, high) = (Point::new(self.left, self.top), Point::new(self.right, self.bottom));
        picture.shape(Rectangle::with_corners(low, high).into_styled(PrimitiveStyle::with_stroke(INK, 1)));
    }

    /// Ticks and numbers below the area: `ticks` are places between its left (0) and right (1) edge.
    pub(super) fn axis_below(&self, picture: &mut Picture, ticks: &[(f64, String)], title: &str) {
        for (share, text) in ticks {
            let x = self.left + (share * f64::from(self.right - self.left)).round() as i32;
            picture.line(Point::new(x, self.bottom), Point::new(x, self.bottom + 6), INK);
            picture.write(text, Point::new(x, self.bottom + 17), Alignment::Center, (PLAIN, INK));
        }
        let middle = Point::new((self.left + self.right) / 2, self.bottom + 40);
        picture.write(title, middle, Alignment::Center, (PLAIN, INK));
    }

    /// Ticks and numbers to the left of the area: `ticks` are places between its bottom (0) and top (1) edge.
    pub(super) fn axis_left(&self, picture: &mut Picture, ticks: &[(f64, String)], title: &str) {
        for (share, text) in ticks {
            let y = self.bottom - (share * f64::from(self.bottom - self.top)).round() as i32;
            picture.line(Point::new(self.left - 6, y), Point::new(self.left, y), INK);
            picture.write(text, Point::new(self.left - 10, y), Alignment::Right, (PLAIN, INK));
        }
        picture.write_upward(title, Point::new(self.left - 62, (self.top + self.bottom) / 2), PLAIN);
    }

    /// Fills the area with colours from bottom (0) to top (1), with numbers to its right and a title above.
    pub(super) fn colour_bar(
        &self,
        picture: &mut Picture,
        colour: impl Fn(f64) -> Rgb888,
        ticks: &[(f64, String)],
        title: &[&str],
    ) {
        let height = f64::from((self.bottom - self.top).max(1));
        for y in self.top..=self.bottom {
            let share = f64::from(self.bottom - y) / height;
            picture.line(Point::new(self.left, y), Point::new(self.right, y), colour(share));
        }
        self.frame(picture);
        for (share, text) in ticks {
            let y = self.bottom - (share * height).round() as i32;
            picture.line(Point::new(self.right, y), Point::new(self.right + 5, y), INK);
            picture.write(text, Point::new(self.right + 9, y), Alignment::Left, (PLAIN, INK));
        }
        for (index, line) in title.iter().enumerate() {
            let up = 14 * (title.len() - index) as i32 + 4;
            picture.write(line, Point::new(self.left, self.top - up), Alignment::Left, (SMALL, INK));
        }
    }
}

/// What stands around a plot.
pub(super) struct Frame<'a> {
    /// Two lines above it.
    pub(super) titles: [&'a str; 2],
    /// Room to the right of it.
    pub(super) right_px: i32,
    /// Signs below it.
    pub(super) legend: Vec<(Sign, String)>,
    /// Whether the axes are named and the legend is shown.
    pub(super) axis_titles: bool,
}

impl Frame<'_> {
    /// A picture with titles and legend, and the area of `width` by `height` pixels that is left for the plot.
    pub(super) fn sheet(&self, width: i32, height: i32) -> (Picture, Area) {
        let left = if self.axis_titles { 84 } else { 58 };
        let below = if self.axis_titles { 56 } else { 30 };
        let top = 14 + 22 * self.titles.iter().filter(|line| !line.is_empty()).count() as i32;
        let shown: &[_] = if self.axis_titles { &self.legend } else { &[] };
        let picture_width = left + width + 24 + self.right_px;
        let legend_width = picture_width - left - 24;
        let picture_height = top + height + below + legend_height_px(shown, legend_width) + 8;
        let mut picture = Picture::new(picture_width as u32, picture_height as u32);
        for (index, line) in self.titles.iter().filter(|line| !line.is_empty()).enumerate() {
            let font = if index == 0 { BOLD } else { PLAIN };
            let line = fitted(line, picture_width - left - 8, font);
            picture.write(&line, Point::new(left, 18 + 22 * index as i32), Alignment::Left, (font, INK));
        }
        legend(&mut picture, shown, Point::new(left, top + height + below), legend_width);
        (picture, Area { left, top, right: left + width, bottom: top + height })
    }
}

/// Pictures row by row under two titles, a legend below.
pub(super) fn tiled(pictures: &[Picture], columns: usize, titles: [&str; 2], entries: &[(Sign, String)]) -> Picture {
    let size = |pick: fn((u32, u32)) -> u32| pictures.iter().map(|picture| pick(picture.size_px())).max().unwrap_or(0);
    let (cell_width, cell_height) = (size(|size| size.0).cast_signed(), size(|size| size.1).cast_signed());
    let rows = pictures.len().div_ceil(columns.max(1)) as i32;
    let (left, top) = (20, 60);
    let width = (cell_width * columns as i32).max(640) + left;
    let legend_px = legend_height_px(entries, width - 2 * left);
    let height = top + cell_height * rows + legend_px + LEGEND_ROW_PX / 2;
    let mut sheet = Picture::new(width as u32, height as u32);
    for (index, (line, font)) in titles.into_iter().zip([BOLD, PLAIN]).enumerate() {
        let line = fitted(line, width - 2 * left, font);
        sheet.write(&line, Point::new(left, 18 + 22 * index as i32), Alignment::Left, (font, INK));
    }
    for (index, picture) in pictures.iter().enumerate() {
        let (row, column) = ((index / columns) as i32, (index % columns) as i32);
        sheet.paste(picture, Point::new(column * cell_width, top + row * cell_height));
    }
    legend(&mut sheet, entries, Point::new(left, top + cell_height * rows), width - 2 * left);
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_include_both_ends() {
        let (values, decimals) = ticks(0.0, 10.0, 10.0);
        assert_eq!((values.len(), decimals, values[10]), (11, 0, 10.0));
        let (values, decimals) = ticks(-0.55, 0.55, 8.0);
        assert_eq!((values.len(), decimals), (5, 1), "{values:?}");
        assert_eq!(number(values[2], decimals), "0.0");
    }

    #[test]
    fn an_interval_without_length_has_no_ticks() {
        for (low, high) in [(1.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY), (2.0, 1.0)] {
            assert!(ticks(low, high, 8.0).0.is_empty());
        }
    }
}
