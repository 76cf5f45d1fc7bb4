//! Contract: a shape holds exactly the points its definition names, edges included, and a ray begins where it first
//! does. The oracles here are the definitions in words, polar samples, marching along rays and rotation.

use super::*;
use proptest::prelude::*;
use std::f64::consts::PI;

fn point(x: f64, y: f64) -> Vector2<f64> {
    Vector2::new(x, y)
}

fn polar(centre: [f64; 2], radius: f64, angle_deg: f64) -> Vector2<f64> {
    let angle = angle_deg / 180.0 * PI;
    point(centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin())
}

fn examples() -> Vec<Shape> {
    vec![
        Shape::Rectangle { x_m: [0.2, 1.5], y_m: [-0.4, 0.3] },
        Shape::Circle { centre_m: [0.3, -0.2], radius_m: 0.7 },
        Shape::HalfCircle { centre_m: [0.1, 0.2], radius_m: 0.8, heading_deg: 35.0 },
        Shape::Sector { centre_m: [-0.1, 0.1], radius_m: [0.3, 1.1], bearing_deg: [-20.0, 75.0] },
        Shape::Sector { centre_m: [0.0, 0.0], radius_m: [0.2, 0.9], bearing_deg: [40.0, -60.0] },
        Shape::Sector { centre_m: [0.0, 0.0], radius_m: [0.5, 0.9], bearing_deg: [-180.0, 180.0] },
        Shape::Trapezoid { x_m: [0.1, 1.2], half_width_m: [0.2, 0.9] },
        Shape::Trapezoid { x_m: [0.1, 1.2], half_width_m: [0.0, 0.5] },
        Shape::Polygon { points_m: vec![[0.0, 0.0], [1.0, 0.1], [0.4, 0.4], [0.6, 1.1], [-0.5, 0.7]] },
    ]
}

#[test]
fn each_shape_holds_its_edge_and_nothing_a_millimetre_beyond() {
    let circle = Shape::Circle { centre_m: [0.3, -0.2], radius_m: 0.7 };
    let half = Shape::HalfCircle { centre_m: [0.1, 0.2], radius_m: 0.8, heading_deg: 35.0 };
    let sector = Shape::Sector { centre_m: [-0.1, 0.1], radius_m: [0.3, 1.1], bearing_deg: [-20.0, 75.0] };
    for angle in 0..360 {
        let angle = f64::from(angle);
        assert!(circle.contains(polar([0.3, -0.2], 0.7, angle)));
        assert!(!circle.contains(polar([0.3, -0.2], 0.701, angle)));
        let on_half = (-55.0..=125.0).contains(&(if angle > 180.0 { angle - 360.0 } else { angle }));
        assert_eq!(half.contains(polar([0.1, 0.2], 0.8, angle)), on_half, "at {angle} deg");
        assert!(!half.contains(polar([0.1, 0.2], 0.801, angle)));
        let on_sector = angle <= 75.0 || angle >= 340.0;
        assert_eq!(sector.contains(polar([-0.1, 0.1], 1.1, angle)), on_sector, "at {angle} deg");
        assert_eq!(sector.contains(polar([-0.1, 0.1], 0.3, angle)), on_sector, "at {angle} deg");
        assert!(
            !sector.contains(polar([-0.1, 0.1], 1.101, angle)) && !sector.contains(polar([-0.1, 0.1], 0.299, angle))
        );
    }
    let trapezoid = Shape::Trapezoid { x_m: [0.1, 1.2], half_width_m: [0.2, 0.9] };
    for step in 0..=100 {
        let (x, half_width) = (0.1 + 1.1 * f64::from(step) / 100.0, 0.2 + 0.7 * f64::from(step) / 100.0);
        assert!(trapezoid.contains(point(x, half_width)) && trapezoid.contains(point(x, -half_width)));
        assert!(
            !trapezoid.contains(point(x, half_width + 0.002)) && !trapezoid.contains(point(x, -half_width - 0.002))
        );
    }
}

#[test]
fn a_sector_across_the_back_holds_what_lies_counter_clockwise_between_its_bearings() {
    let sector = Shape::Sector { centre_m: [0.0, 0.0], radius_m: [0.0, 1.0], bearing_deg: [170.0, -170.0] };
    assert!(sector.contains(point(-0.5, 0.0)) && sector.contains(point(0.0, 0.0)));
    assert!(!sector.contains(point(0.5, 0.0)) && !sector.contains(point(0.0, 0.5)));
}

