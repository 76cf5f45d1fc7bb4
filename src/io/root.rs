//! The directory of the transport's files: made private, refused when it is somebody else's, and the locks inside it.
//!
//! In: a path. Out: a directory that only this user can enter, or an error with exit code 73 or 77. Never deletes what
//! it did not make.

use super::error::IpcError;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
#[cfg(target_os = "linux")]
use rustix::net::{
    AddressFamily, Shutdown, SocketAddrUnix, SocketFlags, SocketType, connect, shutdown, socket_with,
    sockopt::socket_peercred,
};
use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{self, Read, Seek, Write};
#[cfg(target_os = "linux")]
use std::os::linux::net::SocketAddrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
#[cfg(target_os = "linux")]
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const MODE: u32 = 0o700;
const OURS: &str = "a directory of this user with mode 0700";

/// Makes `root` with mode 0700 if it is missing, and checks that nobody else can change it.
///
/// # Errors
/// [`IpcError::Permission`] for a symbolic link, another owner, or a directory that others may write to;
/// [`IpcError::CannotCreate`] where it cannot be made.
pub(super) fn prepare(root: &Path) -> Result<(), IpcError> {
    let refuse = |found: String| IpcError::Permission { path: root.to_owned(), found, allowed: OURS };
    let cannot = |source: io::Error| match source.kind() {
        io::ErrorKind::PermissionDenied => refuse("no permission".to_owned()),
        _ => IpcError::CannotCreate { path: root.to_owned(), source },
    };
    if let Some(parent) = root.parent() {
        DirBuilder::new().recursive(true).mode(MODE).create(parent).map_err(cannot)?;
    }
    match DirBuilder::new().mode(MODE).create(root) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(cannot(error)),
        _ => {}
    }
    if let Some(parent) = root.parent() {
        let mode = std::fs::metadata(parent).map_err(cannot)?.permissions().mode();
        if mode & 0o002 != 0 && mode & 0o1000 == 0 {
            return Err(refuse(format!(
                "a parent directory with mode {:04o}, where others can replace it",
                mode & 0o7777
            )));
        }
    }
    let metadata = std::fs::symlink_metadata(root).map_err(cannot)?;
    if metadata.is_symlink() {
        return Err(refuse("a symbolic link".to_owned()));
    }
    if !metadata.is_dir() {
        return Err(refuse("a file".to_owned()));
    }
    let uid = rustix::process::geteuid().as_raw();
    if metadata.uid() != uid {
        return Err(refuse(format!("owner {}, not {uid}", metadata.uid())));
    }
    let mode = metadata.permissions().mode() & 0o777;
    if mode & 0o022 != 0 {
        return Err(refuse(format!("mode {mode:04o}, others can write")));
    }
    if mode & 0o077 != 0 {
        // Ours and never writable by others: closing it is enough.
        std::fs::set_permissions(root, std::fs::Permissions::from_mode(MODE)).map_err(cannot)?;
    }
    Ok(())
}

/// A lock that lives as long as this value; the kernel releases it when the process dies.
#[derive(Debug)]
pub(super) struct SetupLock {
    _directory: File,
}

impl SetupLock {
    /// Waits until nobody else sets up, at most `limit`. `None` when time ran out.
    pub(super) fn acquire(root: &Path, limit: Duration) -> io::Result<Option<Self>> {
        let directory = File::open(root)?;
        let deadline = Instant::now() + limit;
        loop {
            match flock(&directory, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Ok(Some(Self { _directory: directory })),
                Err(Errno::WOULDBLOCK | Errno::INTR) if Instant::now() < deadline => {
                    std::thread::sleep(Duration::from_millis(2));
                }
                Err(Errno::WOULDBLOCK | Errno::INTR) => return Ok(None),
                Err(error) => return Err(error.into()),
            }
        }
    }
}

/// Makes two daemons under one root and prefix impossible: by a file that names the holder, and by a name that cannot be
/// deleted with the root.
#[derive(Debug)]
pub struct DaemonLock {
    file: File,
    path: PathBuf,
    #[cfg(target_os = "linux")]
    name: Option<UnixListener>,
}

