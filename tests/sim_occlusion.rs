//! Contract: what stands in the way of any part of a path hides it, in both directions: walls, pillars, movers, housings
//! and obstructions of the robot. Every test shows the same path open as its control.

mod sim_support;

use nalgebra::{Vector2, Vector3};
use noctule::geometry::Pose2;
use noctule::geometry::shape::Shape;
use noctule::sensor::SensorSetup;
use noctule::signal::{PingSet, Velocity};
use noctule::sim::{Mover, PathLoop, SimParams, Simulator, World};
use sim_support::*;

const WALL: ([f64; 2], [f64; 2]) = ([1.0, -40.0], [1.0, 40.0]);

fn wall() -> World {
    walls(&[&[WALL.0, WALL.1]])
}

fn made(world: World, sensors: &[SensorSetup], params: SimParams) -> Simulator {
    let mut simulator = simulator(world, sensors, params);
    simulator.set_pose(Pose2::default());
    simulator
}

/// What `receiver` reads of the wall's echo of `emitter`'s emission, in units of what is right without occlusion.
fn wall_echo(set: &PingSet, sensors: &[SensorSetup], emitter: usize, receiver: usize) -> f64 {
    let place = Pose2::default();
    let image = mirrored(&in_world(&place, &sensors[emitter], &sensors[emitter].emitter_m), WALL.0, WALL.1);
    let path_m = (image - in_world(&place, &sensors[receiver], &sensors[receiver].array.positions_m[19])).norm();
    reading(row(set, receiver, 19), path_m / SPEED_M_S) * path_m / 0.2
}

#[test]
fn a_housing_hides_an_echo_from_its_emitter_on_and_to_its_microphones() {
    // The third sensor stands 0.1 m in front of the first, or out of the way behind.
    let third_in_front = sensor(0.1f64.hypot(0.3), 0.3f64.atan2(0.1).to_degrees(), -0.3f64.atan2(0.1).to_degrees());
    let scene = |third: SensorSetup| [sensor(0.3, 90.0, -90.0), sensor(0.3, -90.0, 90.0), third];
    let reading = |third: SensorSetup, emitter: usize, receiver: usize| {
        let sensors = scene(third);
        let mut simulator = made(wall(), &sensors, bare());
        (0..3).filter(|sensor| *sensor != emitter).for_each(|sensor| simulator.set_emitting(sensor, false));
        wall_echo(&ping(&mut simulator), &sensors, emitter, receiver)
    };
    let away = || sensor(0.6, 180.0, 180.0);
    for (emitter, receiver, what) in [(0, 0, "both ways"), (0, 1, "from the emitter"), (1, 0, "to the microphones")] {
        let (hidden, open) = (reading(third_in_front.clone(), emitter, receiver), reading(away(), emitter, receiver));
        assert!(hidden < 1e-3 && (open - 1.0).abs() < 0.02, "{what}: {hidden} {open}");
    }
    let beside = reading(third_in_front.clone(), 1, 1);
    assert!((beside - 1.0).abs() < 0.02, "the second sensor sees past it: {beside}");
}

#[test]
fn a_housing_between_two_sensors_hides_what_they_send_each_other_directly() {
    let direct = |third: SensorSetup| {
        let sensors = [sensor(0.3, 90.0, -90.0), sensor(0.3, -90.0, 90.0), third];
        let mut simulator = made(World::default(), &sensors, bare());
        [0, 2].iter().for_each(|sensor| simulator.set_emitting(*sensor, false));
        largest(row(&ping(&mut simulator), 0, 19))
    };
    let (hidden, open) = (direct(sensor(0.02, 0.0, 0.0)), direct(sensor(0.2, 0.0, 0.0)));
    // Emitter and microphones each see the other at a right angle, where the housing leaves a half: 0.2 / 4 / 0.6 m.
    assert!(hidden == 0.0 && (open / 0.083 - 1.0).abs() < 0.1, "{hidden} {open}");
}

#[test]
fn a_mover_hides_while_it_is_in_the_way_and_not_before_or_after() {
    let sensors = [sensor(0.0, 0.0, 0.0)];
    let mover = Mover {
        radius_m: 0.1,
        path: vec![[0.6, 1.0], [0.6, -1.0]],
        speed_m_s: 0.5,
        repeat: PathLoop::Once,
        start_s: 0.0,
    };
    let mut simulator = made(World { movers: vec![mover], ..wall() }, &sensors, bare());
    let echoes: Vec<f64> = (0..5)
        .map(|_| {
            let echo = wall_echo(&ping(&mut simulator), &sensors, 0, 0);
            (0..10).for_each(|_| simulator.step(Velocity::ZERO, 0.1));
            echo
        })
        .collect();
    // At 0, 1, 2, 3, 4 s it is 1, 0.5, 0, -0.5, -1 m beside the boresight.
    assert!(echoes[2] < 0.05, "{echoes:?}");
    for time_s in [0, 1, 3, 4] {
        assert!((echoes[time_s] - 1.0).abs() < 0.1, "{echoes:?}");
    }
}

