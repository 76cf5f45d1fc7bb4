//! Contract: echoes of thin pillars, edges and tilted panes are as strong as exact theory says: the series of a rigid
//! cylinder and Keller's edge, computed here in f64; the simulator's own code is never called for an expected value.

mod sim_support;

use nalgebra::{Complex, Vector2, Vector3};
use noctule::geometry::Pose2;
use noctule::sensor::{MicrophoneArray, SensorSetup};
use noctule::sim::{Pillar, SimParams, World};
use sim_support::*;
use std::f64::consts::{PI, TAU};

/// Bessel functions J_0..J_n and Y_0..Y_n of `x`: Miller's downward recurrence, Neumann's series for Y_0 and Y_1, then
/// upwards.
fn bessel(x: f64, n: usize) -> (Vec<f64>, Vec<f64>) {
    let start = 2 * ((n as f64).max(x + 15.0 * x.cbrt()) / 2.0 + 30.0) as usize;
    let mut j = vec![0.0; start + 2];
    j[start] = 1e-300;
    for k in (1..=start).rev() {
        j[k - 1] = 2.0 * k as f64 / x * j[k] - j[k + 1];
        if j[k - 1].abs() > 1e250 {
            j[k - 1..].iter_mut().for_each(|value| *value *= 1e-250);
        }
    }
    let norm = j[0] + 2.0 * j[2..].iter().step_by(2).sum::<f64>();
    j.iter_mut().for_each(|value| *value /= norm);
    let logarithm = (0.5 * x).ln() + 0.577_215_664_901_532_9;
    let (mut even, mut odd) = (0.0, 0.0);
    for k in 1..start / 2 {
        let (sign, count) = (if k % 2 == 0 { 1.0 } else { -1.0 }, k as f64);
        even += sign * j[2 * k] / count;
        odd += sign * (2.0 * count + 1.0) / (count * (count + 1.0)) * j[2 * k + 1];
    }
    let mut y = vec![0.0; n + 2];
    y[0] = 2.0 / PI * (logarithm * j[0] - 2.0 * even);
    y[1] = 2.0 / PI * (-j[0] / x + (logarithm - 1.0) * j[1] - odd);
    for k in 1..=n {
        y[k + 1] = 2.0 * k as f64 / x * y[k] - y[k - 1];
    }
    (j, y)
}

#[test]
fn the_series_own_bessel_functions_are_those_of_the_tables() {
    let (j, y) = bessel(5.0, 10);
    for (found, table) in
        [(j[0], -0.177_596_771_3), (j[1], -0.327_579_137_6), (y[0], -0.308_517_625_2), (y[1], 0.147_863_143_4)]
    {
        assert!((found - table).abs() < 1e-9, "{found} {table}");
    }
    // Wronskian, far from the tables: J(n+1) Y(n) - J(n) Y(n+1) = 2 / (pi x).
    let (j, y) = bessel(900.0, 120);
    assert!(((j[101] * y[100] - j[100] * y[101]) * PI * 900.0 / 2.0 - 1.0).abs() < 1e-9);
}

/// A rigid cylinder of radius `a` between a line source and a receiver, both at `r` from its axis, `angle` apart: the exact
/// scattered field over that of geometrical optics.
fn exact_over_geometrical(frequency_hz: f64, a: f64, r: f64, angle: f64) -> Complex<f64> {
    let k = TAU * frequency_hz / SPEED_M_S;
    let n = (k * a + 8.0 * (k * a).cbrt() + 15.0) as usize;
    let ((j, y), (jr, yr)) = (bessel(k * a, n + 1), bessel(k * r, n + 1));
    let slope = |v: &[f64], m: usize| if m == 0 { -v[1] } else { 0.5 * (v[m - 1] - v[m + 1]) };
    let exact: Complex<f64> = (0..=n)
        .map(|m| {
            let hankel = Complex::new(jr[m], yr[m]);
            let ratio = Complex::new(slope(&j, m), 0.0) / Complex::new(slope(&j, m), slope(&y, m));
            -ratio * hankel * hankel * ((if m == 0 { 1.0 } else { 2.0 }) * (m as f64 * angle).cos())
        })
        .sum();
    let s = (r * (0.5 * angle).sin()).hypot(r * (0.5 * angle).cos() - a);
    let rho = 1.0 / (1.0 / s + 2.0 * s / (a * (r * (0.5 * angle).cos() - a)));
    let geometrical = (2.0 / (PI * k * s) * rho / (rho + s)).sqrt();
    exact / Complex::from_polar(geometrical, 2.0 * k * s - PI / 4.0)
}

