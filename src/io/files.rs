//! The transport's files under one root and prefix: told from others', reserved, closed to others, swept and wiped.
//!
//! In: a root, a prefix. Out: files that are all ours, all private and all backed by memory, or an error. A file is known by
//! its name alone, so that files spoilt by a crash are found like sound ones. Never reads what is in them.

use super::error::IpcError;
use super::params::IpcParams;
use super::root::{DaemonLock, SetupLock, prepare};
use std::fs::{File, Metadata, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where the transport's payloads lie.
pub(super) const SHARED_MEMORY: &str = "/dev/shm";
/// The transport's folders in the root.
const FOLDERS: [&str; 2] = ["nodes", "services"];
/// Digits of the hash in the name of every file in shared memory.
const HASH_LEN: usize = 40;
/// Longest wait for another process's set-up before a wipe.
const LOCK_LIMIT: Duration = Duration::from_millis(1_500);
const OTHERS: u32 = 0o077;
const OWNER_READ: u32 = 0o400;

/// Whether a name in shared memory is one of `prefix`, and not of a longer prefix that begins with it.
pub(super) fn is_of_prefix(name: &str, prefix: &str) -> bool {
    let Some(rest) = name.strip_prefix(prefix) else { return false };
    let hash_len = rest.bytes().take_while(u8::is_ascii_hexdigit).count();
    hash_len == HASH_LEN && rest.as_bytes().get(HASH_LEN) == Some(&b'_')
}

fn files_in(folder: &Path) -> impl Iterator<Item = (PathBuf, Metadata)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    // A file may go between its listing and our look.
    entries.filter_map(|entry| Some((entry.path(), std::fs::symlink_metadata(entry.path()).ok()?)))
}

/// The prefix's files in shared memory.
pub(super) fn shared(prefix: &str) -> impl Iterator<Item = (PathBuf, Metadata)> {
    files_in(Path::new(SHARED_MEMORY)).filter(move |(path, metadata)| {
        metadata.is_file()
            && path.file_name().and_then(|name| name.to_str()).is_some_and(|name| is_of_prefix(name, prefix))
    })
}

/// The transport's folders, the folders of its nodes, and everything in them.
fn below(root: &Path) -> Vec<(PathBuf, Metadata)> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = FOLDERS.iter().map(|folder| root.join(folder)).collect();
    while let Some(folder) = folders.pop() {
        for (path, metadata) in files_in(&folder) {
            if metadata.is_dir() {
                folders.push(path.clone());
            }
            found.push((path, metadata));
        }
        found.extend(std::fs::symlink_metadata(&folder).ok().map(|metadata| (folder, metadata)));
    }
    found
}

/// Refuses a start among files that another user put where ours belong.
pub(super) fn refuse_foreign(prefix: &str) -> Result<(), IpcError> {
    let ours = rustix::process::geteuid().as_raw();
    match shared(prefix).find(|(_, metadata)| metadata.uid() != ours) {
        None => Ok(()),
        Some((path, metadata)) => Err(IpcError::Permission {
            path,
            found: format!("owner {}, not {ours}", metadata.uid()),
            allowed: "files of this user; remove it, or use another [ipc] prefix",
        }),
    }
}

/// Whether a shared-memory file has no size, or cannot be read yet: its maker is at it, or was killed.
pub(super) fn is_half_made(metadata: &Metadata) -> bool {
    metadata.len() == 0 || metadata.mode() & OWNER_READ == 0
}

/// Removes shared-memory files that a process began and, killed, will never finish: without a size, or not yet readable.
///
/// The transport waits for such a file for ever, when it begins, ends or cleans up after the dead; without the file it goes on.
/// They are given `patience` to become whole.
pub(super) fn sweep_half_made(prefix: &str, patience: Duration) {
    let half_made =
        || shared(prefix).filter(|(_, metadata)| is_half_made(metadata)).map(|(path, metadata)| (path, metadata.ino()));
    let seen: Vec<_> = half_made().collect();
    if seen.is_empty() {
        return;
    }
    std::thread::sleep(patience);
    for (path, _) in half_made().filter(|file| seen.contains(file)) {
        log::warn!("{} was left half made and is removed", path.display());
        let _ = std::fs::remove_file(path);
    }
}

