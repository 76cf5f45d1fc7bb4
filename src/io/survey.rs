//! What lies under a root and prefix, and who lives there, seen from outside: for `noctule status` and `noctule doctor`.
//!
//! In: [`IpcParams`]. Out: facts. Registers, locks, makes, changes and removes nothing, so it may be taken beside a running
//! system and on a machine where nothing ever ran. The transport can wait for ever for what a dead process left half made:
//! its own lists are given up after [`LIST_LIMIT`].

use super::files::{self, Remains};
use super::node::{Transport, transport_config};
use super::params::IpcParams;
use super::root::{DAEMON_NAMES, daemon_name, lock_path};
use super::topics::{SCHEMA_ATTRIBUTE, Topic};
use iceoryx2::node::{NodeState, NodeView as _};
use iceoryx2::prelude::{CallbackProgression, Node, Service};
use serde::Serialize;
use std::io::Read as _;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// The version of the transport that this build speaks; no other one is understood.
pub const TRANSPORT_VERSION: &str = "0.10.0";
/// Longest wait for the transport's lists.
pub const LIST_LIMIT: Duration = Duration::from_millis(1_500);
/// A file that is half made for this long will never be whole.
const MAKING_LIMIT: Duration = Duration::from_secs(1);
/// Ending of the segments that begin with the version of the transport that made them.
const VERSIONED: &str = ".dynamic";

/// The root directory as it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Root {
    /// Not there yet; the nearest directory above it that exists, and whether this user may write there.
    Missing {
        /// The directory.
        above: PathBuf,
        /// Whether the root can be made.
        writable: bool,
    },
    /// A directory.
    Directory {
        /// User that owns it.
        owner: u32,
        /// Permission bits.
        mode: u32,
        /// Permission bits of the directory above it.
        parent_mode: u32,
    },
    /// Something else, which a start refuses.
    Other(String),
}

/// A process that registered with the transport.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Participant {
    /// Name that it gave itself, for example `noctule-daemon`; `?` where it cannot be read.
    pub name: String,
    /// Its process.
    pub process: Option<u32>,
    /// Whether it lives.
    pub alive: bool,
}

/// A service that exists.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FoundService {
    /// Topic.
    pub name: String,
    /// Schema hash in its attributes.
    pub schema: Option<String>,
    /// The hash that this build expects there; none for a name that is no topic of ours.
    pub expected: Option<String>,
    /// Who takes part.
    pub participants: Vec<Participant>,
}

/// Everything seen at one moment.
#[derive(Debug, Clone)]
pub struct Survey {
    /// The root directory's path.
    pub root_path: PathBuf,
    /// Prefix.
    pub prefix: String,
    /// The root directory.
    pub root: Root,
    /// Process of the daemon that holds the lock.
    pub daemon: Option<u32>,
    /// Names of daemons of other roots or prefixes on this machine.
    pub other_daemons: Vec<String>,
    /// Files of the prefix in root and shared memory.
    pub file_count: usize,
    /// Bytes that its files in shared memory take.
    pub shared_bytes: u64,
    /// Files in shared memory that another user owns.
    pub foreign: Vec<(PathBuf, u32)>,
    /// Files in shared memory that will never be whole.
    pub half_made: Vec<PathBuf>,
    /// Segments of another version of the transport.
    pub other_versions: Vec<(PathBuf, String)>,
    /// Who registered; none when the transport did not answer in time.
    pub participants: Option<Vec<Participant>>,
    /// Services there are; none when the transport did not answer in time.
    pub services: Option<Vec<FoundService>>,
}

impl Survey {
    /// Looks. `topics` are those whose types this build knows.
    #[must_use]
    pub fn take(params: &IpcParams, topics: Vec<Topic>) -> Self {
        let (root_path, prefix) = (params.root_path(), params.prefix.clone());
        let root = look_at_root(&root_path);
        let ours = rustix::process::geteuid().as_raw();
        let shared: Vec<_> = files::shared(&prefix).collect();
        let old = |modified: Option<std::time::SystemTime>| {
            modified.and_then(|at| at.elapsed().ok()).is_some_and(|age| age >= MAKING_LIMIT)
        };
        let foreign = shared.iter().filter(|(_, data)| data.uid() != ours);
        let half_made = shared.iter().filter(|(_, data)| files::is_half_made(data) && old(data.modified().ok()));
        let (participants, services) = match &root {
            Root::Directory { .. } => lists(&root_path, &prefix, topics),
            _ => (Some(Vec::new()), Some(Vec::new())),
        };
        Self {
            daemon: lock_holder(&root_path, &prefix),
            other_daemons: other_daemons(&root_path, &prefix),
            file_count: Remains::list(&root_path, &prefix).count(),
            shared_bytes: shared.iter().map(|(_, data)| data.blocks() * 512).sum(),
            foreign: foreign.map(|(path, data)| (path.clone(), data.uid())).collect(),
            half_made: half_made.map(|(path, _)| path.clone()).collect(),
            other_versions: shared.iter().filter_map(|(path, _)| other_version(path)).collect(),
            root_path,
            prefix,
            root,
            participants,
            services,
        }
    }