/// What every daemon's name outside of the file system begins with.
pub(super) const DAEMON_NAMES: &str = "noctule-daemon-";

/// The name, outside of the file system, of the daemon of a root and prefix of this user.
pub(super) fn daemon_name(root: &Path, prefix: &str) -> String {
    let hash = crc32fast::hash(root.as_os_str().as_encoded_bytes());
    format!("{DAEMON_NAMES}{}-{prefix}{hash:08x}", rustix::process::geteuid().as_raw())
}

/// The file that a daemon locks.
pub(super) fn lock_path(root: &Path, prefix: &str) -> PathBuf {
    root.join(format!("{prefix}daemon.lock"))
}

/// How long a start waits for a name whose holder has let go of it. A process that forks holds every open file twice until its
/// child runs its own program: some hundred microseconds, longer on a loaded machine.
#[cfg(target_os = "linux")]
const LET_GO: Duration = Duration::from_millis(250);

/// What holds a name outside of the file system.
#[cfg(target_os = "linux")]
enum NameHolder {
    /// A process of this user or of root.
    Daemon(u32),
    /// A process that has let go of the name, as a lock does when it is dropped, or has just gone.
    Leaving,
    /// Somebody whose name is no use to us and no obstacle.
    Stranger,
}

/// Asks who listens under a name; a full queue is no reason to wait.
#[cfg(target_os = "linux")]
fn name_holder(name: &str) -> NameHolder {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let asked = SocketAddrUnix::new_abstract_name(name.as_bytes()).and_then(|address| {
        let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
        connect(&socket, &address)?;
        socket_peercred(&socket)
    });
    match asked {
        Ok(holder) if holder.uid == rustix::process::geteuid() || holder.uid.is_root() => {
            NameHolder::Daemon(holder.pid.as_raw_pid().cast_unsigned())
        }
        Err(Errno::CONNREFUSED) => NameHolder::Leaving,
        _ => NameHolder::Stranger,
    }
}

/// Claims a name outside of the file system for the daemon of this root and prefix. `Err` with the holder's process, if it is
/// one of this user; a name that another user squats is no use to us and no obstacle.
#[cfg(target_os = "linux")]
fn claim_name(root: &Path, prefix: &str) -> Result<Option<UnixListener>, u32> {
    let name = daemon_name(root, prefix);
    let Ok(address) = SocketAddr::from_abstract_name(&name) else { return Ok(None) };
    let deadline = Instant::now() + LET_GO;
    loop {
        match UnixListener::bind_addr(&address) {
            Ok(listener) => return Ok(listener.set_nonblocking(true).is_ok().then_some(listener)),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => match name_holder(&name) {
                NameHolder::Daemon(pid) => return Err(pid),
                NameHolder::Leaving if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(1)),
                NameHolder::Leaving | NameHolder::Stranger => return Ok(None),
            },
            Err(_) => return Ok(None),
        }
    }
}

