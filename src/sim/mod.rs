//! A world that a robot drives in and hears: commanded velocities in, raw pings, odometry and a score out
//! (specification, section 8).
//!
//! Microphone signals are made from geometry, emission and path lengths alone; nothing here imports `imaging` or `flow`,
//! so that a sign wrong in both cannot cancel out. Everything is decided by the seed: the same world, robot and seed give
//! the same bits, whatever else the machine does. This module reads no clock and starts no thread.
//!
//! ```text
//! World ── Obstacles ──┐
//! SensorSetup ─ Stations ─► paths (planes, corners, edges, cylinders, direct) ─► waveforms at exact delays ─► PingSet
//! Velocity ─► Robot ─► pose, clearance, odometry ─► Guidance ─► wanted velocity
//! ```

mod echo;
mod faults;
mod guidance;
mod obstacles;
mod params;
mod robot;
mod score;
mod solids;
mod world;

pub use faults::{Fault, Faults};
pub use params::{Air, Bursts, JAMMERS_MAX, Jammer, MotionLimits, RobotParams, SimError, SimParams, Turns};
pub use robot::Odometry;
pub use score::{RunScore, Stay};
pub use solids::{Ball, Bar};
pub use world::{Mover, Outline, PathLoop, Pillar, Start, Wall, WantedVelocity, World};

use crate::geometry::shape::Shape;
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::parameter::check_range;
use crate::sensor::{RecordingFormat, SensorSetup};
use crate::signal::{PingSet, SampleFormat, Samples, Velocity};
use crate::time::Stamp;
use echo::EchoMaker;
use guidance::Guidance;
use nalgebra::Vector2;
use obstacles::Obstacles;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use robot::Robot;
use score::{Scorer, is_clear};
use std::sync::Arc;

/// Motion is integrated in steps of at most this.
const STEP_MAX_S: f64 = 0.01;
/// Random places of the start zone that are tried before it counts as full.
const START_TRIES: usize = 1000;

/// What really moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoverTruth {
    /// Its middle in the world.
    pub centre_m: Vector2<f64>,
    /// Its velocity in the world.
    pub velocity_m_s: Vector2<f64>,
    /// Its radius.
    pub radius_m: f64,
    /// Whether nothing stands between it and the robot's middle.
    pub in_sight: bool,
}

/// One robot in one world.
#[derive(Debug, Clone)]
pub struct Simulator {
    world: World,
    obstacles: Obstacles,
    robot: Robot,
    guidance: Guidance,
    scorer: Scorer,
    echoes: EchoMaker,
    format: SampleFormat,
    time_s: f64,
    ping_count: u64,
    clearance_m: f64,
    touching: bool,
}

impl Simulator {
    /// Puts a robot with `sensors` into the start zone of `world`.
    ///
    /// # Errors
    /// [`SimError`] when a parameter is not allowed, the emission's rate is not the recording's, there are too many
    /// sensors or microphones, or the start zone is full.
    pub fn new(
        world: World,
        sensors: &[SensorSetup],
        recording: &RecordingFormat,
        robot: RobotParams,
        speed_of_sound_m_s: f64,
        params: SimParams,
        seed: u64,
    ) -> Result<Self, SimError> {
        world.validate()?;
        robot.validate()?;
        params.validate()?;
        check_range("speed_of_sound_m_s", speed_of_sound_m_s, 200.0, 500.0)?;
        let echoes = EchoMaker::new(sensors, recording, &params, speed_of_sound_m_s, seed)?;
        let obstacles = Obstacles::new(&world);
        let wheel_scale = wheel_scale(params.odometry_drift, seed);
        let mut robot = Robot::new(&robot, sensors.iter().map(|sensor| sensor.mount.pose()), wheel_scale);
        let start = start_pose(&world.start, &robot, &obstacles, seed)?;
        robot.put(start);
        let clearance_m = robot.clearance_m(&start, &obstacles);
        let mut guidance =
            Guidance::new(&world.waypoints, world.reach_m, world.input.linear_m_s, params.repeat_waypoints);
        guidance.update(&start);
        Ok(Self {
            scorer: Scorer::new(start.position_m(), clearance_m),
            world,
            obstacles,
            robot,
            guidance,
            echoes,
            format: recording.format,
            time_s: 0.0,
            ping_count: 0,
            clearance_m,
            touching: false,
        })
    }

