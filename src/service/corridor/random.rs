//! Random corridors: 1.2 m wide, with bends, and 0 to 3 obstacles of random size in them.
//!
//! Goes in: a seed. Comes out: a [`Corridor`] whose truth is known from how it was drawn. Obstacles stand clear of the limits between in
//! the way and beside, and between passable and not, by 5 cm: what a tape measure could not tell apart is no question.

use super::{Corridor, Obstacle};
use crate::detect::projection::Edge;
use crate::sim::{Pillar, Start, Wall, WantedVelocity, World};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::f64::consts::FRAC_PI_4;

/// Width of a corridor.
const WIDTH_M: f64 = 1.2;
/// How far a corridor goes on beyond both ends of the path.
const END_M: f64 = 0.7;
/// Straight pieces, shortest and longest.
const PIECE_M: [f64; 2] = [3.0, 4.4];
/// Least distance of an obstacle from a bend or an end, and from the next.
const FROM_BEND_M: f64 = 1.1;
const FROM_OTHER_M: f64 = 1.9;
/// Distance from the limits of what is in the way and what can be passed.
const MARGIN_M: f64 = 0.05;
/// Longest time of a run.
const TIME_LIMIT_S: f64 = 180.0;

/// Draws a corridor.
pub(super) fn corridor(seed: u64, safe_width_m: f64) -> Corridor {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(3);
    let path_m = path(&mut random);
    let places = places(&path_m, &mut random);
    let mut world = World {
        walls: vec![hull(&path_m)],
        time_limit_s: TIME_LIMIT_S,
        input: WantedVelocity { linear_m_s: 0.0, angular_rad_s: 0.0 },
        guidance: false,
        start: start(&path_m),
        ..World::default()
    };
    let mut obstacles = Vec::new();
    for (edge, along_m) in places {
        let obstacle = obstacle(&edge, along_m, safe_width_m, &mut random);
        if let [centre_m] = obstacle.points_m[..] {
            world.pillars.push(Pillar { centre: centre_m.into(), radius_m: obstacle.radius_m });
        } else {
            let points = obstacle.points_m.iter().map(|point| (*point).into()).collect();
            world.walls.push(Wall { points, closed: true });
        }
        obstacles.push(obstacle);
    }
    Corridor { world, path_m: path_m.iter().map(|point| (*point).into()).collect(), obstacles }
}

fn between(random: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * random.random::<f64>()
}

/// Two or three straight pieces with bends of 45 or 90 degrees.
fn path(random: &mut ChaCha8Rng) -> Vec<Vector2<f64>> {
    let mut heading_rad = 0.0;
    let mut path_m = vec![Vector2::zeros()];
    let count = if random.random::<f64>() < 0.5 { 2 } else { 3 };
    for index in 0..count {
        if index > 0 {
            let eighths = if random.random::<f64>() < 0.7 { 2.0 } else { 1.0 };
            let side = if random.random::<f64>() < 0.5 { 1.0 } else { -1.0 };
            heading_rad += side * eighths * FRAC_PI_4;
        }
        let length_m = between(random, PIECE_M);
        path_m.push(path_m[index] + length_m * Vector2::new(f64::cos(heading_rad), f64::sin(heading_rad)));
    }
    path_m
}

/// The walls: half a width to either side of the path, mitred, closed beyond its ends.
fn hull(path_m: &[Vector2<f64>]) -> Wall {
    let last = path_m.len() - 1;
    let along = |index: usize| (path_m[index + 1] - path_m[index]).normalize();
    let left = |along: Vector2<f64>| Vector2::new(-along.y, along.x);
    let side = |side: f64| {
        (0..=last).map(move |index| {
            let offset = match index {
                0 => left(along(0)) * side - along(0) * (2.0 * END_M / WIDTH_M),
                index if index == last => left(along(last - 1)) * side + along(last - 1) * (2.0 * END_M / WIDTH_M),
                index => {
                    let (before, after) = (left(along(index - 1)), left(along(index)));
                    (before + after) / (1.0 + before.dot(&after)) * side
                }
            };
            path_m[index] + 0.5 * WIDTH_M * offset
        })
    };
    let around = side(1.0).chain(side(-1.0).rev());
    Wall { points: around.map(Into::into).collect(), closed: true }
}

