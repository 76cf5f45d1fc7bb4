//! The ways of many runs as one map of how often each place was visited (paper 000, figure 9).

use super::PlottedRun;
use super::chrome::{Area, Frame, Sign};
use super::world::{self, Map};
use crate::io::canvas::Picture;
use crate::sim::World;
use embedded_graphics::pixelcolor::Rgb888;
use nalgebra::Vector2;

/// Least side of a cell of the map in pixels.
const CELL_MIN_PX: i32 = 2;
/// Cells from the middle of a footprint to its rim: where more would be needed the cells are made larger.
const REACH_MAX_CELLS: f64 = 30.0;
/// Two points of a way farther apart than this are not joined: nothing drives so far in a ping set.
const STEP_MAX_M: f64 = 1.0;
const BAR_PX: i32 = 126;

/// What is counted in a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum HeatMeasure {
    /// Runs whose footprint came over it: where robots went.
    #[default]
    Runs,
    /// Ping sets during which a footprint was over it: where robots spent their time.
    PingSets,
}

/// How a heat map is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct HeatMapOptions {
    /// First line; the counts of runs, layouts, contacts and goals stand in the second.
    pub title: String,
    /// Radius of the robot; 0 for its centre alone.
    pub footprint_radius_m: f64,
    /// What is counted.
    pub measure: HeatMeasure,
    /// Pixels of the map's longer side, without what stands around it; 200 to 4000.
    pub long_side_px: u32,
}

impl Default for HeatMapOptions {
    fn default() -> Self {
        Self { title: String::new(), footprint_radius_m: 0.0, measure: HeatMeasure::Runs, long_side_px: 1100 }
    }
}

/// Draws all runs over the world: the count of every place on a logarithmic scale, and a red cross where a contact was.
#[must_use]
pub fn heat_map(world: &World, runs: &[PlottedRun], options: &HeatMapOptions) -> Picture {
    let counts = world::counts(runs);
    let mut map = Map::new(
        world,
        runs,
        options.long_side_px,
        Frame {
            titles: [&options.title, &counts],
            right_px: BAR_PX,
            legend: vec![(Sign::Contact, "contact".to_owned())],
            axis_titles: true,
        },
    );
    let cells = count(&map, runs, options);
    let most = cells.values.iter().copied().max().unwrap_or(0).max(1);
    for (index, value) in cells.values.iter().enumerate().filter(|(_, value)| **value > 0) {
        let corner = cells.corner_px(index);
        let side = f64::from(cells.side_px - 1);
        map.picture.block(corner, corner + Vector2::new(side, side), heat(share_of(*value, most)));
    }
    map.draw_floor(world);
    map.draw_world(world);
    map.draw_waypoints(world);
    map.draw_contacts(runs);
    draw_bar(&mut map, most, options);
    map.picture
}

/// Place on the logarithmic scale from 1 (0) to `most` (1).
fn share_of(value: u32, most: u32) -> f64 {
    if most <= 1 { 0.5 } else { f64::from(value).ln() / f64::from(most).ln() }
}

/// From yellow, a single visit, to dark violet: even in brightness, told apart by colour-blind readers, without any red.
fn heat(share: f64) -> Rgb888 {
    let colour = colorous::VIRIDIS.eval_continuous(1.0 - share.clamp(0.0, 1.0));
    Rgb888::new(colour.r, colour.g, colour.b)
}

fn draw_bar(map: &mut Map, most: u32, options: &HeatMapOptions) {
    let Area { top, right, bottom, .. } = map.area;
    let bar = Area { left: right + 28, top: top + 70, right: right + 48, bottom: (top + 400).min(bottom) };
    let decades = (0..10).map(|power| 10u32.pow(power));
    let values = decades.flat_map(|decade| [1, 2, 5].map(|part| decade.saturating_mul(part)));
    let mut shown: Vec<u32> = values.filter(|value| *value <= most).collect();
    // The largest count is told exactly, without a neighbour that it would cover.
    shown.retain(|value| *value == most || share_of(*value, most) < 0.94 || most == 1);
    if shown.last() != Some(&most) {
        shown.push(most);
    }
    let ticks: Vec<_> = shown.into_iter().map(|value| (share_of(value, most), value.to_string())).collect();
    let title = match (options.measure, options.footprint_radius_m > 0.0) {
        (HeatMeasure::Runs, true) => ["runs whose", "robot covered", "this place", "(log scale)"],
        (HeatMeasure::Runs, false) => ["runs whose", "centre crossed", "this place", "(log scale)"],
        (HeatMeasure::PingSets, true) => ["ping sets with", "a robot over", "this place", "(log scale)"],
        (HeatMeasure::PingSets, false) => ["ping sets with", "its centre at", "this place", "(log scale)"],
    };
    bar.colour_bar(&mut map.picture, heat, &ticks, &title);
}

