//! `noctule run`, `controller`, `arm`, `stop`, `reset`: the processes of the running robot.

use super::args::{ControllerArguments, OperatorArguments, RunArguments};
use super::output::print_line;
use super::process::backend_failure;
use super::{Failure, exit};
use crate::config::Config;
use crate::controller_process;
use crate::io::recording_file::is_mcap;
use crate::io::source::SourceError;
pub use crate::io::wire::message::Request;
use crate::io::{Ipc, IpcError, OperatorClient};
use crate::life::panic::end_on_panic;
use crate::life::{self, Stop};
use crate::sensor::RecordingParams;
use crate::service::replay::recorded_config;
use crate::service::{self, ServiceError, SourceChoice};
use crate::signal::SampleFormat;
use crate::sim::World;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Longest wait for the effect of an operator's request.
const REQUEST_LIMIT: Duration = Duration::from_secs(3);

/// Runs the daemon.
///
/// # Errors
/// The codes of the specification, section 11.
pub fn run(arguments: &RunArguments) -> Result<(), Failure> {
    let stop = Stop::on_signals().map_err(no_signals)?;
    end_on_panic(stop.flag());
    let mut config = super::config::load(&arguments.choice)?;
    let source = source_choice(&arguments.source, arguments.seed, &mut config)?;
    if let (SourceChoice::Replay(paths), None) = (&source, &arguments.choice.config)
        && let Some(run) = paths.first().filter(|path| is_mcap(path))
    {
        // A recorded run carries its configuration; where the topics are is this machine's matter.
        config = Config { ipc: config.ipc, ..recorded_config(run).map_err(|error| service_failure(&error))? };
    }
    let prefer = arguments.backend.map_or(config.imaging.backend, Into::into);
    let limit = arguments.duration.map(Duration::from_secs_f64);
    let record = arguments.record.options();
    service::run_recorded(&config, &source, prefer, limit, &stop, record.as_ref())
        .map_err(|error| service_failure(&error))
}

/// A flag that SIGTERM and SIGINT set; a second signal ends the process at once.
///
/// # Errors
/// Exit 70 when signals cannot be watched.
pub fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    life::stop_flag().map_err(no_signals)
}

fn no_signals(error: std::io::Error) -> Failure {
    Failure::new(exit::INTERNAL, format!("cannot watch for signals: {error}"))
}

/// The default recording is that of PDM hardware. Where the configuration says nothing of it, the simulator delivers
/// PCM, which costs less and images the same.
pub fn prefer_pcm(config: &mut Config) {
    if config.recording == RecordingParams::default() {
        config.recording.format = SampleFormat::PcmF32;
    }
}

/// Reads `sim`, `sim:WORLD`, `replay:FILE[,FILE...]` or `live`.
fn source_choice(text: &str, seed: u64, config: &mut Config) -> Result<SourceChoice, Failure> {
    let (kind, rest) = text.split_once(':').map_or((text, None), |(kind, rest)| (kind, Some(rest)));
    match (kind, rest) {
        ("sim", world) => {
            prefer_pcm(config);
            let world = Box::new(load_world(world.map(Path::new))?);
            let endless = rest.is_none();
            Ok(SourceChoice::Simulator { world, seed, endless })
        }
        ("replay", Some(files)) if !files.is_empty() => {
            Ok(SourceChoice::Replay(files.split(',').map(PathBuf::from).collect()))
        }
        ("live", None) => Ok(SourceChoice::Live),
        _ => Err(Failure::new(
            exit::USAGE,
            format!("--source: found {text}, allowed: sim, sim:WORLD, replay:FILE[,FILE...] or live"),
        )),
    }
}

/// Loads a world, or the built-in one.
///
/// # Errors
/// Exit 65.
pub fn load_world(path: Option<&Path>) -> Result<World, Failure> {
    let world = path.map_or_else(World::default_world, World::load);
    world.map_err(|error| {
        let of_configurations =
            ["config_version", "sensor", "control", "imaging", "recording", "platform", "ipc", "safety"];
        let top = error.key.as_deref().map(|key| key.split(['.', '[']).next().unwrap_or(key));
        let hint = match top {
            Some(key) if of_configurations.contains(&key) => {
                "\nthis is a configuration, not a world: give it with --config"
            }
            _ => "",
        };
        Failure::new(exit::DATA, format!("{error}{hint}"))
    })
}

/// The failure for a daemon that ended.
pub fn service_failure(error: &ServiceError) -> Failure {
    match error {
        ServiceError::Parameter(_) => Failure::new(exit::CONFIG, error),
        ServiceError::Simulator(_) => Failure::new(exit::DATA, error),
        ServiceError::Backend(error) => backend_failure(error),
        ServiceError::Ipc(error) | ServiceError::Source(SourceError::Ipc(error)) => ipc_failure(error),
        ServiceError::Source(SourceError::Recording(error)) => super::process::data_failure(error),
        ServiceError::Source(SourceError::Other(_)) => Failure::new(exit::DATA, error),
        ServiceError::Record(error) | ServiceError::Source(SourceError::Record(error)) => {
            Failure::new(error.exit_code(), error)
        }
        ServiceError::RootLost(_) => Failure::new(exit::IPC_STUCK, error),
        ServiceError::Gave { code, .. } => Failure::new(*code, error),
        ServiceError::Internal(_) => Failure::new(exit::INTERNAL, error),
    }
}

/// The failure for inter-process communication that cannot begin or go on.
pub fn ipc_failure(error: &IpcError) -> Failure {
    Failure::new(error.exit_code(), error)
}

/// Runs the controller process.
///
/// # Errors
/// The codes of the specification; what went wrong was logged.
pub fn controller(arguments: &ControllerArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    match controller_process::serve(&config, arguments.arm) {
        0 => Ok(()),
        code => Err(Failure::new(code, "")),
    }
}

/// Sends an operator's request and waits for its effect.
///
/// # Errors
/// Exit 69 when nobody answers or nothing changes, and the codes of the transport.
pub fn operator(arguments: &OperatorArguments, request: Request) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let client = OperatorClient::open(&ipc).map_err(|error| ipc_failure(&error))?;
    let states = client.request(request, REQUEST_LIMIT).map_err(|error| ipc_failure(&error))?;
    print_line(&states)
}

/// Removes everything that stopped processes have under the configured root and prefix.
///
/// # Errors
/// 69 where a daemon runs, and the codes of the transport.
pub fn wipe(arguments: &OperatorArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let count = crate::io::wipe(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let root = config.ipc.root_path();
    print_line(&format!("{count} files removed under {} and of prefix {}", root.display(), config.ipc.prefix))
}
