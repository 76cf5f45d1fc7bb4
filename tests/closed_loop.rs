//! Contract: the whole way from simulated microphones to motion drives the built-in robot through every world without touching
//! anything and without standing for long; without CA and OA it does touch (the negative control), and never does it drive blindly.

use noctule::config::Config;
use noctule::control::Controller;
use noctule::flow::MaskSet;
use noctule::geometry::Pose2;
use noctule::imaging::backend::{Backend, Image};
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::direct_path::{DirectPath, HEARD_MIN};
use noctule::imaging::plan::ImagingPlan;
use noctule::sensor::SensorSetup;
use noctule::service::regions::mask_params;
use noctule::signal::{Cues, Decision, LayerName, PingSet, SampleFormat};
use noctule::sim::{MotionLimits, RobotParams, RunScore, SimParams, Simulator, World};
use noctule::time::Stamp;
use std::path::Path;
use std::sync::Arc;

const PERIOD_S: f64 = 0.1;
/// From the emission to the command that follows from it.
const LATENCY_NS: u64 = 60_000_000;
const PERIOD_NS: u64 = 100_000_000;
/// Longest that a robot may stay in one place while motion is wanted.
const STOP_MAX_S: f64 = 5.0;

/// World, robot, imaging and controller, stepped with a clock of their own.
struct Loop {
    simulator: Simulator,
    pings: PingSet,
    plan: Arc<ImagingPlan>,
    direct_path: DirectPath,
    backend: CpuBackend,
    image: Image,
    masks: MaskSet,
    controller: Controller,
    now: Stamp,
    /// A sensor whose pings do not arrive.
    absent: Option<usize>,
}

impl Loop {
    fn new(mut config: Config, world: World, params: SimParams, seed: u64, mirrored: bool) -> Self {
        config.recording.format = SampleFormat::PcmF32;
        let mut sensors = config.sensor_setups().unwrap();
        if mirrored {
            sensors.iter_mut().for_each(mirror);
        }
        let (recording, directions) = (config.recording().unwrap(), config.directions().unwrap());
        let zones = config.dead_zones(&sensors, &directions);
        let hidden: Vec<Vec<bool>> = zones.into_iter().map(|zone| zone.hidden).collect();
        let sound_m_s = config.speed_of_sound_m_s();
        let plan =
            Arc::new(ImagingPlan::new(&sensors, &hidden, &recording, &config.imaging, directions, sound_m_s).unwrap());
        let regions = mask_params(&config.control, &config.platform);
        let masks = MaskSet::build(&plan.grid, &sensors, &hidden, &regions).unwrap();
        let backend = CpuBackend::open(Arc::clone(&plan), Arc::clone(masks.table()), Some(1)).unwrap();
        let platform = &config.platform;
        let limits = MotionLimits {
            max_linear_m_s: platform.max_linear_m_s,
            max_angular_rad_s: platform.max_angular_rad_s,
            max_linear_accel_m_s2: platform.max_linear_accel_m_s2,
            max_angular_accel_rad_s2: platform.max_angular_accel_rad_s2,
        };
        let robot = RobotParams { radius_m: platform.radius_m, limits };
        let simulator = Simulator::new(world, &sensors, &recording, robot, sound_m_s, params, seed).unwrap();
        Self {
            pings: simulator.empty_ping_set(),
            simulator,
            direct_path: DirectPath::new(&plan, &sensors, sound_m_s),
            image: Image::empty(&plan, masks.table()),
            backend,
            plan,
            masks,
            controller: Controller::new(&config.control, &config.platform),
            now: Stamp { boottime_ns: 1_000_000_000, wall_ns: 0 },
            absent: None,
        }
    }

    fn default_robot(world: World, seed: u64) -> Self {
        Self::new(Config::default(), world, SimParams::default(), seed, false)
    }

