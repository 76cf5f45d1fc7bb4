//! What the microphones of one ping heard: their signals, the spectrum, and the matched filter's envelopes; and an energyscape as a
//! rectangle of bearing and range.
//!
//! In: numbers that somebody computed. Out: pictures. Draws only what is finite; computes no result.

use super::chrome::{self, Area, Frame};
use crate::io::canvas::{GRID_LINE, INK, Picture};
use crate::io::picture::{DYNAMIC_RANGE_DB, decibels, heat, top_db};
use crate::signal::{Energyscape, PolarGrid};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Rectangle};
use nalgebra::Vector2;

const TRACE: Rgb888 = Rgb888::new(0, 114, 178);
const BAND: Rgb888 = Rgb888::new(213, 94, 0);
const WIDTH_PX: i32 = 1000;
const HEIGHT_PX: i32 = 420;
const BAR_PX: i32 = 90;
/// Decibels that a spectrum shows.
const SPECTRUM_DB: f64 = 80.0;

/// What is drawn of a ping. All lists are `[microphone][...]` or by frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct HeardPing {
    /// Demodulated samples, `[microphone][sample]`.
    pub signals: Vec<Vec<f32>>,
    /// Their rate.
    pub sample_rate_hz: f64,
    /// Mean power of all microphones at each frequency, decibels of full scale, from 0 Hz to half the rate.
    pub spectrum_db: Vec<f64>,
    /// Lowest and highest frequency of the emission.
    pub band_hz: (f64, f64),
    /// Envelopes after the matched filter, `[microphone][range]`.
    pub envelopes: Vec<Vec<f32>>,
    /// First and last range of the envelopes.
    pub ranges_m: (f64, f64),
}

/// Draws a ping: signals, spectrum and envelopes one below the other.
#[must_use]
pub fn heard(titles: [&str; 2], ping: &HeardPing) -> Picture {
    chrome::tiled(&[signals(ping), spectrum(ping), envelopes(ping)], 1, titles, &[])
}

