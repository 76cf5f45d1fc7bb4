//! Control regions to masks: one ternary mask a layer and sensor, and the flat table of their cells (paper 000, section
//! 4.1; specification, section 4).
//!
//! Goes in: grid, mounts, hidden directions, regions. Comes out: [`MaskSet`], built once. A cell is in a mask when its
//! robot-frame point lies in the region, at the robot's height where that is known, and the cell is seen; side +1 for y >= 0, else -1. Never touches an image.

use super::coverage;
use super::params::{MaskParams, PeakParams};
use super::region::{self, FlowStrip};
use crate::geometry::shape::Shape;
use crate::parameter::ParameterError;
use crate::sensor::{Mount, SensorSetup};
use crate::signal::{CoverageCue, LayerName, Mask, MaskPurpose, MaskRow, MaskTable, PolarGrid, SENSORS_MAX};
use nalgebra::Vector2;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How far behind the footprint a reverse wants nothing to be heard: beyond the range at which a sensor at the rim is deaf.
const BEHIND_REACH_M: f64 = 0.45;
/// Room to either side of a footprint that drives straight on or back.
const WAY_SIDE_M: f64 = 0.05;

/// Farthest that a way point lies ahead, and how far they are apart: half a ring.
const WAY_REACH_M: f64 = 5.0;
const WAY_STEP_M: f64 = 0.025;

/// Width of a ring: an echo's main lobe and the ripple of its pulse fit into one and its neighbours.
const RING_M: f64 = 0.05;
/// Rings that are told apart; what lies farther out shares the last one.
pub(super) const RINGS_MAX: usize = 256;

/// Most flow lines of a mask set.
pub const FLOW_LINES_MAX: usize = 1000;

/// Everything that is fixed about regions: masks, table, lengths of flow lines, coverage of each set of sensors.
///
/// In the table every region has two rows a sensor and ring of ranges, its left cells (+1) and its right cells (-1): only so can
/// a left and a right reflection be found equally near, and a side lobe be told by the echo at its range. Then come the cells
/// behind the footprint, the flow lines, and the whole rings, left and right. Rows without a cell are left out.
#[derive(Debug, Clone)]
pub struct MaskSet {
    pub(super) grid: Arc<PolarGrid>,
    pub(super) table: Arc<MaskTable>,
    pub(super) peaks: PeakParams,
    pub(super) collision_threshold: f64,
    pub(super) cell_weight: f32,
    pub(super) side_lobe_share: f64,
    /// Ring of each row of the table; 0 where it has no meaning.
    pub(super) rings: Vec<usize>,
    /// Whether a row's cells lie where the robot drives to, within its width.
    pub(super) in_way: Vec<bool>,
    /// Places of the way ahead within the CA region, and which ring of which sensor sees them.
    pub(super) way: Vec<WayPoint>,
    pub(super) lines: Vec<Line>,
    /// Indexed by the bit set of the sensors used.
    pub(super) coverage: [CoverageCue; 1 << SENSORS_MAX],
    pub(super) mounts: Vec<Mount>,
    masks: Vec<Mask>,
}

/// A flow line and how much of it each sensor sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    pub(super) lateral_m: f64,
    /// Seen cells of each sensor: the parts of |F_d| of eq. 14.
    pub(super) cell_counts: [u32; SENSORS_MAX],
}

/// A place in the robot's way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WayPoint {
    /// Distance from the footprint.
    pub(super) distance_m: f64,
    /// How far ahead of the footprint's front; negative beside it.
    pub(super) ahead_m: f64,
    /// Ring in which each sensor sees it; `None` where one does not.
    pub(super) rings: [Option<usize>; SENSORS_MAX],
}