    /// Whether anybody lives here, as far as can be told.
    #[must_use]
    pub fn is_inhabited(&self) -> bool {
        self.daemon.is_some() || self.participants.as_ref().is_none_or(|all| all.iter().any(|one| one.alive))
    }

    /// Registrations of processes that are gone.
    #[must_use]
    pub fn dead(&self) -> Vec<&Participant> {
        self.participants.iter().flatten().filter(|one| !one.alive).collect()
    }

    /// Services whose type is not the one of this build.
    #[must_use]
    pub fn other_builds(&self) -> Vec<&FoundService> {
        let differs = |service: &&FoundService| service.expected.is_some() && service.schema != service.expected;
        self.services.iter().flatten().filter(differs).collect()
    }
}

fn look_at_root(root: &Path) -> Root {
    let Ok(metadata) = std::fs::symlink_metadata(root) else {
        let above = root.ancestors().skip(1).find(|path| path.is_dir()).unwrap_or(Path::new("/")).to_owned();
        let writable = rustix::fs::access(&above, rustix::fs::Access::WRITE_OK).is_ok();
        return Root::Missing { above, writable };
    };
    if metadata.is_symlink() {
        return Root::Other("a symbolic link".to_owned());
    }
    if !metadata.is_dir() {
        return Root::Other("a file".to_owned());
    }
    let bits = |metadata: &std::fs::Metadata| metadata.permissions().mode() & 0o7777;
    let parent = root.parent().and_then(|parent| std::fs::metadata(parent).ok());
    Root::Directory { owner: metadata.uid(), mode: bits(&metadata), parent_mode: parent.as_ref().map_or(0, bits) }
}

/// The process that holds the daemon's lock, asked without locking it.
fn lock_holder(root: &Path, prefix: &str) -> Option<u32> {
    let path = lock_path(root, prefix);
    let (text, metadata) = (std::fs::read_to_string(&path).ok()?, std::fs::metadata(&path).ok()?);
    let process: u32 = text.trim().parse().ok()?;
    // A lock of the kernel ends with its process; a file that is left says nothing.
    let inode = format!(":{}", metadata.ino());
    match std::fs::read_to_string("/proc/locks") {
        Ok(locks) => locks
            .lines()
            .filter(|line| line.contains("FLOCK"))
            .any(|line| line.split_whitespace().any(|part| part.ends_with(&inode)))
            .then_some(process),
        Err(_) => exists(process).then_some(process),
    }
}

/// Whether a process runs, be it another user's.
#[must_use]
pub fn exists(process: u32) -> bool {
    rustix::process::Pid::from_raw(process.cast_signed())
        .is_some_and(|pid| rustix::process::test_kill_process(pid) != Err(rustix::io::Errno::SRCH))
}

/// Daemons of this machine but for the one of this root and prefix, as the kernel lists their names.
fn other_daemons(root: &Path, prefix: &str) -> Vec<String> {
    let listed = std::fs::read_to_string("/proc/net/unix").unwrap_or_default();
    let ours = daemon_name(root, prefix);
    let names = listed.lines().filter_map(|line| line.rsplit_once('@')).map(|(_, name)| name.trim());
    let mut others: Vec<String> =
        names.filter(|name| name.starts_with(DAEMON_NAMES) && *name != ours).map(ToOwned::to_owned).collect();
    others.sort();
    others.dedup();
    others
}

/// A segment that another version of the transport made, with that version.
fn other_version(path: &Path) -> Option<(PathBuf, String)> {
    if !path.to_string_lossy().ends_with(VERSIONED) {
        return None;
    }
    let mut bytes = [0; 8];
    std::fs::File::open(path).ok()?.read_exact(&mut bytes).ok()?;
    let number = u64::from_ne_bytes(bytes);
    let part = |shift: u32| (number >> shift) & 0xffff;
    let version = format!("{}.{}.{}", part(32), part(16), part(0));
    (number != 0 && version != TRANSPORT_VERSION).then(|| (path.to_owned(), version))
}

