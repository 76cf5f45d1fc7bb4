//! The way into shared memory: an explicit configuration, a set-up that ends in three seconds whatever it meets, a
//! check that shared memory suffices. The ports themselves are opened by [`super::session`].
//!
//! In: [`IpcParams`]. Out: an [`Ipc`], or an [`IpcError`]. The transport's own search for configuration files is never
//! used, and its default of waiting for slow receivers neither.

use super::error::IpcError;
use super::params::IpcParams;
use super::root::{DaemonLock, SetupLock, prepare};
use super::session::Session;
use iceoryx2::node::NodeCreationFailure;
use iceoryx2::prelude::{
    BackpressureStrategy, Config, LogLevel, Node, NodeBuilder, NodeName, SemanticString, SignalHandlingMode,
    ipc_threadsafe, set_log_level,
};
use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

/// The transport with ports that may change threads; the same bytes as every other of its variants.
pub(super) type Transport = ipc_threadsafe::Service;

/// Longest set-up.
const SETUP_LIMIT: Duration = Duration::from_secs(3);
/// Longest wait for another process's set-up.
const LOCK_LIMIT: Duration = Duration::from_millis(1_500);
/// Where the transport's payloads lie.
const SHARED_MEMORY: &str = "/dev/shm";

/// Root, prefix and configuration of the transport, checked. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Ipc {
    root: PathBuf,
    prefix: String,
    config: Config,
}

/// Keeps the transport's registration of this process; dropped last.
pub(super) type Registration = Node<Transport>;

impl Ipc {
    /// Makes or checks the root directory and fixes the transport's configuration.
    ///
    /// # Errors
    /// [`IpcError::Permission`] (77) for a root that is not ours alone, [`IpcError::CannotCreate`] (73).
    pub fn open(params: &IpcParams) -> Result<Self, IpcError> {
        set_log_level(match log::max_level() {
            log::LevelFilter::Trace => LogLevel::Trace,
            log::LevelFilter::Debug => LogLevel::Warn,
            _ => LogLevel::Fatal,
        });
        let root = params.root_path();
        prepare(&root)?;
        let invalid = |what: &str| IpcError::Internal(format!("{what} is not taken by the transport"));
        let text = root.to_str().ok_or_else(|| invalid("a root that is not UTF-8"))?;
        let mut config = Config::default();
        let path = iceoryx2::prelude::Path::new(text.as_bytes()).map_err(|_| invalid(text))?;
        config.global.set_root_path(&path);
        config.global.prefix =
            iceoryx2::prelude::FileName::new(params.prefix.as_bytes()).map_err(|_| invalid(&params.prefix))?;
        config.global.creation_timeout = Duration::from_secs(1);
        config.defaults.publish_subscribe.backpressure_strategy = BackpressureStrategy::DiscardData;
        Ok(Self { root, prefix: params.prefix.clone(), config })
    }

    /// The root directory.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// What every name of ours begins with.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Takes the lock that only one daemon can have.
    pub(super) fn lock_daemon(&self) -> Result<DaemonLock, IpcError> {
        DaemonLock::acquire(&self.root, &self.prefix)
    }

    /// Refuses to begin where shared memory cannot hold `needed` bytes: later that would be a bus error.
    pub(super) fn check_space(&self, needed: u64) -> Result<(), IpcError> {
        let Ok(space) = rustix::fs::statvfs(SHARED_MEMORY) else { return Ok(()) };
        let free = space.f_bavail.saturating_mul(space.f_frsize);
        if needed <= free { Ok(()) } else { Err(IpcError::NoSpace { place: SHARED_MEMORY, needed, free }) }
    }

    /// Reserves every page of the payload memory made under our prefix, so that no later write can fail.
    pub(super) fn reserve_memory(&self) -> Result<(), IpcError> {
        let Ok(entries) = std::fs::read_dir(SHARED_MEMORY) else { return Ok(()) };
        for entry in entries.flatten() {
            let name = entry.file_name();
            let Some(name) = name.to_str() else { continue };
            if !name.starts_with(&self.prefix) || !name.ends_with(".data") {
                continue;
            }
            let Ok(file) = File::options().read(true).write(true).open(entry.path()) else { continue };
            let Ok(metadata) = file.metadata() else { continue };
            if metadata.len() == 0 || metadata.blocks() * 512 >= metadata.len() {
                continue;
            }
            #[cfg(any(target_os = "linux", target_os = "android"))]
            if rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, metadata.len()).is_err() {
                let free = rustix::fs::statvfs(SHARED_MEMORY).map_or(0, |space| space.f_bavail * space.f_frsize);
                return Err(IpcError::NoSpace { place: SHARED_MEMORY, needed: metadata.len(), free });
            }
        }
        Ok(())
    }

    pub(super) fn stuck(&self, what: String) -> IpcError {
        IpcError::Stuck { what, root: self.root.clone(), prefix: self.prefix.clone() }
    }

    /// Registers this process as `node_name` and runs `make`, in a thread of its own that is given up after three
    /// seconds: the transport can wait for ever for a file that a dead process left half made.
    pub(super) fn set_up<T: Send + 'static>(
        &self,
        node_name: &'static str,
        make: impl FnOnce(&Session) -> Result<T, IpcError> + Send + 'static,
    ) -> Result<(Registration, T), IpcError> {
        let (sender, receiver) = sync_channel(1);
        let ipc = self.clone();
        let worker = std::thread::Builder::new().name(format!("{node_name} set-up"));
        let run = move || {
            // A transport that panics over a spoilt file is a stuck one: whoever waits says so.
            let _ = sender.send(crate::life::panic::contained(|| ipc.set_up_here(node_name, make)));
        };
        worker.spawn(run).map_err(|error| IpcError::Internal(error.to_string()))?;
        match receiver.recv_timeout(SETUP_LIMIT) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout) => {
                Err(self.stuck(format!("set-up did not end within {} s", SETUP_LIMIT.as_secs())))
            }
            Err(RecvTimeoutError::Disconnected) => Err(self.stuck("the transport gave up during set-up".to_owned())),
        }
    }

    fn set_up_here<T>(
        &self,
        node_name: &str,
        make: impl FnOnce(&Session) -> Result<T, IpcError>,
    ) -> Result<(Registration, T), IpcError> {
        let lock = SetupLock::acquire(&self.root, LOCK_LIMIT)
            .map_err(|source| IpcError::CannotCreate { path: self.root.clone(), source })?;
        if lock.is_none() {
            return Err(self.stuck("another process has been setting up for too long".to_owned()));
        }
        let name = NodeName::new(node_name).map_err(|error| IpcError::Internal(format!("{error:?}")))?;
        let node = NodeBuilder::new()
            .name(&name)
            .config(&self.config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Transport>()
            .map_err(|error| match error {
                NodeCreationFailure::InsufficientPermissions => IpcError::Permission {
                    path: self.root.clone(),
                    found: "files that this user may not change".to_owned(),
                    allowed: "files of this user",
                },
                error => self.stuck(format!("this process could not be registered ({error:?})")),
            })?;
        let made = make(&Session::new(self, &self.config, &node))?;
        Ok((node, made))
    }
}