#[test]
fn an_obstruction_on_the_robot_hides_what_is_behind_it_and_turns_with_the_robot() {
    let sensors = [sensor(0.0, 0.0, 0.0)];
    let mast = [Shape::Circle { centre_m: [0.2, 0.0], radius_m: 0.03 }];
    let echo = |shapes: &[Shape], heading_deg: f64| {
        let mut simulator = made(wall(), &sensors, bare());
        simulator.set_obstructions(shapes);
        simulator.set_pose(Pose2 { heading_rad: f64::to_radians(heading_deg), ..Pose2::default() });
        peak_near(row(&ping(&mut simulator), 0, 19), 2.0 / SPEED_M_S, 8.0 / RATE_HZ)
    };
    assert!(echo(&mast, 0.0) < 1e-4, "{}", echo(&mast, 0.0));
    assert!((echo(&[], 0.0) / 0.1 - 1.0).abs() < 0.02, "control: without the mast");
    // Turned by 30 degrees the wall is beside the mast.
    assert!((echo(&mast, 30.0) / 0.1 - 1.0).abs() < 0.02, "{}", echo(&mast, 30.0));
}

/// Two walls that turn a ray from the origin to the left, across and back; they meet nowhere.
fn two_panes() -> [[[f64; 2]; 2]; 2] {
    let (at, along) = (Vector2::new(1.5, 1.2), Vector2::new(1.625, -0.781).normalize() * 0.5);
    let left: [[f64; 2]; 2] = [(at - along).into(), (at + along).into()];
    [left, left.map(|[x, y]| [x, -y])]
}

/// Path over the panes in the order given, if the reflection points lie on them: the image of the image.
fn over_two(panes: [[[f64; 2]; 2]; 2], from: Vector3<f64>, to: Vector3<f64>) -> Option<f64> {
    let once = mirrored(&from, panes[0][0], panes[0][1]);
    let twice = mirrored(&once, panes[1][0], panes[1][1]);
    let second = meeting(twice, to, panes[1])?;
    meeting(once, second, panes[0])?;
    Some((twice - to).norm())
}

/// Where the line between two places meets a pane.
fn meeting(from: Vector3<f64>, to: Vector3<f64>, pane: [[f64; 2]; 2]) -> Option<Vector3<f64>> {
    let (a, b) = (Vector2::from(pane[0]), Vector2::from(pane[1]));
    let (ray, edge) = (to.xy() - from.xy(), b - a);
    let scale = ray.perp(&edge);
    let (share, along) = ((a - from.xy()).perp(&edge) / scale, (a - from.xy()).perp(&ray) / scale);
    ((0.0..=1.0).contains(&share) && (0.0..=1.0).contains(&along)).then(|| from + (to - from) * share)
}

/// What multipath adds on one microphone.
fn added_by_multipath(world: &World, place: Pose2, microphone: usize) -> Vec<f32> {
    let hear = |multipath: bool| {
        let params = SimParams { multipath, ..bare() };
        let mut simulator = simulator(world.clone(), &[sensor(0.0, 0.0, 0.0)], params);
        simulator.set_pose(place);
        ping(&mut simulator)
    };
    let (with, without) = (hear(true), hear(false));
    row(&with, 0, microphone).iter().zip(row(&without, 0, microphone)).map(|(with, without)| with - without).collect()
}

#[test]
fn multipath_over_two_walls_is_the_image_of_the_image_in_both_orders_on_every_microphone() {
    let panes = two_panes();
    let world = walls(&[&panes[0], &panes[1]]);
    let sensor = sensor(0.0, 0.0, 0.0);
    for place in [Pose2::default(), Pose2 { x_m: 0.06, y_m: -0.05, heading_rad: 0.1 }] {
        let emitter = in_world(&place, &sensor, &sensor.emitter_m);
        for (index, local) in sensor.array.positions_m.iter().enumerate().step_by(5) {
            let microphone = in_world(&place, &sensor, local);
            let paths: Vec<f64> = [panes, [panes[1], panes[0]]]
                .into_iter()
                .filter_map(|order| over_two(order, emitter, microphone))
                .collect();
            assert_eq!(paths.len(), 2, "the scene shows both orders");
            let mut rest = added_by_multipath(&world, place, index);
            let before = largest(&rest);
            for path_m in &paths {
                for (sample, value) in rest.iter_mut().enumerate() {
                    *value -= (0.2 / path_m * sweep(sample as f64 / RATE_HZ - path_m / SPEED_M_S)) as f32;
                }
            }
            let amplitude = 0.2 / paths[0];
            assert!(largest(&rest) < 2e-4 * amplitude, "microphone {index}: {} of {amplitude}", largest(&rest));
            assert!(before > 0.3 * amplitude, "control: there was something, {before}");
        }
    }
}

