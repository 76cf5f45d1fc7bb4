//! Edges to drive on: the generalized Voronoi diagram of walls, the lines in the middle between what stands (paper 001, reference 18).
//!
//! Goes in: straight pieces of walls, the width that the robot needs, a place where it can be. Comes out: [`EdgeGraph`], midlines with
//! their clearance, joined at junctions. Branches that run into corners, passages that are too narrow and everything that cannot
//! be reached from the place are left out. The diagram itself is that of `boostvoronoi`, on a grid of a tenth of a millimetre. For tools,
//! not for the daemon: it allocates.

mod cut;
mod graph;

use super::projection::Edge;
use boostvoronoi::prelude::{Builder, BvError, Diagram, SourceCategory};
use graph::Links;
use nalgebra::Vector2;

/// Step of the grid that walls are put on; a world of 10 km fits.
const GRID_M: f64 = 1e-4;
/// Curved edges become points this far apart.
const CURVE_STEP_M: f64 = 0.02;
/// Most pieces of wall.
pub const WALLS_MAX: usize = 20_000;
/// Most points of one curved edge.
const CURVE_POINTS_MAX: usize = 1000;

/// Why there are no edges.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EdgesError {
    /// Too many walls, or walls that are no numbers or farther out than 10 km.
    #[error("walls: found {found}, allowed: at most {WALLS_MAX} pieces within 10 km")]
    Walls {
        /// What was found.
        found: String,
    },
    /// The diagram could not be made.
    #[error("the Voronoi diagram of {pieces} pieces of wall cannot be made: {reason}")]
    Diagram {
        /// Number of pieces after cutting them where they meet.
        pieces: usize,
        /// What the library says.
        reason: String,
    },
}

/// A junction, or the end of a midline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Where it is.
    pub place_m: Vector2<f64>,
    /// Distance to the nearest wall.
    pub clearance_m: f64,
}

/// A midline between two nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Midline {
    /// Index of the node where it begins.
    pub from: usize,
    /// Index of the node where it ends.
    pub to: usize,
    /// Its points, both nodes included.
    pub points_m: Vec<Vector2<f64>>,
    /// Its length.
    pub length_m: f64,
    /// Half the width of its narrowest place.
    pub clearance_m: f64,
}

/// All midlines that can be driven.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EdgeGraph {
    /// Junctions and ends.
    pub nodes: Vec<Node>,
    /// Midlines.
    pub midlines: Vec<Midline>,
}

/// The midlines between `walls` on which a robot that needs `safe_width_m` can drive from `start_m`.
///
/// # Errors
/// [`EdgesError`].
pub fn edges(walls: &[[Vector2<f64>; 2]], safe_width_m: f64, start_m: Vector2<f64>) -> Result<EdgeGraph, EdgesError> {
    let far = |wall: &&[Vector2<f64>; 2]| {
        wall.iter().flat_map(|point| point.iter()).any(|coordinate| !(coordinate.abs() <= 1e4))
    };
    if let Some([from, to]) = walls.iter().find(far) {
        return Err(EdgesError::Walls { found: format!("a piece from {:?} to {:?}", from.as_slice(), to.as_slice()) });
    }
    if walls.len() > WALLS_MAX {
        return Err(EdgesError::Walls { found: format!("{} pieces", walls.len()) });
    }
    let pieces = cut::on_grid(walls, GRID_M);
    if pieces.is_empty() {
        return Ok(EdgeGraph::default());
    }
    let diagram =
        diagram(&pieces).map_err(|error| EdgesError::Diagram { pieces: pieces.len(), reason: error.to_string() })?;
    let walls: Vec<Edge> = pieces.iter().map(piece_m).collect();
    let clearance_m =
        |place_m: Vector2<f64>| walls.iter().map(|wall| wall.distance_m(place_m)).fold(f64::INFINITY, f64::min);
    let mut links = Links::new(diagram.vertices().iter().map(|vertex| GRID_M * Vector2::new(vertex.x(), vertex.y())));
    for line in lines(&diagram, &walls) {
        let narrowest_m = line.points_m.iter().map(|point| clearance_m(*point)).fold(f64::INFINITY, f64::min);
        if narrowest_m >= 0.5 * safe_width_m {
            links.join(line.from, line.to, line.points_m, narrowest_m);
        }
    }
    Ok(links.graph(start_m, &walls, clearance_m))
}