impl DaemonLock {
    /// Takes the lock and writes this process's id into it.
    ///
    /// # Errors
    /// [`IpcError::DaemonRunning`] naming the holder.
    pub(super) fn acquire(root: &Path, prefix: &str) -> Result<Self, IpcError> {
        let path = lock_path(root, prefix);
        let cannot = |source| IpcError::CannotCreate { path: path.clone(), source };
        loop {
            let mut file = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .mode(0o600)
                .open(&path)
                .map_err(cannot)?;
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => {}
                Err(Errno::WOULDBLOCK) => {
                    let mut text = String::new();
                    let _ = file.read_to_string(&mut text);
                    return Err(IpcError::DaemonRunning { pid: text.trim().parse().unwrap_or(0), path });
                }
                Err(Errno::INTR) => continue,
                Err(error) => return Err(cannot(error.into())),
            }
            let mut lock = Self {
                file,
                path: path.clone(),
                #[cfg(target_os = "linux")]
                name: None,
            };
            // The holder before may have removed the file between our open and our lock.
            if !lock.is_ours() {
                lock.path = PathBuf::new();
                continue;
            }
            #[cfg(target_os = "linux")]
            {
                let refuse = |pid| IpcError::DaemonRunning { pid, path: path.clone() };
                lock.name = claim_name(root, prefix).map_err(refuse)?;
            }
            lock.file.set_len(0).and_then(|()| lock.file.rewind()).map_err(cannot)?;
            writeln!(lock.file, "{}", std::process::id()).map_err(cannot)?;
            return Ok(lock);
        }
    }

    /// Whether the locked file is still the one that others would find.
    #[must_use]
    pub fn is_ours(&self) -> bool {
        // Those who asked who holds the name and went again must not fill its queue.
        #[cfg(target_os = "linux")]
        while self.name.as_ref().is_some_and(|name| name.accept().is_ok()) {}
        match (self.file.metadata(), std::fs::symlink_metadata(&self.path)) {
            (Ok(held), Ok(found)) => held.ino() == found.ino() && held.dev() == found.dev(),
            _ => false,
        }
    }
}

impl Drop for DaemonLock {
    fn drop(&mut self) {
        if self.is_ours() {
            let _ = std::fs::remove_file(&self.path);
        }
        // Closing lets go only when no child of this process, just forked, holds the same open files.
        let _ = flock(&self.file, FlockOperation::Unlock);
        #[cfg(target_os = "linux")]
        if let Some(name) = &self.name {
            let _ = shutdown(name, Shutdown::Both);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_is_made_private_and_an_open_one_of_ours_is_closed() {
        let parent = tempfile::tempdir().expect("directory");
        let root = parent.path().join("deep/root");
        prepare(&root).expect("made");
        let mode = || std::fs::metadata(&root).expect("there").permissions().mode() & 0o777;
        assert_eq!(mode(), 0o700);
        std::fs::set_permissions(&root, std::fs::Permissions::from_mode(0o755)).expect("changed");
        prepare(&root).expect("accepted");
        assert_eq!(mode(), 0o700);
    }

    #[test]
    fn links_files_and_roots_that_others_can_write_to_are_refused_with_77() {
        let parent = tempfile::tempdir().expect("directory");
        let target = parent.path().join("target");
        prepare(&target).expect("made");
        let link = parent.path().join("link");
        std::os::unix::fs::symlink(&target, &link).expect("link");
        let file = parent.path().join("file");
        std::fs::write(&file, "").expect("file");
        let open = parent.path().join("open");
        std::fs::create_dir(&open).expect("directory");
        std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o777)).expect("changed");
        for root in [link, file, open] {
            let error = prepare(&root).expect_err("refused");
            assert_eq!(error.exit_code(), 77, "{error}");
        }
    }

    #[test]
    fn a_root_of_another_user_is_refused_with_77() {
        if !rustix::process::geteuid().is_root() {
            return; // Only root can make a directory of another user.
        }
        let parent = tempfile::tempdir().expect("directory");
        let root = parent.path().join("foreign");
        std::fs::create_dir(&root).expect("directory");
        std::fs::set_permissions(&root, std::fs::Permissions::from_mode(0o700)).expect("changed");
        std::os::unix::fs::chown(&root, Some(12_345), None).expect("given away");
        let error = prepare(&root).expect_err("refused");
        assert_eq!(error.exit_code(), 77, "{error}");
    }

