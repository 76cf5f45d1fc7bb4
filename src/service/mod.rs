//! The daemon: a configuration and a source in; commands, energyscapes, cues and health out.
//!
//! Three threads that the robot depends on, and one that it does not. The *acquiring* thread asks the source for ping sets and hands them on, newest first
//! ([`acquisition`], [`handoff`]). The *deciding* thread images, decides and publishes ([`decision`], around
//! [`pipeline`]). The *watching* thread is the caller's: it has the last word to the robot, and ends the process when one of the
//! others dies or hangs, since a daemon with a thread missing must not go on ([`watching`]). The *detecting* thread reads the
//! published images like any other reader ([`detecting`]).
//!
//! The same pipeline is driven in simulation, faster than real time: one robot in [`trial`], many in [`proving`], and
//! sensor layouts are ranked by that in [`sweep`]. Corridors are driven by a detector alone in [`corridor`].

pub mod acquisition;
pub mod corridor;
mod crew;
pub mod decision;
mod detecting;
mod detections;
mod drive;
pub mod emission_trials;
pub mod handoff;
pub mod health;
pub mod image_quality;
pub mod latency;
pub mod motion_trials;
pub mod pipeline;
pub mod plots;
pub mod proving;
pub mod regions;
pub mod replay;
pub mod ring_scenes;
pub mod scanning;
pub mod soak;
pub mod space_trials;
pub mod supervisor;
pub mod sweep;
pub mod tape;
pub mod trial;
pub mod watching;
pub mod wiring;

use crate::config::Config;
use crate::control::default_regions;
use crate::flow::MaskSet;
use crate::imaging::backend::BackendError;
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::io::record::{RecordError, RecordOptions, RecordState, Recorder, Recording};
use crate::io::recording_file::is_mcap;
use crate::io::source::live::LiveSource;
use crate::io::source::recorded::RecordedSource;
use crate::io::source::replay::ReplaySource;
use crate::io::source::simulator::SimulatorSource;
use crate::io::source::{Source, SourceError};
use crate::io::wire::message::EnergyscapeHeader;
use crate::io::wire::telemetry::CueThresholds;
use crate::io::{DaemonTopics, Ipc, IpcError, LiveTopics};
use crate::life::Stop;
use crate::parameter::ParameterError;
use crate::signal::PingSet;
use crate::sim::{RobotParams, SimError, SimParams, Simulator, Turns, World};
use crate::time::{Clock, Stamp, SystemClock};
use acquisition::Delivered;
use decision::DecisionLoop;
use detecting::Detecting;
use health::Reporter;
use pipeline::Pipeline;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tape::Tape;
use wiring::SensingSetup;

/// Longest wait for the end of a recording after a planned end, and after a signal: then the process is to be gone within a second.
const FINISH_LIMIT: Duration = Duration::from_secs(10);
const SIGNAL_FINISH_LIMIT: Duration = Duration::from_millis(400);

/// Where ping sets come from.
#[derive(Debug, Clone)]
pub enum SourceChoice {
    /// The simulated robot in a world, with the seed of its noise and start; `endless` begins the waypoints again.
    Simulator {
        /// The world.
        world: Box<World>,
        /// Seed.
        seed: u64,
        /// Whether the waypoints begin again after the last.
        endless: bool,
    },
    /// Recordings, one a sensor.
    Replay(Vec<PathBuf>),
    /// Drivers on the raw topics.
    Live,
}

/// Why the daemon could not start or had to end.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The configuration asks for what cannot be.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The simulated robot cannot be put into its world.
    #[error(transparent)]
    Simulator(#[from] SimError),
    /// No backend.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// No shared memory.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// The source cannot start or go on.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A recording cannot be made or read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The IPC root was removed or replaced under the running daemon.
    #[error("the IPC root {0} was taken away: the robot was stopped")]
    RootLost(String),
    /// The state machine ended the process.
    #[error("the daemon could not go on: {reason}")]
    Gave {
        /// Exit code.
        code: u8,
        /// Why.
        reason: String,
    },
    /// A thread could not be started or died.
    #[error("internal error: {0}")]
    Internal(String),
}

/// Runs the daemon until `stop` is asked, the source ends, or `limit` has passed since the first ping set.
///
/// # Errors
/// [`ServiceError`]. Before it returns for any reason but a dead thread, zero was published.
pub fn run(
    config: &Config,
    source: &SourceChoice,
    prefer: Prefer,
    limit: Option<Duration>,
    stop: &Stop,
) -> Result<(), ServiceError> {
    run_recorded(config, source, prefer, limit, stop, None)
}

