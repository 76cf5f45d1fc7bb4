//! Contract: world files are read strictly; the robot drives, touches, is guided and scored as the specification says
//! (section 8). Expected motion is integrated here, independently.

mod sim_support;

use noctule::geometry::Pose2;
use noctule::sensor::SensorSetup;
use noctule::signal::{SampleFormat, Velocity};
use noctule::sim::{
    MotionLimits, Mover, Outline, PathLoop, Pillar, RobotParams, SimError, SimParams, Simulator, Start, World,
};
use sim_support::{SPEED_M_S, open_wall, pcm, pdm, sensor, three_sensors};
use std::path::Path;

fn drive(world: World, sensors: &[SensorSetup], params: SimParams, seed: u64) -> Simulator {
    Simulator::new(world, sensors, &pcm(), RobotParams::default(), SPEED_M_S, params, seed).unwrap()
}

fn alone(world: World) -> Simulator {
    drive(world, &[sensor(0.0, 0.0, 0.0)], SimParams::default(), 1)
}

#[test]
fn every_world_file_loads_and_leaves_room_to_start() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/worlds");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let world = World::load(&path).unwrap_or_else(|error| panic!("{error}"));
        for seed in 0..20 {
            assert!(drive(world.clone(), &three_sensors(), SimParams::default(), seed).clearance_m() > 0.05);
        }
        names.push(path.file_stem().unwrap().to_string_lossy().into_owned());
    }
    let paper = ["default", "corridor", "wall", "obstacle", "t_junction"];
    let harder = ["thin_pillars", "glass", "narrow_doors", "crossing", "warehouse", "apartment"];
    for name in paper.into_iter().chain(harder) {
        assert!(names.iter().any(|found| found == name), "{name} of {names:?}");
    }
    let built_in = World::default_world().unwrap();
    assert_eq!(built_in, World::load(Path::new("fixtures/worlds/default.toml")).unwrap());
    assert!(built_in.waypoints.len() >= 4 && !built_in.movers.is_empty() && built_in.pillars.len() >= 2);
}

#[test]
fn a_missing_world_file_is_named() {
    let error = World::load(Path::new("fixtures/worlds/nowhere.toml")).unwrap_err();
    assert!(error.to_string().contains("nowhere.toml"), "{error}");
}

#[test]
fn a_complete_world_file_means_what_it_says() {
    let text = r#"
        waypoints = [[1.0, 2.0], [3.0, 4.0]]
        reach_m = 0.5
        time_limit_s = 60.0
        input = { linear_m_s = 0.2, angular_rad_s = -0.1 }
        guidance = false
        [[wall]]
        points = [[0, 0], [1, 0], [1, 1]]
        closed = true
        [[pillar]]
        centre = [5.0, 5.0]
        radius_m = 0.25
        [[mover]]
        radius_m = 0.3
        path = [[6, 6], [7, 6]]
        speed_m_s = 0.4
        loop = "cycle"
        start_s = 2.0
        [start]
        corner = [-3.0, -3.0]
        size = [0.5, 0.5]
        heading_deg = 90.0
        heading_spread_deg = 5.0
    "#;
    let world = World::parse(Path::new("here.toml"), text).unwrap();
    assert_eq!((world.waypoints.len(), world.reach_m, world.time_limit_s, world.guidance), (2, 0.5, 60.0, false));
    assert_eq!((world.input.linear_m_s, world.input.angular_rad_s), (0.2, -0.1));
    assert_eq!(world.walls[0].pieces().count(), 3, "closed");
    assert_eq!((world.movers[0].repeat, world.movers[0].start_s), (PathLoop::Cycle, 2.0));
    assert_eq!(world.start.heading_spread_deg, 5.0);
    let circles: Vec<_> = world.outline(2.0 + 1.25).filter(|piece| matches!(piece, Outline::Circle { .. })).collect();
    let Outline::Circle { centre_m, moving: true, .. } = circles[1] else { panic!("{circles:?}") };
    assert!((centre_m.x - 6.5).abs() < 1e-12, "half a metre along after 1.25 s at 0.4 m/s");
    let defaults = World::parse(Path::new("empty.toml"), "").unwrap();
    assert_eq!((defaults.reach_m, defaults.time_limit_s, defaults.guidance), (0.3, 120.0, true));
}

