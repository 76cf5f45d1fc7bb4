//! `noctule process`: recordings to energyscapes in NumPy files (specification, section 11).
//!
//! Several recordings at a time, several imagers at each, one thread an imager: all cores are at work whether there are many
//! recordings or one, and the bytes are the same however many there are. Memory does not grow with a recording's length. A
//! bad input gets its error and the others go on. What was finished before is passed over.

mod export;
mod finished;
mod inputs;
mod job;
mod team;

pub use inputs::Shard;

use super::args::ProcessArguments;
use super::output::{make_folder, progress};
use super::series::cores;
use super::{Failure, exit};
use crate::config::Config;
use crate::imaging::backend::{BackendError, BackendKind};
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::io::recording_file::{RecordingError, RecordingFile, is_mcap};
use crate::parameter::did_you_mean;
use crate::service::wiring;
use crate::signal::{MaskTable, SENSORS_MAX};
use finished::Fingerprint;
use indicatif::ProgressBar;
use inputs::Target;
use job::Job;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Once, PoisonError};

/// Offline nobody waits for a ping: a software adapter may take its time, and only a hang is given up.
const OFFLINE: ImagerOptions = ImagerOptions { threads: Some(1), gpu_deadline_ms: 10_000 };
/// Imagers on one GPU: while one waits for it, the other reads and writes.
const GPU_IMAGERS: usize = 2;

/// What all recordings have in common.
pub struct Batch<'a> {
    config: &'a Config,
    arguments: &'a ProcessArguments,
    sensor_index: usize,
    chosen: Chosen,
    imagers_per_recording: usize,
    bar: ProgressBar,
    announced: Once,
}

/// The backend that all imagers take, chosen once.
pub enum Chosen {
    /// The CPU, and why.
    Cpu {
        /// The reason as the meta data gives it.
        reason: String,
    },
    /// A GPU, found again in the same way.
    Gpu {
        /// What was asked for.
        prefer: Prefer,
    },
}

/// A recording that is to be imaged, as it is now.
type Waiting = (Target, Fingerprint);

/// Runs the command.
///
/// # Errors
/// Exit 65 when any input is bad (after all were tried), 69 without the GPU asked for, 73, 74, 77, 78.
pub fn process(arguments: &ProcessArguments) -> Result<(), Failure> {
    // The first run among the inputs speaks for all: they are imaged with one configuration.
    let first = arguments.inputs.iter().find(|path| is_mcap(path)).or(arguments.inputs.first());
    let config = super::record::config_of_recording(first.map_or(Path::new(""), PathBuf::as_path), &arguments.choice)?;
    let sensor_index = find_sensor(&config, arguments.sensor.as_deref())?;
    let targets = inputs::targets(arguments)?;
    make_folder(&arguments.out)?;
    let (waiting, mut failures) = unfinished(&config, sensor_index, arguments, targets)?;
    if !waiting.is_empty() {
        failures.extend(image(&config, sensor_index, arguments, waiting)?);
    }
    // All have been told; the exit code is that of the first in the order of the names.
    failures.sort_by(|(a, _), (b, _)| a.folder.cmp(&b.folder));
    match failures.first() {
        Some((_, code)) => Err(Failure::new(*code, "")),
        None => Ok(()),
    }
}

/// The index of the sensor of that name; the first without one.
///
/// # Errors
/// Exit 2 naming the sensors there are.
pub fn find_sensor(config: &Config, name: Option<&str>) -> Result<usize, Failure> {
    let Some(name) = name else { return Ok(0) };
    let names: Vec<&str> = config.sensor.iter().map(|sensor| sensor.name.as_str()).collect();
    names.iter().position(|found| *found == name).ok_or_else(|| {
        let near = did_you_mean(name, names.iter().copied());
        Failure::new(exit::USAGE, format!("--sensor: found {name}, allowed: {}{near}", names.join(", ")))
    })
}

fn prefer(config: &Config, arguments: &ProcessArguments) -> Prefer {
    arguments.backend.map_or(config.imaging.backend, Into::into)
}

