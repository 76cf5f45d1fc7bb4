//! One simulated robot driving through one world: the daemon's pipeline, the controller's gate and the simulator, stepped
//! with a clock of their own, faster than real time and bit-reproducible.
//!
//! Goes in: a robot ([`TrialRig`]), a world, and what is to go wrong ([`TrialOptions`]). Comes out: [`Trial`], the score and
//! the track of the drive. What happens in which order is [`mod@super::drive`]'s. Reads no clock.

use super::ServiceError;
use super::drive::Drive;
use super::wiring::{self, SensingSetup};
use crate::config::Config;
use crate::flow::MaskSet;
use crate::geometry::Pose2;
use crate::imaging::backend::{BackendError, BackendReport};
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::safety::GateState;
use crate::signal::{Cause, Cues, DaemonState, Energyscape, LayerName, SENSORS_MAX, Velocity};
use crate::sim::{MoverTruth, RunScore, SimParams, Stay, World};
use std::sync::Arc;

/// Ping sets that the self-test and arming may take.
const START_SETS_MAX: u32 = 100;
/// A GPU that takes longer than this for a ping set hangs.
const GPU_PATIENCE_MS: u64 = 10_000;
/// A mover within this distance of the footprint counts as in the way.
const MOVER_NEAR_M: f64 = 1.0;
/// Smallest commanded turn that counts as one when changes of sign are counted.
const TURN_MIN_RAD_S: f64 = 0.05;

/// A robot ready to be driven: configuration, sensors, plan and masks, made once and shared by all its trials.
pub struct TrialRig {
    config: Config,
    setup: SensingSetup,
    masks: MaskSet,
}

/// A sensor that falls silent: its pings no longer arrive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorLoss {
    /// Index of the sensor.
    pub sensor_index: usize,
    /// Simulated time from which it is lost.
    pub at_s: f64,
}

/// A time in which the wheels slip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slip {
    /// Simulated time at which it begins and ends.
    pub from_to_s: [f64; 2],
    /// Share of its turning that each wheel brings to the floor: left, right.
    pub grip: [f64; 2],
}

/// What a trial may be told.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialOptions {
    /// Acoustics.
    pub acoustics: SimParams,
    /// Seed of start, noise and odometry.
    pub seed: u64,
    /// Backend.
    pub prefer: Prefer,
    /// Sensors that are lost on the way.
    pub losses: Vec<SensorLoss>,
    /// Times in which the wheels slip.
    pub slips: Vec<Slip>,
}

impl Default for TrialOptions {
    fn default() -> Self {
        Self { acoustics: SimParams::default(), seed: 1, prefer: Prefer::Cpu, losses: Vec::new(), slips: Vec::new() }
    }
}

/// The drive at the time of one ping set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackPoint {
    /// Simulated time.
    pub time_s: f64,
    /// True pose in the world.
    pub pose: Pose2,
    /// True velocity.
    pub velocity: Velocity,
    /// What the world asked for.
    pub wanted: Velocity,
    /// What was decided.
    pub decided: Velocity,
    /// The layer that decided.
    pub layer: LayerName,
    /// Why it did.
    pub cause: Cause,
    /// Whether the controller counted the robot as stuck.
    pub stuck: bool,
    /// State of the daemon.
    pub state: DaemonState,
    /// State of the controller's gate.
    pub gate: GateState,
    /// Gap between footprint and whatever is nearest.
    pub clearance_m: f64,
    /// Gap between footprint and the nearest mover; infinite without one.
    pub mover_clearance_m: f64,
}

/// How a trial went.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Seed.
    pub seed: u64,
    /// The simulator's score.
    pub score: RunScore,
    /// Longest time in one place although motion was wanted and no mover was within 1 m.
    pub longest_stuck_unhindered_s: f64,
    /// Changes of the turn's sign in AFF and RCF, per metre of way: a robot that weaves in a corridor has many.
    pub turn_changes_per_m: f64,
    /// Drive, a point a ping set.
    pub track: Vec<TrackPoint>,
}

