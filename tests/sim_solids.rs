//! Contract: floor, ceiling, balls and bars of a world sound from where they are and as loud as their closed forms say, computed here;
//! no code of the simulator is called for an expected value.

mod sim_support;

use nalgebra::Vector3;
use noctule::geometry::Pose2;
use noctule::sensor::{MicrophoneArray, SensorSetup};
use noctule::sim::{Ball, Bar, World};
use sim_support::*;
use std::path::Path;

/// Measured 6e-6 of the amplitude for planes (see `sim_physics`); a hundredth of a sample is 7e-3.
const SHAPE_TOLERANCE: f64 = 5e-5;

/// One microphone at the emitter, both at the sensor's origin.
fn point_sensor() -> SensorSetup {
    let array = MicrophoneArray { positions_m: vec![Vector3::zeros()], enabled: vec![true], weights: vec![1.0] };
    SensorSetup { array, emitter_m: Vector3::zeros(), ..sensor(0.0, 0.0, 0.0) }
}

/// Worst difference, as a share of the amplitude, between what the microphones hear and one echo of the given lengths.
fn error(world: &World, sensor: &SensorSetup, echo: impl Fn(&Vector3<f64>) -> (f64, f64)) -> f64 {
    let mut simulator = simulator(world.clone(), std::slice::from_ref(sensor), bare());
    simulator.set_pose(Pose2::default());
    let set = ping(&mut simulator);
    let of = |(index, microphone): (usize, &Vector3<f64>)| {
        let (path_m, amplitude) = echo(microphone);
        misfit(row(&set, 0, index), path_m / SPEED_M_S, amplitude) / amplitude
    };
    sensor.array.positions_m.iter().enumerate().map(of).fold(0.0, f64::max)
}

#[test]
fn floor_and_ceiling_sound_from_their_image_sources_on_every_microphone() {
    let sensor = sensor(0.0, 0.0, 0.0);
    let floor = World { floor_m: Some(-0.7), ..World::default() };
    let ceiling = World { ceiling_m: Some(1.9), ..World::default() };
    for (world, level_m) in [(&floor, -0.7), (&ceiling, 1.9)] {
        // Straight down and up both gains of the housing are a half; the bare emitter sends the same everywhere.
        let echo = |level_m: f64| {
            move |microphone: &Vector3<f64>| {
                let image = Vector3::new(0.0, 0.0, 2.0 * level_m - 0.06);
                let path_m = (image - microphone).norm();
                (path_m, 0.2 / path_m)
            }
        };
        // What is heard is the gain of 90 degrees off the axis, to a hundredth: the array is not seen from exactly there.
        let gained = |gain: f64| {
            move |microphone: &Vector3<f64>| {
                let (path_m, amplitude) = echo(level_m)(microphone);
                (path_m, gain * amplitude)
            }
        };
        assert!(error(world, &sensor, gained(0.25)) < 1e-3, "{level_m}: {}", error(world, &sensor, gained(0.25)));
        assert!(error(world, &sensor, gained(0.26)) > 1e-2);
        let lower = move |microphone: &Vector3<f64>| {
            let (path_m, amplitude) = echo(level_m - 0.001)(microphone);
            (path_m, 0.25 * amplitude)
        };
        assert!(error(world, &sensor, lower) > 0.1, "a millimetre lower must show");
    }
}

#[test]
fn a_ball_and_a_bar_are_as_loud_as_a_sphere_and_a_cylinder() {
    let sensor = point_sensor();
    let (centre, radius_m) = (Vector3::new(1.0, 0.3, -0.4), 0.08);
    let world = World { balls: vec![Ball { centre: centre.into(), radius_m }], ..World::default() };
    let r = centre.norm() - radius_m;
    let sphere = |_: &Vector3<f64>| (2.0 * r, 0.2 * radius_m / (2.0 * r * (radius_m + r)));
    assert!(error(&world, &sensor, sphere) < SHAPE_TOLERANCE, "{}", error(&world, &sensor, sphere));
    assert!(error(&world, &sensor, |_| (2.0 * r + 1e-5, sphere(&centre).1)) > 1e-3);
    // A level bar overhead, square on: the nearest point of its axis is at (1.2, 0, 0.5).
    let bar = Bar { from: [1.2, -3.0, 0.5], to: [1.2, 3.0, 0.5], radius_m: 0.02 };
    let world = World { bars: vec![bar], ..World::default() };
    let r = 1.2f64.hypot(0.5) - 0.02;
    let cylinder = |_: &Vector3<f64>| (2.0 * r, 0.2 * (0.02 / (0.02 + r)).sqrt() / (2.0 * r));
    assert!(error(&world, &sensor, cylinder) < SHAPE_TOLERANCE, "{}", error(&world, &sensor, cylinder));
    // The same bar end on is a ball of its radius, there where it ends.
    let end_on = Bar { from: [1.2, 0.0, 0.5], to: [3.6, 0.0, 1.5], radius_m: 0.02 };
    let world = World { bars: vec![end_on], ..World::default() };
    let end = |_: &Vector3<f64>| (2.0 * r, 0.2 * 0.02 / (2.0 * r * (0.02 + r)));
    assert!(error(&world, &sensor, end) < 1e-3, "{}", error(&world, &sensor, end));
}

#[test]
fn nothing_sounds_from_behind_a_wall_nor_from_behind_the_sensor() {
    let quiet = |world: World| {
        let walled = world.walls.len() == 1;
        let mut simulator = simulator(world, &[point_sensor()], bare());
        simulator.set_pose(Pose2::default());
        let set = ping(&mut simulator);
        // What the wall itself echoes is over 2.5 ms after it came.
        let from = if walled { ((2.0 / SPEED_M_S + 2.6e-3) * RATE_HZ) as usize } else { 0 };
        largest(&row(&set, 0, 0)[from..])
    };
    let ball = |x_m: f64| vec![Ball { centre: [x_m, 0.0, 0.2], radius_m: 0.1 }];
    let walls = walls(&[&[[1.0, -40.0], [1.0, 40.0]]]).walls;
    assert_eq!(quiet(World { balls: ball(-1.0), ..World::default() }), 0.0);
    assert!(quiet(World { balls: ball(1.0), ..World::default() }) > 1e-3);
    assert_eq!(quiet(World { balls: ball(2.5), walls: walls.clone(), ..World::default() }), 0.0);
    assert!(quiet(World { balls: ball(2.5), ..World::default() }) > 1e-3);
}

#[test]
fn wrong_solids_are_refused_by_their_key() {
    let refused = |text: &str, key: &str| {
        let error = World::parse(Path::new("w.toml"), text).unwrap_err().to_string();
        assert!(error.contains(key), "{error}");
    };
    refused("floor_m = 0.2\n", "floor_m");
    refused("ceiling_m = -1\n", "ceiling_m");
    refused("[[ball]]\ncentre = [1, 2]\nradius_m = 0.1\n", "2 coordinates");
    refused("[[ball]]\ncentre = [1, 2, 3]\nradius_m = 0\n", "ball[0].radius_m");
    refused("[[bar]]\nfrom = [1, 2, 3]\nto = [1, 2, 3]\nradius_m = 0.1\n", "bar[0].to");
    let text = "floor_m = -0.4\nceiling_m = 2.1\n[[ball]]\ncentre = [1, 2, 3]\nradius_m = 0.1\n[[bar]]\nfrom = [1, 2, 3]\nto = [1, 2, 4]\nradius_m = 0.02\n";
    let world = World::parse(Path::new("w.toml"), text).unwrap();
    assert_eq!((world.floor_m, world.balls.len(), world.bars.len()), (Some(-0.4), 1, 1));
}