    /// A ping set with buffers of the right size for [`Simulator::ping_set`].
    #[must_use]
    pub fn empty_ping_set(&self) -> PingSet {
        let len: Vec<usize> = (0..self.echoes.sensor_count()).map(|sensor| self.echoes.raw_len(sensor)).collect();
        PingSet::empty(len.len(), self.format, &len)
    }

    /// Makes what all sensors hear of an emission at the present pose and time, stamped `emitted_at`. Sensors that fire in turn do so
    /// where the robot and the movers will be by then if they go on as they move now.
    ///
    /// Overwrites `out`; buffers that do not fit are replaced, those that do are kept, and then nothing is allocated.
    pub fn ping_set(&mut self, emitted_at: Stamp, out: &mut PingSet) {
        let sensor_count = self.echoes.sensor_count();
        if out.pings.len() != sensor_count {
            *out = self.empty_ping_set();
        }
        out.sequence = self.ping_count;
        out.emitted_at = emitted_at;
        out.present = std::array::from_fn(|sensor| sensor < sensor_count);
        for (sensor, ping) in out.pings.iter_mut().enumerate() {
            let len = self.echoes.raw_len(sensor);
            if ping.samples.format() != self.format || ping.samples.len() != len {
                ping.samples = Arc::new(Samples::zeros(self.format, len));
            }
            ping.sensor_index = sensor;
            ping.sequence = self.ping_count;
            let turn_s = self.echoes.turn_s(sensor);
            ping.emitted_at = emitted_at.plus_ns((1e9 * turn_s).round() as u64);
            if sensor == 0 || turn_s > 0.0 {
                self.obstacles.move_to(&self.world, self.time_s + turn_s);
                let velocity = self.robot.body_velocity();
                self.echoes.place(&robot::moved(&self.robot.pose, velocity, turn_s), velocity);
            }
            self.echoes.hear(sensor, self.ping_count, &self.obstacles, ping.samples_mut());
        }
        self.obstacles.move_to(&self.world, self.time_s);
        self.ping_count += 1;
    }

