//! Contract: where the documentation says that paper 003 is wrong, it is: every printed formula, listing and table that is not
//! followed is held against plain geometry, by numbers.

use nalgebra::Vector2;
use noctule::detect::ring::{RingObject, bearing_rad, objects, reading_index};
use noctule::detect::triangulation::{RangeReading, triangulate};
use noctule::detect::{RingParams, ring};
use noctule::geometry::Pose2;

/// The paper's robot: 20 cm across.
const RING_M: f64 = 0.1;
/// A thing off the axis of the pair that hears it.
const THING_M: Vector2<f64> = Vector2::new(0.9, 0.45);

fn transducer(sonar: usize) -> Pose2 {
    let heading_rad = bearing_rad(sonar);
    Pose2 { x_m: RING_M * heading_rad.cos(), y_m: RING_M * heading_rad.sin(), heading_rad }
}

fn range_m(sonar: usize) -> f64 {
    (THING_M - transducer(sonar).position_m()).norm()
}

fn baseline_m() -> f64 {
    (transducer(1).position_m() - transducer(0).position_m()).norm()
}

fn ours() -> Vec<RingObject> {
    let params = RingParams { ring_radius_m: RING_M, cone_deg: 90.0, ..RingParams::default() };
    let mut ranges_m = [None; ring::SONARS];
    (ranges_m[0], ranges_m[1]) = (Some(range_m(0)), Some(range_m(1)));
    objects(&params, &ranges_m, &Pose2::default())
}

#[test]
fn both_of_our_ways_find_the_thing_where_it_is() {
    assert!((ours()[0].position_m - THING_M).norm() < 1e-9);
    let reading = |sonar| RangeReading { transducer: transducer(sonar), range_m: range_m(sonar), range_sigma_m: 1e-6 };
    let fix = triangulate(&reading(0), &reading(1), 90f64.to_radians()).expect("both hear it");
    assert!((fix.position_m - THING_M).norm() < 1e-5);
}

/// (i) to (v), as printed, with D2 for the paper's D^2; of the two signs the one that is nearer to the thing.
fn by_equation_one(ranges_m: [f64; 2], d2: f64) -> Vector2<f64> {
    let (first, second) = (transducer(0).position_m(), transducer(1).position_m());
    let (apart, squared) = (first - second, (first - second).norm_squared());
    let root = (ranges_m[0].powi(2) * squared - d2 * d2).max(0.0).sqrt();
    let across = Vector2::new(-apart.y, apart.x);
    [1.0, -1.0]
        .map(|sign| first + (apart * d2 + across * sign * root) / squared)
        .into_iter()
        .min_by(|a, b| (a - THING_M).norm().total_cmp(&(b - THING_M).norm()))
        .expect("two")
}

#[test]
fn equation_six_exchanges_the_ranges_and_mirrors_the_thing() {
    let (first_m, second_m, baseline_m) = (range_m(0), range_m(1), baseline_m());
    let printed = (first_m.powi(2) - second_m.powi(2) - baseline_m.powi(2)) / 2.0;
    let mended = (second_m.powi(2) - first_m.powi(2) - baseline_m.powi(2)) / 2.0;
    let off_m = |d2: f64| (by_equation_one([first_m, second_m], d2) - THING_M).norm();
    assert!(off_m(mended) < 1e-9, "{}", off_m(mended));
    assert!(off_m(printed) > 0.2, "{}", off_m(printed));
}

#[test]
fn equations_eleven_and_twelve_depend_on_the_unit() {
    // alpha = acos(b / 2) + h, h = sqrt(b^2 / 4 + w^2), with b = 12 cm and w = 10 cm.
    let alpha = |unit: f64| {
        let (b, w): (f64, f64) = (0.12 * unit, 0.1 * unit);
        (b / 2.0).acos() + (b * b / 4.0 + w * w).sqrt()
    };
    assert!(alpha(100.0).is_nan(), "in the paper's centimetres it is no number");
    assert!((alpha(1.0) - alpha(10.0)).abs() > 0.3, "{} {}", alpha(1.0), alpha(10.0));
}

#[test]
fn equation_thirteen_has_plus_for_minus_and_its_listing_leaves_the_baseline_out() {
    let (first_m, second_m, b) = (range_m(0), range_m(1), baseline_m());
    let cosine = (b * b + first_m * first_m - second_m * second_m) / (2.0 * b * first_m);
    let true_m = (THING_M - 0.5 * (transducer(0).position_m() + transducer(1).position_m())).norm();
    let squared_m2 = |sign: f64| first_m * first_m + b * b / 4.0 + sign * first_m * b * cosine;
    assert!((squared_m2(-1.0).sqrt() - true_m).abs() < 1e-12);
    let across_m = (first_m * first_m - second_m * second_m) / (2.0 * b);
    let excess_m2 = squared_m2(1.0) - true_m * true_m;
    assert!((excess_m2 - b * (b + 2.0 * across_m)).abs() < 1e-12 && excess_m2 > 0.01, "{excess_m2}");
    let listing_m = (first_m * first_m + b * b / 4.0 + first_m * cosine).sqrt();
    assert!(listing_m - true_m > 0.05, "{listing_m} for {true_m}");
}