#[test]
fn broken_worlds_are_refused_with_the_key_that_is_wrong() {
    for (text, key) in [
        ("reach = 0.3", "reach"),
        ("[[wall]]\npoints = [[0.0, 0.0]]", "wall[0].points"),
        ("[[wall]]\npoints = [[0, 0], [1, 1]]\nclosed = true", "wall[0].points"),
        ("[[wall]]\npoints = [[0, 0], [1, 1], [1, 1]]", "wall[0].points[2]"),
        ("[[wall]]\npoints = [[0, 0], [1, 0], [1, 1], [0, 0]]\nclosed = true", "wall[0].points"),
        ("[[wall]]\npoints = [[0, 0], [nan, 1]]", "wall[0].points[1][0]"),
        ("[[wall]]\npoints = [[0, 0], [1, 0]]\n[[wall]]\npoints = [[0, 0], [inf, 0]]", "wall[1].points[1][0]"),
        ("[[wall]]\npoints = [[0, 0, 0], [1, 1, 1]]", "points"),
        ("[[pillar]]\ncentre = [0, 0]\nradius_m = 0", "pillar[0].radius_m"),
        ("[[pillar]]\ncentre = [0, 0]", "radius_m"),
        ("[[pillar]]\ncentre = [0, 0]\nradius = 1", "radius"),
        ("[[mover]]\nradius_m = 0.1\npath = []", "mover[0].path"),
        ("[[mover]]\nradius_m = 0.1\npath = [[0, 0]]\nspeed_m_s = -1", "mover[0].speed_m_s"),
        ("[[mover]]\nradius_m = 0.1\npath = [[0, 0]]\nloop = \"random\"", "random"),
        ("[start]\nsize = [-1, 0]", "start.size[0]"),
        ("[start]\nheading_spread_deg = 200", "start.heading_spread_deg"),
        ("reach_m = 0", "reach_m"),
        ("time_limit_s = -1", "time_limit_s"),
        ("input = { linear_m_s = nan, angular_rad_s = 0 }", "input.linear_m_s"),
        ("waypoints = [[1, 2], [1e9, 0]]", "waypoints[1][0]"),
        ("waypoints = [[1, 2]", "waypoints"),
    ] {
        let error = World::parse(Path::new("broken.toml"), text).expect_err(text).to_string();
        assert!(error.contains(key) && error.contains("broken.toml"), "{text:?} gives {error:?}, expected {key:?}");
    }
}

#[test]
fn the_robot_stops_in_contact_with_a_wall_and_can_leave_it_again() {
    let mut simulator = alone(World { walls: vec![open_wall(&[[1.0, -3.0], [1.0, 3.0]])], ..World::default() });
    for _ in 0..60 {
        assert!(!simulator.contact() || simulator.pose().x_m > 0.79);
        simulator.step(Velocity::forward_m_s(0.3), 0.1);
    }
    assert!(simulator.contact() && simulator.score().collided && simulator.finished());
    let stopped = simulator.pose();
    assert!(stopped.x_m <= 0.8 && stopped.x_m > 0.79, "radius 0.2 m before the wall at 1 m: {}", stopped.x_m);
    assert_eq!(simulator.score().min_clearance_m, 0.0);
    for _ in 0..10 {
        simulator.step(Velocity::forward_m_s(-0.3), 0.1);
    }
    assert!(!simulator.contact() && simulator.pose().x_m < 0.6);
    assert!(simulator.score().collided, "a contact is never forgotten");
}

