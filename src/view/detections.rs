//! What the detectors found as JSON in the robot's frame, for the page: reflectors, what is free around the robot, the obstacle on the
//! planned way, objects and the occupied cells of the map.
//!
//! Goes in: the newest of each topic. Comes out: one object, or null for what was never heard. Turns what lies in the frame of
//! odometry into the robot's with the pose that came with it, so that the page only draws.

use crate::geometry::{Pose2, wrap_angle_rad};
use crate::io::wire::detections::{MAP_CELLS, Objects, Obstacle, Scan, follower_name};
use nalgebra::{Matrix2, Vector2};
use serde_json::{Value, json};

/// A cell this sure is drawn as occupied, per cent.
const OCCUPIED: i16 = 65;
/// Ellipses show this many standard deviations.
const ELLIPSE_SIGMAS: f64 = 2.0;

fn ms(t_ns: u64) -> f64 {
    t_ns as f64 * 1e-6
}

/// To the millimetre: nobody sees more, and the message is half as long.
fn short(value_m: f64) -> f64 {
    (value_m * 1e3).round() / 1e3
}

/// A scan: reflectors, and how far each bearing is known to be free.
#[must_use]
pub fn scan_json(scan: &Scan) -> Value {
    let peaks = (0..scan.peak_count.min(scan.peak_x_m.len() as u32) as usize).map(|index| {
        let (x_m, y_m) = (f64::from(scan.peak_x_m[index]), f64::from(scan.peak_y_m[index]));
        json!([short(x_m), short(y_m), scan.peak_sensor[index]])
    });
    json!({
        "emitted_ms": ms(scan.t_monotonic_ns),
        "first_rad": scan.bearing_first_rad,
        "step_rad": scan.bearing_step_rad,
        "near_m": scan.range_min_m,
        "far_m": scan.range_max_m,
        "free_m": scan.free_m.iter().map(|free_m| short(f64::from(*free_m))).collect::<Vec<_>>(),
        "peaks": peaks.collect::<Vec<_>>(),
    })
}

/// Where the objects were seen from, in their own frame.
fn seen_from(objects: &Objects) -> Pose2 {
    match objects.frame {
        0 => Pose2 { x_m: objects.robot_x_m, y_m: objects.robot_y_m, heading_rad: objects.robot_heading_rad },
        _ => Pose2::default(),
    }
}

/// Objects as ellipses, and the map's occupied cells.
#[must_use]
pub fn objects_json(objects: &Objects) -> Value {
    let pose = seen_from(objects);
    let listed = (0..(objects.object_count as usize).min(objects.x_m.len())).map(|index| {
        let place_m = pose.local_from_parent(Vector2::new(objects.x_m[index], objects.y_m[index]));
        let spread = Matrix2::new(
            objects.variance_x_m2[index],
            objects.covariance_xy_m2[index],
            objects.covariance_xy_m2[index],
            objects.variance_y_m2[index],
        );
        let (long_m, wide_m, angle_rad) = ellipse(&spread);
        json!({
            "x_m": short(place_m.x),
            "y_m": short(place_m.y),
            "long_m": short(long_m),
            "wide_m": short(wide_m),
            "angle_rad": wrap_angle_rad(angle_rad - pose.heading_rad),
            "score": objects.score[index],
        })
    });
    let occupied = objects.map.iter().enumerate().filter(|(_, cell)| **cell >= OCCUPIED).map(|(index, _)| {
        let (row, column) = ((index / MAP_CELLS) as f64, (index % MAP_CELLS) as f64);
        let middle_m = Vector2::new(objects.map_x_m + column * objects.cell_m, objects.map_y_m + row * objects.cell_m);
        let middle_m = pose.local_from_parent(middle_m);
        json!([short(middle_m.x), short(middle_m.y)])
    });
    json!({
        "emitted_ms": ms(objects.t_monotonic_ns),
        "objects": listed.collect::<Vec<_>>(),
        "cell_m": objects.cell_m,
        "cell_angle_rad": -pose.heading_rad,
        "occupied": occupied.collect::<Vec<_>>(),
    })
}