impl Trial {
    /// Share of the ping sets that each layer decided, in the order of [`LayerName`]'s numbers; sums to 1 unless there were none.
    #[must_use]
    pub fn layer_share(&self) -> [(LayerName, f64); 6] {
        let count = self.track.len().max(1) as f64;
        LayerName::ALL.map(|name| (name, self.track.iter().filter(|point| point.layer == name).count() as f64 / count))
    }
}

/// What is shown to a watcher after every ping set.
pub struct Moment<'a> {
    /// The point just added to the track.
    pub point: &'a TrackPoint,
    /// What the layers were given.
    pub cues: &'a Cues,
    /// The energyscapes, in the order of the sensors.
    pub energyscapes: &'a [Energyscape],
    /// Where odometry put the robot when the sensors pinged.
    pub odometry: Pose2,
    /// What really moved then.
    pub movers: &'a [MoverTruth],
}

impl TrialRig {
    /// Plans sensors and masks. The raw data are PCM f32 unless `config.recording` was set by the caller.
    ///
    /// # Errors
    /// What the configuration asks for and cannot be.
    pub fn new(config: Config) -> Result<Self, ServiceError> {
        let setup = wiring::sensing(&config)?;
        let masks = wiring::masks(&config, &setup)?;
        Ok(Self { config, setup, masks })
    }

    /// The sensors and their plan.
    #[must_use]
    pub fn setup(&self) -> &SensingSetup {
        &self.setup
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The masks.
    #[must_use]
    pub fn masks(&self) -> &MaskSet {
        &self.masks
    }

    /// Opens the backend that a trial would have, says which it was and lets it go.
    ///
    /// # Errors
    /// When there is none.
    pub fn backend(&self, prefer: Prefer) -> Result<BackendReport, ServiceError> {
        let imager = open_imager(&self.setup, &self.masks, prefer)?;
        imager.announce();
        Ok(imager.report().clone())
    }

    /// Drives until contact, goal or time limit. `watch` sees every ping set and ends the trial early by returning false.
    ///
    /// # Errors
    /// When the robot does not fit into the start zone, there is no backend, or a ping set cannot be imaged.
    pub fn run(
        &self,
        world: World,
        options: &TrialOptions,
        watch: &mut dyn FnMut(&Moment) -> bool,
    ) -> Result<Trial, ServiceError> {
        let mut run = Run::new(self, world, options)?;
        run.arm(options)?;
        while !run.drive.simulator.finished() && run.step(options, watch)? {}
        Ok(run.finish(options.seed))
    }
}

/// An imager of one thread. Simulated time waits for a GPU: a deadline in real time would make the result depend on the
/// machine's load.
pub(super) fn open_imager(setup: &SensingSetup, masks: &MaskSet, prefer: Prefer) -> Result<Imager, BackendError> {
    let options = ImagerOptions { threads: Some(1), gpu_deadline_ms: GPU_PATIENCE_MS };
    Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), prefer, options)
}

/// A trial under way.
struct Run {
    drive: Drive,
    track: Vec<TrackPoint>,
    unhindered: Stay,
    turns: TurnCounter,
    movers: Vec<MoverTruth>,
}

impl Run {
    fn new(rig: &TrialRig, world: World, options: &TrialOptions) -> Result<Self, ServiceError> {
        let imager = open_imager(&rig.setup, &rig.masks, options.prefer)?;
        let drive = Drive::new(rig, world, options.acoustics, options.seed, imager)?;
        let unhindered = Stay::new(drive.simulator.pose().position_m());
        Ok(Self { drive, track: Vec::new(), unhindered, turns: TurnCounter::default(), movers: Vec::new() })
    }