/// As [`run`], recorded if `record` says how. A disk that cannot be written is told in log and health; the robot is driven all the
/// same.
///
/// # Errors
/// As [`run`].
pub fn run_recorded(
    config: &Config,
    source: &SourceChoice,
    prefer: Prefer,
    limit: Option<Duration>,
    stop: &Stop,
    record: Option<&RecordOptions>,
) -> Result<(), ServiceError> {
    let setup = wiring::sensing(config)?;
    let masks = wiring::masks(config, &setup)?;
    setup.hidden.iter().for_each(|what| log::info!("hidden: {what}"));
    setup.warnings.iter().for_each(|what| log::warn!("{what}"));
    log::info!("{}", stopping_line(config));
    let options = ImagerOptions { threads: None, gpu_deadline_ms: config.safety.gpu_deadline().as_millis() as u64 };
    let imager = Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), prefer, options)?;
    imager.announce();
    // Opening a driver may take seconds, during which a signal may end the process as it stands. Shared memory is put in order.
    stop.hold();
    let ipc = Ipc::open(&config.ipc)?;
    let choice = source;
    let open = |setup: &SensingSetup| open_source(config, setup, choice, &ipc);
    // Before the working threads, whose priority it must not have.
    let recording = record.map(|options| start_recording(options, config, &setup));
    drive_recorded(config, Parts { setup, masks, imager }, &ipc, open, limit, stop, recording)
}

/// A recording, or the state that it could not get out of.
fn start_recording(options: &RecordOptions, config: &Config, setup: &SensingSetup) -> Result<Recording, RecordState> {
    Recording::start(options, tape::subject(config, setup)).map_err(|error| {
        log::error!("nothing is recorded, the robot goes on: {error}");
        error.state()
    })
}

/// What the daemon works with, made elsewhere.
pub struct Parts {
    /// The sensors.
    pub setup: SensingSetup,
    /// The regions.
    pub masks: MaskSet,
    /// The backends.
    pub imager: Imager,
}

/// As [`run`], with the parts and the source given: whoever brings a source of his own, a test for one, begins here.
///
/// # Errors
/// As [`run`].
pub fn drive(
    config: &Config,
    parts: Parts,
    ipc: &Ipc,
    open_source: impl FnOnce(&SensingSetup) -> Result<Box<dyn Source + Send>, ServiceError>,
    limit: Option<Duration>,
    stop: &Stop,
) -> Result<(), ServiceError> {
    drive_recorded(config, parts, ipc, open_source, limit, stop, None)
}

fn drive_recorded(
    config: &Config,
    parts: Parts,
    ipc: &Ipc,
    open_source: impl FnOnce(&SensingSetup) -> Result<Box<dyn Source + Send>, ServiceError>,
    limit: Option<Duration>,
    stop: &Stop,
    recording: Option<Result<Recording, RecordState>>,
) -> Result<(), ServiceError> {
    let Parts { setup, masks, imager } = parts;
    let topics = DaemonTopics::open(ipc, &setup.sensor_names(), &setup.cell_counts())?;
    let source = open_source(&setup)?;
    log::info!("source: {}", source.describe());
    let empty = Delivered { pings: empty_ping_set(&setup), wanted: None, moment: None };
    let epoch = topics.epoch();
    let begun = SystemClock.now();
    let notes = recording.as_ref().and_then(|recording| recording.as_ref().ok()).map(|recording| recording.tap.notes());
    let detecting = Detecting::start(config, &setup, ipc, notes)?;
    let pipeline = Pipeline::new(config, setup, masks, imager, epoch, begun);
    let (tape, recorder) = match recording {
        None => (Tape::default(), None),
        Some(Err(state)) => (Tape::broken(state), None),
        Some(Ok(Recording { tap, recorder })) => (Tape::new(tap, epoch, begun), Some(recorder)),
    };
    let decision = decision_loop(config, pipeline, topics, ipc, tape);
    let ended = watching::supervise(decision, source, empty, limit, stop);
    if let Some(detecting) = detecting {
        detecting.end();
    }
    if let Some(recorder) = recorder {
        let planned = limit.is_some_and(|limit| SystemClock.now().since_ns(begun) >= limit.as_nanos() as i64);
        finish_recording(recorder, if planned { FINISH_LIMIT } else { SIGNAL_FINISH_LIMIT });
    }
    ended
}

/// The robot stands and knows it; now the file may be finished.
fn finish_recording(recorder: Recorder, limit: Duration) {
    match recorder.finish(limit) {
        Ok(tally) => log::info!(
            "recorded {} messages, {} MiB; {} ping sets and {} notes lost",
            tally.messages,
            tally.bytes >> 20,
            tally.dropped_sets,
            tally.dropped_notes
        ),
        Err(error) => log::error!("the recording ended early: {error}"),
    }
}

