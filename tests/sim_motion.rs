//! Contract: an echo is heard where the moving robot's microphones are when it arrives, off movers where they are when
//! the sound meets them; a robot at rest hears what it would without. Times of flight are solved here by bisection.

mod sim_support;

use noctule::geometry::Pose2;
use noctule::signal::{PingSet, Velocity};
use noctule::sim::{Mover, PathLoop, SimParams, World};
use sim_support::*;

const WALL: ([f64; 2], [f64; 2]) = ([2.4, -40.0], [2.9, 40.0]);

/// The robot's pose `time_s` after `pose` at constant `velocity`: an arc in small steps.
fn later(pose: &Pose2, velocity: Velocity, time_s: f64) -> Pose2 {
    let step_s = time_s / 64.0;
    (0..64).fold(*pose, |pose, _| {
        let middle_rad = pose.heading_rad + 0.5 * velocity.angular_rad_s * step_s;
        Pose2 {
            x_m: pose.x_m + velocity.linear_m_s * step_s * middle_rad.cos(),
            y_m: pose.y_m + velocity.linear_m_s * step_s * middle_rad.sin(),
            heading_rad: pose.heading_rad + velocity.angular_rad_s * step_s,
        }
    })
}

/// The time at which sound that needs `path_m(t)` to be where the microphone is at `t` gets there.
fn arrival_s(path_m: impl Fn(f64) -> f64) -> f64 {
    let (mut early, mut late) = (0.0, 0.1);
    for _ in 0..60 {
        let middle = 0.5 * (early + late);
        if path_m(middle) > SPEED_M_S * middle { early = middle } else { late = middle }
    }
    early
}

/// A ping of a robot that has reached `velocity`, and where it was when it sent.
fn moving_ping(world: World, velocity: Velocity, params: SimParams) -> (Pose2, PingSet) {
    let mut simulator = simulator(world, &[sensor(0.15, 30.0, -30.0)], params);
    simulator.set_pose(Pose2 { x_m: -0.3, y_m: 0.1, heading_rad: 0.0 });
    (0..10).for_each(|_| simulator.step(velocity, 0.1));
    assert_eq!(simulator.velocity(), velocity);
    (simulator.pose(), ping(&mut simulator))
}

#[test]
fn a_walls_echo_arrives_where_the_moving_microphones_are_by_then() {
    let sensor = sensor(0.15, 30.0, -30.0);
    for (linear_m_s, angular_rad_s) in [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.9), (0.3, -0.7)] {
        let velocity = Velocity { linear_m_s, angular_rad_s };
        let (place, set) = moving_ping(walls(&[&[WALL.0, WALL.1]]), velocity, bare());
        let (_, standing) = moving_ping(walls(&[&[WALL.0, WALL.1]]), velocity, SimParams { motion: false, ..bare() });
        let image = mirrored(&in_world(&place, &sensor, &sensor.emitter_m), WALL.0, WALL.1);
        let mut largest_shift_s = 0.0f64;
        for index in [0, 9, 31] {
            let local = &sensor.array.positions_m[index];
            let path_m = |time_s: f64| (image - in_world(&later(&place, velocity, time_s), &sensor, local)).norm();
            let (arrival_s, unmoved_s) = (arrival_s(path_m), path_m(0.0) / SPEED_M_S);
            largest_shift_s = largest_shift_s.max((arrival_s - unmoved_s).abs());
            let amplitude = 0.2 / path_m(0.0);
            let error = misfit(row(&set, 0, index), arrival_s, amplitude) / amplitude;
            assert!(error < 2e-4, "{velocity:?}, microphone {index}: {error}");
            let error = misfit(row(&standing, 0, index), unmoved_s, amplitude) / amplitude;
            assert!(error < 2e-4, "control, without motion: {error}");
        }
        // 14 ms at 0.3 m/s are 4 mm or 12 us; a tenth of that would show.
        assert!(largest_shift_s > 2e-6, "{velocity:?}: {largest_shift_s}");
    }
}

#[test]
fn an_echo_off_a_mover_comes_from_where_it_is_when_the_sound_meets_it() {
    let mover = |speed_m_s| Mover {
        radius_m: 0.2,
        path: vec![[2.5, 0.0], [0.5, 0.0]],
        speed_m_s,
        repeat: PathLoop::Once,
        start_s: 0.0,
    };
    let echo_s = |speed_m_s: f64, motion: bool| {
        let world = World { movers: vec![mover(speed_m_s)], ..World::default() };
        let mut simulator = simulator(world, &[sensor(0.0, 0.0, 0.0)], SimParams { motion, ..bare() });
        simulator.set_pose(Pose2::default());
        let set = ping(&mut simulator);
        let about_s = 2.0 * 2.3 / SPEED_M_S;
        let delays = (-400..400).map(|step| about_s + f64::from(step) * 1e-7);
        let samples = row(&set, 0, 19);
        let fit = |delay_s: f64| {
            let window = (delay_s * RATE_HZ) as usize - 10..(delay_s * RATE_HZ) as usize + 1200;
            window.map(|i| f64::from(samples[i]) * sweep(i as f64 / RATE_HZ - delay_s)).sum::<f64>()
        };
        delays.max_by(|first, second| fit(*first).total_cmp(&fit(*second))).unwrap()
    };
    // At 2.3 m the sound needs 6.7 ms to get there: at 0.5 m/s the mover is 3.35 mm nearer, the way 6.7 mm shorter.
    let earlier_s = echo_s(0.5, false) - echo_s(0.5, true);
    let expected_s = 2.0 * 0.5 * (2.3 / SPEED_M_S) / SPEED_M_S;
    assert!((earlier_s / expected_s - 1.0).abs() < 0.02, "{earlier_s} {expected_s}");
    assert_eq!(echo_s(0.0, true), echo_s(0.0, false));
}

#[test]
fn a_robot_at_rest_hears_the_same_with_and_without_motion() {
    let world = || World { movers: Vec::new(), ..World::default_world().unwrap() };
    let hear = |motion: bool| {
        let mut simulator = simulator(world(), &three_sensors(), SimParams { motion, ..bare() });
        simulator.set_pose(Pose2 { x_m: 2.0, y_m: 1.0, heading_rad: 0.4 });
        ping(&mut simulator)
    };
    assert!(hear(true) == hear(false));
    assert!(largest(row(&hear(true), 0, 0)) > 0.01, "there is something to hear");
}