/// One microphone at the emitter, both at the sensor's origin.
fn point_sensor(distance_m: f64, bearing_deg: f64) -> SensorSetup {
    let array = MicrophoneArray { positions_m: vec![Vector3::zeros()], enabled: vec![true], weights: vec![1.0] };
    SensorSetup { array, emitter_m: Vector3::zeros(), ..sensor(distance_m, bearing_deg, -bearing_deg) }
}

/// Discrete Fourier sum of a ping or of the sweep.
fn spectrum(value_of: impl Fn(usize) -> f64, count: usize, frequency_hz: f64) -> Complex<f64> {
    (0..count).map(|index| Complex::from_polar(value_of(index), -TAU * frequency_hz * index as f64 / RATE_HZ)).sum()
}

/// By how many dB the simulator's pillar echo differs from the exact one, at every kilohertz of the band; sensors at 1.5 m
/// from the axis see it `angle` apart, and the second sends.
fn errors_db(radius_m: f64, angle: f64) -> Vec<f64> {
    let (x_m, y_m) = (1.5 * (0.5 * angle).cos(), 1.5 * (0.5 * angle).sin());
    let sensors = if angle == 0.0 {
        vec![point_sensor(0.0, 0.0)]
    } else {
        vec![point_sensor(y_m, 90.0), point_sensor(y_m, -90.0)]
    };
    let world = World { pillars: vec![Pillar { centre: [x_m, 0.0], radius_m }], ..World::default() };
    let mut simulator = simulator(world, &sensors, bare());
    if sensors.len() > 1 {
        simulator.set_emitting(0, false);
    }
    simulator.set_pose(Pose2::default());
    let set = ping(&mut simulator);
    let s = y_m.hypot(x_m - radius_m);
    // The direct way between the two, a path of 2 y, is over before the echo of 2 s begins, or not in the scene.
    let begin = ((2.0 * s / SPEED_M_S) * RATE_HZ) as usize - 50;
    assert!(angle == 0.0 || 2.0 * y_m / SPEED_M_S + 2.5e-3 < begin as f64 / RATE_HZ);
    // A point source spreads in height as well: geometrical amplitude in space, checked in the tests of the echoes.
    let cosine = (x_m - radius_m) / s;
    let rho = 1.0 / (1.0 / s + 2.0 / (radius_m * cosine));
    let geometrical = 0.2 / s * (rho / (rho + s) / 2.0).sqrt();
    (27..=49)
        .map(|step| {
            let frequency_hz = 1e3 * f64::from(step);
            let heard = |index| if index < begin { 0.0 } else { f64::from(row(&set, 0, 0)[index]) };
            let found = spectrum(heard, SAMPLES, frequency_hz)
                / spectrum(|index| sweep(index as f64 / RATE_HZ), 1126, frequency_hz);
            let exact = exact_over_geometrical(frequency_hz, radius_m, 1.5, angle).norm() * geometrical;
            20.0 * (found.norm() / exact).log10()
        })
        .collect()
}

#[test]
fn pillars_echo_like_the_exact_rigid_cylinder() {
    // Radius, angle between the ways, largest error; measured 0.48, 0.02, 0.003, 1.06, 0.02 dB (waves that creep around).
    for (radius_m, angle_deg, limit_db) in
        [(0.01, 0.0, 0.6f64), (0.05, 0.0, 0.06), (0.1, 0.0, 0.03), (0.01, 60.0, 1.2), (0.1, 60.0, 0.05)]
    {
        let errors = errors_db(radius_m, f64::to_radians(angle_deg));
        let worst_db = errors.iter().fold(0.0f64, |worst, error| worst.max(error.abs()));
        assert!(worst_db < limit_db, "radius {radius_m} m, {angle_deg} deg: {errors:?}");
    }
}