    /// One ping set, one decision, one period of motion.
    fn step(&mut self) -> (Cues, Decision) {
        self.simulator.ping_set(self.now, &mut self.pings);
        if let Some(absent) = self.absent {
            self.pings.present[absent] = false;
        }
        self.backend.image(&self.pings, &mut self.image).unwrap();
        let mut used = self.image.imaged;
        for (index, ping) in self.pings.pings.iter().enumerate() {
            // A sensor that does not hear its own emission is no witness of free space.
            used[index] &= self.pings.present[index] && self.direct_path.correlation(&self.plan, ping) >= HEARD_MIN;
        }
        let cues = self.masks.fuse(&self.image.sums, used, self.now, self.pings.sequence);
        let (wanted, pose) = (self.simulator.wanted_velocity(), self.simulator.odometry().pose);
        let decision = self.controller.step_with_odometry(self.now.plus_ns(LATENCY_NS), &cues, wanted, Some(pose));
        let forward_m_s = decision.velocity.linear_m_s;
        assert!(forward_m_s <= wanted.linear_m_s.max(0.0) + 1e-9, "faster than wanted: {decision:?}");
        assert!(forward_m_s >= wanted.linear_m_s.min(0.0) || decision.layer == LayerName::CollisionAvoidance);
        self.simulator.step(decision.velocity, PERIOD_S);
        self.now = self.now.plus_ns(PERIOD_NS);
        (cues, decision)
    }

    /// Drives until the run is over. Also tells how often the commanded turn changed its sign.
    fn drive(&mut self) -> (RunScore, usize) {
        let (mut changes, mut last_sign) = (0, 0.0);
        while !self.simulator.finished() {
            let (_, decision) = self.step();
            let turn_rad_s = decision.velocity.angular_rad_s;
            if turn_rad_s.abs() > 0.05 {
                changes += usize::from(turn_rad_s.signum() == -last_sign);
                last_sign = turn_rad_s.signum();
            }
        }
        (self.simulator.score(), changes)
    }
}

/// The sensor as a mirror beside the robot shows it.
fn mirror(sensor: &mut SensorSetup) {
    sensor.mount.bearing_rad = -sensor.mount.bearing_rad;
    sensor.mount.yaw_rad = -sensor.mount.yaw_rad;
    sensor.emitter_m.y = -sensor.emitter_m.y;
    sensor.array.positions_m.iter_mut().for_each(|place| place.y = -place.y);
}

fn world(name: &str) -> World {
    World::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/worlds").join(name)).unwrap()
}

fn parse(text: &str) -> World {
    World::parse(Path::new("test.toml"), text).unwrap()
}

/// Drives to the goal and holds the run to: no contact, goal reached, no long stop.
#[track_caller]
fn reaches_goal(world: World, seed: u64) -> (Loop, RunScore, usize) {
    let waypoint_count = world.waypoints.len();
    let mut run = Loop::default_robot(world, seed);
    let (score, changes) = run.drive();
    assert!(!score.collided, "seed {seed}: contact at {:?}: {score:?}", run.simulator.pose());
    assert!(score.reached_goal && score.waypoints_reached == waypoint_count, "seed {seed}: {score:?}");
    assert!(score.longest_stuck_s <= STOP_MAX_S, "seed {seed}: {score:?}");
    (run, score, changes)
}

#[test]
fn the_robot_goes_round_the_office_past_pillars_doors_and_walkers() {
    for seed in [1, 2] {
        let (_, score, _) = reaches_goal(World::default_world().unwrap(), seed);
        assert!(score.mean_speed_m_s > 0.2, "{score:?}");
    }
}

#[test]
fn a_wall_ahead_is_turned_away_from() {
    for seed in 1..=2 {
        reaches_goal(world("wall.toml"), seed);
    }
}

#[test]
fn an_obstacle_in_a_hall_is_gone_round() {
    for seed in 1..=2 {
        reaches_goal(world("obstacle.toml"), seed);
    }
}

#[test]
fn a_junction_is_turned_at_the_way_that_is_meant() {
    for seed in 1..=2 {
        reaches_goal(world("t_junction.toml"), seed);
    }
}

/// Measured: 2 or 3 changes, and less than 2 cm off the middle after 8 m.
#[test]
fn a_corridor_is_driven_in_its_middle_without_weaving() {
    for seed in 1..=2 {
        let (run, _, changes) = reaches_goal(world("corridor.toml"), seed);
        assert!(run.simulator.pose().y_m.abs() < 0.1, "{:?}", run.simulator.pose());
        assert!(changes <= 6, "{changes} changes of the turn's sign");
    }
}

