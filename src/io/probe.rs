//! Whether the files that a process opened are still the ones that others find, or were deleted under it.
//!
//! In: the open files before and after a set-up. Out: yes or no, at any later time, for a dozen look-ups in memory. Opens,
//! reads and changes nothing. Where the system does not list a process's open files, the answer is always yes.

use super::files::{SHARED_MEMORY, is_of_prefix};
use std::collections::BTreeSet;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Where the system lists the files that this process has open.
const OPEN_FILES: &str = "/proc/self/fd";
const OWNER_WRITE: u32 = 0o200;

/// A process's open files at one moment: descriptor, path, and whether it may write.
#[derive(Debug, Default)]
pub(super) struct OpenFiles(BTreeSet<(PathBuf, PathBuf, bool)>);

impl OpenFiles {
    /// Those of this process, now.
    pub(super) fn now() -> Self {
        let entries = std::fs::read_dir(OPEN_FILES).into_iter().flatten().flatten();
        let look = |descriptor: PathBuf| {
            let writable = std::fs::symlink_metadata(&descriptor).ok()?.mode() & OWNER_WRITE != 0;
            Some((descriptor.clone(), std::fs::read_link(&descriptor).ok()?, writable))
        };
        Self(entries.filter_map(|entry| look(entry.path())).collect())
    }

    /// How many there are; `None` where the system does not tell.
    pub(super) fn count() -> Option<u64> {
        std::fs::read_dir(OPEN_FILES).ok().map(|entries| entries.count() as u64)
    }
}

/// The files of the transport that must stay as long as a set-up's ports do.
#[derive(Debug, Default)]
pub(super) struct Probe {
    files: Vec<(PathBuf, u64, u64)>,
}

impl Probe {
    /// Of all files that were opened since `before`: everything in the root, every service's segment in shared memory, and
    /// the payloads that we write. Those of others come and go with them.
    pub(super) fn since(before: &OpenFiles, root: &Path, prefix: &str) -> Self {
        let after = OpenFiles::now();
        // So the system marks a file that was deleted already.
        let named = |path: &PathBuf| PathBuf::from(path.to_string_lossy().trim_end_matches(" (deleted)"));
        let stays = |path: &Path, writable: bool| {
            let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return false };
            let shared = path.parent() == Some(Path::new(SHARED_MEMORY)) && is_of_prefix(name, prefix);
            path.starts_with(root) && name.starts_with(prefix)
                || shared && (name.ends_with(".dynamic") || writable && name.ends_with(".data"))
        };
        let look = |descriptor: &PathBuf, path: PathBuf| {
            // Through the descriptor: what we opened, whatever bears its name by now.
            let metadata = std::fs::metadata(descriptor).ok()?;
            Some((path, metadata.dev(), metadata.ino()))
        };
        let opened =
            after.0.difference(&before.0).map(|(descriptor, path, writable)| (descriptor, named(path), *writable));
        let lasting = opened.filter(|(_, path, writable)| stays(path, *writable));
        let mut files: Vec<_> = lasting.filter_map(|(descriptor, path, _)| look(descriptor, path)).collect();
        files.sort();
        files.dedup();
        Self { files }
    }

    /// The first file that is gone or was replaced.
    pub(super) fn lost(&self) -> Option<&Path> {
        let stays = |(path, device, inode): &&(PathBuf, u64, u64)| {
            std::fs::symlink_metadata(path).is_ok_and(|found| (found.dev(), found.ino()) == (*device, *inode))
        };
        self.files.iter().find(|file| !stays(file)).map(|(path, ..)| path.as_path())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;

    #[test]
    fn a_file_that_was_deleted_or_replaced_is_lost_and_one_that_only_changed_is_not() {
        let root = tempfile::tempdir().expect("directory");
        let before = OpenFiles::now();
        let path = root.path().join("x_lock");
        let _held = File::create(&path).expect("made");
        let probe = Probe::since(&before, root.path(), "x_");
        assert_eq!(probe.files.len(), 1, "{probe:?}");
        std::fs::write(&path, "changed").expect("written");
        assert_eq!(probe.lost(), None);
        std::fs::remove_file(&path).expect("deleted");
        assert_eq!(probe.lost(), Some(path.as_path()));
        std::fs::write(&path, "another").expect("written");
        // The old file still holds its number, so another one has another.
        assert_eq!(probe.lost(), Some(path.as_path()));
    }
}
