//! Contract: the two range-based detectors reproduce what can be computed by hand: the worked numbers of paper 001, and for the ring
//! of paper 003 plain geometry, since its printed formulas contradict each other. Also by the command line.

#[path = "detectors_worked/projection_paper.rs"]
mod projection_paper;
#[path = "detectors_worked/ring_paper.rs"]
mod ring_paper;
#[path = "detectors_worked/route.rs"]
mod route;

use assert_cmd::Command;
use nalgebra::{Matrix2, Vector2};
use noctule::detect::projection::{self, Edge, project};
use noctule::detect::{ProjectionParams, RingParams, ring};
use noctule::geometry::Pose2;
use proptest::prelude::*;
use serde_json::Value;

/// The edge of figures 4 to 6 and readings in millimetres, as the paper gives them.
const EDGE: Edge = Edge { start_m: Vector2::new(1.0, 3.0), end_m: Vector2::new(3.0, 3.0) };

fn readings(given_mm: &[(usize, f64)]) -> [Option<f64>; 8] {
    let mut ranges_m = [None; 8];
    given_mm.iter().for_each(|(sonar, range_mm)| ranges_m[*sonar] = Some(range_mm / 1000.0));
    ranges_m
}

fn pose(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
}

#[test]
fn the_worked_numbers_of_figures_4_and_5_come_out_as_printed() {
    let params = ProjectionParams::default();
    for (readings_mm, at, expected, largest) in [
        (vec![(4, 356.3), (5, 419.9)], pose(1.3, 3.0, 0.0), [0.0, 0.0, 0.0, 0.0, 4.0, 2.6, 0.0, 0.0], 4),
        (vec![(4, 167.4), (5, 191.2), (6, 292.0)], pose(1.5, 3.0, 0.0), [0.0, 0.0, 0.0, 0.0, 7.1, 5.9, 3.3, 0.0], 4),
    ] {
        let found = project(&params, &readings(&readings_mm), &at, &EDGE);
        for (found, expected) in found.projections.iter().zip(expected) {
            // The paper prints one decimal.
            assert!((found - expected).abs() <= 0.05 + 1e-9, "{found} for {expected}");
        }
        assert_eq!((found.sonar, found.blind), (Some(largest), false));
    }
}

#[test]
fn a_wall_square_to_the_way_is_no_obstacle_however_near_and_the_classical_detector_stops_at_it() {
    let params = ProjectionParams::default();
    let walls = readings(&[(0, 10.0), (7, 10.0)]);
    let found = project(&params, &walls, &pose(2.0, 3.0, 0.0), &EDGE);
    assert_eq!(found.sonar, None, "{found:?}");
    assert_eq!(projection::classical(&walls, 0.3), Some(0));
    assert_eq!(projection::classical(&readings(&[(3, 300.0)]), 0.3), None, "at the limit it is none");
    // Figure 6: what stands at a right angle to the way.
    let beside = project(&params, &readings(&[(7, 100.0)]), &pose(1.9, 3.25, 0.0), &EDGE);
    assert!(beside.sonar.is_none() && !beside.blind, "{beside:?}");
}

#[test]
fn beyond_its_distance_from_the_edge_the_detector_is_blind_and_says_so() {
    let params = ProjectionParams::default();
    let ahead = readings(&[(3, 50.0), (4, 50.0)]);
    let at = |y_m: f64| project(&params, &ahead, &pose(1.5, y_m, 0.0), &EDGE);
    let (edge, limit, beyond) = (at(3.0), at(3.3 - 1e-9), at(3.3 + 1e-6));
    // N2 falls from 1 on the edge to 0.4 at the limit.
    let way_rad = |y_m: f64| (3.0_f64 - y_m).atan2(1.5);
    let expected = edge.projections[3] * 0.4 * (10_f64.to_radians() - way_rad(3.3)).cos() / 10_f64.to_radians().cos();
    assert!((limit.projections[3] - expected).abs() < 1e-6, "{limit:?}");
    assert!(edge.sonar.is_some() && !edge.blind && !limit.blind);
    assert_eq!((beyond.sonar, beyond.blind, beyond.projections), (None, true, [0.0; 8]));
    // Past its ends the distance of a segment is that of the end.
    assert!(project(&params, &ahead, &pose(0.6, 3.0, 0.0), &EDGE).blind);
}

#[test]
fn a_reading_that_is_no_number_can_only_stop() {
    let found = project(&ProjectionParams::default(), &[Some(f64::NAN); 8], &pose(1.5, 3.0, 0.0), &EDGE);
    assert!(found.sonar.is_some(), "{found:?}");
    assert_eq!(projection::classical(&[Some(f64::NAN); 8], 0.3), Some(0));
}

