//! Contract: the flow field is the time derivative of true rigid motion for any mount, and its lines keep their constant along
//! it; the oracle moves reflectors with homogeneous transforms and shares no formula with `flow`.

use nalgebra::{Matrix3, Vector3};
use noctule::flow::flow_line::{
    flow_line_range_m, lateral_m, rotation_circle_ranges_m, rotation_radius_m, turn_centre_distance_m,
};
use noctule::flow::{FlowRate, flow_rate};
use noctule::sensor::Mount;
use noctule::signal::Velocity;
use proptest::prelude::*;

/// Transform of a frame at (x, y), turned by `heading`, into its parent.
fn frame(x: f64, y: f64, heading: f64) -> Matrix3<f64> {
    let (s, c) = heading.sin_cos();
    Matrix3::new(c, -s, x, s, c, y, 0.0, 0.0, 1.0)
}

/// World from robot after driving a time at a constant velocity: the exact arc.
fn driven(velocity: Velocity, time_s: f64) -> Matrix3<f64> {
    let (v, w) = (velocity.linear_m_s, velocity.angular_rad_s);
    let turned = w * time_s;
    if w.abs() < 1e-12 {
        return frame(v * time_s, 0.0, turned);
    }
    // sin(a)/w and (1 - cos(a))/w without the cancellation of small angles.
    frame(v / w * turned.sin(), v / w * 2.0 * (0.5 * turned).sin().powi(2), turned)
}

/// Sensor in robot: go to the place along its bearing, then turn by bearing and yaw.
fn robot_from_sensor(mount: &Mount) -> Matrix3<f64> {
    frame(0.0, 0.0, mount.bearing_rad) * frame(mount.distance_m, 0.0, 0.0) * frame(0.0, 0.0, mount.yaw_rad)
}

/// Range and bearing of a reflector, that stood at (r, theta) at time 0, at another time.
fn seen_after(mount: &Mount, velocity: Velocity, range_m: f64, bearing_rad: f64, time_s: f64) -> (f64, f64) {
    let sensor = robot_from_sensor(mount);
    let world = sensor * Vector3::new(range_m * bearing_rad.cos(), range_m * bearing_rad.sin(), 1.0);
    let now = (driven(velocity, time_s) * sensor).try_inverse().unwrap() * world;
    (now.x.hypot(now.y), now.y.atan2(now.x))
}

/// Central difference of fourth order.
fn true_rate(mount: &Mount, velocity: Velocity, range_m: f64, bearing_rad: f64) -> FlowRate {
    const H_S: f64 = 1e-3;
    let at = |steps: f64| seen_after(mount, velocity, range_m, bearing_rad, steps * H_S);
    let unwrap = |angle: f64| {
        let turns = ((angle - bearing_rad) / std::f64::consts::TAU).round();
        angle - turns * std::f64::consts::TAU
    };
    let derivative = |f: &dyn Fn(f64) -> f64| (8.0 * (f(1.0) - f(-1.0)) - (f(2.0) - f(-2.0))) / (12.0 * H_S);
    FlowRate { range_m_s: derivative(&|steps| at(steps).0), bearing_rad_s: derivative(&|steps| unwrap(at(steps).1)) }
}

/// Eq. 6 as the paper prints it.
fn printed_rate(mount: &Mount, velocity: Velocity, range_m: f64, bearing_rad: f64) -> FlowRate {
    let (v, w, l) = (velocity.linear_m_s, velocity.angular_rad_s, mount.distance_m);
    let (beta, delta) = (mount.yaw_rad, mount.bearing_rad + mount.yaw_rad);
    FlowRate {
        range_m_s: -l * w * (beta - bearing_rad).sin() - v * (bearing_rad + delta).cos(),
        bearing_rad_s: (l * w * (beta - bearing_rad).cos() + v * (bearing_rad + delta).sin()) / range_m + w,
    }
}

/// Largest difference of the two rates, the bearing's as metres a second across at the reflector.
fn difference_m_s(a: FlowRate, b: FlowRate, range_m: f64) -> f64 {
    (a.range_m_s - b.range_m_s).abs().max((a.bearing_rad_s - b.bearing_rad_s).abs() * range_m)
}

fn mounts() -> impl Strategy<Value = Mount> {
    (0.0..0.6f64, -3.2..3.2f64, -3.2..3.2f64).prop_map(|(distance_m, bearing_rad, yaw_rad)| Mount {
        distance_m,
        bearing_rad,
        yaw_rad,
    })
}

fn velocities() -> impl Strategy<Value = Velocity> {
    (-1.0..1.0f64, -2.0..2.0f64).prop_map(|(linear_m_s, angular_rad_s)| Velocity { linear_m_s, angular_rad_s })
}