/// The amplitude of a pane's two ends on a sensor at the origin, heard with a tone of 40 kHz; nearest end first.
fn ends_of(pane: [[f64; 2]; 2], edge_radius_m: f64) -> [f64; 2] {
    let mut sensor = point_sensor(0.0, 0.0);
    sensor.emission = tone(40e3);
    let mut simulator = simulator(walls(&[&pane]), &[sensor], SimParams { edge_radius_m, ..bare() });
    simulator.set_pose(Pose2::default());
    let set = ping(&mut simulator);
    let samples = row(&set, 0, 0);
    let mut delays = pane.map(|end| 2.0 * Vector2::from(end).norm() / SPEED_M_S);
    delays.sort_by(f64::total_cmp);
    delays.map(|delay_s| {
        let from = (delay_s * RATE_HZ) as usize;
        largest(&samples[from..from + 1126])
    })
}

#[test]
fn a_pane_tilted_out_of_its_mirrors_sight_answers_with_kellers_edges_alone() {
    let k = TAU * 40e3 / SPEED_M_S;
    for tilt_deg in [40.0f64, 50.0, 65.0] {
        // A pane of 1.4 m whose middle is 2 m ahead; its perpendicular passes the sensor at 2 sin(tilt) > 0.7 m.
        let along = Vector2::new(tilt_deg.to_radians().sin(), tilt_deg.to_radians().cos()) * 0.7;
        let (near, far) = (Vector2::new(2.0, 0.0) - along, Vector2::new(2.0, 0.0) + along);
        let found = ends_of([near.into(), far.into()], 0.0);
        for (end, into_the_pane, found) in [(near, along, found[0]), (far, -along, found[1])] {
            let cosine = (-end).normalize().dot(&into_the_pane.normalize());
            // A hard half plane, to and fro: (1 + 1/cos) / (2 sqrt(2 pi k)), spread over s, s and 2 s.
            let coefficient = (1.0 + 1.0 / cosine).abs() / (2.0 * (TAU * k).sqrt());
            let s = end.norm();
            let expected = 0.2 * coefficient / (2.0 * s * s * s).sqrt();
            assert!((found / expected - 1.0).abs() < 0.03, "tilt {tilt_deg}, end at {s} m: {found} {expected}");
        }
    }
}

#[test]
fn a_tilted_pane_is_27_db_weaker_than_one_that_faces_the_sensor_with_rounded_ends_too() {
    let half = |tilt_deg: f64| {
        let along = Vector2::new(tilt_deg.to_radians().sin(), tilt_deg.to_radians().cos()) * 0.5;
        [(Vector2::new(2.0, 0.0) - along).into(), (Vector2::new(2.0, 0.0) + along).into()]
    };
    let tilted = ends_of(half(50.0), SimParams::default().edge_radius_m);
    // Rounded ends echo like cylinders of 2 mm: 0.2 / (2 s) * sqrt(a / s), at 1.65 m 0.0021.
    let s = Vector2::from(half(50.0)[0]).norm();
    let expected = 0.2 / (2.0 * s) * (0.002 / s).sqrt();
    assert!((tilted[0] / expected - 1.0).abs() < 0.05, "{tilted:?} {expected}");
    let facing = 0.05;
    let down_db = 20.0 * (facing / tilted[0]).log10();
    assert!((25.0..35.0).contains(&down_db), "{down_db}");
    // Nearer than 0.5 / sin(50 degrees) = 0.65 m the perpendicular meets the pane, and the mirror shows.
    let mirror_at = |distance_m: f64| {
        let along = Vector2::new(50f64.to_radians().sin(), 50f64.to_radians().cos()) * 0.5;
        let pane = [Vector2::new(distance_m, 0.0) - along, Vector2::new(distance_m, 0.0) + along];
        let mut simulator = simulator(walls(&[&[pane[0].into(), pane[1].into()]]), &[point_sensor(0.0, 0.0)], bare());
        simulator.set_pose(Pose2::default());
        let foot_m = distance_m * 50f64.to_radians().cos();
        peak_near(row(&ping(&mut simulator), 0, 0), 2.0 * foot_m / SPEED_M_S, 8.0 / RATE_HZ) * 2.0 * foot_m / 0.2
    };
    assert!(mirror_at(0.5) > 0.8 && mirror_at(0.9) < 0.2, "{} {}", mirror_at(0.5), mirror_at(0.9));
}