impl MaskSet {
    /// Builds masks and table for sensors that share `grid`; `hidden[sensor][direction]` says which directions a sensor
    /// cannot see.
    ///
    /// # Errors
    /// A region whose mask is empty on every sensor, a grid that begins at range zero (the laws divide by r^2), no or too
    /// many sensors or flow lines, or `hidden` of another shape than `[sensor][direction]`. Keys are relative to `[control]`,
    /// except `range_min_m` (of `[imaging]`) and `sensor`.
    pub fn build(
        grid: &Arc<PolarGrid>,
        sensors: &[SensorSetup],
        hidden: &[Vec<bool>],
        params: &MaskParams,
    ) -> Result<Self, ParameterError> {
        let mounts: Vec<Mount> = sensors.iter().map(|sensor| sensor.mount).collect();
        check_shapes(grid, mounts.len(), hidden)?;
        let strips = region::flow_strips(&params.flow_lines);
        if strips.len() > FLOW_LINES_MAX {
            let allowed = format!("at most {FLOW_LINES_MAX} flow lines in all");
            return Err(ParameterError::new("flow_following.regions", format!("{} flow lines", strips.len()), allowed));
        }
        let mut builder = Builder::new(grid, &mounts, hidden, params);
        let regions = [
            (LayerName::CollisionAvoidance, &params.collision_avoidance),
            (LayerName::ObstacleAvoidance, &params.obstacle_avoidance),
            (LayerName::CorridorFollowing, &params.corridor_following),
        ];
        for (layer, shapes) in regions.into_iter().filter(|(_, shapes)| !shapes.is_empty()) {
            builder.add_region(layer, shapes)?;
        }
        builder.add_behind();
        let lines = if strips.is_empty() { Vec::new() } else { builder.add_flow_lines(&strips)? };
        builder.add_rings();
        let view = coverage::View::new(grid, &mounts, hidden);
        let seen_by = |point_m| view.seen_by(point_m);
        let way = way_points(&params.collision_avoidance, params.footprint_radius_m, &mounts, seen_by);
        Ok(Self {
            grid: Arc::clone(grid),
            coverage: coverage::of_all_sensor_sets(params.footprint_radius_m, params.blind_gap_m, seen_by),
            peaks: params.peaks,
            collision_threshold: params.collision_threshold,
            cell_weight: params.cell_weight,
            side_lobe_share: params.side_lobe_share,
            rings: builder.rings,
            in_way: builder.in_way,
            way,
            lines,
            masks: builder.masks,
            table: Arc::new(builder.table),
            mounts,
        })
    }

    /// The table that a backend sums over.
    #[must_use]
    pub fn table(&self) -> &Arc<MaskTable> {
        &self.table
    }

    /// The masks of all layers that are on, by layer, then by sensor; a layer that one sensor cannot see has a mask of
    /// zeros there. Flow following's mask is the union of its lines.
    pub fn masks(&self) -> impl Iterator<Item = &Mask> {
        self.masks.iter()
    }

    /// The grid that all masks stand on.
    #[must_use]
    pub fn grid(&self) -> &Arc<PolarGrid> {
        &self.grid
    }

    /// Number of sensors that the set was built for.
    #[must_use]
    pub fn sensor_count(&self) -> usize {
        self.mounts.len()
    }

    /// How far ahead and behind a set of sensors sees without a gap.
    #[must_use]
    pub fn coverage(&self, used: [bool; SENSORS_MAX]) -> CoverageCue {
        self.coverage[coverage::bits(used)]
    }

    /// Whether these sensors leave a place of the CA region ahead of the footprint, over its whole width, that all together would
    /// see, to none of them: a lost one was its only cover.
    #[must_use]
    pub fn lacks_cover_ahead(&self, used: [bool; SENSORS_MAX]) -> bool {
        let covered = |point: &WayPoint| point.rings.iter().zip(used).any(|(ring, used)| used && ring.is_some());
        self.way.iter().any(|point| point.ahead_m >= 0.0 && !covered(point))
    }
}