#[test]
fn a_sensor_outside_the_body_touches_before_the_body_does() {
    let world = || World { pillars: vec![Pillar { centre: [1.0, 0.0], radius_m: 0.1 }], ..World::default() };
    let mut simulator = drive(world(), &[sensor(0.25, 0.0, 0.0)], SimParams::default(), 1);
    for _ in 0..60 {
        simulator.step(Velocity::forward_m_s(0.3), 0.1);
    }
    // The housing's front face is at the sensor's origin; the pillar begins at 0.9 m.
    let front_m = simulator.pose().x_m + 0.25;
    assert!(simulator.contact() && front_m <= 0.9 && front_m > 0.89, "{front_m}");
    let mut inside = drive(world(), &[sensor(0.1, 0.0, 0.0)], SimParams::default(), 1);
    for _ in 0..60 {
        inside.step(Velocity::forward_m_s(0.3), 0.1);
    }
    assert!(inside.pose().x_m > 0.69 && inside.pose().x_m <= 0.7, "control: the body itself, {}", inside.pose().x_m);
}

#[test]
fn a_mover_that_runs_into_the_standing_robot_is_contact() {
    let mover = Mover {
        radius_m: 0.2,
        path: vec![[3.0, 0.0], [-3.0, 0.0]],
        speed_m_s: 0.5,
        repeat: PathLoop::Once,
        start_s: 0.0,
    };
    let mut simulator = alone(World { movers: vec![mover], ..World::default() });
    let mut first_contact_s = None;
    while simulator.time_s() < 8.0 {
        simulator.step(Velocity::ZERO, 0.1);
        if simulator.contact() && first_contact_s.is_none() {
            first_contact_s = Some(simulator.time_s());
        }
    }
    // The gap of 3 - 0.4 m closes at 0.5 m/s.
    let expected_s = 2.6 / 0.5;
    assert!((first_contact_s.unwrap() - expected_s).abs() <= 0.11, "{first_contact_s:?}");
}

#[test]
fn guidance_reaches_every_waypoint_of_an_empty_world_and_slows_for_sharp_turns() {
    for seed in 0..8 {
        let world = World {
            waypoints: vec![[3.0, 0.0], [3.0, 2.0], [0.0, 2.5], [-1.0, -1.0], [2.0, -1.0]],
            start: Start { heading_spread_deg: 180.0, size: [0.5, 0.5], ..Start::default() },
            ..World::default()
        };
        let mut simulator = drive(world, &[sensor(0.0, 0.0, 0.0)], SimParams::default(), seed);
        let mut slowest_near_turn_m_s = f64::INFINITY;
        while !simulator.finished() {
            let wanted = simulator.wanted_velocity();
            assert!(wanted.linear_m_s <= 0.3 + 1e-12 && wanted.linear_m_s >= 0.0, "{wanted:?}");
            simulator.step(wanted, 0.1);
            let to_first_turn_m = (simulator.pose().position_m() - nalgebra::Vector2::new(3.0, 0.0)).norm();
            if to_first_turn_m < 0.35 {
                slowest_near_turn_m_s = slowest_near_turn_m_s.min(simulator.velocity().linear_m_s);
            }
        }
        let score = simulator.score();
        assert!(score.reached_goal && score.waypoints_reached == 5 && !score.collided, "{score:?}");
        assert!(score.path_length_m > 11.0 && score.path_length_m < 17.0, "{score:?}");
        assert!(slowest_near_turn_m_s < 0.25, "{slowest_near_turn_m_s}");
        assert_eq!(simulator.wanted_velocity(), Velocity::ZERO, "nothing left to reach");
    }
}

#[test]
fn guidance_that_repeats_goes_round_again() {
    let world = World { waypoints: vec![[0.6, 0.0], [0.6, 0.6], [0.0, 0.3]], reach_m: 0.2, ..World::default() };
    let params = SimParams { repeat_waypoints: true, ..SimParams::default() };
    let mut simulator = drive(world, &[sensor(0.0, 0.0, 0.0)], params, 1);
    for _ in 0..600 {
        let wanted = simulator.wanted_velocity();
        simulator.step(wanted, 0.1);
    }
    assert!(simulator.waypoints_reached() > 6, "{}", simulator.waypoints_reached());
}