#[test]
fn every_leg_of_multipath_can_be_hidden() {
    let panes = two_panes();
    let path_m = 2.0 * 1.5f64.hypot(1.2) + 2.4;
    let heard = |screen: Option<[[f64; 2]; 2]>| {
        let mut world = walls(&[&panes[0], &panes[1]]);
        world.walls.extend(screen.map(|points| open_wall(&points)));
        let samples = added_by_multipath(&world, Pose2::default(), 19);
        peak_near(&samples, path_m / SPEED_M_S, 100.0 / RATE_HZ) * path_m / 0.2
    };
    assert!(heard(None) > 0.3, "control: {}", heard(None));
    // Screens of 0.1 m across the first, the middle and the last leg (and, with the orders changed, the other way round).
    let across = |x: f64, y: f64, dx: f64, dy: f64| Some([[x - dx, y - dy], [x + dx, y + dy]]);
    for (screen, leg) in [
        (across(0.75, 0.6, 0.02, -0.05), "left"),
        (across(1.5, 0.3, 0.05, 0.02), "middle"),
        (across(0.75, -0.6, 0.02, 0.05), "right"),
    ] {
        assert!(heard(screen) < 0.05, "{leg}: {}", heard(screen));
    }
}

#[test]
fn multipath_over_a_wall_and_a_cylinder_goes_both_ways_at_fermats_lengths() {
    let (from, to) = ([-40.0, 0.9], [40.0, 0.9]);
    let (centre, radius_m) = (Vector2::new(1.6, -0.2), 0.15);
    let mut world = walls(&[&[from, to]]);
    world.pillars = vec![noctule::sim::Pillar { centre: centre.into(), radius_m }];
    let sensor = sensor(0.0, 0.0, 0.0);
    let place = Pose2::default();
    let emitter = in_world(&place, &sensor, &sensor.emitter_m);
    for index in [0, 13, 31] {
        let microphone = in_world(&place, &sensor, &sensor.array.positions_m[index]);
        let mut rest = added_by_multipath(&world, place, index);
        let before = largest(&rest);
        // The image of the emitter over the cylinder, and the cylinder into the image of the microphone.
        for (source, ear) in [(mirrored(&emitter, from, to), microphone), (emitter, mirrored(&microphone, from, to))] {
            let (path_m, amplitude) = over_cylinder(source, ear, centre, radius_m);
            for (sample, value) in rest.iter_mut().enumerate() {
                *value -= (0.2 * amplitude * sweep(sample as f64 / RATE_HZ - path_m / SPEED_M_S)) as f32;
            }
        }
        assert!(largest(&rest) < 5e-3 * before && before > 5e-3, "microphone {index}: {} of {before}", largest(&rest));
    }
}

/// Length over a cylinder, found by trying, and amplitude by the divergence of rays after the reflection: one caustic
/// at the source's distance, the other where 1/rho = 1/s + 2/(a cos).
fn over_cylinder(source: Vector3<f64>, ear: Vector3<f64>, centre: Vector2<f64>, radius_m: f64) -> (f64, f64) {
    let legs = |step: i32| {
        let angle = f64::from(step) * 1e-5;
        let normal = Vector2::new(angle.cos(), angle.sin());
        let point = centre + normal * radius_m;
        let (to_source, to_ear) = (source.xy() - point, ear.xy() - point);
        (to_source.norm(), to_ear.norm(), to_source.normalize().dot(&normal), to_ear.dot(&normal))
    };
    let (s, d, cosine, _) = (-314_159..314_159)
        .map(legs)
        .filter(|(_, _, cosine, ahead)| *cosine > 0.0 && *ahead > 0.0)
        .min_by(|first, second| (first.0 + first.1).total_cmp(&(second.0 + second.1)))
        .unwrap();
    let rho = 1.0 / (1.0 / s + 2.0 / (radius_m * cosine));
    let amplitude = (1.0 / s) * (rho * s / ((rho + d) * (s + d))).sqrt();
    ((s + d).hypot(source.z - ear.z), amplitude)
}