    /// Lets the daemon test itself and arms daemon and gate, before the world's time begins.
    fn arm(&mut self, options: &TrialOptions) -> Result<(), ServiceError> {
        for _ in 0..START_SETS_MAX {
            let drive = &mut self.drive;
            if drive.gate.state() == GateState::Track {
                return Ok(());
            }
            let ready = drive.pipeline.daemon().state() == DaemonState::Ready;
            let waits = drive.gate.armed_epoch().is_none();
            if ready || (waits && drive.pipeline.daemon().state().allows_motion()) {
                drive.arm();
            }
            self.period(options, Velocity::ZERO, false, &mut |_| true)?;
        }
        let reason = format!("the simulated robot could not be armed: {}", self.drive.pipeline.daemon().reason());
        Err(ServiceError::Internal(reason))
    }

    fn step(&mut self, options: &TrialOptions, watch: &mut dyn FnMut(&Moment) -> bool) -> Result<bool, ServiceError> {
        let wanted = self.drive.simulator.wanted_velocity();
        self.period(options, wanted, true, watch)
    }

    /// One ping set, one command, one period of ticks; the world stands still unless it `moves`.
    fn period(
        &mut self,
        options: &TrialOptions,
        wanted: Velocity,
        moves: bool,
        watch: &mut dyn FnMut(&Moment) -> bool,
    ) -> Result<bool, ServiceError> {
        let drive = &mut self.drive;
        let time_s = drive.simulator.time_s();
        drive.hear();
        for loss in options.losses.iter().filter(|loss| time_s >= loss.at_s && loss.sensor_index < SENSORS_MAX) {
            drive.pings.present[loss.sensor_index] = false;
        }
        let outcome = drive.decide(wanted)?;
        let before = (drive.simulator.pose(), drive.simulator.velocity());
        let odometry = drive.simulator.odometry().pose;
        self.movers.clear();
        self.movers.extend(drive.simulator.movers());
        let slip = options.slips.iter().find(|slip| (slip.from_to_s[0]..slip.from_to_s[1]).contains(&time_s));
        drive.simulator.set_grip(slip.map_or([1.0; 2], |slip| slip.grip));
        for _ in 0..drive.ticks() {
            drive.tick(moves);
        }
        if !moves {
            return Ok(true);
        }
        let point = TrackPoint {
            time_s,
            pose: before.0,
            velocity: before.1,
            wanted,
            decided: outcome.velocity,
            layer: if outcome.output.state.allows_motion() { outcome.decision.layer } else { LayerName::Stopped },
            cause: outcome.decision.cause,
            stuck: outcome.decision.stuck,
            state: outcome.output.state,
            gate: drive.gate.state(),
            clearance_m: drive.simulator.clearance_m(),
            mover_clearance_m: drive.simulator.mover_clearance_m(),
        };
        let unhindered = wanted != Velocity::ZERO && !(point.mover_clearance_m < MOVER_NEAR_M);
        self.unhindered.note(time_s, point.pose.position_m(), unhindered);
        self.turns.note(&point);
        self.track.push(point);
        let energyscapes = &self.drive.pipeline.image().energyscapes;
        Ok(watch(&Moment { point: &point, cues: &outcome.cues, energyscapes, odometry, movers: &self.movers }))
    }

    fn finish(self, seed: u64) -> Trial {
        let score = self.drive.simulator.score();
        Trial {
            seed,
            longest_stuck_unhindered_s: self.unhindered.longest_s(),
            turn_changes_per_m: self.turns.changes as f64 / score.path_length_m.max(1e-9),
            score,
            track: self.track,
        }
    }
}

/// Counts changes of the turn's sign while walls or corridors are followed.
#[derive(Default)]
struct TurnCounter {
    last_sign: f64,
    changes: usize,
}

impl TurnCounter {
    fn note(&mut self, point: &TrackPoint) {
        let follows = matches!(point.layer, LayerName::FlowFollowing | LayerName::CorridorFollowing);
        let turn_rad_s = point.decided.angular_rad_s;
        if !follows {
            self.last_sign = 0.0;
        } else if turn_rad_s.abs() > TURN_MIN_RAD_S {
            self.changes += usize::from(turn_rad_s.signum() == -self.last_sign);
            self.last_sign = turn_rad_s.signum();
        }
    }
}