#[test]
fn without_guidance_the_input_drives_and_waypoints_only_score() {
    let world = World { waypoints: vec![[1.0, 1.0]], guidance: false, ..World::default() };
    let mut simulator = alone(world.clone());
    assert_eq!(simulator.wanted_velocity(), Velocity::forward_m_s(0.3));
    for _ in 0..100 {
        simulator.step(Velocity::forward_m_s(0.3), 0.1);
    }
    assert!(!simulator.goal_reached() && simulator.waypoints_reached() == 0);
    let on_the_way = World { waypoints: vec![[1.0, 0.2]], ..world };
    let mut simulator = alone(on_the_way);
    for _ in 0..100 {
        simulator.step(Velocity::forward_m_s(0.3), 0.1);
    }
    assert!(simulator.goal_reached());
}

#[test]
fn motion_is_the_integral_of_the_velocity_and_odometry_agrees() {
    let mut simulator = alone(World::default());
    let commands = [(0.3, 0.0), (0.3, 0.5), (0.1, -0.9), (0.0, 0.8), (-0.2, 0.1)];
    let (mut x, mut y, mut heading) = (0.0f64, 0.0f64, 0.0f64);
    for (linear_m_s, angular_rad_s) in commands {
        // Let the acceleration limit settle, then integrate finely from the true start.
        for _ in 0..10 {
            simulator.step(Velocity { linear_m_s, angular_rad_s }, 0.1);
        }
        (x, y, heading) = (simulator.pose().x_m, simulator.pose().y_m, simulator.pose().heading_rad);
        simulator.step(Velocity { linear_m_s, angular_rad_s }, 0.7);
        for _ in 0..70_000 {
            let middle = heading + 0.5 * angular_rad_s * 1e-5;
            x += linear_m_s * middle.cos() * 1e-5;
            y += linear_m_s * middle.sin() * 1e-5;
            heading += angular_rad_s * 1e-5;
        }
        let pose = simulator.pose();
        assert!((pose.x_m - x).abs() < 1e-9 && (pose.y_m - y).abs() < 1e-9, "{pose:?} {x} {y}");
        assert!((pose.heading_rad - heading).sin().abs() < 1e-9);
    }
    let (truth, odometry) = (simulator.pose(), simulator.odometry().pose);
    assert!((truth.position_m() - odometry.position_m()).norm() < 1e-9);
    assert!(x.hypot(y) > 0.3 && heading.is_finite(), "the test drove somewhere");
}

#[test]
fn odometry_drifts_as_configured_and_as_the_seed_says() {
    let error_m = |drift: f64, seed: u64| {
        let params = SimParams { odometry_drift: drift, ..SimParams::default() };
        let mut simulator = drive(World::default(), &[sensor(0.0, 0.0, 0.0)], params, seed);
        for _ in 0..100 {
            simulator.step(Velocity::forward_m_s(0.3), 0.1);
        }
        (simulator.pose().position_m() - simulator.odometry().pose.position_m()).norm()
    };
    assert_eq!(error_m(0.0, 1), 0.0);
    let errors: Vec<f64> = (0..20).map(|seed| error_m(0.01, seed)).collect();
    let mean = errors.iter().sum::<f64>() / 20.0;
    // 3 m with wheels 1 % off: 2 cm along and, by turning, 0.5 * 3 m * (3 m * 0.014 / 0.32 m) = 20 cm sideways, typically.
    assert!(mean > 0.05 && mean < 0.4, "{errors:?}");
    assert_eq!(error_m(0.01, 3), error_m(0.01, 3));
    assert!(errors.windows(2).all(|pair| pair[0] != pair[1]));
}