#[test]
fn an_infinite_strip_has_no_end_and_a_ray_enters_it() {
    let strip = Shape::Rectangle { x_m: [1.0, f64::INFINITY], y_m: [-0.5, 0.5] };
    strip.validate("s").unwrap();
    assert!(strip.contains(point(1e6, 0.5)) && !strip.contains(point(0.9, 0.0)) && !strip.contains(point(2.0, 0.6)));
    assert_eq!(strip.first_hit_m(point(0.0, 0.0), point(1.0, 0.0)), Some(1.0));
    let diagonal = point(0.6, -0.8);
    assert!((strip.first_hit_m(point(1.0, 2.1), diagonal).unwrap() - 2.0).abs() < 1e-12);
    assert_eq!(strip.first_hit_m(point(0.0, 0.0), point(-1.0, 0.0)), None);
}

#[test]
fn nan_lies_in_no_shape_and_a_nan_ray_meets_none() {
    let everywhere =
        Shape::Rectangle { x_m: [f64::NEG_INFINITY, f64::INFINITY], y_m: [f64::NEG_INFINITY, f64::INFINITY] };
    for shape in examples().iter().chain([&everywhere]) {
        for bad in [point(f64::NAN, 0.0), point(0.5, f64::NAN), point(f64::INFINITY, 0.0)] {
            assert!(!shape.contains(bad), "{shape:?} holds {bad:?}");
            assert_eq!(shape.first_hit_m(bad, point(1.0, 0.0)), None);
        }
        assert_eq!(shape.first_hit_m(point(9.0, 9.0), point(f64::NAN, 1.0)), None.or(everywhere_hit(shape)));
    }
}

fn everywhere_hit(shape: &Shape) -> Option<f64> {
    shape.contains(point(9.0, 9.0)).then_some(0.0)
}

#[test]
fn validate_names_the_key_of_each_bad_number() {
    let nan = f64::NAN;
    let cases = [
        (Shape::Rectangle { x_m: [1.0, 0.0], y_m: [0.0, 1.0] }, "r.x_m"),
        (Shape::Rectangle { x_m: [0.0, 1.0], y_m: [0.0, nan] }, "r.y_m"),
        (Shape::Circle { centre_m: [0.0, nan], radius_m: 1.0 }, "r.centre_m"),
        (Shape::Circle { centre_m: [0.0, 0.0], radius_m: 0.0 }, "r.radius_m"),
        (Shape::HalfCircle { centre_m: [0.0, 0.0], radius_m: -1.0, heading_deg: 0.0 }, "r.radius_m"),
        (Shape::HalfCircle { centre_m: [0.0, 0.0], radius_m: 1.0, heading_deg: nan }, "r.heading_deg"),
        (Shape::Sector { centre_m: [0.0, 0.0], radius_m: [1.0, 0.5], bearing_deg: [0.0, 90.0] }, "r.radius_m"),
        (Shape::Sector { centre_m: [0.0, 0.0], radius_m: [0.0, 0.5], bearing_deg: [90.0, 90.0] }, "r.bearing_deg"),
        (Shape::Trapezoid { x_m: [0.0, f64::INFINITY], half_width_m: [1.0, 1.0] }, "r.x_m"),
        (Shape::Trapezoid { x_m: [0.0, 1.0], half_width_m: [0.0, 0.0] }, "r.half_width_m"),
        (Shape::Polygon { points_m: vec![[0.0, 0.0], [1.0, 0.0]] }, "r.points_m"),
        (Shape::Polygon { points_m: vec![[0.0, 0.0], [1.0, nan], [0.0, 1.0]] }, "r.points_m[1]"),
        (Shape::Polygon { points_m: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]] }, "r.points_m[1]"),
        (Shape::Polygon { points_m: vec![[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]] }, "r.points_m"),
        (Shape::Polygon { points_m: vec![[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [0.0, 1.0]] }, "r.points_m"),
    ];
    for (shape, key) in cases {
        assert_eq!(shape.validate("r").map_err(|error| error.key), Err(key.to_owned()), "{shape:?}");
    }
    for shape in examples() {
        shape.validate("r").unwrap();
    }
}

#[test]
fn what_is_written_is_read_again() {
    for shape in examples() {
        let text = toml::to_string(&shape).unwrap();
        assert_eq!(toml::from_str::<Shape>(&text).unwrap(), shape, "{text}");
    }
}

#[test]
fn a_key_of_another_shape_and_a_missing_key_are_refused_by_name() {
    let refusal = |text: &str| toml::from_str::<Shape>(text).unwrap_err().message().to_owned();
    assert!(
        refusal("shape = \"circle\"\ncentre_m = [0, 0]\nradius_m = 1\nx_m = [0, 1]").contains("unknown field `x_m`")
    );
    assert!(refusal("shape = \"circle\"\ncentre_m = [0, 0]").contains("missing field `radius_m`"));
    assert!(refusal("shape = \"circle\"\ncentre_m = [0, 0]\nradius_m = [0, 1]").starts_with("radius_m: found [0, 1]"));
    assert!(refusal("shape = \"disc\"").contains("unknown variant `disc`"));
    assert!(refusal("centre_m = [0, 0]").contains("missing field `shape`"));
}