/// Reserves every page of the prefix's files, so that no later write can fail for want of memory.
pub(super) fn reserve(prefix: &str) -> Result<(), IpcError> {
    for (path, metadata) in shared(prefix) {
        let len = metadata.len();
        if len == 0 || metadata.blocks() * 512 >= len {
            continue;
        }
        let Ok(file) = File::options().read(true).write(true).open(path) else { continue };
        #[cfg(any(target_os = "linux", target_os = "android"))]
        if rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, len).is_err() {
            return Err(IpcError::NoSpace { place: SHARED_MEMORY, needed: len, free: free_bytes().unwrap_or(0) });
        }
    }
    Ok(())
}

/// The file by which a node of the transport says that it uses a service.
pub(super) fn service_tag(root: &Path, prefix: &str, node: u128, hash: &str) -> PathBuf {
    root.join(format!("nodes/{node}/{prefix}{hash}.service_tag"))
}

/// Removes the file that announces a service; false where there is none.
pub(super) fn remove_service_file(root: &Path, prefix: &str, hash: &str) -> bool {
    std::fs::remove_file(root.join(format!("services/{prefix}{hash}.service"))).is_ok()
}

/// Bytes that are free in shared memory; none known where it has no directory.
pub(super) fn free_bytes() -> Option<u64> {
    free_bytes_of(Path::new(SHARED_MEMORY))
}

/// Bytes that this user may still write where a path lies.
#[must_use]
pub fn free_bytes_of(path: &Path) -> Option<u64> {
    let space = rustix::fs::statvfs(path).ok()?;
    Some(space.f_bavail.saturating_mul(space.f_frsize))
}

/// Takes from everybody else what rights the transport gives them: its management segment it opens to the whole world.
pub(super) fn close_to_others(root: &Path, prefix: &str) {
    let ours = rustix::process::geteuid().as_raw();
    for (path, metadata) in shared(prefix).chain(below(root)) {
        let mode = metadata.mode() & 0o7777;
        if metadata.uid() == ours && mode & OTHERS != 0 && !metadata.is_symlink() {
            let _ = std::fs::set_permissions(path, Permissions::from_mode(mode & !OTHERS));
        }
    }
}

/// What the transport has under one root and prefix at one moment, and nothing that comes later.
#[derive(Debug)]
pub(super) struct Remains {
    files: Vec<(PathBuf, Metadata)>,
    folders: Vec<PathBuf>,
}