/// Says what is passed over, and gives the rest: what is to be imaged, and what is not even there.
fn unfinished(
    config: &Config,
    sensor_index: usize,
    arguments: &ProcessArguments,
    targets: Vec<Target>,
) -> Result<(Vec<Waiting>, Vec<(Target, u8)>), Failure> {
    let backend = format!("{:?}", prefer(config, arguments));
    let settings = finished::settings(config, sensor_index, &backend, (arguments.png, arguments.format))
        .map_err(|error| Failure::new(exit::CONFIG, error))?;
    let (count, mut waiting, mut failures) = (targets.len(), Vec::new(), Vec::new());
    for target in targets {
        match Fingerprint::of(&target.input, &settings) {
            Ok(fingerprint) if !arguments.force && fingerprint.is_finished_in(&target.folder) => {
                log::info!("{}: finished before, skipped (--force does it again)", target.input.display());
            }
            Ok(fingerprint) => waiting.push((target, fingerprint)),
            Err(error) => {
                let failure = data_failure(&RecordingError::Io { path: target.input.clone(), error });
                eprintln!("noctule: {}", failure.message);
                failures.push((target, failure.code));
            }
        }
    }
    let skipped = count - waiting.len() - failures.len();
    if skipped > 0 || arguments.shard.is_some() {
        log::info!("{count} recordings: {skipped} finished before, {} to do", waiting.len());
    }
    Ok((waiting, failures))
}

/// Chooses the backend for good: looking for a GPU takes longer than imaging a short recording.
fn choose(config: &Config, sensor_index: usize, prefer: Prefer) -> Result<Chosen, Failure> {
    if prefer == Prefer::Cpu {
        return Ok(Chosen::Cpu { reason: "the configuration asks for the CPU".to_owned() });
    }
    let refuse = |error| Failure::new(exit::CONFIG, error);
    let recording = config.recording().map_err(refuse)?;
    let setup = wiring::sensing_of_one(config, sensor_index, &recording).map_err(refuse)?;
    let imager = Imager::open(setup.plan, Arc::new(MaskTable::default()), prefer, OFFLINE)
        .map_err(|error| backend_failure(&error))?;
    Ok(match imager.kind() {
        BackendKind::Cpu => Chosen::Cpu { reason: imager.report().reason.clone() },
        BackendKind::Gpu => Chosen::Gpu { prefer },
    })
}

/// Images all that waits; gives the failures, which have been told.
fn image(
    config: &Config,
    sensor_index: usize,
    arguments: &ProcessArguments,
    waiting: Vec<Waiting>,
) -> Result<Vec<(Target, u8)>, Failure> {
    let chosen = choose(config, sensor_index, prefer(config, arguments))?;
    let jobs = arguments.jobs.map_or_else(cores, |jobs| jobs as usize);
    let imagers = if matches!(chosen, Chosen::Gpu { .. }) { jobs.min(GPU_IMAGERS) } else { jobs };
    let at_once = imagers.min(waiting.len());
    let hints = wiring::file_hints(config);
    // A header is all that is read here; what cannot be opened is told when its turn comes.
    let pings = |input| {
        RecordingFile::open_sensor(input, hints, sensor_index)
            .map_or(0, |recording| recording.shape().ping_count as u64)
    };
    let bar = progress(0, "imaging");
    if !bar.is_hidden() {
        bar.set_length(waiting.iter().map(|(target, _)| pings(&target.input)).sum());
    }
    let imagers_per_recording = imagers / at_once;
    let batch = Batch { config, arguments, sensor_index, chosen, imagers_per_recording, bar, announced: Once::new() };
    let (next, failures) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(|| {
                let mut crew = None;
                while let Some((target, fingerprint)) = waiting.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if let Err(failure) = (Job { batch: &batch, target, fingerprint }).run(&mut crew) {
                        batch.bar.suspend(|| eprintln!("noctule: {}", failure.message));
                        let mut failures = failures.lock().unwrap_or_else(PoisonError::into_inner);
                        failures.push((target.clone(), failure.code));
                    }
                }
            });
        }
    });
    batch.bar.finish_and_clear();
    Ok(failures.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// The failure for a recording that cannot be used.
pub fn data_failure(error: &RecordingError) -> Failure {
    let code = match error {
        RecordingError::Io { error, .. } if error.kind() == std::io::ErrorKind::PermissionDenied => exit::PERMISSION,
        RecordingError::Io { error, .. } if error.kind() != std::io::ErrorKind::NotFound => exit::IO,
        _ => exit::DATA,
    };
    Failure::new(code, error)
}

/// The failure for a backend that cannot be opened or used.
pub fn backend_failure(error: &BackendError) -> Failure {
    let code = match error {
        BackendError::PingShape { .. } => exit::DATA,
        BackendError::Unavailable(_) | BackendError::Lost(_) | BackendError::Timeout { .. } => exit::UNAVAILABLE,
        BackendError::Invalid(_) | BackendError::Cpu(_) => exit::INTERNAL,
    };
    Failure::new(code, error)
}

const _: () = assert!(SENSORS_MAX == 3, "the flags of a single-sensor ping set are written out in the team");
