//! Scenes that show what the virtual sonar ring is worth: the paper's experiment and random ones (paper 003, section VI).
//!
//! Goes in: scenes ([`Scene`]). Comes out: for each method ([`Method`]) what was found, missed and made up, and whether the
//! covariances told with it are honest ([`Score`]). Simulator, imaging, scan and detector are the daemon's own; what the paper
//! did with three plain sonars is done beside it, on the same scenes. A scene depends on its seed alone, never on the number of
//! threads. Draws nothing, reads no clock.

pub mod scene;
pub mod score;
pub mod single;

pub use scene::Scene;
pub use score::{Score, Told};

use super::scanning::Scanning;
use super::trial::TrialRig;
use super::{ServiceError, crew, simulator};
use crate::config::Config;
use crate::detect::RingDetector;
use crate::detect::ring::RingObject;
use crate::detect::ring_detector::RingReport;
use crate::detect::virtual_ring::{Echoes, OBJECTS_MAX, VirtualRing};
use crate::geometry::Pose2;
use crate::imaging::params::Prefer;
use crate::signal::{RobotScan, Velocity};
use crate::sim::{SimParams, Simulator};
use crate::time::Stamp;
use nalgebra::Vector2;
use score::{score, things};
use single::{Compass, Listening, Singles};
use std::path::Path;

const CONFIG: &str = include_str!("../../fixtures/config/ring.toml");
/// Pings over which the third method fuses, and the time between them.
pub const PINGS: u64 = 10;
const PING_PERIOD_NS: u64 = 100_000_000;
const STEPS_PER_PING: u32 = 5;
/// How the robot drives meanwhile.
const DRIVE: Velocity = Velocity { linear_m_s: 0.15, angular_rad_s: 0.5 };
/// Relative error of its wheels.
const ODOMETRY_DRIFT: f64 = 0.005;
/// A track counts as told from this score on.
const SCORE_MIN: f64 = 0.5;
/// Simulated clock at the first ping.
const START_NS: u64 = 1_000_000_000;

/// A way of finding things.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Three energyscapes at once, one ping; the nearest echo of each virtual sonar.
    Nearest,
    /// The same, with all echoes that the images show.
    All,
    /// The same, fused over a second while driving.
    Fused,
    /// Three plain sonars turned three times, headings by the gyro: the paper.
    Gyro,
    /// The same, headings by the wheels.
    Wheels,
    /// The same, headings by the Kalman filter.
    Filter,
}

impl Method {
    /// All of them, in the order of the scores.
    pub const ALL: [Method; 6] =
        [Method::Nearest, Method::All, Method::Fused, Method::Gyro, Method::Wheels, Method::Filter];

    /// Name in tables and JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Method::Nearest => "energyscapes, nearest echo",
            Method::All => "energyscapes, all echoes",
            Method::Fused => "energyscapes, 1 s driving",
            Method::Gyro => "plain sonars, gyro",
            Method::Wheels => "plain sonars, odometry",
            Method::Filter => "plain sonars, Kalman filter",
        }
    }
}

/// Scores of one scene, in the order of [`Method::ALL`].
pub type Scores = [Score; 6];

/// What is left of a scene: scores, and what the fused method knew at its end.
#[derive(Debug, Clone)]
pub struct SceneRun {
    /// One a method.
    pub scores: Scores,
    /// The detector's last report.
    pub report: RingReport,
    /// Where the robot was then, and where odometry believed it to be.
    pub poses: [Pose2; 2],
}

/// The robots, made once and shared by all scenes.
pub struct RingScenes {
    rig: TrialRig,
    singles: Singles,
}

/// One thread's share of the work.
pub struct RingWorker<'a> {
    scenes: &'a RingScenes,
    scanning: Scanning,
    listening: Listening,
}

/// The built-in robot of these scenes, `fixtures/config/ring.toml`.
///
/// # Errors
/// Never but for a fault in that file.
pub fn config() -> Result<Config, ServiceError> {
    Config::parse(CONFIG, Path::new("ring.toml")).map_err(|error| ServiceError::Internal(error.to_string()))
}

impl RingScenes {
    /// Makes the robots of `config`, which must have three sensors 120 degrees apart for the paper's own way to make sense.
    ///
    /// # Errors
    /// What the configuration asks for and cannot be.
    pub fn new(config: Config) -> Result<Self, ServiceError> {
        let singles = Singles::new(&config)?;
        Ok(Self { rig: TrialRig::new(config)?, singles })
    }

    /// The robot.
    #[must_use]
    pub fn config(&self) -> &Config {
        self.rig.config()
    }