/// What each sonar of a ring reads of one point, by plain distances.
fn readings_of(params: &RingParams, at: &Pose2, point_m: Vector2<f64>) -> [Option<f64>; 12] {
    std::array::from_fn(|sonar| {
        let bearing_rad = at.heading_rad + (30.0 * sonar as f64).to_radians();
        let place_m =
            Vector2::new(at.x_m, at.y_m) + params.ring_radius_m * Vector2::new(bearing_rad.cos(), bearing_rad.sin());
        let to_m = point_m - place_m;
        let off_rad = noctule::geometry::wrap_angle_rad(to_m.y.atan2(to_m.x) - bearing_rad);
        (off_rad.abs() <= 0.5 * params.cone_deg.to_radians()).then_some(to_m.norm())
    })
}

proptest! {
    #[test]
    fn a_point_that_two_neighbours_hear_is_found_where_it_is(
        range_m in 0.3..4.0_f64, bearing_deg in 0.0..360.0_f64, x_m in -3.0..3.0_f64, y_m in -3.0..3.0_f64, heading_deg in -180.0..180.0_f64,
    ) {
        let params = RingParams { cone_deg: 45.0, ..RingParams::default() };
        let at = pose(x_m, y_m, heading_deg);
        let point_m = at.parent_from_local(Vector2::new(range_m * bearing_deg.to_radians().cos(), range_m * bearing_deg.to_radians().sin()));
        let ranges_m = readings_of(&params, &at, point_m);
        let heard = (0..12).filter(|sonar| ranges_m[*sonar].is_some() && ranges_m[(sonar + 1) % 12].is_some()).count();
        let found = ring::objects(&params, &ranges_m, &at);
        prop_assert_eq!(found.len(), heard);
        for object in found {
            // The roots of nearly equal readings lose digits across the line of sight: 4 m / (2 x 0.08 m) of them.
            prop_assert!((object.position_m - point_m).norm() < 1e-9, "{:?} for {:?}", object.position_m, point_m);
        }
    }

    #[test]
    fn the_covariance_is_that_of_finite_differences(range_m in 0.4..3.0_f64, off_deg in -6.0..6.0_f64, first in 0_usize..12) {
        let params = RingParams { cone_deg: 60.0, ..RingParams::default() };
        let at = pose(0.4, -0.2, 17.0);
        let bearing_rad = (30.0 * first as f64 + 15.0 + off_deg).to_radians();
        let point_m = at.parent_from_local(range_m * Vector2::new(bearing_rad.cos(), bearing_rad.sin()));
        let all_m = readings_of(&params, &at, point_m);
        let pair = [first, (first + 1) % 12];
        let only: [Option<f64>; 12] = std::array::from_fn(|sonar| all_m[sonar].filter(|_| pair.contains(&sonar)));
        let place = |ranges_m: &[Option<f64>; 12]| ring::objects(&params, ranges_m, &at).first().map(|object| object.position_m);
        let step_m = 1e-7;
        let mut derivative = Matrix2::zeros();
        for (column, sonar) in pair.into_iter().enumerate() {
            let moved = |by_m: f64| {
                let mut ranges_m = only;
                ranges_m[sonar] = ranges_m[sonar].map(|range_m| range_m + by_m);
                place(&ranges_m)
            };
            let (Some(after_m), Some(before_m)) = (moved(step_m), moved(-step_m)) else { return Ok(()) };
            derivative.set_column(column, &((after_m - before_m) / (2.0 * step_m)));
        }
        let expected = derivative * derivative.transpose() * params.range_noise_m.powi(2);
        let found = ring::objects(&params, &only, &at)[0].covariance_m2;
        prop_assert!((found - expected).norm() < 1e-5 * expected.norm(), "{} for {}", found, expected);
    }
}

#[test]
fn at_one_metre_a_centimetre_of_noise_is_twelve_and_more_across() {
    let params = RingParams::default();
    let object = ring::objects(
        &params,
        &readings_of(&params, &pose(0.0, 0.0, 0.0), Vector2::from([0.9659, 0.2588])),
        &pose(0.0, 0.0, 0.0),
    );
    let axis = Vector2::new(15_f64.to_radians().cos(), 15_f64.to_radians().sin());
    let across = Vector2::new(-axis.y, axis.x);
    let deviation_m = |along: Vector2<f64>| (along.transpose() * object[0].covariance_m2 * along)[0].sqrt();
    assert!((0.12..0.27).contains(&deviation_m(across)), "{} m across", deviation_m(across));
    assert!(deviation_m(axis) < 0.011, "{} m along", deviation_m(axis));
}

