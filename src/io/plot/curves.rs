//! Curves on doubly logarithmic paper, a panel each: what was measured, and what would follow from the first point.

use super::chrome::{self, Frame, Sign};
use crate::io::canvas::{GRID_LINE, Picture};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use nalgebra::Vector2;

const MEASURED: Rgb888 = Rgb888::new(0, 114, 178);
const EXPECTED: Rgb888 = Rgb888::new(213, 94, 0);
/// Pixels of a panel's plot.
const WIDTH_PX: i32 = 420;
const HEIGHT_PX: i32 = 300;

/// A point of both curves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// Place along the horizontal axis.
    pub x: f64,
    /// Height of the curve that was measured.
    pub measured: f64,
    /// Height of the curve that it is compared with.
    pub expected: f64,
}

/// One panel.
#[derive(Debug, Clone, PartialEq)]
pub struct CurvePanel {
    /// What is varied.
    pub x_title: String,
    /// From left to right. Points that are not above zero are left out.
    pub points: Vec<CurvePoint>,
}

/// Draws all panels with one vertical axis, so that heights can be compared; `names` are those of the two curves.
#[must_use]
pub fn curves(panels: &[CurvePanel], titles: [&str; 2], y_title: &str, names: [&str; 2]) -> Picture {
    let drawable =
        |point: &CurvePoint| [point.x, point.measured, point.expected].iter().all(|v| v.is_finite() && *v > 0.0);
    let kept: Vec<(&str, Vec<CurvePoint>)> = panels
        .iter()
        .map(|panel| (panel.x_title.as_str(), panel.points.iter().copied().filter(drawable).collect()))
        .collect();
    let heights = || kept.iter().flat_map(|(_, points)| points).flat_map(|point| [point.measured, point.expected]);
    let (low, high) = (heights().fold(f64::INFINITY, f64::min), heights().fold(0.0, f64::max));
    let (low, high) = if high > 0.0 { (low / 1.3, high * 1.3) } else { (0.1, 10.0) };
    let drawn: Vec<Picture> = kept.iter().map(|(title, points)| panel(title, points, (low, high), y_title)).collect();
    let legend = [(Sign::Line(MEASURED), names[0].to_owned()), (Sign::Dashes(EXPECTED), names[1].to_owned())];
    chrome::tiled(&drawn, 3, titles, &legend)
}

fn panel(x_title: &str, points: &[CurvePoint], (low, high): (f64, f64), y_title: &str) -> Picture {
    let frame = Frame { titles: ["", ""], right_px: 0, legend: Vec::new(), axis_titles: true };
    let (mut picture, area) = frame.sheet(WIDTH_PX, HEIGHT_PX);
    let (first, last) = (points.first().map_or(1.0, |p| p.x / 1.2), points.last().map_or(10.0, |p| p.x * 1.2));
    let share = |value: f64, low: f64, high: f64| (value / low).ln() / (high / low).ln();
    let place = |x: f64, y: f64| {
        let (across, up) = (share(x, first, last), share(y, low, high));
        Vector2::new(
            f64::from(area.left) + across * f64::from(area.right - area.left),
            f64::from(area.bottom) - up * f64::from(area.bottom - area.top),
        )
    };
    let ups: Vec<(f64, String)> =
        decades(low, high).into_iter().map(|value| (share(value, low, high), format!("{value}"))).collect();
    for (up, _) in &ups {
        let y = area.bottom - (up * f64::from(area.bottom - area.top)).round() as i32;
        picture.line(Point::new(area.left, y), Point::new(area.right, y), GRID_LINE);
    }
    let across: Vec<(f64, String)> =
        points.iter().map(|point| (share(point.x, first, last), format!("{}", point.x))).collect();
    area.frame(&mut picture);
    area.axis_below(&mut picture, &apart(across), x_title);
    area.axis_left(&mut picture, &ups, y_title);
    let curve = |height: fn(&CurvePoint) -> f64| -> Vec<Vector2<f64>> {
        points.iter().map(|point| place(point.x, height(point))).collect()
    };
    picture.dashes(&curve(|point| point.expected), 2.0, EXPECTED);
    let measured = curve(|point| point.measured);
    picture.polyline(&measured, 2.5, MEASURED);
    measured.iter().for_each(|at| picture.disc(*at, 4.5, MEASURED));
    picture
}

/// 1, 2 and 5 of every power of ten within an interval.
fn decades(low: f64, high: f64) -> Vec<f64> {
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let values = powers.flat_map(|power| [1.0, 2.0, 5.0].map(|part| part * 10f64.powi(power)));
    values.filter(|value| (low..=high).contains(value)).collect()
}

/// Ticks whose numbers would touch the one before lose their number.
fn apart(ticks: Vec<(f64, String)>) -> Vec<(f64, String)> {
    const LEAST: f64 = 0.11;
    let mut last = f64::NEG_INFINITY;
    let keep = |(share, text): (f64, String)| {
        let text = if share - last < LEAST { String::new() } else { text };
        if !text.is_empty() {
            last = share;
        }
        (share, text)
    };
    ticks.into_iter().map(keep).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_twice_as_high_lies_higher_and_nothing_senseless_is_drawn() {
        let point = |x: f64, measured: f64| CurvePoint { x, measured, expected: measured };
        let draw = |points: Vec<CurvePoint>| {
            let panels = [CurvePanel { x_title: "x".to_owned(), points }];
            curves(&panels, ["title", "below"], "ms", ["measured", "expected"])
        };
        let top = |picture: &Picture, left: bool| {
            let (width, height) = picture.size_px();
            let columns = if left { 0..width / 3 } else { width / 3..width };
            let blue = [MEASURED.r(), MEASURED.g(), MEASURED.b()];
            (70..height).find(|y| columns.clone().any(|x| picture.pixel(x as i32, *y as i32) == Some(blue)))
        };
        let picture = draw(vec![point(1.0, 1.0), point(2.0, 2.0)]);
        assert!(top(&picture, false) < top(&picture, true), "the higher point lies right and above");
        let clean = draw(vec![point(1.0, 1.0), point(f64::NAN, 3.0), point(2.0, 2.0), point(3.0, -1.0)]);
        assert!(clean == picture);
        draw(Vec::new());
    }

    #[test]
    fn decades_have_three_lines() {
        assert_eq!(decades(0.9, 21.0), [1.0, 2.0, 5.0, 10.0, 20.0]);
    }
}