fn frame(title: &'static str) -> Frame<'static> {
    Frame { titles: [title, ""], right_px: BAR_PX, legend: Vec::new(), axis_titles: true }
}

/// A trace a microphone, all on one scale, the first at the top.
fn signals(ping: &HeardPing) -> Picture {
    let (mut picture, area) = frame("signals of the microphones, all on one scale").sheet(WIDTH_PX, HEIGHT_PX);
    let count = ping.signals.len();
    let samples = ping.signals.iter().map(Vec::len).max().unwrap_or(0);
    let loudest =
        ping.signals.iter().flatten().filter(|value| value.is_finite()).fold(0.0_f32, |most, v| most.max(v.abs()));
    let row_px = f64::from(area.bottom - area.top) / count.max(1) as f64;
    for (index, signal) in ping.signals.iter().enumerate() {
        let middle = f64::from(area.top) + (index as f64 + 0.5) * row_px;
        // Neighbours may touch where they are loudest, and not cover each other.
        let scale = if loudest > 0.0 { 0.75 * row_px / f64::from(loudest) } else { 0.0 };
        for column in 0..WIDTH_PX {
            let at = |column: i32| (column as usize * samples / WIDTH_PX as usize).min(signal.len());
            let part = &signal[at(column)..at(column + 1).max(at(column) + 1).min(signal.len())];
            let finite = || part.iter().copied().filter(|value| value.is_finite()).map(f64::from);
            let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
            if low <= high {
                let place = |value: f64| {
                    let y = (middle - value * scale).round() as i32;
                    Point::new(area.left + column, y.clamp(area.top, area.bottom))
                };
                picture.line(place(low), place(high), TRACE);
            }
        }
    }
    area.frame(&mut picture);
    let duration_ms = samples as f64 / ping.sample_rate_hz * 1e3;
    area.axis_below(&mut picture, &chrome::axis_ticks(0.0, duration_ms, WIDTH_PX), "time since the emission began, ms");
    area.axis_left(&mut picture, &microphones(count), "microphone");
    let told = format!("peak {loudest:.3}");
    let at = Point::new(area.right + 8, area.top + 8);
    picture.label(&told, at, embedded_graphics::text::Alignment::Left);
    picture
}

/// Places of the numbers of microphones, the first at the top.
fn microphones(count: usize) -> Vec<(f64, String)> {
    let step = count.div_ceil(8).max(1);
    let place = |index: usize| (1.0 - (index as f64 + 0.5) / count.max(1) as f64, index.to_string());
    (0..count).step_by(step).map(place).collect()
}

fn spectrum(ping: &HeardPing) -> Picture {
    let title = "mean spectrum of all microphones; orange: the band of the emission";
    let (mut picture, area) = frame(title).sheet(WIDTH_PX, HEIGHT_PX);
    let highest_khz = ping.sample_rate_hz * 0.5e-3;
    let finite = || ping.spectrum_db.iter().copied().filter(|value| value.is_finite());
    let top = (finite().fold(-300.0, f64::max) / 10.0).ceil() * 10.0;
    let bottom = top - SPECTRUM_DB;
    let height = f64::from(area.bottom - area.top);
    let across = |khz: f64| f64::from(area.left) + khz / highest_khz * f64::from(area.right - area.left);
    let up = |level: f64| f64::from(area.bottom) - ((level - bottom) / SPECTRUM_DB).clamp(0.0, 1.0) * height;
    let levels = chrome::axis_ticks(bottom, top, HEIGHT_PX);
    for (share, _) in &levels {
        let y = area.bottom - (share * height).round() as i32;
        picture.line(Point::new(area.left, y), Point::new(area.right, y), GRID_LINE);
    }
    for edge_hz in [ping.band_hz.0, ping.band_hz.1] {
        let x = across(edge_hz * 1e-3);
        picture.dashes(&[Vector2::new(x, f64::from(area.top)), Vector2::new(x, f64::from(area.bottom))], 2.0, BAND);
    }
    let last = ping.spectrum_db.len().saturating_sub(1).max(1) as f64;
    // The loudest of what falls on a column: a line must not vanish between pixels.
    let mut columns = vec![f64::NEG_INFINITY; WIDTH_PX as usize + 1];
    for (index, level) in ping.spectrum_db.iter().enumerate().filter(|(_, level)| level.is_finite()) {
        let column = (index as f64 / last * f64::from(WIDTH_PX)).round() as usize;
        columns[column] = columns[column].max(*level);
    }
    let places: Vec<Vector2<f64>> = columns
        .iter()
        .enumerate()
        .filter(|(_, level)| level.is_finite())
        .map(|(column, level)| Vector2::new(f64::from(area.left) + column as f64, up(*level)))
        .collect();
    picture.polyline(&places, 1.5, TRACE);
    area.frame(&mut picture);
    area.axis_below(&mut picture, &chrome::axis_ticks(0.0, highest_khz, WIDTH_PX), "frequency, kHz");
    area.axis_left(&mut picture, &levels, "dBFS");
    picture
}

fn envelopes(ping: &HeardPing) -> Picture {
    let title = "after the matched filter: envelope of each microphone, decibels below the loudest";
    let (mut picture, area) = frame(title).sheet(WIDTH_PX, HEIGHT_PX);
    let loudest =
        ping.envelopes.iter().flatten().filter(|value| value.is_finite()).fold(0.0_f32, |most, v| most.max(*v));
    let top_db = decibels(f64::from(loudest));
    let count = ping.envelopes.len();
    raster(&mut picture, area, count, |row, share| {
        let envelope = ping.envelopes.get(row)?;
        let index = (share * envelope.len() as f64) as usize;
        let reach = (envelope.len() / WIDTH_PX as usize).max(1);
        let part = envelope.get(index..(index + reach).min(envelope.len()))?;
        let value = part.iter().copied().filter(|value| value.is_finite()).reduce(f32::max)?;
        Some(heat((decibels(f64::from(value)) - top_db) / DYNAMIC_RANGE_DB + 1.0))
    });
    let (first_m, last_m) = ping.ranges_m;
    area.axis_below(&mut picture, &chrome::axis_ticks(first_m, last_m, WIDTH_PX), "range, m");
    area.axis_left(&mut picture, &microphones(count), "microphone");
    bar(&mut picture, area, 0.0);
    picture
}

/// Fills an area row by row, the first at the top, by the colour of a row and a share from left to right.
fn raster(picture: &mut Picture, area: Area, rows: usize, colour: impl Fn(usize, f64) -> Option<Rgb888>) {
    let height = (area.bottom - area.top).max(1);
    for y in 0..height {
        let row = y as usize * rows / height as usize;
        for x in 0..area.right - area.left {
            if let Some(colour) = colour(row, f64::from(x) / f64::from(area.right - area.left)) {
                picture.shape(Pixel(Point::new(area.left + x, area.top + y), colour));
            }
        }
    }
    let (low, high) = (Point::new(area.left, area.top), Point::new(area.right, area.bottom));
    picture.shape(Rectangle::with_corners(low, high).into_styled(PrimitiveStyle::with_stroke(INK, 1)));
}

fn bar(picture: &mut Picture, area: Area, top_db: f64) {
    let bar = Area { left: area.right + 20, top: area.top + 22, right: area.right + 38, bottom: area.bottom };
    let ticks: Vec<(f64, String)> = (0..=5)
        .map(|step| f64::from(step) / 5.0)
        .map(|share| (share, format!("{:.0}", top_db + (share - 1.0) * DYNAMIC_RANGE_DB)))
        .collect();
    bar.colour_bar(picture, heat, &ticks, &[if top_db == 0.0 { "dB" } else { "dBFS" }]);
}

/// Draws an energyscape as a rectangle: bearings from left (positive) to right, ranges upwards. Of a grid with elevations the
/// loudest at each bearing is shown.
#[must_use]
pub fn rectangular(titles: [&str; 2], energyscape: &Energyscape) -> Picture {
    let frame = Frame { titles, right_px: BAR_PX, legend: Vec::new(), axis_titles: true };
    let (mut picture, area) = frame.sheet(900, 620);
    let grid: &PolarGrid = &energyscape.grid;
    let azimuths: Vec<f64> = grid.directions().iter().map(|direction| direction.azimuth_rad.to_degrees()).collect();
    let (right_deg, left_deg) =
        azimuths.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(*at), high.max(*at)));
    let columns = area.right - area.left;
    // For each column the directions as near as the nearest one.
    let nearest: Vec<Vec<usize>> = (0..columns)
        .map(|x| {
            let bearing = left_deg - f64::from(x) / f64::from(columns - 1).max(1.0) * (left_deg - right_deg);
            let distance = |index: usize| (azimuths[index] - bearing).abs();
            let best = (0..azimuths.len()).map(distance).fold(f64::INFINITY, f64::min);
            (0..azimuths.len()).filter(|index| distance(*index) <= best + 1e-6).collect()
        })
        .collect();
    let top = top_db([energyscape]);
    let rows = grid.range_count();
    raster(&mut picture, area, rows, |row, share| {
        let directions = nearest.get((share * f64::from(columns)) as usize)?;
        let values = directions.iter().map(|direction| energyscape.values[grid.cell(*direction, rows - 1 - row)]);
        let value = values.filter(|value| value.is_finite()).reduce(f32::max)?;
        Some(heat((decibels(f64::from(value)) - top) / DYNAMIC_RANGE_DB + 1.0))
    });
    // Ticks are made for a rising axis; left is positive here.
    let bearings =
        chrome::axis_ticks(right_deg, left_deg, columns).into_iter().map(|(share, text)| (1.0 - share, text));
    area.axis_below(&mut picture, &bearings.collect::<Vec<_>>(), "bearing, degrees (left positive)");
    let (first_m, last_m) = (grid.range_m(0), grid.range_m(rows - 1));
    area.axis_left(&mut picture, &chrome::axis_ticks(first_m, last_m, area.bottom - area.top), "range, m");
    bar(&mut picture, area, top);
    picture
}