/// The negative control of all of the above: what keeps the robot from the wall are CA and OA.
#[test]
fn without_collision_and_obstacle_avoidance_the_robot_runs_into_the_wall() {
    let mut config = Config::default();
    config.control.collision_avoidance.enabled = false;
    config.control.obstacle_avoidance.enabled = false;
    config.control.corridor_following.enabled = false;
    config.control.stuck.enabled = false;
    let mut run = Loop::new(config, world("wall.toml"), SimParams::default(), 1, false);
    assert!(run.drive().0.collided);
}

/// Somebody walks towards the robot and stops in its way.
const VISITOR: &str = r#"
guidance = false
time_limit_s = 25.0
[[mover]]
radius_m = 0.2
path = [[3.5, 0.05], [1.8, 0.05]]
speed_m_s = 0.3
loop = "once"
[start]
"#;

#[test]
fn a_walker_who_stops_in_the_way_is_gone_round() {
    let mut run = Loop::default_robot(parse(VISITOR), 1);
    let (score, _) = run.drive();
    assert!(!score.collided && score.longest_stuck_s <= STOP_MAX_S, "{score:?} at {:?}", run.simulator.pose());
}

#[test]
fn without_its_front_sensor_the_robot_does_not_drive() {
    for dead_emitter in [true, false] {
        let mut run = Loop::default_robot(world("corridor.toml"), 1);
        for _ in 0..20 {
            run.step();
        }
        assert!(run.simulator.velocity().linear_m_s > 0.25, "it drives at first");
        if dead_emitter {
            run.simulator.set_emitting(0, false);
        } else {
            run.absent = Some(0);
        }
        for _ in 0..20 {
            let (cues, decision) = run.step();
            assert_eq!((cues.sensors_used[0], cues.coverage.ahead_m), (false, 0.0));
            assert!(decision.velocity.linear_m_s <= 0.0, "{decision:?}");
        }
        assert_eq!(run.simulator.velocity().linear_m_s, 0.0);
    }
}

/// A wall askew on the left, a pillar in the way: all layers get to act within the first ten seconds.
const ASKEW: &str = r#"
guidance = false
[[wall]]
points = [[-2.0, 0.9], [9.0, 1.2]]
[[wall]]
points = [[5.0, -3.0], [4.6, 1.0]]
[[pillar]]
centre = [2.2, 0.15]
radius_m = 0.15
[start]
"#;

#[test]
fn a_mirrored_world_gives_the_mirrored_trajectory() {
    let mut flipped = parse(ASKEW);
    for wall in &mut flipped.walls {
        wall.points.iter_mut().for_each(|point| point[1] = -point[1]);
    }
    flipped.pillars.iter_mut().for_each(|pillar| pillar.centre[1] = -pillar.centre[1]);
    let silent = SimParams { noise_rms: 0.0, ..SimParams::default() };
    let mut here = Loop::new(Config::default(), parse(ASKEW), silent, 1, false);
    let mut there = Loop::new(Config::default(), flipped, silent, 1, true);
    let start = Pose2 { x_m: 0.0, y_m: -0.05, heading_rad: 0.05 };
    here.simulator.set_pose(start);
    there.simulator.set_pose(Pose2 { y_m: 0.05, heading_rad: -0.05, ..start });
    let mut turned = false;
    for step in 0..100 {
        let (layer, other_layer) = (here.step().1.layer, there.step().1.layer);
        let (pose, other) = (here.simulator.pose(), there.simulator.pose());
        turned |= pose.heading_rad.abs() > 0.3;
        assert_eq!(layer, other_layer, "step {step}");
        // Sums of f32 in another order; a sign wrong anywhere is off by centimetres within a second.
        let off_m = (pose.x_m - other.x_m).abs().max((pose.y_m + other.y_m).abs());
        assert!(off_m < 1e-3 && (pose.heading_rad + other.heading_rad).abs() < 1e-2, "step {step}: {pose:?} {other:?}");
    }
    assert!(turned, "nothing was avoided: {:?}", here.simulator.pose());
}