    /// Lets the robot obey `commanded` for `dt_s`, and the movers walk on.
    ///
    /// The command is bent to the platform's limits of speed and acceleration; one that is not finite means standing
    /// still. The robot cannot drive through things: it stops in contact, see [`Simulator::contact`].
    pub fn step(&mut self, commanded: Velocity, dt_s: f64) {
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return;
        }
        let motion_wanted = self.wanted_velocity() != Velocity::ZERO;
        let start_s = self.time_s;
        let count = (dt_s / STEP_MAX_S).ceil().max(1.0);
        let part_s = dt_s / count;
        for part in 1..=count as u64 {
            self.time_s = start_s + dt_s * (part as f64 / count);
            self.obstacles.move_to(&self.world, self.time_s);
            self.robot.velocity = self.robot.velocity_after(commanded, part_s);
            self.clearance_m = self.robot.advance(part_s, &self.obstacles);
            self.touching = !is_clear(self.clearance_m);
            self.guidance.update(&self.robot.pose);
            self.scorer.note(
                self.time_s,
                self.robot.pose.position_m(),
                self.clearance_m,
                motion_wanted,
                (self.guidance.reached, self.world.waypoints.len()),
                self.world.time_limit_s,
            );
        }
    }

    /// What the world wants of the robot now: guidance to the next waypoint, or the world's constant input.
    #[must_use]
    pub fn wanted_velocity(&self) -> Velocity {
        if self.world.guidance && !self.world.waypoints.is_empty() {
            return self.guidance.wanted(&self.robot.pose, &self.robot.params.limits);
        }
        let WantedVelocity { linear_m_s, angular_rad_s } = self.world.input;
        Velocity { linear_m_s, angular_rad_s }
    }

    /// Switches a sensor's emission on or off, for tests of faults; its microphones go on hearing.
    pub fn set_emitting(&mut self, sensor_index: usize, on: bool) {
        self.echoes.set_emitting(sensor_index, on);
    }

    /// Sets what hides things on the robot itself, in its frame: masts and boxes on the deck. They do not echo.
    pub fn set_obstructions(&mut self, shapes: &[Shape]) {
        self.echoes.set_obstructions(shapes);
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// True pose of the robot in the world.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        self.robot.pose
    }

    /// Sets the robot down somewhere else, at rest; odometry starts anew there.
    pub fn set_pose(&mut self, pose: Pose2) {
        self.robot.put(pose);
        self.clearance_m = self.robot.clearance_m(&pose, &self.obstacles);
    }

    /// True velocity of the robot.
    #[must_use]
    pub fn velocity(&self) -> Velocity {
        self.robot.body_velocity()
    }

    /// Lets the wheels slip: each brings this share of its turning to the floor, left and right; odometry does not know. What is not
    /// between 0 and 1 counts as 1.
    pub fn set_grip(&mut self, share: [f64; 2]) {
        self.robot.grip = share.map(|share| if (0.0..=1.0).contains(&share) { share } else { 1.0 });
    }

    /// Where each mover is, how it moves and whether a line from the robot's middle to it is free.
    pub fn movers(&self) -> impl Iterator<Item = MoverTruth> + '_ {
        let here_m = self.robot.pose.position_m();
        self.obstacles.movers().iter().map(move |circle| {
            let offset_m = circle.centre_m - here_m;
            let rim_m = here_m + offset_m * (1.0 - circle.radius_m / offset_m.norm().max(circle.radius_m));
            MoverTruth {
                centre_m: circle.centre_m,
                velocity_m_s: circle.velocity_m_s,
                radius_m: circle.radius_m,
                in_sight: !self.obstacles.block(here_m, rim_m),
            }
        })
    }

    /// Pose and twist as the wheels report them, in the world's frame.
    #[must_use]
    pub fn odometry(&self) -> Odometry {
        self.robot.odometry
    }

    /// Simulated time since the start.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Whether the footprint (body, and housings outside it) touches anything, or was stopped by it in the last step.
    #[must_use]
    pub fn contact(&self) -> bool {
        self.touching
    }

    /// Gap between the footprint and whatever is nearest, after the last step.
    #[must_use]
    pub fn clearance_m(&self) -> f64 {
        self.clearance_m
    }

    /// Gap between the footprint's disc and the nearest mover, after the last step; infinite without movers.
    #[must_use]
    pub fn mover_clearance_m(&self) -> f64 {
        let (place_m, radius_m) = (self.robot.pose.position_m(), self.robot.params.radius_m);
        let gap_m = |circle: &obstacles::Circle| (circle.centre_m - place_m).norm() - circle.radius_m - radius_m;
        self.obstacles.movers().iter().map(gap_m).fold(f64::INFINITY, f64::min)
    }

    /// The waypoint meant now, if there is one left.
    #[must_use]
    pub fn next_waypoint_m(&self) -> Option<[f64; 2]> {
        self.guidance.target_m().map(Into::into)
    }

    /// Waypoints reached, rounds included.
    #[must_use]
    pub fn waypoints_reached(&self) -> usize {
        self.guidance.reached
    }

    /// Whether the last waypoint was reached in time; without waypoints, whether the limit was reached without contact.
    #[must_use]
    pub fn goal_reached(&self) -> bool {
        self.scorer.score.reached_goal
    }

    /// Whether the run is over: contact, goal or time limit. The score stands still from then on, the world does not.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.scorer.finished
    }

    /// How the run went so far.
    #[must_use]
    pub fn score(&self) -> RunScore {
        self.scorer.score
    }
}

/// Draws the start pose: the first place of the zone, in the order of the seed, that is free.
fn start_pose(start: &Start, robot: &Robot, obstacles: &Obstacles, seed: u64) -> Result<Pose2, SimError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for _ in 0..START_TRIES {
        let pose = Pose2 {
            x_m: start.corner[0] + start.size[0] * random.random::<f64>(),
            y_m: start.corner[1] + start.size[1] * random.random::<f64>(),
            heading_rad: wrap_angle_rad(
                (start.heading_deg + start.heading_spread_deg * (2.0 * random.random::<f64>() - 1.0)).to_radians(),
            ),
        };
        if robot.clearance_m(&pose, obstacles) > 0.0 {
            return Ok(pose);
        }
    }
    Err(SimError::NoRoomAtStart { tries: START_TRIES })
}

/// Relative errors of the two wheels' diameters: sums of twelve uniform numbers, which is Gaussian enough.
fn wheel_scale(drift: f64, seed: u64) -> [f64; 2] {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(1);
    std::array::from_fn(|_| 1.0 + drift * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0))
}