fn stopping_line(config: &Config) -> String {
    let platform = &config.platform;
    let (unseen_m, braking_m) = (default_regions::unseen_way_m(platform), default_regions::braking_way_m(platform));
    format!(
        "worst stop at {} m/s: {unseen_m:.3} m unseen + {braking_m:.3} m braking, radius {} m",
        platform.max_linear_m_s, platform.radius_m
    )
}

fn empty_ping_set(setup: &SensingSetup) -> PingSet {
    let lens: Vec<usize> = (0..setup.sensors.len()).map(|index| setup.plan.raw_len(index)).collect();
    PingSet::empty(lens.len(), setup.plan.format, &lens)
}

fn open_source(
    config: &Config,
    setup: &SensingSetup,
    choice: &SourceChoice,
    ipc: &Ipc,
) -> Result<Box<dyn Source + Send>, ServiceError> {
    let rate_hz = config.control.rate_hz;
    match choice {
        SourceChoice::Simulator { world, seed, endless } => {
            let params = SimParams { repeat_waypoints: *endless, ..SimParams::default() };
            let simulator = simulator(config, setup, (**world).clone(), params, *seed)?;
            Ok(Box::new(SimulatorSource::open(simulator, ipc, rate_hz, config.set_duration_s(&setup.recording))?))
        }
        SourceChoice::Replay(paths) if paths.iter().any(|path| is_mcap(path)) => {
            let [path] = paths.as_slice() else {
                let found =
                    format!("found {} files, allowed: one MCAP recording, which holds all sensors", paths.len());
                return Err(SourceError::Other(found).into());
            };
            Ok(Box::new(RecordedSource::open(path, config.slot_ns())?))
        }
        SourceChoice::Replay(paths) => {
            let words = wiring::file_hints(config);
            Ok(Box::new(ReplaySource::open(paths, words, &empty_ping_set(setup), rate_hz, config.slot_ns())?))
        }
        SourceChoice::Live => {
            let sensors = setup.raw_shapes();
            let topics = LiveTopics::open(ipc, &sensors)?;
            Ok(Box::new(LiveSource::new(topics, sensors.len(), config.safety.group_deadline(), config.slot_ns())))
        }
    }
}

/// A simulator of the configured robot.
///
/// # Errors
/// [`SimError`].
pub fn simulator(
    config: &Config,
    setup: &SensingSetup,
    world: World,
    params: SimParams,
    seed: u64,
) -> Result<Simulator, SimError> {
    let platform = &config.platform;
    let robot = RobotParams {
        radius_m: platform.radius_m,
        z_m: platform.z_m,
        limits: crate::sim::MotionLimits {
            max_linear_m_s: platform.max_linear_m_s,
            max_angular_rad_s: platform.max_angular_rad_s,
            max_linear_accel_m_s2: platform.max_linear_accel_m_s2,
            max_angular_accel_rad_s2: platform.max_angular_accel_rad_s2,
        },
    };
    let speed_of_sound_m_s = setup.speed_of_sound_m_s;
    let turns = Turns { slot_s: config.slot_s(), period_s: 1.0 / config.control.rate_hz };
    let params = SimParams { turns: (turns.slot_s > 0.0).then_some(turns), ..params };
    let mut simulator =
        Simulator::new(world, &setup.sensors, &setup.recording, robot, speed_of_sound_m_s, params, seed)?;
    simulator.set_obstructions(&config.obstruction);
    Ok(simulator)
}

fn decision_loop(config: &Config, pipeline: Pipeline, topics: DaemonTopics, ipc: &Ipc, tape: Tape) -> DecisionLoop {
    let setup = pipeline.setup();
    let grid = &setup.plan.grid;
    let header = |index| EnergyscapeHeader::for_grid(grid, index, setup.speed_of_sound_m_s);
    let control = &config.control;
    let period_ns = (1e9 / control.rate_hz) as u64;
    DecisionLoop {
        root: ipc.root().display().to_string(),
        headers: (0..setup.sensors.len()).map(header).collect(),
        thresholds: CueThresholds {
            collision: control.collision_avoidance.threshold,
            obstacle: control.obstacle_avoidance.threshold,
            corridor: control.corridor_following.threshold,
            wall_single: control.flow_following.threshold_single,
            wall_corridor: control.flow_following.threshold_corridor,
        },
        input_max_age_ns: config.safety.input_max_age_ns(),
        recording_ns: (config.set_duration_s(&setup.recording) * 1e9) as u64,
        period_ns,
        reporter: Reporter::new(period_ns as f64 * 1e-6),
        input: None,
        pose: None,
        dropped_count: 0,
        last_set_at: None,
        last_emitted_at: Stamp::default(),
        tape,
        pipeline,
        topics,
    }
}
