//! The world as geometry asks for it: wall pieces that meet only at their ends, the corners where they meet, circles.
//!
//! Walls of a world file may cross, touch and overlap as they like; they are cut where they meet, so that every corner
//! knows all faces around it. This file computes no sound; plane geometry only.

use super::solids::Solids;
use super::world::World;
use nalgebra::Vector2;

/// Points closer than this are one point.
const MERGE_M: f64 = 1e-3;
/// A mover's velocity is taken over the time that sound flies, about.
const VELOCITY_OVER_S: f64 = 0.01;

/// A straight piece of wall; both faces reflect.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pub(super) from_m: Vector2<f64>,
    pub(super) to_m: Vector2<f64>,
    /// Unit vector from `from_m` to `to_m`.
    pub(super) along: Vector2<f64>,
    pub(super) length_m: f64,
}

/// Pillar or mover.
#[derive(Debug, Clone, Copy)]
pub(super) struct Circle {
    pub(super) centre_m: Vector2<f64>,
    pub(super) radius_m: f64,
    pub(super) velocity_m_s: Vector2<f64>,
}

/// A point where wall pieces end.
#[derive(Debug, Clone)]
pub(super) struct Corner {
    pub(super) at_m: Vector2<f64>,
    /// Direction and segment index of each piece that ends here, in the order of directions.
    faces: Vec<(f64, usize)>,
}

/// The open wedge between two neighbouring faces of a corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sector {
    /// Direction of its first face; the wedge extends counter-clockwise from it.
    first_rad: f64,
    /// Its opening angle, in (0, 2 pi].
    pub(super) opening_rad: f64,
    /// Segments of its first and last face (the same one at a wall's end).
    pub(super) faces: (usize, usize),
}

impl Sector {
    /// Angle of `direction_rad` from the first face, or nothing when it points out of the wedge.
    pub(super) fn angle_of(&self, direction_rad: f64) -> Option<f64> {
        let angle = (direction_rad - self.first_rad).rem_euclid(std::f64::consts::TAU);
        (angle <= self.opening_rad).then_some(angle)
    }
}

impl Corner {
    /// The wedge that `direction_rad` points into.
    pub(super) fn sector(&self, direction_rad: f64) -> Option<Sector> {
        let count = self.faces.len();
        (0..count)
            .map(|index| {
                let (first_rad, first) = self.faces[index];
                let (last_rad, last) = self.faces[(index + 1) % count];
                let opening = (last_rad - first_rad).rem_euclid(std::f64::consts::TAU);
                let opening_rad = if opening > 0.0 { opening } else { std::f64::consts::TAU };
                Sector { first_rad, opening_rad, faces: (first, last) }
            })
            .find(|sector| sector.angle_of(direction_rad).is_some())
    }
}

/// Everything that stands in a world.
#[derive(Debug, Clone)]
pub(super) struct Obstacles {
    pub(super) segments: Vec<Segment>,
    pub(super) corners: Vec<Corner>,
    /// Pillars first, then movers.
    pub(super) circles: Vec<Circle>,
    pillar_count: usize,
    pub(super) solids: Solids,
}

impl Obstacles {
    pub(super) fn new(world: &World) -> Self {
        let pieces: Vec<_> = world.walls.iter().flat_map(|wall| wall.pieces()).collect();
        let (points, ends) = cut_where_they_meet(&pieces);
        let segments: Vec<Segment> = ends
            .iter()
            .map(|&(from, to)| {
                let offset = points[to] - points[from];
                let length_m = offset.norm();
                Segment { from_m: points[from], to_m: points[to], along: offset / length_m, length_m }
            })
            .collect();
        let corners = points
            .iter()
            .enumerate()
            .map(|(point, &at_m)| Corner { at_m, faces: faces_at(point, &ends, &segments) })
            .collect();
        let circle =
            |centre_m: Vector2<f64>, radius_m: f64| Circle { centre_m, radius_m, velocity_m_s: Vector2::zeros() };
        let pillars = world.pillars.iter().map(|pillar| circle(Vector2::from(pillar.centre), pillar.radius_m));
        let movers = world.movers.iter().map(|mover| circle(mover.position_m(0.0), mover.radius_m));
        let solids = Solids {
            floor_m: world.floor_m,
            ceiling_m: world.ceiling_m,
            balls: world.balls.clone(),
            bars: world.bars.clone(),
        };
        Self { segments, corners, circles: pillars.chain(movers).collect(), pillar_count: world.pillars.len(), solids }
    }