#[test]
fn readings_that_no_point_explains_are_no_object() {
    let params = RingParams::default();
    let at = pose(0.0, 0.0, 0.0);
    let pair = |first: Option<f64>, second: Option<f64>| {
        let mut ranges_m = [None; 12];
        (ranges_m[0], ranges_m[1]) = (first, second);
        ring::objects(&params, &ranges_m, &at).len()
    };
    assert_eq!(pair(Some(1.0), Some(1.0)), 1);
    assert_eq!(pair(Some(1.0), None), 0, "one of two");
    assert_eq!(pair(Some(1.0), Some(1.2)), 0, "farther apart than the baseline");
    assert_eq!(pair(Some(0.01), Some(0.01)), 0, "nearer together than the baseline");
    assert_eq!(pair(Some(f64::NAN), Some(1.0)), 0, "no number");
    // Within the baseline's difference and yet far outside both cones.
    assert_eq!(pair(Some(1.0), Some(1.07)), 0, "outside the cones");
}

#[test]
fn four_turns_of_three_sensors_fill_every_reading_once() {
    let mut filled: Vec<usize> =
        (0..4).flat_map(|turn| (0..3).map(move |sensor| ring::reading_index(sensor, turn))).collect();
    assert_eq!(&filled[..3], [0, 4, 8]);
    filled.sort_unstable();
    assert_eq!(filled, (0..12).collect::<Vec<_>>());
}

fn detect(detector: &str, input: &str) -> (Option<i32>, Value, String) {
    let output = Command::cargo_bin("noctule")
        .expect("built")
        .args(["detect", detector])
        .write_stdin(input)
        .output()
        .expect("runs");
    let value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code(), value, String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn the_command_line_takes_and_gives_the_json_of_the_contract() {
    let input = r#"{"ranges_m": [null, null, null, null, 0.3563, 0.4199, null, null],
        "pose": {"x_m": 1.3, "y_m": 3.0, "heading_deg": 0.0}, "edge": [[1.0, 3.0], [3.0, 3.0]]}"#;
    let (code, found, _) = detect("projection", input);
    assert_eq!(code, Some(0));
    assert_eq!((&found["detected"], &found["sonar"], &found["blind"]), (&true.into(), &4.into(), &false.into()));
    assert_eq!(found["projections"].as_array().map(Vec::len), Some(8));
    let (_, nothing, _) = detect("projection", &input.replace("0.3563", "0.59").replace("0.4199", "0.61"));
    assert_eq!((&nothing["detected"], &nothing["sonar"]), (&false.into(), &Value::Null));

    let input = r#"{"ranges_m": [1, 1, null, null, null, null, null, null, null, null, null, null], "ring_radius_m": 0.2, "cone_deg": 40,
        "pose": {"x_m": 1.0, "y_m": 2.0, "heading_deg": 75.0}}"#;
    let (code, found, _) = detect("ring", input);
    assert_eq!(code, Some(0));
    let object = &found["objects"][0];
    // Both on the axis at 75 + 15 degrees: straight up.
    assert!((object["x_m"].as_f64().expect("x") - 1.0).abs() < 1e-9 && object["y_m"].as_f64().expect("y") > 3.1);
    assert_eq!(object["pair"], serde_json::json!([0, 1]));
    assert_eq!(object["covariance"].as_array().map(Vec::len), Some(2));
}

#[test]
fn an_input_that_is_none_is_refused_by_name_with_65() {
    let sound = r#"{"ranges_m": [1, 1, 1, 1, 1, 1, 1, 1], "pose": {"x_m": 0, "y_m": 0, "heading_deg": 0}, "edge": [[0, 0], [1, 0]]}"#;
    assert_eq!(detect("projection", sound).0, Some(0));
    for (change, to, named) in [
        ("\"ranges_m\": [1,", "\"ranges_m\": [", "array of length 8"),
        ("[1, 1,", "[-1, 1,", "ranges_m[0]"),
        ("[1, 1,", "[\"near\", 1,", "line 1"),
        ("\"x_m\": 0", "\"x_m\": 1e300", "pose.x_m"),
        ("\"heading_deg\": 0", "\"heading\": 0", "heading"),
        ("[1, 0]]", "[0, 0]]", "edge"),
        ("{\"ranges_m\"", "{\"extra\": 1, \"ranges_m\"", "extra"),
        (sound, "", "found nothing"),
        (sound, "[]", "standard input"),
    ] {
        let (code, _, said) = detect("projection", &sound.replacen(change, to, 1));
        assert!(
            code == Some(65) && said.contains(named) && said.contains("standard input"),
            "{change} -> {to}: {code:?} {said}"
        );
    }
    let ring = r#"{"ranges_m": [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], "ring_radius_m": -1, "pose": {"x_m": 0, "y_m": 0, "heading_deg": 0}}"#;
    let (code, _, said) = detect("ring", ring);
    assert!(code == Some(65) && said.contains("ring_radius_m: found -1"), "{code:?} {said}");
}