fn check_shapes(grid: &PolarGrid, sensor_count: usize, hidden: &[Vec<bool>]) -> Result<(), ParameterError> {
    if !(1..=SENSORS_MAX).contains(&sensor_count) {
        return Err(ParameterError::new("sensor", format!("{sensor_count} sensors"), format!("1 to {SENSORS_MAX}")));
    }
    if grid.range_first_m() <= 0.0 {
        let allowed = "a range above 0, since the control laws divide by its square";
        return Err(ParameterError::new("range_min_m", grid.range_first_m(), allowed));
    }
    if hidden.len() != sensor_count || hidden.iter().any(|rows| rows.len() != grid.direction_count()) {
        let found = format!("hidden directions of {} sensors", hidden.len());
        let allowed = format!("{} directions for each of {sensor_count} sensors", grid.direction_count());
        return Err(ParameterError::new("sensor", found, allowed));
    }
    Ok(())
}

/// Ring that a range lies in.
pub(super) fn ring_of(range_m: f64) -> usize {
    ((range_m / RING_M) as usize).min(RINGS_MAX - 1)
}

/// Places of the way ahead in the CA region, 2.5 cm apart, and what sees them. Those that nothing sees are left out: they are the
/// concern of the coverage.
fn way_points(
    shapes: &[Shape],
    footprint_radius_m: f64,
    mounts: &[Mount],
    seen_by: impl Fn(Vector2<f64>) -> usize,
) -> Vec<WayPoint> {
    let reach = (WAY_REACH_M / WAY_STEP_M) as i64;
    let half_count = (footprint_radius_m / WAY_STEP_M).ceil() as i64;
    let places = (0..=reach).flat_map(|ahead| (-half_count..=half_count).map(move |across| (ahead, across)));
    places
        .filter_map(|(ahead, across)| {
            let y_m = (across as f64 * WAY_STEP_M).clamp(-footprint_radius_m, footprint_radius_m);
            let point_m = Vector2::new(ahead as f64 * WAY_STEP_M, y_m);
            let distance_m = region::footprint_distance_m(point_m, footprint_radius_m);
            let sensors = seen_by(point_m);
            if distance_m <= 0.0 || sensors == 0 || !region::inside_any(shapes, point_m) {
                return None;
            }
            let ring = |(index, mount): (usize, &Mount)| {
                let seen = sensors & 1 << index != 0;
                seen.then(|| ring_of((point_m - mount.position_m()).norm()))
            };
            let mut rings = [None; SENSORS_MAX];
            rings.iter_mut().zip(mounts.iter().enumerate().map(ring)).for_each(|(slot, ring)| *slot = ring);
            Some(WayPoint { distance_m, ahead_m: point_m.x - footprint_radius_m, rings })
        })
        .collect()
}

/// Gathers masks and table rows, layer by layer.
struct Builder<'a> {
    grid: &'a PolarGrid,
    mounts: &'a [Mount],
    hidden: &'a [Vec<bool>],
    footprint_radius_m: f64,
    z_m: Option<[f64; 2]>,
    masks: Vec<Mask>,
    table: MaskTable,
    rings: Vec<usize>,
    in_way: Vec<bool>,
}

impl<'a> Builder<'a> {
    fn new(grid: &'a PolarGrid, mounts: &'a [Mount], hidden: &'a [Vec<bool>], params: &MaskParams) -> Self {
        let ranges_m = grid.ranges_m();
        let gains: Vec<f32> = ranges_m.iter().map(|range_m| params.range_gain.at(*range_m) as f32).collect();
        let floors: Vec<f32> = ranges_m
            .iter()
            .map(|range_m| (params.noise_floor.at(*range_m) * params.range_gain.at(*range_m)) as f32)
            .collect();
        let table =
            MaskTable { gains: vec![gains; mounts.len()], floors: vec![floors; mounts.len()], ..MaskTable::default() };
        Self {
            grid,
            mounts,
            hidden,
            footprint_radius_m: params.footprint_radius_m,
            z_m: params.z_m,
            masks: Vec::new(),
            table,
            rings: Vec::new(),
            in_way: Vec::new(),
        }
    }

