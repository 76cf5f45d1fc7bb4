//! Measuring and planning on memories made by hand: every place is known.

use super::*;
use crate::signal::Peak;

const EDGE: Edge = Edge { start_m: Vector2::new(0.0, 0.0), end_m: Vector2::new(4.0, 0.0) };

/// A memory in which a robot that stands at `at_m` on the edge heard all `places` three times.
fn map(at_m: f64, places: &[[f64; 2]]) -> (LocalMap, RobotScan, Pose2) {
    let pose = Pose2 { x_m: at_m, y_m: 0.0, heading_rad: 0.0 };
    let mut scan = RobotScan::unseen();
    scan.peaks.extend(places.iter().map(|place| Peak {
        position_m: pose.local_from_parent(Vector2::from(*place)),
        sensor_m: Vector2::zeros(),
        range_sigma_m: 0.003,
        bearing_sigma_rad: 0.02,
        energy: 0.1,
        sensor_index: 0,
    }));
    let mut map = LocalMap::new();
    (0..3).for_each(|step| map.add(&scan, &pose, 0.1 * f64::from(step)));
    (map, scan, pose)
}

fn width_m(passage: Passage) -> f64 {
    passage.width_m().expect("known")
}

#[test]
fn a_box_on_the_right_wall_leaves_a_passage_on_its_left_and_none_on_its_right() {
    // Walls beside the robot, the box's corner, and where it meets its wall.
    let (map, scan, pose) = map(1.0, &[[1.0, 0.6], [1.0, -0.6], [1.6, -0.15], [1.6, -0.6]]);
    let params = ProjectionParams::default();
    let found = measure(&map, &scan, &pose, &EDGE, Vector2::new(1.6, -0.15), &params);
    assert!(found.in_the_way && !found.far_end_seen, "{found:?}");
    assert!((found.along_near_m - 1.6).abs() < 1e-9 && (found.across_left_m + 0.15).abs() < 1e-9);
    assert!((width_m(found.left) - 0.75).abs() < 1e-9 && width_m(found.right) < 1e-9);
    let route = sub_route(&found, &pose, &EDGE, &params).expect("room");
    // In the middle of what is left, as half a safe width and 8 cm are more; before the box and behind it; back on the edge.
    assert!((route.across_m - 0.225).abs() < 1e-9, "{route:?}");
    let [_, entry, exit, back] = route.points_m;
    assert!(entry.x < 1.6 && exit.x > 1.6 && back.x > exit.x && back.y.abs() < 1e-9, "{route:?}");
}

#[test]
fn the_side_with_the_smaller_detour_is_taken_and_too_narrow_a_passage_is_none() {
    let params = ProjectionParams::default();
    let wide = |pillar_m: f64| {
        let (map, scan, pose) = map(1.0, &[[1.0, 1.2], [1.0, -1.2], [1.6, pillar_m]]);
        let found = measure(&map, &scan, &pose, &EDGE, Vector2::new(1.6, pillar_m), &params);
        sub_route(&found, &pose, &EDGE, &params).expect("room").across_m
    };
    assert!(wide(0.1) < 0.0 && wide(-0.1) > 0.0);
    let (map, scan, pose) = map(1.0, &[[1.0, 0.6], [1.0, -0.6], [1.6, 0.1], [1.6, -0.1]]);
    let found = measure(&map, &scan, &pose, &EDGE, Vector2::new(1.6, -0.1), &params);
    assert!((width_m(found.left) - 0.5).abs() < 1e-9 && (width_m(found.right) - 0.5).abs() < 1e-9, "{found:?}");
    assert_eq!(sub_route(&found, &pose, &EDGE, &params), None);
}

#[test]
fn two_things_with_less_than_the_safe_width_between_them_are_one_and_with_more_two() {
    let params = ProjectionParams::default();
    let (near, scan, pose) = map(1.0, &[[1.0, 1.5], [1.0, -1.5], [1.6, 0.1], [1.7, -0.4]]);
    let one = measure(&near, &scan, &pose, &EDGE, Vector2::new(1.6, 0.1), &params);
    assert!((one.across_left_m - one.across_right_m - 0.5).abs() < 1e-9, "{one:?}");
    let (apart, scan, pose) = map(1.0, &[[1.0, 1.5], [1.0, -1.5], [1.6, 0.1], [1.7, -0.6]]);
    let two = measure(&apart, &scan, &pose, &EDGE, Vector2::new(1.6, 0.1), &params);
    assert!(
        (two.across_left_m - two.across_right_m).abs() < 1e-9 && (width_m(two.right) - 0.7).abs() < 1e-9,
        "{two:?}"
    );
}

#[test]
fn a_side_without_a_wall_is_open_only_where_it_was_seen() {
    let params = ProjectionParams::default();
    let (map, mut scan, pose) = map(1.0, &[[1.0, -0.6], [1.6, -0.15]]);
    let unseen = measure(&map, &scan, &pose, &EDGE, Vector2::new(1.6, -0.15), &params);
    assert_eq!(unseen.left, Passage::Unknown);
    assert_eq!(sub_route(&unseen, &pose, &EDGE, &params), None, "unseen is not free");
    scan.rays.iter_mut().for_each(|ray| ray.free_m = 2.0);
    let seen = measure(&map, &scan, &pose, &EDGE, Vector2::new(1.6, -0.15), &params);
    assert_eq!(seen.left, Passage::Open);
    assert!(sub_route(&seen, &pose, &EDGE, &params).is_some());
}

#[test]
fn what_does_not_reach_into_the_safe_path_is_not_in_the_way() {
    let params = ProjectionParams::default();
    let (map, scan, pose) = map(1.0, &[[1.0, 0.6], [1.0, -0.6], [1.5, -0.35]]);
    assert!(!measure(&map, &scan, &pose, &EDGE, Vector2::new(1.5, -0.35), &params).in_the_way);
}

#[test]
fn the_far_end_is_found_from_beside_and_what_stands_far_behind_is_another_thing() {
    let params = ProjectionParams::default();
    let (before, scan, pose) = map(1.0, &[[1.0, 0.6], [1.6, -0.15]]);
    let measured = measure(&before, &scan, &pose, &EDGE, Vector2::new(1.6, -0.15), &params);
    // Its flank beside the robot, its far corner, the wall beyond its flank, another box.
    let (beside, ..) = map(1.8, &[[1.8, -0.15], [1.95, -0.15], [1.8, -0.6], [2.9, -0.15]]);
    assert!((far_end_m(&beside, &EDGE, &measured, &params) - 1.95).abs() < 1e-9);
}
