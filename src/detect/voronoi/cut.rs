//! Walls on a grid, cut where they meet: pieces that have at most their ends in common, as the Voronoi library wants them.
//!
//! Goes in: pieces as people draw them, crossing, touching, overlapping, double. Comes out: `[x0, y0, x1, y1]` in steps of the grid.

use nalgebra::Vector2;
use std::collections::BTreeSet;

/// Rounds of cutting: putting a crossing on the grid moves the pieces that meet there a little, and they may cross anew.
const ROUNDS_MAX: usize = 8;

type Point = [i64; 2];

/// Cuts walls on a grid of `step_m`.
pub(super) fn on_grid(walls: &[[Vector2<f64>; 2]], step_m: f64) -> Vec<[i32; 4]> {
    let point = |place_m: &Vector2<f64>| [(place_m.x / step_m).round() as i64, (place_m.y / step_m).round() as i64];
    let mut pieces: BTreeSet<[Point; 2]> =
        walls.iter().filter_map(|[from, to]| piece(point(from), point(to))).collect();
    for _ in 0..ROUNDS_MAX {
        let all: Vec<[Point; 2]> = pieces.iter().copied().collect();
        let cut: BTreeSet<[Point; 2]> = all.iter().flat_map(|one| cut_at(one, &points_on(one, &all))).collect();
        if cut == pieces {
            break;
        }
        pieces = cut;
    }
    let narrow = |value: i64| i32::try_from(value).unwrap_or(0);
    pieces.iter().map(|[from, to]| [narrow(from[0]), narrow(from[1]), narrow(to[0]), narrow(to[1])]).collect()
}

/// A piece in the order of its ends, unless they are one.
fn piece(from: Point, to: Point) -> Option<[Point; 2]> {
    (from != to).then(|| if from < to { [from, to] } else { [to, from] })
}

fn cross(a: Point, b: Point, c: Point) -> i128 {
    let [abx, aby, acx, acy] = [b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]].map(i128::from);
    abx * acy - aby * acx
}

fn within(piece: &[Point; 2], point: Point) -> bool {
    (0..2).all(|axis| {
        let [from, to] = [piece[0][axis], piece[1][axis]];
        (from.min(to)..=from.max(to)).contains(&point[axis])
    })
}

/// Points of a piece at which others touch or cross it.
fn points_on(one: &[Point; 2], all: &[[Point; 2]]) -> Vec<Point> {
    let mut points = Vec::new();
    for other in all.iter().filter(|other| *other != one) {
        let [a, b] = [cross(one[0], one[1], other[0]), cross(one[0], one[1], other[1])];
        let [c, d] = [cross(other[0], other[1], one[0]), cross(other[0], other[1], one[1])];
        points.extend(
            other.iter().zip([a, b]).filter(|(end, side)| *side == 0 && within(one, **end)).map(|(end, _)| *end),
        );
        let crosses = (a > 0) != (b > 0) && (c > 0) != (d > 0) && a != 0 && b != 0 && c != 0 && d != 0;
        if crosses {
            let share = c as f64 / (c - d) as f64;
            let along = |axis: usize| one[0][axis] + ((one[1][axis] - one[0][axis]) as f64 * share).round() as i64;
            points.push([along(0), along(1)]);
        }
    }
    points
}

fn cut_at(one: &[Point; 2], points: &[Point]) -> Vec<[Point; 2]> {
    let far = |point: &Point| {
        let [x, y] = [point[0] - one[0][0], point[1] - one[0][1]].map(i128::from);
        x * x + y * y
    };
    let mut ends: Vec<Point> = one.iter().chain(points).copied().collect();
    ends.sort_by_key(far);
    ends.windows(2).filter_map(|pair| piece(pair[0], pair[1])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(walls: &[[f64; 4]]) -> Vec<[i32; 4]> {
        let walls: Vec<_> = walls.iter().map(|[a, b, c, d]| [Vector2::new(*a, *b), Vector2::new(*c, *d)]).collect();
        on_grid(&walls, 1e-4)
    }

    #[test]
    fn walls_that_cross_touch_or_overlap_are_cut_where_they_meet() {
        assert_eq!(cut(&[[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]]).len(), 4, "a cross");
        assert_eq!(cut(&[[-1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]).len(), 3, "a T");
        assert_eq!(cut(&[[0.0, 0.0, 2.0, 0.0], [1.0, 0.0, 3.0, 0.0]]).len(), 3, "an overlap");
        assert_eq!(cut(&[[0.0, 0.0, 2.0, 0.0], [2.0, 0.0, 0.0, 0.0]]).len(), 1, "the same twice");
        assert_eq!(cut(&[[0.0, 0.0, 1e-6, 0.0]]).len(), 0, "a point");
        assert_eq!(cut(&[[0.0, 0.0, 1.0, 0.0], [0.0, 0.5, 1.0, 0.5]]).len(), 2, "apart");
    }

    #[test]
    fn what_was_cut_has_only_ends_in_common() {
        let walls: Vec<[f64; 4]> = (0..12)
            .map(|index| {
                let (sin, cos) = (0.7 * f64::from(index)).sin_cos();
                [cos, sin, -cos * 0.9 + 0.1, -sin + 0.05 * f64::from(index)]
            })
            .collect();
        let pieces: Vec<[Point; 2]> =
            cut(&walls).iter().map(|piece| piece.map(i64::from)).map(|[a, b, c, d]| [[a, b], [c, d]]).collect();
        assert!(pieces.len() > 40);
        for one in &pieces {
            let inner = points_on(one, &pieces).into_iter().filter(|point| !one.contains(point));
            assert_eq!(inner.count(), 0, "{one:?}");
        }
    }
}