/// Half axes and direction of the longer one of the ellipse of [`ELLIPSE_SIGMAS`].
fn ellipse(spread: &Matrix2<f64>) -> (f64, f64, f64) {
    let eigen = spread.symmetric_eigen();
    let longer = usize::from(eigen.eigenvalues[1] > eigen.eigenvalues[0]);
    let half_m = |index: usize| ELLIPSE_SIGMAS * eigen.eigenvalues[index].max(0.0).sqrt();
    let axis = eigen.eigenvectors.column(longer);
    (half_m(longer), half_m(1 - longer), axis.y.atan2(axis.x))
}

/// The obstacle on the planned way and the way round it. `objects` tells where the robot was.
#[must_use]
pub fn obstacle_json(obstacle: &Obstacle, objects: Option<&Objects>) -> Value {
    let pose = objects.map(seen_from);
    let local = |x_m: f64, y_m: f64| {
        let place_m = pose?.local_from_parent(Vector2::new(x_m, y_m));
        Some(json!([short(place_m.x), short(place_m.y)]))
    };
    let route = (0..(obstacle.route_count as usize).min(obstacle.route_x_m.len()))
        .filter_map(|index| local(obstacle.route_x_m[index], obstacle.route_y_m[index]));
    let place = (obstacle.detected != 0).then(|| local(obstacle.x_m, obstacle.y_m)).flatten();
    json!({
        "emitted_ms": ms(obstacle.t_monotonic_ns),
        "follower": follower_name(obstacle.follower),
        "detected": obstacle.detected != 0,
        "blind": obstacle.blind != 0,
        "place": place,
        "route": route.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_and_cells_come_out_in_the_robots_frame() {
        let mut objects = Objects::blank();
        (objects.robot_x_m, objects.robot_y_m, objects.robot_heading_rad) = (2.0, 1.0, std::f64::consts::FRAC_PI_2);
        objects.object_count = 1;
        (objects.x_m[0], objects.y_m[0]) = (2.0, 2.5);
        (objects.variance_x_m2[0], objects.variance_y_m2[0]) = (0.04, 0.0001);
        (objects.map_x_m, objects.map_y_m, objects.cell_m) = (0.0, 0.0, 0.2);
        objects.map[12 * MAP_CELLS + 10] = 90;
        let told = objects_json(&objects);
        let object = &told["objects"][0];
        assert_eq!((&object["x_m"], &object["y_m"]), (&json!(1.5), &json!(0.0)), "straight ahead");
        assert_eq!((&object["long_m"], &object["wide_m"]), (&json!(0.4), &json!(0.02)));
        let angle_rad = object["angle_rad"].as_f64().expect("angle");
        assert!((angle_rad.abs() - std::f64::consts::FRAC_PI_2).abs() < 1e-9, "the long axis lies across the way");
        assert_eq!(told["occupied"], json!([[1.4, 0.0]]));
        objects.frame = 1;
        assert_eq!(objects_json(&objects)["objects"][0]["x_m"], json!(2.0), "in the robot's frame already");
    }

    #[test]
    fn a_way_round_is_drawn_only_where_it_is_known_where_the_robot_was() {
        let mut obstacle = Obstacle { detected: 1, x_m: 3.0, route_count: 2, follower: 2, ..Obstacle::blank() };
        (obstacle.route_x_m[0], obstacle.route_x_m[1]) = (2.0, 4.0);
        assert_eq!(obstacle_json(&obstacle, None)["route"], json!([]));
        let objects = Objects { robot_x_m: 1.0, ..Objects::blank() };
        let told = obstacle_json(&obstacle, Some(&objects));
        assert_eq!((&told["place"], &told["route"]), (&json!([2.0, 0.0]), &json!([[1.0, 0.0], [3.0, 0.0]])));
        assert_eq!(told["follower"], "MEASURE");
    }
}
