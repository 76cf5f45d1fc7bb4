//! Contract: midlines of a world are as far from the walls on both sides as geometry says, meet where corridors meet, and leave out what is
//! too narrow, what runs into corners and what cannot be reached. Also by the command line.

use assert_cmd::Command;
use nalgebra::Vector2;
use noctule::detect::voronoi::{EdgeGraph, EdgesError, edges};
use noctule::service::corridor::wall_pieces;
use noctule::sim::World;
use serde_json::Value;
use std::path::Path;

/// Walls are put on a grid of 0.1 mm; the middle of two of them is as near to the true one, and distances twice as near.
const TOLERANCE_M: f64 = 2e-4;

fn world(walls: &[(&[[f64; 2]], bool)]) -> World {
    let mut text = "[start]\ncorner = [0.0, 0.0]\n".to_owned();
    for (points, closed) in walls {
        text = format!("{text}[[wall]]\npoints = {points:?}\nclosed = {closed}\n");
    }
    World::parse(Path::new("test.toml"), &text).expect("a world")
}

fn graph(world: &World, safe_width_m: f64) -> EdgeGraph {
    edges(&wall_pieces(world, 16), safe_width_m, Vector2::from(world.start.corner)).expect("edges")
}

/// Distances of a point from the walls, each place of a wall once: a corner belongs to two. Written out.
fn distances_m(world: &World, at_m: Vector2<f64>) -> Vec<f64> {
    let mut feet: Vec<Vector2<f64>> = Vec::new();
    for [from, to] in wall_pieces(world, 16) {
        let along = to - from;
        let share = ((at_m - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        let foot = from + along * share;
        if feet.iter().all(|other| (other - foot).norm() > 0.01) {
            feet.push(foot);
        }
    }
    let mut found: Vec<f64> = feet.iter().map(|foot| (at_m - foot).norm()).collect();
    found.sort_by(f64::total_cmp);
    found
}

fn ends(graph: &EdgeGraph, degree: usize) -> usize {
    let count =
        |node: usize| graph.midlines.iter().flat_map(|line| [line.from, line.to]).filter(|end| *end == node).count();
    (0..graph.nodes.len()).filter(|node| count(*node) == degree).count()
}

#[test]
fn a_straight_corridor_has_one_midline_in_its_middle() {
    let world = world(&[(&[[-1.0, -0.6], [5.0, -0.6], [5.0, 0.6], [-1.0, 0.6]], true)]);
    let graph = graph(&world, 0.6);
    assert_eq!((graph.nodes.len(), graph.midlines.len()), (2, 1), "{graph:?}");
    let line = &graph.midlines[0];
    assert!(line.points_m.iter().all(|point| point.y.abs() <= TOLERANCE_M), "{line:?}");
    assert!((line.length_m - 4.8).abs() <= 2.0 * TOLERANCE_M && (line.clearance_m - 0.6).abs() <= TOLERANCE_M);
}

#[test]
fn every_point_is_as_far_from_the_nearest_wall_as_from_one_on_another_side() {
    let t_junction = world(&[(
        &[[-3.0, -0.6], [3.0, -0.6], [3.0, 0.6], [0.5, 0.6], [0.5, 3.0], [-0.5, 3.0], [-0.5, 0.6], [-3.0, 0.6]],
        true,
    )]);
    let found = graph(&t_junction, 0.6);
    assert_eq!((ends(&found, 3), ends(&found, 1), found.midlines.len()), (1, 3, 3), "three arms: {found:?}");
    for point in found.midlines.iter().flat_map(|line| &line.points_m) {
        let distances_m = distances_m(&t_junction, *point);
        assert!(distances_m[1] - distances_m[0] <= 2.0 * TOLERANCE_M, "{point:?}: {distances_m:?}");
    }
    let junction = found.midlines.iter().flat_map(|line| [line.from, line.to]).find(|node| {
        found.midlines.iter().flat_map(|line| [line.from, line.to]).filter(|end| end == node).count() == 3
    });
    let place_m = found.nodes[junction.expect("a junction")].place_m;
    let three_m = distances_m(&t_junction, place_m);
    assert!(place_m.x.abs() <= TOLERANCE_M && three_m[2] - three_m[0] <= 2.0 * TOLERANCE_M, "{place_m:?} {three_m:?}");
}

#[test]
fn what_is_too_narrow_or_cannot_be_reached_is_left_out() {
    let door = |half_m: f64| {
        world(&[
            (&[[-1.0, -1.0], [4.0, -1.0], [4.0, 1.0], [-1.0, 1.0]], true),
            (&[[1.5, -1.0], [1.5, -half_m]], false),
            (&[[1.5, half_m], [1.5, 1.0]], false),
        ])
    };
    let reach_m = |world: &World| {
        let graph = graph(world, 0.6);
        graph.nodes.iter().map(|node| node.place_m.x).fold(f64::NEG_INFINITY, f64::max)
    };
    assert!(reach_m(&door(0.31)) > 2.5, "through a door of 0.62 m");
    assert!(reach_m(&door(0.29)) < 1.5, "not through one of 0.58 m");
}

#[test]
fn a_pillar_is_gone_round_on_both_sides() {
    let mut world = world(&[(&[[-1.0, -1.0], [5.0, -1.0], [5.0, 1.0], [-1.0, 1.0]], true)]);
    world.pillars.push(noctule::sim::Pillar { centre: [2.0, 0.0], radius_m: 0.2 });
    let graph = graph(&world, 0.6);
    let beside = |side: f64| {
        graph.midlines.iter().flat_map(|line| &line.points_m).any(|point| {
            // In the middle between the pillar and the wall; the polygon about the pillar is up to 2 % larger than it.
            (point.x - 2.0).abs() < 0.05 && (side * point.y - 0.6).abs() < 0.01
        })
    };
    assert!(beside(1.0) && beside(-1.0), "{graph:?}");
}

#[test]
fn walls_that_are_none_are_refused() {
    let nan = [[Vector2::new(0.0, f64::NAN), Vector2::new(1.0, 0.0)]];
    assert!(matches!(edges(&nan, 0.6, Vector2::zeros()), Err(EdgesError::Walls { .. })));
    assert_eq!(edges(&[], 0.6, Vector2::zeros()), Ok(EdgeGraph::default()));
}

#[test]
fn the_command_line_prints_and_draws_the_edges_of_every_world() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = folder.path().join("edges.png");
    let run = |world: &str| {
        let output = Command::cargo_bin("noctule")
            .expect("built")
            .args(["detect", "edges", world, "--json", "--plot"])
            .arg(&picture)
            .output()
            .expect("runs");
        assert_eq!(output.status.code(), Some(0), "{world}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).expect("JSON")
    };
    for world in
        ["office", "fixtures/worlds/t_junction.toml", "fixtures/worlds/coverage.toml", "fixtures/worlds/warehouse.toml"]
    {
        let found = run(world);
        let midlines = found["midlines"].as_array().expect("midlines");
        assert!(!midlines.is_empty(), "{world}");
        for midline in midlines {
            assert!(midline["clearance_m"].as_f64().expect("a number") >= 0.3 - 1e-9, "{world}: {midline}");
        }
    }
    assert!(std::fs::metadata(&picture).expect("drawn").len() > 1000);
    let missing =
        Command::cargo_bin("noctule").expect("built").args(["detect", "edges", "none.toml"]).output().expect("runs");
    assert_eq!(missing.status.code(), Some(65));
}