/// A little off the path and askew, as a robot stands that somebody put there.
fn start(path_m: &[Vector2<f64>]) -> Start {
    let corner_m = path_m[0] - Vector2::repeat(0.03);
    Start { corner: corner_m.into(), size: [0.06, 0.06], heading_deg: 0.0, heading_spread_deg: 3.0 }
}

/// Where obstacles stand: edge and distance from its start.
fn places(path_m: &[Vector2<f64>], random: &mut ChaCha8Rng) -> Vec<(Edge, f64)> {
    let wanted = (4.0 * random.random::<f64>()) as usize;
    let edges: Vec<Edge> = path_m.windows(2).map(|pair| Edge { start_m: pair[0], end_m: pair[1] }).collect();
    let mut places: Vec<(usize, f64)> = Vec::new();
    for _ in 0..100 {
        if places.len() == wanted {
            break;
        }
        let index = (edges.len() as f64 * random.random::<f64>()) as usize;
        let along_m = between(random, [FROM_BEND_M, edges[index].length_m() - FROM_BEND_M]);
        let clear = |(other, other_m): &(usize, f64)| *other != index || (other_m - along_m).abs() >= FROM_OTHER_M;
        if places.iter().all(clear) {
            places.push((index, along_m));
        }
    }
    places.into_iter().map(|(index, along_m)| (edges[index], along_m)).collect()
}

/// An obstacle of one of four kinds: in the way with room beside it, in the way without, beside the way, a pillar in the way.
fn obstacle(edge: &Edge, along_m: f64, safe_width_m: f64, random: &mut ChaCha8Rng) -> Obstacle {
    let (half_m, half_safe_m) = (0.5 * WIDTH_M, 0.5 * safe_width_m);
    let side = if random.random::<f64>() < 0.5 { 1.0 } else { -1.0 };
    let length_m = between(random, [0.15, 0.5]);
    // How far a box reaches from its wall into the corridor.
    let [reaches, passes] = [half_m - half_safe_m, WIDTH_M - safe_width_m];
    let stands = |depth_m: f64, passable: bool, in_the_way: bool| {
        let corner = |x_m: f64, y_m: f64| edge.point_m(Vector2::new(along_m + x_m, side * y_m));
        let (near_m, far_m) = (-0.5 * length_m, 0.5 * length_m);
        let points_m = vec![
            corner(near_m, half_m),
            corner(far_m, half_m),
            corner(far_m, half_m - depth_m),
            corner(near_m, half_m - depth_m),
        ];
        Obstacle { points_m, radius_m: 0.0, in_the_way, passable }
    };
    match random.random::<f64>() {
        kind if kind < 0.4 => stands(between(random, [reaches + MARGIN_M, passes - MARGIN_M]), true, true),
        kind if kind < 0.5 => stands(between(random, [passes + MARGIN_M, passes + 0.3]), false, true),
        kind if kind < 0.75 => stands(between(random, [0.08, reaches - MARGIN_M]), true, false),
        _ => {
            let radius_m = between(random, [0.04, 0.12]);
            // Its edge reaches into the safe path, and leaves the safe width on the other side.
            let nearest_m = half_safe_m - MARGIN_M + radius_m;
            let farthest_m = half_m - (WIDTH_M - safe_width_m) + MARGIN_M + radius_m;
            let across_m = between(random, [farthest_m.min(nearest_m), nearest_m]);
            let centre_m = edge.point_m(Vector2::new(along_m, side * across_m));
            Obstacle { points_m: vec![centre_m], radius_m, in_the_way: true, passable: true }
        }
    }
}