/// Turns a shape that has a heading about the origin.
fn turned(shape: &Shape, angle_deg: f64) -> Shape {
    let turn = |p: &[f64; 2]| {
        let angle = angle_deg / 180.0 * PI;
        [p[0] * angle.cos() - p[1] * angle.sin(), p[0] * angle.sin() + p[1] * angle.cos()]
    };
    match shape {
        Shape::Circle { centre_m, radius_m } => Shape::Circle { centre_m: turn(centre_m), radius_m: *radius_m },
        Shape::HalfCircle { centre_m, radius_m, heading_deg } => {
            Shape::HalfCircle { centre_m: turn(centre_m), radius_m: *radius_m, heading_deg: heading_deg + angle_deg }
        }
        Shape::Sector { centre_m, radius_m, bearing_deg } => Shape::Sector {
            centre_m: turn(centre_m),
            radius_m: *radius_m,
            bearing_deg: bearing_deg.map(|bearing| bearing + angle_deg),
        },
        Shape::Polygon { points_m } => Shape::Polygon { points_m: points_m.iter().map(turn).collect() },
        Shape::Rectangle { x_m, y_m } => {
            let corners = [[x_m[0], y_m[0]], [x_m[1], y_m[0]], [x_m[1], y_m[1]], [x_m[0], y_m[1]]];
            Shape::Polygon { points_m: corners.iter().map(turn).collect() }
        }
        Shape::Trapezoid { x_m, half_width_m: w } => {
            let corners = [[x_m[0], -w[0]], [x_m[1], -w[1]], [x_m[1], w[1]], [x_m[0], w[0]]];
            Shape::Polygon { points_m: corners.iter().map(turn).collect() }
        }
    }
}

proptest! {
    #[test]
    fn turning_shape_and_point_together_changes_nothing(
        index in 0usize..9, x in -1.5f64..1.5, y in -1.5f64..1.5, angle in -180.0f64..180.0,
    ) {
        let shape = &examples()[index];
        let other = turned(shape, angle);
        let spun = nalgebra::Rotation2::new(angle / 180.0 * PI) * point(x, y);
        prop_assert!((shape.distance_m(point(x, y)) - other.distance_m(spun)).abs() < 1e-9, "{:?}", shape);
    }

    #[test]
    fn a_polygon_is_the_same_whichever_way_round_and_wherever_it_starts(
        x in -1.0f64..1.5, y in -0.5f64..1.5, start in 0usize..5,
    ) {
        let Shape::Polygon { points_m } = examples().remove(8) else { unreachable!() };
        let mut other = points_m.clone();
        other.rotate_left(start);
        other.reverse();
        let (one, two) = (Shape::Polygon { points_m }, Shape::Polygon { points_m: other });
        prop_assert_eq!(one.contains(point(x, y)), two.contains(point(x, y)));
    }

    #[test]
    fn distance_is_what_the_nearest_of_many_inner_points_says(index in 0usize..9, x in -2.0f64..2.0, y in -2.0f64..2.0) {
        let shape = &examples()[index];
        let nearest = (0..=120).flat_map(|i| (0..=120).map(move |j| point(-1.5 + f64::from(i) * 0.03, -1.5 + f64::from(j) * 0.03)))
            .filter(|inner| shape.contains(*inner))
            .map(|inner| (inner - point(x, y)).norm())
            .fold(f64::INFINITY, f64::min);
        let distance = shape.distance_m(point(x, y));
        // No grid point may be nearer than the distance; one within a few cells of the nearest edge point must exist,
        // fewer where the shape ends in a sharp tip.
        prop_assert!(distance <= nearest + 1e-12 && nearest - distance < 0.15, "{} {} {:?}", distance, nearest, shape);
    }

    #[test]
    fn a_ray_begins_where_marching_along_it_first_lands_inside(
        index in 0usize..9, x in -2.0f64..2.0, y in -2.0f64..2.0, angle in 0.0f64..360.0,
    ) {
        let shape = &examples()[index];
        let (origin, direction) = (point(x, y), polar([0.0, 0.0], 1.0, angle));
        let marched = (0..6000).map(|step| f64::from(step) * 1e-3).find(|t| shape.contains(origin + direction * *t));
        match (shape.first_hit_m(origin, direction), marched) {
            (Some(hit), Some(marched)) => {
                // The exact answer may clip a corner that the march stepped over, and so be nearer, never farther.
                prop_assert!(hit <= marched + 1e-9, "{} after {} {:?}", hit, marched, shape);
                prop_assert!(shape.distance_m(origin + direction * hit) < 1e-8);
            }
            (Some(hit), None) => prop_assert!(shape.distance_m(origin + direction * hit) < 1e-8),
            (None, Some(marched)) => prop_assert!(false, "missed at {} {:?}", marched, shape),
            (None, None) => {}
        }
    }
}
