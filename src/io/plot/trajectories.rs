//! Ways through a world, coloured by the layer that decided at each point (paper 000, figures 11 and 12).

use super::chrome::{self, Frame, Sign};
use super::world::{self, Map};
use super::{PlottedRun, layer_ink, layer_words};
use crate::io::canvas::Picture;
use crate::signal::LayerName;
use crate::sim::World;
use nalgebra::Vector2;

/// From the bottom to the top: what is rare and matters must not be covered by what is common.
const ORDER: [LayerName; 6] = [
    LayerName::PassThrough,
    LayerName::CorridorFollowing,
    LayerName::FlowFollowing,
    LayerName::ObstacleAvoidance,
    LayerName::CollisionAvoidance,
    LayerName::Stopped,
];
/// What the numbers of the legend are.
const SHARES: &str = "; colours: the layer that decided, with its share of the ping sets";
/// Most panels of one picture.
const PANELS_MAX: usize = 64;

/// How ways are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct PathsOptions {
    /// First line; the counts of runs, layouts, contacts and goals stand in the second.
    pub title: String,
    /// Pixels of the map's longer side, without what stands around it; 200 to 4000. With a panel for each layout, of all
    /// maps of a row together.
    pub long_side_px: u32,
}

impl Default for PathsOptions {
    fn default() -> Self {
        Self { title: String::new(), long_side_px: 1100 }
    }
}

/// Draws all runs over the world, a line a run: open circle at the start, square at the end, red cross at a contact.
#[must_use]
pub fn paths(world: &World, runs: &[PlottedRun], options: &PathsOptions) -> Picture {
    let counts = world::counts(runs) + SHARES;
    let frame = Frame { titles: [&options.title, &counts], right_px: 0, legend: way_legend(runs), axis_titles: true };
    panel(world, runs, runs, options.long_side_px, frame)
}

/// As [`paths`], with a panel of its own for each layout, in the order in which they first appear; at most 64.
#[must_use]
pub fn paths_by_layout(world: &World, runs: &[PlottedRun], options: &PathsOptions) -> Picture {
    let mut layouts: Vec<&str> = Vec::new();
    for run in runs {
        if !layouts.contains(&run.layout) && layouts.len() < PANELS_MAX {
            layouts.push(run.layout);
        }
    }
    let columns = match layouts.len() {
        0 | 1 => 1,
        count @ 2..=3 => count,
        4 => 2,
        5..=9 => 3,
        _ => 4,
    };
    let panels: Vec<Picture> = layouts
        .iter()
        .map(|layout| {
            let chosen: Vec<PlottedRun> = runs.iter().filter(|run| run.layout == *layout).cloned().collect();
            let counts = world::counts(&chosen).replacen(", 1 layout", "", 1);
            let side_px = options.long_side_px.clamp(200, 8000) / columns as u32;
            let frame = Frame { titles: [layout, &counts], right_px: 0, legend: Vec::new(), axis_titles: false };
            panel(world, &chosen, runs, side_px, frame)
        })
        .collect();
    let mut legend = world::world_legend(world);
    legend.extend(way_legend(runs));
    chrome::tiled(&panels, columns, [&options.title, &(world::counts(runs) + SHARES)], &legend)
}

/// One map: the size is that of a map of all `runs`, so that panels agree.
fn panel(world: &World, shown: &[PlottedRun], runs: &[PlottedRun], side_px: u32, frame: Frame) -> Picture {
    let mut map = Map::new(world, runs, side_px, frame);
    map.draw_floor(world);
    map.draw_world(world);
    let width_px = if shown.len() > 30 { 1.8 } else { 3.2 };
    for layer in ORDER {
        for run in shown {
            for piece in world::drawable(&run.points) {
                let places: Vec<(Vector2<f64>, LayerName)> =
                    piece.into_iter().map(|(place_m, layer)| (map.view.place(place_m), layer)).collect();
                // A point's layer decided the way from it to the next; the last one has no such way.
                for pair in places.windows(2).filter(|pair| pair[0].1 == layer) {
                    map.picture.stroke(pair[0].0, pair[1].0, width_px, layer_ink(layer));
                }
            }
        }
    }
    for (sign, pick) in [(Sign::End, 1), (Sign::Start, 0)] {
        for run in shown.iter().filter(|run| pick == 0 || !run.collided) {
            let point = if pick == 0 { run.points.first() } else { run.points.last() };
            if let Some(place_m) = point.and_then(|point| world::place_m(point.x_m, point.y_m)) {
                sign.draw(&mut map.picture, map.view.place(place_m));
            }
        }
    }
    map.draw_waypoints(world);
    map.draw_contacts(shown);
    map.picture
}

/// Signs of the layers, with the share of ping sets that each decided, and of what else is on a way.
fn way_legend(runs: &[PlottedRun]) -> Vec<(Sign, String)> {
    let layers = || runs.iter().flat_map(|run| run.points.iter().map(|point| point.layer));
    let all = layers().count().max(1) as f64;
    let entry = |layer: &LayerName| {
        let percent = 100.0 * layers().filter(|found| found == layer).count() as f64 / all;
        (Sign::Line(layer_ink(*layer)), format!("{} {percent:.1} %", layer_words(*layer)))
    };
    let mut entries: Vec<_> = ORDER.iter().rev().map(entry).collect();
    let marks = [(Sign::Start, "start"), (Sign::End, "end"), (Sign::Contact, "contact")];
    entries.extend(marks.map(|(sign, words)| (sign, words.to_owned())));
    entries
}