#[test]
fn equation_fourteen_counts_from_the_second_sonars_side() {
    let (first_m, b) = (range_m(0), baseline_m());
    let middle_m = 0.5 * (transducer(0).position_m() + transducer(1).position_m());
    let far_m = (THING_M - middle_m).norm();
    let printed_rad = ((first_m * first_m - b * b / 4.0 - far_m * far_m) / (b * far_m)).acos();
    let angle_rad = |sonar: usize| {
        let to_sonar = transducer(sonar).position_m() - middle_m;
        ((THING_M - middle_m).dot(&to_sonar) / (far_m * to_sonar.norm())).acos()
    };
    assert!((printed_rad - angle_rad(1)).abs() < 1e-9);
    assert!((printed_rad - angle_rad(0)).abs() > 0.1);
}

#[test]
fn the_printed_gate_lets_nothing_pass() {
    // cos(alpha - gamma) <= cos(beta) <= cos(alpha + gamma): for a ring alpha is 75 degrees.
    let alpha_deg = 75.0_f64;
    for gamma_deg in [10.0, 22.5, 45.0] {
        let low = (alpha_deg - gamma_deg).to_radians().cos();
        let high = (alpha_deg + gamma_deg).to_radians().cos();
        let passes = |beta_deg: &usize| (low..=high).contains(&(*beta_deg as f64).to_radians().cos());
        assert_eq!((0..=180).filter(passes).count(), 0);
        let turned = |beta_deg: &usize| (high..=low).contains(&(*beta_deg as f64).to_radians().cos());
        assert!((0..=180).filter(turned).count() > 15, "limits the right way round");
    }
}

#[test]
fn the_constant_baseline_of_12_cm_belongs_to_no_step_of_30_degrees() {
    assert!((baseline_m() - 0.0518).abs() < 1e-4, "{}", baseline_m());
    let step_deg = 2.0 * (0.12_f64 / (2.0 * RING_M)).asin().to_degrees();
    assert!((step_deg - 73.7).abs() < 0.1, "{step_deg}");
    // With 12 cm for b the same two ranges put the thing more than twice too near to the axis.
    let across_m = |b: f64| (range_m(0).powi(2) - range_m(1).powi(2)) / (2.0 * b);
    assert!(across_m(baseline_m()) > 2.0 * across_m(0.12));
}

#[test]
fn table_four_fills_seven_of_twelve_cells_and_table_five_pairs_the_last_sonar_with_the_wrong_one() {
    let mut filled: Vec<usize> = Vec::new();
    for turn in 0..4_usize {
        // n = n - (n - i)
        let n = turn;
        filled.extend(if n == 0 { [n, n + 4, n + 8] } else { [n, n + 1, n + 2] });
    }
    filled.sort_unstable();
    filled.dedup();
    assert_eq!(filled.len(), 7, "{filled:?}");
    let mut ours: Vec<usize> = (0..4).flat_map(|turn| (0..3).map(move |sensor| reading_index(sensor, turn))).collect();
    ours.sort_unstable();
    assert_eq!(ours, (0..12).collect::<Vec<_>>());
    // distanceStorage[i - 10] for i = 11: sonars 11 and 1 look 60 degrees apart, 11 and 0 are neighbours.
    let apart_deg = |sonar: usize| noctule::geometry::wrap_angle_rad(bearing_rad(sonar) - bearing_rad(11)).to_degrees();
    assert!((apart_deg(11 - 10) - 60.0).abs() < 1e-9 && (apart_deg(0) - 30.0).abs() < 1e-9);
}

#[test]
fn equation_sixteen_steps_by_60_degrees_between_pairs_that_are_30_apart() {
    let apart_deg = (bearing_rad(1) - bearing_rad(0)).to_degrees();
    assert!((apart_deg - 30.0).abs() < 1e-9);
    assert!((12.0 * 60.0_f64 - 360.0).abs() > 1.0, "twelve pairs by 60 degrees go round twice");
}

#[test]
fn no_place_of_the_robot_explains_table_seven() {
    let table =
        [(23.36, 60.0, 40.0), (117.88, 20.0, 40.0), (124.35, 100.0, 40.0), (38.82, 40.0, 80.0), (59.16, 60.0, 40.0)];
    // A place is right to half a cell, and D is measured from a point of the robot's rim.
    let slack_cm = 10.0 * 2f64.sqrt() + 10.0;
    let worst_cm = |x_cm: f64, y_cm: f64| {
        let off_cm = table
            .map(|(far_cm, to_x_cm, to_y_cm): (f64, f64, f64)| ((to_x_cm - x_cm).hypot(to_y_cm - y_cm) - far_cm).abs());
        off_cm.into_iter().fold(0.0, f64::max)
    };
    let places = (-200..=400).flat_map(|x| (-200..=400).map(move |y| (f64::from(x), f64::from(y))));
    let least_cm = places.map(|(x_cm, y_cm)| worst_cm(x_cm, y_cm)).fold(f64::INFINITY, f64::min);
    assert!(least_cm > slack_cm, "{least_cm} cm where {slack_cm} are allowed");
}