    /// The movers, where they are now.
    pub(super) fn movers(&self) -> &[Circle] {
        &self.circles[self.pillar_count..]
    }

    /// Moves the movers to where they are at `time_s`.
    pub(super) fn move_to(&mut self, world: &World, time_s: f64) {
        for (circle, mover) in self.circles[self.pillar_count..].iter_mut().zip(&world.movers) {
            circle.centre_m = mover.position_m(time_s);
            circle.velocity_m_s = (mover.position_m(time_s + VELOCITY_OVER_S) - circle.centre_m) / VELOCITY_OVER_S;
        }
    }

    /// Whether something stands between two points; what touches an end itself does not count.
    pub(super) fn block(&self, from_m: Vector2<f64>, to_m: Vector2<f64>) -> bool {
        let offset = to_m - from_m;
        let length_m = offset.norm();
        if length_m < 4e-6 {
            return false;
        }
        let (from_m, to_m) = (from_m + offset * (1e-6 / length_m), to_m - offset * (1e-6 / length_m));
        self.segments.iter().any(|segment| segments_cross(from_m, to_m, segment.from_m, segment.to_m))
            || self
                .circles
                .iter()
                .any(|circle| distance_to_segment_m(circle.centre_m, from_m, to_m) < circle.radius_m * (1.0 - 1e-9))
    }
}

/// Cuts `pieces` at all common points; returns the points and the pairs of points that are joined.
fn cut_where_they_meet(pieces: &[(Vector2<f64>, Vector2<f64>)]) -> (Vec<Vector2<f64>>, Vec<(usize, usize)>) {
    let mut points: Vec<Vector2<f64>> = Vec::new();
    let mut ends: Vec<(usize, usize)> = Vec::new();
    for &(from, to) in pieces {
        let mut cuts = vec![(0.0, from), ((to - from).norm(), to)];
        for &(other_from, other_to) in pieces {
            for point in [other_from, other_to].into_iter().chain(crossing(from, to, other_from, other_to)) {
                if distance_to_segment_m(point, from, to) < MERGE_M {
                    cuts.push(((point - from).dot(&(to - from).normalize()), point));
                }
            }
        }
        cuts.sort_by(|first, second| first.0.total_cmp(&second.0));
        let indices: Vec<usize> = cuts.into_iter().map(|(_, point)| index_of(&mut points, point)).collect();
        for pair in indices.windows(2) {
            let (low, high) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
            if low != high && !ends.contains(&(low, high)) {
                ends.push((low, high));
            }
        }
    }
    (points, ends)
}

fn index_of(points: &mut Vec<Vector2<f64>>, point: Vector2<f64>) -> usize {
    if let Some(index) = points.iter().position(|known| (known - point).norm() < MERGE_M) {
        return index;
    }
    points.push(point);
    points.len() - 1
}

fn faces_at(point: usize, ends: &[(usize, usize)], segments: &[Segment]) -> Vec<(f64, usize)> {
    let mut faces: Vec<(f64, usize)> = ends
        .iter()
        .zip(segments)
        .enumerate()
        .filter_map(|(index, (&(from, to), segment))| {
            let away = if from == point {
                segment.along
            } else if to == point {
                -segment.along
            } else {
                return None;
            };
            Some((away.y.atan2(away.x), index))
        })
        .collect();
    faces.sort_by(|first, second| first.0.total_cmp(&second.0));
    faces
}

/// z component of the cross product.
pub(super) fn cross(first: Vector2<f64>, second: Vector2<f64>) -> f64 {
    first.x * second.y - first.y * second.x
}

