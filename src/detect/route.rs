//! The shortest way over an occupancy grid: A* (paper 003, future work).
//!
//! Goes in: a grid, start and goal, the robot's radius. Comes out: the way in metres, or nothing where there is none. A cell is
//! closed if the robot, standing in its middle, would touch an occupied one; ways go straight and diagonally, but never across
//! the corner of a closed cell. Unknown cells are dearer than free ones, or closed. Allocates: it is for planning, not for every
//! ping.

use super::occupancy::{OCCUPIED_PERCENT, UNKNOWN};
use nalgebra::Vector2;
use pathfinding::prelude::astar;

/// Cost of a step straight across one cell; along the diagonal it is [`DIAGONAL`].
const STRAIGHT: u64 = 10_000;
const DIAGONAL: u64 = 14_142;
/// How much of a touch is still none.
const TOUCH_M: f64 = 1e-9;

/// A grid to find a way on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridMap<'a> {
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Edge of a cell.
    pub cell_m: f64,
    /// Middle of the first cell.
    pub origin_m: Vector2<f64>,
    /// Row by row, x first: 0 free to 100 occupied, 255 unknown.
    pub percent: &'a [u8],
}

/// What may be driven over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RouteOptions {
    /// Radius of the robot.
    pub robot_radius_m: f64,
    /// Cost of an unknown cell relative to a free one, at least 1; `None` closes them.
    pub unknown_cost: Option<f64>,
    /// From this percentage on a cell is occupied.
    pub occupied_percent: u8,
}

impl Default for RouteOptions {
    fn default() -> Self {
        Self { robot_radius_m: 0.1, unknown_cost: Some(3.0), occupied_percent: OCCUPIED_PERCENT }
    }
}

/// A way.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Middles of its cells, the first and the last of them instead where the way begins and ends.
    pub points_m: Vec<Vector2<f64>>,
    /// Length of the way through the middles of the cells.
    pub length_m: f64,
    /// Cost: the same, but that unknown cells count for more.
    pub cost_m: f64,
}

impl GridMap<'_> {
    /// The cell of a place; nothing outside.
    #[must_use]
    pub fn cell_at(&self, place_m: Vector2<f64>) -> Option<(usize, usize)> {
        let [x, y] =
            [place_m.x - self.origin_m.x, place_m.y - self.origin_m.y].map(|way_m| (way_m / self.cell_m).round());
        let inside = (0.0..self.width as f64).contains(&x) && (0.0..self.height as f64).contains(&y);
        inside.then_some((x as usize, y as usize))
    }

    /// How occupied the cell of a place is; nothing outside.
    #[must_use]
    pub fn percent_at(&self, place_m: Vector2<f64>) -> Option<u8> {
        self.cell_at(place_m).and_then(|cell| self.percent_of(cell))
    }

    /// Middle of a cell.
    #[must_use]
    pub fn middle_m(&self, (x, y): (usize, usize)) -> Vector2<f64> {
        self.origin_m + Vector2::new(x as f64, y as f64) * self.cell_m
    }

    fn percent_of(&self, (x, y): (usize, usize)) -> Option<u8> {
        let inside = x < self.width && y < self.height;
        inside.then(|| self.percent.get(y * self.width + x).copied()).flatten()
    }
}

/// What a step into each cell costs relative to a free one, in hundredths; 0 where the robot cannot be.
#[must_use]
pub fn costs(map: &GridMap, options: &RouteOptions) -> Vec<u64> {
    let unknown = options.unknown_cost.map_or(0, |cost| (100.0 * cost.clamp(1.0, 1e6)).round() as u64);
    let mut costs: Vec<u64> = Vec::with_capacity(map.width * map.height);
    let cells = || (0..map.height).flat_map(|y| (0..map.width).map(move |x| (x, y)));
    costs.extend(cells().map(|cell| match map.percent_of(cell) {
        None => 0,
        Some(UNKNOWN) => unknown,
        Some(_) => 100,
    }));
    // Cells that an occupied one closes: those from whose middle it is nearer than the radius.
    let reach = (options.robot_radius_m / map.cell_m + 0.5).ceil().clamp(0.0, 1e4) as i64;
    let occupied = |percent: u8| percent != UNKNOWN && percent >= options.occupied_percent;
    for (x, y) in cells().filter(|cell| map.percent_of(*cell).is_some_and(occupied)) {
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let gap_m = |step: i64| ((step.abs() as f64 - 0.5) * map.cell_m).max(0.0);
                let touches = (dx, dy) == (0, 0) || gap_m(dx).hypot(gap_m(dy)) < options.robot_radius_m - TOUCH_M;
                if let Some(cell) = moved(map, (x, y), (dx, dy)).filter(|_| touches) {
                    costs[cell.1 * map.width + cell.0] = 0;
                }
            }
        }
    }
    costs
}

/// The cell so many cells on; nothing outside.
fn moved(map: &GridMap, (x, y): (usize, usize), (dx, dy): (i64, i64)) -> Option<(usize, usize)> {
    let x = x.checked_add_signed(dx as isize).filter(|x| *x < map.width)?;
    let y = y.checked_add_signed(dy as isize).filter(|y| *y < map.height)?;
    Some((x, y))
}

/// The cheapest way from `start_m` to `goal_m`; nothing if there is none, or one of them lies outside. The robot may stand where
/// it could not drive to: the first cell is never closed.
#[must_use]
pub fn route(map: &GridMap, start_m: Vector2<f64>, goal_m: Vector2<f64>, options: &RouteOptions) -> Option<Route> {
    let (start, goal) = (map.cell_at(start_m)?, map.cell_at(goal_m)?);
    let costs = costs(map, options);
    let cost = |cell: (usize, usize)| costs[cell.1 * map.width + cell.0];
    let step = |from: (usize, usize), by: (i64, i64)| {
        let to = moved(map, from, by).filter(|to| cost(*to) > 0)?;
        let diagonal = by.0 != 0 && by.1 != 0;
        let open = |side: (i64, i64)| moved(map, from, side).is_some_and(|cell| cost(cell) > 0);
        if diagonal && !(open((by.0, 0)) && open((0, by.1))) {
            return None;
        }
        let length = if diagonal { DIAGONAL } else { STRAIGHT };
        Some((to, length * cost(to) / 100))
    };
    const AROUND: [(i64, i64); 8] = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];
    let left = |cell: &(usize, usize)| {
        let (dx, dy) = (cell.0.abs_diff(goal.0) as u64, cell.1.abs_diff(goal.1) as u64);
        STRAIGHT * dx.abs_diff(dy) + DIAGONAL * dx.min(dy)
    };
    let (cells, cost) =
        astar(&start, |&from| AROUND.into_iter().filter_map(move |by| step(from, by)), left, |cell| *cell == goal)?;
    let length = |pair: &[(usize, usize)]| {
        let straight = pair[0].0 == pair[1].0 || pair[0].1 == pair[1].1;
        if straight { map.cell_m } else { map.cell_m * std::f64::consts::SQRT_2 }
    };
    let mut points_m: Vec<Vector2<f64>> = cells.iter().map(|cell| map.middle_m(*cell)).collect();
    if let Some(first) = points_m.first_mut() {
        *first = start_m;
    }
    if points_m.len() > 1 {
        if let Some(last) = points_m.last_mut() {
            *last = goal_m;
        }
    } else {
        points_m.push(goal_m);
    }
    Some(Route {
        points_m,
        length_m: cells.windows(2).map(length).sum(),
        cost_m: cost as f64 / STRAIGHT as f64 * map.cell_m,
    })
}