fn piece_m(piece: &[i32; 4]) -> Edge {
    let [x0, y0, x1, y1] = piece.map(|coordinate| f64::from(coordinate) * GRID_M);
    Edge { start_m: Vector2::new(x0, y0), end_m: Vector2::new(x1, y1) }
}

fn diagram(pieces: &[[i32; 4]]) -> Result<Diagram, BvError> {
    Builder::<i32>::default().with_segments(pieces.iter())?.build()
}

/// An edge of the diagram between two of its vertices.
struct Line {
    from: usize,
    to: usize,
    points_m: Vec<Vector2<f64>>,
}

/// What a cell of the diagram is nearest to.
#[derive(Debug, Clone, Copy)]
enum Site {
    Point(Vector2<f64>),
    Wall(Edge),
}

/// Edges with two ends between two different sites.
fn lines(diagram: &Diagram, walls: &[Edge]) -> Vec<Line> {
    let site = |cell: &boostvoronoi::prelude::Cell| {
        let wall = walls.get(cell.source_index().usize())?;
        Some(match cell.source_category() {
            SourceCategory::SegmentStart => Site::Point(wall.start_m),
            SourceCategory::SegmentEnd => Site::Point(wall.end_m),
            _ => Site::Wall(*wall),
        })
    };
    let mut lines = Vec::new();
    for edge in diagram.edges() {
        let line = || {
            let twin = diagram.edge(edge.twin().ok()?).ok()?;
            // Each edge is there twice, once in either direction.
            let once = edge.id().usize() < twin.id().usize();
            if !(once && edge.is_primary()) {
                return None;
            }
            let (from, to) = (edge.vertex0()?, twin.vertex0()?);
            let ends_m = [from, to].map(|vertex| {
                let vertex = &diagram.vertices()[vertex.usize()];
                GRID_M * Vector2::new(vertex.x(), vertex.y())
            });
            let sites = [edge.cell().ok()?, twin.cell().ok()?].map(|cell| diagram.cell(cell).ok().and_then(site));
            let points_m = match sites {
                [Some(Site::Point(focus_m)), Some(Site::Wall(wall))]
                | [Some(Site::Wall(wall)), Some(Site::Point(focus_m))] => parabola(focus_m, &wall, ends_m),
                // Between two points the narrowest place is in their middle.
                [Some(Site::Point(first_m)), Some(Site::Point(second_m))] => {
                    let line = Edge { start_m: ends_m[0], end_m: ends_m[1] };
                    let middle_m = 0.5 * (first_m + second_m);
                    let between = (0.0..=line.length_m()).contains(&line.local_m(middle_m).x);
                    if between { vec![ends_m[0], middle_m, ends_m[1]] } else { ends_m.to_vec() }
                }
                _ => ends_m.to_vec(),
            };
            Some(Line { from: from.usize(), to: to.usize(), points_m })
        };
        lines.extend(line());
    }
    lines
}

/// Points from end to end on the parabola that is as far from a point as from a wall's line.
fn parabola(focus_m: Vector2<f64>, wall: &Edge, [from_m, to_m]: [Vector2<f64>; 2]) -> Vec<Vector2<f64>> {
    let focus = wall.local_m(focus_m);
    let (first, last) = (wall.local_m(from_m).x, wall.local_m(to_m).x);
    // A point on the wall's own line: the edge is straight.
    if focus.y.abs() < GRID_M {
        return vec![from_m, to_m];
    }
    let count = (((last - first).abs() / CURVE_STEP_M).ceil() as usize).clamp(1, CURVE_POINTS_MAX);
    let mut points_m = vec![from_m];
    points_m.extend((1..count).map(|step| {
        let along_m = first + (last - first) * (step as f64 / count as f64);
        let across_m = ((along_m - focus.x).powi(2) + focus.y.powi(2)) / (2.0 * focus.y);
        wall.point_m(Vector2::new(along_m, across_m))
    }));
    points_m.push(to_m);
    points_m
}
