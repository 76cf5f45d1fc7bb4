//! Where the edges of a shape are: distances to them and crossings of a ray with them.
//!
//! Goes in: a shape and a point or a ray in the same frame. Comes out: metres. Never decides what is inside; that is
//! [`Shape::contains`], which asks for the distance.

use super::{Shape, bearing_span_deg};
use nalgebra::Vector2;

type Point = Vector2<f64>;

fn unit_deg(angle_deg: f64) -> Point {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    Point::new(cos, sin)
}

fn cross(a: Point, b: Point) -> f64 {
    a.x * b.y - a.y * b.x
}

fn outside_interval(value: f64, interval: &[f64; 2]) -> f64 {
    (interval[0] - value).max(value - interval[1]).max(0.0)
}

/// Distance from a finite point to the shape, zero inside.
pub(super) fn distance_m(shape: &Shape, point: Point) -> f64 {
    match shape {
        Shape::Rectangle { x_m, y_m } => outside_interval(point.x, x_m).hypot(outside_interval(point.y, y_m)),
        Shape::Circle { centre_m, radius_m } => ((point - Point::from(*centre_m)).norm() - radius_m).max(0.0),
        Shape::HalfCircle { centre_m, radius_m, heading_deg } => {
            let (offset, heading) = (point - Point::from(*centre_m), unit_deg(*heading_deg));
            let (ahead, aside) = (heading.dot(&offset), cross(heading, offset));
            if ahead >= 0.0 {
                (offset.norm() - radius_m).max(0.0)
            } else {
                ahead.hypot((aside.abs() - radius_m).max(0.0))
            }
        }
        Shape::Sector { centre_m, radius_m, bearing_deg } => {
            sector_distance_m(point - Point::from(*centre_m), radius_m, bearing_deg)
        }
        Shape::Trapezoid { x_m, half_width_m } => polygon_distance_m(&trapezoid_corners(x_m, half_width_m), point),
        Shape::Polygon { points_m } => polygon_distance_m(points_m, point),
    }
}

fn sector_distance_m(offset: Point, radius_m: &[f64; 2], bearing_deg: &[f64; 2]) -> f64 {
    let (first, last) = (unit_deg(bearing_deg[0]), unit_deg(bearing_deg[1]));
    let span_deg = bearing_span_deg(bearing_deg);
    let (after_first, before_last) = (cross(first, offset) >= 0.0, cross(offset, last) >= 0.0);
    let between = match span_deg {
        span if span >= 360.0 => true,
        span if span <= 180.0 => after_first && before_last,
        _ => after_first || before_last,
    };
    if between {
        outside_interval(offset.norm(), radius_m)
    } else {
        let side = |unit: Point| segment_distance_m(unit * radius_m[0], unit * radius_m[1], offset);
        side(first).min(side(last))
    }
}

fn segment_distance_m(from: Point, to: Point, point: Point) -> f64 {
    let along = to - from;
    let share = ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (from + along * share - point).norm()
}

/// The four corners, counter-clockwise from the right-hand one at the first x.
fn trapezoid_corners(x_m: &[f64; 2], half_width_m: &[f64; 2]) -> [[f64; 2]; 4] {
    [[x_m[0], -half_width_m[0]], [x_m[1], -half_width_m[1]], [x_m[1], half_width_m[1]], [x_m[0], half_width_m[0]]]
}

fn edges(corners: &[[f64; 2]]) -> impl Iterator<Item = (Point, Point)> + '_ {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(from, to)| (Point::from(*from), Point::from(*to))).filter(|(from, to)| from != to)
}

fn polygon_distance_m(corners: &[[f64; 2]], point: Point) -> f64 {
    // Even-odd rule: a half-open test of each edge, so that a corner level with the point is counted once.
    let inside = edges(corners).fold(false, |inside, (from, to)| {
        let straddles = (from.y > point.y) != (to.y > point.y);
        inside != (straddles && point.x < from.x + (point.y - from.y) / (to.y - from.y) * (to.x - from.x))
    });
    if inside {
        return 0.0;
    }
    edges(corners).map(|(from, to)| segment_distance_m(from, to, point)).fold(f64::INFINITY, f64::min)
}

/// Distances along the ray at which it may enter or leave the shape: every true crossing and some that are none, in no
/// order, negative ones and NaN included.
pub(super) fn crossings_m(shape: &Shape, origin: Point, direction: Point) -> Vec<f64> {
    let line = |through: Point, along: Point| cross(through - origin, along) / cross(direction, along);
    let circle = |centre: &[f64; 2], radius_m: f64| {
        let towards = Point::from(*centre) - origin;
        let (nearest, height) = (towards.dot(&direction), cross(direction, towards));
        let half_chord = (radius_m * radius_m - height * height).sqrt();
        [nearest - half_chord, nearest + half_chord]
    };
    match shape {
        Shape::Rectangle { x_m, y_m } => {
            let upright = x_m.map(|x| (x - origin.x) / direction.x);
            let level = y_m.map(|y| (y - origin.y) / direction.y);
            [upright, level].concat()
        }
        Shape::Circle { centre_m, radius_m } => circle(centre_m, *radius_m).to_vec(),
        Shape::HalfCircle { centre_m, radius_m, heading_deg } => {
            let diameter = line(Point::from(*centre_m), unit_deg(heading_deg + 90.0));
            [&circle(centre_m, *radius_m)[..], &[diameter]].concat()
        }
        Shape::Sector { centre_m, radius_m, bearing_deg } => {
            let sides = bearing_deg.map(|bearing| line(Point::from(*centre_m), unit_deg(bearing)));
            [circle(centre_m, radius_m[0]), circle(centre_m, radius_m[1]), sides].concat()
        }
        Shape::Trapezoid { x_m, half_width_m } => {
            edges(&trapezoid_corners(x_m, half_width_m)).map(|(from, to)| line(from, to - from)).collect()
        }
        Shape::Polygon { points_m } => edges(points_m).map(|(from, to)| line(from, to - from)).collect(),
    }
}

/// The first pair of edges of a closed polygon that cross, or touch without being neighbours.
pub(super) fn first_crossing_edges(corners: &[[f64; 2]]) -> Option<(usize, usize)> {
    let edges: Vec<_> = edges(corners).collect();
    let count = edges.len();
    (0..count).find_map(|first| {
        (first + 1..count)
            .find(|&second| {
                let neighbours = second == first + 1 || (first == 0 && second == count - 1);
                if neighbours { doubles_back(edges[first], edges[second]) } else { meet(edges[first], edges[second]) }
            })
            .map(|second| (first, second))
    })
}

/// Whether two neighbouring edges run back over each other.
fn doubles_back(first: (Point, Point), second: (Point, Point)) -> bool {
    let (a, b) = if first.1 == second.0 {
        (first.0 - first.1, second.1 - second.0)
    } else {
        (first.1 - first.0, second.0 - second.1)
    };
    cross(a, b) == 0.0 && a.dot(&b) > 0.0
}

/// Whether two segments have a point in common.
fn meet(first: (Point, Point), second: (Point, Point)) -> bool {
    let side = |(from, to): (Point, Point), point: Point| cross(to - from, point - from);
    let (a, b) = (side(first, second.0), side(first, second.1));
    let (c, d) = (side(second, first.0), side(second, first.1));
    if a == 0.0 && b == 0.0 {
        let along = first.1 - first.0;
        let place = |point: Point| (point - first.0).dot(&along);
        let (low, high) = (place(second.0).min(place(second.1)), place(second.0).max(place(second.1)));
        return high >= 0.0 && low <= along.norm_squared();
    }
    a * b <= 0.0 && c * d <= 0.0
}
