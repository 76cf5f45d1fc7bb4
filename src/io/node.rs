//! The way into shared memory: an explicit configuration, a set-up that ends in three seconds whatever it meets, a
//! check that shared memory suffices. The ports themselves are opened by [`super::session`].
//!
//! In: [`IpcParams`]. Out: an [`Ipc`], or an [`IpcError`]. The transport's own search for configuration files is never
//! used, and its default of waiting for slow receivers neither.

use super::error::IpcError;
use super::files::{self, Remains, SHARED_MEMORY};
use super::params::IpcParams;
use super::probe::{OpenFiles, Probe};
use super::root::{DaemonLock, SetupLock, prepare};
use super::session::{Session, living_others};
use super::topics::Topic;
use super::watch;
use iceoryx2::node::NodeCreationFailure;
use iceoryx2::prelude::{
    BackpressureStrategy, Config, LogLevel, Node, NodeBuilder, NodeName, SemanticString, SignalHandlingMode,
    ipc_threadsafe, set_log_level,
};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

/// The transport with ports that may change threads; the same bytes as every other of its variants.
pub(super) type Transport = ipc_threadsafe::Service;

/// Longest set-up.
const SETUP_LIMIT: Duration = Duration::from_secs(3);
/// Longest wait for another process's set-up.
const LOCK_LIMIT: Duration = Duration::from_millis(1_500);
/// A shared-memory file is made within microseconds. One that is half made for this long will never be whole.
const MAKING_LIMIT: Duration = Duration::from_millis(100);
/// Descriptors of the transport's registration of a process, and of what a program opens besides: log, GPU, pipes.
const DESCRIPTORS_SPARE: u64 = 24;
/// Descriptors that are asked for where fewer are allowed but more are to be had.
const DESCRIPTORS_WANTED: u64 = 1_024;
/// Files of the registration of a process, and room for a late client's connections.
const SPARE_BYTES: u64 = 64 * 1024;

/// Root, prefix and configuration of the transport, checked. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Ipc {
    root: PathBuf,
    prefix: String,
    config: Config,
}

/// Keeps the transport's registration of this process; dropped last.
#[derive(Debug)]
pub(super) struct Registration {
    probe: Probe,
    prefix: String,
    _node: Node<Transport>,
}

impl Drop for Registration {
    /// A node that ends cleans up after the dead, and would wait for ever for what they left half made.
    fn drop(&mut self) {
        files::sweep_half_made(&self.prefix, MAKING_LIMIT);
    }
}

impl Registration {
    /// A file of ours that was deleted or replaced under us: nobody who comes now can hear us.
    pub(super) fn lost(&self) -> Option<&Path> {
        self.probe.lost()
    }
}

/// What a set-up will take, so that it is refused before it begins.
#[derive(Debug, Clone, Copy)]
pub(super) struct Needs {
    bytes: u64,
    descriptors: u64,
}

impl Needs {
    /// Those of a process without ports.
    pub(super) fn new() -> Self {
        Self { bytes: SPARE_BYTES, descriptors: DESCRIPTORS_SPARE }
    }

    /// And of a publisher of samples of up to `len` elements, with all subscribers that it can get.
    pub(super) fn publisher(self, topic: &Topic, len: usize) -> Self {
        let descriptors = self.descriptors + 4 + topic.qos.subscribers_max as u64;
        Self { bytes: self.bytes + topic.publisher_bytes(len), descriptors }
    }

    /// And of a subscriber, with all publishers that it can get.
    pub(super) fn subscriber(self, topic: &Topic) -> Self {
        let descriptors = self.descriptors + 3 + 2 * topic.qos.publishers_max as u64;
        Self { bytes: self.bytes + topic.subscriber_bytes(), descriptors }
    }

    /// And of `bytes` more.
    pub(super) fn spare(self, bytes: u64) -> Self {
        Self { bytes: self.bytes + bytes, ..self }
    }

    /// Bytes of shared memory.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Descriptors of open files.
    pub(super) fn descriptors(&self) -> u64 {
        self.descriptors
    }
}