    fn add_region(&mut self, layer: LayerName, shapes: &[Shape]) -> Result<(), ParameterError> {
        let first_entry = self.table.cells.len();
        for sensor_index in 0..self.mounts.len() {
            let mask = self.mask(layer, sensor_index, |point_m| {
                if region::inside_any(shapes, point_m) { region::side_of(point_m) } else { 0 }
            });
            for side in [1, -1] {
                let cells = mask.values.iter().enumerate().filter(|(_, value)| **value == side);
                for (ring, cells) in self.by_ring(cells.map(|(cell, _)| cell)) {
                    let in_way = |cell: &usize| self.is_in_way(layer, sensor_index, *cell);
                    let (way, aside): (Vec<usize>, Vec<usize>) = cells.into_iter().partition(in_way);
                    self.push_row(MaskPurpose::Region(layer), sensor_index, ring, &aside);
                    let row_count = self.table.rows.len();
                    self.push_row(MaskPurpose::Region(layer), sensor_index, ring, &way);
                    self.in_way[row_count..].fill(true);
                }
            }
            self.masks.push(mask);
        }
        if self.table.cells.len() == first_entry { Err(empty_mask(layer)) } else { Ok(()) }
    }

    /// Whether a cell of the CA region lies where the robot drives to. Other regions are not cut.
    fn is_in_way(&self, layer: LayerName, sensor_index: usize, cell: usize) -> bool {
        let half_width_m = self.footprint_radius_m + WAY_SIDE_M;
        layer == LayerName::CollisionAvoidance && self.point_m(sensor_index, cell).y.abs() <= half_width_m
    }

    fn add_behind(&mut self) {
        let radius_m = self.footprint_radius_m;
        let strip = Shape::Rectangle {
            x_m: [-radius_m - BEHIND_REACH_M, 0.0],
            y_m: [-radius_m - WAY_SIDE_M, radius_m + WAY_SIDE_M],
        };
        for sensor_index in 0..self.mounts.len() {
            let inside = |point_m| i8::from(strip.contains(point_m));
            let mask = self.mask(LayerName::CollisionAvoidance, sensor_index, inside);
            let cells = mask.values.iter().enumerate().filter(|(_, value)| **value != 0);
            let cells: Vec<usize> = cells.map(|(cell, _)| cell).collect();
            self.push_row(MaskPurpose::Behind, sensor_index, 0, &cells);
        }
    }

    /// The whole of each ring that some region or flow line has a cell in, left and right.
    fn add_rings(&mut self) {
        for sensor_index in 0..self.mounts.len() {
            let judged = |row: &&MaskRow| row.sensor_index == sensor_index && row.purpose != MaskPurpose::Behind;
            let cells = self.table.rows.iter().filter(judged).flat_map(|row| row.first..row.first + row.count);
            let used: BTreeSet<usize> = cells
                .map(|entry| self.grid.direction_and_range(self.table.cells[entry] as usize).1)
                .map(|range_index| ring_of(self.grid.range_m(range_index)))
                .flat_map(|ring| [ring.saturating_sub(1), ring, ring + 1])
                .collect();
            let seen = (0..self.grid.cell_count()).filter(|cell| {
                let (direction_index, _) = self.grid.direction_and_range(*cell);
                !self.hidden[sensor_index][direction_index]
            });
            for (index, cells) in self.by_ring(seen).into_iter().filter(|(ring, _)| used.contains(ring)) {
                for side in [1, -1] {
                    let on_side = |cell: &usize| region::side_of(self.point_m(sensor_index, *cell)) == side;
                    let cells: Vec<usize> = cells.iter().copied().filter(on_side).collect();
                    self.push_row(MaskPurpose::Ring { index }, sensor_index, index, &cells);
                }
            }
        }
    }

