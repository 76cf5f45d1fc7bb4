//! What ego-motion by echoes is worth: simulated drives, the estimate beside the truth of every ping set.
//!
//! Goes in: worlds, robots, seeds, times in which the wheels slip ([`MotionCase`]). Comes out: for each drive what was heard
//! ([`HeardSet`]), what the estimator makes of it ([`MotionSample`]), and the score ([`score::MotionScore`]). The drives are those of
//! [`super::trial`]; the estimator only listens, unless the robot's configuration has it slow down for movers. Draws nothing, reads no
//! clock.

pub mod score;

pub use super::scanning::estimator;

use super::trial::{Slip, TrialOptions, TrialRig};
use super::{ServiceError, crew, regions};
use crate::detect::EgoMotion;
use crate::detect::ego_motion::velocity_between;
use crate::detect::reflectors::{REFLECTORS_MAX, Reflector, ReflectorFinder};
use crate::geometry::Pose2;
use crate::imaging::params::Prefer;
use crate::signal::{EgoMotionReport, Velocity};
use crate::sim::{MoverTruth, RunScore, SimParams, World};
use crate::time::Stamp;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Relative error of the wheels' diameters.
const ODOMETRY_DRIFT: f64 = 0.005;
/// Simulated clock at the start of a drive.
const START_NS: u64 = 1_000_000_000;
/// What the wheels lose in the three slips of a drive: spin, pull to one side, stand in front of a sill.
const GRIPS: [[f64; 2]; 3] = [[0.4, 0.4], [0.4, 1.0], [0.0, 0.0]];
/// When the first begins, how much later at most, how long each lasts, and from one to the next.
const SLIP_FIRST_S: f64 = 3.0;
const SLIP_SPREAD_S: f64 = 2.0;
const SLIP_LASTS_S: f64 = 1.2;
const SLIP_PERIOD_S: f64 = 5.0;

/// One drive to be made.
#[derive(Debug, Clone)]
pub struct MotionCase {
    /// Name of the world.
    pub world_name: String,
    /// The world, with its time limit.
    pub world: World,
    /// Index of the robot.
    pub robot: usize,
    /// Seed.
    pub seed: u64,
    /// Times in which the wheels slip.
    pub slips: Vec<Slip>,
}

/// Three slips, drawn by `seed`.
#[must_use]
pub fn slips(seed: u64) -> Vec<Slip> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(7);
    let slip = |(index, grip): (usize, &[f64; 2])| {
        let from_s = SLIP_FIRST_S + index as f64 * SLIP_PERIOD_S + SLIP_SPREAD_S * random.random::<f64>();
        Slip { from_to_s: [from_s, from_s + SLIP_LASTS_S], grip: *grip }
    };
    GRIPS.iter().enumerate().map(slip).collect()
}

/// What was heard of a ping set, and the truth of it.
#[derive(Debug, Clone)]
pub struct HeardSet {
    /// Simulated time.
    pub time_s: f64,
    /// Reflectors of each sensor.
    pub reflectors: Vec<Vec<Reflector>>,
    /// By the wheels.
    pub odometry: Pose2,
    /// In truth.
    pub pose: Pose2,
    /// What really moves.
    pub movers: Vec<MoverTruth>,
}

/// A drive.
#[derive(Debug)]
pub struct MotionDrive {
    /// What was heard.
    pub sets: Vec<HeardSet>,
    /// How it went.
    pub score: RunScore,
    /// Smallest gap between footprint and a mover.
    pub mover_clearance_m: f64,
}

/// The estimate of a ping set beside the truth.
#[derive(Debug, Clone)]
pub struct MotionSample {
    /// Simulated time.
    pub time_s: f64,
    /// What the estimator said.
    pub report: EgoMotionReport,
    /// Mean velocity since the ping set before, in truth.
    pub truth: Velocity,
    /// True pose.
    pub pose: Pose2,
    /// What really moves.
    pub movers: Vec<MoverTruth>,
}

