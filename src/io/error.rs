//! Why inter-process communication cannot begin or go on, in words for a person and as an exit code for a supervisor.

use std::io;
use std::path::PathBuf;

/// An error of the transport or of what it stands on.
#[derive(Debug, thiserror::Error)]
pub enum IpcError {
    /// Another daemon runs under the same root and prefix.
    #[error("another daemon (process {pid}) holds {}: stop it, or use another [ipc] root or prefix", path.display())]
    DaemonRunning {
        /// Process that holds the lock.
        pid: u32,
        /// The lock.
        path: PathBuf,
    },
    /// Somebody else publishes what only one may.
    #[error("service {service} already has its publisher (process {holder}); only one is allowed")]
    PublisherPresent {
        /// The service.
        service: String,
        /// Process ids, or `unknown`.
        holder: String,
    },
    /// A service offers no more places.
    #[error("service {service}: {what}; allowed are {allowed}")]
    Crowded {
        /// The service.
        service: String,
        /// What there are too many of.
        what: &'static str,
        /// How many may be.
        allowed: usize,
    },
    /// The service was made by another build.
    #[error("service {service} was made by another build: found {found}; expected {expected}")]
    Incompatible {
        /// The service.
        service: String,
        /// What does not fit.
        found: String,
        /// Our schema, type and limits.
        expected: String,
    },
    /// Nobody offers the service.
    #[error("nobody offers {service} under {} with prefix {prefix}: is the daemon running?", root.display())]
    NoPeer {
        /// The service.
        service: String,
        /// Root that was searched.
        root: PathBuf,
        /// Prefix that was searched.
        prefix: String,
    },
    /// A request had no effect.
    #[error("{0}")]
    NoEffect(String),
    /// The name is no topic.
    #[error("{topic} is no topic; there are: {known}")]
    UnknownTopic {
        /// What was asked for.
        topic: String,
        /// The topics.
        known: String,
    },
    /// Shared memory is too small.
    #[error(
        "shared memory {place} has {free} bytes free, {needed} are needed: enlarge it, or use fewer or smaller sensors"
    )]
    NoSpace {
        /// Where.
        place: &'static str,
        /// Bytes that are needed.
        needed: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// The process may not open enough files.
    #[error(
        "this process may have {allowed} files open, {needed} are needed ({open} are open): raise RLIMIT_NOFILE (ulimit -n)"
    )]
    NoDescriptors {
        /// Descriptors that are needed, with those that are open.
        needed: u64,
        /// Most that the process may have.
        allowed: u64,
        /// Descriptors in use already.
        open: u64,
    },
    /// A file of ours was deleted or replaced while we used it.
    #[error("{} was taken away: nobody who starts now can be heard", path.display())]
    TakenAway {
        /// The file.
        path: PathBuf,
    },
    /// A file or directory cannot be made.
    #[error("cannot create {}: {source}", path.display())]
    CannotCreate {
        /// What.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Left-overs of a dead process, or somebody who holds on to what is needed.
    #[error("communication is stuck: {what}; stop all processes, remove {} and the shared memory files {prefix}*, start again", root.display())]
    Stuck {
        /// What happened, and with which service.
        what: String,
        /// The root.
        root: PathBuf,
        /// The prefix.
        prefix: String,
    },
    /// Somebody else's file, or one that others may change.
    #[error("{}: found {found}, allowed: {allowed}", path.display())]
    Permission {
        /// What.
        path: PathBuf,
        /// What is wrong.
        found: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A sample could not be sent.
    #[error("cannot publish on {service}: {reason}")]
    Send {
        /// The service.
        service: String,
        /// What the transport says.
        reason: String,
    },
    /// A name or path that the transport does not take, or a thread that died.
    #[error("internal error of the transport: {0}")]
    Internal(String),
}

impl IpcError {
    /// The exit code of the safe-state contract: 69 peer unavailable, 70 internal, 73 cannot create, 75 stuck, 77 permission.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            IpcError::DaemonRunning { .. }
            | IpcError::PublisherPresent { .. }
            | IpcError::Crowded { .. }
            | IpcError::Incompatible { .. }
            | IpcError::NoPeer { .. }
            | IpcError::NoEffect(_) => 69,
            IpcError::UnknownTopic { .. } => 2,
            IpcError::NoSpace { .. } | IpcError::NoDescriptors { .. } | IpcError::CannotCreate { .. } => 73,
            IpcError::Stuck { .. } | IpcError::TakenAway { .. } => 75,
            IpcError::Permission { .. } => 77,
            IpcError::Send { .. } | IpcError::Internal(_) => 70,
        }
    }
}