    #[test]
    fn a_second_daemon_is_told_the_first_ones_process_and_the_lock_leaves_nothing() {
        let root = tempfile::tempdir().expect("directory");
        let lock = DaemonLock::acquire(root.path(), "test_").expect("free");
        match DaemonLock::acquire(root.path(), "test_") {
            Err(IpcError::DaemonRunning { pid, .. }) => assert_eq!(pid, std::process::id()),
            other => panic!("{other:?}"),
        }
        assert!(DaemonLock::acquire(root.path(), "other_").is_ok(), "another prefix is another daemon");
        drop(lock);
        assert_eq!(std::fs::read_dir(root.path()).expect("there").count(), 0);
        assert!(DaemonLock::acquire(root.path(), "test_").is_ok());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_second_daemon_is_refused_even_when_the_first_ones_root_was_deleted() {
        let parent = tempfile::tempdir().expect("directory");
        let root = parent.path().join("root");
        prepare(&root).expect("made");
        let lock = DaemonLock::acquire(&root, "test_").expect("free");
        std::fs::remove_dir_all(&root).expect("deleted");
        prepare(&root).expect("made again");
        for _ in 0..300 {
            match DaemonLock::acquire(&root, "test_") {
                Err(IpcError::DaemonRunning { pid, .. }) => assert_eq!(pid, std::process::id()),
                other => panic!("{other:?}"),
            }
            assert!(!lock.is_ours());
        }
        drop(lock);
        assert!(DaemonLock::acquire(&root, "test_").is_ok());
    }

    /// As a fork does: the child holds the same open files until it runs its own program.
    #[test]
    #[cfg(target_os = "linux")]
    fn a_lock_let_go_is_free_although_a_child_just_forked_holds_its_files() {
        let root = tempfile::tempdir().expect("directory");
        let acquire = || DaemonLock::acquire(root.path(), "test_");
        let forked = |lock: &DaemonLock| {
            let name = lock.name.as_ref().expect("a name").try_clone().expect("held twice");
            (lock.file.try_clone().expect("held twice"), name)
        };
        let lock = acquire().expect("free");
        let child = forked(&lock);
        assert!(matches!(acquire(), Err(IpcError::DaemonRunning { .. })), "the control: nobody let go");
        drop(lock);
        let starts = std::thread::spawn(move || {
            std::thread::sleep(LET_GO / 10);
            drop(child);
        });
        let lock = acquire().expect("let go");
        starts.join().expect("the child runs its own program");
        assert!(lock.name.is_some(), "the name is claimed as soon as the child has gone");

        // A child that never lets go cannot keep the name from a start for ever.
        let child = forked(&lock);
        drop(lock);
        let begun = Instant::now();
        assert!(acquire().expect("let go").name.is_none());
        assert!(begun.elapsed() >= LET_GO);
        drop(child);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_name_whose_queue_is_full_makes_nobody_wait() {
        let root = tempfile::tempdir().expect("directory");
        let name = daemon_name(root.path(), "test_");
        let address = SocketAddrUnix::new_abstract_name(name.as_bytes()).expect("a name");
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let socket = || socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None).expect("socket");
        let holder = socket();
        rustix::net::bind(&holder, &address).expect("free");
        rustix::net::listen(&holder, 1).expect("listens");
        let waiting = [socket(), socket(), socket()];
        assert_eq!(waiting.each_ref().map(|socket| connect(socket, &address)), [Ok(()), Ok(()), Err(Errno::AGAIN)]);
        let lock = DaemonLock::acquire(root.path(), "test_").expect("the file decides");
        assert!(lock.name.is_none());
    }

    #[test]
    fn a_root_in_a_directory_where_others_can_replace_it_is_refused_with_77() {
        let parent = tempfile::tempdir().expect("directory");
        let open = parent.path().join("open");
        std::fs::create_dir(&open).expect("directory");
        let mode = |mode| std::fs::set_permissions(&open, std::fs::Permissions::from_mode(mode)).expect("changed");
        mode(0o777);
        assert_eq!(prepare(&open.join("root")).expect_err("refused").exit_code(), 77);
        mode(0o1777);
        prepare(&open.join("root")).expect("as in /tmp: others can make files there, but not replace ours");
    }

    #[test]
    fn a_lock_whose_file_was_deleted_notices() {
        let root = tempfile::tempdir().expect("directory");
        let lock = DaemonLock::acquire(root.path(), "test_").expect("free");
        assert!(lock.is_ours());
        std::fs::remove_file(root.path().join("test_daemon.lock")).expect("deleted");
        assert!(!lock.is_ours());
    }
}