/// Counts of the cells of a map, row by row from its top left corner.
struct Cells {
    area: Area,
    side_px: i32,
    columns: i32,
    rows: i32,
    values: Vec<u32>,
    /// The last that was counted in each cell, so that nothing is counted twice in one.
    last: Vec<u32>,
}

impl Cells {
    fn new(area: Area, side_px: i32) -> Self {
        let columns = (area.right - area.left) / side_px + 1;
        let rows = (area.bottom - area.top) / side_px + 1;
        let count = columns as usize * rows as usize;
        Self { area, side_px, columns, rows, values: vec![0; count], last: vec![0; count] }
    }

    fn corner_px(&self, index: usize) -> Vector2<f64> {
        let (row, column) = (index as i32 / self.columns, index as i32 % self.columns);
        Vector2::new(f64::from(self.area.left + column * self.side_px), f64::from(self.area.top + row * self.side_px))
    }

    /// A place of the picture in cells: whole numbers are the middles of cells.
    fn in_cells(&self, place_px: Vector2<f64>) -> Vector2<f64> {
        let middle_px = 0.5 * f64::from(self.side_px - 1);
        let corner = Vector2::new(f64::from(self.area.left), f64::from(self.area.top));
        (place_px - corner.add_scalar(middle_px)) / f64::from(self.side_px)
    }

    /// Counts `visit` in all cells within `radius` cells of the line between two places, all in cells.
    fn visit(&mut self, from: Vector2<f64>, to: Vector2<f64>, radius: f64, visit: u32) {
        let (low, high) = (from.inf(&to).add_scalar(-radius), from.sup(&to).add_scalar(radius));
        let along = to - from;
        for row in (low.y.floor().max(0.0) as i32)..=(high.y.ceil().min(f64::from(self.rows - 1)) as i32) {
            for column in (low.x.floor().max(0.0) as i32)..=(high.x.ceil().min(f64::from(self.columns - 1)) as i32) {
                let offset = Vector2::new(f64::from(column), f64::from(row)) - from;
                let share = (offset.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                let index = row as usize * self.columns as usize + column as usize;
                if (offset - along * share).norm() <= radius && self.last[index] != visit {
                    self.last[index] = visit;
                    self.values[index] += 1;
                }
            }
        }
    }
}

fn count(map: &Map, runs: &[PlottedRun], options: &HeatMapOptions) -> Cells {
    let radius_px = Some(options.footprint_radius_m * map.view.pixels_per_m()).filter(|radius| radius.is_finite());
    let radius_px = radius_px.unwrap_or(0.0).clamp(0.0, 1e4);
    let side_px = ((radius_px / REACH_MAX_CELLS).ceil() as i32).max(CELL_MIN_PX);
    let mut cells = Cells::new(map.area, side_px);
    // A centre alone still has to be seen.
    let radius = (radius_px / f64::from(side_px)).max(0.75);
    let joined = options.measure == HeatMeasure::Runs;
    let mut visit = 0;
    for run in runs {
        visit += 1;
        for piece in world::drawable(&run.points) {
            let mut before: Option<Vector2<f64>> = None;
            for (place_m, _) in piece {
                let near = |before: &Vector2<f64>| joined && (before - place_m).norm() <= STEP_MAX_M;
                let from_m = before.filter(near).unwrap_or(place_m);
                visit += u32::from(!joined);
                let (from, to) = (cells.in_cells(map.view.place(from_m)), cells.in_cells(map.view.place(place_m)));
                cells.visit(from, to, radius, visit);
                before = Some(place_m);
            }
        }
    }
    cells
}