/// Makes a drive and keeps what was heard.
///
/// # Errors
/// Those of [`TrialRig::run`].
pub fn drive(rig: &TrialRig, case: &MotionCase) -> Result<MotionDrive, ServiceError> {
    let params = regions::mask_params(&rig.config().control, &rig.config().platform, &rig.config().imaging.directions);
    let hidden = rig.setup().hidden_directions();
    let finder = |hidden: &Vec<bool>| {
        let floor = |range_m| params.noise_floor.at(range_m);
        ReflectorFinder::new(&rig.setup().plan.grid, hidden, floor, params.side_lobe_share)
    };
    let mut finders: Vec<ReflectorFinder> = hidden.iter().map(finder).collect();
    let mut sets = Vec::new();
    let mut mover_clearance_m = f64::INFINITY;
    let acoustics = SimParams { odometry_drift: ODOMETRY_DRIFT, ..SimParams::default() };
    let options = TrialOptions {
        acoustics,
        seed: case.seed,
        prefer: Prefer::Cpu,
        slips: case.slips.clone(),
        ..TrialOptions::default()
    };
    let trial = rig.run(case.world.clone(), &options, &mut |moment| {
        let look = |(finder, image): (&mut ReflectorFinder, &crate::signal::Energyscape)| {
            let mut found = Vec::with_capacity(REFLECTORS_MAX);
            finder.find(&image.values, &mut found);
            found
        };
        mover_clearance_m = mover_clearance_m.min(moment.point.mover_clearance_m);
        sets.push(HeardSet {
            time_s: moment.point.time_s,
            reflectors: finders.iter_mut().zip(moment.energyscapes).map(look).collect(),
            odometry: moment.odometry,
            pose: moment.point.pose,
            movers: moment.movers.to_vec(),
        });
        true
    })?;
    Ok(MotionDrive { sets, score: trial.score, mover_clearance_m })
}

/// What the estimator says of each set of a drive, the first two left out, and how long it took at most is the caller's to measure.
#[must_use]
pub fn estimate(mut estimator: EgoMotion, sets: &[HeardSet]) -> Vec<MotionSample> {
    let mut samples = Vec::with_capacity(sets.len());
    let mut before: Option<&HeardSet> = None;
    for (index, set) in sets.iter().enumerate() {
        for (sensor, reflectors) in set.reflectors.iter().enumerate() {
            estimator.hear_reflectors(sensor, reflectors);
        }
        let boottime_ns = START_NS + (set.time_s * 1e9).round() as u64;
        let emitted_at = Stamp { boottime_ns, wall_ns: boottime_ns };
        let report = *estimator.update(index as u64, emitted_at, Some(set.odometry));
        if let Some(before) = before.filter(|_| report.interval_s > 0.0 && index > 1) {
            let truth = velocity_between(&before.pose, &set.pose, report.interval_s);
            let movers = set.movers.clone();
            samples.push(MotionSample { time_s: set.time_s, report, truth, pose: set.pose, movers });
        }
        before = Some(set);
    }
    samples
}

/// A case with what came of it.
pub type Driven = (usize, Result<(MotionDrive, Vec<MotionSample>), ServiceError>);

/// Makes all drives on a few threads; results in the order of the cases.
///
/// # Errors
/// [`ServiceError::Internal`] when no thread can be started.
pub fn run(
    rigs: &[TrialRig],
    cases: &[MotionCase],
    jobs: usize,
    tell: &mut dyn FnMut(u64),
) -> Result<Vec<Driven>, ServiceError> {
    let work = |(): &mut (), index: usize| {
        let case = &cases[index];
        let rig = &rigs[case.robot];
        let driven = drive(rig, case).map(|driven| {
            let samples = estimate(estimator(rig.config(), rig.setup()), &driven.sets);
            (driven, samples)
        });
        (index, driven)
    };
    let mut count = |done: &[Option<Driven>]| tell(done.iter().flatten().count() as u64);
    crew::work_off(cases.len(), jobs, "noctule-motion", || (), work, &mut count)
}