#[test]
fn commands_are_bent_to_the_platforms_limits_and_nonsense_means_standing_still() {
    let limits = MotionLimits {
        max_linear_m_s: 0.5,
        max_angular_rad_s: 1.0,
        max_linear_accel_m_s2: 0.4,
        max_angular_accel_rad_s2: 2.0,
    };
    let robot = RobotParams { radius_m: 0.2, limits, ..RobotParams::default() };
    let sensors = [sensor(0.0, 0.0, 0.0)];
    let mut simulator =
        Simulator::new(World::default(), &sensors, &pcm(), robot, SPEED_M_S, SimParams::default(), 1).unwrap();
    simulator.step(Velocity { linear_m_s: 9.0, angular_rad_s: -9.0 }, 0.25);
    assert!((simulator.velocity().linear_m_s - 0.1).abs() < 1e-9);
    assert!((simulator.velocity().angular_rad_s + 0.5).abs() < 1e-9);
    simulator.step(Velocity { linear_m_s: 9.0, angular_rad_s: -9.0 }, 5.0);
    assert_eq!(simulator.velocity(), Velocity { linear_m_s: 0.5, angular_rad_s: -1.0 });
    simulator.step(Velocity { linear_m_s: f64::NAN, angular_rad_s: 0.3 }, 5.0);
    assert_eq!(simulator.velocity(), Velocity::ZERO);
    let before = simulator.time_s();
    simulator.step(Velocity::forward_m_s(0.1), f64::NAN);
    simulator.step(Velocity::forward_m_s(0.1), -1.0);
    assert_eq!(simulator.time_s(), before);
}

#[test]
fn a_run_without_waypoints_is_won_by_no_contact_until_the_limit_and_standing_counts_as_stuck() {
    let mut simulator = alone(World { time_limit_s: 5.0, ..World::default() });
    while !simulator.finished() {
        assert!(!simulator.goal_reached());
        let wanted = if simulator.time_s() < 2.0 { Velocity::forward_m_s(0.3) } else { Velocity::ZERO };
        simulator.step(wanted, 0.1);
    }
    let score = simulator.score();
    assert!(score.reached_goal && (score.duration_s - 5.0).abs() < 1e-6, "{score:?}");
    assert!((score.longest_stuck_s - 3.0).abs() < 0.6, "{score:?}");
    assert!((score.mean_speed_m_s - score.path_length_m / 5.0).abs() < 1e-12);
    let json = serde_json::to_value(score).unwrap();
    for key in [
        "collided",
        "reached_goal",
        "waypoints_reached",
        "longest_stuck_s",
        "duration_s",
        "path_length_m",
        "min_clearance_m",
        "mean_speed_m_s",
    ] {
        assert!(!json[key].is_null(), "{key}");
    }
}

#[test]
fn starts_fill_the_zone_and_belong_to_their_seed() {
    let start = Start { corner: [2.0, -1.0], size: [2.0, 1.0], heading_deg: 90.0, heading_spread_deg: 10.0 };
    let world = World { start, ..World::default() };
    let pose = |seed: u64| drive(world.clone(), &[sensor(0.0, 0.0, 0.0)], SimParams::default(), seed).pose();
    let poses: Vec<Pose2> = (0..60).map(pose).collect();
    for pose in &poses {
        assert!((2.0..=4.0).contains(&pose.x_m) && (-1.0..=0.0).contains(&pose.y_m));
        assert!((80.0..=100.0).contains(&pose.heading_rad.to_degrees()));
    }
    let mean_x = poses.iter().map(|pose| pose.x_m).sum::<f64>() / 60.0;
    assert!((mean_x - 3.0).abs() < 0.3, "{mean_x}");
    assert_eq!(pose(7), pose(7));
}