/// The truncated difference is off by h^4/30 of the fifth derivative: a bearing that turns at up to 9.3 rad/s (2.2 m/s across at
/// 0.3 m, and 2 rad/s of the robot) gives about 24 * 9.3^5 / 30 * 1e-12 rad/s, 2e-8 m/s at that range; 6e-9 was seen.
const RATE_TOLERANCE_M_S: f64 = 1e-7;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn the_field_is_the_derivative_of_true_motion(
        mount in mounts(), velocity in velocities(), range_m in 0.3..5.0f64, bearing_rad in -1.57..1.57f64,
    ) {
        let field = flow_rate(&mount, velocity, range_m, bearing_rad);
        let truth = true_rate(&mount, velocity, range_m, bearing_rad);
        prop_assert!(difference_m_s(field, truth, range_m) < RATE_TOLERANCE_M_S, "{field:?} {truth:?}");
    }

    #[test]
    fn straight_motion_keeps_the_lateral_distance(
        mount in mounts(), linear_m_s in -1.0..1.0f64, range_m in 0.3..5.0f64, bearing_rad in -1.57..1.57f64,
    ) {
        let velocity = Velocity::forward_m_s(linear_m_s);
        let start_m = lateral_m(&mount, range_m, bearing_rad);
        for step in 0..20 {
            let (r, theta) = seen_after(&mount, velocity, range_m, bearing_rad, 0.2 * f64::from(step));
            prop_assert!((lateral_m(&mount, r, theta) - start_m).abs() < 1e-12);
            if r > 0.05 && (theta + mount.bearing_rad + mount.yaw_rad).sin().abs() > 0.05 {
                let on_line_m = flow_line_range_m(&mount, start_m, theta);
                prop_assert!(on_line_m.is_some_and(|on_line_m| (on_line_m - r).abs() < 1e-10), "{on_line_m:?} {r}");
            }
        }
    }

    #[test]
    fn rotation_keeps_the_circle(
        mount in mounts(), angular_rad_s in -2.0..2.0f64, range_m in 0.3..5.0f64, bearing_rad in -1.57..1.57f64,
    ) {
        let velocity = Velocity { linear_m_s: 0.0, angular_rad_s };
        let rho_m = rotation_radius_m(&mount, range_m, bearing_rad);
        for step in 0..20 {
            let (r, theta) = seen_after(&mount, velocity, range_m, bearing_rad, 0.2 * f64::from(step));
            prop_assert!((rotation_radius_m(&mount, r, theta) - rho_m).abs() < 1e-10);
            let crossings = rotation_circle_ranges_m(&mount, rho_m, theta);
            // Where the ray grazes the circle, a rounding error of 1e-16 moves the crossing by its square root.
            prop_assert!(crossings.into_iter().flatten().any(|crossing_m| (crossing_m - r).abs() < 1e-6), "{crossings:?} {r}");
        }
    }

    #[test]
    fn any_constant_velocity_keeps_the_distance_from_its_turn_centre(
        mount in mounts(), linear_m_s in -1.0..1.0f64, angular_rad_s in 0.05..2.0f64, left in any::<bool>(),
        range_m in 0.3..5.0f64, bearing_rad in -1.57..1.57f64,
    ) {
        let velocity = Velocity { linear_m_s, angular_rad_s: if left { angular_rad_s } else { -angular_rad_s } };
        let start_m = turn_centre_distance_m(&mount, velocity, range_m, bearing_rad).unwrap();
        for step in 0..20 {
            let (r, theta) = seen_after(&mount, velocity, range_m, bearing_rad, 0.2 * f64::from(step));
            let now_m = turn_centre_distance_m(&mount, velocity, r, theta).unwrap();
            prop_assert!((now_m - start_m).abs() < 1e-10 * (1.0 + start_m));
        }
    }

    // Negative control: the oracle tells the printed equation from the true one wherever the sensor is yawed and the robot turns.
    #[test]
    fn the_printed_field_is_not_true_motion_for_a_yawed_sensor(
        distance_m in 0.1..0.6f64, bearing_rad in -3.2..3.2f64, yaw_rad in 0.2..1.4f64, angular_rad_s in 0.3..2.0f64,
        linear_m_s in -1.0..1.0f64, range_m in 0.5..5.0f64, theta_rad in 0.2..1.4f64,
    ) {
        let mount = Mount { distance_m, bearing_rad, yaw_rad };
        let velocity = Velocity { linear_m_s, angular_rad_s };
        let printed = printed_rate(&mount, velocity, range_m, theta_rad);
        let truth = true_rate(&mount, velocity, range_m, theta_rad);
        prop_assert!(difference_m_s(printed, truth, range_m) > 1e-3);
    }
}

#[test]
fn straight_motion_has_no_turn_centre_and_a_parallel_ray_no_crossing() {
    let mount = Mount { distance_m: 0.15, bearing_rad: 0.0, yaw_rad: 0.0 };
    assert_eq!(turn_centre_distance_m(&mount, Velocity::forward_m_s(0.3), 1.0, 0.2), None);
    assert_eq!(flow_line_range_m(&mount, 0.5, 0.0), None);
    assert_eq!(flow_line_range_m(&mount, 0.5, -0.5), None, "a line on the left never crosses a ray to the right");
    assert_eq!(rotation_circle_ranges_m(&mount, 0.05, 1.5), [None, None]);
}

#[test]
fn driving_at_a_reflector_brings_it_nearer_and_turning_left_moves_it_right() {
    let nose = Mount { distance_m: 0.15, bearing_rad: 0.0, yaw_rad: 0.0 };
    let ahead = flow_rate(&nose, Velocity::forward_m_s(0.3), 1.0, 0.0);
    assert!((ahead.range_m_s + 0.3).abs() < 1e-15 && ahead.bearing_rad_s == 0.0);
    let turning = flow_rate(&nose, Velocity { linear_m_s: 0.0, angular_rad_s: 1.0 }, 1.0, 0.0);
    assert!(turning.bearing_rad_s < -1.0);
}