impl Remains {
    pub(super) fn list(root: &Path, prefix: &str) -> Self {
        let ours = rustix::process::geteuid().as_raw();
        let (folders, mut files): (Vec<_>, Vec<_>) =
            below(root).into_iter().partition(|(_, metadata)| metadata.is_dir());
        files.retain(|(path, _)| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)));
        files.extend(shared(prefix).filter(|(_, metadata)| metadata.uid() == ours));
        let mut folders: Vec<PathBuf> = folders.into_iter().map(|(path, _)| path).collect();
        // Deepest first, so that a folder is empty when its turn comes.
        folders.sort_by_key(|path| std::cmp::Reverse(path.as_os_str().len()));
        Self { files, folders }
    }

    /// How many files there are.
    pub(super) fn count(&self) -> usize {
        self.files.len()
    }

    /// How long ago the newest of the files was written; none without files. One from the future is new.
    pub(super) fn age(&self) -> Option<Duration> {
        let written = self.files.iter().filter_map(|(_, metadata)| metadata.modified().ok()).max()?;
        Some(written.elapsed().unwrap_or_default())
    }

    /// Removes the files, and those of the folders inside the transport's two that are empty then; returns how many files there
    /// were. A file that was put in a listed one's place since stays, and so do the transport's two folders: somebody may just be
    /// about to write there. Locks of ours are none of the transport's.
    ///
    /// To be called only while holding the root's lock for set-up, when no process uses the files.
    pub(super) fn remove(&self) -> std::io::Result<usize> {
        let mut removed = 0;
        for (path, listed) in &self.files {
            if std::fs::symlink_metadata(path).is_ok_and(|now| now.ino() != listed.ino()) {
                continue;
            }
            match std::fs::remove_file(path) {
                Ok(()) => removed += 1,
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        // A folder that another prefix still uses is not empty and stays.
        let inner = |path: &&PathBuf| !FOLDERS.iter().any(|folder| path.ends_with(folder));
        self.folders.iter().filter(inner).for_each(|folder| drop(std::fs::remove_dir(folder)));
        Ok(removed)
    }
}

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
    if SetupLock::acquire(&root, LOCK_LIMIT).map_err(cannot)?.is_none() {
        let what = "another process has been setting up for too long".to_owned();
        return Err(IpcError::Stuck { what, root, prefix: params.prefix.clone() });
    }
    let _no_daemon = DaemonLock::acquire(&root, &params.prefix)?;
    let removed = Remains::list(&root, &params.prefix).remove().map_err(cannot)?;
    FOLDERS.iter().for_each(|folder| drop(std::fs::remove_dir(root.join(folder))));
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HASH: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5";

    #[test]
    fn a_longer_prefix_is_another_prefix() {
        assert!(is_of_prefix(&format!("bat_{HASH}_1.data"), "bat_"));
        for name in [format!("bat_two_{HASH}_1.data"), format!("bat_{HASH}"), format!("bat_a{HASH}_1.data")] {
            assert!(!is_of_prefix(&name, "bat_"), "{name}");
        }
        assert!(!is_of_prefix(&format!("bat_{HASH}_1.data"), "ba"));
    }

    #[test]
    fn a_wipe_takes_what_is_of_the_prefix_and_nothing_else() {
        let directory = tempfile::tempdir().expect("directory");
        let root = directory.path().join("root");
        let params = IpcParams { root: Some(root.clone()), prefix: format!("wipe{}_", std::process::id()) };
        let ours = |folder: &str, name: &str| root.join(folder).join(format!("{}{name}", params.prefix));
        let theirs = root.join("services").join(format!("other_{HASH}.service"));
        let unrelated = root.join("notes.txt");
        std::fs::create_dir_all(root.join("nodes/77")).expect("made");
        std::fs::create_dir_all(root.join("services")).expect("made");
        prepare(&root).expect("private");
        let shared = Path::new(SHARED_MEMORY).join(format!("{}{HASH}_5.data", params.prefix));
        let doomed =
            [ours("nodes", "77.node_monitor"), ours("nodes/77", "x.tag"), ours("services", "a.service"), shared];
        for path in doomed.iter().chain([&theirs, &unrelated]) {
            std::fs::write(path, "x").expect("written");
        }
        assert_eq!(wipe(&params).expect("wiped"), doomed.len());
        assert!(doomed.iter().all(|path| !path.exists()) && !root.join("nodes").exists());
        assert!(theirs.exists() && unrelated.exists());
        assert_eq!(wipe(&params).expect("nothing there"), 0);
    }

    #[test]
    fn a_wipe_under_a_running_daemon_is_refused_with_69() {
        let directory = tempfile::tempdir().expect("directory");
        let root = directory.path().join("root");
        prepare(&root).expect("made");
        let params = IpcParams { root: Some(root.clone()), prefix: format!("run{}_", std::process::id()) };
        let _daemon = DaemonLock::acquire(&root, &params.prefix).expect("free");
        assert_eq!(wipe(&params).expect_err("refused").exit_code(), 69);
    }
}