/// The transport's configuration for a root and prefix; touches nothing.
pub(super) fn transport_config(root: &Path, prefix: &str) -> Result<Config, IpcError> {
    let invalid = |what: &str| IpcError::Internal(format!("{what} is not taken by the transport"));
    let text = root.to_str().ok_or_else(|| invalid("a root that is not UTF-8"))?;
    let mut config = Config::default();
    let path = iceoryx2::prelude::Path::new(text.as_bytes()).map_err(|_| invalid(text))?;
    config.global.set_root_path(&path);
    config.global.prefix = iceoryx2::prelude::FileName::new(prefix.as_bytes()).map_err(|_| invalid(prefix))?;
    config.global.creation_timeout = Duration::from_secs(1);
    config.defaults.publish_subscribe.backpressure_strategy = BackpressureStrategy::DiscardData;
    Ok(config)
}

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
        let config = transport_config(&root, &params.prefix)?;
        Ok(Self { root, prefix: params.prefix.clone(), config })
    }

    /// The root directory.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The transport's configuration as its own tools read it from `config/iceoryx2.toml`.
    ///
    /// # Errors
    /// [`IpcError::Internal`].
    pub fn transport_toml(&self) -> Result<String, IpcError> {
        toml::to_string(&self.config).map_err(|error| IpcError::Internal(error.to_string()))
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

    /// Refuses to begin where shared memory or descriptors do not suffice: later the one would be a bus error, the other a
    /// start that looks stuck.
    fn check(needs: &Needs) -> Result<(), IpcError> {
        if let Some(free) = files::free_bytes().filter(|free| needs.bytes > *free) {
            return Err(IpcError::NoSpace { place: SHARED_MEMORY, needed: needs.bytes, free });
        }
        let Some(open) = OpenFiles::count() else { return Ok(()) };
        let limit = getrlimit(Resource::Nofile);
        let needed = open + needs.descriptors;
        if limit.current.is_none_or(|allowed| needed <= allowed) {
            return Ok(());
        }
        // What the system grants a process by default is less than what it lets it ask for.
        let wanted = limit.maximum.map_or(DESCRIPTORS_WANTED, |most| most.min(DESCRIPTORS_WANTED)).max(needed);
        let asked = Rlimit { current: Some(wanted), maximum: limit.maximum };
        setrlimit(Resource::Nofile, asked).map_err(|_| IpcError::NoDescriptors {
            needed,
            allowed: limit.maximum.or(limit.current).unwrap_or(0),
            open,
        })
    }

    pub(super) fn stuck(&self, what: String) -> IpcError {
        IpcError::Stuck { what, root: self.root.clone(), prefix: self.prefix.clone() }
    }

    /// Registers this process as `node_name` and runs `make`, in a thread of its own that is given up after three
    /// seconds: the transport can wait for ever for a file that a dead process left half made.
    pub(super) fn set_up<T: Send + 'static>(
        &self,
        node_name: &'static str,
        needs: Needs,
        make: impl FnOnce(&Session) -> Result<T, IpcError> + Send + 'static,
    ) -> Result<(Registration, T), IpcError> {
        Self::check(&needs)?;
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
        files::refuse_foreign(&self.prefix)?;
        files::sweep_half_made(&self.prefix, MAKING_LIMIT);
        self.clear_if_alone()?;
        let before = OpenFiles::now();
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
        let session = Session::new(self, &self.config, &node);
        let made = make(&session)?;
        watch::start(node_name, self.prefix.clone(), session.into_calls());
        files::reserve(&self.prefix)?;
        files::close_to_others(&self.root, &self.prefix);
        let probe = Probe::since(&before, &self.root, &self.prefix);
        Ok((Registration { probe, prefix: self.prefix.clone(), _node: node }, made))
    }

    /// Begins with nothing where nobody lives: whatever the dead left, and in what state, can then do no harm.
    ///
    /// A client of any language may be starting at this very moment: what is young is given time to turn out to be alive, and
    /// what comes later is left alone.
    fn clear_if_alone(&self) -> Result<(), IpcError> {
        let alone = || living_others(&self.config, None) == Some(0);
        let remains = Remains::list(&self.root, &self.prefix);
        let Some(age) = remains.age().filter(|_| alone()) else { return Ok(()) };
        if age < MAKING_LIMIT {
            std::thread::sleep(MAKING_LIMIT - age);
            if !alone() {
                return Ok(());
            }
        }
        let removed = remains.remove().map_err(|source| IpcError::CannotCreate { path: self.root.clone(), source })?;
        if removed > 1 {
            log::info!("{removed} files of dead processes were removed from {}", self.root.display());
        }
        Ok(())
    }
}
