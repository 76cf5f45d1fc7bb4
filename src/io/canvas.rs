//! What every picture of this crate is drawn on: pixels, pens, text and the step from metres to pixels.
//!
//! Goes in: places and colours. Comes out: a [`Picture`] and its PNG. Text and plain lines are embedded-graphics'; wide
//! strokes and translucent areas are drawn here, because it has neither smooth edges nor transparency. Coordinates that are
//! not finite or far outside are left out, so no input can make it panic or run long. Knows nothing of robots.

use embedded_graphics::mono_font::iso_8859_7::{FONT_7X13, FONT_9X15, FONT_9X15_BOLD};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Line, PrimitiveStyle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use nalgebra::Vector2;
use std::convert::Infallible;
use std::path::Path;

pub(super) const BACKGROUND: Rgb888 = Rgb888::new(255, 255, 255);
pub(super) const INK: Rgb888 = Rgb888::new(60, 60, 60);
pub(super) const GRID_LINE: Rgb888 = Rgb888::new(150, 150, 150);

/// Text of captions, of scales, and of titles.
pub(super) const SMALL: &MonoFont<'static> = &FONT_7X13;
pub(super) const PLAIN: &MonoFont<'static> = &FONT_9X15;
pub(super) const BOLD: &MonoFont<'static> = &FONT_9X15_BOLD;

/// Places farther out than this are not drawn: no picture is as large, and arithmetic stays exact.
const FAR_PX: f64 = 1e7;

/// An RGB picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    width: u32,
    height: u32,
    pixels: Vec<Rgb888>,
}

