//! Contract: what paper 001 prints and what cannot be meant: each claim of `detect::projection` about a misprint is computed here from
//! the printed formula, and the printed table decides.

use nalgebra::Vector2;
use noctule::detect::ProjectionParams;
use noctule::detect::projection::{BEARINGS_DEG, Edge, TRANSDUCERS_M, project};
use noctule::geometry::Pose2;

/// Table 1: (reading in millimetres, sonar, printed projection) of figures 4 and 5, on the edge and heading along it.
const TABLE_1: [(f64, usize, f64); 5] =
    [(356.3, 4, 4.0), (419.9, 5, 2.6), (167.4, 4, 7.1), (191.2, 5, 5.9), (292.0, 6, 3.3)];
const RANGE_MAX_MM: f64 = 600.0;
const EDGE: Edge = Edge { start_m: Vector2::new(1.0, 3.0), end_m: Vector2::new(3.0, 3.0) };

fn n1(range_mm: f64) -> f64 {
    -(10.0 / RANGE_MAX_MM) * (range_mm - RANGE_MAX_MM)
}

fn cosine(sonar: usize) -> f64 {
    BEARINGS_DEG[sonar].to_radians().cos()
}

#[test]
fn equation_3_with_its_factor_r_gives_table_1_in_no_unit_and_without_it_in_any() {
    for (range_mm, sonar, printed) in TABLE_1 {
        assert!((n1(range_mm) * cosine(sonar) - printed).abs() <= 0.05, "without r: {printed}");
    }
    // A factor of unit k would have to be the same for every line; what each line would need differs by more than the rounding.
    let needed: Vec<[f64; 2]> = TABLE_1
        .iter()
        .map(|(range_mm, sonar, printed)| {
            let with_r = n1(*range_mm) * range_mm * cosine(*sonar);
            [(printed - 0.05) / with_r, (printed + 0.05) / with_r]
        })
        .collect();
    let (low, high) = (
        needed.iter().map(|[low, _]| *low).fold(0.0, f64::max),
        needed.iter().map(|[_, high]| *high).fold(f64::INFINITY, f64::min),
    );
    assert!(low > 1.5 * high, "some unit would do: {low} to {high}");
    // And nearer would count less: against step 2.
    assert!(n1(100.0) * 100.0 < n1(300.0) * 300.0);
}

#[test]
fn equation_4_compared_by_its_magnitude_would_stop_at_what_lies_behind() {
    let params = ProjectionParams::default();
    let mut ranges_m = [None; 8];
    ranges_m[3] = Some(0.1);
    // The robot turns away from its way: sonar 3 looks back along it.
    let pose = Pose2 { x_m: 2.0, y_m: 3.0, heading_rad: 170_f64.to_radians() };
    let printed = n1(100.0) * (BEARINGS_DEG[3].to_radians() + pose.heading_rad).cos();
    assert!(printed < -params.threshold, "{printed}");
    let found = project(&params, &ranges_m, &pose, &EDGE);
    assert_eq!((found.sonar, found.projections[3]), (None, 0.0));
}

#[test]
fn the_distance_from_an_edge_is_that_of_the_segment() {
    let params = ProjectionParams::default();
    let beyond = Pose2 { x_m: 9.0, y_m: 3.0, heading_rad: 0.0 };
    let line_m = (beyond.position_m() - EDGE.start_m).perp(&EDGE.along()).abs();
    assert_eq!(line_m, 0.0, "on the infinite line it would see");
    assert!(project(&params, &[None; 8], &beyond, &EDGE).blind);
}

#[test]
fn readings_from_the_robots_centre_would_not_give_figure_4() {
    let (range_mm, sonar, printed) = TABLE_1[0];
    let [x_m, y_m] = TRANSDUCERS_M[sonar];
    let bearing_rad = BEARINGS_DEG[sonar].to_radians();
    let echo_m = Vector2::new(x_m, y_m) + range_mm * 1e-3 * Vector2::new(bearing_rad.cos(), bearing_rad.sin());
    let from_centre = n1(echo_m.norm() * 1e3) * cosine(sonar);
    assert!(from_centre < 2.0 && printed > 3.0, "{from_centre}");
}

#[test]
fn in_figure_6_the_projection_is_small_and_not_zero_unless_the_robot_heads_along_the_actual_edge() {
    let params = ProjectionParams::default();
    let mut ranges_m = [None; 8];
    ranges_m[7] = Some(0.264);
    let along_x = Pose2 { x_m: 1.9, y_m: 3.25, heading_rad: 0.0 };
    let along_edge = Pose2 { heading_rad: EDGE.direction_rad(along_x.position_m()), ..along_x };
    let found = |pose: &Pose2| project(&params, &ranges_m, pose, &EDGE);
    let (x, edge) = (found(&along_x), found(&along_edge));
    assert!(x.projections[7] > 0.5 && x.projections[7] < 1.0 && x.sonar.is_none(), "{x:?}");
    assert!(edge.projections[7] < 1e-9 && !edge.blind, "{edge:?}");
}