    /// Opens what a thread needs.
    ///
    /// # Errors
    /// When a backend cannot be opened.
    pub fn worker(&self) -> Result<RingWorker<'_>, ServiceError> {
        Ok(RingWorker {
            scenes: self,
            scanning: Scanning::open(&self.rig, Prefer::Cpu)?,
            listening: self.singles.listen()?,
        })
    }

    /// Scores `runs` random scenes from `first_seed` on, on `jobs` threads, in the order of the seeds. `hear` is told, on the
    /// calling thread, how many are done.
    ///
    /// # Errors
    /// The first scene's that could not be done.
    pub fn run(
        &self,
        first_seed: u64,
        runs: u64,
        jobs: usize,
        hear: &mut dyn FnMut(u64),
    ) -> Result<Vec<(u64, Scores)>, ServiceError> {
        let seed = |index: usize| first_seed.wrapping_add(index as u64);
        let work = |worker: &mut Result<RingWorker, ServiceError>, index| match worker {
            Ok(worker) => worker.run(&Scene::random(seed(index))).map(|run| run.scores),
            Err(error) => Err(ServiceError::Internal(error.to_string())),
        };
        let mut tell = |finished: &[Option<_>]| hear(finished.iter().flatten().count() as u64);
        let scored = crew::work_off(runs as usize, jobs, "noctule-ring", || self.worker(), work, &mut tell)?;
        scored.into_iter().enumerate().map(|(index, scores)| Ok((seed(index), scores?))).collect()
    }
}

/// Scores of many scenes as those of one.
#[must_use]
pub fn sum<'a>(scores: impl Iterator<Item = &'a Scores>) -> Scores {
    let mut sums = Scores::default();
    for scene in scores {
        for (sum, score) in sums.iter_mut().zip(scene) {
            sum.add(score);
        }
    }
    sums
}

impl RingWorker<'_> {
    /// Finds the things of a scene in every way.
    ///
    /// # Errors
    /// When the robot does not fit into the scene or a ping set cannot be imaged.
    pub fn run(&mut self, scene: &Scene) -> Result<SceneRun, ServiceError> {
        let (config, setup) = (self.scenes.rig.config(), self.scenes.rig.setup());
        let acoustics = SimParams { odometry_drift: ODOMETRY_DRIFT, ..SimParams::default() };
        let mut simulator = simulator(config, setup, scene.world.clone(), acoustics, scene.seed)?;
        let mut pings = simulator.empty_ping_set();
        let mut detector = RingDetector::new(&config.detect.ring);
        let (mut nearest, mut all) = (Score::default(), Score::default());
        let mut poses = [simulator.pose(), simulator.odometry().pose];
        for ping in 0..PINGS {
            if ping > 0 {
                drive(&mut simulator);
            }
            poses = [simulator.pose(), simulator.odometry().pose];
            let emitted_ns = START_NS + ping * PING_PERIOD_NS;
            simulator.ping_set(Stamp { boottime_ns: emitted_ns, wall_ns: emitted_ns }, &mut pings);
            let scan = self.scanning.look(&pings)?;
            detector.update(scan, &poses[1]);
            if ping == 0 {
                let once = |echoes| at_once(config, scan, echoes, scene, &poses, detector.report());
                (nearest, all) = (once(Echoes::Nearest), once(Echoes::All));
            }
        }
        let report = detector.report().clone();
        let told: Vec<Told> = report
            .objects()
            .iter()
            .filter(|track| track.score >= SCORE_MIN)
            .map(|track| Told { position_m: track.position_m, covariance_m2: track.covariance_m2 })
            .collect();
        let standing = things(&scene.world.pillars, &poses[0], &poses[1]);
        let fused = score(&standing, &told, |place_m| is_occupied(&report, place_m));
        let [gyro, wheels, filter] = self.paper(scene)?;
        Ok(SceneRun { scores: [nearest, all, fused, gyro, wheels, filter], report, poses })
    }

    /// Finds them the paper's way.
    fn paper(&mut self, scene: &Scene) -> Result<[Score; 3], ServiceError> {
        let config = self.scenes.rig.config();
        let params = &config.detect.ring;
        let round = self.scenes.singles.read(&mut self.listening, scene)?;
        let standing = things(&scene.world.pillars, &scene.start, &scene.start);
        Ok([Compass::Gyro, Compass::Wheels, Compass::Filter].map(|compass| {
            let found = single::objects(params, &round, &scene.start, compass);
            let scan = single::as_scan(params, &round, &scene.start, compass, config.imaging.range_min_m);
            let mut detector = RingDetector::new(params);
            detector.fuse(&scan, &scene.start, &found);
            score(&standing, &single::as_told(&found), |place_m| is_occupied(detector.report(), place_m))
        }))
    }
}

/// Scores one ping alone.
fn at_once(
    config: &Config,
    scan: &RobotScan,
    echoes: Echoes,
    scene: &Scene,
    poses: &[Pose2; 2],
    report: &RingReport,
) -> Score {
    let mut ring = VirtualRing::new(&config.detect.ring, echoes);
    let readings = ring.read(scan);
    let mut objects: Vec<RingObject> = Vec::with_capacity(OBJECTS_MAX);
    ring.objects(scan, &readings, &poses[1], &mut objects);
    let standing = things(&scene.world.pillars, &poses[0], &poses[1]);
    score(&standing, &single::as_told(&objects), |place_m| is_occupied(report, place_m))
}

fn drive(simulator: &mut Simulator) {
    let step_s = PING_PERIOD_NS as f64 * 1e-9 / f64::from(STEPS_PER_PING);
    for _ in 0..STEPS_PER_PING {
        simulator.step(DRIVE, step_s);
    }
}

fn is_occupied(report: &RingReport, place_m: Vector2<f64>) -> bool {
    let percent = report.grid.map().percent_at(place_m);
    percent.is_some_and(|percent| (crate::detect::occupancy::OCCUPIED_PERCENT..=100).contains(&percent))
}