impl Picture {
    pub(super) fn new(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![BACKGROUND; width as usize * height as usize] }
    }

    /// Width and height in pixels.
    #[must_use]
    pub fn size_px(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Colour of a pixel, (0, 0) at the top left; `None` outside.
    #[must_use]
    pub fn pixel(&self, x: i32, y: i32) -> Option<[u8; 3]> {
        self.index(x, y).map(|index| {
            let colour = self.pixels[index];
            [colour.r(), colour.g(), colour.b()]
        })
    }

    fn index(&self, x: i32, y: i32) -> Option<usize> {
        let inside = (0..self.width.cast_signed()).contains(&x) && (0..self.height.cast_signed()).contains(&y);
        inside.then(|| y as usize * self.width as usize + x as usize)
    }

    /// Draws a shape of embedded-graphics.
    pub(super) fn shape(&mut self, drawn: impl Drawable<Color = Rgb888>) {
        let Ok(_) = drawn.draw(self);
    }

    /// Draws a line one pixel wide.
    pub(super) fn line(&mut self, from: Point, to: Point, colour: Rgb888) {
        self.shape(Line::new(from, to).into_styled(PrimitiveStyle::with_stroke(colour, 1)));
    }

    /// Lays `colour` over a pixel; `share` 1 covers it, 0 leaves it.
    pub(super) fn blend(&mut self, x: i32, y: i32, colour: Rgb888, share: f64) {
        if let Some(index) = self.index(x, y) {
            let below = self.pixels[index];
            let mix = |below: u8, above: u8| {
                (f64::from(below) + (f64::from(above) - f64::from(below)) * share.clamp(0.0, 1.0)).round() as u8
            };
            self.pixels[index] =
                Rgb888::new(mix(below.r(), colour.r()), mix(below.g(), colour.g()), mix(below.b(), colour.b()));
        }
    }

    /// Lays `colour` over every pixel from `low` to `high` by the share that `cover` gives for its centre.
    pub(super) fn cover(
        &mut self,
        (low, high): (Vector2<f64>, Vector2<f64>),
        colour: Rgb888,
        cover: impl Fn(Vector2<f64>) -> f64,
    ) {
        let columns = (low.x.floor().max(0.0) as i32)..=(high.x.ceil().min(f64::from(self.width) - 1.0) as i32);
        for y in (low.y.floor().max(0.0) as i32)..=(high.y.ceil().min(f64::from(self.height) - 1.0) as i32) {
            for x in columns.clone() {
                let share = cover(Vector2::new(f64::from(x), f64::from(y)));
                if share > 0.0 {
                    self.blend(x, y, colour, share);
                }
            }
        }
    }

    /// A straight stroke with round ends.
    pub(super) fn stroke(&mut self, from: Vector2<f64>, to: Vector2<f64>, width_px: f64, colour: Rgb888) {
        if !(near(from) && near(to)) {
            return;
        }
        let (along, reach_px) = (to - from, 0.5 * width_px + 1.0);
        let (low, high) = (from.inf(&to).add_scalar(-reach_px), from.sup(&to).add_scalar(reach_px));
        self.cover((low, high), colour, |place| {
            let share = ((place - from).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
            (0.5 * width_px + 0.5 - (place - from - along * share).norm()).min(1.0)
        });
    }

    /// Strokes from place to place.
    pub(super) fn polyline(&mut self, places: &[Vector2<f64>], width_px: f64, colour: Rgb888) {
        for pair in places.windows(2) {
            self.stroke(pair[0], pair[1], width_px, colour);
        }
    }

    /// A stroke with a head at its end.
    pub(super) fn arrow(&mut self, from: Vector2<f64>, to: Vector2<f64>, width_px: f64, colour: Rgb888) {
        let length_px = (to - from).norm();
        if !(near(from) && near(to)) || length_px < 1e-9 {
            return;
        }
        let unit = (to - from) / length_px;
        let (back, across) = (unit * (4.0 + 2.5 * width_px), Vector2::new(-unit.y, unit.x) * (2.0 + 1.5 * width_px));
        self.stroke(from, to, width_px, colour);
        self.stroke(to, to - back + across, width_px, colour);
        self.stroke(to, to - back - across, width_px, colour);
    }

    /// Dashes from place to place, as long as the gaps are and a little more.
    pub(super) fn dashes(&mut self, places: &[Vector2<f64>], width_px: f64, colour: Rgb888) {
        const PERIOD_PX: f64 = 14.0;
        const DASH_PX: f64 = 8.0;
        let mut travelled_px = 0.0;
        for pair in places.windows(2) {
            let length_px = (pair[1] - pair[0]).norm();
            if !(near(pair[0]) && near(pair[1])) || length_px < 1e-9 {
                continue;
            }
            let unit = (pair[1] - pair[0]) / length_px;
            // Only what crosses the picture is walked along.
            let (first_px, last_px) = self.crossing(pair[0], unit, length_px);
            let mut at_px = ((travelled_px + first_px) / PERIOD_PX).floor() * PERIOD_PX - travelled_px;
            while at_px < last_px {
                let (dash_from_px, dash_to_px) = (at_px.max(0.0), (at_px + DASH_PX).min(length_px));
                if dash_from_px < dash_to_px {
                    self.stroke(pair[0] + unit * dash_from_px, pair[0] + unit * dash_to_px, width_px, colour);
                }
                at_px += PERIOD_PX;
            }
            travelled_px += length_px;
        }
    }

    /// First and last distance from `from` along `unit`, within `length_px`, that can lie on the picture.
    fn crossing(&self, from: Vector2<f64>, unit: Vector2<f64>, length_px: f64) -> (f64, f64) {
        let middle = Vector2::new(f64::from(self.width), f64::from(self.height)) * 0.5;
        let nearest_px = (middle - from).dot(&unit);
        ((nearest_px - middle.norm()).max(0.0), (nearest_px + middle.norm()).min(length_px))
    }

    /// A filled disc.
    pub(super) fn disc(&mut self, centre: Vector2<f64>, radius_px: f64, colour: Rgb888) {
        if near(centre) && radius_px < FAR_PX {
            let reach = Vector2::repeat(radius_px + 1.0);
            let share = |place: Vector2<f64>| (radius_px + 0.5 - (place - centre).norm()).min(1.0);
            self.cover((centre - reach, centre + reach), colour, share);
        }
    }

    /// The line of a circle.
    pub(super) fn ring(&mut self, centre: Vector2<f64>, radius_px: f64, width_px: f64, colour: Rgb888) {
        if near(centre) && radius_px < FAR_PX {
            let reach = Vector2::repeat(radius_px + width_px + 1.0);
            let share =
                |place: Vector2<f64>| (0.5 * width_px + 0.5 - ((place - centre).norm() - radius_px).abs()).min(1.0);
            self.cover((centre - reach, centre + reach), colour, share);
        }
    }

    /// A filled rectangle, edges included.
    pub(super) fn block(&mut self, low: Vector2<f64>, high: Vector2<f64>, colour: Rgb888) {
        if near(low) && near(high) {
            self.cover((low, high), colour, |_| 1.0);
        }
    }

    /// Small text whose baseline begins, is centred or ends at a point.
    pub(super) fn label(&mut self, text: &str, at: Point, alignment: Alignment) {
        self.shape(Text::with_alignment(text, at, MonoTextStyle::new(SMALL, INK), alignment));
    }

    /// Text whose middle height is at a point.
    pub(super) fn write(
        &mut self,
        text: &str,
        at: Point,
        alignment: Alignment,
        (font, colour): (&MonoFont<'_>, Rgb888),
    ) {
        let style = TextStyleBuilder::new().alignment(alignment).baseline(Baseline::Middle).build();
        self.shape(Text::with_text_style(text, at, MonoTextStyle::new(font, colour), style));
    }

    /// Text that reads from bottom to top, its middle at a point.
    pub(super) fn write_upward(&mut self, text: &str, at: Point, font: &MonoFont<'_>) {
        let (width, height) = (text_width_px(text, font), font.character_size.height.cast_signed());
        let mut flat = Picture::new(width as u32, height as u32);
        flat.write(text, Point::new(0, height / 2), Alignment::Left, (font, INK));
        for y in 0..height {
            for x in 0..width {
                let turned = Point::new(at.x - height / 2 + y, at.y + width / 2 - x);
                if let Some(colour) = flat.index(x, y).map(|index| flat.pixels[index]).filter(|c| *c != BACKGROUND) {
                    self.shape(Pixel(turned, colour));
                }
            }
        }
    }

    /// Copies a picture so that its top left pixel is at `at`.
    pub(super) fn paste(&mut self, picture: &Picture, at: Point) {
        for y in 0..picture.height.cast_signed() {
            for x in 0..picture.width.cast_signed() {
                if let Some(index) = picture.index(x, y) {
                    self.shape(Pixel(Point::new(at.x + x, at.y + y), picture.pixels[index]));
                }
            }
        }
    }
}

fn near(place: Vector2<f64>) -> bool {
    place.x.abs() < FAR_PX && place.y.abs() < FAR_PX
}

/// Width of a text in pixels.
pub(super) fn text_width_px(text: &str, font: &MonoFont<'_>) -> i32 {
    let advance = font.character_size.width.cast_signed() + font.character_spacing.cast_signed();
    i32::try_from(text.chars().count()).unwrap_or(0).saturating_mul(advance)
}

/// The text, cut with two dots where it would be wider than `width_px`.
pub(super) fn fitted(text: &str, width_px: i32, font: &MonoFont<'_>) -> String {
    if text_width_px(text, font) <= width_px {
        return text.to_owned();
    }
    let count = (width_px / text_width_px("x", font).max(1)).max(2) as usize;
    text.chars().take(count - 2).chain("..".chars()).collect()
}

impl OriginDimensions for Picture {
    fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }
}

impl DrawTarget for Picture {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(point, colour) in pixels {
            if let Some(index) = self.index(point.x, point.y) {
                self.pixels[index] = colour;
            }
        }
        Ok(())
    }
}