    fn by_ring(&self, cells: impl Iterator<Item = usize>) -> BTreeMap<usize, Vec<usize>> {
        let mut rings: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for cell in cells {
            let (_, range_index) = self.grid.direction_and_range(cell);
            rings.entry(ring_of(self.grid.range_m(range_index))).or_default().push(cell);
        }
        rings
    }

    fn add_flow_lines(&mut self, strips: &[FlowStrip]) -> Result<Vec<Line>, ParameterError> {
        let layer = LayerName::FlowFollowing;
        let line = |strip: &FlowStrip| Line { lateral_m: strip.lateral_m, cell_counts: [0; SENSORS_MAX] };
        let mut lines: Vec<Line> = strips.iter().map(line).collect();
        for sensor_index in 0..self.mounts.len() {
            let mut cells_of_line = vec![Vec::new(); strips.len()];
            let mut mask = self.mask(layer, sensor_index, |_| 1);
            for cell in 0..mask.values.len() {
                if mask.values[cell] == 0 {
                    continue;
                }
                let point_m = self.point_m(sensor_index, cell);
                mask.values[cell] = match region::strip_of(strips, point_m) {
                    Some(index) => {
                        cells_of_line[index].push(cell);
                        region::side_of(point_m)
                    }
                    None => 0,
                };
            }
            for (index, cells) in cells_of_line.iter().enumerate() {
                let purpose = MaskPurpose::FlowLine { index, lateral_m: strips[index].lateral_m };
                lines[index].cell_counts[sensor_index] = cells.len() as u32;
                self.push_row(purpose, sensor_index, 0, cells);
            }
            self.masks.push(mask);
        }
        let seen = lines.iter().any(|line| line.cell_counts.iter().any(|count| *count > 0));
        if seen { Ok(lines) } else { Err(empty_mask(layer)) }
    }

    /// The mask whose seen cells have the value that `value_at` gives their points.
    fn mask(&self, layer: LayerName, sensor_index: usize, value_at: impl Fn(Vector2<f64>) -> i8) -> Mask {
        let mut values = vec![0; self.grid.cell_count()];
        for (cell, value) in values.iter_mut().enumerate() {
            let (direction_index, range_index) = self.grid.direction_and_range(cell);
            let z_m = region::cell_height_m(self.grid, direction_index, range_index);
            let in_way = self.z_m.is_none_or(|[low_m, high_m]| (low_m..=high_m).contains(&z_m));
            if in_way && !self.hidden[sensor_index][direction_index] {
                *value = value_at(self.point_m(sensor_index, cell));
            }
        }
        Mask { layer, sensor_index, values }
    }

    fn point_m(&self, sensor_index: usize, cell: usize) -> Vector2<f64> {
        let (direction_index, range_index) = self.grid.direction_and_range(cell);
        region::cell_point_m(self.grid, &self.mounts[sensor_index], direction_index, range_index)
    }

    fn push_row(&mut self, purpose: MaskPurpose, sensor_index: usize, ring: usize, cells: &[usize]) {
        if cells.is_empty() {
            return;
        }
        let first = self.table.cells.len();
        for &cell in cells {
            let point_m = self.point_m(sensor_index, cell);
            self.table.cells.push(cell as u32);
            self.table.sides.push(f32::from(region::side_of(point_m)));
            self.table.distances_m.push(region::footprint_distance_m(point_m, self.footprint_radius_m) as f32);
        }
        self.rings.push(ring);
        self.in_way.push(false);
        self.table.rows.push(MaskRow { purpose, sensor_index, first, count: cells.len() });
    }
}

fn empty_mask(layer: LayerName) -> ParameterError {
    let found = "regions that no sensor sees a cell of";
    let allowed = "regions within some sensor's view and range, or enabled = false";
    ParameterError::new(format!("{}.regions", layer.as_str()), found, allowed)
}
