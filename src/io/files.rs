//! The transport's files under one root and prefix, and how a supervisor wipes them when communication is stuck.
//!
//! In: where the topics are. Out: nothing of them left. A file is known by its name alone, so that spoilt ones go too.

use super::error::IpcError;
use super::params::IpcParams;
use super::root::{DaemonLock, SetupLock, prepare};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where the transport's payloads lie.
const SHARED_MEMORY: &str = "/dev/shm";
/// The transport's folders in the root.
const FOLDERS: [&str; 2] = ["nodes", "services"];
/// Longest wait for another process's set-up before a wipe.
const LOCK_LIMIT: Duration = Duration::from_millis(1_500);

/// Removes everything that daemon, controller and their clients have under the root and prefix of `params`: what a supervisor
/// does after exit code 75, when it has stopped them all. Returns how many files there were.
///
/// A client that still runs loses its topics and has to be started again; a running daemon is refused.
///
/// # Errors
/// [`IpcError`]: 69 where a daemon runs, 73, 75 where another process is setting up, 77 for a root that is not ours.
pub fn wipe(params: &IpcParams) -> Result<usize, IpcError> {
    let root = params.root_path();
    prepare(&root)?;
    let cannot = |source| IpcError::CannotCreate { path: root.clone(), source };
    let _alone = SetupLock::acquire(&root, LOCK_LIMIT).map_err(cannot)?.ok_or_else(|| IpcError::Stuck {
        what: "another process has been setting up for too long".to_owned(),
        root: root.clone(),
        prefix: params.prefix.clone(),
    })?;
    let _no_daemon = DaemonLock::acquire(&root, &params.prefix)?;
    let mut doomed = Vec::new();
    FOLDERS.iter().for_each(|folder| collect(&root.join(folder), &mut doomed));
    doomed.extend(names_in(Path::new(SHARED_MEMORY)));
    doomed.retain(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(&params.prefix)));
    let mut removed = 0;
    for path in doomed {
        match std::fs::remove_file(&path) {
            Ok(()) => removed += 1,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(cannot(error)),
        }
    }
    Ok(removed)
}

fn names_in(folder: &Path) -> impl Iterator<Item = PathBuf> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) {
    for path in names_in(folder) {
        if path.is_dir() {
            collect(&path, found);
        } else {
            found.push(path);
        }
    }
}