#[test]
fn what_cannot_be_simulated_is_refused_at_start() {
    let refuse = |world: World, sensors: &[SensorSetup], recording, params| {
        Simulator::new(world, sensors, &recording, RobotParams::default(), SPEED_M_S, params, 1).unwrap_err()
    };
    let full = World { pillars: vec![Pillar { centre: [0.0, 0.0], radius_m: 1.0 }], ..World::default() };
    let one = [sensor(0.0, 0.0, 0.0)];
    let params = SimParams::default();
    assert!(matches!(refuse(full, &one, pcm(), params), SimError::NoRoomAtStart { .. }));
    let mut slow = pcm();
    slow.sample_rate_hz = 250e3;
    let error = refuse(World::default(), &one, slow, params).to_string();
    assert!(error.contains("sonar") && error.contains("250000"), "{error}");
    let mut wide = sensor(0.0, 0.0, 0.0);
    wide.array.positions_m.push(nalgebra::Vector3::zeros());
    assert!(refuse(World::default(), &[wide], pdm(), params).to_string().contains("33"));
    let error = refuse(World::default(), &[], pcm(), params).to_string();
    assert!(error.contains("1 to 3"), "{error}");
    let negative = SimParams { noise_rms: -1.0, ..params };
    assert!(refuse(World::default(), &one, pcm(), negative).to_string().contains("noise_rms"));
    let mut decimated = pcm();
    decimated.decimation = 10;
    decimated.format = SampleFormat::PcmI16;
    assert!(refuse(World::default(), &one, decimated, params).to_string().contains("decimation"));
}

#[test]
fn the_default_world_can_be_driven_round_by_guidance_alone_when_nobody_walks_about() {
    let mut world = World::default_world().unwrap();
    world.movers.clear();
    for seed in 0..5 {
        let mut simulator = drive(world.clone(), &three_sensors(), SimParams::default(), seed);
        while !simulator.finished() {
            let wanted = simulator.wanted_velocity();
            simulator.step(wanted, 0.1);
        }
        assert!(simulator.goal_reached(), "{:?} at {:?}", simulator.score(), simulator.pose());
    }
}

/// How a robot of `radius_m` fares in a world file when it follows guidance and hears nothing.
fn driven_blindly(name: &str, radius_m: f64, with_movers: bool, seed: u64) -> noctule::sim::RunScore {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/worlds");
    let mut world = World::load(&folder.join(name)).unwrap();
    if !with_movers {
        world.movers.clear();
    }
    let robot = RobotParams { radius_m, ..RobotParams::default() };
    let sensors = [sensor(0.0, 0.0, 0.0)];
    let mut simulator = Simulator::new(world, &sensors, &pcm(), robot, SPEED_M_S, SimParams::default(), seed).unwrap();
    while !simulator.finished() {
        let wanted = simulator.wanted_velocity();
        simulator.step(wanted, 0.1);
    }
    simulator.score()
}

#[test]
fn the_ways_of_the_harder_worlds_are_as_wide_as_they_say() {
    for (name, radius_m, gap_m) in [
        // 5 cm on either side, less what the guidance cuts corners.
        ("narrow_doors.toml", 0.1, 0.005),
        ("crossing.toml", 0.2, 0.3),
        ("warehouse.toml", 0.2, 0.2),
        ("apartment.toml", 0.2, 0.1),
    ] {
        for seed in 0..10 {
            let score = driven_blindly(name, radius_m, false, seed);
            assert!(score.reached_goal && score.min_clearance_m > gap_m, "{name}: {score:?}");
        }
    }
    // Control: the doors are narrow, a robot 5 cm wider on either side does not pass.
    assert!(driven_blindly("narrow_doors.toml", 0.15, false, 1).collided);
}

#[test]
fn who_hears_nothing_runs_into_thin_pillars_panes_and_people() {
    for (name, radius_m) in
        [("thin_pillars.toml", 0.1), ("glass.toml", 0.1), ("crossing.toml", 0.1), ("crossing.toml", 0.2)]
    {
        for seed in 0..10 {
            let score = driven_blindly(name, radius_m, true, seed);
            assert!(score.collided && !score.reached_goal, "{name}, seed {seed}: {score:?}");
        }
    }
}