/// Writes a PNG.
///
/// # Errors
/// What the file system or the encoder says.
pub fn write_png(path: &Path, picture: &Picture) -> std::io::Result<()> {
    encode_png(std::io::BufWriter::new(std::fs::File::create(path)?), picture)
}

/// Writes a PNG to wherever its bytes are to go.
///
/// # Errors
/// What the writer or the encoder says.
pub fn encode_png(to: impl std::io::Write, picture: &Picture) -> std::io::Result<()> {
    let mut encoder = png::Encoder::new(to, picture.width, picture.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    let bytes: Vec<u8> = picture.pixels.iter().flat_map(|colour| [colour.r(), colour.g(), colour.b()]).collect();
    writer.write_image_data(&bytes)?;
    Ok(writer.finish()?)
}

/// Metres to pixels and back. A pixel's centre is at whole numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    origin: Vector2<f64>,
    /// Where a metre along x and along y leads to, in pixels; at right angles.
    axes: [Vector2<f64>; 2],
    pixels_per_m: f64,
}

impl View {
    /// The robot seen from above: the frame's origin at `origin`, x up, y to the left.
    pub(super) fn robot(origin: Point, pixels_per_m: f64) -> Self {
        Self::robot_at(Vector2::new(f64::from(origin.x), f64::from(origin.y)), pixels_per_m)
    }

    /// As [`View::robot`], the origin anywhere between pixels.
    pub(super) fn robot_at(origin: Vector2<f64>, pixels_per_m: f64) -> Self {
        let axes = [Vector2::new(0.0, -pixels_per_m), Vector2::new(-pixels_per_m, 0.0)];
        Self { origin, axes, pixels_per_m }
    }

    /// A map: `corner_m` at `corner`, x to the right, y up.
    pub(super) fn map(corner: Point, corner_m: Vector2<f64>, pixels_per_m: f64) -> Self {
        let axes = [Vector2::new(pixels_per_m, 0.0), Vector2::new(0.0, -pixels_per_m)];
        let corner = Vector2::new(f64::from(corner.x), f64::from(corner.y));
        Self { origin: corner - axes[0] * corner_m.x - axes[1] * corner_m.y, axes, pixels_per_m }
    }

    pub(super) fn pixels_per_m(&self) -> f64 {
        self.pixels_per_m
    }

    pub(super) fn place(&self, point_m: Vector2<f64>) -> Vector2<f64> {
        self.origin + self.axes[0] * point_m.x + self.axes[1] * point_m.y
    }

    pub(super) fn pixel(&self, point_m: Vector2<f64>) -> Point {
        let place = self.place(point_m);
        Point::new(place.x.round() as i32, place.y.round() as i32)
    }

    pub(super) fn point_m(&self, x: i32, y: i32) -> Vector2<f64> {
        let offset = Vector2::new(f64::from(x), f64::from(y)) - self.origin;
        let scale = self.pixels_per_m * self.pixels_per_m;
        Vector2::new(offset.dot(&self.axes[0]), offset.dot(&self.axes[1])) / scale
    }
}
