//! Planned edges in a world, and how a robot drove along them (paper 001, figures 8 and 9).
//!
//! Goes in: worlds with lines and ways. Comes out: a picture, a panel for each world. Knows no detector.

use super::chrome::{self, Frame, Sign};
use super::world::{self, Map};
use crate::io::canvas::{INK, Picture};
use crate::sim::World;
use embedded_graphics::pixelcolor::Rgb888;
use nalgebra::Vector2;

/// Pixels of a single map's longer side, and of a row of maps.
const LONG_SIDE_PX: u32 = 1100;
const ROW_PX: u32 = 1800;
const LINE: Rgb888 = Rgb888::new(120, 120, 120);

/// What a robot did on a stretch of its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doing {
    /// Followed the edge.
    Follows,
    /// Stood and measured.
    Measures,
    /// Drove past an obstacle or back to the edge.
    Passes,
    /// Waited: no way on.
    Blocked,
}

impl Doing {
    const ALL: [Doing; 4] = [Doing::Follows, Doing::Measures, Doing::Passes, Doing::Blocked];

    fn ink(self) -> Rgb888 {
        match self {
            Doing::Follows => Rgb888::new(0, 158, 115),
            Doing::Measures => Rgb888::new(240, 190, 0),
            Doing::Passes => Rgb888::new(0, 114, 178),
            Doing::Blocked => Rgb888::new(213, 94, 0),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Doing::Follows => "follows the edge",
            Doing::Measures => "stands and measures",
            Doing::Passes => "passes an obstacle",
            Doing::Blocked => "blocked",
        }
    }
}

/// One world with what was planned and driven in it.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgePanel<'a> {
    /// What stands above it.
    pub title: String,
    /// The world.
    pub world: &'a World,
    /// Planned lines, point by point.
    pub lines_m: Vec<Vec<[f64; 2]>>,
    /// The way driven.
    pub way: Vec<([f64; 2], Doing)>,
    /// Whether it ended with a contact.
    pub collided: bool,
}

/// Draws the panels, `columns` in a row, under a title.
#[must_use]
pub fn edge_panels(title: &str, panels: &[EdgePanel], columns: usize) -> Picture {
    let driven = panels.iter().any(|panel| !panel.way.is_empty());
    let mut legend = vec![(Sign::Dashes(LINE), "planned edge".to_owned())];
    if driven {
        legend.extend(Doing::ALL.map(|doing| (Sign::Line(doing.ink()), doing.words().to_owned())));
        let marks = [(Sign::Start, "start"), (Sign::End, "end"), (Sign::Contact, "contact")];
        legend.extend(marks.map(|(sign, words)| (sign, words.to_owned())));
    }
    if let [one] = panels {
        let frame = Frame { titles: [title, &one.title], right_px: 0, legend, axis_titles: true };
        return draw(one, LONG_SIDE_PX, frame);
    }
    let columns = columns.clamp(1, 8);
    let drawn: Vec<Picture> = panels
        .iter()
        .map(|panel| {
            let frame = Frame { titles: [&panel.title, ""], right_px: 0, legend: Vec::new(), axis_titles: false };
            draw(panel, ROW_PX / columns as u32, frame)
        })
        .collect();
    chrome::tiled(&drawn, columns, [title, ""], &legend)
}

fn draw(panel: &EdgePanel, long_side_px: u32, frame: Frame) -> Picture {
    let mut map = Map::new(panel.world, &[], (long_side_px, None), frame);
    let thin = long_side_px < LONG_SIDE_PX;
    let place = |[x_m, y_m]: [f64; 2]| world::place_m(x_m, y_m);
    for line in &panel.lines_m {
        let places: Vec<Vector2<f64>> =
            line.iter().filter_map(|point| place(*point)).map(|point_m| map.view.place(point_m)).collect();
        map.picture.dashes(&places, 1.6, LINE);
        for end in [places.first(), places.last()].into_iter().flatten() {
            map.picture.disc(*end, if thin { 2.0 } else { 4.0 }, INK);
        }
    }
    map.draw_world(panel.world);
    for pair in panel.way.windows(2) {
        if let (Some(from_m), Some(to_m)) = (place(pair[0].0), place(pair[1].0)) {
            let width_px = if thin { 2.0 } else { 3.2 };
            map.picture.stroke(map.view.place(from_m), map.view.place(to_m), width_px, pair[0].1.ink());
        }
    }
    let end = if panel.collided { Sign::Contact } else { Sign::End };
    for (sign, point) in [(end, panel.way.last()), (Sign::Start, panel.way.first())] {
        if let Some(place_m) = point.and_then(|(point, _)| place(*point)) {
            sign.draw(&mut map.picture, map.view.place(place_m));
        }
    }
    map.finished().0
}