/// The point that two segments have in common, unless they are parallel.
fn crossing(
    from: Vector2<f64>,
    to: Vector2<f64>,
    other_from: Vector2<f64>,
    other_to: Vector2<f64>,
) -> Option<Vector2<f64>> {
    let (along, other) = (to - from, other_to - other_from);
    let determinant = cross(along, other);
    if determinant.abs() < 1e-12 {
        return None;
    }
    let share = cross(other_from - from, other) / determinant;
    let other_share = cross(other_from - from, along) / determinant;
    ((0.0..=1.0).contains(&share) && (0.0..=1.0).contains(&other_share)).then(|| from + along * share)
}

/// Whether two segments have a point in common; merely parallel ones have none.
pub(super) fn segments_cross(
    from: Vector2<f64>,
    to: Vector2<f64>,
    other_from: Vector2<f64>,
    other_to: Vector2<f64>,
) -> bool {
    let (along, other) = (to - from, other_to - other_from);
    let determinant = cross(along, other);
    let offset = other_from - from;
    // No division: this is the innermost question of the simulator.
    let (share, other_share) = (cross(offset, other), cross(offset, along));
    if determinant > 0.0 {
        share >= 0.0 && share <= determinant && other_share >= 0.0 && other_share <= determinant
    } else {
        determinant < 0.0 && share <= 0.0 && share >= determinant && other_share <= 0.0 && other_share >= determinant
    }
}

/// Distance of a point from a segment.
pub(super) fn distance_to_segment_m(point: Vector2<f64>, from: Vector2<f64>, to: Vector2<f64>) -> f64 {
    let along = to - from;
    let share = ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (point - from - along * share).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::world::Wall;
    use std::f64::consts::PI;

    fn world(walls: &[&[[f64; 2]]]) -> Obstacles {
        let walls = walls.iter().map(|points| Wall { points: points.to_vec(), closed: false }).collect();
        Obstacles::new(&World { walls, ..World::default() })
    }

    #[test]
    fn a_wall_that_touches_another_cuts_it_and_makes_two_concave_corners() {
        let obstacles = world(&[&[[0.0, -1.0], [0.0, 1.0]], &[[0.0, 0.0], [2.0, 0.0]]]);
        assert_eq!(obstacles.segments.len(), 3);
        let corner = obstacles.corners.iter().find(|corner| corner.at_m.norm() < 1e-9).unwrap();
        assert!((corner.sector(0.7).unwrap().opening_rad - PI / 2.0).abs() < 1e-12);
        assert!((corner.sector(-0.7).unwrap().opening_rad - PI / 2.0).abs() < 1e-12);
        assert!((corner.sector(PI).unwrap().opening_rad - PI).abs() < 1e-12);
    }

    #[test]
    fn crossing_and_overlapping_walls_are_cut_once() {
        let crossed = world(&[&[[-1.0, 0.0], [1.0, 0.0]], &[[0.0, -1.0], [0.0, 1.0]]]);
        assert_eq!(crossed.segments.len(), 4);
        let overlapping = world(&[&[[0.0, 0.0], [2.0, 0.0]], &[[1.0, 0.0], [3.0, 0.0]]]);
        assert_eq!(overlapping.segments.len(), 3);
    }

    #[test]
    fn the_end_of_a_wall_has_a_full_turn_around_it() {
        let obstacles = world(&[&[[0.0, 0.0], [1.0, 0.0]]]);
        let end = &obstacles.corners[0];
        assert_eq!(end.sector(2.0).unwrap().opening_rad, 2.0 * PI);
    }

    #[test]
    fn a_point_on_the_blocking_wall_itself_is_seen() {
        let obstacles = world(&[&[[1.0, -1.0], [1.0, 1.0]]]);
        let origin = Vector2::zeros();
        assert!(!obstacles.block(origin, Vector2::new(1.0, 0.2)));
        assert!(obstacles.block(origin, Vector2::new(1.1, 0.2)));
        assert!(!obstacles.block(origin, Vector2::new(1.1, 1.3)));
    }
}