/// Runs `work` in a thread of its own, which is left behind when it takes too long.
fn within<T: Send + 'static>(limit: Duration, work: impl FnOnce() -> Option<T> + Send + 'static) -> Option<T> {
    let (sender, receiver) = sync_channel(1);
    let run = move || {
        let _ = sender.send(crate::life::panic::contained(work));
    };
    std::thread::Builder::new().name("noctule survey".to_owned()).spawn(run).ok()?;
    receiver.recv_timeout(limit).ok()?
}

fn lists(root: &Path, prefix: &str, topics: Vec<Topic>) -> (Option<Vec<Participant>>, Option<Vec<FoundService>>) {
    let Ok(config) = transport_config(root, prefix) else { return (None, None) };
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
    let for_services = config.clone();
    let participants = within(LIST_LIMIT, move || {
        let mut found = Vec::new();
        let listed = Node::<Transport>::list(&config, |state| {
            found.push(participant(&state));
            CallbackProgression::Continue
        });
        listed.is_ok().then_some(found)
    });
    if participants.is_none() {
        return (None, None);
    }
    let services = within(LIST_LIMIT, move || {
        let key = SCHEMA_ATTRIBUTE.try_into().ok()?;
        let mut found = Vec::new();
        let listed = Transport::list(&for_services, |service| {
            let attributes = service.static_details.attributes();
            let name = service.static_details.name().to_string();
            let expected = topics.iter().find(|topic| topic.name == name);
            let nodes = service.dynamic_details.map_or_else(Vec::new, |dynamic| dynamic.nodes);
            found.push(FoundService {
                schema: attributes.key_value(&key, 0).map(ToString::to_string),
                expected: expected.map(|topic| format!("{:016x}", topic.schema_hash())),
                participants: nodes.iter().map(participant).collect(),
                name,
            });
            CallbackProgression::Continue
        });
        found.sort_by(|a, b| a.name.cmp(&b.name));
        listed.is_ok().then_some(found)
    });
    (participants, services)
}

fn participant(state: &NodeState<Transport>) -> Participant {
    let details = match state {
        NodeState::Alive(view) => view.details().clone(),
        NodeState::Dead(view) => view.details().clone(),
        NodeState::Inaccessible(_) | NodeState::Undefined(_) => None,
    };
    Participant {
        name: details.map_or("?".to_owned(), |details| details.name().to_string()),
        process: state.node_id().pid::<Transport>().ok().and_then(|pid| u32::try_from(pid.value()).ok()),
        alive: matches!(state, NodeState::Alive(_) | NodeState::Inaccessible(_)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_is_the_one_that_is_pinned() {
        let manifest = include_str!("../../Cargo.toml");
        assert!(manifest.contains(&format!("iceoryx2 = {{ version = \"={TRANSPORT_VERSION}\"")));
    }

    #[test]
    fn a_segment_of_another_version_is_told_by_its_first_bytes() {
        let folder = tempfile::tempdir().expect("folder");
        let make = |name: &str, number: u64| {
            let path = folder.path().join(name);
            std::fs::write(&path, number.to_ne_bytes()).expect("written");
            path
        };
        let version = |major: u64, minor: u64, patch: u64| major << 32 | minor << 16 | patch;
        assert_eq!(other_version(&make("a.dynamic", version(0, 10, 0))), None);
        let (_, found) = other_version(&make("b.dynamic", version(0, 9, 2))).expect("another");
        assert_eq!(found, "0.9.2");
        assert_eq!(other_version(&make("c.dynamic", 0)), None, "still being made");
        assert_eq!(other_version(&make("d.data", version(0, 9, 2))), None);
    }

    #[test]
    fn a_missing_root_is_told_with_the_directory_that_it_would_be_made_in_and_stays_missing() {
        let folder = tempfile::tempdir().expect("folder");
        let root = folder.path().join("deep/root");
        let params = IpcParams { root: Some(root.clone()), prefix: format!("survey{}_", std::process::id()) };
        let survey = Survey::take(&params, Vec::new());
        assert_eq!(survey.root, Root::Missing { above: folder.path().to_owned(), writable: true });
        assert!(!survey.is_inhabited() && !root.exists());
    }
}
